"""Fragility of a simulator whose capacity in peak ground velocity is lognormal, from a campaign that learned it."""

import csv
import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from commandline import activefail, refused, sets
from scipy.special import ndtr, ndtri

from activefail.analyses.fragility.band import Interval
from activefail.analyses.fragility.findings import FragilityFindings
from activefail.campaign.settings import IF_CALLED, parse_settings
from activefail.estimates.integral import integral_of
from activefail.pages.report.analyses import curves_shown, write_fragility
from activefail.run.opening import open_run
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.pulse import VELOCITY_PER_ACCELERATION, velocity_of
from activefail.seismic.hazard.hazard import read_hazard
from activefail.space.shares import significant
from activefail.space.space import Array

MEDIAN, BETA = 1.2, 0.3
"""Of the peak ground velocity at failure [m/s]; damage begins at exp(−0.3) of it."""

LIMIT = f"""
import math

def reserve(d):
    velocity = {VELOCITY_PER_ACCELERATION * GRAVITY!r} * d["A_p"] * d["T_p"]
    return math.log({MEDIAN} * d["r"] / velocity)
"""

CAMPAIGN = """
seed = 3
[simulator]
python = "pulses:reserve"
outcomes = ["safe", "damage", "failure"]
margins = ["g"]
levels = { g = [0.3, 0.0] }
[sampling]
initial = 20
budget = 30
[space]
T_p = { distribution = "lognormal", median = 2.0, dispersion = 0.6, unit = "s" }
A_p = { distribution = "lognormal", median = 0.3, dispersion = 0.8, unit = "g" }
r = { distribution = "lognormal", median = 1.0, dispersion = 0.3 }
"""

HAZARD = """
description = "a <site>"
[pulse_period]
median_s = 2.0
dispersion = 0.4
definition = "acceleration"
[pgv]
median_m_s = 0.8
dispersion = 0.25
"""

UNCERTAIN = """
[uncertainty]
test_data = 0.24
modelling = 0.32
[curve]
pgv_m_s = [0.5, 2.0]
annual_rate = [1.6e-3, 1e-4]
"""

