"""Campaigns that end once they know a failure probability: when, after which check, and resumed to the same bits."""

import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest
from campaign.stub import given
from cases import some
from rare import four_branch

from activefail.analyses.findings.learned_from import choices_in_words
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.execution.local import ThreadExecutor
from activefail.learning.model import margin
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.threads import one_thread
from activefail.loop.asking import ask
from activefail.loop.history import History
from activefail.loop.learning import Learned, current
from activefail.loop.probability_rule import Looks, check_designs, contradicted
from activefail.loop.progress import Observer
from activefail.loop.running import run
from activefail.loop.telling import add, drop, tell
from activefail.record.batch import ACTIVE, CHECK, INITIAL
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results

PROBABILITY = 2.2225e-3


@dataclass(frozen=True)
class FourBranch:
    """Fails rarely, and reports its margin.

    Attributes:
        lowest, highest: range to which its margins are clipped.
        hidden: the middle of a disc whose designs fail too.
    """

    lowest: float = -np.inf
    highest: float = np.inf
    hidden: tuple[float, float] | None = None

    outcomes = ("safe", "failure")
    causes = ("",)
    margins = ("g",)
    releases_gil = True

    def run(self, X):
        g = four_branch(X)
        if self.hidden is not None:
            g = np.minimum(g, np.hypot(*(X - self.hidden).T) - 0.5)
        nothing = np.zeros(len(X))
        margin = np.clip(g, self.lowest, self.highest)[:, None]
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), margin, nothing)


def campaign_on(simulator, **changes):
    normal = {"distribution": "normal", "mean": 0.0, "sd": 1.0}
    keys = {
        "seed": 1,
        "space": {"x": normal, "y": normal},
        "sampling.initial": 12,
        "sampling.batch": 1,
        "sampling.budget": 120,
        "classifier.features": "design",
        "stop": {"probability": "failure", "cov": 0.2},
    }
    settings = given().changed(keys | {key.replace("__", "."): value for key, value in changes.items()})
    return Campaign.of(settings, simulator=simulator)


def taken(campaign, store=None, observer=None):
    store = MemoryStore(campaign.schema) if store is None else store
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, campaign.settings.sampling.budget, observer)
    return store


@pytest.fixture(scope="module")
def ended():
    campaign = campaign_on(FourBranch())
    return campaign, taken(campaign)


def test_it_ends_by_itself_after_a_check_that_found_nothing_and_knows_the_probability(ended) -> None:
    campaign, store = ended
    history, learned = History.of(store.batches), current(campaign, store, write=False)
    assert len(history) < 80
    assert (history.outcome == 1).sum() >= 3
    assert learned.looks.is_known
    assert learned.looks.probability == pytest.approx(PROBABILITY, rel=0.25)
    checks = [batch for batch in store.batches if (batch.origin == CHECK).all()]
    assert store.batches[-1] is checks[-1]
    assert all(len(batch) == 4 + 2 * 2 for batch in checks)
    assert set(history.origin.tolist()) == {INITIAL, ACTIVE, CHECK}


