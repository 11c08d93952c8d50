"""What a lost run means: unknown, failure or impossible. Learner, stop rule and intervals read it from one place."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import given
from commandline import activefail
from explorer.conftest import site_of
from scipy.special import ndtr

from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.findings.estimates import ProbabilityFindings
from activefail.analyses.findings.summary import where_lost
from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.estimates.error import expected_error, verify
from activefail.estimates.estimate import plan_estimate
from activefail.estimates.hidden import hidden_places
from activefail.estimates.integral import BoundariesOf, OfBoundary, boundary_of, integral_of, integrate
from activefail.estimates.probability_estimator import Estimator, Existing
from activefail.estimates.surface import verify_surface
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import Learned, current
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.run.opening import open_run
from activefail.simulators.interface import NUMERICAL_FAILURE, RAISED, Results
from activefail.space.weighted import WeightedRows

DIES_BELOW = -2.0
IF_NONE, IF_ALL = 1.42e-3, 0.0241
"""P(3 − x − 0.1 y ≤ 0), and the probability of that or of y < −2 (10⁸ samples)."""


@dataclass(frozen=True)
class Dies:
    """A margin of two normal variables, whose solver gives up where the second one is low."""

    margins: tuple[str, ...] = ("g",)
    impossible: tuple[int, ...] = ()
    at: float = 3.0
    below: float = DIES_BELOW

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    def run(self, X):
        g = self.at - X[:, 0] - 0.1 * X[:, 1]
        lost = X[:, 1] < self.below
        outcome = np.where(lost, NUMERICAL_FAILURE, g <= 0.0).astype(np.int8)
        margins = np.where(lost, np.nan, g)[:, None] if self.margins else np.empty((len(X), 0))
        return Results(outcome, np.zeros(len(X), dtype=np.int8), margins, np.zeros(len(X)))


@dataclass(frozen=True)
class Noisy(Dies):
    """A solver that does not repeat."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def run(self, X):
        return super().run(X + np.column_stack([0.2 * self.rng.standard_normal(len(X)), np.zeros(len(X))]))


@dataclass(frozen=True)
class Beyond(Dies):
    """A solver that gives up around the boundary."""

    def run(self, X):
        g = self.at - X[:, 0] - 0.1 * X[:, 1]
        lost = (g <= 0.05) & (g > -0.3)
        outcome = np.where(lost, NUMERICAL_FAILURE, g <= 0.0).astype(np.int8)
        return Results(outcome, np.zeros(len(X), dtype=np.int8), np.where(lost, np.nan, g)[:, None], np.zeros(len(X)))


def settings_of(**changes):
    normal = {"distribution": "normal", "mean": 0.0, "sd": 1.0}
    keys = {
        "seed": 2,
        "space": {"x": normal, "y": normal},
        "sampling.initial": 16,
        "sampling.batch": 4,
        "sampling.budget": 48,
        "classifier.features": "design",
        "limits.numerical_failures": 1.0,
    }
    return given().changed(keys | {key.replace("__", "."): value for key, value in changes.items()})


def taken(simulator, /, **changes):
    settings = settings_of(**changes)
    campaign = Campaign.of(settings, simulator=simulator)
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, settings.sampling.budget)
    return campaign, store, current(campaign, store, write=False)


@pytest.fixture(scope="module")
def unknown() -> tuple[Campaign, MemoryStore, Learned]:
    return taken(Dies(), stop={"probability": "failure", "cov": 0.1})


def test_the_interval_reaches_the_probability_whatever_the_lost_runs_are(
    unknown: tuple[Campaign, MemoryStore, Learned],
) -> None:
    campaign, store, learned = unknown
    assert learned.classifier.unknown is not None
    held = 0
    with ThreadExecutor(1) as executor:
        estimator = Estimator(campaign, store, executor, learned.classifier, History.of(store.batches).last_iteration)
        for draw in range(1, 7):
            question = Question.of_space(campaign.space).drawn(draw)
            estimate = estimator.sample("failure", 50, question).estimate(0.9)
            held += estimate.low <= IF_NONE and estimate.high >= IF_ALL
    assert held == 6


