"""The reduced model of the collision: its geometry and symmetry, how well it predicts the bearing, and at what cost."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Bearing, Model, Pulse, simulate_one
from activefail.seismic.bearing.collision import (
    collide,
    collision_features,
    collision_severity,
    touching_displacement,
)
from activefail.seismic.bearing.contact import Plate
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.ground import Ricker


@pytest.mark.parametrize(("D_tot", "h_sl", "T_b"), [(0.45, 0.1, 5.5), (0.6, 0.2, 4.0), (0.85, 0.39, 2.5)])
def test_at_the_touching_displacement_the_seated_slider_is_at_the_rim(D_tot, h_sl, T_b):
    radius, half_width = 0.5 * GRAVITY * (T_b / (2.0 * math.pi)) ** 2, 0.15
    half_dish = 0.5 * (D_tot + 0.30)
    length = 2.0 * math.sqrt(radius**2 - half_width**2) - h_sl
    x = touching_displacement(half_dish, half_width, length, h_sl)
    # The slider stands on the line between the dishes' centres, (0, R) and L away from it at x to the right.
    tilt = math.asin(x / length)
    center = np.array([0.5 * x, radius - 0.5 * length * math.cos(tilt)])
    corner = center + np.array(
        [
            half_width * math.cos(tilt) + 0.5 * h_sl * math.sin(tilt),
            half_width * math.sin(tilt) - 0.5 * h_sl * math.cos(tilt),
        ]
    )
    assert np.hypot(*(corner - [0.0, radius])) == pytest.approx(radius, rel=1e-6)
    assert corner[0] == pytest.approx(half_dish, abs=1e-6)


def test_the_bearing_touches_at_that_displacement_with_the_slider_in_the_middle(designs, production):
    touched = np.flatnonzero(production.outcome >= 1)[:40]
    for row in designs[touched].tolist():
        row[6] *= 100.0  # nearly rigid: elastic rocking would touch earlier
        bearing, pulse = Bearing.from_row(row, 0.30), Pulse.from_table(*row[7:])
        motion = simulate_one(bearing, pulse)
        first = motion.margins.first_touch_time
        if math.isnan(first):
            continue
        x_s, x_t = (np.interp(first, motion.t, motion.q[:, column]) for column in (0, 3))
        length = 2.0 * math.sqrt(bearing.radius**2 - 0.15**2) - bearing.slider_height
        touch = touching_displacement(0.5 * bearing.dish_diameter, 0.15, length, bearing.slider_height)
        assert abs(x_t) == pytest.approx(touch, rel=0.02)
        assert x_s / x_t == pytest.approx(0.5, abs=2e-3)


def test_the_reduced_model_alone_tells_impact_in_99_and_failure_in_98_of_100_samples(designs, production):
    severity = collision_severity(designs)
    assert np.mean((severity > 0.0) == (production.outcome >= 1)) >= 0.985
    assert np.mean((severity > 1.0) == (production.outcome == 2)) >= 0.98


def test_what_fails_at_the_first_collision_is_foretold_in_98_of_100_samples(designs, production):
    soon = production.margin("failure_time") - production.margin("first_touch_time") < 0.5
    assert soon.sum() > 500
    assert np.mean(collision_severity(designs)[soon] > 1.0) >= 0.98


def test_the_pulse_reversed_in_sign_gives_the_same_severity():
    X = TABLE_1.latin_hypercube(100, np.random.default_rng(2))
    mirrored = X.copy()
    mirrored[:, 8] *= -1.0
    assert collision_severity(mirrored).tolist() == collision_severity(X).tolist()


@pytest.mark.parametrize("speed", [1.0, 1.5, 2.0])
def test_a_plate_thrown_without_ground_motion_rises_no_higher_than_its_energy(speed):
    radius, half_width, h_sl, h_rim, k, mass = 2.0, 0.15, 0.25, 5.0, 2e9, 3e5
    half_dish = 0.45
    length = 2.0 * math.sqrt(radius**2 - half_width**2) - h_sl
    edge = radius - math.sqrt(radius**2 - half_dish**2)
    plate = Plate(radius, half_dish, edge + h_rim, k, 0.0, 0.0, 0.0, 0.02)
    touch = touching_displacement(half_dish, half_width, length, h_sl)
    still = Ricker(0.0, 1.0)
    lift, tilt = collide(plate, mass, half_width, 0.5 * h_sl, h_rim, length, touch, still, 0.0, touch, speed, speed)
    slope = touch / math.sqrt(length**2 - touch**2)
    kinetic = 0.5 * speed**2 * (1.0 + slope**2) / GRAVITY
    potential = length - math.sqrt(length**2 - touch**2)
    static = 2.0 * (0.5 * mass * GRAVITY / k) ** (2.0 / 3.0)
    assert 0.0 < lift**2 * h_rim <= kinetic + potential + static
    assert tilt > 0.0


def test_a_faster_arrival_lifts_the_plate_higher():
    radius, half_width, h_sl, h_rim = 2.0, 0.15, 0.25, 5.0
    length = 2.0 * math.sqrt(radius**2 - half_width**2) - h_sl
    plate = Plate(radius, 0.45, 0.051 + h_rim, 2e9, 0.0, 0.0, 0.05, 0.02)
    touch = touching_displacement(0.45, half_width, length, h_sl)
    still = Ricker(0.0, 1.0)
    lifts = [
        collide(plate, 3e5, half_width, 0.5 * h_sl, h_rim, length, touch, still, 0.0, touch, speed, speed)[0]
        for speed in (0.4, 0.8, 1.2)
    ]
    assert lifts == sorted(lifts)
    assert lifts[2] > 1.5 * lifts[0]


def test_without_a_touch_the_severity_is_0_and_the_feature_its_floor(designs, production):
    calm = (production.outcome == 0) & (production.margin("peak_displacement_ratio") < 0.7)
    assert calm.sum() > 100
    assert np.all(collision_severity(designs[calm]) == 0.0)
    assert_allclose(collision_features(designs[calm])[:, 0], math.tanh(-1.5), rtol=1e-12)


@pytest.mark.parametrize("restitution", ["pairwise", "assembly"])
def test_it_stays_finite_far_outside_table_1(restitution):
    rng = np.random.default_rng(6)
    X = TABLE_1.latin_hypercube(200, rng)
    X[:, 6] = 10.0 ** rng.uniform(7.0, 11.0, 200)
    X[:, 5] = 10.0 ** rng.uniform(0.0, 2.5, 200)
    X[:, 7] = 10.0 ** rng.uniform(-1.0, 1.0, 200)
    X[:, 8] = rng.uniform(0.0, 3.0, 200)
    severity = collision_severity(X, Model(restitution=restitution))
    assert np.isfinite(severity).all()
    assert 20 < np.count_nonzero(severity > 1.0) < 180


def test_assembly_damping_makes_collisions_milder():
    X = TABLE_1.latin_hypercube(300, np.random.default_rng(7))
    hard = collision_severity(X, Model(restitution="pairwise"))
    soft = collision_severity(X, Model(restitution="assembly"))
    assert np.mean(soft > 1.0) < np.mean(hard > 1.0)


def test_a_design_that_cannot_be_built_has_no_severity():
    X = TABLE_1.latin_hypercube(8, np.random.default_rng(0))
    X[2, 0] = 0.5  # a radius of 3 cm
    X[5, 7] = np.nan
    assert np.flatnonzero(np.isnan(collision_severity(X))).tolist() == [2, 5]


def test_designs_of_another_shape_are_refused():
    with pytest.raises(InputError, match=r"must be an array of shape \(n, 9\) .* got shape \(3, 8\)"):
        collision_severity(np.zeros((3, 8)))
