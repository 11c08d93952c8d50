"""Compares the bearing before any rim touch with OpenSees' friction pendulum element, and both with a rigid pendulum.

    python studies/opensees.py --python /path/to/python/with/openseespy
    python studies/opensees.py --n 400 --seed 2 --outcomes 500
    python studies/opensees.py --records farfield

The designs are random designs of Table 1 that touch no rim. The bearing runs in three variants: unchanged; with slow
creep (friction regularised over 10^-5 m/s instead of 10^-3); and with slow creep and nearly rigid contacts (10^4
times as stiff). OpenSees (campaigns/opensees_model.py, in the interpreter that --python names, by default this one)
runs in three: unchanged; without the rise of the mass (pulses only); and with friction mobilised over the displacement
that the bearing's elastic contacts allow. This program integrates the equation of a rigid pendulum. It compares the
peak displacement, and the largest difference of the histories over that peak. docs/opensees.md reports the results.

With --records, each of --n bearings, again random designs of Table 1, is under a record in place of a pulse: those of a
set of FEMA P695 (with activefail[records]), one after the other, or synthetic ones, each times a random factor from 0.5
to 2. docs/records.md reports the results.
"""

import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from study import asked, head, line

from activefail.seismic.bearing import TABLE_1, Accelerogram, Bearing, Model, Pulse, Tolerance, simulate, simulate_one
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.pulse import HALF_DURATION, ground_acceleration
from activefail.seismic.bearing.simulation import FREE_PERIODS
from activefail.seismic.motions.accelerogram_sets import read_record_set

PROGRAM = Path(__file__).parents[1] / "campaigns" / "opensees_model.py"
MODEL = Model()
COULOMB = Model(friction_velocity=1e-5)
RIGID_STIFFNESS = 1e4


class Path1D(NamedTuple):
    """Displacement of the top plate [m] over time [s], 0 at the pulse's centre."""

    t: np.ndarray
    x: np.ndarray

    @property
    def peak(self):
        return np.abs(self.x).max()

    def difference(self, other):
        """Largest difference of the histories over the other's peak, at the other's times until the shorter ends."""
        within = (other.t >= self.t[0]) & (other.t <= self.t[-1])
        return np.abs(np.interp(other.t[within], self.t, self.x) - other.x[within]).max() / other.peak


def rigid_limit(bearing):
    """L between the dishes' circles [m] and the friction coefficient on a surface of that radius (docs/opensees.md)."""
    half_angle = math.asin(0.5 * bearing.slider_diameter / bearing.radius)
    length = 2.0 * bearing.radius * math.cos(half_angle) - bearing.slider_height
    lever = 2.0 * bearing.radius * math.sin(math.atan(bearing.mu)) / (length * math.cos(half_angle))
    return length, math.tan(math.asin(lever))


@njit(cache=True, nogil=True, error_model="numpy")
def _swing(length, friction, amplitude, period, step, count):
    t, x = np.empty(count + 1), np.zeros(count + 1)
    angle, rate = 0.0, 0.0
    t[0] = -HALF_DURATION * period
    for n in range(count):
        ground = ground_acceleration(t[n], amplitude, period)
        pressed = length * rate * rate + GRAVITY * math.cos(angle) - ground * math.sin(angle)
        rate -= step / length * (GRAVITY * math.sin(angle) + ground * math.cos(angle))
        rate = math.copysign(max(abs(rate) - step / length * friction * pressed, 0.0), rate)
        angle += step * rate
        t[n + 1], x[n + 1] = t[n] + step, length * math.sin(angle)
    return t, x


def pendulum(length, friction, pulse, free_time, steps=6400):
    """A point mass on a circle with Coulomb friction, at any displacement: the limit of a rigid bearing.

        L φ'' = −g sin φ − ü_g cos φ − μ n sgn φ',    n = L φ'² + g cos φ − ü_g sin φ,    x = L sin φ

    By leapfrog, as `activefail.seismic.bearing.sliding`, whose equation is this one's for small φ.
    """
    step = min(pulse.period, 1.0) / steps
    count = math.ceil((2.0 * HALF_DURATION * pulse.period + free_time) / step)
    return Path1D(*_swing(length, friction, pulse.amplitude, pulse.period, step, count))


