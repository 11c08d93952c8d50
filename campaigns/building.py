"""A base-isolated shear building on double friction pendulum bearings: the simulator of `building.toml`.

`building_records.toml` has it under ground-motion records in place of pulses.

The bearing is activefail's: planar bodies with friction, rims, slider rotation and uplift (docs/theory.md). It
carries a base slab and storeys instead of a rigid mass, and their horizontal motion acts back on the bearing.
docs/building.md gives the equations and their sources. SI units, unless a name says otherwise.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from activefail.bearing import Bearing, Model, Pulse
from activefail.bearing import outcome as o
from activefail.bearing.accelerogram import STILL
from activefail.bearing.course import at_sample, from_sample, longest_step, shaking
from activefail.bearing.design import GRAVITY
from activefail.bearing.dynamics import System, dfp_acceleration, dfp_linearisation, equilibrium, system
from activefail.bearing.ground import acceleration
from activefail.bearing.simulation import EVENT_STEP, FREE_PERIODS, SCALE_Q, SCALE_V

DAMAGE_DRIFT = 0.005
"""Interstorey drift over the storey's height: brittle non-structural elements (EN 1998-1:2004, 4.4.3.2)."""

FAILURE_DRIFT = 0.020
"""The same: above an isolation system, by response histories (ASCE/SEI 7-16, 17.6.4.4)."""

TOLERANCE = 1e-4
"""Relative error of a step."""

SCALE_D = 0.005
"""A mode's displacement [m] below which errors are absolute; ten times that per second for its velocity."""

LONGEST_STEP = 0.05
"""[s]; and T_s/20 at most: peaks are detected at the ends and the middles of steps."""

MOST_STEPS = 1_000_000

DONE, TOO_MANY_STEPS, STEP_UNDERFLOW = 0, 1, 2
"""Status of `_integrate`."""


class Shear(NamedTuple):
    """The modes of a shear building on a fixed base, (n,) or (n, n): the floor first, then the mode."""

    omega: np.ndarray  # ω_j [rad/s]
    shape: np.ndarray  # Γ_j φ_j of each floor; their sum over j is 1
    mass: np.ndarray  # effective modal masses M*_j over the mass of a floor; their sum is n


def shear_building(storeys, period):
    """Modes of n equal floors on n equal storeys whose longest period is T_s [s], in closed form; a `Shear`."""
    j, i = np.arange(1, storeys + 1), np.arange(1, storeys + 1)[:, None]
    angle = (2 * j - 1) * np.pi / (2 * storeys + 1)
    omega = 2.0 * np.pi / period * np.sin(0.5 * angle) / np.sin(0.5 * angle[0])
    phi = np.sin(i * angle)
    participation = phi.sum(axis=0) / (phi * phi).sum(axis=0)
    return Shear(omega, participation * phi, participation * phi.sum(axis=0))


class Building(NamedTuple):
    """An isolated building under a ground motion, as the kernels see it.

    Coordinates: the bearing's five, then for each mode D_j [m], the displacement relative to the base of an oscillator
    with the mode's frequency and damping. A floor is at Σ Γ_j φ_j D_j relative to the base.
    """

    bearing: System  # its plate mass M is that of the base and all floors
    base: float  # mass of the base slab [kg]
    mass: np.ndarray  # (n,) effective modal masses M*_j [kg]
    stiffness: np.ndarray  # (n,) ω_j² [1/s²]
    damping: np.ndarray  # (n,) 2ζω_j [1/s]
    drift: np.ndarray  # (n, n) from the D_j to interstorey drifts over the storey's height [1/m]
    floor: np.ndarray  # (n, n) from the s_j to the floors' absolute accelerations [-]


