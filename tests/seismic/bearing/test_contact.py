"""The force laws against the page they come from, their known impacts and their derivatives."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from activefail.seismic.bearing import Bearing, Model, Pulse
from activefail.seismic.bearing.contact import LEAST_PENETRATION, Plate, gap, meets_rim, vertex_force, vertex_jacobian
from activefail.seismic.bearing.dynamics import System, system

PLATE = Plate(
    radius=1.5,
    rim_distance=0.45,
    rim_top=0.10,
    stiffness=2e9,
    dish_damping=3e5,
    rim_damping=5e5,
    mu=0.07,
    friction_velocity=1e-3,
)


def in_dish(penetration: float, angle: float) -> tuple[float, float]:
    """A vertex that penetrates the dish, seen from its centre at an angle from the apex."""
    distance = PLATE.radius + penetration
    return distance * math.sin(angle), PLATE.radius - distance * math.cos(angle)


def on_axes(angle: float, along: float, inward: float) -> tuple[float, float]:
    """(u, w) of a vector given along the dish's tangent (to the right) and its inward normal."""
    return along * math.cos(angle) - inward * math.sin(angle), along * math.sin(angle) + inward * math.cos(angle)


@pytest.mark.parametrize("angle", [-0.25, 0.0, 0.1])
@pytest.mark.parametrize("slip", [0.0, 1e-3, -0.4])
@pytest.mark.parametrize("approach", [-0.2, 0.0, 0.2])
def test_the_dish_pushes_along_its_normal_with_hertz_force_and_damper_and_rubs_along_its_tangent(angle, slip, approach):
    penetration = 2e-3
    force = vertex_force(*in_dish(penetration, angle), *on_axes(angle, slip, -approach), PLATE)
    damper = PLATE.dish_damping * penetration**0.25 * approach if approach > 0.0 else 0.0
    normal = PLATE.stiffness * penetration**1.5 + damper
    friction = -PLATE.mu * normal * slip / math.hypot(slip, 1e-3)
    assert (force.u, force.w) == pytest.approx(on_axes(angle, friction, normal), rel=1e-10, abs=1e-6)
    assert force.rim == 0.0
    assert force.stored == pytest.approx(0.4 * PLATE.stiffness * penetration**2.5, rel=1e-10)
    assert force.dissipation == pytest.approx(damper * approach - friction * slip, rel=1e-9, abs=1e-9)


def test_a_vertex_above_the_dish_or_beyond_its_centre_feels_nothing():
    assert gap(*in_dish(-1e-4, 0.2), PLATE) == pytest.approx(1e-4)
    assert tuple(vertex_force(*in_dish(-1e-4, 0.2), 1.0, -2.0, PLATE)) == (0.0,) * 6
    beyond = (0.0, 2.0 * PLATE.radius + 1e-3)  # penetrates the sphere's other half, which is no dish
    assert gap(*beyond, PLATE) < 0.0
    assert tuple(vertex_force(*beyond, 1.0, 2.0, PLATE)) == (0.0,) * 6


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("approach", [-0.3, 0.3])
@pytest.mark.parametrize("climb", [-0.5, 0.0, 0.5])
def test_the_rim_pushes_to_the_axis_and_rubs_along_its_wall(side, approach, climb):
    penetration, height = 1.5e-3, 0.098  # above the dish at that place: the rim alone
    force = vertex_force(side * (PLATE.rim_distance + penetration), height, side * approach, climb, PLATE)
    damper = PLATE.rim_damping * penetration**0.25 * approach if approach > 0.0 else 0.0
    normal = PLATE.stiffness * penetration**1.5 + damper
    friction = -PLATE.mu * normal * climb / math.hypot(climb, 1e-3)
    assert (force.u, force.w) == pytest.approx((-side * normal, friction), rel=1e-10)
    assert force.rim == pytest.approx(normal, rel=1e-10)
    assert force.stored == pytest.approx(0.4 * PLATE.stiffness * penetration**2.5, rel=1e-10)
    assert force.dissipation == pytest.approx(damper * approach - friction * climb, rel=1e-9, abs=1e-9)