@pytest.mark.slow
@pytest.mark.parametrize("every", some([False, True], False))
def test_interrupted_after_any_batch_it_resumes_to_the_same_bits(ended, tmp_path, every) -> None:
    campaign, whole = ended
    n = len(whole.batches)
    stops = list(range(1, n)) if every else [n // 2, n - 2, n - 1]
    folder = tmp_path / str(n - 1)
    with FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store:

        def keep(progress) -> None:
            # As a kill at this moment would leave it.
            if len(store.batches) in stops[:-1]:
                shutil.copytree(folder, tmp_path / str(len(store.batches)), dirs_exist_ok=True)

        taken(campaign, store, Observer(keep, stop=lambda: len(store.batches) >= n - 1))
    for stop in stops:
        folder = tmp_path / str(stop)
        if stop == n - 1:
            # Without saved states everything is learned again, from the first batch on.
            (folder / "checkpoint.h5").unlink()
        with FolderStore.open(folder, campaign.schema, write=True) as store:
            assert len(store.batches) == stop
            taken(campaign, store)
            assert len(store.batches) == n
            for one, other in zip(store.batches, whole.batches, strict=True):
                assert one.designs.tobytes() == other.designs.tobytes()
                assert one.origin.tobytes() == other.origin.tobytes()
            state, expected = store.latest_state(), whole.latest_state()
            assert state[0] == expected[0]
            assert set(state[1]) == set(expected[1])
            assert all(np.array_equal(state[1][name], expected[1][name], equal_nan=True) for name in state[1])


def test_resumed_after_its_end_it_simulates_nothing_more(ended) -> None:
    campaign, store = ended
    before = len(store.batches)
    taken(campaign, store)
    assert len(store.batches) == before


@pytest.mark.slow
def test_truncated_margins_are_learned_from_too() -> None:
    campaign = campaign_on(FourBranch(lowest=0.0))
    store = taken(campaign)
    learned = current(campaign, store, write=False)
    assert learned.classifier.latents[0].trained.data.truncated
    assert learned.looks.probability == pytest.approx(PROBABILITY, rel=0.35)


def test_a_check_reaches_a_rare_choice_that_was_never_simulated() -> None:
    # It lies in the middle of thirty choices, of which any two are equally different.
    shares, rare = np.roll([0.01, *[0.99 / 29] * 29], 14), 14
    kind = {"choices": [f"c{number}" for number in range(30)], "probabilities": shares.tolist()}
    x = {"distribution": "normal", "mean": 0.0, "sd": 1.0}
    settings = given().changed({"space": {"x": x, "kind": kind}, "classifier.features": "design"})
    campaign = Campaign.of(settings, simulator=FourBranch())
    looks = Looks(np.array([[0.0, 0.01, 0.001, 0.0]]))
    classifier = Classifier(("safe", "failure"), campaign.features, ())
    for seed in range(3):
        X = campaign.space.random(60, np.random.default_rng(seed))
        simulated = X[X[:, 1] != rare][:40]
        places = check_designs(campaign, simulated, looks, classifier, np.random.default_rng(100 + seed))
        assert rare in places[:, 1]


def test_a_check_that_meets_a_hidden_failure_continues_the_campaign(ended) -> None:
    campaign, store = ended
    known = current(campaign, store, write=False)
    where = np.array([[-2.4, 2.2]])
    hidden = campaign_on(FourBranch(hidden=(-2.4, 2.2)))
    results = hidden.simulator.run(where)
    batch = replace(History.of_sample(where, results), origin=np.array([CHECK], dtype=np.int8))
    assert contradicted(hidden, known.classifier, batch).tolist() == [True]
    # On the right side, but with a margin that the classifier considered impossible.
    odd = replace(batch, outcome=np.zeros(1, dtype=np.int8), margins=np.array([[50.0]]))
    assert contradicted(hidden, known.classifier, odd).tolist() == [True]
    failed = replace(batch, outcome=np.full(1, -1, dtype=np.int8))
    assert contradicted(hidden, known.classifier, failed).tolist() == [False]
    expected = four_branch(where)
    right = replace(batch, outcome=np.zeros(1, dtype=np.int8), margins=expected[:, None])
    assert contradicted(hidden, known.classifier, right).tolist() == [False]


def copied(campaign, store, batches=None):
    """A record with the first so many batches of another one, or with all of them and what was learned."""
    copy = MemoryStore(campaign.schema)
    first = store.batches[:batches]
    for batch in first:
        copy.commit(batch)
    copy.hand_out(store.asked[store.asked.learned < first[-1].iteration])
    if batches is None:
        copy.write_state(*store.latest_state())
    return copy


@pytest.fixture(scope="module")
def at_check(ended):
    """The record before the last check, and what was learned from it."""
    campaign, whole = ended
    store = copied(campaign, whole, len(whole.batches) - 1)
    with one_thread():
        current(campaign, store, write=True)
    return store


def test_a_check_that_is_cut_short_or_has_lost_runs_ends_nothing(ended, at_check) -> None:
    campaign, store = ended
    n = len(store.batches)
    whole = History.of(store.batches)
    last = whole.last_iteration
    earlier = current(campaign, copied(campaign, at_check), write=False)
    # Two lost runs of 45, wherever they are, leave a probability of 0.002 unknown.
    for rows, failed, known in ((8, 0, True), (8, 2, False), (8, 3, False), (3, 0, False)):
        outcome = store.batches[-1].results.outcome.copy()
        outcome[:failed] = -1
        batch = replace(store.batches[-1], results=replace(store.batches[-1].results, outcome=outcome))
        history = History.of([*store.batches[: n - 1], batch])[: len(whole) - 8 + rows]
        learned = Learned.after(campaign, history, last, earlier)
        assert learned.looks.is_known is known


def test_the_rule_is_met_only_as_long_as_nothing_is_simulated_after_the_check(ended) -> None:
    campaign, store = ended
    more = copied(campaign, store)
    with ThreadExecutor(1) as executor:
        run(campaign, more, executor, len(History.of(store.batches)) + 1, use_stop_rule=False)
    assert not current(campaign, more, write=False).looks.is_known


def test_two_narrow_looks_four_simulations_apart_are_needed() -> None:
    rows = [[20, 1e-3, 4e-5, 1e-4], [22, 1e-3, 4e-5, 1e-4], [24, 1e-3, 4e-5, 1e-4]]
    assert Looks(np.array(rows)).is_narrow(0.1)
    # What a user sees includes the error of the integration; the rule asks the posterior alone.
    assert Looks(np.array(rows)).sd == pytest.approx(np.hypot(4e-5, 1e-4))
    assert not Looks(np.array(rows[:2])).is_narrow(0.1)
    wide = [[20, 1e-3, 9e-5, 1e-4], *rows[1:]]
    assert not Looks(np.array(wide)).is_narrow(0.1)
    assert not Looks(np.array([*rows[:2], [24, 1e-3, 6e-5, 1e-4]])).is_narrow(0.1)


def test_without_margins_the_rule_never_ends_a_campaign() -> None:
    campaign = campaign_on(FourBranch(), classifier__learns="outcomes", sampling__budget=20)
    store = taken(campaign)
    assert len(History.of(store.batches)) == 20
    assert not current(campaign, store, write=False).looks.is_known


def test_predictions_from_a_part_of_the_simulations_are_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in ("WARPED_ON", "LEARNED_ON", "EXACT", "INDUCING"):
        monkeypatch.setattr(margin, limit, 16)
    campaign = campaign_on(FourBranch(), sampling__budget=20)
    store = taken(campaign)
    (text,) = choices_in_words(campaign, History.of(store.batches), current(campaign, store, write=False).classifier)
    assert "; predictions use 16 inducing points" in text


@pytest.mark.slow
@pytest.mark.parametrize("asynchronous", [False, True])
def test_a_clipped_margin_never_ends_a_campaign_but_is_checked_again(asynchronous: bool) -> None:
    campaign = campaign_on(FourBranch(highest=1.5), sampling__budget=66, sampling__asynchronous=asynchronous)
    store = taken(campaign)
    history = History.of(store.batches)
    assert (history.margins == 1.5).sum() >= 3
    assert len(history) == 66
    assert (history.origin == CHECK).sum() >= 2 * 8
    (text,) = choices_in_words(campaign, history, current(campaign, store, write=False).classifier)
    assert "this margin is clipped at its largest value and does not show a failure behind it" in text


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"stop": {"probability": "collapse"}}, "stop.probability: must be the outcome of a target boundary"),
        ({"classifier.learns": "drift"}, "classifier.learns: must be one of auto, outcomes, g, got 'drift'"),
    ],
)
def test_a_rule_that_cannot_be_is_refused(changes, rule) -> None:
    with pytest.raises(InputError, match=rule):
        campaign_on(FourBranch(), **{key.replace(".", "__"): value for key, value in changes.items()})


