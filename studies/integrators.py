"""The simulator with other integrators: steps, time, outcomes and energy errors.

A Rosenbrock method is another tableau for the simulator's own step. A diagonally implicit method has its own attempt of
a step and a copy of the step control. The loop, its events and the weights of errors are the simulator's. The outcomes
of the simulator at a tolerance of 1e-6 count as right. integrators.toml has the coefficients and their sources.

    python studies/integrators.py --n 2000
    python studies/integrators.py --n 5000 --only RODAS4P2 --tolerances 1e-4
"""

import math
import tomllib
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from numba import njit
from study import asked, head, line, timed
from threadpoolctl import threadpool_limits

from activefail.seismic.bearing import TABLE_1, Tolerance, integrator, simulate, simulation
from activefail.seismic.bearing.integrator import (
    ACCEPTED,
    STEP_UNDERFLOW,
    TOO_MANY_STEPS,
    State,
    Tableau,
    acceleration,
    root_of,
    step_of,
)
from activefail.seismic.bearing.kernels import INLINE, KERNEL
from activefail.seismic.bearing.tuples import (
    axpy,
    axpy_rows,
    error_sum,
    factorise,
    scaled,
    scaled_rows,
    solve,
    weighted,
)

NEWTON_SHARE, MOST_ITERATIONS = 0.05, 8
"""Newton's method ends when its error is this share of the tolerance, or fails after this number of iterations."""


class Attempt(NamedTuple):
    """The end of a diagonally implicit method's attempted step, its error, its middle, and its cost."""

    q: Any
    v: Any
    error_q: Any
    error_v: Any
    middle_q: Any
    middle_v: Any
    evaluations: int
    solved: bool


@njit(**INLINE)
def newton(problem, t, base_q, base_v, a, factors, gamma_step, q, v, control):
    """An implicit stage's (q, v, a) from a first guess of a; the evaluations; whether it converged."""
    last, count, done, going = math.inf, 0, False, True
    while going and not done and count < MOST_ITERATIONS:
        at_v = axpy(gamma_step, a, base_v)
        at_q = axpy(gamma_step, at_v, base_q)
        change = solve(factors, axpy(-1.0, a, acceleration(problem, t, at_q, at_v)))
        a = axpy(1.0, change, a)
        change_v = scaled(gamma_step, change)
        squares = error_sum(change_v, v, v, control.scale_v)
        squares += error_sum(scaled(gamma_step, change_v), q, q, control.scale_q)
        size = math.sqrt(squares / (2 * len(q))) / control.tolerance
        rate = size / last if count > 0 else 0.5
        going = math.isfinite(size) and rate < 1.0
        done = going and size * rate / (1.0 - rate) <= NEWTON_SHARE
        last, count = size, count + 1
    at_v = axpy(gamma_step, a, base_v)
    return axpy(gamma_step, at_v, base_q), at_v, a, count, done


def esdirk(gamma, A, error):
    """The attempt of a step by a stiffly accurate diagonally implicit method with an explicit first stage."""
    c = np.round([0.0, *(sum(row) + gamma for row in A)], 12)
    # The middle: the polynomial through the stages, of those at the same time the last.
    nodes = [int(np.flatnonzero(c == at)[-1]) for at in np.unique(c)]
    lagrange = {i: math.prod((0.5 - c[j]) / (c[i] - c[j]) for j in nodes if j != i) for i in nodes}
    middle = tuple(float(lagrange.get(i, 0.0)) for i in range(len(c)))
    last = len(A)

    @njit(**INLINE)
    def stages(problem, t, q, v, slope, step, gamma_step, factors, control):
        return (q,), (v,), (slope[0],), 0, True

    def with_stage(before, time, a):
        @njit(**INLINE)
        def stages(problem, t, q, v, slope, step, gamma_step, factors, control):
            qs, vs, slopes, count, solved = before(problem, t, q, v, slope, step, gamma_step, factors, control)
            at_q, at_v = axpy(step, weighted(a, vs), q), axpy(step, weighted(a, slopes), v)
            rate = slopes[len(slopes) - 1]
            if solved:
                at_q, at_v, rate, iterations, solved = newton(
                    problem, t + time * step, at_q, at_v, rate, factors, gamma_step, q, v, control
                )
                count += iterations
            return (*qs, at_q), (*vs, at_v), (*slopes, rate), count, solved

        return stages

    for time_, row in zip(c[1:].tolist(), A, strict=True):
        stages = with_stage(stages, time_, row)

    @njit(**INLINE)
    def attempt(problem, t, q, v, slope, step, control):
        gamma_step = gamma * step
        factors = factorise(scaled_rows(-gamma_step, axpy_rows(gamma_step, slope[1], slope[2])))
        qs, vs, slopes, count, solved = stages(problem, t, q, v, slope, step, gamma_step, factors, control)
        error_q, error_v = scaled(step, weighted(error, vs)), scaled(step, weighted(error, slopes))
        return Attempt(qs[last], vs[last], error_q, error_v, weighted(middle, qs), weighted(middle, vs), count, solved)

    return attempt


