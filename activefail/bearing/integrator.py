"""An error-controlled Rosenbrock method for stiff second-order systems q'' = a(t, q, q').

RODAS (Hairer and Wanner, Solving Ordinary Differential Equations II, 1996, section IV.7): six stages, order 4 with an
embedded order 3, stiffly accurate and L-stable. A velocity stage eliminates its position stage, so that a system of n
coordinates costs one n x n factorisation a step instead of 2n x 2n.

A problem is a NamedTuple of numbers. It says what it computes by overloading `acceleration` and `linearisation` for its
type (numba.extending.overload): compiled code then calls them without indirection, and the compiled result is cached
on disk, which numba does not do for functions that are passed as arguments. (The type of a problem goes into the
index of that cache. One from a script or a test must be kept out of it: other processes cannot import it.)
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from activefail.space import Array


def acceleration(problem, t, q, v, out):
    """Write a(t, q, v) into `out`, shape (n,); to be overloaded for each problem."""
    raise NotImplementedError


def linearisation(problem, t, q, v, by_q, by_v, by_t):
    """Write ∂a/∂q and ∂a/∂v, shapes (n, n), and ∂a/∂t, shape (n,); to be overloaded for each problem."""
    raise NotImplementedError


# RODAS in the transformed variables of its authors' code: stage arguments y + Σ A_ij u_j, couplings C_ij u_j / h.
GAMMA = 0.25
_TIME = np.array([0.0, 0.386, 0.21, 0.63, 1.0, 1.0])
_TIME_DERIVATIVE = np.array([0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0])
_A = np.zeros((6, 6))
_A[1, :1] = [1.544]
_A[2, :2] = [0.9466785280815826, 0.2557011698983284]
_A[3, :3] = [3.314825187068521, 2.896124015972201, 0.9986419139977817]
_A[4, :4] = [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950]
_A[5, :5] = [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0]
_C = np.zeros((6, 6))
_C[1, :1] = [-5.6688]
_C[2, :2] = [-2.430093356833875, -0.2063599157091915]
_C[3, :3] = [-0.1073529058151375, -9.594562251023355, -20.47028614809616]
_C[4, :4] = [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160]
_C[5, :5] = [8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054]
# Dense output of order 3: y(t + s h) = (1 - s) y0 + s (y1 + (1 - s) (Σ D1_j u_j + s Σ D2_j u_j)).
_D1 = np.array([10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662])
_D2 = np.array([-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872])
_STAGES = 6
_ORDER = 4

ACCEPTED, TOO_MANY_STEPS, STEP_UNDERFLOW = 0, 1, 2
"""Status of `advance`."""


class Workspace(NamedTuple):
    """The state of one integration and its scratch arrays, for n coordinates."""

    clock: Array  # (2,): time at the end of the last accepted step, step to try next
    counts: Array  # (3,) int64: attempted steps, rejected steps, evaluations of the acceleration
    q: Array  # (n,) coordinates
    v: Array  # (n,) velocities
    a: Array  # (n,) accelerations at (t, q, v)
    scale: Array  # (2, n) magnitudes of q and v below which errors are absolute
    u_q: Array  # (6, n) stages
    u_v: Array  # (6, n)
    stage_q: Array  # (n,)
    stage_v: Array  # (n,)
    force: Array  # (n,)
    by_q: Array  # (n, n)
    by_v: Array  # (n, n)
    by_t: Array  # (n,)
    matrix: Array  # (n, n) factorised
    pivots: Array  # (n,) int64
    right: Array  # (n,)
    lead: Array  # (n,)


@njit(cache=True)
def workspace(q, v, scale_q, scale_v):
    """A workspace that starts at (q, v); the caller sets the clock and evaluates `a` with `start`."""
    n = q.size
    scale = np.empty((2, n))
    scale[0] = scale_q
    scale[1] = scale_v
    return Workspace(
        np.zeros(2),
        np.zeros(3, dtype=np.int64),
        q.copy(),
        v.copy(),
        np.zeros(n),
        scale,
        np.zeros((_STAGES, n)),
        np.zeros((_STAGES, n)),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(n, dtype=np.int64),
        np.zeros(n),
        np.zeros(n),
    )


@njit(cache=True)
def start(problem, t, step, work):
    """Set the clock and evaluate the acceleration at the start."""
    work.clock[0] = t
    work.clock[1] = step
    acceleration(problem, t, work.q, work.v, work.a)


@njit(cache=True, error_model="numpy")
def _factorise(matrix, pivots):
    """LU factors with partial pivoting, in place; False when the matrix is singular or not finite."""
    n = pivots.size
    for column in range(n):
        best = column
        for row in range(column + 1, n):
            if abs(matrix[row, column]) > abs(matrix[best, column]):
                best = row
        pivots[column] = best
        if best != column:
            for other in range(n):
                matrix[column, other], matrix[best, other] = matrix[best, other], matrix[column, other]
        if not abs(matrix[column, column]) > 0.0:  # also catches NaN
            return False
        inverse = 1.0 / matrix[column, column]
        for row in range(column + 1, n):
            factor = matrix[row, column] * inverse
            matrix[row, column] = factor
            for other in range(column + 1, n):
                matrix[row, other] -= factor * matrix[column, other]
    return True


@njit(cache=True, error_model="numpy")
def _solve(matrix, pivots, x):
    """Solve in place with the factors of `_factorise`."""
    n = pivots.size
    for row in range(n):
        best = pivots[row]
        if best != row:
            x[row], x[best] = x[best], x[row]
    for row in range(1, n):
        total = x[row]
        for other in range(row):
            total -= matrix[row, other] * x[other]
        x[row] = total
    for row in range(n - 1, -1, -1):
        total = x[row]
        for other in range(row + 1, n):
            total -= matrix[row, other] * x[other]
        x[row] = total / matrix[row, row]


@njit(cache=True, error_model="numpy")
def attempt(problem, step, work):
    """One Rosenbrock step from the workspace's state, its end left in `stage_q`, `stage_v`; the linearisation is given.

    Returns whether the linear system could be solved.
    """
    n = work.q.size
    t = work.clock[0]
    inverse = 1.0 / step
    gamma_step = GAMMA * step
    for i in range(n):
        for j in range(n):
            work.matrix[i, j] = -gamma_step * (work.by_v[i, j] + gamma_step * work.by_q[i, j])
        work.matrix[i, i] += 1.0
    if not _factorise(work.matrix, work.pivots):
        return False
    for stage in range(_STAGES):
        if stage == 0:
            for i in range(n):
                work.stage_v[i] = work.v[i]
                work.force[i] = work.a[i]
        else:
            for i in range(n):
                q, v = work.q[i], work.v[i]
                for j in range(stage):
                    q += _A[stage, j] * work.u_q[j, i]
                    v += _A[stage, j] * work.u_v[j, i]
                work.stage_q[i] = q
                work.stage_v[i] = v
            acceleration(problem, t + _TIME[stage] * step, work.stage_q, work.stage_v, work.force)
            work.counts[2] += 1
        for i in range(n):
            lead, right = work.stage_v[i], work.force[i] + _TIME_DERIVATIVE[stage] * step * work.by_t[i]
            for j in range(stage):
                lead += _C[stage, j] * inverse * work.u_q[j, i]
                right += _C[stage, j] * inverse * work.u_v[j, i]
            work.lead[i] = lead
            work.right[i] = right
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += work.by_q[i, j] * work.lead[j]
            work.u_v[stage, i] = gamma_step * (work.right[i] + gamma_step * total)
        _solve(work.matrix, work.pivots, work.u_v[stage])
        for i in range(n):
            work.u_q[stage, i] = gamma_step * (work.lead[i] + work.u_v[stage, i])
    for i in range(n):
        work.stage_q[i] += work.u_q[_STAGES - 1, i]
        work.stage_v[i] += work.u_v[_STAGES - 1, i]
    return True


@njit(cache=True, error_model="numpy")
def _error(work, tolerance):
    """Root mean square of the step's error over tolerance·(scale + |y|); the last stage is the error."""
    n = work.q.size
    total = 0.0
    for i in range(n):
        size = max(abs(work.q[i]), abs(work.stage_q[i]))
        error = work.u_q[_STAGES - 1, i] / (tolerance * (work.scale[0, i] + size))
        total += error * error
        size = max(abs(work.v[i]), abs(work.stage_v[i]))
        error = work.u_v[_STAGES - 1, i] / (tolerance * (work.scale[1, i] + size))
        total += error * error
    return np.sqrt(total / (2 * n))


