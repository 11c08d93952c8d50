"""The continuous motion of one simulated bearing, and its description in text."""

import math

import numpy as np

from activefail.errors import InputError
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.accelerogram import STILL, Accelerogram
from activefail.seismic.bearing.contact import Plate, gap, vertex_force, with_arc
from activefail.seismic.bearing.design import GRAVITY, Pulse
from activefail.seismic.bearing.dynamics import System, lever, seen_by_plate, speed_seen_by_plate, system
from activefail.seismic.bearing.kernels import kernel
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.seismic.bearing.simulation import Response
from activefail.space.space import Array
from activefail.visible import visible

LONGEST_STEP = 0.01
"""Longest interval of `Motion.fine_times` [s]; longer steps are divided for smooth lines."""


@kernel(error_model="numpy")
def _watch(system, q, v, arcs, gaps, rims):
    """Compute confinement gaps [m] and normal rim forces [N] along a motion.

    q, v: (n, 5); arcs: (n, 4), deformations of the rims [m]; gaps, rims: (n, 2), outputs; column 0 is the bottom plate,
    column 1 the top plate.
    """
    for row in range(len(q)):
        for side in range(2):
            plate = system.bottom if side == 0 else system.top
            plate = with_arc(with_arc(plate, -1.0, arcs[row, 2 * side]), 1.0, arcs[row, 2 * side + 1])
            least, on_rim = math.inf, 0.0
            for vertex in (2 * side, 2 * side + 1):
                r_x, r_z = lever(system, vertex, q[row, 2])
                u, w = seen_by_plate(vertex, r_x, r_z, q[row])
                du, dw = speed_seen_by_plate(vertex, r_x, r_z, v[row])
                least = min(least, gap(u, w, plate))
                on_rim += vertex_force(u, w, du, dw, plate).rim
            gaps[row, side] = least
            rims[row, side] = on_rim


class Motion:
    """A response as a continuous motion: cubic Hermite splines through the accepted steps, of q with v and v with a.

    Raises:
        InputError: if the response has fewer than two steps, because the simulation was abandoned at its start.
    """

    def __init__(self, response: Response) -> None:
        # Every simulation imports this module; few draw a motion, and this import takes a fifth of a second.
        from scipy.interpolate import CubicHermiteSpline

        if len(response.t) < 2:
            raise InputError(
                f"There is no motion to draw: the simulation ended at its start ("
                f"{response.outcome_name}, {response.cause_name})."
            )
        # The last step may be so short that the spline's coefficients overflow.
        keep = np.append(np.diff(response.t) > 1e-9, True)
        self.response = response
        # Contacts do not depend on the ground's motion.
        motion = response.pulse if isinstance(response.pulse, Pulse) else STILL
        self.system: System = system(response.bearing, motion, response.model)
        self.steps: Array = response.t[keep]
        self._q = CubicHermiteSpline(self.steps, response.q[keep], response.v[keep])
        self._v = CubicHermiteSpline(self.steps, response.v[keep], response.a[keep])
        self._rims = response.rims[keep]

    @property
    def time_label(self) -> str:
        """Label of a time axis."""
        origin = "record's first sample" if isinstance(self.response.pulse, Accelerogram) else "pulse's centre"
        return f"Time from the {origin} [s]"

    @property
    def start(self) -> float:
        """Time of the first step [s]."""
        return float(self.steps[0])

    @property
    def end(self) -> float:
        """Time of the last step [s]; the time of failure, if any."""
        return float(self.steps[-1])

    @property
    def onset(self) -> float:
        """Time shortly before the top plate first moves by 1 % of the capacity [s]; the start if it never does."""
        moved = np.abs(self.response.q[:, 3]) > 0.01 * self.response.bearing.displacement_capacity
        if not moved.any():
            return self.start
        first = float(self.response.t[moved.argmax()])
        return max(self.start, first - max(0.1, 0.05 * (self.end - first)))

    def position(self, t: Array | float) -> Array:
        """Coordinates at times t of shape S [s], shape S x 5; constant before the start and after the end."""
        q: Array = self._q(np.clip(t, self.start, self.end))
        return q

    def velocity(self, t: Array | float) -> Array:
        """Velocities at times t of shape S [s], shape S x 5."""
        v: Array = self._v(np.clip(t, self.start, self.end))
        return v

    def rims(self, t: Array | float) -> Array:
        """Deformations of the rims' arcs at times t of shape S [s], as in `Response.rims`, shape S x 4.

        They are linear within a step; an arc that breaks is broken throughout its last step.
        """
        t = np.clip(t, self.start, self.end)
        k = np.maximum(np.searchsorted(self.steps, t), 1)
        before, after = self._rims[k - 1], self._rims[k]
        share = (t - self.steps[k - 1]) / (self.steps[k] - self.steps[k - 1])
        whole = np.isfinite(after)
        moved = np.where(whole, after, before) - before
        return np.where(whole, before + np.expand_dims(share, -1) * moved, math.inf)

    def plates(self, t: float) -> tuple[Plate, Plate]:
        """The bottom and the top plate with their rims at a time [s]."""
        arcs = self.rims(t).tolist()
        bottom, top = self.system.bottom, self.system.top
        return bottom._replace(left=arcs[0], right=arcs[1]), top._replace(left=arcs[2], right=arcs[3])

    def fine_times(self) -> Array:
        """Times of the accepted steps, with steps longer than `LONGEST_STEP` divided evenly."""
        parts = np.maximum(np.ceil(np.diff(self.steps) / LONGEST_STEP).astype(np.int64), 1)
        first, length = np.repeat(self.steps[:-1], parts), np.repeat(np.diff(self.steps) / parts, parts)
        within = np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)
        return np.append(first + within * length, self.end)

    def ground(self, t: Array) -> Array:
        """Ground acceleration at times t, shape (n,) [m/s²]."""
        pulse = self.response.pulse
        if isinstance(pulse, Accelerogram):
            return pulse.at(t)
        return np.array([ground_acceleration(instant, pulse.amplitude, pulse.period) for instant in t.tolist()])

    def contacts(self, t: Array) -> tuple[Array, Array]:
        """Confinement gaps [m] and rim forces [N] at times t, shape (n,): two arrays (n, 2), bottom and top plate."""
        gaps, rims = np.empty((len(t), 2)), np.empty((len(t), 2))
        _watch(self.system, self.position(t), self.velocity(t), self.rims(t), gaps, rims)
        return gaps, rims

    def force_ratio(self, t: Array) -> Array:
        """Horizontal force of the slider on the top plate / M g, (ẍ_t + ü_g)/g, at times t, shape (n,) [-].

        Linear between the accepted steps, because the force of stiff contacts at interpolated positions is noise.
        """
        accepted = (self.response.a[:, 3] + self.ground(self.response.t)) / GRAVITY
        return np.interp(t, self.response.t, accepted)