def advancing(attempt, order):
    """`integrator.advance` with an attempt that may not converge, and its error estimate's order."""
    root = root_of(order + 1)

    @njit(**KERNEL)
    def advance(problem, state, control, longest):
        t, q, v = state.t, state.q, state.v
        slope = integrator.linearisation(problem, t, q, v)
        step, rejected = min(state.step, longest), False
        attempts, rejections, evaluations = state.attempts, state.rejections, state.evaluations
        while attempts < control.most and step >= 1e-14 * max(1.0, abs(t)):
            trial = attempt(problem, t, q, v, slope, step, control)
            attempts += 1
            evaluations += trial.evaluations
            squares = error_sum(trial.error_q, q, trial.q, control.scale_q)
            squares += error_sum(trial.error_v, v, trial.v, control.scale_v)
            error = math.sqrt(squares / (2 * len(q))) / control.tolerance if trial.solved else math.inf
            factor = min(3.0, max(0.2, 0.8 / root(error))) if math.isfinite(error) else 0.1 if trial.solved else 0.3
            if error <= 1.0:
                step_next = step * (min(factor, 1.0) if rejected else factor)
                done = State(t + step, step_next, trial.q, trial.v, attempts, rejections, evaluations + 1)
                return ACCEPTED, done, trial.middle_q, trial.middle_v
            rejections += 1
            rejected = True
            step *= factor
        status = TOO_MANY_STEPS if attempts >= control.most else STEP_UNDERFLOW
        return status, State(t, state.step, q, v, attempts, rejections, evaluations), q, v

    return advance


def recompiled(kernel: Any, **changed: Any) -> FunctionType:
    """A kernel's Python function with other globals, to be recompiled."""
    function = kernel.py_func
    return FunctionType(function.__code__, {**function.__globals__, **changed})


def rosenbrock(tableau: Tableau) -> Any:
    """`integrator.advance` with another tableau."""
    changed = {
        "attempt": step_of(tableau),
        "error_root": root_of(tableau.error_order + 1),
        "EVALUATIONS": len(tableau.c) - 1,
    }
    return njit(**KERNEL)(recompiled(integrator.advance, **changed))


def measure(name, run, X, relative, reference):
    """Simulate all designs with a kernel in place of activefail's, and print its cost."""
    with patch.object(simulation, "integrate", run):
        simulate(X[:1], threads=1)  # compiled before the clock runs
        answers, seconds = timed(lambda: simulate(X, tolerance=Tolerance(relative=relative), threads=1))
    counts = (f"{answers.statistic(c).mean():.0f}" for c in ("steps", "rejected_steps", "evaluations"))
    energy = answers.statistic("energy_error")[answers.outcome >= 0]
    errors = (f"{error:.1e}" for error in np.quantile(energy, (0.5, 0.99, 1.0)))
    equal = f"{(answers.outcome == reference.outcome).sum()} of {len(X)}"
    line(name, f"{relative:g}", *counts, f"{1e3 * seconds / len(X):.2f}", equal, *errors)


def frozen(value):
    """Lists as tuples, which compiled code takes as constants."""
    return tuple(map(frozen, value)) if isinstance(value, list) else value


def kernel_of(name, method):
    """The simulator's kernel with another method."""
    if "C" in method:
        advance = rosenbrock(Tableau(name=name, **method))
    else:
        advance = advancing(esdirk(method["gamma"], method["A"], method["error"]), method["error_order"])
    return njit(nogil=True, **KERNEL)(recompiled(simulation.integrate, advance=advance))


def main():
    methods = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    options = asked(__doc__, n=2000, only=list(methods), tolerances=[3e-4, 1e-4, 3e-5])
    X = TABLE_1.latin_hypercube(options.n, np.random.default_rng(0))
    with threadpool_limits(limits=1):
        reference = simulate(X, tolerance=Tolerance(relative=1e-6), threads=1)
        head("", "rtol", "steps", "rejected", "rhs", "ms", "outcomes", "energy error: median", "99 %", "largest")
        for relative in options.tolerances:
            measure("activefail", simulation.integrate, X, relative, reference)
        for name in options.only:
            run = kernel_of(name, {key: frozen(value) for key, value in methods[name].items()})
            for relative in options.tolerances:
                measure(name, run, X, relative, reference)


if __name__ == "__main__":
    main()
