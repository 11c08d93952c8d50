"""The simulator with other integrators in the place of its own: steps, time, labels and energy errors.

A method brings only the attempt of a step. The loop with its events, the weights of errors and the control of the step
are the product's, with the root that belongs to the order of the method's error estimate. What a label should be is
said by the product at a tolerance of 1e-6. Coefficients and their sources: integrators.toml.

    python benchmarks/integrators.py --n 2000
    python benchmarks/integrators.py --n 5000 --only RODAS4P2 --tolerances 1e-4
"""

import argparse
import math
import time
import tomllib
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from numba import njit
from threadpoolctl import threadpool_limits

from activefail.bearing import TABLE_1, Responses, Tolerance, integrator, simulate, simulation
from activefail.bearing.integrator import ACCEPTED, STEP_UNDERFLOW, TOO_MANY_STEPS, State, acceleration
from activefail.bearing.kernels import KERNEL
from activefail.bearing.tuples import (
    axpy,
    axpy_rows,
    combination,
    error_sum,
    factorise,
    product,
    scaled,
    scaled_rows,
    solve,
    weighted,
)
from activefail.space import Array

INLINE = {"forceinline": True, **KERNEL}
NEWTON_SHARE, MOST_ITERATIONS = 0.05, 8
"""Newton's method is done when its error is this share of the tolerance; it is given up after so many iterations."""


class Attempt(NamedTuple):
    """The end of an attempted step, its error, its middle, and what it took."""

    q: Any
    v: Any
    error_q: Any
    error_v: Any
    middle_q: Any
    middle_v: Any
    evaluations: int
    solved: bool


@njit(**INLINE)
def couple(gamma_step, by_q, factors, lead, right):
    """A Rosenbrock stage's (u_q, u_v), as in `activefail.bearing.integrator`."""
    pull = axpy(gamma_step, product(by_q, lead), right)
    u_v = solve(factors, scaled(gamma_step, pull))
    return scaled(gamma_step, axpy(1.0, lead, u_v)), u_v


def rosenbrock(gamma, derivative, time, A, C, dense):
    """The attempt of a step by a stiffly accurate Rosenbrock method whose last stage is its error."""
    first, last = derivative[0], len(C)
    # y(t + h/2) = (y0 + y1)/2 + Σ middle_j u_j
    middle = tuple(0.25 * sum(0.5**i * row[j] for i, row in enumerate(dense)) for j in range(len(dense[0])))
    kept = len(middle)

    @njit(**INLINE)
    def stages(problem, t, q, v, slope, step, gamma_step, factors):
        u_q, u_v = couple(gamma_step, slope[1], factors, v, axpy(first * step, slope[3], slope[0]))
        return q, v, (u_q,), (u_v,)

    def with_stage(before, time, derivative, a, c):
        @njit(**INLINE)
        def stages(problem, t, q, v, slope, step, gamma_step, factors):
            _, _, us_q, us_v = before(problem, t, q, v, slope, step, gamma_step, factors)
            at_q, at_v = combination(q, a, us_q), combination(v, a, us_v)
            force = acceleration(problem, t + time * step, at_q, at_v)
            lead = axpy(1.0 / step, weighted(c, us_q), at_v)
            right = axpy(1.0 / step, weighted(c, us_v), axpy(derivative * step, slope[3], force))
            u_q, u_v = couple(gamma_step, slope[1], factors, lead, right)
            return at_q, at_v, (*us_q, u_q), (*us_v, u_v)

        return stages

    for stage in zip(time[1:], derivative[1:], A, C, strict=True):
        stages = with_stage(stages, *stage)

    @njit(**INLINE)
    def attempt(problem, t, q, v, slope, step, control):
        gamma_step = gamma * step
        factors = factorise(scaled_rows(-gamma_step, axpy_rows(gamma_step, slope[1], slope[2])))
        last_q, last_v, us_q, us_v = stages(problem, t, q, v, slope, step, gamma_step, factors)
        end_q, end_v = axpy(1.0, last_q, us_q[last]), axpy(1.0, last_v, us_v[last])
        middle_q = combination(axpy(0.5, q, scaled(0.5, end_q)), middle, us_q[:kept])
        middle_v = combination(axpy(0.5, v, scaled(0.5, end_v)), middle, us_v[:kept])
        return Attempt(end_q, end_v, us_q[last], us_v[last], middle_q, middle_v, last, True)

    return attempt


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
            at_q, at_v, rate = (
                axpy(step, weighted(a, vs), q),
                axpy(step, weighted(a, slopes), v),
                slopes[len(slopes) - 1],
            )
            if solved:
                at_q, at_v, rate, more, solved = newton(
                    problem, t + time * step, at_q, at_v, rate, factors, gamma_step, q, v, control
                )
                count += more
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
    """`activefail.bearing.integrator.advance` with another attempt, whose error estimate is of the given order."""

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
            root = math.sqrt(math.sqrt(error)) if order == 3 else error ** (1.0 / (order + 1))
            factor = min(3.0, max(0.2, 0.8 / root)) if math.isfinite(error) else 0.1 if trial.solved else 0.3
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


