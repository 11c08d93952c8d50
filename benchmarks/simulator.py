"""Speed and correctness of the simulator beside SciPy's stiff solvers, in one run and on one thread.

All solve the same equations of motion with the same compiled right-hand side and analytical Jacobian, weigh errors
alike (5 cm, 0.5 m/s), check the same event functions at accepted steps and stop by the same rules. The longest step is
ours, except that ours shortens it to 10 ms while a plate is off the slider, which the peers are spared. What a label
should be is said by our integrator at a tolerance 100 times tighter. SciPy's solvers step in Python, so the times
compare what a user would wait for; the evaluations of the right-hand side compare the methods.

    python benchmarks/simulator.py --n 500 --peers 30
"""

import argparse
import time
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import LSODA, OdeSolver, Radau
from threadpoolctl import threadpool_limits

from activefail.bearing import TABLE_1, Bearing, Model, Pulse, Responses, Tolerance, simulate
from activefail.bearing import outcome as o
from activefail.bearing.contact import Plate
from activefail.bearing.design import GRAVITY
from activefail.bearing.dynamics import System, dfp_acceleration, dfp_linearisation, energy, equilibrium, system
from activefail.bearing.pulse import HALF_DURATION
from activefail.bearing.simulation import FREE_PERIODS
from activefail.space import Array

PEERS: tuple[type[OdeSolver], ...] = (LSODA, Radau)
PEER_TOLERANCES = (1e-4, 1e-5, 1e-6)
SCALE = np.repeat([0.05, 0.5], 5)
"""Positions [m, rad] and velocities below which errors count as absolute, as ours do."""


def pack(constants: System) -> Array:
    """A system as an array: passing the tuple itself from Python costs a peer more than the right-hand side."""
    return np.array([*constants[:6], *constants.bottom, *constants.top, constants.amplitude, constants.period])


@njit
def _unpack(p):
    bottom = Plate(p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13])
    top = Plate(p[14], p[15], p[16], p[17], p[18], p[19], p[20], p[21])
    return System(p[0], p[1], p[2], p[3], p[4], p[5], bottom, top, p[22], p[23])


@njit(error_model="numpy")
def slope(t, y, p):
    """The first-order form of the equations of motion, shape (10,)."""
    out = np.empty(10)
    out[:5] = y[5:]
    dfp_acceleration(_unpack(p), t, y[:5], y[5:], out[5:])
    return out


@njit(error_model="numpy")
def jacobian(t, y, p):
    """Its derivative by y, shape (10, 10)."""
    out = np.zeros((10, 10))
    by_q, by_v, by_t = np.empty((5, 5)), np.empty((5, 5)), np.empty(5)
    dfp_linearisation(_unpack(p), t, y[:5], y[5:], by_q, by_v, by_t)
    for i in range(5):
        out[i, 5 + i] = 1.0
    out[5:, :5] = by_q
    out[5:, 5:] = by_v
    return out


@njit(error_model="numpy")
def look(t, y, p):
    """Whether a rim is touched, the cause of failure or none, and the stored energy [J]."""
    constants = _unpack(p)
    seen = o.observe(constants, y[:5], y[5:])
    return seen.touch > 0.0, o.failure_cause(seen, constants, True), energy(constants, t, y[:5], y[5:]).stored


class Answer(NamedTuple):
    """What a peer gave for one design."""

    label: int
    seconds: float
    steps: int
    evaluations: int
    jacobians: int


def solve(solver: type[OdeSolver], row: Array, relative: float) -> Answer:
    """One design by one of SciPy's solvers, by the rules of `activefail.bearing.simulation`."""
    began = time.perf_counter()
    bearing, pulse = Bearing.from_table(*row[:7]), Pulse(row[7], row[8] * GRAVITY)
    constants = system(bearing, pulse, Model())
    p = pack(constants)
    rest = np.concatenate([equilibrium(constants), np.zeros(5)])
    pulse_end = HALF_DURATION * pulse.period
    stepper = solver(
        lambda t, y: slope(t, y, p),
        -pulse_end,
        rest,
        pulse_end + FREE_PERIODS * row[0],
        first_step=1e-3 * pulse.period,
        max_step=min(Tolerance().longest_step, 0.1 * pulse.period),
        rtol=relative,
        atol=relative * SCALE,
        jac=lambda t, y: jacobian(t, y, p),
    )
    radius, capacity = bearing.radius, bearing.displacement_capacity
    reach = bearing.plate_mass * GRAVITY * (radius - np.sqrt(radius**2 - 0.25 * capacity**2))
    at_rest = look(-pulse_end, rest, p)[2]
    label, steps = o.NO_IMPACT, 0
    while stepper.status == "running":
        stepper.step()
        if stepper.status == "failed":
            label = o.NUMERICAL_FAILURE
            break
        steps += 1
        touched, cause, stored = look(stepper.t, stepper.y, p)
        if touched:
            label = max(label, o.IMPACT)
        if cause != o.NONE:
            label = o.FAILURE if label == o.IMPACT else o.NUMERICAL_FAILURE
            break
        if stepper.t > pulse_end and stored - at_rest < reach:
            break
    return Answer(label, time.perf_counter() - began, steps, stepper.nfev, stepper.njev)