def test_an_estimate_counts_the_runs_of_the_campaign_as_status_does_though_the_first_were_lost(
    unknown: tuple[Campaign, MemoryStore, Learned],
) -> None:
    campaign, store, learned = unknown
    history, question = History.of(store.batches), Question.of_space(campaign.space)
    lost_first = history[np.argsort(history.answered, kind="stable")]
    assert lost_first.leading_failures > 0
    with ThreadExecutor(1) as executor:
        estimator = Estimator(campaign, store, executor, learned.classifier, history.last_iteration)
        estimate = estimator.sample("failure", 10, question).estimate(0.9)
    findings = ProbabilityFindings.of(campaign, lost_first, learned.classifier, "failure", estimate, question)
    assert findings.learned == len(history)


def test_a_stop_rule_is_not_met_while_lost_runs_decide_the_probability(
    unknown: tuple[Campaign, MemoryStore, Learned],
) -> None:
    _, store, learned = unknown
    assert len(History.of(store.batches)) == 48
    assert not learned.looks.is_known


def test_runs_lost_at_random_widen_the_range_by_their_share_and_its_ends_are_in_order() -> None:
    campaign = Campaign.of(settings_of(), simulator=Dies())
    X = campaign.space.latin_hypercube(200, np.random.default_rng(0))
    lost = np.random.default_rng(1).random(200) < 0.15
    F, g = campaign.features(X), 2.0 - X[:, 0]
    classifier = Classifier(
        ("safe", "failure"),
        campaign.features,
        (MarginLatent(fit_margin(F[~lost], g[~lost])),),
        unknown=VariationalGP().learned(F, lost),
    )
    none, learned, every = (
        float(integrate(BoundariesOf(classifier, campaign.features, ends), campaign.space).probability[0])
        for ends in ("none", "learned", "all")
    )
    assert learned == pytest.approx(ndtr(-2.0), rel=0.05)
    assert none == pytest.approx(0.85 * ndtr(-2.0), rel=0.1)
    assert every - none == pytest.approx(lost.mean(), abs=0.02)


def test_where_runs_die_is_proposed_less_and_less() -> None:
    # From outcomes the dead half would look like the most uncertain one: no run there ever has a label.
    _, store, _ = taken(Dies(margins=(), at=0.5, below=0.0), sampling__budget=56)
    lost = ~History.of(store.batches).answered
    assert 6 <= lost[:16].sum() <= 10
    assert lost[-20:].sum() <= 4


def test_impossible_designs_leave_the_measure_and_break_no_limit() -> None:
    campaign, _, learned = taken(Dies(impossible=(0,)), sampling__initial=40, limits__numerical_failures=0.0)
    assert learned.classifier.unknown is None
    integral = integrate(BoundariesOf(learned.classifier, campaign.features), campaign.space)
    # x decides nearly alone, so the probability among the designs that exist is about that of all.
    true = ndtr(-3.0 / 1.01**0.5)
    assert integral.probability[0] == pytest.approx(true, rel=0.15)


def test_all_places_give_the_probability_among_the_designs_that_exist() -> None:
    # Half of the designs do not exist, whatever x is.
    campaign, _, learned = taken(Dies(impossible=(0,), at=1.0, below=0.0), sampling__initial=40)
    boundary = boundary_of(learned.classifier, campaign.features, "failure")
    question = Question.of_space(campaign.space)
    quick = classifier_probability(boundary, question, 4096)
    integral = integral_of(question, BoundariesOf(learned.classifier, campaign.features), campaign.space)
    assert quick == pytest.approx(integral.probability[0], rel=0.02)
    assert quick == pytest.approx(float(ndtr(-1.0 / 1.01**0.5)), rel=0.15)