def describe_outcome(response: Response) -> str:
    """The outcome in a sentence."""
    margins = response.margins
    cause = response.cause_name.replace("_", " ")
    match response.outcome:
        case o.NO_IMPACT:
            peak = margins.peak_displacement_ratio
            return f"No impact: peak displacement {peak:.2f} of the capacity"
        case o.IMPACT:
            return (
                f"Rim impact without failure: first touch at {seconds(margins.first_touch_time)} "
                f"with {margins.first_touch_velocity:.2f} m/s"
            )
        case o.FAILURE:
            after = margins.failure_time - margins.first_touch_time
            touch = "without a rim touch" if math.isnan(after) else f"{after:.2f} s after the first rim touch"
            return f"Failure by {cause} at {seconds(margins.failure_time)}, {touch}"
        case _:
            return f"Numerical failure ({cause}): no statement about the bearing"


_LONGEST_NAME = 32
"""Characters of a record's name in a title."""


def describe_design(response: Response) -> str:
    """The bearing and the pulse in one line, with units, as mathtext."""
    bearing, pulse = response.bearing, response.pulse
    period = 2.0 * math.pi * math.sqrt(2.0 * bearing.radius / GRAVITY)
    exponent = math.floor(math.log10(bearing.stiffness))
    return "   ".join(
        (
            rf"$T_b$ {period:.2f} s",
            rf"$\mu$ {bearing.mu:.3f}",
            rf"$D_{{tot}}$ {bearing.displacement_capacity:.3f} m",
            rf"$D_{{sl}}$ {bearing.slider_diameter:.3f} m",
            rf"$h_{{sl}}$ {bearing.slider_height:.3f} m",
            rf"$h_{{rim}}$ {1e3 * bearing.rim_height:.0f} mm",
            rf"$p$ {bearing.pressure / 1e6:.1f} MPa",
            rf"$k$ {bearing.stiffness / 10.0**exponent:.2f}$\cdot 10^{{{exponent}}}$ N/m$^{{1.5}}$",
            *_describe_motion(pulse),
        )
    )


