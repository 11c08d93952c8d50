"""The Rosenbrock methods: their tables, and problems of which the answer is known, apart from any bearing."""

import math
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from cases import some_of
from numba import njit
from numba.core.caching import NullCache
from numba.extending import overload
from scipy.integrate import solve_ivp

from activefail.seismic.bearing import integrator
from activefail.seismic.bearing.integrator import (
    ACCEPTED,
    RODAS,
    STEP_UNDERFLOW,
    TOO_MANY_STEPS,
    Control,
    State,
    Tableau,
    advance,
    start,
    step_of,
)
from activefail.space.space import Array

UNLIMITED = 10**9


class Springs(NamedTuple):
    """Two springs seen from coordinates that mix them: q'' = −K q − C q' with modes (1, 1) and (1, −1)."""

    slow: float  # ω² of the mode (1, 1) [1/s²]
    fast: float  # ω² of the mode (1, −1) [1/s²]
    slow_damping: float  # 2 ζ ω [1/s]
    fast_damping: float


class Oscillator(NamedTuple):
    """q'' = (swing (1 − q²) − damping) q' − linear q − cubic q³ + push cos(frequency t), and NaN beyond a wall.

    One type for all problems of one coordinate, because each type is compiled anew.
    """

    damping: float = 0.0
    linear: float = 0.0
    cubic: float = 0.0
    push: float = 0.0
    frequency: float = 0.0
    swing: float = 0.0
    wall: float = math.inf


def van_der_pol(stiffness: float) -> Oscillator:
    """q'' = stiffness (1 − q²) q' − q."""
    return Oscillator(swing=stiffness, linear=1.0)


@overload(integrator.acceleration)
def _accelerations(problem, t, q, v):
    kind = getattr(problem, "instance_class", None)
    if kind is Springs:

        def springs(problem, t, q, v):
            mean = 0.5 * (problem.slow * (q[0] + q[1]) + problem.slow_damping * (v[0] + v[1]))
            half = 0.5 * (problem.fast * (q[0] - q[1]) + problem.fast_damping * (v[0] - v[1]))
            return -mean - half, -mean + half

        return springs
    if kind is Oscillator:

        def oscillator(problem, t, q, v):
            pull = (problem.swing * (1.0 - q[0] * q[0]) - problem.damping) * v[0]
            pull -= problem.linear * q[0] + problem.cubic * q[0] ** 3
            if q[0] >= problem.wall:
                pull = math.nan
            return (pull + problem.push * math.cos(problem.frequency * t),)

        return oscillator
    return None


@overload(integrator.linearisation)
def _linearisations(problem, t, q, v):
    kind = getattr(problem, "instance_class", None)
    if kind is Springs:

        def springs(problem, t, q, v):
            a, b = -0.5 * (problem.slow + problem.fast), -0.5 * (problem.slow - problem.fast)
            c = -0.5 * (problem.slow_damping + problem.fast_damping)
            d = -0.5 * (problem.slow_damping - problem.fast_damping)
            return integrator.acceleration(problem, t, q, v), ((a, b), (b, a)), ((c, d), (d, c)), (0.0, 0.0)

        return springs
    if kind is Oscillator:

        def oscillator(problem, t, q, v):
            by_q = -2.0 * problem.swing * q[0] * v[0] - problem.linear - 3.0 * problem.cubic * q[0] ** 2
            by_v = problem.swing * (1.0 - q[0] * q[0]) - problem.damping
            by_t = -problem.push * problem.frequency * math.sin(problem.frequency * t)
            return integrator.acceleration(problem, t, q, v), ((by_q,),), ((by_v,),), (by_t,)

        return oscillator
    return None


@pytest.fixture(scope="module", autouse=True)
def nothing_of_these_problems_on_disk():
    # A cached kernel's index names the types it was compiled for: with a test's class among them every later process
    # that cannot import this module fails on reading it.
    cache = integrator.advance._cache
    integrator.advance._cache = NullCache()
    yield
    integrator.advance._cache = cache


def ones(n: int) -> tuple[float, ...]:
    return (1.0,) * n


def fixed_steps(problem, t: float, q: list[float], v: list[float], duration: float, steps: int):
    """The end of a motion in equal steps, and the states half way through them, shapes (2, n), (steps, 2, n)."""
    step = duration / steps
    # An infinite tolerance: every step is accepted as it is.
    control = Control(1e30, ones(len(q)), ones(len(q)), UNLIMITED)
    state, halves = start(t, step, tuple(q), tuple(v)), []
    for _ in range(steps):
        status, state, *half = advance(problem, state._replace(step=step), control, step)
        assert status == ACCEPTED
        halves.append(half)
    assert (state.attempts, state.rejections, state.evaluations) == (steps, 0, 6 * steps)
    assert state.t == pytest.approx(t + duration)
    return np.array([state.q, state.v]), np.array(halves)