def test_the_rim_ends_at_its_top_and_has_no_lower_end():
    u = PLATE.rim_distance + 1e-3
    assert meets_rim(u, PLATE.rim_top - 1e-9, PLATE)
    assert not meets_rim(u, PLATE.rim_top, PLATE)
    assert meets_rim(-u, -0.5, PLATE)
    assert not meets_rim(PLATE.rim_distance, 0.0, PLATE)


def test_beyond_the_rim_distance_dish_and_rim_act_together():
    angle = math.asin((PLATE.rim_distance + 1e-3) / (PLATE.radius + 2e-3))
    u, w = in_dish(2e-3, angle)
    both = vertex_force(u, w, 0.1, 0.2, PLATE)
    dish = vertex_force(u, w, 0.1, 0.2, PLATE._replace(rim_distance=1.0))
    rim = vertex_force(u, w, 0.1, 0.2, PLATE._replace(radius=2.0))
    assert dish.stored > 0.0
    assert rim.rim > 0.0
    assert dish.rim == 0.0
    assert gap(u, w, PLATE._replace(radius=2.0)) > 0.0
    assert np.array(both) == pytest.approx(np.array(dish) + np.array(rim), rel=1e-12)


def test_the_elastic_force_is_the_gradient_of_the_stored_energy():
    rng = np.random.default_rng(4)
    h = 1e-8
    for _ in range(50):
        u, w = in_dish(rng.uniform(5e-4, 5e-3), rng.uniform(-0.33, 0.33))
        by_u = (vertex_force(u + h, w, 0, 0, PLATE).stored - vertex_force(u - h, w, 0, 0, PLATE).stored) / (2 * h)
        by_w = (vertex_force(u, w + h, 0, 0, PLATE).stored - vertex_force(u, w - h, 0, 0, PLATE).stored) / (2 * h)
        force = vertex_force(u, w, 0.0, 0.0, PLATE)
        size = math.hypot(force.u, force.w)
        assert (force.u, force.w) == pytest.approx((-by_u, -by_w), rel=1e-6, abs=1e-6 * size)


def test_friction_and_dampers_never_give_energy():
    rng = np.random.default_rng(5)
    for _ in range(500):
        u, w = in_dish(rng.uniform(-1e-3, 5e-3), rng.uniform(-0.33, 0.33))
        assert vertex_force(u, w, rng.normal(), rng.normal(), PLATE).dissipation >= 0.0


def bearing(height: float, pressure: float, stiffness: float) -> Bearing:
    return Bearing(2.0, 0.05, 0.95, 0.30, height, 0.03, pressure, stiffness)


def rebound(plate: Plate, mass: float, speed: float) -> tuple[float, float]:
    """Rebound over approach speed and the deepest penetration [m] of a body of a mass that hits the rim squarely."""

    def motion(_, y):
        force = vertex_force(plate.rim_distance + y[0], plate.rim_top - 0.01, y[1], 0.0, plate)
        return y[1], force.u / mass

    def parted(_, y):
        return y[0]

    def deepest(_, y):
        return y[1]

    parted.terminal, parted.direction = True, -1.0
    # From a picometre inside: at the surface itself the damper's derivative is singular.
    path = solve_ivp(motion, (0.0, 1.0), [1e-12, speed], events=[parted, deepest], rtol=1e-9, atol=1e-13)
    return -path.y_events[0][0][1] / speed, path.y_events[1][0][0]


BODIES = [(0.20, 45e6, 5e9, 0.5), (0.10, 30e6, 2.5e8, 0.05), (0.39, 60e6, 1e9, 3.0)]
"""Slider height [m], pressure [Pa], stiffness [N/m^1.5] and approach speed [m/s]: masses over a factor of four."""


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("side", ["bottom", "top"])
@pytest.mark.parametrize(
    ("target", "ratio"),
    [(0.4, 0.393), (0.5, 0.495), (0.6, 0.596), (0.65, 0.647), (0.7, 0.698), (0.8, 0.799), (0.9, 0.900)],
)
def test_two_bodies_rebound_as_tabulated_whatever_their_mass_stiffness_and_speed(target, ratio, side, body):
    height, pressure, stiffness, speed = body
    bodies = system(bearing(height, pressure, stiffness), Pulse(1.0, 0.0), Model(restitution_coefficient=target))
    m, M = bodies.slider_mass, bodies.plate_mass
    # The bottom plate is held by the ground; the top plate is free, and the two move relatively as one reduced mass.
    plate, mass = (bodies.bottom, m) if side == "bottom" else (bodies.top, m * M / (m + M))
    measured, penetration = rebound(plate, mass, speed)
    assert measured == pytest.approx(ratio, abs=5.1e-4)
    # Unloading is elastic: what the spring holds at its deepest is what the body leaves with.
    assert 0.8 * stiffness / mass * penetration**2.5 / speed**2 == pytest.approx(measured**2, abs=1e-6)