def _describe_motion(pulse: Pulse | Accelerogram) -> tuple[str, ...]:
    if isinstance(pulse, Accelerogram):
        # A dollar sign would begin mathtext.
        name = visible(pulse.name).replace("$", "")
        name = name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"
        return (*([name] if name else []), rf"PGA {pulse.peak / GRAVITY:.3f} g", rf"PGV {pulse.peak_velocity:.2f} m/s")
    return rf"$T_p$ {pulse.period:.2f} s", rf"$A_p$ {minus(f'{pulse.amplitude / GRAVITY:.3f}')} g"


def _origin(response: Response) -> str:
    return "after the record's first sample" if isinstance(response.pulse, Accelerogram) else "after the pulse's centre"


def record_lines(record: Accelerogram) -> list[str]:
    """A record's size and peaks, as lines for a terminal."""
    samples = f"{len(record.acceleration)} samples of {record.dt:g} s"
    peaks = f"PGA {record.peak / GRAVITY:.3g} g, PGV {record.peak_velocity:.3g} m/s"
    lines = [f"record     {record.name}: {samples}, {peaks}"]
    if record.vertical is not None:
        lines.append(f"vertical   PGA {np.abs(record.vertical).max() / GRAVITY:.3g} g")
    return lines


def response_lines(response: Response) -> list[str]:
    """The outcome of a simulated bearing and its margins, as lines for a terminal."""
    margins, statistics = response.margins, response.statistics
    lines = [f"outcome    {response.outcome_name}{f' ({response.cause_name})' if response.cause_name else ''}"]
    if response.cause_name == "failure_without_rim_touch":
        lines.append(
            "           the failure criterion was met before the slider touched a rim. This counts as a numerical "
            "failure; check the units"
        )
    elif response.outcome_name == "numerical_failure":
        lines.append("           the integration was abandoned; this says nothing about the bearing")
    rows = [
        ("x / D_tot", f"{margins.peak_displacement_ratio:.3f}", "peak displacement over the capacity"),
        ("F_rim / Mg", f"{margins.peak_rim_force_ratio:.3f}", "peak rim force over the weight"),
        ("gap / rim", f"{margins.peak_gap_ratio:.3f}", "largest uplift of a plate over the rim height"),
        ("tilt", f"{margins.peak_tilt:.3f} rad", "largest rotation of the slider"),
        (
            "energy",
            f"{statistics.energy_error:.1e}",
            f"imbalance, relative; {statistics.steps} steps, {statistics.rejected_steps} rejected",
        ),
    ]
    if not math.isnan(margins.failure_time):
        rows.insert(0, ("failure", f"{margins.failure_time:.3f} s", _origin(response)))
    if not math.isnan(margins.first_touch_time):
        touch = f"first rim touch, at {margins.first_touch_velocity:.3f} m/s"
        rows.insert(0, ("impact", f"{margins.first_touch_time:.3f} s", touch))
    return [*lines, *(f"{name:<10} {value:<10} {meaning}" for name, value, meaning in rows)]


def minus(number: str) -> str:
    """A number with a typographical minus."""
    return number.replace("-", "−")


def seconds(time: float) -> str:
    """A time of the motion, as text."""
    return minus(f"t = {time:.3f} s")


def instants(response: Response) -> dict[str, float]:
    """Characteristic times of the motion by name, in chronological order [s]."""
    motion, margins = Motion(response), response.margins
    chosen = {"at rest": motion.start}
    touch = margins.first_touch_time
    t = motion.fine_times()
    x_t = motion.position(t)[:, 3]
    if response.outcome == o.FAILURE:
        if math.isfinite(touch):
            chosen["first rim touch"] = touch
            chosen["half-way to failure"] = 0.5 * (touch + margins.failure_time)
        chosen["failure"] = margins.failure_time
    elif math.isfinite(touch):
        gaps = motion.contacts(t)[0].max(axis=1)
        chosen["first rim touch"] = touch
        if gaps.max() > 0.0:
            chosen["largest uplift"] = float(t[gaps.argmax()])
        else:
            chosen["largest displacement"] = float(t[np.abs(x_t).argmax()])
        chosen["end of the run"] = motion.end
    else:
        chosen["furthest to the left"] = float(t[x_t.argmin()])
        chosen["furthest to the right"] = float(t[x_t.argmax()])
        chosen["end of the run"] = motion.end
    return dict(sorted(chosen.items(), key=lambda item: item[1]))
