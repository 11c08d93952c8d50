"""What the tests of the bearing share: two thousand designs of Table 1 and responses at two tolerances."""

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

from activefail.seismic.bearing import TABLE_1, Bearing, Responses, Tolerance, simulate
from activefail.seismic.bearing.dynamics import System
from activefail.seismic.bearing.integrator import ACCEPTED, Control, advance, start
from activefail.seismic.bearing.outcome import NONE, failure_cause, observe
from activefail.space.space import Array

SAMPLES = 2000


@pytest.fixture(scope="session")
def designs() -> Array:
    """Designs of Table 1, shape (2000, 9)."""
    return TABLE_1.latin_hypercube(SAMPLES, np.random.default_rng(20260801))


@pytest.fixture(scope="session")
def production(designs: Array) -> Responses:
    return simulate(designs)


@pytest.fixture(scope="session")
def tight(designs: Array) -> Responses:
    """Half of the same designs at a tolerance 100 times tighter, at which each takes several times as long."""
    return simulate(designs[: SAMPLES // 2], tolerance=Tolerance(relative=Tolerance().relative / 100.0))


@pytest.fixture
def bearing() -> Bearing:
    """The bearing for which physics.md states its closed forms."""
    return Bearing(
        radius=2.0,
        mu=0.06,
        dish_diameter=0.95,
        slider_diameter=0.30,
        slider_height=0.20,
        rim_height=0.03,
        pressure=45e6,
        stiffness=5e9,
    )


@njit(error_model="numpy")
def _drift(system, t, q, v, duration, control, longest):
    state = start(t, 1e-5, q, v)
    history = np.empty((200_000, 11))
    rows = 0
    while rows < history.shape[0]:
        history[rows, 0] = state.t
        for i in range(5):
            history[rows, 1 + i] = state.q[i]
            history[rows, 6 + i] = state.v[i]
        rows += 1
        left = t + duration - state.t
        if left <= 0.0 or failure_cause(observe(system, state.q, state.v), system, True) != NONE:
            return rows, history
        status, state, _, _ = advance(system, state, control, min(longest, left))
        if status != ACCEPTED:
            return -1, history
    return -1, history


@pytest.fixture(scope="session")
def drift() -> Callable[..., Array]:
    """Integrates from any state to a time or a failure: accepted steps, columns t, q, v, shape (n, 11)."""

    def motion(
        system: System, t: float, q: Array, v: Array, duration: float, tolerance: float = 1e-6, longest: float = 0.02
    ) -> Array:
        control = Control(tolerance, (0.05,) * 5, (0.5,) * 5, 1_000_000)
        rows, history = _drift(system, t, tuple(map(float, q)), tuple(map(float, v)), duration, control, longest)
        assert rows > 0, "the integration failed"
        return history[:rows]

    return motion
