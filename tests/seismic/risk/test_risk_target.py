"""Targets that are risks in a number of years: pulses as a hazard's curve says."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, refused
from scipy.stats import norm

from activefail import open_run
from activefail.analyses.design.design_task import Requirement, read_targets
from activefail.analyses.design.risk_target import at_risk
from activefail.analyses.fragility.curve import Curve, Ladder, Rate, risk_of
from activefail.errors import InputError
from activefail.seismic.hazard.hazard import Hazard
from activefail.seismic.hazard.risk_target import pulses_of_curve
from activefail.space.space import Array
from activefail.space.weighted import WeightedRows

VELOCITIES, RATES = [0.2, 0.5, 1.0, 2.0], [1e-2, 2e-3, 4e-4, 5e-5]

VALUES = {
    "magnitude": {"M": 7.0},
    "pgv": {"median_m_s": 1.0, "dispersion": 0.25},
    "curve": {"pgv_m_s": VELOCITIES, "annual_rate": RATES},
}


def hazard(**more: object) -> Hazard:
    return Hazard.of({**VALUES, **more}, Path("hazard.toml"))


def pulses_as(rate: Rate, of: Hazard) -> WeightedRows:
    return pulses_of_curve(rate, of.rows, of.period_given)


RATE = Rate(np.array(VELOCITIES), np.array(RATES), 50.0)


def share(rows: WeightedRows, values: Array) -> float:
    return float((rows.weight * values).mean())


def test_pulses_of_a_curve_exceed_each_velocity_as_often_as_it_says() -> None:
    rows = pulses_as(RATE, hazard())
    for velocity, rate in zip(VELOCITIES[1:], RATES[1:], strict=True):
        assert RATES[0] * share(rows, rows.column("PGV") > velocity) == pytest.approx(rate, rel=0.02)
    assert rows.column("PGV").min() >= 0.2
    # The mass beyond the extrapolated end is kept.
    slope = math.log(RATES[-1] / RATES[-2]) / math.log(2.0)
    assert RATES[0] * share(rows, rows.column("PGV") > 3.0) == pytest.approx(RATES[-1] * 1.5**slope, rel=0.03)


def test_every_block_of_pulses_is_a_sample_of_the_same_distribution() -> None:
    rows = pulses_as(RATE, hazard())
    mean = share(rows, rows.column("PGV"))
    error = float(rows.standard_error(rows.column("PGV")))
    assert 0.0 < error < 0.005 * mean


@pytest.mark.parametrize(("median", "dispersion"), [(0.8, 0.3), (2.0, 0.4), (0.3, 0.4), (0.15, 0.5)])
def test_a_target_and_a_fragility_define_a_risk_alike(median: float, dispersion: float) -> None:
    ladder = Ladder("PGV", "m/s", np.geomspace(0.05, 20.0, 800), is_log=True)
    curve = Curve(ladder, norm.cdf(np.log(ladder.levels / median) / dispersion), 0.001)
    expected = risk_of(curve, RATE)
    site, (requirement,), rate = at_risk(hazard(), [Requirement("failure", 0.01, 50.0)])
    assert site.rows is not None
    P = share(site.rows, norm.cdf(np.log(site.rows.column("PGV") / median) / dispersion))
    # The pulses end where 1e-4 of the rate remains, and their strata have one velocity for each block.
    assert rate.risk(P) == pytest.approx(expected.probability, rel=0.002)
    assert rate.risk(requirement.target) == pytest.approx(0.01)


def test_periods_have_their_distribution_given_the_velocity() -> None:
    site = hazard(pgv={"median_m_s": 1.0, "dispersion": 0.25, "correlation_with_period": 0.6})
    rows = pulses_as(RATE, site)
    z = (np.log(rows.column("T_p") / site.median_period)) / site.period_dispersion
    expected = 0.6 * np.log(rows.column("PGV")) / 0.25
    residual = (z - expected) / 0.8
    assert share(rows, residual) == pytest.approx(0.0, abs=0.05)
    assert share(rows, residual**2) == pytest.approx(1.0, abs=0.05)


def test_periods_of_a_table_are_those_of_its_pulses_of_similar_velocity() -> None:
    rng = np.random.default_rng(0)
    velocity = rng.lognormal(0.0, 0.6, 6000)
    short = rng.random(6000) < 0.5
    # Long periods where the velocity is large, as a table of correlated pulses has them.
    period = np.where(short, 1.0, 2.0) * np.where(velocity > 1.0, 4.0, 1.0)
    table = WeightedRows(("T_p", "PGV"), np.column_stack([period, velocity]), np.ones(6000))
    rows = pulses_as(RATE, replace(hazard(), rows=table))
    for large, periods in ((True, (4.0, 8.0)), (False, (1.0, 2.0))):
        far = (rows.column("PGV") > 1.25) if large else (rows.column("PGV") < 0.8)
        assert set(rows.column("T_p")[far]) == set(periods)
        assert share(rows, far & (rows.column("T_p") == periods[0])) == pytest.approx(0.5 * share(rows, far), rel=0.1)


@pytest.mark.parametrize(
    ("velocities", "rates"),
    [([0.3, 0.305, 8.0], [1e-2, 1e-9, 1e-10]), ([0.3, 0.33, 3.0], [1e-2, 1e-6, 1e-7]), ([0.3, 3.0], [1e-2, 9.99e-3])],
    ids=["a step", "steep", "flat"],
)
def test_no_curve_rests_on_a_few_pulses(velocities: list[float], rates: list[float]) -> None:
    rows = pulses_as(Rate(np.array(velocities), np.array(rates)), hazard())
    if rates[1] < 1e-3:
        assert rows.weight.sum() ** 2 / (rows.weight**2).sum() > 1000
    for velocity, rate in zip(velocities[1:], rates[1:], strict=True):
        assert rates[0] * share(rows, rows.column("PGV") > velocity) == pytest.approx(
            rate, rel=0.05, abs=1e-3 * rates[0]
        )


def test_added_uncertainty_raises_the_risk_as_the_wider_fragility_does() -> None:
    median, dispersion, added = 1.5, 0.3, 0.4
    site, _, rate = at_risk(
        hazard(uncertainty={"design_requirements": added, "test_data": 0.0, "modelling": 0.0}),
        [Requirement("failure", 0.01, 50.0)],
    )
    pulses, _ = site.pulses()
    assert isinstance(pulses, WeightedRows)
    P = share(pulses, norm.cdf(np.log(pulses.column("PGV") / median) / dispersion))
    ladder = Ladder("PGV", "m/s", np.geomspace(0.05, 20.0, 800), is_log=True)
    wider = Curve(ladder, norm.cdf(np.log(ladder.levels / median) / math.hypot(dispersion, added)), 0.001)
    expected = risk_of(wider, RATE)
    assert rate.risk(P) == pytest.approx(expected.probability, rel=0.03)


def test_targets_in_years_are_read() -> None:
    outcomes = ("safe", "damage", "failure")
    for text in ("1% in 50 years", "1 % in 50 years", "0.01 in 50 years"):
        assert read_targets(text, outcomes, "failure") == (Requirement("failure", pytest.approx(0.01), 50.0),)
    assert read_targets("damage=10% in 30 years,failure=1% in 30 years", outcomes, "failure") == (
        Requirement("damage", 0.1, 30.0),
        Requirement("failure", 0.01, 30.0),
    )


@pytest.mark.parametrize("text", ["1.2.3% in 50 years", "0% in 50 years", "95% in 50 years", "1% in 0 years"])
def test_a_risk_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="a risk must be above 0 and at most 90 %"):
        read_targets(text, ("safe", "failure"), "failure")


def test_what_a_risk_needs_is_told() -> None:
    one = Requirement("failure", 0.01, 50.0)
    without = Hazard.of({name: VALUES[name] for name in ("magnitude", "pgv")}, Path("hazard.toml"))
    for site in (None, without):
        with pytest.raises(InputError, match=r"requires a hazard with a \[curve\]"):
            at_risk(site, [one])
    for other in (Requirement("impact", 0.3), Requirement("impact", 0.3, 30.0)):
        with pytest.raises(InputError, match="all targets must be risks in the same number of years"):
            at_risk(hazard(), [one, other])
    with pytest.raises(InputError, match="Begin the curve at a larger level"):
        at_risk(hazard(), [Requirement("failure", 1e-4, 50.0)])
    with pytest.raises(InputError, match="Begin the curve at a smaller level"):
        at_risk(hazard(), [Requirement("failure", 0.9, 50.0)])


def test_a_bearing_is_designed_for_a_risk(tmp_path: Path) -> None:
    (tmp_path / "bearing.toml").write_text("[sampling]\ninitial = 60\nbudget = 60\n")
    (tmp_path / "hazard.toml").write_text(
        "[magnitude]\nM = 7.0\n[pgv]\nmedian_m_s = 1.0\ndispersion = 0.25\n"
        f"[curve]\npgv_m_s = {VELOCITIES}\nannual_rate = {RATES}\n"
    )
    (tmp_path / "fixed.toml").write_text(
        "T_b = 3.5\nmu = 0.11\nh_sl_ratio = 0.6\nh_rim_ratio = 0.1\np = 45.0\nk = 2e9\n"
    )
    result = activefail("run", tmp_path / "bearing.toml", "--out", tmp_path / "run")
    assert result.code == 0, result.err
    asked = ("--hazard", tmp_path / "hazard.toml", "--fixed", tmp_path / "fixed.toml", "--simulations", "100")
    result = activefail("design", tmp_path / "run", "--target", "1% in 50 years", *asked, "--no-chart", "--json")
    assert result.code in (0, 3), result.err
    found = json.loads(result.out)
    risk = found["requirements"][0]["risk"]
    assert risk["target"] == pytest.approx(0.01)
    assert risk["low"] < risk["risk"] < risk["high"]
    assert risk["risk"] == pytest.approx(-math.expm1(-50.0 * RATES[0] * found["probability"]))
    assert (risk["high"] <= risk["target"]) == (found["status"] == "verified")
    assert any("Pulses below 0.2 m/s" in sentence for sentence in found["assumptions"])
    # A verified design of a report is one given a pulse.
    with open_run(tmp_path / "run") as opened:
        assert opened.store.recall(("verified designs",)) is None
    refused(
        activefail("report", tmp_path / "run", *asked[:4], "--target", "1% in 50 years"), "under loads of the hazard"
    )