def test_an_error_is_that_of_the_designs_that_exist() -> None:
    # A sixth of the designs do not exist.
    campaign, store, learned = taken(Dies(margins=(), impossible=(0,), at=0.3, below=-1.0), sampling__budget=60)
    with ThreadExecutor(1) as executor, one_thread():
        last = History.of(store.batches).last_iteration
        estimator = Estimator(campaign, store, executor, learned.classifier, last)
        error = verify(estimator, 200, 0.9)
    assert error.nonexistent > 0
    assert error.simulations + error.nonexistent == error.requested == 200
    X = campaign.space.random(20_000, np.random.default_rng(5))
    X = X[X[:, 1] >= -1.0]
    beyond = 0.3 - X[:, 0] - 0.1 * X[:, 1] <= 0.0
    wrong = (learned.classifier.latents[0].moments(campaign.features(X)).mean > 0.0) != beyond
    assert error.low <= wrong.mean() <= error.high < wrong.mean() + 0.05
    assert "gave no result" not in error.in_words[1]
    assert f"({error.nonexistent} designs that do not exist left out)" in error.in_words[1]
    # What it expects where designs do not exist, whose outcome it never saw, is no error.
    everywhere = replace(learned.classifier, impossible=None)
    assert expected_error(campaign, learned.classifier) < expected_error(campaign, everywhere)


def test_of_a_simulator_that_does_not_repeat_hardly_any_designs_that_probably_do_not_exist_are_simulated() -> None:
    # Half of the designs do not exist; from outcomes the classifier is never sure which, nor of what they would give.
    solver = Noisy(margins=(), impossible=(0,), at=0.3, below=0.0)
    noise = {"simulator": {"python": "made:run", "repeatable": False}}
    campaign, store, learned = taken(solver, sampling__budget=80, **noise)
    with ThreadExecutor(1) as executor, one_thread():
        last = History.of(store.batches).last_iteration
        estimator = Estimator(campaign, store, executor, learned.classifier, last)
        numbers = verify_surface(estimator, 200, 0.9).as_json()
    assert (numbers["simulations"] + numbers["nonexistent"], numbers["numerical_failures"]) == (200, 0)
    assert 0 < numbers["nonexistent"] <= 60


def test_a_design_that_does_not_exist_is_predicted_to_be_so(tmp_path: Path) -> None:
    (tmp_path / "limit.py").write_text(SIMULATOR)
    (tmp_path / "made.toml").write_text(
        'simulator = { python = "limit:run", margins = ["g"], lost = "impossible" }\n'
        "sampling = { initial = 40, budget = 40 }\nspace.x = { distribution = 'normal', mean = 0, sd = 1 }\n"
        "space.y = { distribution = 'normal', mean = 0, sd = 1 }\n"
    )
    (tmp_path / "designs.csv").write_text("x,y\n0.0,-2.5\n0.0,1.0\n4.0,1.0\n")
    assert activefail("run", tmp_path / "made.toml", "--out", tmp_path / "run").code == 0
    asked = ("--csv", tmp_path / "designs.csv", "--out", tmp_path / "predicted.csv", "--code", tmp_path)
    for after in ((), ("--after", "40")):
        result = activefail("predict", tmp_path / "run", *asked, *after)
        assert result.code == 0, result.err
        rows = (tmp_path / "predicted.csv").read_text().splitlines()[1:]
        assert rows[0] == "0.0,-2.5,does not exist,,,,"
        assert [row.split(",")[2] for row in rows[1:]] == ["safe", "failure"]
    with open_run(tmp_path / "run", code=tmp_path) as opened:
        one = site_of(opened.findings).one
        assert "This design does not exist with a probability of " in one.predict({"x": "0", "y": "-2.5"})
        assert "does not exist" not in one.predict({"x": "0", "y": "1"})


