"""Fragility curves against any variable of a simulator whose capacity is lognormal, from a campaign that learned it."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import activefail, refused
from scipy.special import ndtr, ndtri

from activefail.analyses.fragility.band import Interval
from activefail.run.opening import open_run

MEDIAN, BETA = 1.2, 0.3
"""Of the velocity at failure [m/s]; damage begins at exp(−0.3) of it."""
PER_AMPLITUDE = 1.5
"""Velocity of a pulse over amplitude and period [m/s²]."""

LIMIT = f"""
import math

def reserve(d):
    velocity = {PER_AMPLITUDE} * d["A_p"] * d["T_p"]
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


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fragility")
    (folder / "pulses.py").write_text(LIMIT)
    (folder / "made.toml").write_text(CAMPAIGN)
    result = activefail("run", folder / "made.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    return folder


def probability(levels: Any, median: float, beta: float) -> Any:
    return ndtr(np.log(np.asarray(levels) / median) / beta)


def test_a_curve_against_any_variable_integrates_over_the_others(ended: Path, tmp_path: Path) -> None:
    (tmp_path / "asked.toml").write_text('description = "one site"\n[space]\nT_p = { value = 2.0 }\n')
    with open_run(ended / "run", code=ended) as opened:
        found = opened.fragility(against="A_p", question=tmp_path / "asked.toml", bounds=(0.05, 3.0))
        strength = opened.fragility(against="r", fixed={"T_p": 2.0})
    one = found.boundaries[-1]
    median = MEDIAN / (PER_AMPLITUDE * 2.0)
    assert one.curve.probability == pytest.approx(probability(found.ladder.levels, median, BETA), abs=0.01)
    assert (found.ladder.levels[0], found.ladder.levels[-1]) == (pytest.approx(0.05), pytest.approx(3.0))
    assert found.title == "one site"
    falling = strength.boundaries[-1].curve
    assert not falling.rises
    # Fails where A_p exceeds the amplitude that r resists.
    levels = falling.ladder.levels
    assert falling.probability == pytest.approx(1.0 - probability(levels * median, 0.3, 0.8), abs=0.015)
    level = falling.capacity(0.1).level
    assert level == pytest.approx(0.3 * math.exp(-0.8 * ndtri(0.1)) / median, rel=0.05)


@pytest.mark.usefixtures("without_pictures")
def test_the_command_shows_a_curve_against_any_variable(
    ended: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("fragility", ended / "run", "--code", ended, "--against", "r", "--range", "0.5,2")
    result = activefail(*command, "--out", tmp_path)
    assert result.code == 0, result.err
    assert "fragility against r, under the design measure" in result.out
    assert "The curve is integrated over T_p, A_p." in result.out
    assert "intervals  none: every number is the classifier's" in result.out
    assert not (tmp_path / "pelicun.csv").exists()
    page = (tmp_path / "fragility.html").read_text()
    assert "<code>--verify 250</code> gives intervals" in page
    interval = Interval(1.0, 0.9, 1.1, 0.95, None)
    monkeypatch.setattr("activefail.analyses.fragility.findings.capacity_interval", lambda *_: interval)
    verified = activefail(*command, "--verify", "20", "--out", tmp_path / "verified")
    assert verified.code == 0, verified.err
    page = (tmp_path / "verified" / "fragility.html").read_text()
    assert "<code>activefail design</code> finds a design" in page
    assert "pelicun" not in page
    table = activefail(*command, "--csv", "-")
    assert table.out.startswith("r,kind,outside_design_space,p_damage,")
    verified = activefail(*command, "--verify", "20", "--json", "--outcome", "damage")
    numbers = json.loads(verified.out)["outcomes"]
    assert numbers["failure"]["verified"] == []
    assert 10 < sum(level["simulations"] for level in numbers["damage"]["verified"]) <= 20
    assert numbers["failure"]["risk"] is None
    assert numbers["failure"]["risk_reason"] == "a risk requires a hazard with annual rates"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "hazard, against: exactly one is required"),
        (["--against", "r", "--out", "run/simulations"], "is one of the run folder's own files"),
        (["--against", "r", "--out", "made.toml"], "--out: made.toml must be a folder, but is a file."),
        (["--against", "q"], "against: must be one of the uncertain variables (T_p, A_p, r), got 'q'."),
        (
            ["--against", "r", "--range", "2,1"],
            "bounds (--range): must be two finite numbers with `low < high`, got 2,1.",
        ),
        (["--against", "r", "--fixed", "fixed.toml"], "against: r has the value 1.1; leave it out of --fixed."),
        (["--against", "r", "--fixed", "pulse.toml"], "against: no variable besides r is uncertain"),
    ],
)
def test_a_wrong_request_is_refused(
    ended: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
) -> None:
    monkeypatch.chdir(ended)
    Path("fixed.toml").write_text("r = 1.1\n")
    Path("pulse.toml").write_text("T_p = 1.1\nA_p = 0.3\n")
    refused(activefail("fragility", "run", "--code", ".", *options), message)
