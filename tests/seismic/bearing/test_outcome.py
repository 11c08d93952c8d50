"""The events and the three outcomes on states made by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from activefail.seismic.bearing import Bearing, Model, Pulse, outcome
from activefail.seismic.bearing.dynamics import System, equilibrium, system
from activefail.seismic.bearing.outcome import Observation, crossing, failure_cause, failure_fraction, observe
from activefail.space.space import Array

AT_REST = np.zeros(5)


@pytest.fixture
def constants(bearing: Bearing) -> System:
    return system(bearing, Pulse(1.0, 1.0), Model())


def with_offsets(constants: System, **offsets: float) -> Array:
    """The bearing at rest with some coordinates moved."""
    q = np.array(equilibrium(constants))
    for name, offset in offsets.items():
        q[("x_s", "z_s", "theta", "x_t", "z_t").index(name)] += offset
    return q


def test_the_bearing_at_rest_touches_nothing_and_has_not_failed(constants):
    seen = observe(constants, equilibrium(constants), AT_REST)
    assert seen.touch == pytest.approx(constants.half_width - constants.bottom.rim_distance)
    assert seen.confinement_gap == pytest.approx(-0.00467, abs=2e-5)
    assert (seen.rim_force, seen.tilt) == (0.0, 0.0)
    assert failure_cause(seen, constants, True) == outcome.NONE


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_the_slider_at_the_bottom_rim_is_a_touch_with_its_velocity_and_force(constants, direction):
    to_rim = constants.bottom.rim_distance - constants.half_width
    q = with_offsets(constants, x_s=direction * (to_rim + 1e-3), x_t=direction * to_rim)
    speed = np.array([direction * 0.4, 0.0, 0.0, direction * 0.1, 0.0])
    seen = observe(constants, q, speed)
    assert seen.touch == pytest.approx(1e-3, rel=1e-9)
    assert seen.touch_velocity == pytest.approx(0.4)
    damper = constants.bottom.rim_damping * 1e-3**0.25 * 0.4
    assert seen.rim_force == pytest.approx(5e9 * 1e-3**1.5 + damper, rel=1e-9)
    assert failure_cause(seen, constants, True) == outcome.NONE


def test_the_top_rim_is_touched_by_the_slider_relative_to_the_top_plate(constants):
    to_rim = constants.top.rim_distance - constants.half_width
    speed = np.array([0.1, 0.0, 0.0, 0.5, 0.0])
    seen = observe(constants, with_offsets(constants, x_t=to_rim + 1e-3), speed)
    assert seen.touch == pytest.approx(1e-3, rel=1e-9)
    assert seen.touch_velocity == pytest.approx(0.4)
    assert observe(constants, with_offsets(constants, x_t=to_rim - 1e-3), speed).touch == pytest.approx(-1e-3, rel=1e-9)


def test_the_rim_force_is_the_larger_of_the_two_plates_and_not_their_sum(constants):
    to_rim = constants.bottom.rim_distance - constants.half_width
    alone = observe(constants, with_offsets(constants, x_s=to_rim + 1e-3, x_t=to_rim), AT_REST).rim_force
    both = observe(constants, with_offsets(constants, x_s=to_rim + 1e-3, x_t=2.0 * to_rim + 1.5e-3), AT_REST).rim_force
    assert alone > 0.0
    assert both == alone


def test_a_vertex_beyond_the_rim_and_above_its_top_has_escaped(constants):
    to_rim = constants.bottom.rim_distance - constants.half_width
    rise = constants.bottom.rim_top - equilibrium(constants)[1] + constants.half_height
    below, at = (with_offsets(constants, x_s=to_rim + 2e-3, z_s=rise + d, z_t=rise + d) for d in (-1e-4, 1e-9))
    assert failure_cause(observe(constants, below, AT_REST), constants, False) == outcome.NONE
    assert failure_cause(observe(constants, at, AT_REST), constants, False) == outcome.ESCAPE
    assert observe(constants, below, AT_REST).escape == pytest.approx(-1e-4)
    inside = with_offsets(constants, x_s=to_rim - 1e-3, z_s=rise + 0.01, z_t=rise + 0.01)
    assert failure_cause(observe(constants, inside, AT_REST), constants, False) == outcome.NONE


@pytest.mark.parametrize("plate", ["bottom", "top"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_any_of_the_four_vertices_can_escape(constants, plate, side):
    to_rim = constants.bottom.rim_distance - constants.half_width + 1e-3
    high = constants.bottom.rim_top + 1e-3 - (equilibrium(constants)[1] - constants.half_height)
    if plate == "bottom":
        # Shifted to one side of the bottom plate and lifted; the top plate follows exactly.
        q = with_offsets(constants, x_s=side * to_rim, x_t=side * to_rim, z_s=high, z_t=high)
    else:
        q = with_offsets(constants, x_t=-side * to_rim, z_t=high)
    assert failure_cause(observe(constants, q, AT_REST), constants, False) == outcome.ESCAPE


def test_confinement_is_lost_when_both_vertices_that_face_a_plate_are_above_the_rims_height(constants, bearing):
    just = bearing.rim_height - observe(constants, equilibrium(constants), AT_REST).confinement_gap
    # A lift h opens a gap of h cos(incline).
    lift = just / math.cos(math.asin(0.15 / 2.0))
    held = observe(constants, with_offsets(constants, z_t=0.99 * lift), AT_REST)
    lost = observe(constants, with_offsets(constants, z_t=1.01 * lift), AT_REST)
    assert held.confinement_gap < bearing.rim_height < lost.confinement_gap
    assert failure_cause(held, constants, True) == outcome.NONE
    assert failure_cause(lost, constants, True) == outcome.LOSS_OF_CONFINEMENT
    assert failure_cause(lost, constants, False) == outcome.NONE
    # The same for the bottom plate, with the slider stuck to the top one.
    raised = observe(constants, with_offsets(constants, z_s=1.01 * lift, z_t=1.01 * lift), AT_REST)
    assert failure_cause(raised, constants, True) == outcome.LOSS_OF_CONFINEMENT


def test_one_vertex_in_its_dish_keeps_the_slider_confined(constants, bearing):
    # Turned about the bottom left vertex: the right one is far above the rim's height, and the plate lies on top.
    angle = 0.15
    q = np.array(equilibrium(constants))
    corner = np.array([-constants.half_width, -constants.half_height])
    turned = np.array(
        [
            math.cos(angle) * corner[0] - math.sin(angle) * corner[1],
            math.sin(angle) * corner[0] + math.cos(angle) * corner[1],
        ]
    )
    q[:3] = q[0] + (corner - turned)[0], q[1] + (corner - turned)[1], angle
    q[4] += 2.0 * constants.half_width * math.sin(angle)
    seen = observe(constants, q, AT_REST)
    assert 2.0 * constants.half_width * math.sin(angle) > bearing.rim_height
    assert seen.confinement_gap < bearing.rim_height
    assert failure_cause(seen, constants, True) == outcome.NONE


def test_the_slider_overturns_beyond_the_angle_of_its_diagonal(constants, bearing):
    limit = math.atan(bearing.slider_diameter / bearing.slider_height)
    seen = observe(constants, equilibrium(constants), AT_REST)
    for sign in (-1.0, 1.0):
        assert observe(constants, with_offsets(constants, theta=sign * 0.3), AT_REST).tilt == pytest.approx(0.3)
    assert failure_cause(seen._replace(tilt=limit * (1.0 - 1e-9)), constants, True) == outcome.NONE
    assert failure_cause(seen._replace(tilt=limit * (1.0 + 1e-9)), constants, True) == outcome.OVERTURNING


def test_of_several_failures_at_one_step_the_first_in_order_is_named(constants, bearing):
    everything = Observation(0.01, 0.0, 0.0, 0.0, 2.0 * bearing.rim_height, 0.0, math.pi)
    assert failure_cause(everything, constants, True) == outcome.ESCAPE
    assert failure_cause(everything._replace(escape=-1e-9), constants, True) == outcome.LOSS_OF_CONFINEMENT
    assert failure_cause(everything._replace(escape=-1e-9), constants, False) == outcome.OVERTURNING


def test_the_time_of_an_event_is_interpolated_between_two_steps(constants, bearing):
    assert crossing(-1.0, 3.0, 0.0) == 0.25
    assert crossing(2.0, 4.0, 3.0) == 0.5
    # An event that held already, or does not hold yet, is put at the step's end.
    assert crossing(1.0, 2.0, 0.0) == 1.0
    assert crossing(-2.0, -1.0, 0.0) == 1.0
    limit = math.atan(bearing.slider_diameter / bearing.slider_height)
    before = Observation(-1.0, 0.0, 0.0, 0.0, 0.0, -0.01, 0.0)
    after = Observation(1.0, 0.0, 0.0, 0.0, 2.0 * bearing.rim_height, 0.03, 4.0 * limit)
    assert failure_fraction(before, after, outcome.ESCAPE, constants) == pytest.approx(0.25)
    assert failure_fraction(before, after, outcome.LOSS_OF_CONFINEMENT, constants) == pytest.approx(0.5)
    assert failure_fraction(before, after, outcome.OVERTURNING, constants) == pytest.approx(0.25)


def test_observations_agree_with_the_definitions_written_a_second_time(bearing):
    rng = np.random.default_rng(9)
    for _ in range(300):
        made = replace(bearing, radius=rng.uniform(1.0, 3.5), slider_height=rng.uniform(0.1, 0.39))
        constants = system(made, Pulse(1.0, 1.0), Model())
        q = np.array(equilibrium(constants)) + rng.normal(size=5) * np.array([0.2, 0.03, 0.1, 0.4, 0.05])
        edge = made.radius - math.sqrt(made.radius**2 - made.dish_diameter**2 / 4.0)
        gaps, beyond, above = [], [], []
        for side, up in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
            body = complex(side * made.slider_diameter / 2.0, up * made.slider_height / 2.0)
            vertex = complex(q[0], q[1]) + body * complex(math.cos(q[2]), math.sin(q[2]))
            apex = complex(q[3], q[4]) if up > 0 else 0j
            height = (apex - vertex).imag if up > 0 else vertex.imag
            distance = (vertex - apex).real
            gaps.append(made.radius - abs(complex(distance, height - made.radius)))
            beyond.append(abs(distance) - made.dish_diameter / 2.0)
            above.append(height - edge - made.rim_height)
        seen = observe(constants, q, AT_REST)
        assert seen.confinement_gap == pytest.approx(max(min(gaps[:2]), min(gaps[2:])), abs=1e-12)
        assert seen.escape == pytest.approx(max(map(min, beyond, above)), abs=1e-12)
        assert seen.touch == pytest.approx(
            max((b for b, a in zip(beyond, above, strict=True) if a < 0.0), default=-math.inf), abs=1e-12
        )
        assert seen.tilt == abs(q[2])


def test_an_event_that_had_no_value_before_is_put_at_the_end_of_the_step():
    assert crossing(-np.inf, 0.1, 0.0) == 1.0
