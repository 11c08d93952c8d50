"""An error-controlled Rosenbrock method for stiff second-order systems q'' = a(t, q, q').

RODAS (Hairer and Wanner, Solving Ordinary Differential Equations II, 1996, section IV.7): six stages, order 4 with an
embedded order 3, stiffly accurate and L-stable. A velocity stage eliminates its position stage, so that a system of n
coordinates costs one n x n factorisation a step instead of 2n x 2n.

Coordinates are tuples of n numbers (`tuples`), so that a step lives in registers.

A problem is a NamedTuple of numbers. It says what it computes by overloading `acceleration` and `linearisation` for its
type (numba.extending.overload): compiled code then calls them without indirection, and the compiled result is cached
on disk, which numba does not do for functions that are passed as arguments. (The type of a problem goes into the
index of that cache. One from a script or a test must be kept out of it: other processes cannot import it.)
"""

import math
from typing import NamedTuple

from numba import njit

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

Vector = tuple[float, ...]


def acceleration(problem, t, q, v):
    """a(t, q, v), a vector; to be overloaded for each problem."""
    raise NotImplementedError


def linearisation(problem, t, q, v):
    """a, ∂a/∂q, ∂a/∂v and ∂a/∂t at (t, q, v): vector, two matrices, vector; to be overloaded for each problem."""
    raise NotImplementedError


# RODAS in the transformed variables of its authors' code: stage arguments y + Σ A_j u_j, couplings Σ C_j u_j / h.
GAMMA = 0.25
_DERIVATIVE_1 = 0.25  # weight of h ∂a/∂t in the first stage, which is taken at the step's start


class Stage(NamedTuple):
    """Coefficients of a stage after the first."""

    time: float
    derivative: float
    A: Vector
    C: Vector


