"""Speed and correctness of the simulator compared with other integrators of the same equations, on one thread.

All integrate the same equations of motion with the same compiled right-hand side and analytical Jacobian, the same
weights of errors, the same event functions at accepted steps and the same rules for stopping. The longest step is also
the same, except that only activefail shortens it to 10 ms while a plate is off the slider. The outcomes of activefail's
integrator at a tolerance 100 times tighter count as right. SciPy's solvers step in Python, so the times compare what a
user would wait for, and the evaluations of the right-hand side compare the methods. Each runs in its fastest form, by
its solver class and one compiled check at a step's end; LSODA also runs as a user would call it, by solve_ivp with
event functions. Semi-implicit Euler is compiled, and so is LSODA in numbalsoda, which is skipped if it is not installed
(it is built from source: `pip install numbalsoda` with CMake and a Fortran compiler).

    python studies/simulator.py --n 500 --peers 20

    python studies/simulator.py --n 500 --peers 500 --only numbalsoda
    python studies/simulator.py --n 5000 --peers 0     outcomes only
    python studies/simulator.py --settled 20000        is any run ended that would have failed?
    python studies/simulator.py --threads 2            scaling
"""

import time
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numba import carray, cfunc, njit
from scipy.integrate import BDF, LSODA, Radau, solve_ivp
from study import asked, head, timed
from study import line as row_of
from threadpoolctl import threadpool_limits

from activefail.seismic.bearing import TABLE_1, Bearing, Model, Pulse, Tolerance, simulate
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.barrier import Barrier, barrier
from activefail.seismic.bearing.contact import Plate
from activefail.seismic.bearing.dynamics import System, dfp_acceleration, dfp_linearisation, energy, equilibrium, system
from activefail.seismic.bearing.ground import Ricker
from activefail.seismic.bearing.pulse import HALF_DURATION, impulse_to_come
from activefail.seismic.bearing.simulation import FREE_PERIODS, SCALE_Q, SCALE_V, simulate_one
from activefail.seismic.bearing.tuples import axpy

PEERS = (LSODA, BDF, Radau)
PEER_TOLERANCES = (1e-4, 1e-5, 1e-6)
SCALE = np.array([*SCALE_Q, *SCALE_V])
"""Positions [m, rad] and velocities below which errors count as absolute, as ours do."""
EULER_STEPS = (4e-6, 2e-6, 1e-6)
OUTPUT_STEP = 2e-3
"""Times between the states that numbalsoda gives [s]."""
REPEATS = 5


def pack(constants):
    """A system as an array: passing the tuple itself from Python costs a peer more than the right-hand side."""
    return np.array([*constants[:8], *constants.bottom, *constants.top, *constants.motion])


@njit
def _unpack(p):
    bottom = Plate(p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16], p[17], p[18], p[19])
    top = Plate(p[20], p[21], p[22], p[23], p[24], p[25], p[26], p[27], p[28], p[29], p[30], p[31])
    return System(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], bottom, top, Ricker(p[32], p[33]))


@njit
def _halves(y):
    return (y[0], y[1], y[2], y[3], y[4]), (y[5], y[6], y[7], y[8], y[9])


@njit(error_model="numpy")
def slope(t, y, p):
    """The first-order form of the equations of motion, shape (10,)."""
    q, v = _halves(y)
    a = dfp_acceleration(_unpack(p), t, q, v)
    return np.array([v[0], v[1], v[2], v[3], v[4], a[0], a[1], a[2], a[3], a[4]])


@njit(error_model="numpy")
def jacobian(t, y, p):
    """Its derivative by y, shape (10, 10)."""
    out = np.zeros((10, 10))
    q, v = _halves(y)
    _, by_q, by_v, _ = dfp_linearisation(_unpack(p), t, q, v)
    for i in range(5):
        out[i, 5 + i] = 1.0
    out[5:, :5] = np.array(by_q)
    out[5:, 5:] = np.array(by_v)
    return out


@njit(error_model="numpy")
def look(t, y, p):
    """Whether a rim is touched, the cause of failure if any, and the stored energy [J]."""
    constants = _unpack(p)
    q, v = _halves(y)
    seen = o.observe(constants, q, v)
    return seen.touch > 0.0, o.failure_cause(seen, constants, True), energy(constants, t, q, v).stored


@njit(error_model="numpy")
def settled(t, touched, stored, constants, levels):
    """Whether the outcome is settled, as in `activefail.seismic.bearing.simulation`."""
    if not touched and t <= HALF_DURATION * constants.motion.period:
        return False
    reach = levels.failure if touched else min(levels.touch, levels.failure)
    growth = np.sqrt(0.5 * (constants.plate_mass + constants.slider_mass))
    pushed = growth * impulse_to_come(t, constants.motion.amplitude, constants.motion.period)
    return np.sqrt(max(0.0, stored - levels.least)) + pushed < np.sqrt(reach - levels.least)