def building_of(design):
    """The `Building` of a design, by the names and in the units of `building.toml`; its base weighs as much as a floor.

    Without T_p the ground is still: `_integrate` then moves it as a record does.

    Raises:
        InputError: if the bearing cannot be built.
        ValueError: if the building cannot.
    """
    bearing = Bearing.from_table(
        *(design[name] for name in ("T_b", "mu", "D_tot", "h_sl_ratio", "h_rim_ratio", "p", "k"))
    )
    ground = Pulse.from_table(design["T_p"], design["A_p"]) if "T_p" in design else STILL
    n = int(design["storeys"])
    if n != design["storeys"] or n < 1 or min(design["T_s"], design["storey_height"]) <= 0.0 or design["damping"] < 0.0:
        raise ValueError(
            f"storeys must be a whole number, T_s and storey_height positive, damping not negative: {design}"
        )
    shear = shear_building(n, design["T_s"])
    floor = bearing.plate_mass / (n + 1)
    return Building(
        system(bearing, ground, Model()),
        floor,
        floor * shear.mass,
        shear.omega**2,
        2.0 * design["damping"] * shear.omega,
        np.diff(shear.shape, axis=0, prepend=0.0) / design["storey_height"],
        -shear.shape,
    )


@njit(error_model="numpy")
def pull(building, j, q, v):
    """s_j = ω_j² D_j + 2ζω_j D_j' of a mode [m/s²]."""
    return building.stiffness[j] * q[5 + j] + building.damping[j] * v[5 + j]


@njit(error_model="numpy")
def accelerate(building, t, q, v, out):
    """Write the accelerations of all coordinates, (5 + n,), into `out`.

    The bearing's kernel assumes a plate of rigid mass M. M (a + ü_g) is the force on the plate, whatever it carries.
    """
    bearing = building.bearing
    ground = acceleration(bearing.motion, t)
    a = dfp_acceleration(bearing, t, (q[0], q[1], q[2], q[3], q[4]), (v[0], v[1], v[2], v[3], v[4]))
    force = bearing.plate_mass * (a[3] + ground)
    for j in range(len(q) - 5):
        force += building.mass[j] * pull(building, j, q, v)
    base = force / building.base
    out[0], out[1], out[2], out[3], out[4] = a[0], a[1], a[2], base - ground, a[4]
    for j in range(len(q) - 5):
        out[5 + j] = -pull(building, j, q, v) - base


@njit(error_model="numpy")
def linearise(building, t, q, v, by_q, by_v, by_t):
    """Write ∂a/∂q and ∂a/∂v, (5 + n, 5 + n), and ∂a/∂t, (5 + n,), into the last three."""
    bearing, size = building.bearing, len(q)
    place, speed = (q[0], q[1], q[2], q[3], q[4]), (v[0], v[1], v[2], v[3], v[4])
    _, bearing_q, bearing_v, bearing_t = dfp_linearisation(bearing, t, place, speed)
    for i in range(5):
        by_t[i] = bearing_t[i]
        # Horizontally the base is lighter than the plate that the bearing's kernel assumes.
        ratio = bearing.plate_mass / building.base if i == 3 else 1.0
        for j in range(5):
            by_q[i, j], by_v[i, j] = ratio * bearing_q[i][j], ratio * bearing_v[i][j]
        for j in range(5, size):
            by_q[i, j] = by_v[i, j] = 0.0
    for j in range(5, size):
        share = building.mass[j - 5] / building.base
        by_q[3, j], by_v[3, j] = share * building.stiffness[j - 5], share * building.damping[j - 5]
    for i in range(5, size):
        by_t[i] = 0.0
        for j in range(size):
            by_q[i, j], by_v[i, j] = -by_q[3, j], -by_v[3, j]
        by_q[i, i] -= building.stiffness[i - 5]
        by_v[i, i] -= building.damping[i - 5]


@njit(error_model="numpy")
def solve(factors, x):
    """Solve a linear system in place with the LU factors of `rosenbrock_step` (no pivoting)."""
    size = len(x)
    for i in range(size):
        for j in range(i):
            x[i] -= factors[i, j] * x[j]
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, size):
            x[i] -= factors[i, j] * x[j]
        x[i] /= factors[i, i]