@njit(cache=True, error_model="numpy")
def middle(work, q, v):
    """Write the state half way through the step just attempted into q and v (dense output of order 3)."""
    for i in range(work.q.size):
        first_q, second_q, first_v, second_v = 0.0, 0.0, 0.0, 0.0
        for j in range(_STAGES - 1):
            first_q += _D1[j] * work.u_q[j, i]
            second_q += _D2[j] * work.u_q[j, i]
            first_v += _D1[j] * work.u_v[j, i]
            second_v += _D2[j] * work.u_v[j, i]
        q[i] = 0.5 * work.q[i] + 0.5 * (work.stage_q[i] + 0.5 * (first_q + 0.5 * second_q))
        v[i] = 0.5 * work.v[i] + 0.5 * (work.stage_v[i] + 0.5 * (first_v + 0.5 * second_v))


@njit(cache=True, error_model="numpy")
def advance(problem, work, tolerance, longest, most, middle_q, middle_v):
    """Make one accepted step of at most `longest` [s], retrying with shorter ones; a status.

    Afterwards the workspace holds the state at the step's end and `middle_q`, `middle_v` that half way. The step to
    try next is in the clock. `most` bounds the attempts of the whole integration.
    """
    n = work.q.size
    linearisation(problem, work.clock[0], work.q, work.v, work.by_q, work.by_v, work.by_t)
    step = min(work.clock[1], longest)
    rejected = False
    while True:
        if work.counts[0] >= most:
            return TOO_MANY_STEPS
        if step < 1e-14 * max(1.0, abs(work.clock[0])):
            return STEP_UNDERFLOW
        work.counts[0] += 1
        error = _error(work, tolerance) if attempt(problem, step, work) else np.inf
        # 0.9: the customary safety factor; the bounds keep one odd error estimate from spoiling the step.
        factor = min(5.0, max(0.2, 0.9 * error ** (-1.0 / _ORDER))) if np.isfinite(error) else 0.1
        if error <= 1.0:
            break
        work.counts[1] += 1
        rejected = True
        step *= factor
    middle(work, middle_q, middle_v)
    for i in range(n):
        work.q[i] = work.stage_q[i]
        work.v[i] = work.stage_v[i]
    work.clock[0] += step
    work.clock[1] = step * (min(factor, 1.0) if rejected else factor)
    acceleration(problem, work.clock[0], work.q, work.v, work.a)
    work.counts[2] += 1
    return ACCEPTED
