"""Comparisons over seeds: what is compared, that nothing is done twice, and what an interruption leaves."""

import json
from concurrent.futures import Future
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from pounding import CODE, SIMULATOR

from activefail.analyses.comparison.seeds import (
    STATIC,
    Arm,
    ArmScore,
    ComparisonPlan,
    Point,
    compare_seeds,
    curves,
    simulations_to_reach,
)
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import open_campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.pages.report.comparison import comparison_json, comparison_lines, comparison_text, write_comparison

pytestmark = pytest.mark.slow

TEXT = 'seed = 3\nsampling = { initial = 30, budget = 35, batch = 5 }\nclassifier.kernel = "matern52"\n'
SETTINGS = parse_settings(TEXT + SIMULATOR, "made.toml")
PLAN = ComparisonPlan(SETTINGS, 2, ("entropy",), ("decorrelated", "design"), (30, 60), 100, code=CODE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("comparison")


class Here:
    """Stands for a pool of processes where these are not the claim: each takes two seconds to load the libraries."""

    def __init__(self, processes, kept):
        pass

    def submit(self, function, *args):
        call = Future()
        call.set_result(function(*args))
        return call

    def ask_to_stop(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        pass


@pytest.fixture
def here(monkeypatch):
    monkeypatch.setattr("activefail.analyses.comparison.seeds.ProcessPool", Here)


@pytest.fixture(scope="module")
def stopped_and_continued(folder):
    """The times of the scores' files after a stop and after the rest, and all scores."""

    def times():
        return {path: path.stat().st_mtime_ns for path in (folder / "scores").glob("*.json")}

    done = []
    assert compare_seeds(PLAN, folder, 2, done=lambda n, _: done.append(n), stop=lambda: len(done) >= 3) is None
    before = times()
    with mock.patch("activefail.analyses.comparison.seeds.ProcessPool", Here):
        scores = compare_seeds(PLAN, folder, 1)
    return before, times(), scores


@pytest.fixture(scope="module")
def scores(stopped_and_continued):
    return stopped_and_continued[2]


def test_every_seed_has_every_arm_scored_where_it_should_be(scores):
    rows = [(s.arm.seed, s.arm.features, s.arm.sampling, s.simulations) for s in scores]
    expected = [
        (seed, features, sampling, n)
        for seed in (3, 4)
        for features in ("decorrelated", "design")
        for sampling, n in (*(("entropy", n) for n in range(30, 36)), (STATIC, 30), (STATIC, 60))
    ]
    assert rows == expected
    assert all(0.5 < s.measures["accuracy"] <= 1.0 for s in scores)


def test_samplings_of_one_seed_share_the_test_set_and_their_features_the_static_design(folder, scores):
    simulator = Campaign.of(SETTINGS, CODE).simulator
    with open_campaign(folder / "designs", write=False) as (_, store):
        X, answers = store.read_set("test-100-0")
        assert np.array_equal(answers.outcome, simulator.run(X).outcome)
        assert len(store.read_set("static-60-seed4-0")[0]) == 60
        assert not np.array_equal(store.read_set("static-60-seed4-0")[0], store.read_set("static-60-seed3-0")[0])


def test_a_comparison_given_again_is_read_not_computed(folder, scores):
    stages = []
    assert compare_seeds(PLAN, folder, 2, stages.append) == scores
    assert stages == []


@pytest.mark.exhaustive
def test_an_arm_whose_scores_are_lost_is_scored_again_and_alike(folder, scores):
    paths = sorted((folder / "scores").glob("design-static-30-*.json"))
    for path in paths:
        path.unlink()
    assert compare_seeds(PLAN, folder, 2) == scores


@pytest.mark.usefixtures("here")
def test_more_arms_leave_those_that_were_scored_alone(folder, scores):
    before = {path: path.stat().st_mtime_ns for path in (folder / "scores").glob("*.json")}
    extra = compare_seeds(replace(PLAN, static=(30, 45, 60), features=("decorrelated",)), folder, 1)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert {s.simulations for s in extra if s.arm.sampling == STATIC} == {30, 45, 60}


def test_a_folder_of_another_campaign_is_refused(folder, scores):
    other = replace(PLAN, settings=SETTINGS.changed({"sampling.batch": 10}))
    with pytest.raises(InputError, match="another campaign or test set"):
        compare_seeds(other, folder, 2)
    with pytest.raises(InputError, match="another campaign or test set"):
        compare_seeds(replace(PLAN, test=110), folder, 2)


@pytest.mark.usefixtures("here")
def test_a_stop_keeps_what_was_scored_and_the_same_command_goes_on(tmp_path, stopped_and_continued):
    before, after, scores = stopped_and_continued
    assert 3 <= len(before) < len(after) == len(PLAN.arms())
    assert before.items() <= after.items()
    of_decorrelated = [score for score in scores if score.arm.features == "decorrelated"]
    assert compare_seeds(replace(PLAN, features=("decorrelated",)), tmp_path, 1) == of_decorrelated


def test_the_page_has_every_median_and_the_table_every_score(tmp_path, scores):
    page = write_comparison(PLAN, scores, tmp_path).read_text(encoding="utf-8")
    for (features, sampling), points in curves(scores, "accuracy").items():
        for point in points:
            assert f"| {features} | {sampling} | {point.simulations} | {np.median(point.values):.4f}" in page
    assert len((tmp_path / "scores.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(scores)
    assert "nan" not in page
    assert len(comparison_lines(scores)) == 1 + 2 * 8
    for name in ("accuracy.svg", "accuracy.png", "log_score.png"):
        assert (tmp_path / name).stat().st_size > 5000


def test_its_json_has_the_spread_of_each_measure_over_the_seeds(scores):
    shown = comparison_json(PLAN, scores)
    for row in shown["over_seeds"]:
        of_seeds = [
            score.measures["log_score"]
            for score in scores
            if (score.arm.features, score.arm.sampling) == (row["features"], row["sampling"])
            and score.simulations == row["simulations"]
        ]
        assert len(of_seeds) == PLAN.seeds
        expected = {"median": np.median(of_seeds), "lowest": min(of_seeds), "highest": max(of_seeds)}
        assert row["measures"]["log_score"] == expected
    assert len(shown["over_seeds"]) * PLAN.seeds == len(shown["scores"]) == len(scores)


def made(sampling, n, accuracies):
    return [ArmScore(Arm("decorrelated", sampling, n, seed), n, {"accuracy": a}) for seed, a in enumerate(accuracies)]


def test_simulations_to_reach_a_level_are_interpolated_in_their_logarithm():
    points = [Point(250, np.array([0.90, 0.92])), Point(1000, np.array([0.93, 0.95]))]
    assert simulations_to_reach(points, 0.91) == 250
    assert simulations_to_reach(points, 0.925) == pytest.approx(500)
    assert simulations_to_reach(points, 0.96) is None


def test_curves_hold_the_seeds_of_each_size_in_order_of_size():
    actual = curves([*made("entropy", 60, [0.9, 0.8]), *made("entropy", 30, [0.7, 0.6])], "accuracy")
    assert [(p.simulations, p.values.tolist()) for p in actual["decorrelated", "entropy"]] == [
        (30, [0.7, 0.6]),
        (60, [0.9, 0.8]),
    ]


def test_a_sampling_that_never_gets_there_is_said_to_need_more(scores):
    best = [replace(s, measures=s.measures | {"accuracy": 1.0}) if s.arm.sampling == "entropy" else s for s in scores]
    assert "> 60" in comparison_text(PLAN, best)
    assert "Target boundary: failure. Accuracy refers to the failure boundary." in comparison_text(PLAN, best)


def test_a_measure_that_is_not_defined_is_a_dash_and_survives_the_file(folder, scores, tmp_path):
    path = folder / "scores" / f"{PLAN.arms()[0].name}.json"
    rows = json.loads(path.read_text(encoding="utf-8"))
    rows[0]["measures"]["recall_small"] = float("nan")
    (tmp_path / "scores").mkdir()
    (tmp_path / "comparison.toml").write_bytes((folder / "comparison.toml").read_bytes())
    for other in (folder / "scores").glob("*.json"):
        (tmp_path / "scores" / other.name).write_bytes(other.read_bytes())
    (tmp_path / "scores" / path.name).write_text(json.dumps(rows), encoding="utf-8")
    read = compare_seeds(PLAN, tmp_path, 1)
    assert np.isnan(read[0].measures["recall_small"])
    alone = [replace(s, measures=s.measures | {"recall_small": np.nan}) for s in scores]
    assert "| – |" in comparison_text(PLAN, alone)


def test_scores_are_saved_as_they_are(folder, scores):
    saved = json.loads((folder / "scores" / f"{PLAN.arms()[0].name}.json").read_text(encoding="utf-8"))
    assert [row["measures"] for row in saved] == [s.measures for s in scores[: len(saved)]]