def orders(errors: list[float] | Array) -> Array:
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def reference(function, t: Array, y0: list[float]) -> Array:
    """A solution to 12 digits, shape (len(t), len(y0))."""
    path = solve_ivp(function, (t[0], t[-1]), y0, method="DOP853", t_eval=t, rtol=1e-13, atol=1e-13)
    return path.y.T


def duffing_reference(problem: Oscillator, t: Array, y0: list[float]) -> Array:
    d, a, b, p, w = problem[:5]
    return reference(lambda t, y: (y[1], -d * y[1] - a * y[0] - b * y[0] ** 3 + p * math.cos(w * t)), t, y0)


DUFFING = Oscillator(damping=0.3, linear=1.0, cubic=2.0, push=1.5, frequency=1.7)


def tableaux() -> list[Tableau]:
    """The simulator's table and those of studies/integrators.toml."""
    text = (Path(__file__).parents[3] / "studies" / "integrators.toml").read_text(encoding="utf-8")
    others = [Tableau(name=name, **frozen(table)) for name, table in tomllib.loads(text).items() if "C" in table]
    return [RODAS, *others]


def frozen(value):
    match value:
        case dict():
            return {key: frozen(part) for key, part in value.items()}
        case list():
            return tuple(map(frozen, value))
    return value


each_tableau = pytest.mark.parametrize("tableau", tableaux(), ids=lambda tableau: tableau.name)


class Classical(NamedTuple):
    """A table in the variables k of the definition: stage i takes h f' Σ_j gamma_ij k_j."""

    alpha: Array
    gamma: Array
    b: Array
    error: Array


def classical(tableau: Tableau) -> Classical:
    """A table in the variables k = Γ⁻¹ u, with Γ⁻¹ = I/γ − C (Hairer and Wanner 1996, section IV.7)."""
    A, C = (np.zeros((len(tableau.c),) * 2) for _ in range(2))
    for i, (a, c) in enumerate(zip(tableau.A, tableau.C, strict=True), start=1):
        A[i, :i], C[i, :i] = a, c
    gamma = np.linalg.inv(np.eye(len(A)) / tableau.gamma - C)
    return Classical(A @ gamma, gamma, np.array(tableau.b) @ gamma, np.array(tableau.error) @ gamma)


@each_tableau
def test_the_times_and_the_derivative_weights_of_a_table_follow_from_its_matrices(tableau):
    made = classical(tableau)
    assert made.alpha.sum(axis=1) == pytest.approx(tableau.c, abs=1e-9)
    assert made.gamma.sum(axis=1) == pytest.approx(tableau.d, abs=1e-9)


@each_tableau
def test_a_table_and_its_embedded_method_meet_the_order_conditions(tableau):
    made = classical(tableau)
    alpha, beta = made.alpha, made.alpha + made.gamma
    a, e = alpha.sum(axis=1), beta.sum(axis=1)
    # Hairer and Wanner (1996), table IV.7.1: order, weights of the stages, value.
    conditions = [
        (1, np.ones(len(a)), 1.0),
        (2, e, 1 / 2),
        (3, a**2, 1 / 3),
        (3, beta @ e, 1 / 6),
        (4, a**3, 1 / 4),
        (4, a * (alpha @ e), 1 / 8),
        (4, beta @ a**2, 1 / 12),
        (4, beta @ beta @ e, 1 / 24),
    ]
    for weights, order in ((made.b, tableau.order), (made.b - made.error, tableau.error_order)):
        for degree, stages, value in conditions:
            if degree <= order:
                assert weights @ stages == pytest.approx(value, abs=1e-9), (order, degree)


# Compiling a table takes most of the time: kept is the one in use.
@pytest.mark.parametrize("tableau", some_of(tableaux(), {0}), ids=lambda tableau: tableau.name)
def test_the_step_of_a_table_has_its_order_and_its_error_estimate_that_of_the_embedded_method(tableau):
    attempt = step_of(tableau)

    @njit
    def motion(problem, t, q, v, step, steps):
        largest = 0.0
        for _ in range(steps):
            trial = attempt(problem, t, q, v, integrator.linearisation(problem, t, q, v), step)
            largest = max(largest, abs(trial.error_q[0]))
            t, q, v = t + step, trial.q, trial.v
        return q[0], v[0], largest

    exact = duffing_reference(DUFFING, np.array([0.4, 3.4]), [0.7, -0.2])[-1]
    ends = np.array([motion(DUFFING, 0.4, (0.7,), (-0.2,), 3.0 / n, n) for n in (60, 120, 240)])
    observed = orders(np.abs(ends[:, :2] - exact).max(axis=1))
    assert observed[-1] > tableau.order - 0.3, observed
    # Of one step: one order more.
    observed = orders(ends[:, 2])
    assert observed == pytest.approx(tableau.error_order + 1, abs=0.3)