def test_without_damping_a_body_rebounds_as_fast_as_it_came():
    bodies = system(bearing(0.2, 45e6, 5e9), Pulse(1.0, 0.0), Model(restitution_coefficient=1.0))
    assert rebound(bodies.bottom, bodies.slider_mass, 0.5)[0] == pytest.approx(1.0, abs=1e-7)


def thrown_plate(bodies: System, speed: float) -> float:
    """Rebound ratio of the top plate that squeezes the slider between its own rim and the bottom plate's."""
    bottom, top = bodies.bottom, bodies.top

    def motion(_, y):
        slider, plate, slider_speed, plate_speed = y
        on_slider = vertex_force(bottom.rim_distance + slider, bottom.rim_top - 0.01, slider_speed, 0.0, bottom).u
        pushed = vertex_force(
            -top.rim_distance + slider - plate, top.rim_top - 0.01, slider_speed - plate_speed, 0.0, top
        ).u
        return slider_speed, plate_speed, (on_slider + pushed) / bodies.slider_mass, -pushed / bodies.plate_mass

    def parted(_, y):
        return y[1]

    parted.terminal, parted.direction = True, -1.0
    path = solve_ivp(
        motion, (0.0, 1.0), [1e-9, 2e-9, speed, speed], events=parted, method="Radau", rtol=1e-8, atol=1e-11
    )
    return -path.y_events[0][0][3] / speed


def test_a_plate_thrown_through_the_slider_rebounds_with_e_only_under_assembly_damping():
    made = bearing(0.2, 45e6, 5e9)
    assembly = thrown_plate(system(made, Pulse(1.0, 0.0), Model(restitution="assembly")), 0.5)
    pairwise = thrown_plate(system(made, Pulse(1.0, 0.0), Model(restitution="pairwise")), 0.5)
    # 0.647 is the law's own value for e = 0.65; the slider's mass, 0.03 % of the plate's, stands between.
    assert assembly == pytest.approx(0.647, abs=2e-3)
    assert pairwise == pytest.approx(0.99, abs=1e-2)


def numerical_jacobian(point: np.ndarray, steps: np.ndarray, plate: Plate = PLATE) -> np.ndarray:
    columns = []
    for i in range(4):
        move = np.zeros(4)
        move[i] = steps[i]
        after, before = vertex_force(*(point + move), plate), vertex_force(*(point - move), plate)
        columns.append([(after.u - before.u) / (2.0 * steps[i]), (after.w - before.w) / (2.0 * steps[i])])
    return np.array(columns).T


@pytest.mark.parametrize("where", ["dish", "rim", "both"])
@pytest.mark.parametrize("approach", [True, False])
def test_the_derivatives_of_a_contact_agree_with_finite_differences(where, approach):
    rng = np.random.default_rng(6)
    for _ in range(40):
        penetration, angle = rng.uniform(5e-4, 5e-3), rng.uniform(0.05, 0.25)
        inward = -rng.uniform(0.02, 1.0) if approach else rng.uniform(0.02, 1.0)
        along = rng.choice([1e-4, 1e-3, 1e-2, 0.5]) * rng.choice([-1.0, 1.0])
        if where == "rim":
            position = -(PLATE.rim_distance + penetration), 0.095
            velocity = inward, along
        else:
            if where == "both":
                angle = math.asin((PLATE.rim_distance + rng.uniform(5e-4, 2e-3)) / (PLATE.radius + penetration))
            position, velocity = in_dish(penetration, angle), on_axes(angle, along, inward)
        if where == "both" and abs(velocity[0]) < 1e-3:
            continue  # the rim's damper switches on within the difference
        f_u, f_w, *derivatives = vertex_jacobian(*position, *velocity, PLATE)
        force = vertex_force(*position, *velocity, PLATE)
        assert (f_u, f_w) == pytest.approx((force.u, force.w), rel=1e-12)
        # Steps far below the penetration and the friction velocity, far above rounding of metres.
        numerical = numerical_jacobian(np.array([*position, *velocity]), np.array([1e-8, 1e-8, 1e-8, 1e-8]))
        analytical = np.array(derivatives).reshape(2, 4)
        np.testing.assert_allclose(analytical, numerical, rtol=1e-6, atol=3e-7 * np.abs(numerical).max())


