"""Simulators that do not repeat: detection, replicates, the noise in the model, and what judges it."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import activefail
from scipy.special import ndtr

from activefail.analyses.design.design_task import Requirement, design_task
from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.design.search import Candidate, Designed, Look
from activefail.analyses.findings.estimates import ProbabilityFindings
from activefail.analyses.findings.learned_from import choices_in_words, known_in_words, saved_choices
from activefail.campaign.assembly import Campaign
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.campaign.settings import CampaignSettings, checked
from activefail.errors import InputError, SimulationError
from activefail.estimates.integral import BoundariesOf
from activefail.estimates.probability_estimator import Estimator
from activefail.estimates.surface import score
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.state import classifier_state
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.learning import current, learn_from
from activefail.loop.running import run
from activefail.loop.telling import add
from activefail.record.memory import MemoryStore
from activefail.run.opening import open_run
from activefail.simulators.command import CommandSimulator
from activefail.simulators.interface import Results
from activefail.space.weighted import WeightedRows
from activefail.text.progress import silent

NOISE = 0.15
FRESH = np.random.default_rng(3).random((500, 2))


@dataclass(frozen=True)
class HalfPlane:
    """1 − x − y and noise, normal unless it is drawn otherwise."""

    noise: float = NOISE
    draws: Callable[[np.random.Generator, int], np.ndarray] = np.random.Generator.standard_normal
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    simulated: list[np.ndarray] = field(default_factory=list)

    outcomes, margins, causes, releases_gil = ("safe", "failure"), ("g",), ("",), True

    def run(self, X):
        self.simulated.append(X)
        g = 1.0 - X.sum(axis=1) + self.noise * self.draws(self.rng, len(X))
        nothing = np.zeros(len(X))
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), g[:, None], nothing)


def settings_of(repeatable=None, **sections):
    simulator = {"python": "half:plane", "margins": ["g"]} | ({} if repeatable is None else {"repeatable": repeatable})
    variables = {name: {"low": 0.0, "high": 1.0} for name in "xy"}
    settings = {"simulator": simulator, "space": variables, "sampling": {"initial": 40, "budget": 60}}
    return checked(CampaignSettings, settings | sections, "test")


def campaign_of(simulator, repeatable=None, **sections):
    return Campaign.of(settings_of(repeatable, **sections), simulator=simulator)


def taken(simulator, repeatable=None, store=None, **sections):
    campaign = campaign_of(simulator, repeatable, **sections)
    store = store or MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, 60)
    return campaign, store


def test_a_campaign_that_meets_noise_asks_and_asks_again_before_it_pays_for_more() -> None:
    simulator = HalfPlane()
    campaign = campaign_of(simulator)
    store = MemoryStore(campaign.schema)
    for simulations in (11, 11):
        with pytest.raises(SimulationError, match=r"id 0 has two results: .*repeatable = false"):
            taken(simulator, store=store)
        assert sum(map(len, simulator.simulated)) == simulations
    assert len(History.of(store.batches)) == 10


@pytest.mark.parametrize(("repeatable", "simulations"), [(None, 61), (True, 60)])
def test_one_design_is_simulated_twice_unless_the_file_says_that_it_repeats(repeatable, simulations) -> None:
    simulator = HalfPlane(noise=0.0)
    _, store = taken(simulator, repeatable)
    assert sum(map(len, simulator.simulated)) == simulations
    designs = History.of(store.batches).designs
    if repeatable:
        _, other = taken(HalfPlane(noise=0.0))
        assert designs.tobytes() == History.of(other.batches).designs.tobytes()


@pytest.mark.parametrize("batch", [1, 10])
def test_rounding_is_no_noise(batch) -> None:
    sampling = {"initial": 58, "budget": 60, "batch": batch, "asynchronous": batch == 1}
    _, store = taken(HalfPlane(noise=1e-14), sampling=sampling)
    assert len(History.of(store.batches)) == 60


def test_results_of_another_folder_take_the_place_of_the_initial_design() -> None:
    campaign, former = taken(HalfPlane(), False)
    first, store = History.of(former.batches)[:36], MemoryStore(campaign.schema)
    results = Results(first.outcome, first.outcome, first.margins, np.zeros(36))
    add(campaign, store, first.designs, replace(results, cause=np.zeros(36, dtype=np.int8)))
    assert len(HandedOut.of(store).initial_left(campaign)) < 40 - 20


@pytest.fixture(scope="module", params=["outcomes", "g"])
def noisy(request):
    campaign, store = taken(HalfPlane(), False, classifier={"learns": request.param})
    return campaign, store, current(campaign, store, write=False).classifier


def test_the_surface_is_the_probability_of_an_outcome_and_is_what_is_integrated(noisy) -> None:
    campaign, _, classifier = noisy
    surface, learned = ndtr((FRESH.sum(axis=1) - 1.0) / NOISE), classifier.probabilities(FRESH)[:, 1]
    by_margin = campaign.settings.classifier.learns == "g"
    assert np.abs(learned - surface).mean() < (0.04 if by_margin else 0.1)
    integrated = ndtr(BoundariesOf(classifier, campaign.features)(FRESH))[:, 0]
    assert integrated == pytest.approx(learned, abs=1e-9)
    if by_margin:
        data, noise = classifier.latents[0].margin_data, classifier.latents[0].trained.noise
        assert data.warping != "none" or noise * data.unit == pytest.approx(NOISE, rel=0.35)


def with_a_bad_one(rng, n):
    """Normal noise, and 5 % that are six standard deviations worse."""
    return rng.standard_normal(n) - 6.0 * (rng.random(n) < 0.05)


@pytest.mark.parametrize(
    ("draws", "is_told"),
    [
        (np.random.Generator.standard_normal, False),
        (with_a_bad_one, True),
        (lambda rng, n: rng.choice([-1.5, -0.4, 0.0, 0.1, 2.0], n), True),
        (lambda rng, n: 0.5 * rng.standard_t(1.5, n), True),
    ],
)
def test_a_noise_that_is_not_normal_is_told_beside_every_number_of_the_classifier(draws, is_told) -> None:
    campaign, store = taken(HalfPlane(draws=draws), False, classifier={"learns": "g"}, sampling={"initial": 60})
    classifier, history = current(campaign, store, write=False).classifier, History.of(store.batches)
    learnable, settings = campaign.learnable, campaign.settings
    (saved,) = saved_choices(classifier_state(classifier), campaign.simulator.outcomes, learnable, "g")
    without_torch = SimpleNamespace(outcomes=classifier.outcomes, latents=[SimpleNamespace(normality=saved.normality)])
    with ThreadExecutor(1) as executor:
        estimator = Estimator(campaign, store, executor, classifier, history.last_iteration)
        estimate = estimator.sample("failure", 20, campaign.question).estimate(0.9)
        task = design_task(Inquiry(campaign, campaign.question), (Requirement("failure", 0.1),), ("x",))
        sampled = estimator.sample("failure", 20, task.question.at({"x": 0.2}))
        look = Look(Candidate({"x": 0.2}, np.array([0.2]), is_feasible=False), (sampled,), 0.9, 20)
        design = DesignFindings.beside(estimator, Designed(task, (look,), 1, "out of reach"), False, silent)
    found = ProbabilityFindings.of(campaign, history, classifier, "failure", estimate, campaign.question)
    told = [
        saved.sentence(settings),
        *choices_in_words(campaign, history, classifier),
        " ".join(found.assumptions),
        " ".join(design.as_json()["assumptions"]),
        *(
            known_in_words(
                SimpleNamespace(campaign=campaign, history=history, _turn=nullcontext(), _predicts=(None, one))
            )
            for one in (classifier, without_torch)
        ),
    ]
    assert ["its noise is not normal" in one for one in told] == [is_told] * 6


def test_fresh_simulations_of_equal_rows_are_runs_of_their_own(noisy) -> None:
    campaign, store, classifier = noisy
    rows = WeightedRows(("x", "y"), np.array([[0.5, 0.5], [0.4, 0.5]]), np.ones(2))
    question = Question("rows", campaign.space.names, rows)
    simulator = campaign.simulator
    before = sum(map(len, simulator.simulated))
    with ThreadExecutor(1) as executor:
        Estimator(campaign, store, executor, classifier, 2).sample("failure", 30, question)
    assert sum(map(len, simulator.simulated)) == before + 30


def test_replicates_are_recorded_and_an_outcome_s_share_is_learned() -> None:
    campaign = campaign_of(HalfPlane(), False, classifier={"learns": "outcomes"})
    store = MemoryStore(campaign.schema)
    X = np.repeat([[0.2, 0.2], [0.5, 0.5], [0.8, 0.8]], [20, 40, 20], axis=0)
    outcome = np.repeat([0, 0, 1], [20, 28, 32]).astype(np.int8)
    results = Results(outcome, np.zeros(80, dtype=np.int8), np.where(outcome, -0.1, 0.1)[:, None], np.zeros(80))
    assert add(campaign, store, X, results) == 80
    classifier = learn_from(campaign, History.of(store.batches))
    assert classifier.probabilities(X[30:31])[0, 1] == pytest.approx(0.3, abs=0.08)


@pytest.mark.parametrize(("key", "value"), [("stop", {"error": 0.02}), ("validation", {"size": 100})])
def test_what_counts_wrong_designs_is_refused(key, value) -> None:
    with pytest.raises(InputError, match=rf"`{key}\.\w+` requires a simulator that repeats"):
        settings_of(False, **{key: value})


def test_the_log_score_and_the_calibration_are_those_of_the_probabilities() -> None:
    rng = np.random.default_rng(0)
    p = rng.random(4000)
    one = score(p, rng.random(4000) < p, 0, 0.99)
    assert one.low < one.expected_log_score < one.high
    assert all(part.low < part.predicted < part.high for part in one.calibration)
    too_sure = score(ndtr(3.0 * p), rng.random(4000) < p, 0, 0.99)
    assert too_sure.high < too_sure.expected_log_score


def test_a_program_that_does_not_repeat_is_run_verified_and_keeps_a_folder_for_each_run(tmp_path: Path) -> None:
    (tmp_path / "run.py").write_text(
        "import json, os, random\n"
        "outcome = 'failure' if random.random() < float(os.environ['AF_x']) else 'safe'\n"
        "open(os.environ['AF_OUT'], 'w').write(json.dumps({'outcome': outcome}))\n"
    )
    (tmp_path / "noisy.toml").write_text(
        "sampling = { initial = 12, budget = 14, batch = 2 }\n"
        "simulator = { command = 'python {here}/run.py', repeatable = false }\n"
        "space.x = { low = 0.0, high = 1.0, step = 0.25 }\n"
    )
    ran = activefail("run", tmp_path / "noisy.toml", "--out", tmp_path / "run", "--quiet")
    assert ran.code == 0, ran.err
    with open_run(tmp_path / "run", code=tmp_path) as opened:
        assert len(opened.simulations) == 14
        assert isinstance(opened.campaign.simulator, CommandSimulator)
        assert len(list(opened.campaign.simulator.work.iterdir())) == 14
    verified = activefail("verify", tmp_path / "run", "--simulations", "10", "--code", tmp_path)
    assert "log score" in verified.out, verified.err
    written = (tmp_path / "run" / "journal").read_bytes()
    assert activefail("verify", tmp_path / "run", "--simulations", "10", "--code", tmp_path).out == verified.out
    assert (tmp_path / "run" / "journal").read_bytes() == written
    reported = activefail("report", tmp_path / "run", "--code", tmp_path)
    page = (tmp_path / "run" / "report.html").read_text()
    assert verified.out.splitlines()[1].removeprefix("log score ").strip() in page
    assert "missing" not in reported.out, reported.err
    assert "activefail compare" not in page