def test_a_linear_oscillator_is_integrated_with_order_four():
    problem = Springs(slow=4.0, fast=25.0, slow_damping=0.0, fast_damping=0.5)
    decay, turn = -0.25, math.sqrt(25.0 - 0.0625)

    def exact(t):
        # slow: cos 2t; fast: released at rest from 0.5.
        fast = 0.5 * math.exp(decay * t) * (math.cos(turn * t) - decay / turn * math.sin(turn * t))
        return np.array([math.cos(2.0 * t) + fast, math.cos(2.0 * t) - fast])

    errors = [
        np.abs(fixed_steps(problem, 0.0, [1.5, 0.5], [0.0, 0.0], 3.0, n)[0][0] - exact(3.0)).max()
        for n in (32, 64, 128, 256)
    ]
    assert (orders(errors) > 3.8).all(), orders(errors)
    assert errors[-1] < 1e-6


def test_a_forced_nonlinear_oscillator_is_integrated_with_order_four():
    exact = duffing_reference(DUFFING, np.array([0.4, 3.4]), [0.7, -0.2])[-1]
    errors = [
        np.abs(fixed_steps(DUFFING, 0.4, [0.7], [-0.2], 3.0, n)[0][:, 0] - exact).max() for n in (30, 60, 120, 240)
    ]
    assert (orders(errors)[1:] > 3.8).all(), orders(errors)
    assert errors[-1] < 1e-7


def test_a_van_der_pol_oscillator_is_integrated_with_order_four():
    exact = reference(lambda t, y: (y[1], 2.0 * (1.0 - y[0] ** 2) * y[1] - y[0]), np.array([0.0, 3.0]), [1.5, 0.5])[-1]
    errors = [
        np.abs(fixed_steps(van_der_pol(2.0), 0.0, [1.5], [0.5], 3.0, n)[0][:, 0] - exact).max() for n in (60, 120, 240)
    ]
    assert (orders(errors) > 3.7).all(), orders(errors)
    assert errors[-1] < 1e-6


def test_a_stiff_mode_at_rest_does_not_lower_the_order():
    # The fast mode's frequency is 1e5 times what the steps resolve, with aperiodic damping: h ω from 3000 to 25000.
    problem = Springs(slow=4.0, fast=1e11, slow_damping=0.2, fast_damping=6e5)
    decay, turn = -0.1, math.sqrt(4.0 - 0.01)
    exact = math.exp(decay * 3.0) * (math.cos(turn * 3.0) - decay / turn * math.sin(turn * 3.0))
    errors = [
        np.abs(fixed_steps(problem, 0.0, [1.0, 1.0], [0.0, 0.0], 3.0, n)[0][0] - exact).max() for n in (15, 30, 60, 120)
    ]
    assert (orders(errors) > 3.7).all(), orders(errors)


@pytest.mark.parametrize("stiffness", [1e8, 1e12, 1e16])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.4, 1.0])
def test_one_step_far_longer_than_a_stiff_period_leaves_nothing_of_it(stiffness, damping_ratio):
    omega = math.sqrt(stiffness)
    problem = Springs(slow=0.0, fast=stiffness, slow_damping=0.0, fast_damping=2.0 * damping_ratio * omega)
    step = 1e4 / omega
    (q, v), _ = fixed_steps(problem, 0.0, [0.01, -0.01], [0.0, 0.0], step, 1)
    # L-stable: the growth factor falls like 1/(h ω).
    assert np.abs(q).max() < 0.01 * 2e-2
    assert np.abs(v).max() < 0.01 * omega * 2e-2
    (q, v), _ = fixed_steps(problem, 0.0, [0.01, -0.01], [0.0, 0.0], 100.0 * step, 1)
    assert np.abs(q).max() < 0.01 * 2e-4


@pytest.mark.parametrize("stretch", [0.1, 1.0, 3.0, 10.0, 100.0, 1e4])
def test_an_undamped_spring_never_gains_amplitude_at_any_step(stretch):
    problem = Springs(slow=0.0, fast=100.0, slow_damping=0.0, fast_damping=0.0)
    (q, v), _ = fixed_steps(problem, 0.0, [1.0, -1.0], [0.0, 0.0], 50 * stretch / 10.0, 50)
    assert math.hypot(q[0] - q[1], (v[0] - v[1]) / 10.0) <= 2.0 * (1.0 + 1e-12)