@pytest.mark.exhaustive
def test_a_search_from_outcomes_alone_proposes_designs_of_twice_the_standard_deviation() -> None:
    text = """
    simulator = { python = "limit:branches" }
    stop = { probability = "failure" }
    space.x = { distribution = "normal", mean = 0, sd = 1 }
    """
    settings = parse_settings(text, "made.toml")
    assert settings.acquisition.criterion == "eavc"
    assert parse_settings(text.replace("stop", "# stop"), "made.toml").acquisition.criterion == "joint_entropy"
    chosen = []
    for rule in ({"probability": "failure"}, None):
        campaign = campaign_on(
            FourBranch(), stop=rule, **{"classifier.learns": "outcomes", "acquisition.criterion": "eavc"}
        )
        store = MemoryStore(campaign.schema)
        with ThreadExecutor(1) as executor:
            run(campaign, store, executor, 40)
        history = History.of(store.batches)
        chosen.append(np.linalg.norm(history.designs[history.origin == ACTIVE][-15:], axis=1))
    wide, plain = chosen
    assert np.median(wide) > np.median(plain)


# --- the rule in campaigns whose simulations are made elsewhere ---------------------------------------------------


def told(campaign, store, designs):
    tell(campaign, store, designs.id, campaign.simulator.run(designs.designs))


