"""Failure probabilities as a user asks for them: a limit state, a campaign, a number with its interval."""

import html
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import activefail, refused
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import beta

from activefail.analyses.findings.estimates import rounded_up, upper_bound
from activefail.analyses.findings.status import estimate_of, read_status
from activefail.cli.analyses import site_of
from activefail.errors import InputError
from activefail.pages.explorer.jobs import Jobs
from activefail.pages.report.environment import probability
from activefail.record.run_folder import FolderStore
from activefail.run.opening import open_run
from activefail.space.shares import alike

CAMPAIGN = """
simulator = {{ python = "limit:{name}", margins = ["g"] }}
stop = {{ probability = "failure" }}
[space]
x = {{ distribution = "normal", mean = 0, sd = 1 }}
y = {{ distribution = "normal", mean = 0, sd = 1 }}
[sampling]
budget = {budget}
"""

LIMITS = """
def plane(design):
    return 3.0 - design["x"] + 0.1 * design["y"]

def reversed_sign(design):
    g = 1.5 - design["x"]
    return {"outcome": "failure" if g <= 0 else "safe", "margins": {"g": -g}}

def never(design):
    return 20.0 + design["x"]

def clipped(design):
    g = min(1.8 - design["x"] + 0.1 * design["y"], 1.0)
    return {"outcome": "failure" if g <= 0 else "safe", "margins": {"g": g}}
"""

TRUE = float(ndtr(-3.0 / 1.01**0.5))


