"""A double friction pendulum bearing in OpenSees: each run answers one design of a campaign.

    python opensees_model.py --t-b 4 --mu 0.06 --d-tot 0.6 --t-p 2.5 --a-p 0.3 --out answer.json
    python opensees_model.py --t-b 4 --mu 0.06 --d-tot 0.6 --record kobe.csv

docs/opensees.md describes the equations, their assumptions, and a comparison with activefail's own bearing. The program
needs openseespy and NumPy but nothing from activefail, so any interpreter that has these two can run it.
"""

import argparse
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

try:
    import openseespy.opensees as ops
except (ImportError, RuntimeError) as error:  # a RuntimeError if a library that it needs is missing
    sys.exit(
        f"opensees_model.py: {sys.executable} cannot import openseespy ({error}). Install it there with `pip install "
        f"openseespy`. On Debian it also needs the packages libblas3, liblapack3 and libgfortran5."
    )

GRAVITY = 9.81
"""g [m/s²]."""

MASS = 1.0
"""Mass on the bearing [kg]. All forces are proportional to it, so the motion does not depend on it."""

SHORTENING = 1e-4
"""Shortening of the bearing by the weight [m]; it gives a vertical period of 20 ms."""

SETTLING = 2.5
"""The motion is followed for this many T_b after the pulse."""

HALVINGS = 12
"""How often a step that does not converge is halved before the run is abandoned."""


@dataclass(frozen=True)
class Pendulum:
    """The single pendulum that moves as a rigid double friction pendulum does (docs/opensees.md).

    Attributes:
        length: L between the centres of the circles on which the slider's edges move [m].
        friction: coefficient that acts on the pendulum's own surface [-].
        capacity: displacement of the top plate at which the slider's edge reaches a rim [m].
    """

    length: float
    friction: float
    capacity: float

    @classmethod
    def of(cls, T_b: float, mu: float, D_tot: float, slider_diameter: float, slider_height: float) -> "Pendulum":
        """Of a bearing with two equal dishes: s, -, m, m, m.

        Raises:
            ValueError: if it cannot be built.
        """
        radius = 0.5 * GRAVITY * (T_b / (2.0 * math.pi)) ** 2
        rim = 0.5 * (D_tot + slider_diameter)
        if not rim < radius:
            raise ValueError(
                f"a dish must be less than a hemisphere, got a radius of {radius:.4g} m and a rim at {rim} m"
            )
        half_angle = math.asin(0.5 * slider_diameter / radius)  # that the slider covers of a dish
        length = 2.0 * radius * math.cos(half_angle) - slider_height
        lever = 2.0 * radius * math.sin(math.atan(mu)) / (length * math.cos(half_angle)) if length > 0.0 else math.inf
        if not lever < 1.0:
            raise ValueError(
                f"the slider's height must be less than the distance between the dishes' centres, got {slider_height} m"
            )
        return cls(length, math.tan(math.asin(lever)), length * math.sin(math.asin(rim / radius) - half_angle))


@dataclass(frozen=True)
class Ground:
    """The ground's acceleration, linear between samples at equal intervals.

    Attributes:
        begin: time of the first sample [s].
        dt: interval between samples [s].
        acceleration: (n,) [m/s²].
        substeps: steps of the integration in an interval.
    """

    begin: float
    dt: float
    acceleration: np.ndarray
    substeps: int = 1

    @classmethod
    def of_pulse(cls, T_p: float, A_p: float, settling: float, steps: int) -> "Ground":
        """An antisymmetric Ricker pulse, of period T_p [s] and amplitude A_p [g], 0 at its centre.

        Args:
            T_p, A_p: of the pulse [s, g].
            settling: time after the pulse [s].
            steps: per pulse period, or per second if that is shorter.
        """
        dt = min(T_p, 1.0) / steps
        begin = -1.5 * T_p
        t = begin + dt * np.arange(math.ceil((settling - 2.0 * begin) / dt) + 1)
        return cls(begin, dt, ricker(t, T_p, A_p))

    @classmethod
    def of_record(cls, file: Path, settling: float, steps: int) -> "Ground":
        """A record: a file with a time [s] and an acceleration [m/s²] in each line, separated by a comma.

        Args:
            file: of the record.
            settling: time after the record [s].
            steps: per second, at least.

        Raises:
            OSError: if the file cannot be read.
            ValueError: if its lines are not two numbers, or its times do not rise by equal intervals.
        """
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
        if rows.shape[0] < 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
            raise ValueError(f"{file}: must have two numbers in each of at least two lines, got shape {rows.shape}")
        t, a = rows.T
        dt = (t[-1] - t[0]) / (len(t) - 1)
        if not (dt > 0.0 and np.abs(np.diff(t) - dt).max() < 0.01 * dt):
            raise ValueError(f"{file}: times must rise by equal intervals")
        return cls(t[0], dt, np.append(a, np.zeros(math.ceil(settling / dt))), math.ceil(dt * steps))


