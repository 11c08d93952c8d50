"""Bearings, pulses and models as a user states them, and the messages about invalid ones."""

import math
import subprocess
import sys

import numpy as np
import pytest

from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Bearing, Model, Pulse, Tolerance, simulate

ROW = (4.0, 0.07, 0.65, 0.8, 0.12, 45.0, 2e9, 1.5, 0.4)


def test_table_1_has_the_papers_variables_in_its_order_with_its_ranges():
    ranges = {
        "T_b": (2.5, 5.5),
        "mu": (0.02, 0.12),
        "D_tot": (0.450, 0.850),
        "h_sl_ratio": (0.33, 1.3),
        "h_rim_ratio": (0.05, 0.2),
        "p": (30.0, 60.0),
        "k": (2.5e8, 50e8),
        "T_p": (0.25, 5.0),
        "A_p": (0.1, 0.8),
    }
    assert TABLE_1.names == tuple(ranges)
    assert list(zip(TABLE_1.low.tolist(), TABLE_1.high.tolist(), strict=True)) == list(ranges.values())


def test_a_row_of_table_1_becomes_a_bearing_in_si_units():
    made = Bearing.from_table(*ROW[:7])
    assert 2.0 * math.pi * math.sqrt(2.0 * made.radius / 9.81) == pytest.approx(4.0, rel=1e-14)
    assert made.dish_diameter == pytest.approx(0.95)
    assert made.displacement_capacity == pytest.approx(0.65)
    assert made.slider_height == pytest.approx(0.24)
    assert made.rim_height == pytest.approx(0.036)
    assert (made.mu, made.pressure, made.stiffness, made.slider_diameter) == (0.07, 45e6, 2e9, 0.30)
    assert made.plate_mass == pytest.approx(45e6 * math.pi * 0.30**2 / 4.0 / 9.81)
    smaller = Bearing.from_table(*ROW[:7], slider_diameter=0.2)
    assert (smaller.dish_diameter, smaller.slider_height) == pytest.approx((0.85, 0.16))


@pytest.mark.parametrize(
    ("e", "ratio"), [(0.65, 0.3728), (1.0, 0.0), (0.5, 9 * math.sqrt(5) / 2 * 0.75 / (0.5 * (0.5 * 12.274334 + 16)))]
)
def test_the_damping_ratio_of_a_restitution_coefficient_is_jankowskis(e, ratio):
    assert Model(restitution_coefficient=e).damping_ratio == pytest.approx(ratio, abs=5e-5)


def test_the_defaults_are_those_that_the_page_chose():
    model = Model()
    assert (model.slider_diameter, model.restitution_coefficient, model.restitution) == (0.30, 0.65, "pairwise")
    assert (model.slider_density, model.friction_velocity, model.loss_of_confinement) == (7850.0, 1e-3, True)


@pytest.mark.parametrize("column", range(9))
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_bad_entry_is_named_by_row_column_rule_and_value(column, value):
    X = np.tile(ROW, (5, 1))
    X[3, column] = value
    name = TABLE_1.names[column]
    with pytest.raises(InputError) as caught:
        simulate(X)
    message = str(caught.value)
    assert f"Row 3, column {name}" in message
    assert f"`{name}` must be positive and finite" in message
    assert str(value) in message