# RODAS3 (Sandu et al. 1997): arguments y + Σ A_j u_j, couplings Σ C_j u_j / h; the end of a step is the argument of its
# last stage plus u_4, which is the error as well.
GAMMA = 0.5
TIMES = (0.0, 0.0, 1.0, 1.0)
DERIVATIVES = (0.5, 1.5, 0.0, 0.0)
A = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [2.0, 0.0, 1.0, 0.0]])
C = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0], [1.0, -1.0, -8.0 / 3.0, 0.0]])


@njit(error_model="numpy")
def rosenbrock_step(building, t, q, v, h, q_end, v_end):
    """One step on q'' = a(t, q, q') by an L-stable method of order 3 with an embedded method of order 2.

    A stage solves (1/γh − J) u = f + Σ C_j u_j / h + h γ_i ∂f/∂t for its (u_q, u_v); u_q is eliminated. The final
    state is written into `q_end` and `v_end`. Returns its errors.
    """
    size, gh = len(q), GAMMA * h
    by_q, by_v, by_t = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    linearise(building, t, q, v, by_q, by_v, by_t)
    factors = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            factors[i, j] = (1.0 / gh if i == j else 0.0) - by_v[i, j] - gh * by_q[i, j]
    for k in range(size):
        for i in range(k + 1, size):
            factors[i, k] /= factors[k, k]
            for j in range(k + 1, size):
                factors[i, j] -= factors[i, k] * factors[k, j]
    u_q, u_v = np.zeros((4, size)), np.zeros((4, size))
    a, lead = np.empty(size), np.empty(size)
    for stage in range(4):
        for i in range(size):
            q_end[i], v_end[i], lead[i] = q[i], v[i], 0.0
            for j in range(stage):
                q_end[i] += A[stage, j] * u_q[j, i]
                v_end[i] += A[stage, j] * u_v[j, i]
                lead[i] += C[stage, j] / h * u_q[j, i]
            lead[i] += v_end[i]
        accelerate(building, t + TIMES[stage] * h, q_end, v_end, a)
        for i in range(size):
            right = a[i] + DERIVATIVES[stage] * h * by_t[i]
            for j in range(stage):
                right += C[stage, j] / h * u_v[j, i]
            for j in range(size):
                right += gh * by_q[i, j] * lead[j]
            u_v[stage, i] = right
        solve(factors, u_v[stage])
        for i in range(size):
            u_q[stage, i] = gh * (lead[i] + u_v[stage, i])
    for i in range(size):
        q_end[i] += u_q[3, i]
        v_end[i] += u_v[3, i]
    return u_q[3], u_v[3]


@njit(error_model="numpy")
def largest(matrix, x):
    """Largest magnitude of a matrix times a vector."""
    magnitude = 0.0
    for i in range(len(matrix)):
        total = 0.0
        for j in range(len(x)):
            total += matrix[i, j] * x[j]
        magnitude = max(magnitude, abs(total))
    return magnitude


@njit(error_model="numpy")
def squared_errors(error, before, after, scale):
    """Σ (error_i / (scale_i + max(|before_i|, |after_i|)))²."""
    total = 0.0
    for i in range(len(error)):
        total += (error[i] / (scale[i] + max(abs(before[i]), abs(after[i])))) ** 2
    return total


@njit(error_model="numpy")
def energy_and_events(building, t, q, v):
    """Stored energy [J], dissipation and the ground's power [W], of both; the bearing's `Observation`."""
    bearing = building.bearing
    place, speed = (q[0], q[1], q[2], q[3], q[4]), (v[0], v[1], v[2], v[3], v[4])
    energy, seen = o.examine(bearing, t, place, speed)
    stored, dissipation, work = energy
    ground = acceleration(bearing.motion, t)
    for j in range(len(building.mass)):
        # The bearing's kinetic energy has M*_j at the plate's velocity; the oscillator moves relative to that.
        mass, D, rate = building.mass[j], q[5 + j], v[5 + j]
        stored += mass * (rate * (v[3] + 0.5 * rate) + 0.5 * building.stiffness[j] * D * D)
        dissipation += mass * building.damping[j] * rate * rate
        work -= mass * rate * ground
    return stored, dissipation, work, seen