@njit(error_model="numpy")
def euler(constants, q, v, end, step, levels):
    """Label by semi-implicit Euler with a fixed step, and the steps; events are checked every 0.5 ms."""
    t, touched = -HALF_DURATION * constants.motion.period, False
    steps, every = 0, max(1, round(5e-4 / step))
    while t < end:
        a = dfp_acceleration(constants, t, q, v)
        v = axpy(step, a, v)
        q = axpy(step, v, q)
        t += step
        steps += 1
        if steps % every == 0:
            seen = o.observe(constants, q, v)
            stored = energy(constants, t, q, v).stored
            touched = touched or seen.touch > 0.0
            if not np.isfinite(stored):
                return o.NUMERICAL_FAILURE, steps
            if o.failure_cause(seen, constants, True) != o.NONE:
                return (o.FAILURE if touched else o.NUMERICAL_FAILURE), steps
            if settled(t, touched, stored, constants, levels):
                break
    return (o.IMPACT if touched else o.NO_IMPACT), steps


class Answer(NamedTuple):
    """A peer's answer for one design; NaN for what it does not count."""

    outcome: int
    seconds: float
    steps: float
    evaluations: float
    jacobians: float


def problem(row):
    """A design's constants, energy levels and end time."""
    constants = system(Bearing.from_row(row.tolist(), 0.30), Pulse.from_table(*row[7:].tolist()), Model())
    return constants, barrier(constants, True), HALF_DURATION * constants.motion.period + FREE_PERIODS * float(row[0])


def solve(solver, row, relative):
    """One design by one of SciPy's solvers, by the rules of `activefail.seismic.bearing.simulation`."""
    began = time.process_time()
    constants, levels, end = problem(row)
    p = pack(constants)
    stepper = solver(
        lambda t, y: slope(t, y, p),
        -HALF_DURATION * constants.motion.period,
        np.array([*equilibrium(constants), 0.0, 0.0, 0.0, 0.0, 0.0]),
        end,
        first_step=1e-3 * constants.motion.period,
        max_step=min(Tolerance().longest_step, 0.1 * constants.motion.period),
        rtol=relative,
        atol=relative * SCALE,
        jac=lambda t, y: jacobian(t, y, p),
    )
    outcome, steps = o.NO_IMPACT, 0
    while stepper.status == "running":
        stepper.step()
        if stepper.status == "failed":
            outcome = o.NUMERICAL_FAILURE
            break
        steps += 1
        touched, cause, stored = look(stepper.t, stepper.y, p)
        if touched:
            outcome = max(outcome, o.IMPACT)
        if cause != o.NONE:
            outcome = o.FAILURE if outcome == o.IMPACT else o.NUMERICAL_FAILURE
            break
        if settled(stepper.t, outcome == o.IMPACT, stored, constants, levels):
            break
    return Answer(outcome, time.process_time() - began, steps, stepper.nfev, stepper.njev)


@njit(error_model="numpy")
def events(t, y, p, touched, levels):
    """The event functions for solve_ivp: touch, escape, loss of confinement, overturning, a settled outcome."""
    constants = _unpack(p)
    q, v = _halves(y)
    seen = o.observe(constants, q, v)
    stored = energy(constants, t, q, v).stored
    done = settled(t, touched, stored, constants, Barrier(levels[0], levels[1], levels[2]))
    gap, tilt = seen.confinement_gap - constants.rim_height, seen.tilt - constants.tilt_limit
    return max(seen.touch, -1.0), max(seen.escape, -1.0), gap, tilt, 1.0 if done else -1.0


def solve_by_solve_ivp(derivative, row, relative):
    """One design by LSODA as a user would call it: one call of solve_ivp, with the compiled functions of `solve`.

    `derivative`: whether it uses the analytical Jacobian or finite differences.

    One event function for each way in which a run ends, and one for the touch, after which another energy settles the
    outcome. solve_ivp calls each at the end of every step and refines the roots.
    """
    began = time.process_time()
    constants, levels, end = problem(row)
    p, barriers, touched = pack(constants), np.array(levels), False

    def event(place):
        def function(t, y):
            nonlocal touched
            values = events(t, y, p, touched, barriers)
            touched = touched or values[0] > 0.0
            return float(values[place])

        function.terminal, function.direction = place > 0, 1.0
        return function

    path = solve_ivp(
        lambda t, y: slope(t, y, p),
        (-HALF_DURATION * constants.motion.period, end),
        np.array([*equilibrium(constants), 0.0, 0.0, 0.0, 0.0, 0.0]),
        method="LSODA",
        events=[event(place) for place in range(5)],
        first_step=1e-3 * constants.motion.period,
        max_step=min(Tolerance().longest_step, 0.1 * constants.motion.period),
        rtol=relative,
        atol=relative * SCALE,
        **({"jac": lambda t, y: jacobian(t, y, p)} if derivative else {}),
    )
    failed = any(len(times) for times in path.t_events[1:4])
    outcome = o.FAILURE if failed else o.IMPACT if touched else o.NO_IMPACT
    if path.status < 0 or (failed and not touched):
        outcome = o.NUMERICAL_FAILURE
    return Answer(outcome, time.process_time() - began, len(path.t) - 1, path.nfev, path.njev)