def yielding(penetration: float, **arcs: float) -> Plate:
    """The plate with a rim that yields where its spring is compressed by `penetration` [m]."""
    strength = PLATE.stiffness * penetration * math.sqrt(penetration)
    return PLATE._replace(strength=strength, yield_penetration=penetration, **arcs)


@pytest.mark.parametrize("approach", [-0.3, 0.3])
@pytest.mark.parametrize("penetration", [2e-3, 5e-3])
def test_the_force_of_a_yielding_rim_is_at_most_its_strength_and_has_its_derivatives(penetration, approach):
    plate = yielding(3e-3)
    at = -(plate.rim_distance + penetration), 0.098, -approach, 0.2
    force = vertex_force(*at, plate)
    whole = vertex_force(*at, PLATE)
    assert whole.rim == whole.demand == force.demand if penetration < 3e-3 else force.demand > plate.strength
    assert force.rim == pytest.approx(min(whole.rim, plate.strength), rel=1e-12)
    # Within a step: the spring's energy to its strength, then the work of the strength.
    elastic, plastic = min(penetration, 3e-3), max(penetration - 3e-3, 0.0)
    stored = 0.4 * plate.stiffness * elastic**2.5 + plate.strength * plastic
    assert force.stored == pytest.approx(stored, rel=1e-9)
    spring = plate.stiffness * elastic**1.5
    friction = plate.mu * force.rim * 0.2**2 / math.hypot(0.2, 1e-3)
    assert force.dissipation == pytest.approx((force.rim - spring) * approach + friction, rel=1e-6)
    f_u, f_w, *derivatives = vertex_jacobian(*at, plate)
    assert (f_u, f_w) == pytest.approx((force.u, force.w), rel=1e-12)
    numerical = numerical_jacobian(np.array(at), np.full(4, 1e-8), plate)
    np.testing.assert_allclose(
        np.array(derivatives).reshape(2, 4), numerical, rtol=1e-6, atol=3e-7 * np.abs(numerical).max() + 1e-2
    )


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_deformed_arc_stands_further_out_and_the_opposite_one_where_it_was(side):
    arcs = {"left": 0.01, "right": 0.0} if side < 0.0 else {"left": 0.0, "right": 0.01}
    plate = yielding(3e-3, **arcs)
    place = PLATE.rim_distance + 0.011
    moved, same = (vertex_force(u, 0.098, 0.0, 0.0, plate) for u in (side * place, -side * place))
    assert moved.rim == pytest.approx(PLATE.stiffness * 1e-3**1.5, rel=1e-9)
    assert same.rim == pytest.approx(plate.strength, rel=1e-12)
    assert not meets_rim(side * (place - 2e-3), 0.0, plate)
    broken = plate._replace(**{name: math.inf for name, arc in arcs.items() if arc})
    assert vertex_force(side * place, 0.098, 0.3, 0.1, broken).rim == 0.0


def test_the_dampers_derivative_stops_growing_below_the_floor_of_penetration():
    w = in_dish(LEAST_PENETRATION * 1e-3, 0.0)[1]
    by_height = vertex_jacobian(0.0, w, 0.0, -1.0, PLATE)[7]
    assert by_height == pytest.approx(-0.25 * PLATE.dish_damping * LEAST_PENETRATION**-0.75, rel=1e-6)
