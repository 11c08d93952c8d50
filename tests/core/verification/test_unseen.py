"""Campaigns that never saw an outcome: they search for it, never meet their stop rule, and every command says so."""

import html
import json

import numpy as np
import pytest
from campaign.stub import given
from cases import some
from commandline import activefail
from pounding import NAMES, write_campaign
from rare import four_branch

from activefail.analyses.findings.summary import Summary
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.estimates.confidence_bounds import unseen_outcomes
from activefail.execution.local import ThreadExecutor
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.loop.progress import Observer
from activefail.loop.proposing import search_for_unseen
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.run.opening import create_run
from activefail.simulators.interface import Results


class FourBranch:
    """A series system of two standard normal variables, with 2.2 failures in a thousand designs."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("",), (), True

    def run(self, X):
        nothing = np.zeros(len(X))
        return Results((four_branch(X) < 0.0).astype(np.int8), nothing.astype(np.int8), np.empty((len(X), 0)), nothing)


class NeverFails(FourBranch):
    """The same, without failure."""

    def run(self, X):
        return Results(*(np.zeros(len(X), dtype=np.int8) for _ in range(2)), np.empty((len(X), 0)), np.zeros(len(X)))


def campaign_on(simulator, criterion="eavc", budget=60, extra="", seed=0):
    text = f"""
        seed = {seed}
        simulator = {{ python = "given:run", repeatable = true }}
        sampling = {{ initial = 30, budget = {budget}, batch = 5 }}
        classifier.features = "design"
        acquisition = {{ criterion = "{criterion}", boundary = "failure" }}
        {extra}
        space.x = {{ low = -6, high = 6, distribution = "truncated_normal", mean = 0, sd = 1 }}
        space.y = {{ low = -6, high = 6, distribution = "truncated_normal", mean = 0, sd = 1 }}
        """
    return Campaign.of(parse_settings(text, "rare"), simulator=simulator)


def taken(campaign, store=None):
    store, seen = store or MemoryStore(campaign.schema), []
    with ThreadExecutor(2) as executor:
        assert run(campaign, store, executor, campaign.settings.sampling.budget, Observer(progress=seen.append))
    return store, seen


def failures(store):
    return np.concatenate([batch.results.outcome for batch in store.batches]).sum()


@pytest.fixture(scope="module")
def searched():
    """A campaign that searched for a failure, its store, and its progress."""
    campaign = campaign_on(FourBranch())
    return campaign, *taken(campaign)


@pytest.mark.parametrize("criterion", some(["eavc", "globalmi", "entropy", "sur"], "eavc"))
def test_a_criterion_that_would_stay_among_the_safe_designs_is_set_aside_until_a_failure_was_seen(criterion, searched):
    store, seen = searched[1:] if criterion == "eavc" else taken(campaign_on(FourBranch(), criterion))
    first = np.concatenate([batch.results.outcome for batch in store.batches[:6]])
    assert first.sum() == 0, "the initial design holds a failure, so that there is nothing to search for"
    assert failures(store) > 0
    assert seen[0].unseen == ("safe", "failure")
    assert seen[6].unseen == ("failure",)
    assert seen[-1].unseen == ()


@pytest.mark.parametrize("asynchronous", [False, True])
def test_a_campaign_that_saw_no_failure_is_never_good_enough(asynchronous):
    campaign = campaign_on(NeverFails(), budget=40, extra="stop = { error = 0.05, simulations = 100, every = 1 }")
    settings = campaign.settings.changed({"sampling.asynchronous": asynchronous})
    campaign = Campaign.of(settings, simulator=NeverFails())
    store, seen = taken(campaign)
    assert sum(len(batch) for batch in store.batches) == 40
    assert store.set_names() == []
    assert not any(progress.stop_rule for progress in seen)
    assert seen[-1].unseen == ("failure",)


def test_the_search_begins_where_the_record_stands_and_ends_when_all_was_seen(searched):
    campaign, store, _ = searched
    classifier = current(campaign, store, write=False).classifier
    missing = search_for_unseen(campaign, History.of(store.batches[:6]), classifier)
    assert missing.outcomes == ("failure",)
    assert np.array_equal(missing.known, np.concatenate([batch.designs for batch in store.batches[:6]]))
    assert search_for_unseen(campaign, History.of(store.batches), classifier) is None


def test_the_same_campaign_searches_at_the_same_designs_again(searched):
    again, _ = taken(campaign_on(FourBranch(), budget=45))
    assert len(again.batches) == 9
    for a, b in zip(searched[1].batches[:9], again.batches, strict=True):
        assert np.array_equal(a.designs, b.designs)


def warning(outcomes, initial, chosen):
    counts = (np.array([*numbers], dtype=np.int64) for numbers in (initial, chosen, [0] * len(initial)))
    return Summary(given(), outcomes, 1, *counts, (), 0).unseen_warning


def test_the_warning_gives_the_bound_that_follows_from_the_initial_design():
    counts = np.array([20, 0, 5, 3])
    assert unseen_outcomes(("no_impact", "impact", "failure"), counts) == ("impact",)
    two = ("safe", "failure")
    assert warning(two, (20, 5, 0), (0, 0, 0)) == warning(two, (0, 0, 0), (0, 0, 0)) == ""
    text = warning(two, (30, 0, 0), (10, 0, 0))
    assert "None of the campaign's 40 simulations ended in failure. Its probability" in text
    assert "7.4 %" in text  # 1 − 0.1^(1/30)
    assert "without it). Until one of them does, no classifier can know where failure begins." in text
    assert "100 %" in warning(two, (0, 0, 0), (3, 0, 0))
    # A numerical failure may be one.
    assert "without it and 1 numerical failure)" in warning(two, (30, 0, 1), (10, 0, 0))
    assert "without them and 2 numerical failures)" in warning(("safe", "impact", "failure"), (30, 0, 0, 2), (0,) * 4)


MILD = 'simulator = { python = "mild:run", outcomes = ["no_impact", "impact", "failure"] }\n'


@pytest.fixture(scope="module")
def gentle(tmp_path_factory, simulations_in_this_process):
    """A campaign on buildings that nothing moves into each other, and what its commands say."""
    folder = tmp_path_factory.mktemp("gentle")
    file = folder / "gentle.toml"
    file.write_text(
        "sampling = { initial = 30, budget = 40, batch = 5 }\n"
        f"stop = {{ error = 0.05, simulations = 100, every = 1 }}\n{MILD}"
        + "".join(f"space.{name} = {{ low = 1, high = 1.5 }}\n" for name in NAMES)
    )
    (folder / "mild.py").write_text("def run(design):\n    return 'no_impact'\n")
    return folder / "run", activefail("run", file, "--out", folder / "run")


@pytest.mark.usefixtures("without_pictures")
def test_run_status_verify_and_report_say_which_outcomes_were_never_seen_and_what_follows(gentle, tmp_path):
    folder, result = gentle
    assert result.code == 0
    assert "stop rule  met" not in result.out
    assert "searching for impact and failure (not seen yet)" in result.out
    warning = "None of the campaign's 40 simulations ended in impact or failure. The probability of each over"
    page = tmp_path / "report.html"
    for one in (
        result,
        activefail("status", folder),
        activefail("verify", folder, "--simulations", "20", "--code", folder.parent),
    ):
        assert one.code == 0
        assert f"warning: {warning}" in one.err
        assert "7.4 %" in one.err
    assert activefail("report", folder, "--out", page).code == 0
    assert warning in html.unescape(page.read_text())
    assert activefail("export", folder, "--csv", tmp_path / "designs.csv").code == 0
    predicted = activefail("predict", folder, "--csv", tmp_path / "designs.csv", "--out", tmp_path / "predicted.csv")
    assert (predicted.code, f"warning: {warning}" in predicted.err) == (0, True)
    known = "classifier learned from 40 results (40 no_impact, 0 impact, 0 failure); verified error 0 %"
    assert predicted.out.startswith(known)
    words = ("--csv", tmp_path / "designs.csv", "--out", tmp_path / "predicted.csv", "--after", "39")
    said = activefail("predict", folder, *words).out
    assert said.startswith("classifier learned from 39 results (39 no_impact, 0 impact, 0 failure)\n")


def test_the_warning_comes_before_the_initial_design_is_done_too(gentle, tmp_path):
    home = gentle[0].parent
    with create_run(tmp_path / "run", home / "gentle.toml", code=home) as begun:
        assert begun.summary.unseen_warning == ""
        assert begun.take(budget=12).finished
    for one in (activefail("status", tmp_path / "run"), activefail("resume", tmp_path / "run", "--budget", "12")):
        assert "warning: None of the campaign's 12 simulations ended in impact or failure." in one.err
        assert "17.5 % (90 % confidence, from 12 initial designs" in one.err  # 1 − 0.1^(1/12)


def test_a_stop_rule_that_its_simulations_cannot_show_is_said_before_anything_is_simulated(gentle, tmp_path):
    file = tmp_path / "small.toml"
    write_campaign(file, "sampling = { initial = 4, budget = 4 }\nstop = { error = 0.005, simulations = 100 }\n")
    result = activefail("run", file, "--out", tmp_path / "run")
    assert result.code == 0
    assert "stop.simulations: with 100 simulations the first look cannot show an error below 3.0 %" in result.err
    assert "requires at least 598" in result.err


def test_nobody_reads_a_share_that_was_rounded_to_all_or_nothing():
    from activefail.space.shares import bounds_percent, interval_percent, percent

    assert [percent(p) for p in (0.5, 0.9995, 0.99996, 1.0, 0.0, 1e-5, 1e-12)] == [
        "50.0 %", "99.95 %", "99.996 %", "100 %", "0 %", "0.001 %", "< 0.000001 %",
    ]  # fmt: skip
    assert percent(1.0 - 1e-12) == "> 99.999999 %"
    assert interval_percent(0.0, 0.0327) == "0 to 3.27 %"
    assert bounds_percent(0.08754, 0.09751) == "8.75 to 9.76 %"
    assert bounds_percent(0.0, 0.0000121) == "0 to 0.002 %"
    assert bounds_percent(0.98, 0.99999) == "98.00 to 100 %"
    assert percent(json.loads("NaN")) == "–"