def print_ours(X: Array, tolerance: Tolerance) -> NDArray[np.int8]:
    """Simulate and print; the labels at a tolerance 100 times tighter."""
    ours = simulate(X, tolerance=tolerance, threads=1)
    tight = simulate(X, tolerance=Tolerance(relative=tolerance.relative / 100.0), threads=1)
    ms = 1e3 * ours.seconds
    print(f"activefail, rtol {tolerance.relative:g}: {len(X)} designs of Table 1, one thread")
    print(f"  {'outcome':<18}{'share':>8}{'ms mean':>10}{'slowest':>10}{'steps':>10}{'rejected':>10}{'rhs':>10}")
    names = [*o.OUTCOMES, "numerical_failure"]
    for name, rows in [("all", np.full(len(X), True)), *((name, ours.outcome == name) for name in names)]:
        if rows.any():
            counts = (ours.margin(column)[rows].mean() for column in ("steps", "rejected_steps", "evaluations"))
            print(
                f"  {name:<18}{rows.mean():>8.1%}{ms[rows].mean():>10.2f}{ms[rows].max():>10.2f}"
                + "".join(f"{count:>10.0f}" for count in counts)
            )
    print(f"  labels equal at a tolerance 100 times tighter: {(ours.label == tight.label).sum()} of {len(X)}")
    print(f"  largest energy error: {ours.margin('energy_error').max():.1e} of the larger of peak work and Mg·1 mm")
    return tight.label


def print_peers(X: Array, ours: Responses, reference: NDArray[np.int8]) -> None:
    """Run SciPy's solvers on the designs and print them beside ours; looser tolerances first, until labels agree."""

    def line(name: str, relative: float, means: Array, equal: int, base: Array) -> None:
        counts = "".join(f"{count:>10.0f}" for count in means[1:])
        ratios = f"{means[0] / base[0]:>9.1f}x{means[2] / base[2]:>9.2f}x"
        print(f"  {name:<12}{relative:>8g}{means[0]:>10.2f}{counts}{f'{equal} of {len(X)}':>12}{ratios}")

    accepted = ours.margin("steps") - ours.margin("rejected_steps")
    # Ours needs the Jacobian once for every accepted step.
    columns = (1e3 * ours.seconds, accepted, ours.margin("evaluations"), accepted)
    base = np.mean(columns, axis=1)
    print(f"\nThe first {len(X)} of these designs, mean of a design; labels: equal to those of the tight tolerance")
    print(
        f"  {'solver':<12}{'rtol':>8}{'ms':>10}{'accepted':>10}{'rhs':>10}{'jacobians':>10}{'labels':>12}"
        f"{'ms/ours':>10}{'rhs/ours':>10}"
    )
    line("activefail", Tolerance().relative, base, int((ours.label == reference).sum()), base)
    for solver in PEERS:
        for relative in PEER_TOLERANCES:
            answers = [solve(solver, row, relative) for row in X]
            equal = sum(answer.label == label for answer, label in zip(answers, reference, strict=True))
            means = np.mean([(1e3 * a.seconds, a.steps, a.evaluations, a.jacobians) for a in answers], axis=0)
            line(solver.__name__, relative, means, equal, base)
            if equal == len(X):
                break
        else:
            print(f"  {solver.__name__} does not give all labels at any of these tolerances")


def main() -> None:
    parser = argparse.ArgumentParser(description="The simulator's speed beside SciPy's LSODA and Radau.")
    parser.add_argument("--n", type=int, default=500, help="designs of Table 1 for ours")
    parser.add_argument("--peers", type=int, default=30, help="how many of them for SciPy's solvers; 0: none")
    parser.add_argument("--seed", type=int, default=0, help="of the Latin hypercube")
    arguments = parser.parse_args()

    X = TABLE_1.latin_hypercube(arguments.n, np.random.default_rng(arguments.seed))
    with threadpool_limits(limits=1):
        # Compiled kernels are read from disk or built before the clock runs.
        simulate(X[:2], threads=1)
        reference = print_ours(X, Tolerance())
        some = X[: arguments.peers]
        if len(some):
            for solver in PEERS:
                solve(solver, X[0], 1e-2)
            print_peers(some, simulate(some, threads=1), reference[: len(some)])


if __name__ == "__main__":
    main()
