"""Rims that break, yield or are absent: laws of physics, limits, causes, and an independent program."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from activefail.seismic.bearing import Accelerogram, Model, Responses, simulate, simulate_one, simulate_records
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.collision import collision_severity
from activefail.seismic.bearing.design import Bearing, Pulse
from activefail.space.space import Array

BREAKING = Model(rim="breaking", rim_strength=1.5)
YIELDING = Model(rim="yielding", rim_strength=1.0, rim_deformation=0.05)
NONE = Model(rim="none")
TYPES = {"breaking": BREAKING, "yielding": YIELDING, "none": NONE}
N = 400


@pytest.fixture(scope="module", params=TYPES)
def of_type(request: pytest.FixtureRequest, designs: Array) -> tuple[Model, Responses]:
    """A model with a type of rim, and its responses to `N` designs."""
    model = TYPES[request.param]
    return model, simulate(designs[:N], model)


def test_an_infinite_strength_is_a_rigid_rim(designs, production):
    strong = simulate(designs[:N], Model(rim="yielding", rim_strength=1e9, rim_deformation=0.01))
    for name in ("outcome", "cause", "columns"):
        np.testing.assert_array_equal(getattr(strong, name), getattr(production, name)[:N])
    # A rim that breaks might do so at any later touch, so these runs last longer.
    strong = simulate(designs[:N], Model(rim="breaking", rim_strength=1e9))
    np.testing.assert_array_equal(strong.outcome, production.outcome[:N])
    np.testing.assert_array_equal(strong.cause, production.cause[:N])


def test_without_rims_or_strength_fails_what_would_have_touched_a_rim(designs, production):
    touched = production.outcome[:N] > o.NO_IMPACT
    absent = simulate(designs[:N], NONE)
    weak = simulate(designs[:N], Model(rim="breaking", rim_strength=0.0))
    for found, cause in ((absent, o.ESCAPE), (weak, o.RIM_FRACTURE)):
        np.testing.assert_array_equal(found.outcome, np.where(touched, o.FAILURE, o.NO_IMPACT))
        np.testing.assert_array_equal(found.cause, np.where(touched, cause, o.NONE))
    assert np.isnan(absent.margin("first_touch_time")).all()
    # Interpolated in a step of at most 0.1 s, in which a rim without strength does not push back.
    times = weak.margin("first_touch_time"), production.margin("first_touch_time")[:N]
    np.testing.assert_allclose(*times, rtol=0.0, atol=0.02)


def test_a_rim_breaks_where_a_rigid_one_bears_more_than_its_strength(designs, production):
    # Of rigid rims in bearings that survive; a run without failure ends when no more force can come than this.
    peak = production.margin("peak_rim_force_ratio")
    chosen = np.flatnonzero(production.outcome == o.IMPACT)[:15]
    assert len(chosen) == 15
    for row in chosen.tolist():
        weaker, stronger = (Model(rim="breaking", rim_strength=float(peak[row]) * share) for share in (0.99, 1.01))
        assert simulate(designs[row : row + 1], weaker).cause[0] == o.RIM_FRACTURE
        run = simulate_one(Bearing.from_table(*designs[row, :7]), Pulse.from_table(*designs[row, 7:]), to_the_end=True)
        if run.margins.peak_rim_force_ratio <= peak[row]:
            assert simulate(designs[row : row + 1], stronger).outcome[0] == o.IMPACT


def test_no_rim_bears_more_than_its_strength_and_causes_are_of_their_types(of_type):
    model, found = of_type
    assert found.margin("peak_rim_force_ratio").max() <= (model.rim_strength or 0.0) * (1.0 + 1e-12)
    fractures = (found.cause == o.RIM_FRACTURE).sum()
    assert fractures > 100 if model.rim_strength else fractures == 0
    assert not (found.outcome == o.NUMERICAL_FAILURE).any()


def test_energy_is_balanced_with_the_work_that_deforms_and_breaks_rims(of_type, designs):
    # As with rigid rims: the plastic work is known to rounding, and the rest is integrated alike.
    assert of_type[1].statistic("energy_error").max() < 1e-3
    assert np.median(of_type[1].statistic("energy_error")) < 5e-5


def test_a_mirrored_pulse_deforms_the_other_arcs(designs):
    for row in designs[:40]:
        bearing, pulse = Bearing.from_table(*row[:7]), Pulse.from_table(*row[7:])
        one, other = (
            simulate_one(bearing, Pulse(pulse.period, sign * pulse.amplitude), YIELDING) for sign in (1.0, -1.0)
        )
        assert (one.outcome, one.cause) == (other.outcome, other.cause)
        np.testing.assert_allclose(one.rims[-1], other.rims[-1, [1, 0, 3, 2]], rtol=1e-6, atol=1e-9)


def test_arcs_only_grow_and_those_of_a_fracture_are_infinite(designs):
    for row in designs[:40]:
        run = simulate_one(Bearing.from_table(*row[:7]), Pulse.from_table(*row[7:]), YIELDING)
        assert (run.rims[1:] >= run.rims[:-1]).all()
        assert np.isinf(run.rims).any() == (run.cause == o.RIM_FRACTURE)
        assert run.rims[:-1].max() < YIELDING.rim_deformation


def test_no_run_is_ended_that_would_have_failed(of_type, designs):
    model, found = of_type
    still_running = np.flatnonzero(found.outcome < o.FAILURE)
    ended = 0
    for row in still_running[:: max(1, len(still_running) // 60)].tolist():
        bearing, pulse = Bearing.from_table(*designs[row, :7]), Pulse.from_table(*designs[row, 7:])
        run = simulate_one(bearing, pulse, model, to_the_end=True)
        assert run.outcome == found.outcome[row]
        ended += run.margins.end_time > found.margin("end_time")[row]
    assert ended > 50


def test_under_records_with_vertical_motion_rims_break_too_and_energy_is_balanced(of_type, designs):
    model, _ = of_type
    rng = np.random.default_rng(3)
    t = 0.01 * np.arange(1200)
    window = np.exp(-(((t - 5.0) / 3.0) ** 2))

    def shaking(size: float, frequencies: Array) -> Array:
        return size * window * sum(np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.28)) for f in frequencies)

    records = [
        Accelerogram(shaking(rng.uniform(0.5, 3.0), rng.uniform(0.2, 2.0, 5)), 0.01, "", shaking(1.0, np.array([5.0])))
        for _ in range(40)
    ]
    found = simulate_records(designs[:40, :7], records, model)
    rigid = simulate_records(designs[:40, :7], records)
    assert not (found.outcome == o.NUMERICAL_FAILURE).any()
    assert (found.outcome[rigid.outcome > 0] >= rigid.outcome[rigid.outcome > 0]).mean() > 0.9
    assert found.statistic("energy_error").max() < 5e-3
    if model.rim == "none":
        np.testing.assert_array_equal(found.outcome == o.FAILURE, rigid.outcome > o.NO_IMPACT)


def test_the_reduced_model_sees_rims_break(of_type, designs):
    model, found = of_type
    predicted = collision_severity(designs[:N], model) > 1.0
    # With rigid rims it is right for 98.5 % of Table 1 (`collision`).
    assert (predicted == (found.outcome == o.FAILURE)).mean() > 0.97


@pytest.mark.slow
def test_outcomes_are_those_of_an_independent_program(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "studies"))
    study = importlib.import_module("rims")
    try:
        X = study.uniform(60, 3)
        X = X[simulate(X).outcome > 0][:10]
        for kind in ("breaking", "yielding"):
            for row, model in zip(X, study.models(kind, 10, 3), strict=True):
                assert study.ours(row, model)[0] == study.independent(row, model)
    finally:
        for name in ("rims", "study"):
            sys.modules.pop(name, None)