@pytest.mark.slow
def test_asked_for_one_design_at_a_time_it_ends_with_the_bits_of_the_loop(ended) -> None:
    campaign, whole = ended
    store = MemoryStore(campaign.schema)
    while len((proposed := ask(campaign, store, 1, 120)).designs):
        told(campaign, store, proposed.designs)
    assert proposed.reason == "the stop rule is met"
    one, other = History.of(store.batches), History.of(whole.batches)
    for name in ("designs", "outcome", "iteration", "origin", "margins", "cause"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert len(ask(campaign, store, 1, 120, ignore_stop=True).designs) == 1


def test_a_check_is_handed_out_whole_and_nothing_else_before_all_its_results_are_there(ended, at_check) -> None:
    campaign, whole = ended
    store = copied(campaign, at_check)
    proposed = ask(campaign, store, 1, 120)
    check = proposed.designs
    assert (check.origin == CHECK).all()
    assert proposed.reason == "the 8 designs of the stop rule's check belong together"
    assert check.designs.tobytes() == whole.batches[-1].designs.tobytes()
    told(campaign, store, check[:5])
    waiting = ask(campaign, store, 1, 120)
    assert len(waiting.designs) == 0
    assert waiting.reason.startswith("the stop rule waits for the results of its check, ids ")
    # What is learned from a part of the check is learned anew once the rest is there.
    assert not current(campaign, store, write=True).looks.is_known
    with pytest.raises(InputError, match="Nothing can be simulated: the stop rule waits for the results of its check"):
        taken(campaign, store)
    told(campaign, store, check[5:])
    assert current(campaign, store, write=True).looks.is_known
    assert ask(campaign, store, 1, 120).reason == "the stop rule is met"


def test_a_check_of_which_too_much_was_dropped_ends_nothing(ended, at_check) -> None:
    campaign, _ = ended
    store = copied(campaign, at_check)
    check = ask(campaign, store, 8, 120).designs
    told(campaign, store, check[:5])
    drop(store, check.id[5:])
    assert not current(campaign, store, write=True).looks.is_known
    later = ask(campaign, store, 1, 120)
    assert len(later.designs) >= 1
    assert later.reason != "the stop rule is met"


def test_results_beside_a_check_do_not_hide_it(ended, at_check) -> None:
    campaign, _ = ended
    store = copied(campaign, at_check)
    X = np.array([[0.1, 0.2]])
    check = ask(campaign, store, 8, 120).designs
    told(campaign, store, check[:4])
    assert add(campaign, store, X, campaign.simulator.run(X)) == 1
    told(campaign, store, check[4:])
    assert len(set(History.of(store.batches).iteration[-9:].tolist())) == 1
    assert current(campaign, store, write=True).looks.is_known
