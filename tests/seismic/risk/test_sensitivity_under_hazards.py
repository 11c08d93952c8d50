"""Sensitivity under a hazard: pulses are integrated out, and properties have their bounds."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail
from scipy.special import ndtri

from activefail import open_run
from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.sensitivity.calculation import sensitivity
from activefail.analyses.sensitivity.sobol import Estimate
from activefail.campaign.assembly import Campaign
from activefail.campaign.inquiry import Inquiry
from activefail.run.run import Run
from activefail.seismic.bearing.pulse import velocity_of
from activefail.seismic.hazard.hazard import read_hazard
from activefail.space.space import Array

CAMPAIGN = """
simulator = { python = "blocks:reserve", margins = ["reserve"] }
sampling = { initial = 16, budget = 16 }
[classifier]
features = "design"
[space]
mu = { low = 0.02, high = 0.12 }
D_tot = { low = 0.4, high = 0.9, unit = "m" }
T_p = { low = 1.0, high = 6.0, unit = "s" }
A_p = { low = 0.1, high = 1.0, unit = "g" }
"""

BLOCKS = """
def reserve(design):
    return design["D_tot"] + 3.0 * design["mu"] - 0.2 * design["A_p"] * design["T_p"]
"""

HAZARD = """
[pulse_period]
median_s = 3.0
dispersion = 0.4
definition = "acceleration"
[pgv]
median_m_s = 0.6
dispersion = 0.3
[properties]
mu_lower = 0.5
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sensitivity")
    (folder / "blocks.py").write_text(BLOCKS)
    (folder / "made.toml").write_text(CAMPAIGN)
    (folder / "hazard.toml").write_text(HAZARD)
    (folder / "fixed.toml").write_text("D_tot = 0.6\n")
    result = activefail("run", folder / "made.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    return folder


@pytest.fixture(scope="module")
def run(home: Path) -> Iterator[Run]:
    with open_run(home / "run", code=home) as opened:
        yield opened


@pytest.fixture(scope="module")
def campaign(run: Run) -> Campaign:
    return run.campaign


def alone(boundary: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """One boundary as all boundaries of a classifier."""
    return lambda X: boundary(X)[:, None]


def contains(estimate: Estimate, true: float) -> bool:
    return estimate.low <= true <= estimate.high


def additive_in_the_design(X: Array) -> Array:
    """A probability that is linear in the design; the pulses add an odd term, which cancels in the mean."""
    mu, D_tot, T_p, A_p = X.T
    return np.asarray(ndtri(0.5 - 2.0 * mu - 0.3 * D_tot + 0.1 * np.tanh(np.log(velocity_of(A_p, T_p) / 0.6))))


def test_under_a_hazard_the_pulses_are_integrated_out_and_properties_have_their_bound(
    campaign: Campaign, home: Path
) -> None:
    hazard = read_hazard(home / "hazard.toml")
    found = sensitivity(Inquiry.of_hazard(campaign, hazard, {}), alone(additive_in_the_design), "failure", 256, 0.99)
    # The lower bound halves friction, and with it the effect.
    parts = {"mu": 1.0**2 * 0.1**2 / 12.0, "D_tot": 0.3**2 * 0.5**2 / 12.0}
    assert [index.name for index in found.indices] == ["D_tot", "mu"]
    for name, first, total in found.indices:
        true = parts[name] / sum(parts.values())
        assert contains(first, true)
        assert contains(total, true)
    assert found.probability == pytest.approx(0.5 - 0.07 - 0.3 * 0.65, abs=3e-3)
    moves = {move.name: move for move in found.moves}
    assert list(moves) == ["D_tot", "mu"]
    assert (moves["mu"].low, moves["mu"].value, moves["mu"].high) == pytest.approx((0.03, 0.07, 0.11))
    assert moves["mu"].at_low - found.probability == pytest.approx(0.04, abs=1e-6)
    assert moves["D_tot"].at_high - found.probability == pytest.approx(-0.3 * 0.2, abs=1e-6)
    assert found.is_given_designs
    assert any("friction × 0.5" in note for note in found.notes)
    # Friction below 0.04 is halved to less than the campaign's 0.02; pulses lie outside too.
    assert found.outside > 0.2


def test_a_variable_with_a_value_has_no_index_and_is_still_moved_alone(campaign: Campaign, home: Path) -> None:
    hazard = read_hazard(home / "hazard.toml")
    one, none = (
        sensitivity(Inquiry.of_hazard(campaign, hazard, values), alone(additive_in_the_design), "failure", 16)
        for values in ({"D_tot": 0.8}, {"D_tot": 0.8, "mu": 0.05})
    )
    assert [index.name for index in one.indices] == ["mu"]
    assert {move.name: move.value for move in one.moves} == pytest.approx({"mu": 0.07, "D_tot": 0.8})
    assert one.probability == pytest.approx(0.5 - 0.07 - 0.24, abs=3e-3)
    assert (none.indices, none.samples) == ((), 0)
    assert len(none.moves) == 2
    assert any("All variables of the design have values" in note for note in none.notes)


def test_many_rows_of_pulses_are_thinned_with_their_weights(campaign: Campaign, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pgv, period, weight = rng.lognormal(-0.5, 0.4, 3000), rng.lognormal(1.0, 0.4, 3000), rng.random(3000)
    rows = "".join(f"{t},{v},{w}\n" for t, v, w in zip(period, pgv, weight, strict=True))
    (tmp_path / "pulses.csv").write_text("T_p,PGV,weight\n" + rows)
    (tmp_path / "rows.toml").write_text('samples = "pulses.csv"\n')
    hazard, base = read_hazard(tmp_path / "rows.toml"), {"mu": 0.05, "D_tot": 0.6}

    def fails(X: Array) -> Array:
        return np.asarray(5.0 * np.log(velocity_of(X[:, 3], X[:, 2]) / 0.9))

    found = sensitivity(Inquiry.of_hazard(campaign, hazard, base), alone(fails), "failure")
    true = classifier_probability(fails, hazard.question(campaign.space, base))
    assert 0.1 < true < 0.4
    assert found.probability == pytest.approx(true, abs=2e-3)
    assert found.pulses == 128


def test_the_command_leads_with_one_variable_at_a_time_under_a_hazard(home: Path, tmp_path: Path) -> None:
    words = ("sensitivity", home / "run", "--code", home, "--hazard", home / "hazard.toml")
    done = activefail(*words, "--fixed", home / "fixed.toml", "--samples", "16", "--out", tmp_path)
    assert done.code == 0, done.err
    assert done.out.index("at its 10 % quantile") < done.out.index("Sobol' indices")
    assert "with all variables at their base values, without an interval" in done.out
    assert {"one_at_a_time.svg", "indices.png"} <= {file.name for file in tmp_path.iterdir()}
    found = json.loads(activefail(*words, "--bearing", home / "fixed.toml", "--samples", "16", "--json").out)
    assert found["output"] == "probability given the design"
    assert found["interval"] is None
    assert "without simulation" in found["interval_reason"]
    assert [index["variable"] for index in found["indices"]] == ["mu"]
    moves = {move["variable"]: move for move in found["one_at_a_time"]}
    assert moves["D_tot"]["value"] == 0.6
    # More capacity and more friction help.
    assert all(move["probability_at_low"] > move["probability_at_high"] for move in moves.values())
    csv = activefail(*words, "--samples", "16", "--csv", "-")
    assert csv.out.startswith("variable,unit,first,")
    assert len(csv.out.splitlines()) == 3


def test_the_method_takes_a_hazard_as_an_object(run: Run, home: Path) -> None:
    hazard = run.sensitivity(read_hazard(home / "hazard.toml"), fixed={"mu": 0.05}, samples=16)
    assert [index.name for index in hazard.indices] == ["D_tot"]


@pytest.mark.parametrize("fixed", [[], ["--fixed", "fixed.toml"]])
def test_pulses_of_a_file_have_indices_without_values_of_other_variables(
    home: Path, monkeypatch: pytest.MonkeyPatch, fixed: list[str]
) -> None:
    monkeypatch.chdir(home)
    Path("pulses.csv").write_text("T_p,PGV\n2,5\n3,6\n5,7.5\n")
    Path("rows.toml").write_text('samples = "pulses.csv"\n')
    options = ("--code", ".", *fixed, "--samples", "16", "--json")
    result = activefail("sensitivity", "run", "--hazard", "rows.toml", *options)
    assert result.code == 0, result.err
    indices = {index["variable"] for index in json.loads(result.out)["indices"]}
    assert indices == ({"mu"} if fixed else {"mu", "D_tot"})