def numbalsoda_solver():
    """A function that solves one design with numbalsoda; None if it is not installed.

    It integrates to given times, without a Jacobian, a bound on its steps or events. It therefore gets an end time,
    0.1 s after the end of our run, which is not timed. Events are detected in the states every `OUTPUT_STEP`. The
    state is in units of `SCALE`, for it takes one absolute tolerance for all coordinates.
    """
    try:
        from numbalsoda import lsoda, lsoda_sig
    except ImportError:
        return None
    scale = SCALE

    @cfunc(lsoda_sig)
    def scaled_slope(t, y, dy, data):
        p = carray(data, 26)
        p[25] += 1.0
        at = carray(y, 10)
        q = (at[0] * scale[0], at[1] * scale[1], at[2] * scale[2], at[3] * scale[3], at[4] * scale[4])
        v = (at[5] * scale[5], at[6] * scale[6], at[7] * scale[7], at[8] * scale[8], at[9] * scale[9])
        a = dfp_acceleration(_unpack(p), t, q, v)
        out = carray(dy, 10)
        for i in range(5):
            out[i] = v[i] / scale[i]
            out[5 + i] = a[i] / scale[5 + i]

    address = scaled_slope.address

    @njit(error_model="numpy")
    def run(p, y, times, relative):
        states, success = lsoda(address, y / scale, times, data=p, rtol=relative, atol=relative, mxstep=100_000)
        if not success:
            return o.NUMERICAL_FAILURE
        outcome = o.NO_IMPACT
        for i in range(len(times)):
            touched, cause, _ = look(times[i], states[i] * scale, p)
            if touched:
                outcome = o.IMPACT
            if cause != o.NONE:
                return o.FAILURE if outcome == o.IMPACT else o.NUMERICAL_FAILURE
        return outcome

    def solve_row(row, relative):
        end = float(simulate(row[None, :], threads=1).margin("end_time")[0]) + 0.1
        began = time.process_time()
        constants, _, _ = problem(row)
        p = np.array([*pack(constants), 0.0])
        y = np.array([*equilibrium(constants), 0.0, 0.0, 0.0, 0.0, 0.0])
        times = np.arange(-HALF_DURATION * constants.motion.period, end, OUTPUT_STEP)
        outcome = run(p, y, times, relative)
        return Answer(outcome, time.process_time() - began, np.nan, p[25], np.nan)

    return solve_row


def solve_by_euler(row, step):
    """One design by semi-implicit Euler."""
    constants, levels, end = problem(row)
    began = time.process_time()
    outcome, steps = euler(constants, equilibrium(constants), (0.0, 0.0, 0.0, 0.0, 0.0), end, step, levels)
    return Answer(outcome, time.process_time() - began, steps, steps, 0)


def least_of(repeats, X, tolerance):
    """Responses with the minimum wall time of each row, and the minimum total processor time [s].

    Other programs on the machine can only add to the times.
    """
    runs, processor = zip(
        *(timed(lambda: simulate(X, tolerance=tolerance, threads=1)) for _ in range(repeats)), strict=True
    )
    return replace(runs[0], seconds=np.min([run.seconds for run in runs], axis=0)), min(processor)


def print_ours(X, tolerance):
    """Simulate and print; the outcomes at a tolerance 100 times tighter."""
    ours, processor = least_of(REPEATS, X, tolerance)
    tight = simulate(X, tolerance=Tolerance(relative=tolerance.relative / 100.0), threads=1)
    print(f"activefail, rtol {tolerance.relative:g}: {len(X)} designs of Table 1, one thread")
    head("outcome", "share", "ms mean", "slowest", "steps", "rejected", "rhs")
    for name in ("all", *o.OUTCOME_NAMES):
        rows = np.full(len(X), True) if name == "all" else ours.outcome_name == name
        if rows.any():
            ms = 1e3 * ours.seconds[rows]
            counts = (ours.statistic(column)[rows].mean() for column in ("steps", "rejected_steps", "evaluations"))
            times = f"{ms.mean():.2f}", f"{ms.max():.2f}"
            row_of(name, f"{rows.mean():.1%}", *times, *(f"{count:.0f}" for count in counts))
    print(f"processor time, with all that is done in Python: {1e3 * processor / len(X):.2f} ms a design")
    print(f"outcomes equal at a tolerance 100 times tighter: {(ours.outcome == tight.outcome).sum()} of {len(X)}")
    print(f"largest energy error: {ours.statistic('energy_error').max():.1e} of the larger of peak work and Mg·1 mm")
    return tight.outcome