def test_the_state_half_way_through_a_step_has_order_three():
    # One step from the exact state: an interpolation of order 3 is out by h⁴.
    errors = []
    for h in (0.2, 0.1, 0.05, 0.025):
        worst = 0.0
        for begin in np.linspace(0.0, 3.0, 7):
            t = np.array([begin, begin + 0.5 * h])
            from_rest = np.concatenate([[0.0], t + 1.0])
            before, half = duffing_reference(DUFFING, from_rest, [0.7, -0.2])[1:]
            _, halves = fixed_steps(DUFFING, begin + 1.0, [before[0]], [before[1]], h, 1)
            worst = max(worst, np.abs(halves[0, :, 0] - half).max())
        errors.append(worst)
    assert (orders(errors) > 3.6).all(), orders(errors)
    assert errors[-1] < 1e-6


def scalar(tolerance: float, most: int = UNLIMITED) -> Control:
    return Control(tolerance, ones(1), ones(1), most)


def controlled(tolerance: float, end: float) -> State:
    state = start(0.0, 1e-3, (0.7,), (-0.2,))
    while state.t < end:
        status, state, _, _ = advance(DUFFING, state, scalar(tolerance), end - state.t)
        assert status == ACCEPTED
    assert state.t == end
    return state


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
def test_the_error_of_a_controlled_run_follows_the_tolerance(tolerance):
    end = 8.0
    state = controlled(tolerance, end)
    exact = duffing_reference(DUFFING, np.array([0.0, end]), [0.7, -0.2])[-1]
    error = max(abs(state.q[0] - exact[0]), abs(state.v[0] - exact[1]))
    # The motion's own growth of errors over eight seconds, and that the error estimated is of order three.
    assert 1e-3 * tolerance < error < 20.0 * tolerance


def test_steps_grow_as_the_fourth_root_of_the_tolerance_and_few_are_rejected():
    states = [controlled(tolerance, 40.0) for tolerance in (1e-6, 1e-10)]
    counts = np.array([(state.attempts, state.rejections) for state in states])
    # The estimate is of order three, its local error of order four: 10,000 times tighter is ten times as many.
    assert counts[1, 0] / counts[0, 0] == pytest.approx(10.0, rel=0.15)
    assert (counts[:, 1] < 0.1 * counts[:, 0]).all(), counts


def test_a_relaxation_oscillator_is_crossed_with_few_steps_and_the_right_period():
    stiffness = 1e3
    state, crossings = start(0.0, 1e-3, (2.0,), (-1.0 / 1500.0,)), []
    while len(crossings) < 3:
        t, q = state.t, state.q[0]
        status, state, _, _ = advance(van_der_pol(stiffness), state, scalar(1e-5, 20_000), math.inf)
        assert status == ACCEPTED
        if q * state.q[0] < 0.0:
            crossings.append(t + (state.t - t) * q / (q - state.q[0]))
    # (3 − 2 ln 2) μ + 3·2.33811 μ^(−1/3) + ..., Dorodnicyn 1947.
    period = (3.0 - 2.0 * math.log(2.0)) * stiffness + 3.0 * 2.33810741 * stiffness ** (-1.0 / 3.0)
    assert crossings[2] - crossings[0] == pytest.approx(period, rel=1e-4)
    assert state.attempts < 2000


def test_a_rejected_step_leaves_the_state_and_is_counted():
    status, state, _, _ = advance(DUFFING, start(0.0, 5.0, (0.7,), (-0.2,)), scalar(1e-6), math.inf)
    assert status == ACCEPTED
    assert state.rejections == state.attempts - 1 > 0
    assert state.evaluations == 5 * state.attempts + 1
    exact = duffing_reference(DUFFING, np.array([0.0, state.t]), [0.7, -0.2])[-1]
    assert state.q[0] == pytest.approx(exact[0], abs=1e-5)


def test_too_many_attempts_and_a_vanishing_step_are_said_and_change_nothing():
    state = start(0.0, 1e-3, (0.7,), (-0.2,))
    for _ in range(5):
        status, state, _, _ = advance(DUFFING, state, scalar(1e-6, 5), 1e-3)
        assert status == ACCEPTED
    status, after, _, _ = advance(DUFFING, state, scalar(1e-6, 5), 1e-3)
    assert status == TOO_MANY_STEPS
    assert after == state

    status, state = ACCEPTED, start(0.0, 0.1, (0.0,), (1.0,))
    while status == ACCEPTED:
        status, state, _, _ = advance(Oscillator(wall=1.0), state, scalar(1e-6), 0.1)
    assert status == STEP_UNDERFLOW
    assert state.q[0] == pytest.approx(1.0, abs=1e-9)
    assert np.isfinite([state.q[0], state.v[0]]).all()