@pytest.fixture(scope="module", autouse=True)
def one_worker() -> Iterator[None]:
    """Commands start one worker process: to start another takes longer than these simulations."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.cpu_count", lambda: 1)
        yield


def begun(folder: Path, name: str, budget: int = 60) -> Path:
    (folder / "limit.py").write_text(LIMITS)
    (folder / "made.toml").write_text(CAMPAIGN.format(name=name, budget=budget))
    return folder / "made.toml"


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plane")
    result = activefail("run", begun(folder, "plane"), "--out", folder / "run")
    assert result.code == 0, result.err
    assert "learned    failure from the margin g" in result.out
    assert "stop rule  met after" in result.out
    return folder


def test_the_command_tells_the_probability_with_its_interval_and_the_bound_without_a_model(ended: Path) -> None:
    result = activefail("probability", ended / "run", "--code", ended, "--simulations", "20")
    assert result.code == 0, result.err
    assert "probability of failure: 0.00" in result.out
    assert "with 90 % confidence" in result.out
    assert "bound      at most 0.18 with 90 % confidence, without a model: from the 12 simulations" in result.out
    assert "Method of the fresh simulations: importance sampling of the classifier's mistakes." in result.out
    assert "The interval assumes a limit state that is smooth" in result.out


def test_its_json_has_the_same_numbers_each_time(ended: Path) -> None:
    command = ("probability", ended / "run", "--code", ended, "--simulations", "20", "--confidence", "0.95", "--json")
    one, other = (json.loads(activefail(*command).out) for _ in range(2))
    assert one == other
    found = one["outcomes"]["failure"]
    assert found["low"] <= found["probability"] <= found["high"]
    assert found["low"] <= TRUE <= found["high"]
    assert found["probability"] == pytest.approx(TRUE, rel=0.1)
    assert (found["confidence"], found["simulations"], found["learned_from"]) == (0.95, 20, "g")
    assert found["failures_seen"] >= 1
    assert found["method"] == "importance sampling of the classifier's mistakes"
    assert found["bound_without_model"]["one_sided"] is True
    assert activefail("export", ended / "run", "--csv", ended / "all.csv").code == 0
    origins = {line.split(",")[2] for line in (ended / "all.csv").read_text().splitlines()[1:]}
    assert origins == {"seed", "active", "check"}


def test_an_outcome_without_a_boundary_is_refused(ended: Path) -> None:
    for outcome in ("safe", "collapse"):
        result = activefail("probability", ended / "run", "--code", ended, "--outcome", outcome)
        refused(result)
        assert f"outcome: must be one of failure, got '{outcome}'" in result.err


def test_a_margin_of_the_wrong_sign_is_not_learned_from_and_the_reason_is_told(tmp_path: Path) -> None:
    result = activefail("run", begun(tmp_path, "reversed_sign", 16), "--out", tmp_path / "run")
    assert result.code == 0, result.err
    assert "learned    failure from the outcomes; the margin g is not used: its sign contradicts" in result.out
    assert "exactly beyond the boundary; stop.probability cannot end the campaign\n" in result.out
    reason = "it does not show on which side of the boundary a design lies; stop.probability cannot end the campaign\n"
    status = activefail("status", tmp_path / "run").out
    assert f"failure from the outcomes; the margin g is not used: {reason}" in status


@pytest.mark.slow
def test_a_clipped_margin_is_named_as_the_reason_why_the_campaign_goes_on_to_its_budget(tmp_path: Path) -> None:
    result = activefail("run", begun(tmp_path, "clipped", 44), "--out", tmp_path / "run")
    assert result.code == 0, result.err
    reason = (
        "; this margin is clipped at its largest value and does not show a failure behind it, so stop.probability "
        "cannot end the campaign"
    )
    assert "stop rule" not in result.out
    assert reason in result.out
    status = activefail("status", tmp_path / "run")
    assert status.code == 0, status.err
    assert "44 of 44" in status.out
    assert "learned    failure from the margin g" in status.out
    assert reason in status.out
    result = activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "10")
    assert result.code == 0, result.err
    assert "The margin g is clipped at its largest value." in result.out
    assert activefail("export", tmp_path / "run", "--csv", tmp_path / "all.csv").code == 0
    # The check that contradicts nothing is made, and made again.
    assert (tmp_path / "all.csv").read_text().count(",check,") >= 16


def test_where_no_failure_was_seen_the_estimate_says_so_and_the_bound_is_wide(tmp_path: Path) -> None:
    result = activefail("run", begun(tmp_path, "never", 16), "--out", tmp_path / "run")
    assert result.code == 0, result.err
    assert "stop rule  cannot be met: the probability of failure, 0 under the classifier, is below 2e-07" in result.out
    result = activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "10")
    assert result.code == 0, result.err
    assert "interval   0 to 0.18, without a model; 0 to " in result.out
    assert "bound      at most 0.18 with 90 % confidence, without a model" in result.out
    found = json.loads(
        activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "10", "--json").out
    )["outcomes"]["failure"]
    assert found["high"] == pytest.approx(1.0 - 0.1 ** (1.0 / 12.0))
    assert found["high_under_classifier"] < 1e-6
    assert "No simulation ended in failure: the estimate is the classifier's extrapolation" in result.out
    assert "None of the campaign's 16 simulations ended in failure" in result.err


def test_a_probability_and_its_interval_have_equal_digits() -> None:
    assert alike(1.2194e-4, 1.19e-4, 2.4e-4) == ["1.22·10⁻⁴", "1.19·10⁻⁴", "2.40·10⁻⁴"]
    assert alike(4.1e-4, 5e-6, 84.38e-4) == ["4.10·10⁻⁴", "5.00·10⁻⁶", "0.00844"]
    assert alike(4.1e-5, 0.0, 84.38e-5) == ["4.10·10⁻⁵", "0", "8.44·10⁻⁴"]
    assert alike(0.0312, 0.03, 0.5) == ["0.0312", "0.0300", "0.5000"]
    assert alike(0.99971, 0.9) == ["0.999710", "0.900000"]
    assert alike(0.0, 0.0, 2.5e-7) == ["0", "0", "2.50·10⁻⁷"]
    assert alike(0.99971, 0.9, 1.0 - 1e-9, 1.0) == ["0.999710", "0.900000", "> 0.999999", "1.000000"]
    assert alike(1.0, 0.9, 1.0) == ["1.0000", "0.9000", "1.0000"]


_NUMBER = re.compile(r"(< |> )?(\d+(?:\.\d+)?)?(?:·?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?")


def read(text: str) -> tuple[float, int]:
    """The number that a text shows, and whether it is less (-1) or more (1) than that."""
    match = _NUMBER.fullmatch(text)
    assert match is not None
    exponent = int((match[3] or "⁰").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
    return float(match[2] or 1.0) * 10.0**exponent, {None: 0, "< ": -1, "> ": 1}[match[1]]


@given(st.lists(st.one_of(st.floats(-8.0, 0.0), st.floats(0.0, 8.0)), min_size=3, max_size=3))
def test_the_ends_of_an_interval_are_shown_in_order(logits: list[float]) -> None:
    low, middle, high = sorted(10.0**x if x < 0.0 else 1.0 - 10.0**-x for x in logits)
    for texts in (np.array(alike(middle, low, high))[[1, 0, 2]], [probability(p) for p in (low, middle, high)]):
        shown = [read(text) for text in texts]
        assert shown == sorted(shown)


def test_the_bound_is_that_of_clopper_and_pearson_and_never_rounded_down() -> None:
    for hits, draws in ((0, 12), (1, 12), (6, 12), (2, 60)):
        assert upper_bound(hits, draws, 0.9) == pytest.approx(beta.ppf(0.9, hits + 1, draws - hits))
    assert upper_bound(12, 12, 0.9) == upper_bound(0, 0, 0.9) == 1.0
    assert [rounded_up(share) for share in (0.1746, 0.17, 0.00123, 0.999, 0.0, 1.0)] == [
        "0.18",
        "0.17",
        "0.0013",
        "1",
        "0",
        "1",
    ]


def test_before_the_initial_design_is_finished_nothing_is_estimated(tmp_path: Path) -> None:
    file = begun(tmp_path, "plane")
    file.write_text(file.read_text().replace("budget = 60", "initial = 30\nbudget = 30"))
    assert activefail("run", file, "--out", tmp_path / "run", "--budget", "30").code == 0
    path = tmp_path / "run" / "journal"
    batches = [match.start() for match in re.finditer(rb'activefail [0-9a-f]{64} \d+ \["batch"', path.read_bytes())]
    os.truncate(path, batches[20])
    result = activefail("probability", tmp_path / "run", "--code", tmp_path)
    assert "has not finished its initial design; there is nothing to estimate yet" in result.err
    assert result.code == 2


def test_status_says_what_was_learned_from_and_the_probability(ended: Path, tmp_path: Path) -> None:
    shutil.copytree(ended, tmp_path, dirs_exist_ok=True)
    remembered(tmp_path / "run", None)
    result = activefail("status", tmp_path / "run")
    assert result.code == 0, result.err
    assert "learner    regression of the margin g on design features" in result.out
    assert (
        "learned    failure from the margin g (mean log probability of the true side of a left-out design:"
        in result.out
    )
    assert "stop rule  met" in result.out
    assert "--ignore-stop" in result.out
    assert "estimate   probability 0.00" in result.out
    assert activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "20").code == 0
    numbers = read_status(tmp_path / "run").estimates["failure"]
    third = activefail("status", tmp_path / "run").out.splitlines()[2]
    probability = alike(numbers["probability"])[0]
    assert third.startswith(f"estimate   probability of failure {probability}, 90 % interval ")
    assert "from 20 fresh simulations; recall at least " in third
    assert "contradict" not in third
    remembered(tmp_path / "run", {**numbers, "contradictions_where_sure": 2})
    third = activefail("status", tmp_path / "run").out.splitlines()[2]
    assert third.endswith("; fresh simulations contradict the classifier where it was sure: continue the campaign")


def remembered(folder: Path, estimate: Any) -> None:
    """Put an estimate into a record, as the last one of its failure."""
    with FolderStore.open(folder, write=True) as store:
        store.remember(estimate_of("failure", store.digest), estimate)


def test_an_estimate_of_fewer_simulations_is_not_shown_after_the_campaign_went_on(ended: Path, tmp_path: Path) -> None:
    shutil.copytree(ended, tmp_path, dirs_exist_ok=True)
    more = str(read_status(tmp_path / "run").summary.done + 1)
    assert activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "10").code == 0
    assert "10 fresh simulations" in activefail("status", tmp_path / "run").out
    assert activefail("resume", tmp_path / "run", "--code", tmp_path, "--budget", more, "--ignore-stop").code == 0
    assert "fresh simulations; recall" not in activefail("status", tmp_path / "run").out


@pytest.mark.usefixtures("without_pictures")
def test_the_report_leads_with_the_probability_and_draws_the_failure_domain(ended: Path, tmp_path: Path) -> None:
    shutil.copytree(ended, tmp_path, dirs_exist_ok=True)
    assert activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "20").code == 0
    numbers = read_status(tmp_path / "run").estimates["failure"]
    assert activefail("report", tmp_path / "run").code == 0
    page = (tmp_path / "run" / "report.html").read_text()
    lead = page[page.index('aria-label="Summary"') : page.index('<section id="run"')]
    probability, low, high = alike(numbers["probability"], numbers["low"], numbers["high"])
    assert f"<b>{probability}</b> ({low} to {high} with 90 % confidence" in lead
    section = page[page.index('<section id="probability"') : page.index('<div id="learning"')]
    assert section.count("<svg") == 2
    index = re.search(r"reliability index β = ([\d.]+), probability ([\d.]+)", section)
    assert index is not None
    assert float(index[1]) == pytest.approx(3.0 / 1.01**0.5, abs=0.03)
    assert float(index[2]) == pytest.approx(ndtr(-float(index[1])), rel=0.05)
    assert "Gaussian process regression of the margin g, matern52 covariance" in page
    assert "by the expected doubt after the next simulation" in page
    assert "by the criterion" not in page
    assert "Not finished" not in page
    assert " check far from all others" in page
    assert "correlation falls to 52 %" in page


def test_a_campaign_without_margins_is_told_that_its_rule_is_never_met(tmp_path: Path) -> None:
    file = begun(tmp_path, "plane", 14)
    file.write_text(file.read_text() + '[classifier]\nlearns = "outcomes"\n')
    (tmp_path / "limit.py").write_text(LIMITS.replace("return 3.0", "return 1.0"))
    result = activefail("run", file, "--out", tmp_path / "run")
    assert result.code == 0, result.err
    assert "a boundary that is learned from outcomes alone never meets this rule" in result.err


def test_whole_numbers_are_checked_in_python_too(ended: Path, tmp_path: Path) -> None:
    shutil.copytree(ended, tmp_path, dirs_exist_ok=True)
    with open_run(tmp_path / "run", code=tmp_path) as opened:
        for number, fault in ((float("nan"), "a whole number, got nan"), (30.5, "a whole number"), (1, "at least")):
            with pytest.raises(InputError, match=f"budget: must be {fault}"):
                opened.take(budget=number)
            with pytest.raises(InputError, match=f"simulations: must be {fault}"):
                opened.probability(number)


def test_a_probability_that_no_design_reaches_is_not_certified(tmp_path: Path) -> None:
    # The search ends where the probability outside is 1e-8, though the bounds allow designs farther out.
    (tmp_path / "limit.py").write_text('def far(design):\n    return 6.8 - (design["x"] + design["y"]) / 2**0.5\n')
    text = CAMPAIGN.format(name="far", budget=32).replace("[sampling]", "[sampling]\nreach = 1e-12")
    (tmp_path / "far.toml").write_text("seed = 2\n" + text)
    result = activefail("run", tmp_path / "far.toml", "--out", tmp_path / "run")
    assert result.code == 0, result.err
    assert "stop rule  cannot be met: the probability of failure, " in result.out
    result = activefail("probability", tmp_path / "run", "--code", tmp_path, "--simulations", "20", "--json")
    numbers = json.loads(result.out)["outcomes"]["failure"]
    assert numbers["low"] <= ndtr(-6.8) <= numbers["high_under_classifier"]
    assert numbers["high_under_classifier"] >= 1e-8


def test_the_explorer_shows_the_probability_and_offers_the_design_point(ended: Path) -> None:
    stages = list[str]()
    with open_run(ended / "run") as opened:
        failure = opened.failure(stages.append)
        assert failure is not None
        assert failure.is_known
        # What the campaign knew on its way is kept.
        assert not [stage for stage in stages if stage.startswith("learning from")]
        assert len(failure.simulations) > 3
        assert failure.simulations[-1] == len(opened.history)
        assert failure.low[-1] < TRUE < failure.high[-1]
    # By the command's way: it predicts by the saved state until this is asked.
    with Jobs() as jobs:
        shown = site_of(ended / "run", jobs).one.failure({})
    assert shown.count("<svg") == 2
    start = json.loads(html.unescape(re.findall(r'data-fills value="(.*?)"', shown)[0]))
    assert [*start.values()] == pytest.approx(failure.point.X)


def test_a_campaign_that_asks_for_no_probability_has_no_such_section(tmp_path: Path) -> None:
    file = begun(tmp_path, "plane", 16)
    settings = file.read_text().replace('stop = { probability = "failure" }\n', "")
    file.write_text(
        settings.replace("budget = 16", "initial = 12\nbudget = 13") + '[classifier]\nlearns = "outcomes"\n'
    )
    (tmp_path / "limit.py").write_text(LIMITS.replace("return 3.0", "return 1.0"))
    assert activefail("run", file, "--out", tmp_path / "run").code == 0
    with open_run(tmp_path / "run") as opened:
        assert opened.failure() is None