def print_peers(X, reference, only):
    """Run the peers, or `only` those, and print their results; looser tolerances first, until outcomes agree."""
    ours, processor = least_of(REPEATS, X, Tolerance())
    accepted = ours.statistic("steps") - ours.statistic("rejected_steps")
    # Ours needs the Jacobian once for every accepted step.
    counts = np.mean([accepted, ours.statistic("evaluations"), accepted], axis=1)
    base, best = np.array([1e3 * processor / len(X), *counts]), []

    def line(name, setting, means, outcomes):
        equal = int((np.array(outcomes) == reference).sum())
        ratios = f"{means[0] / base[0]:.1f}", f"{means[2] / base[2]:.2f}"
        counts = (f"{count:.0f}" for count in means[1:])
        row_of(name, f"{setting:g}", f"{means[0]:.2f}", *counts, f"{equal} of {len(X)}", *ratios)
        return equal == len(X)

    print(
        f"\nThe first {len(X)} of these designs, mean of a design, processor time; outcomes as at the tight tolerance"
    )
    head("solver", "rtol or step", "ms", "accepted", "rhs", "jacobians", "outcomes", "ms/ours", "rhs/ours")
    line("activefail", Tolerance().relative, base, ours.outcome)
    runs = [
        ("solve_ivp", partial(solve_by_solve_ivp, False), PEER_TOLERANCES),
        ("solve_ivp, J", partial(solve_by_solve_ivp, True), PEER_TOLERANCES),
        *((kind.__name__, partial(solve, kind), PEER_TOLERANCES) for kind in PEERS),
        ("Euler", solve_by_euler, EULER_STEPS),
        ("numbalsoda", numbalsoda_solver(), PEER_TOLERANCES),
    ]
    for name, solver, settings in runs:
        if solver is None or (only and name not in only):
            continue
        solver(X[0], settings[0])  # compiled before the clock runs
        for setting in settings:
            answers = [solver(row, setting) for row in X]
            means = np.mean([(1e3 * a.seconds, a.steps, a.evaluations, a.jacobians) for a in answers], axis=0)
            if line(name, setting, means, [answer.outcome for answer in answers]):
                best.append((means[0] / base[0], f"{name} at {setting:g}"))
                break
    print(
        "solve_ivp's method is LSODA. numbalsoda, if it is installed, gets its end time from us: 0.1 s after our run's."
    )
    if best:
        ratio, name = min(best)
        print(f"At equal outcomes ours takes a {ratio:.0f}th of the time of the fastest of these, {name}.")


def print_settled(n):
    """Whether any run that ended with a settled outcome would have reached another one."""
    X = TABLE_1.latin_hypercube(n, np.random.default_rng(n))
    answers = simulate(X)
    rows = np.flatnonzero((answers.outcome == o.NO_IMPACT) | (answers.outcome == o.IMPACT))
    early = changed = 0
    for row in rows:
        bearing, pulse = Bearing.from_row(X[row].tolist(), 0.30), Pulse.from_table(*X[row, 7:].tolist())
        whole = simulate_one(bearing, pulse, to_the_end=True)
        early += whole.margins.end_time > answers.margin("end_time")[row]
        changed += whole.outcome != answers.outcome[row]
    print(f"{n} designs, {len(rows)} that do not fail, {early} ended early; to the end {changed} get another outcome")


def print_scaling(X, threads):
    """Wall time on one thread over that on several: the minimum of five each, in turn."""
    times = np.empty((5, 2))
    for turn in times:
        for place, count in enumerate((1, threads)):
            began = time.perf_counter()
            simulate(X, threads=count)
            turn[place] = time.perf_counter() - began
    alone, together = times.min(axis=0)
    print(f"{len(X)} designs: {alone:.2f} s on one thread, {together:.2f} s on {threads}: {alone / together:.2f}x")


def main():
    options = asked(__doc__, n=500, peers=20, only=[str], seed=0, settled=0, threads=0)
    if options.settled:
        print_settled(options.settled)
        return
    X = TABLE_1.latin_hypercube(options.n, np.random.default_rng(options.seed))
    with threadpool_limits(limits=1):
        simulate(X[:2], threads=1)  # compiled kernels are read from disk or built before the clock runs
        if options.threads:
            print_scaling(X, options.threads)
            return
        reference = print_ours(X, Tolerance())
        if options.peers:
            some = X[: options.peers]
            print_peers(some, reference[: len(some)], options.only)


if __name__ == "__main__":
    main()