def test_hidden_failure_is_looked_for_where_designs_exist() -> None:
    space = settings_of().design_space()

    def exists(X):
        return X[:, :1]

    places = hidden_places(space, np.zeros((1, 2)), 0.01, 8, np.random.default_rng(0), exists=exists)
    assert (places[:, 0] > 0.0).all()


def test_an_interval_reaches_both_probabilities_if_only_fresh_simulations_are_lost() -> None:
    campaign, store, learned = taken(Dies(below=-9.0, at=2.0))
    assert learned.classifier.unknown is None
    campaign = Campaign.of(campaign.settings, simulator=Beyond(at=2.0))
    if_none, if_all, held = ndtr(-2.3 / 1.01**0.5), ndtr(-1.95 / 1.01**0.5), 0
    with ThreadExecutor(1) as executor:
        estimator = Estimator(campaign, store, executor, learned.classifier, History.of(store.batches).last_iteration)
        for draw in range(1, 7):
            estimate = estimator.sample("failure", 50, Question.of_space(campaign.space).drawn(draw)).estimate(0.9)
            assert estimate.lost is not None
            held += estimate.low <= if_none and estimate.high >= if_all
    assert held == 6


def test_the_share_of_designs_that_exist_has_an_interval_that_holds_where_the_classifier_is_wrong() -> None:
    held = 0
    for seed in range(40):
        exists = np.random.default_rng(seed).random(100) < 0.7
        for n in (100, 10_000):
            # All rows, or so many that hardly anything is known for certain.
            rows = WeightedRows(("x",), np.arange(float(n))[:, None], np.ones(n))
            plan = plan_estimate(lambda X: np.full(len(X), -50.0), rows, 100, np.random.default_rng(seed))
            known = Existing(OfBoundary(0.8, 0.0, 0.0), np.full(100, 0.8), exists, plan)
            middle, low, high = known.share(0.9)
            assert middle == pytest.approx(exists.mean())
            if n == 100:
                assert (low, high) == pytest.approx((middle, middle))
        held += low <= 0.7 <= high
    assert held >= 33


SIMULATOR = """
def run(design):
    if design["y"] < -1.0:
        raise RuntimeError("the solver does not converge")
    return 2.0 - design["x"] - 0.1 * design["y"]
"""


def test_lost_runs_that_mean_failure_are_failures_with_their_cause(tmp_path: Path) -> None:
    (tmp_path / "limit.py").write_text(SIMULATOR)
    (tmp_path / "made.toml").write_text(
        'simulator = { python = "limit:run", margins = ["g"], lost = { raised = "failure" } }\n'
        "sampling = { initial = 40, budget = 40 }\nspace.x = { distribution = 'normal', mean = 0, sd = 1 }\n"
        "space.y = { distribution = 'normal', mean = 0, sd = 1 }\n"
    )
    assert activefail("run", tmp_path / "made.toml", "--out", tmp_path / "run").code == 0
    with open_run(tmp_path / "run", code=tmp_path) as opened:
        history = opened.history
        died = history.designs[:, 1] < -1.0
        assert (history.outcome[died] == 1).all()
        assert (history.cause[died] == RAISED).all()
        assert history.answered.all()
        assert opened.classifier.unknown is None
    status = json.loads(activefail("status", tmp_path / "run", "--json").out)
    assert status["lost"] == ""
    assert status["counts"]["all"]["numerical_failure"] == 0


def test_the_variable_that_tells_lost_runs_from_the_others_is_named() -> None:
    campaign = Campaign.of(settings_of(), simulator=Dies())
    designs = campaign.space.sobol(64, np.random.default_rng(0))
    column = campaign.space.names.index("x")
    lost = designs[:, column] < np.quantile(designs[:, column], 0.2)
    text = where_lost(campaign.space.names, designs, lost)
    assert text.startswith(f"{lost.sum()} of 64 runs gave no result, most of them at low x")
    assert "no single variable" in where_lost(campaign.space.names, designs, np.arange(64) % 8 == 0)