@pytest.mark.parametrize("X", [np.ones(9), np.ones((4, 8)), np.ones((4, 10)), np.ones((2, 2, 9))])
def test_designs_of_the_wrong_shape_are_refused_with_their_shape(X):
    with pytest.raises(InputError) as caught:
        simulate(X)
    assert str(X.shape) in str(caught.value)
    assert "(n, 9)" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mu": -0.1}, ("`mu > 0`", "-0.1")),
        ({"slider_diameter": 1.2}, ("`slider_diameter < dish_diameter`", "1.2", "0.95")),
        ({"radius": 0.4}, ("`dish_diameter < 2 radius`", "0.95", "0.8")),
        ({"slider_height": 4.1}, ("less than the distance", "4.1", "2")),
    ],
)
def test_a_bearing_that_cannot_be_built_is_refused_with_rule_and_value(bearing, change, message):
    with pytest.raises(InputError) as caught:
        Bearing(**{**vars(bearing), **change})
    for part in message:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Bearing.from_table(-4.0, *ROW[1:7]), ("`T_b > 0`", "-4.0")),
        (lambda: Bearing.from_table(1e308, *ROW[1:7]), ("`-1e+75 <= T_b <= 1e+75`", "1e+308")),
        (lambda: Pulse(0.0, 1.0), ("`period > 0`", "0.0")),
        (lambda: Model(friction_velocity=0.0), ("`friction_velocity > 0`", "0.0")),
        (lambda: Model(friction_velocity=0.2), ("`friction_velocity <= 0.1`", "0.2")),
        (lambda: Model(slider_diameter=300.0), ("`slider_diameter < 5`", "300.0")),
        (lambda: Model(restitution_coefficient=1.1), ("`0 < restitution_coefficient <= 1`", "1.1")),
        (lambda: Model(restitution="elastic"), ("pairwise", "assembly", "'elastic'")),
        (lambda: Model(rim="brittle"), ("rigid, breaking, yielding, none", "'brittle'")),
        (lambda: Model(rim_strength=0.8), ('rim = "rigid" cannot be combined with `rim_strength`', "0.8")),
        (lambda: Model(rim="none", rim_strength=0.8), ('rim = "none" cannot be combined with `rim_strength`', "0.8")),
        (lambda: Model(rim="breaking"), ('rim = "breaking" requires `rim_strength`',)),
        (lambda: Model(rim="yielding", rim_strength=0.8), ('rim = "yielding" requires `rim_deformation`',)),
        (
            lambda: Model(rim="breaking", rim_strength=0.8, rim_deformation=0.1),
            ('rim = "breaking" cannot be combined with `rim_deformation`', "0.1"),
        ),
        (lambda: Model(rim="breaking", rim_strength=-0.1), ("`0 <= rim_strength < inf`", "-0.1")),
        (lambda: Model(rim="breaking", rim_strength=float("nan")), ("`0 <= rim_strength < inf`", "nan")),
        (
            lambda: Model(rim="yielding", rim_strength=0.8, rim_deformation=0.2),
            ("`0 < rim_deformation <= slider_diameter / 2`", "0.2 and 0.3 m"),
        ),
        (lambda: Tolerance(relative=0.1), ("`1e-12 <= relative <= 0.01`", "0.1")),
        (lambda: Tolerance(most_steps=0.5), ("`most_steps`", "whole number", "0.5")),
    ],
)
def test_a_setting_outside_its_range_is_refused_with_rule_and_value(make, message):
    with pytest.raises(InputError) as caught:
        make()
    for part in message:
        assert part in str(caught.value)


def test_a_pulse_may_be_mirrored_but_a_design_may_not():
    assert Pulse(1.0, -3.0).amplitude == -3.0
    with pytest.raises(InputError, match="Row 0, column A_p"):
        simulate(np.array([[*ROW[:8], -0.4]]))


def test_the_physics_loads_without_the_learning_the_store_or_the_settings():
    code = (
        "import sys, activefail.seismic.bearing; "
        "print(*sorted({m.split('.')[0] for m in sys.modules} & {'torch', 'h5py', 'gpytorch', 'botorch', 'pydantic', "
        "'matplotlib'}))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == []


def test_table_1_is_the_papers() -> None:
    rows = {
        "T_b": (2.5, 5.5, "s"),
        "mu": (0.02, 0.12, ""),
        "D_tot": (0.450, 0.850, "m"),
        "h_sl_ratio": (0.33, 1.3, ""),
        "h_rim_ratio": (0.05, 0.2, ""),
        "p": (30.0, 60.0, "MPa"),
        "k": (2.5e8, 50e8, "N/m^1.5"),
        "T_p": (0.25, 5.0, "s"),
        "A_p": (0.1, 0.8, "g"),
    }
    assert {p.name: (p.low, p.high, p.unit) for p in TABLE_1.parameters} == rows