@njit(error_model="numpy")
def on_bearing(building, bearing):
    """The building on another `System`, the same bearing after the next sample of a record."""
    return Building(
        bearing,
        building.base,
        building.mass,
        building.stiffness,
        building.damping,
        building.drift,
        building.floor,
    )


@njit(error_model="numpy")
def _integrate(building, samples, q, v, scale_q, scale_v, free_time, longest, tolerance, history):
    """Integrate a building from (q, v) until its bearing fails or the time is over; (q, v) then hold the final state.

    `samples` are those of a record, None for a pulse. Returns a status, then as in `Response`: the index of the
    cause, whether a rim was touched, the four peaks, the error of the energy balance and the steps; and how many rows
    (t, q, v) were written into `history`, one per step until it is full.
    """
    size, sample = len(q), 0
    t, motion_end, h = shaking(building.bearing, samples)
    end = motion_end + free_time
    at_rest, dissipation, power, seen_before = energy_and_events(building, t, q, v)
    displacement, drift, floor, rim = 0.0, 0.0, 0.0, 0.0
    work, lost, peak_work, imbalance = 0.0, 0.0, 0.0, 0.0
    q_end, v_end, middle_q, middle_v = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    s = np.empty(size - 5)
    status, cause, touched, steps, rows = DONE, o.NONE, False, 0, 0
    while True:
        if rows < len(history):
            history[rows, 0] = t
            for i in range(size):
                history[rows, 1 + i], history[rows, 1 + size + i] = q[i], v[i]
            rows += 1
        # The times of the steps add up to the end but for rounding.
        if end - t < 1e-9 or cause != o.NONE:
            break
        sample = at_sample(samples, t, sample)
        bearing = from_sample(building.bearing, samples, sample)
        building = on_bearing(building, bearing)
        bound = longest_step(bearing, samples, t, h, sample, motion_end, longest)
        if seen_before.confinement_gap > 0.0 or seen_before.touch > 0.0:
            bound = min(bound, EVENT_STEP)
        h, rejected = min(h, bound, end - t), False
        while True:
            steps += 1
            if steps > MOST_STEPS or h < 1e-13:
                status = TOO_MANY_STEPS if steps > MOST_STEPS else STEP_UNDERFLOW
                break
            error_q, error_v = rosenbrock_step(building, t, q, v, h, q_end, v_end)
            squares = squared_errors(error_q, q, q_end, scale_q) + squared_errors(error_v, v, v_end, scale_v)
            error = math.sqrt(squares / (2 * size)) / tolerance
            factor = min(3.0, max(0.2, 0.8 * max(error, 1e-9) ** (-1.0 / 3.0))) if math.isfinite(error) else 0.1
            if error <= 1.0:
                break
            h, rejected = h * factor, True
        if status != DONE:
            break
        # The middle of the step from the cubic with the values and slopes of both ends.
        for i in range(size):
            middle_q[i] = 0.5 * (q[i] + q_end[i]) + h / 8.0 * (v[i] - v_end[i])
            middle_v[i] = 1.5 / h * (q_end[i] - q[i]) - 0.25 * (v[i] + v_end[i])
        _, dissipation_middle, power_middle, _ = energy_and_events(building, t + 0.5 * h, middle_q, middle_v)
        t += h
        for i in range(size):
            q[i], v[i] = q_end[i], v_end[i]
        for j in range(size - 5):
            s[j] = pull(building, j, q, v)
        stored, dissipation_end, power_end, seen = energy_and_events(building, t, q, v)
        displacement = max(displacement, abs(middle_q[3]), abs(q[3]))
        drift = max(drift, largest(building.drift, middle_q[5:]), largest(building.drift, q[5:]))
        floor = max(floor, largest(building.floor, s))
        rim = max(rim, seen.rim_force)
        touched = touched or seen.touch > 0.0
        work += h / 6.0 * (power + 4.0 * power_middle + power_end)
        lost += h / 6.0 * (dissipation + 4.0 * dissipation_middle + dissipation_end)
        peak_work = max(peak_work, abs(work))
        cause = o.failure_cause(seen, bearing, True)
        if cause != o.ESCAPE:  # an escape removes the rim's elastic energy from the balance
            imbalance = max(imbalance, abs(stored - at_rest - work + lost))
        dissipation, power, seen_before = dissipation_end, power_end, seen
        h *= min(factor, 1.0) if rejected else factor
    error = imbalance / max(peak_work, bearing.plate_mass * GRAVITY * 1e-3)
    return status, cause, touched, displacement, drift, floor, rim, error, steps, rows


