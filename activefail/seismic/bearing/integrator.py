"""Error-controlled Rosenbrock methods for stiff second-order systems q'' = a(t, q, q').

A method is a table of coefficients, a `Tableau`; `step_of` compiles its step. `advance` uses RODAS. Each stage
eliminates its positions, so that n coordinates cost one n x n factorisation per step instead of 2n x 2n.

Coordinates are tuples of n numbers (`tuples`), so that a step stays in registers.

A problem is a NamedTuple of numbers. It defines its equations by overloading `acceleration` and `linearisation` for its
type (numba.extending.overload). Compiled code then calls them directly, and numba caches the result on disk, which it
does not do for functions passed as arguments. (The index of that cache contains the problem's type. A type from a
script or a test must be kept out of it, because other processes cannot import it.)
"""

import math
from typing import NamedTuple

from numba import njit

from activefail.seismic.bearing.kernels import INLINE, KERNEL, kernel
from activefail.seismic.bearing.tuples import (
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
    """a(t, q, v), a vector; overloaded for each problem."""
    raise NotImplementedError


def linearisation(problem, t, q, v):
    """a, ∂a/∂q, ∂a/∂v and ∂a/∂t at (t, q, v): vector, two matrices, vector; overloaded for each problem."""
    raise NotImplementedError


class Tableau(NamedTuple):
    """A Rosenbrock method for y' = f(t, y) with the Jacobian J = ∂f/∂y, in transformed variables u.

    Stage i solves (I/(γh) − J) u_i = f(t + c_i h, y_0 + Σ_j A_ij u_j) + Σ_j C_ij u_j / h + d_i h ∂f/∂t, with sums over
    j < i. The step ends at y_1 = y_0 + Σ_j b_j u_j, and its error is estimated as Σ_j error_j u_j. Within the step
    y(t + θh) = (1 − θ) y_0 + θ (y_1 + (1 − θ) Σ_j (D_1j + θ D_2j + θ² D_3j + ...) u_j), where D is `dense`.

    Source: [HairerWanner1996, section IV.7].
    """

    name: str
    order: int
    error_order: int  # of the embedded method
    gamma: float
    A: tuple[Vector, ...]  # rows of the stages after the first
    C: tuple[Vector, ...]
    b: Vector
    error: Vector
    c: Vector
    d: Vector
    dense: tuple[Vector, ...]

    @property
    def middle(self) -> Vector:
        """Weights w of the dense output at θ = 1/2: (y_0 + y_1)/2 + Σ_j w_j u_j."""
        columns = zip(*self.dense, strict=True)
        return tuple(0.25 * sum(0.5**k * weight for k, weight in enumerate(column)) for column in columns)


_LAST_STAGES = (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950)
RODAS = Tableau(
    name="RODAS",
    order=4,
    error_order=3,
    gamma=0.25,
    A=(
        (1.544,),
        (0.9466785280815826, 0.2557011698983284),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        _LAST_STAGES,
        (*_LAST_STAGES, 1.0),
    ),
    C=(
        (-5.6688,),
        (-2.430093356833875, -0.2063599157091915),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    ),
    b=(*_LAST_STAGES, 1.0, 1.0),
    error=(0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    c=(0.0, 0.386, 0.21, 0.63, 1.0, 1.0),
    d=(0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0),
    dense=(
        (10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662),
        (-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872),
    ),
)
"""The simulator's method: six stages, stiffly accurate, L-stable.

Source: [HairerWanner1996, section IV.7]; digits of the authors' code.
"""

ACCEPTED, TOO_MANY_STEPS, STEP_UNDERFLOW = 0, 1, 2
"""Status of `advance`."""


class Control(NamedTuple):
    """Parameters of the error control."""

    tolerance: float  # relative error per step
    scale_q: Vector  # magnitudes of q and v below which errors are absolute
    scale_v: Vector
    most: int  # most attempts in the whole integration


class State(NamedTuple):
    """The state of an integration, with its counters."""

    t: float  # end of the last accepted step
    step: float  # next step to try
    q: Vector
    v: Vector
    attempts: int
    rejections: int
    evaluations: int  # of the acceleration


@kernel()
def start(t, step, q, v):
    """The initial state, with the first step to try."""
    return State(t, step, q, v, 0, 0, 0)


class Trial(NamedTuple):
    """The end of an attempted step, its error estimate, and its midpoint."""

    q: Vector
    v: Vector
    error_q: Vector
    error_v: Vector
    middle_q: Vector
    middle_v: Vector


@njit(**INLINE)
def _solve_stage(gamma_step, by_q, factors, lead, right):
    """The (u_q, u_v) of a stage, by elimination of u_q."""
    pull = axpy(gamma_step, product(by_q, lead), right)
    u_v = solve(factors, scaled(gamma_step, pull))
    return scaled(gamma_step, axpy(1.0, lead, u_v)), u_v


def _first_stage(d):
    """Compile the first stage, at the start of the step: tuples of its u_q and of its u_v."""

    @njit(**INLINE)
    def stages(problem, t, q, v, slope, step, gamma_step, factors):
        a, by_q, _, by_t = slope
        u_q, u_v = _solve_stage(gamma_step, by_q, factors, v, axpy(d * step, by_t, a))
        return (u_q,), (u_v,)

    return stages


def _then_stage(before, A, C, c, d):
    """Compile the stages `before` and one more: tuples of their u_q and of their u_v."""

    @njit(**INLINE)
    def stages(problem, t, q, v, slope, step, gamma_step, factors):
        us_q, us_v = before(problem, t, q, v, slope, step, gamma_step, factors)
        _, by_q, _, by_t = slope
        at_q, at_v = combination(q, A, us_q), combination(v, A, us_v)
        force = acceleration(problem, t + c * step, at_q, at_v)
        inverse = 1.0 / step
        lead = axpy(inverse, weighted(C, us_q), at_v)
        right = axpy(inverse, weighted(C, us_v), axpy(d * step, by_t, force))
        u_q, u_v = _solve_stage(gamma_step, by_q, factors, lead, right)
        return (*us_q, u_q), (*us_v, u_v)

    return stages


def step_of(tableau):
    """Compile one step of a method: `step_of(tableau)(problem, t, q, v, slope, step)` is a `Trial`.

    The step starts at (t, q, v), where `slope` is the linearisation. The coefficients are compiled in.
    """
    stages = _first_stage(tableau.d[0])
    for A, C, c, d in zip(tableau.A, tableau.C, tableau.c[1:], tableau.d[1:], strict=True):
        stages = _then_stage(stages, A, C, c, d)
    gamma, b, middle = tableau.gamma, tableau.b, tableau.middle
    dense = len(middle)
    # Skip the leading zeros of the error weights.
    first = next(j for j, weight in enumerate(tableau.error) if weight)
    error = tableau.error[first:]

    @njit(**INLINE)
    def attempt(problem, t, q, v, slope, step):
        _, by_q, by_v, _ = slope
        gamma_step = gamma * step
        factors = factorise(scaled_rows(-gamma_step, axpy_rows(gamma_step, by_q, by_v)))
        us_q, us_v = stages(problem, t, q, v, slope, step, gamma_step, factors)
        end_q, end_v = combination(q, b, us_q), combination(v, b, us_v)
        error_q, error_v = weighted(error, us_q[first:]), weighted(error, us_v[first:])
        middle_q = combination(axpy(0.5, q, scaled(0.5, end_q)), middle, us_q[:dense])
        middle_v = combination(axpy(0.5, v, scaled(0.5, end_v)), middle, us_v[:dense])
        return Trial(end_q, end_v, error_q, error_v, middle_q, middle_v)

    return attempt


def root_of(degree):
    """Compile the root of the given degree."""
    if degree == 4:
        # Two square roots are faster than a power.
        return njit(**INLINE)(lambda x: math.sqrt(math.sqrt(x)))
    return njit(**INLINE)(lambda x: x ** (1.0 / degree))


attempt, error_root = step_of(RODAS), root_of(RODAS.error_order + 1)
EVALUATIONS = len(RODAS.c) - 1
"""Evaluations of the acceleration per attempt; the first stage takes it from the linearisation."""


@kernel(**KERNEL)
def advance(problem, state, control, longest):
    """Make one accepted step of at most `longest` [s], retrying with shorter ones.

    Returns a status, the state at the step's end, and the coordinates and velocities at its midpoint. If no step is
    accepted, the state keeps its values except the counters.
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
        evaluations += EVALUATIONS
        # Root mean square over tolerance·(scale + |y|).
        squares = error_sum(trial.error_q, q, trial.q, control.scale_q)
        squares += error_sum(trial.error_v, v, trial.v, control.scale_v)
        error = math.sqrt(squares / (2 * len(q))) / control.tolerance
        # With a safety factor of 0.8, not the usual 0.9, and at most threefold growth, fewer steps are rejected where a
        # contact begins.
        factor = min(3.0, max(0.2, 0.8 / error_root(error))) if math.isfinite(error) else 0.1
        if error <= 1.0:
            step_next = step * (min(factor, 1.0) if rejected else factor)
            done = State(t + step, step_next, trial.q, trial.v, attempts, rejections, evaluations + 1)
            return ACCEPTED, done, trial.middle_q, trial.middle_v
        rejections += 1
        rejected = True
        step *= factor
    return status, State(t, state.step, q, v, attempts, rejections, evaluations), q, v