_TO_STAGE_5 = (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950)
_STAGE_2 = Stage(0.386, -0.1043, (1.544,), (-5.6688,))
_STAGE_3 = Stage(0.21, 0.1035, (0.9466785280815826, 0.2557011698983284), (-2.430093356833875, -0.2063599157091915))
_STAGE_4 = Stage(
    0.63,
    -0.0362,
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
)
_STAGE_5 = Stage(1.0, 0.0, _TO_STAGE_5, (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160))
_STAGE_6 = Stage(
    1.0,
    0.0,
    (*_TO_STAGE_5, 1.0),
    (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
)
# Dense output of order 3: y(t + s h) = (1 - s) y0 + s (y1 + (1 - s) (Σ D1_j u_j + s Σ D2_j u_j)), here at s = 1/2.
_D1 = (10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662)
_D2 = (-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872)
_MIDDLE = tuple(0.25 * (first + 0.5 * second) for first, second in zip(_D1, _D2, strict=True))
_STAGES = 6

ACCEPTED, TOO_MANY_STEPS, STEP_UNDERFLOW = 0, 1, 2
"""Status of `advance`."""


class Control(NamedTuple):
    """How an integration is controlled."""

    tolerance: float  # relative error per step
    scale_q: Vector  # magnitudes of q and v below which errors are absolute
    scale_v: Vector
    most: int  # bound on the attempts of the whole integration


class State(NamedTuple):
    """Where an integration is, and what it took."""

    t: float  # end of the last accepted step
    step: float  # to try next
    q: Vector
    v: Vector
    attempts: int
    rejections: int
    evaluations: int  # of the acceleration


@njit(cache=True)
def start(t, step, q, v):
    """The state at a start, with the step to try first."""
    return State(t, step, q, v, 0, 0, 0)


class Trial(NamedTuple):
    """The end of a step that was attempted, the estimate of its error, and its middle."""

    q: Vector
    v: Vector
    error_q: Vector
    error_v: Vector
    middle_q: Vector
    middle_v: Vector


@njit(forceinline=True, **KERNEL)
def _couple(step, by_q, factors, lead, right):
    """Solve a stage for its (u_q, u_v) by eliminating u_q."""
    gamma_step = GAMMA * step
    pull = axpy(gamma_step, product(by_q, lead), right)
    u_v = solve(factors, scaled(gamma_step, pull))
    return scaled(gamma_step, axpy(1.0, lead, u_v)), u_v


@njit(forceinline=True, **KERNEL)
def _stage(problem, t, q, v, step, by_q, by_t, factors, stage, us_q, us_v):
    """Arguments of a stage and its (u_q, u_v)."""
    q, v = combination(q, stage.A, us_q), combination(v, stage.A, us_v)
    force = acceleration(problem, t + stage.time * step, q, v)
    inverse = 1.0 / step
    lead = axpy(inverse, weighted(stage.C, us_q), v)
    right = axpy(inverse, weighted(stage.C, us_v), axpy(stage.derivative * step, by_t, force))
    u_q, u_v = _couple(step, by_q, factors, lead, right)
    return q, v, (*us_q, u_q), (*us_v, u_v)


@njit(forceinline=True, **KERNEL)
def attempt(problem, t, q, v, slope, step):
    """One Rosenbrock step from (t, q, v), where `slope` is the linearisation; a `Trial`."""
    a, by_q, by_v, by_t = slope
    gamma_step = GAMMA * step
    factors = factorise(scaled_rows(-gamma_step, axpy_rows(gamma_step, by_q, by_v)))
    u_q, u_v = _couple(step, by_q, factors, v, axpy(_DERIVATIVE_1 * step, by_t, a))
    us_q, us_v = (u_q,), (u_v,)
    _, _, us_q, us_v = _stage(problem, t, q, v, step, by_q, by_t, factors, _STAGE_2, us_q, us_v)
    _, _, us_q, us_v = _stage(problem, t, q, v, step, by_q, by_t, factors, _STAGE_3, us_q, us_v)
    _, _, us_q, us_v = _stage(problem, t, q, v, step, by_q, by_t, factors, _STAGE_4, us_q, us_v)
    _, _, us_q, us_v = _stage(problem, t, q, v, step, by_q, by_t, factors, _STAGE_5, us_q, us_v)
    last_q, last_v, us_q, us_v = _stage(problem, t, q, v, step, by_q, by_t, factors, _STAGE_6, us_q, us_v)
    error_q, error_v = us_q[5], us_v[5]
    end_q, end_v = axpy(1.0, last_q, error_q), axpy(1.0, last_v, error_v)
    middle_q = combination(axpy(0.5, q, scaled(0.5, end_q)), _MIDDLE, us_q[:5])
    middle_v = combination(axpy(0.5, v, scaled(0.5, end_v)), _MIDDLE, us_v[:5])
    return Trial(end_q, end_v, error_q, error_v, middle_q, middle_v)


@njit(cache=True, **KERNEL)
def advance(problem, state, control, longest):
    """Make one accepted step of at most `longest` [s], retrying with shorter ones.

    Returns a status, the state at the step's end and, half way through the step, the coordinates and velocities. The
    state is the one before, apart from what was counted, unless the step was accepted.
    """
    t, q, v = state.t, state.q, state.v
    slope = linearisation(problem, t, q, v)
    step = min(state.step, longest)
    attempts, rejections, evaluations = state.attempts, state.rejections, state.evaluations
    rejected = False
    while True:
        if attempts >= control.most:
            status = TOO_MANY_STEPS
            break
        if step < 1e-14 * max(1.0, abs(t)):
            status = STEP_UNDERFLOW
            break
        trial = attempt(problem, t, q, v, slope, step)
        attempts += 1
        evaluations += _STAGES - 1
        # Root mean square over tolerance·(scale + |y|).
        squares = error_sum(trial.error_q, q, trial.q, control.scale_q)
        squares += error_sum(trial.error_v, v, trial.v, control.scale_v)
        error = math.sqrt(squares / (2 * len(q))) / control.tolerance
        # An estimate of order three: the fourth root. The safety factor is 0.8 for the customary 0.9, and growth
        # threefold at most: fewer steps are rejected where a contact begins.
        factor = min(3.0, max(0.2, 0.8 / math.sqrt(math.sqrt(error)))) if math.isfinite(error) else 0.1
        if error <= 1.0:
            step_next = step * (min(factor, 1.0) if rejected else factor)
            done = State(t + step, step_next, trial.q, trial.v, attempts, rejections, evaluations + 1)
            return ACCEPTED, done, trial.middle_q, trial.middle_v
        rejections += 1
        rejected = True
        step *= factor
    return status, State(t, state.step, q, v, attempts, rejections, evaluations), q, v