class Response(NamedTuple):
    """The response of a building; peaks are those until its bearing failed."""

    cause: str  # of the bearing's failure; empty if it did not fail
    touched: bool  # whether the slider touched a rim
    peak_drift: float  # interstorey drift over the storey's height [-]
    peak_displacement: float  # of the base relative to the ground [m]
    peak_floor_acceleration: float  # absolute, of a floor [m/s²]
    peak_rim_force: float  # on the rim of one plate [N]
    energy_error: float  # largest imbalance over the larger of the ground's peak work and M g · 1 mm [-]
    steps: int
    history: np.ndarray  # (rows, 1 + 2 (5 + n)): t, coordinates, velocities; empty if not requested


def simulate(design, tolerance=TOLERANCE, rows=0, record=None):
    """The `Response` of a design, by the names and in the units of `building.toml`, with a history of `rows` rows.

    A design without T_p and A_p is simulated under a record: `record`, an `Accelerogram`, or the design's own.

    Raises:
        RuntimeError: if the integration fails.
    """
    building, n = building_of(design), int(design["storeys"])
    history = np.empty((rows, 1 + 2 * (5 + n)))
    status, cause, touched, displacement, drift, floor, rim, error, steps, recorded = _integrate(
        building,
        None if "T_p" in design else (record or design["record"].motion).samples,
        np.array([*equilibrium(building.bearing), *[0.0] * n]),
        np.zeros(5 + n),
        np.array([*SCALE_Q, *[SCALE_D] * n]),
        np.array([*SCALE_V, *[10.0 * SCALE_D] * n]),
        FREE_PERIODS * design["T_b"],
        min(LONGEST_STEP, design["T_s"] / 20.0),
        tolerance,
        history,
    )
    if status != DONE or not math.isfinite(error):
        raise RuntimeError(f"the integration failed after {steps} steps with status {status}")
    return Response(o.CAUSES[cause], touched, drift, displacement, floor, rim, error, steps, history[:recorded])


def run(design):
    """The outcome of a design and its margins, as a campaign reads them."""
    response = simulate(design)
    if response.cause or response.peak_drift > FAILURE_DRIFT:
        outcome = "failure"
    else:
        outcome = "damage" if response.peak_drift > DAMAGE_DRIFT else "safe"
    weight = GRAVITY * building_of(design).bearing.plate_mass
    margins = {
        "peak_drift": response.peak_drift,
        "peak_displacement_ratio": response.peak_displacement / design["D_tot"],
        "peak_floor_acceleration": response.peak_floor_acceleration / GRAVITY,
        "peak_rim_force_ratio": response.peak_rim_force / weight,
        "bearing_failed": float(response.cause != ""),
        "energy_error": response.energy_error,
    }
    return {"outcome": outcome, "margins": margins}
