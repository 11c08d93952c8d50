"""The designer's terms of a bearing against its simulated motion."""

from dataclasses import replace

import numpy as np
import pytest

from activefail.seismic.bearing import TABLE_1, Accelerogram, Bearing, Model, Tolerance, simulate_one
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.terms import Terms
from activefail.space.space import Array

MODEL = Model(friction_velocity=1e-6)
ROWS = TABLE_1.from_unit(np.random.default_rng(3).random((12, 9)))[:, :7]


def terms_of(row: Array) -> Terms:
    terms = Terms.of(dict(zip(TABLE_1.names, row.tolist(), strict=False)), MODEL)
    assert terms is not None
    return terms


@pytest.mark.parametrize("row", ROWS)
def test_a_slowly_pushed_bearing_touches_its_rims_where_the_terms_say_at_the_force_they_say(row: Array) -> None:
    terms = terms_of(row)
    push = np.linspace(0.0, 1.3 * terms.nominal_force * GRAVITY, 401)
    record = Accelerogram(-push, 0.5)
    run = simulate_one(Bearing.from_row(row.tolist(), 0.3), record, MODEL, Tolerance(1e-6, longest_step=0.05))
    at_touch = run.margins.first_touch_time
    force = -(run.a[:, 3] + record.at(run.t)) / (GRAVITY + run.a[:, 4])
    assert np.interp(at_touch, run.t, run.q[:, 3]) == pytest.approx(terms.rim_displacement, rel=0.01)
    assert np.interp(at_touch, run.t, force) == pytest.approx(terms.rim_force, rel=0.01)
    # Neither is near the nominal value.
    assert terms.rim_displacement < 0.98 * terms.capacity
    assert terms.rim_force > 1.005 * terms.nominal_force


def test_small_swings_have_the_period_of_the_effective_radius() -> None:
    row = ROWS[0].copy()
    row[1] = 1e-4
    terms, push = terms_of(row), np.zeros(3000)
    push[:40] = 0.5
    run = simulate_one(Bearing.from_row(row.tolist(), 0.3), Accelerogram(push, 0.01), MODEL, to_the_end=True)
    within = (run.t > 1.0) & (run.t < 29.0)
    t, x = run.t[within], run.q[within, 3]
    before = np.flatnonzero(np.sign(x[1:]) != np.sign(x[:-1]))
    crossings = t[before] - x[before] * np.diff(t)[before] / np.diff(x)[before]
    assert 2.0 * np.mean(np.diff(crossings)) == pytest.approx(terms.period, rel=1e-3)
    assert terms.period < 0.98 * terms.nominal_period


def test_a_bearing_without_all_values_or_with_an_impossible_slider_has_no_terms() -> None:
    values = dict(zip(TABLE_1.names, ROWS[0].tolist(), strict=False))
    assert Terms.of({name: value for name, value in values.items() if name != "h_sl_ratio"}, MODEL) is None
    assert Terms.of(values | {"D_tot": 9.0}, MODEL) is None
    assert Terms.of(values | {"h_sl_ratio": 100.0}, MODEL) is None


def test_a_bearing_without_rims_has_edges_instead() -> None:
    values = dict(zip(TABLE_1.names, ROWS[0].tolist(), strict=False))
    none, rigid = Terms.of(values, replace(MODEL, rim="none")), Terms.of(values, MODEL)
    assert none is not None
    assert rigid is not None
    assert none.rim_displacement == rigid.rim_displacement
    assert "touched by the slider" in rigid.text
    assert "rims: none; the slider is at the edges of its dishes at" in none.text