SLOPE, ADDED = 2.0, 0.4


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fragility")
    (folder / "pulses.py").write_text(LIMIT)
    (folder / "made.toml").write_text(CAMPAIGN)
    (folder / "site.toml").write_text(HAZARD)
    (folder / "uncertain.toml").write_text(HAZARD + UNCERTAIN)
    result = activefail("run", folder / "made.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    return folder


@pytest.fixture(scope="module")
def uncertain(ended: Path) -> FragilityFindings:
    with open_run(ended / "run", code=ended) as opened:
        return opened.fragility(ended / "uncertain.toml")


def probability(levels: Any, median: float, beta: float) -> Any:
    return ndtr(np.log(np.asarray(levels) / median) / beta)


def test_the_curve_of_the_pulses_alone_is_that_of_the_limit_state(uncertain: FragilityFindings) -> None:
    for one, median in zip(uncertain.boundaries, (MEDIAN * math.exp(-0.3), MEDIAN), strict=True):
        assert one.alone is not None
        assert one.alone.probability == pytest.approx(probability(one.alone.ladder.levels, median, BETA), abs=0.01)


def test_added_uncertainty_convolves_the_curve(uncertain: FragilityFindings) -> None:
    beta = math.hypot(BETA, ADDED)
    levels = uncertain.ladder.levels
    for one, median in zip(uncertain.boundaries, (MEDIAN * math.exp(-0.3), MEDIAN), strict=True):
        assert one.curve.probability == pytest.approx(probability(levels, median, beta), abs=0.015)
        assert one.curve.fall is None
        for p in (0.025, 0.1, 0.5):
            capacity, interval = one.capacity(p)
            assert capacity.level == pytest.approx(median * math.exp(beta * ndtri(p)), rel=0.04)
            assert (interval.low, interval.high) == (None, None)
        assert uncertain.margin_ratio(one) == pytest.approx(median / 0.8, rel=0.02)


def test_the_risk_is_the_integral_over_the_sites_rates(uncertain: FragilityFindings) -> None:
    risk, beta = uncertain.boundaries[-1].risk, math.hypot(BETA, ADDED)
    mean = math.log(MEDIAN) - SLOPE * beta**2
    rate = 4e-4 * MEDIAN**-SLOPE * math.exp(0.5 * (SLOPE * beta) ** 2)
    # Pulses below 0.5 m/s are left out, where the hazard's curve begins.
    z, of_first = math.log(0.5), 4e-4 * 0.5**-SLOPE
    rate = rate * float(ndtr((mean - z) / beta)) + of_first * float(ndtr((z - math.log(MEDIAN)) / beta))
    assert risk is not None
    # Velocities above 4.2 m/s are counted with the last probability.
    assert risk.annual_rate == pytest.approx(rate, rel=0.03)
    assert 0.0 < risk.share_outside_hazard_curve < 0.5
    assert any("Pulses below 0.5 m/s" in line for line in uncertain.lines)


def test_failures_are_attributed_to_the_pulses_that_cause_them(uncertain: FragilityFindings) -> None:
    parts = uncertain.boundaries[-1].deaggregation
    assert parts is not None
    assert parts.failures is not None
    assert parts.failures is not None
    under_hazard = float(ndtr(math.log(0.8 / MEDIAN) / math.sqrt(BETA**2 + ADDED**2 + 0.25**2)))
    assert parts.probability == pytest.approx(under_hazard, abs=0.01)
    assert parts.failures.share.sum() == pytest.approx(1.0)
    assert parts.pulses.share.sum() == pytest.approx(1.0)
    # The period does not matter, the velocity does.
    assert parts.failures.period.p50 == pytest.approx(2.0, rel=0.1)
    assert parts.pulses.velocity.p50 == pytest.approx(0.8, rel=0.03)
    assert parts.failures.velocity.p50 > 1.05 * 0.8


@pytest.mark.parametrize("limit", [1.2, 1.6, 2.0])
def test_rare_failures_of_a_capacity_with_added_uncertainty_are_not_missed(tmp_path: Path, limit: float) -> None:
    (tmp_path / "site.toml").write_text(
        "[magnitude]\nM = 7.0\n[pgv]\nmedian_m_s = 1.0\ndispersion = 0.2\n[uncertainty]\nmodelling = 0.3\n"
    )
    settings = parse_settings("", "made.toml")
    space = settings.design_space()
    middles = {one.name: 0.5 * (one.low + one.high) for one in space.parameters if one.name not in ("T_p", "A_p")}

    def beyond(X: Array) -> Array:
        T_p, A_p = (X[:, space.names.index(name)] for name in ("T_p", "A_p"))
        return 1e6 * np.log(velocity_of(A_p, T_p) / limit)[:, None]

    hazard = read_hazard(tmp_path / "site.toml")
    probability = integral_of(hazard.question(space, middles), beyond, space).probability
    (parts,) = hazard.deaggregated(beyond, space, middles, probability)
    true = float(ndtr(-math.log(limit) / math.hypot(0.2, 0.3)))
    assert parts.probability == pytest.approx(true, rel=0.06)
    assert parts.failures is not None
    assert parts.failures.velocity.p50 > 1.1 * parts.pulses.velocity.p50


def test_pulses_of_a_file_give_the_same_curve(ended: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = "".join(
        f"{T},{V},{w}\n"
        for T, V, w in zip(rng.uniform(1, 4, 300), rng.uniform(0.4, 1.6, 300), rng.uniform(1, 2, 300), strict=True)
    )
    (tmp_path / "pulses.csv").write_text("T_p,PGV,weight\n" + rows)
    (tmp_path / "rows.toml").write_text('samples = "pulses.csv"\n[uncertainty]\ntest_data = 0.3\n')
    fixed = {"r": 1.1}
    with open_run(ended / "run", code=ended) as opened:
        found = opened.fragility(tmp_path / "rows.toml", fixed)
    assert found.boundaries[-1].curve.resolution < 0.02
    expected = probability(found.ladder.levels, 1.1 * MEDIAN, 0.3)
    assert found.boundaries[-1].curve.probability == pytest.approx(expected, abs=0.02)
    parts = found.boundaries[-1].deaggregation
    assert parts is not None
    assert parts.pulses.share.sum() == pytest.approx(1.0)


def test_few_pulses_with_added_uncertainty_have_smooth_curves_and_intervals_that_hold(
    ended: Path, tmp_path: Path
) -> None:
    (tmp_path / "pulses.csv").write_text("T_p,PGV,weight\n1,1,3\n2,1.4,4\n3,1.7,2\n6,1.1,0.5\n4,3,0.5\n")
    (tmp_path / "rows.toml").write_text('samples = "pulses.csv"\n[uncertainty]\ntest_data = 0.5\n')
    with open_run(ended / "run", code=ended, write=True) as opened:
        found = opened.fragility(tmp_path / "rows.toml", {"r": 1.0}, verify=200)
        whole = opened.probability(100, 0.95, question=tmp_path / "rows.toml", fixed={"r": 1.0})
    one = found.boundaries[-1]
    assert one.curve.probability == pytest.approx(probability(found.ladder.levels, MEDIAN, 0.5), abs=0.02)
    assert np.diff(one.curve.probability).max() < 0.06
    assert one.curve.capacity(0.5).level == pytest.approx(MEDIAN, rel=0.02)
    assert len(one.verified) >= 4
    for level, estimate in one.verified:
        assert estimate.low <= float(probability(level, MEDIAN, 0.5)) <= estimate.high
    true = np.average(probability([1, 1.4, 1.7, 1.1, 3], MEDIAN, 0.5), weights=[3, 4, 2, 0.5, 0.5])
    assert whole.estimate.low <= true <= whole.estimate.high
    assert whole.estimate.probability == pytest.approx(true, abs=0.02)
    assert one.deaggregation is not None
    assert one.deaggregation.probability == pytest.approx(true, abs=0.02)


def test_every_number_without_an_interval_gives_the_reason(uncertain: FragilityFindings) -> None:
    def check(value: Any) -> int:
        if isinstance(value, list):
            return sum(map(check, value))
        if not isinstance(value, dict):
            return 0
        without = [name for name in ("interval", "low", "high") if name in value and value[name] is None]
        assert not without or value["interval_reason"]
        return bool(without) + sum(map(check, value.values()))

    # For each outcome: two curves, three capacities, the hazard's median, margin, risk and pulses.
    assert check(json.loads(json.dumps(uncertain.as_json(), allow_nan=False))) == 2 * 9


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_a_verified_curve_has_intervals_that_hold_and_are_kept(ended: Path, tmp_path: Path) -> None:
    command = ("fragility", ended / "run", "--code", ended, "--hazard", ended / "uncertain.toml", "--verify", "60")
    result = activefail(*command, "--out", tmp_path / "new" / "out", "--csv", tmp_path / "curves.csv")
    assert result.code == 0, result.err
    kept = sets(ended / "run")
    assert "fragility against PGV [m/s], under a <site>" in result.out
    assert "95 % confidence" in result.out
    assert "each one alone has 95 % confidence" in result.out
    again = activefail(*command, "--json")
    assert sets(ended / "run") == kept
    numbers = json.loads(again.out)
    failure, damage = numbers["outcomes"]["failure"], numbers["outcomes"]["damage"]
    beta = math.hypot(BETA, ADDED)
    for level in failure["verified"]:
        assert level["low"] <= probability(level["level"], MEDIAN, beta) <= level["high"]
    # A design that is drawn several times is simulated once.
    assert 30 < sum(level["simulations"] for level in failure["verified"]) <= 60
    assert damage["verified"] == []
    assert damage["capacities"][1]["interval_reason"] == "not verified by simulations"
    # Two levels are verified; the capacity at one of them has an interval, or the reason why it has not.
    capacity = failure["capacities"][1]
    assert capacity["confidence"] == 0.95
    assert (capacity["low"] is None or capacity["high"] is None) == bool(capacity["interval_reason"])
    files = {path.name for path in (tmp_path / "new" / "out").iterdir()}
    assert files == {
        "fragility.csv",
        "fragility.html",
        "fragility.json",
        "fragility.png",
        "fragility.svg",
        "pulses.png",
        "pulses.svg",
        "deaggregation.csv",
        "pelicun.csv",
        "openquake.xml",
    }
    assert json.loads((tmp_path / "new" / "out" / "fragility.json").read_text()) == numbers
    with (tmp_path / "curves.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows].count("verified") == 2
    curve = [float(row["p_failure"]) for row in rows if row["kind"] == "ladder"]
    assert curve == failure["curve"]["probability"]
    assert all(row["p_failure_low"] for row in rows if row["kind"] == "verified")
    model = ElementTree.parse(tmp_path / "new" / "out" / "openquake.xml").getroot()[0]
    assert model.findtext("{http://openquake.org/xmlns/nrml/0.5}limitStates") == "damage failure"
    with (tmp_path / "new" / "out" / "deaggregation.csv").open(newline="") as file:
        shares = [float(row["share_of_failures"]) for row in csv.DictReader(file) if row["outcome"] == "failure"]
    assert sum(shares) == pytest.approx(1.0)


def test_a_campaign_that_cannot_verify_its_curve_is_not_told_to(uncertain: FragilityFindings, tmp_path: Path) -> None:
    found = replace(uncertain, refused=IF_CALLED)
    assert any(line.endswith(f"--verify N {IF_CALLED}") for line in found.lines)
    write_fragility(found, tmp_path)
    page = (tmp_path / "fragility.html").read_text()
    assert "<code>--verify</code> requires a simulator that activefail can call" in page
    assert "--verify 250" not in page
    labels = re.findall(r'<svg role="img" aria-label="([^"]*)"', page)
    assert len(set(labels)) == len(labels) == 2
    assert labels[1].endswith(": Pulses that cause failure under the hazard")


@pytest.mark.parametrize(
    ("verified", "low", "card", "cells"),
    [
        (1.3, None, "by the classifier, no interval", ("–", "–")),
        (1.3, 1.1, "(from 1.10 m/s with 95 % confidence, the other end is unknown)", ("1.30", "from 1.10")),
        (None, 1.1, "by the classifier (from 1.10 m/s with 95 % confidence, the other end is unknown)",
         ("–", "from 1.10")),
    ],
)  # fmt: skip
def test_a_corrected_median_is_shown_only_with_an_end_of_its_interval(
    uncertain: FragilityFindings, monkeypatch: pytest.MonkeyPatch, verified: float | None, low: float | None, card: str,
    cells: tuple[str, str],
) -> None:  # fmt: skip
    interval = Interval(verified, low, None, 0.95, "the levels end")
    monkeypatch.setattr("activefail.analyses.fragility.findings.capacity_interval", lambda *_: interval)
    shown = curves_shown(uncertain, {}, {})
    level = uncertain.boundaries[-1].curve.capacity(0.5).level
    assert level is not None
    assert shown["cards"][0][1:] == (f"{significant(verified if verified and low else level)} m/s", card)
    assert shown["capacities"][0][1][2] == ("50 %", significant(level), *cells)
    assert ("1.30 after correction" in " ".join(uncertain.lines)) == bool(verified and low)
    assert shown["lacks_interval"]
    whole, of_failure = Interval(1.3, 1.1, 1.5, 0.95, None), uncertain.boundaries[-1].curve
    monkeypatch.setattr(
        "activefail.analyses.fragility.findings.capacity_interval",
        lambda curve, *_: whole if curve is of_failure else interval,
    )
    assert not curves_shown(uncertain, {}, {})["lacks_interval"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--hazard", "site.toml", "--against", "r"], "against: cannot be combined with hazard."),
        (["--hazard", "site.toml", "--out", "run/simulations"], "is one of the run folder's own files"),
        (["--hazard", "site.toml", "--out", "site.toml"], "--out: site.toml must be a folder, but is a file."),
    ],
)
def test_a_wrong_request_under_a_hazard_is_refused(
    ended: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
) -> None:
    monkeypatch.chdir(ended)
    refused(activefail("fragility", "run", "--code", ".", *options), message)


def test_a_design_under_pulses_of_a_file_needs_no_value_of_the_variable_that_is_free(
    ended: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    rows = "".join(f"{T},{V}\n" for T, V in zip(rng.uniform(1, 4, 100), rng.lognormal(-0.3, 0.3, 100), strict=True))
    (tmp_path / "pulses.csv").write_text("T_p,PGV\n" + rows)
    (tmp_path / "rows.toml").write_text('samples = "pulses.csv"\n[uncertainty]\ntest_data = 0.2\n')
    for option in ("--hazard", "--question"):
        options = (option, tmp_path / "rows.toml", "--free", "r", "--target", "0.2", "--json")
        result = activefail("design", ended / "run", "--code", ended, *options)
        assert result.code == 0, result.err
        assert "was not used" not in result.out
    with open_run(ended / "run", code=ended, write=True) as opened:
        found = opened.design(0.2, tmp_path / "rows.toml", free="r")
    # The required r is the 80 % quantile of PGV over the median capacity, with a margin for the verification.
    required = float(np.exp(-0.3 + math.hypot(0.3, 0.2) * ndtri(0.8))) / MEDIAN
    assert 0.9 * required < found.bearing["r"] < 1.6 * required


@pytest.mark.parametrize("command", [("fragility",), ("design", "--target", "0.1", "--free", "r"), ("sensitivity",)])
def test_a_hazard_that_cannot_be_asked_for_is_refused_with_its_file(
    ended: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    path = tmp_path / "bounds.toml"
    name, *options = command
    for bound in ("mu_lower = 0.8", "mu_upper = 1.2"):
        path.write_text(HAZARD + f"[properties]\n{bound}\n")
        result = activefail(name, ended / "run", *options, "--code", ended, "--hazard", path)
        refused(result, f"{path}: properties.{bound.split()[0]}: cannot be applied")
    (tmp_path / "pulses.csv").write_text("T_p,PGV\n1,1\n")
    path.write_text('samples = "pulses.csv"\n')
    if name == "fragility":
        result = activefail(name, ended / "run", "--code", ended, "--hazard", path)
        refused(result, f"{path}: r: requires a value, because the hazard is a table of pulses")


@pytest.mark.usefixtures("without_pictures")
def test_a_small_campaign_of_the_bearing_has_fragility_curves(tmp_path: Path, ended: Path) -> None:
    shutil.copy(ended / "uncertain.toml", tmp_path)
    (tmp_path / "made.toml").write_text(
        'sampling = { initial = 40, budget = 40 }\n[classifier]\nfeatures = "design"\n[validation]\nsize = 20\n'
    )
    (tmp_path / "bearing.toml").write_text(
        "T_b = 4.0\nmu = 0.06\nD_tot = 0.65\nh_sl_ratio = 0.6\nh_rim_ratio = 0.1\np = 45.0\nk = 2e9\n"
    )
    assert activefail("run", tmp_path / "made.toml", "--out", tmp_path / "run").code == 0
    result = activefail(
        "fragility", tmp_path / "run", "--bearing", tmp_path / "bearing.toml", "--hazard", tmp_path / "uncertain.toml",
        "--verify", "20", "--out", tmp_path / "out",
    )  # fmt: skip
    assert result.code == 0, result.err
    assert "given      T_b = 4 s, mu = 0.06" in result.out
    limits = "The bearing model is planar. Its rims do not yield, and there is no vertical ground motion."
    assert limits in result.out
    assert (tmp_path / "out" / "pelicun.csv").exists()
    # What the model leaves out belongs to every result.
    options = ("--question", tmp_path / "uncertain.toml", "--bearing", tmp_path / "bearing.toml", "--simulations", "10")
    assert limits in activefail("probability", tmp_path / "run", *options).out
    site = ("--hazard", tmp_path / "uncertain.toml", "--bearing", tmp_path / "bearing.toml")
    assert limits in activefail("sensitivity", tmp_path / "run", *site).out
    # Pulses of a file have no distribution of the bearing's variables beside them.
    (tmp_path / "pulses.csv").write_text("T_p,PGV\n2,1\n3,0.8\n4,1.2\n")
    (tmp_path / "rows.toml").write_text('samples = "pulses.csv"\n')
    rows = activefail("sensitivity", tmp_path / "run", "--hazard", tmp_path / "rows.toml", "--samples", "16")
    assert rows.code == 0, rows.err