def measure(name: str, run: Any, X: Array, relative: float, reference: Responses) -> None:
    """Simulate all designs by a kernel in the place of the product's, and print what it took."""
    with patch.object(simulation, "_run", run):
        simulate(X[:1], threads=1)  # compiled before the clock runs
        began = time.process_time()
        answers = simulate(X, tolerance=Tolerance(relative=relative), threads=1)
        ms = 1e3 * (time.process_time() - began) / len(X)
    counts = "".join(f"{answers.margin(c).mean():>9.0f}" for c in ("steps", "rejected_steps", "evaluations"))
    energy = answers.margin("energy_error")[answers.label >= 0]
    errors = "".join(f"{error:>9.1e}" for error in np.quantile(energy, (0.5, 0.99, 1.0)))
    equal = f"{(answers.label == reference.label).sum()} of {len(X)}"
    print(f"{name:<14}{relative:>8g}{counts}{ms:>8.2f}{equal:>14}{errors}", flush=True)


def main() -> None:
    methods = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description="The simulator with other integrators.")
    parser.add_argument("--n", type=int, default=2000, help="designs of Table 1")
    parser.add_argument("--only", nargs="+", default=list(methods), choices=list(methods), help="some of the methods")
    parser.add_argument("--tolerances", nargs="+", type=float, default=[3e-4, 1e-4, 3e-5])
    arguments = parser.parse_args()
    X = TABLE_1.latin_hypercube(arguments.n, np.random.default_rng(0))
    with threadpool_limits(limits=1):
        reference = simulate(X, tolerance=Tolerance(relative=1e-6), threads=1)
        heads = "".join(f"{head:>9}" for head in ("steps", "rejected", "rhs"))
        print(f"{'':<14}{'rtol':>8}{heads}{'ms':>8}{'labels':>14}   energy error: median, 99 %, largest")
        for relative in arguments.tolerances:
            measure("activefail", simulation._run, X, relative, reference)
        for name in arguments.only:
            method = {key: frozen(value) for key, value in methods[name].items()}
            order = method.pop("order")
            advance = advancing((rosenbrock if "C" in method else esdirk)(**method), order)
            # The product's loop, compiled anew around another `advance`.
            loop = simulation._run.py_func
            run = njit(nogil=True, **KERNEL)(FunctionType(loop.__code__, {**loop.__globals__, "advance": advance}))
            for relative in arguments.tolerances:
                measure(name, run, X, relative, reference)


def frozen(value: Any) -> Any:
    """Lists as tuples, which compiled code takes as constants."""
    return tuple(map(frozen, value)) if isinstance(value, list) else value


if __name__ == "__main__":
    main()