@dataclass(frozen=True)
class Motion:
    """A response, at equal steps in time.

    Attributes:
        t: (n,) times, 0 at the pulse's centre, or those of the record [s].
        x: (n,) displacement of the mass from the ground [m].
        shear: (n,) base shear over the weight [-].
    """

    t: np.ndarray
    x: np.ndarray
    shear: np.ndarray


def ricker(t: np.ndarray, T_p: float, A_p: float) -> np.ndarray:
    """Ground acceleration [m/s²] of an antisymmetric Ricker pulse of period T_p [s] and amplitude A_p [g]."""
    s = 2.0 * math.pi * t / (math.sqrt(3.0) * T_p)
    return A_p * GRAVITY / 1.38 * (s * s - 3.0) * s * np.exp(-0.5 * s * s)


def respond(
    pendulum: Pendulum,
    ground: Ground,
    stick: float = 1e-6,
    vertical: bool = True,
) -> Motion:
    """The motion of a mass on a friction pendulum, until it reaches a rim or the time is over.

    Args:
        pendulum: the pendulum that carries the mass.
        ground: its motion.
        stick: displacement at which friction is fully mobilised [m].
        vertical: whether the mass rises as it moves out.

    Raises:
        RuntimeError: if a step does not converge.
    """
    weight = MASS * GRAVITY
    step = ground.dt / ground.substeps
    count = (len(ground.acceleration) - 1) * ground.substeps
    t = ground.begin + step * np.arange(count + 1)

    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    ops.node(1, 0.0, 0.0)
    ops.node(2, 0.0, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.fix(2, 0, 0, 1)
    # No vertical inertia if the mass does not rise: the vertical force is the weight.
    ops.mass(2, MASS, MASS if vertical else 1e-9 * MASS, 0.0)
    ops.frictionModel("Coulomb", 1, pendulum.friction)
    ops.uniaxialMaterial("Elastic", 1, weight / SHORTENING)
    ops.uniaxialMaterial("Elastic", 2, 1.0)  # against rotation, which is fixed
    bearing = ["-P", 1, "-Mz", 2, "-orient", 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, "-iter", 100, 1e-10 * weight]
    if vertical:
        # With a small d: OpenSeesPy 3.7 accepts this spelling and ignores the manual's "-inclVertDisp".
        bearing.append("-inclVertdisp")
    # The element subtracts the pendulum's stiffness from the initial one; the rest is that of friction.
    initial = weight * (pendulum.friction / stick + 1.0 / pendulum.length)
    ops.element("singleFPBearing", 1, 1, 2, 1, pendulum.length, initial, *bearing)

    ops.timeSeries("Constant", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(2, 0.0, -weight, 0.0)
    _solve_by_newton()
    ops.integrator("LoadControl", 1.0)
    ops.analysis("Static")
    if ops.analyze(1) != 0:
        raise RuntimeError("no static equilibrium under the weight")
    ops.loadConst("-time", 0.0)
    ops.wipeAnalysis()

    ops.timeSeries("Path", 2, "-dt", ground.dt, "-values", *ground.acceleration.tolist())
    ops.pattern("UniformExcitation", 2, 1, "-accel", 2)
    _solve_by_newton()
    ops.integrator("HHT", 0.9)
    ops.analysis("Transient")
    x, shear = np.zeros(count + 1), np.zeros(count + 1)
    for i in range(1, count + 1):
        if not _advance(step, HALVINGS):
            raise RuntimeError(f"no convergence at {t[i]:.4f} s")
        x[i] = ops.nodeDisp(2, 1)
        # The reaction on the ground: the force of the bearing's plastic and pendulum parts.
        shear[i] = ops.eleForce(1, 1) / weight
        if abs(x[i]) >= pendulum.capacity:
            return Motion(t[: i + 1], x[: i + 1], shear[: i + 1])
    return Motion(t, x, shear)


def _solve_by_newton() -> None:
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("BandGeneral")
    ops.test("NormDispIncr", 1e-9, 25)
    ops.algorithm("Newton")


def _advance(step: float, halvings: int) -> bool:
    """Take a step, in halves if it does not converge: Newton's method may cycle if sliding reverses within the step."""
    if ops.analyze(1, step) == 0:
        return True
    return halvings > 0 and _advance(0.5 * step, halvings - 1) and _advance(0.5 * step, halvings - 1)


def answer(pendulum: Pendulum, motion: Motion) -> dict[str, object]:
    """Outcome and margins of a motion, as a campaign reads them."""
    peak = float(np.abs(motion.x).max())
    margins = {
        "peak_displacement_ratio": peak / pendulum.capacity,
        "peak_shear_ratio": float(np.abs(motion.shear).max()),
    }
    if peak >= pendulum.capacity:
        margins["touch_velocity"] = float(abs(motion.x[-1] - motion.x[-2]) / (motion.t[-1] - motion.t[-2]))
        return {"outcome": "impact", "margins": margins}
    margins["residual_displacement"] = float(abs(motion.x[-1]))
    return {"outcome": "safe", "margins": margins}


def positive(text: str) -> float:
    """A positive, finite number."""
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"must be positive and finite, got {text}")
    return value


def main() -> None:
    """Read a design, let it respond, write the answer."""
    parser = argparse.ArgumentParser(
        description="A double friction pendulum bearing in OpenSees under a pulse or a record."
    )
    parser.add_argument("--t-b", type=positive, required=True, help="period of the bearing, 2 pi sqrt(2R/g) [s]")
    parser.add_argument("--mu", type=positive, required=True, help="friction coefficient")
    parser.add_argument("--d-tot", type=positive, required=True, help="displacement capacity D_out - D_sl [m]")
    parser.add_argument("--h-sl-ratio", type=positive, default=0.8, help="slider height over slider diameter")
    parser.add_argument("--slider-diameter", type=positive, default=0.30, help="[m]")
    parser.add_argument("--t-p", type=positive, help="period of the pulse [s]")
    parser.add_argument("--a-p", type=positive, help="amplitude of the pulse [g]")
    parser.add_argument("--record", type=Path, help="file in place of a pulse: CSV with time [s], acceleration [m/s2]")
    parser.add_argument("--steps", type=int, default=400, help="per pulse period, or per second if that is shorter")
    parser.add_argument("--stick", type=positive, default=1e-6, help="displacement that mobilises friction [m]")
    parser.add_argument("--level", action="store_true", help="let the mass move only horizontally")
    parser.add_argument("--out", type=Path, help="file for the answer, JSON; by default it is printed")
    parser.add_argument(
        "--history", type=Path, help="file for the motion: CSV with time [s], displacement [m], shear/W"
    )
    options = parser.parse_args()
    pulse = [options.t_p, options.a_p]
    if pulse.count(None) != (0 if options.record is None else 2):
        parser.error("--t-p and --a-p are required without --record, and cannot be combined with it")
    try:
        height = options.h_sl_ratio * options.slider_diameter
        pendulum = Pendulum.of(options.t_b, options.mu, options.d_tot, options.slider_diameter, height)
        settling = SETTLING * options.t_b
        if options.record is None:
            ground = Ground.of_pulse(*pulse, settling, options.steps)
        else:
            ground = Ground.of_record(options.record, settling, options.steps)
        motion = respond(pendulum, ground, options.stick, not options.level)
    except (OSError, ValueError, RuntimeError) as error:
        sys.exit(f"opensees_model.py: {error}.")
    if options.history:
        columns = np.column_stack([motion.t, motion.x, motion.shear])
        np.savetxt(options.history, columns, delimiter=",", header="t,x,shear", comments="")
    line = json.dumps(answer(pendulum, motion))
    if options.out:
        options.out.write_text(line + "\n", encoding="utf-8")
    else:
        sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
