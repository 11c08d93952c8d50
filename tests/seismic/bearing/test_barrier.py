"""The energies that a bearing cannot touch a rim or fail without, against potential energies of states and searches."""

import math
from itertools import pairwise

import numpy as np
import pytest
from cases import some
from scipy.integrate import quad
from scipy.optimize import minimize

from activefail.seismic.bearing import Bearing, Model, Pulse
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.barrier import barrier
from activefail.seismic.bearing.contact import gap
from activefail.seismic.bearing.dynamics import System, energy, equilibrium, lever, seen_by_plate, system
from activefail.seismic.bearing.pulse import ground_acceleration, impulse_to_come
from activefail.space.space import Array

AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0)


def potential(constants: System, q: Array) -> float:
    return energy(constants, 0.0, tuple(map(float, q)), AT_REST).stored


def constants_of(row: Array) -> System:
    return system(Bearing.from_table(*row[:7]), Pulse(1.0, 0.0), Model())


def states(constants: System, rng: np.random.Generator, n: int):
    """Positions of all kinds within the tilt at which the slider overturns."""
    rest = np.array(equilibrium(constants))
    for size in rng.choice([0.03, 0.3, 1.0], n):
        move = rng.normal(size=5) * np.array([0.6, 0.1, 1.0, 1.0, 0.1]) * size
        # Where gravity has pressed everything together there is less energy.
        if rng.uniform() < 0.7:
            move[1], move[4] = move[1] * 0.1, move[4] * 0.1
        q = rest + move
        if abs(q[2]) <= constants.tilt_limit:
            yield q


def test_no_state_has_less_potential_energy_than_its_kind_is_said_to_need(designs):
    rng = np.random.default_rng(11)
    touching = failing = 0
    for row in designs[:150]:
        constants = constants_of(row)
        levels = barrier(constants, True)
        for q in states(constants, rng, 150):
            stored = potential(constants, q)
            assert stored >= levels.least
            seen = o.observe(constants, q, AT_REST)
            if seen.touch > 0.0:
                touching += 1
                assert stored >= levels.touch
            if o.failure_cause(seen, constants, True) != o.NONE:
                failing += 1
                assert stored >= levels.failure
    assert min(touching, failing) > 1000


@pytest.mark.parametrize(
    "kind", some(["least", "touch", "bottom lost", "top lost", "escape", "overturning"], "least", "overturning")
)
def test_the_lowest_state_of_a_kind_that_a_search_finds_is_no_lower(designs, kind):
    # A penalty holds the search to the kind; the found state's shortfall from it is made up by lifting the plate.
    for row in designs[:5]:
        constants = constants_of(row)
        levels = barrier(constants, True)
        weight = constants.plate_mass * 9.81
        rest = np.array(equilibrium(constants))
        rim = constants.bottom.rim_distance - constants.half_width

        def shortfall(q, constants=constants):
            seen = o.observe(constants, q, AT_REST)
            r_x, _ = lever(constants, 1, q[2])
            match kind:
                case "least":
                    return 0.0
                case "touch":
                    return max(0.0, constants.bottom.rim_distance - q[0] - r_x)
                case "escape":
                    return max(0.0, -seen.escape)
                case "overturning":
                    return max(0.0, constants.tilt_limit - seen.tilt)
            gaps = []
            for vertex in (0, 1) if kind == "bottom lost" else (2, 3):
                u, w = seen_by_plate(vertex, *lever(constants, vertex, q[2]), q)
                gaps.append(gap(u, w, constants.bottom))
            return max(0.0, constants.rim_height - min(gaps))

        def cost(q, constants=constants, weight=weight, shortfall=shortfall):
            tilt = max(0.0, abs(q[2]) - constants.tilt_limit)
            return potential(constants, q) / weight + 20.0 * shortfall(q) + 20.0 * tilt

        lowest = math.inf
        for begin in (
            AT_REST,
            (rim, 0.05, 0.1, 2.0 * rim, 0.1),
            (rim, 0.05, 0.0, rim, 0.05),
            (0.0, 0.1, 0.3, 0.0, 0.2),
        ):
            point = rest + np.array(begin)
            for _ in range(4):
                point = minimize(cost, point, method="Nelder-Mead", options={"maxiter": 3000, "fatol": 1e-9}).x
            if shortfall(point) < 1e-6 and abs(point[2]) < constants.tilt_limit + 1e-6:
                lowest = min(lowest, potential(constants, point) / weight)
        needed = {"least": levels.least, "touch": levels.touch}.get(kind, levels.failure) / weight
        assert lowest >= needed - 1e-4
        if kind == "least":
            # The bound is close: rest is the lowest state.
            assert lowest == pytest.approx(potential(constants, rest) / weight, abs=1e-6)
            assert needed == pytest.approx(lowest, abs=5e-3)


def test_failure_needs_about_what_lifts_the_plate_by_the_rims_height_and_more_where_confinement_does_not_count(bearing):
    constants = system(bearing, Pulse(1.0, 0.0), Model())
    levels = barrier(constants, True)
    rest = potential(constants, np.array(equilibrium(constants)))
    weight = constants.plate_mass * 9.81
    # Confinement is lost by a lift of the rim's height; without it the slider has to climb the edge or overturn.
    assert (levels.failure - rest) / weight == pytest.approx(bearing.rim_height, abs=0.01)
    assert barrier(constants, False).failure > levels.failure
    assert levels.touch - rest > 0.0


def test_of_a_dish_too_steep_nothing_is_promised(bearing):
    constants = system(bearing, Pulse(1.0, 0.0), Model())
    steep = constants._replace(bottom=constants.bottom._replace(radius=0.25))
    assert barrier(steep, True).failure == -math.inf


@pytest.mark.parametrize("amplitude", [3.0, -3.0])
def test_the_impulse_to_come_is_the_integral_of_the_accelerations_size(amplitude):
    for t in np.linspace(-3.5, 3.5, 29):
        roots = [root for root in (-3.0 / math.pi, 0.0, 3.0 / math.pi) if root > t]
        ends = [t, *roots, 12.0]
        area = sum(
            quad(lambda x: abs(ground_acceleration(x, amplitude, 2.0)), a, b, epsabs=1e-12)[0]
            for a, b in pairwise(ends)
        )
        assert impulse_to_come(t, amplitude, 2.0) == pytest.approx(area, rel=1e-7, abs=1e-9)