def ours(row, model=MODEL, stiffness=1.0, tolerance=None, record=None):
    """The bearing itself under its pulse or a record, to the end; None if it touches a rim."""
    stiff = np.array(row)
    stiff[6] *= stiffness
    bearing, motion = Bearing.from_row(stiff.tolist(), model.slider_diameter), record or Pulse.from_table(*row[7:])
    response = simulate_one(bearing, motion, model, tolerance or Tolerance(), to_the_end=True)
    return Path1D(response.t, response.q[:, 3]) if response.outcome_name == "no_impact" else None


def opensees(python, row, *options, record=None):
    """OpenSees' element, by the program of the campaign; None if it touches a rim."""
    names = ("--t-b", "--mu", "--d-tot", "--h-sl-ratio", "", "", "", *(("--t-p", "--a-p") if record is None else ()))
    words = [word for name, value in zip(names, row, strict=False) if name for word in (name, repr(value))]
    with tempfile.TemporaryDirectory() as folder:
        history, ground = Path(folder, "history.csv"), Path(folder, "ground.csv")
        if record is not None:
            times = record.dt * np.arange(len(record.acceleration))
            np.savetxt(ground, np.column_stack([times, record.acceleration]), delimiter=",")
            words += ["--record", ground]
        words += ["--slider-diameter", repr(MODEL.slider_diameter), "--history", history, *options]
        done = subprocess.run([python, PROGRAM, *words], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit(done.stderr)
        t, x, _ = np.loadtxt(history, delimiter=",", skiprows=1).T
    return Path1D(t, x) if '"safe"' in done.stdout else None


def arbiter(row):
    """The rigid pendulum of a design."""
    bearing = Bearing.from_row(row, MODEL.slider_diameter)
    return pendulum(*rigid_limit(bearing), Pulse.from_table(*row[7:]), FREE_PERIODS * row[0])


def elastic_slip(bearing):
    """Displacement [m] of the plate, due to the slider's rocking on its contacts, when sliding begins.

    Of each plate's two vertices one is pressed in and one relieved: a moment k_n D_sl²/2 per plate and radian, k_n the
    stiffness of a contact that carries half of the weight. The shear μW has the arm h_sl, and so has the displacement.
    """
    load = 0.5 * bearing.plate_mass * GRAVITY
    normal = 1.5 * bearing.stiffness ** (2.0 / 3.0) * load ** (1.0 / 3.0)
    return 2.0 * load * bearing.mu * (bearing.slider_height / bearing.slider_diameter) ** 2 / normal


def mobilised(row):
    """The option with which OpenSees' friction is mobilised over the displacement of the bearing's contacts."""
    return "--stick", repr(elastic_slip(Bearing.from_row(row, MODEL.slider_diameter)))


def variants(python, row, record=None):
    """The motions of the bearing and of OpenSees, by name; None where one touches a rim."""
    found = {
        "bearing": ours(row, record=record),
        "bearing, slow creep": ours(row, COULOMB, record=record),
        "bearing, rigid": ours(row, COULOMB, RIGID_STIFFNESS, Tolerance(1e-5), record=record),
    }
    if all(motion is not None for motion in found.values()):
        found["OpenSees"] = opensees(python, row, record=record)
        found["OpenSees, elastic"] = opensees(python, row, *mobilised(row), record=record)
        if record is None:
            found["OpenSees, level"] = opensees(python, row, "--level")
            found["rigid pendulum"] = arbiter(row)
    return found


PAIRS = (
    ("bearing", "OpenSees"),
    ("bearing, rigid", "OpenSees"),
    ("bearing, rigid", "rigid pendulum"),
    ("OpenSees", "rigid pendulum"),
    ("OpenSees, level", "rigid pendulum"),
    ("bearing", "OpenSees, elastic"),
    ("bearing, slow creep", "OpenSees, elastic"),
)


def compare(python, rows, n, least):
    """Print the table of the first n of (design, record or None) that touch no rim and have a peak of `least` [m]."""
    compared, left_out = [], 0
    for row, record in rows:
        if len(compared) == n:
            break
        motions = variants(python, row, record)
        last = "OpenSees" if record else "rigid pendulum"
        if any(motion is None for motion in motions.values()) or motions[last].peak < least:
            left_out += 1
        else:
            compared.append(motions)
    print(f"{len(compared)} designs without a rim touch, {left_out} left out (a peak below {least:g} m, or a touch)")
    peaks = [motions[last].peak for motions in compared]
    print(f"peak displacement {min(peaks):.3f} to {max(peaks):.3f} m, median {np.median(peaks):.3f} m\n")
    head("motion", "compared with", "peak: mean", "median", "90 %", "largest", "history: median", "90 %", "largest")
    for one, other in PAIRS:
        if other in compared[0]:
            peak = np.array([100.0 * (motions[one].peak / motions[other].peak - 1.0) for motions in compared])
            history = np.array([100.0 * motions[one].difference(motions[other]) for motions in compared])
            both = [value for part in (np.abs(peak), history) for value in np.quantile(part, [0.5, 0.9, 1.0])]
            line(one, other, f"{peak.mean():+.2f}", *(f"{value:.2f}" for value in both))
    return compared


def synthetic(rng, dt=0.01, seconds=20.0):
    """A pulse with filtered noise in an envelope, of 0.2 g."""
    t = np.arange(0.0, seconds, dt)
    noise = np.convolve(rng.standard_normal(len(t)), np.exp(-np.arange(0.0, 1.0, dt) / 0.1), mode="same")
    noise *= np.exp(-0.5 * ((t - 8.0) / 3.0) ** 2)
    period = rng.uniform(1.0, 3.0)
    a = np.array([ground_acceleration(time - 8.0, 1.0, period) for time in t]) + 0.7 * noise / np.abs(noise).max()
    return Accelerogram(0.2 * GRAVITY * a / np.abs(a).max(), dt)


def under_pulses(n, seed):
    """Random designs whose bearing touches no rim."""
    X = TABLE_1.latin_hypercube(4 * n, np.random.default_rng(seed))
    return [(row, None) for row in X[simulate(X).outcome == 0].tolist()]


def under_records(name, n, seed):
    """Random designs, each under a record times a random factor."""
    rng = np.random.default_rng(seed)
    X = TABLE_1.latin_hypercube(n, rng)
    if name == "synthetic":
        grounds = [synthetic(rng) for _ in range(n)]
    else:
        grounds = [one.motion for one in read_record_set(Path(name)).records]
    return [(row, grounds[k % len(grounds)].scaled(rng.uniform(0.5, 2.0))) for k, row in enumerate(X.tolist())]


def compare_outcomes(python, n, seed):
    """Whether OpenSees returns `impact` if the bearing touches a rim, over all of Table 1."""
    X = TABLE_1.latin_hypercube(n, np.random.default_rng(seed + 1))
    touched = simulate(X).outcome >= 1
    there = np.array([opensees(python, row) is None for row in X.tolist()])
    print(f"\nimpact or not: the same for {np.mean(there == touched):.1%} of {n} designs;")
    print(f"{np.sum(touched & ~there)} touch a rim in the bearing alone, {np.sum(there & ~touched)} in OpenSees alone")


def main():
    options = asked(__doc__, python=sys.executable, n=100, seed=1, least=0.01, outcomes=0, records=str)
    n, seed = options.n, options.seed
    rows = under_records(options.records, n, seed) if options.records else under_pulses(n, seed)
    compare(options.python, rows, n, options.least)
    if options.outcomes and not options.records:
        compare_outcomes(options.python, options.outcomes, seed)


if __name__ == "__main__":
    main()
