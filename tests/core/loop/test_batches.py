"""The loop: it finds the boundary, and no interruption changes a bit of what it does."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Brittle, Counting, Disc, Raising, disc, distance
from cases import some
from loop.test_asynchronous import first_events
from patience import PATIENCE
from pounding import write_campaign

from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import open_campaign
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import read_settings
from activefail.errors import SimulationError
from activefail.execution.local import ThreadExecutor
from activefail.learning.model import fitting
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.threads import one_thread
from activefail.learning.model.training import train
from activefail.loop.history import History
from activefail.loop.initial import initial_designs
from activefail.loop.learning import accuracy, current
from activefail.loop.progress import Observer, Progress, standing
from activefail.loop.running import run
from activefail.record.batch import ACTIVE, INITIAL
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space.space import Array

INITIAL_SIZE, BUDGET, BATCH = 12, 28, 4
COMMITS = BUDGET // BATCH
INITIAL_COMMITS = INITIAL_SIZE // BATCH


def take(
    campaign: Campaign,
    store: Store | None = None,
    budget: int | None = None,
    workers: int = 2,
    observer: Observer | None = None,
) -> Store:
    """The store of a campaign, taken to a budget (its own by default)."""
    store = MemoryStore(campaign.schema) if store is None else store
    with ThreadExecutor(workers) as executor:
        run(campaign, store, executor, campaign.settings.sampling.budget if budget is None else budget, observer)
    return store


def stop_after(commits: int, store: Store) -> Observer:
    return Observer(stop=lambda: len(store.batches) >= commits)


def recorded(store: Store) -> list[object]:
    """Every bit of a record but the wall times."""
    return [
        (batch.iteration, *(a.tobytes() for a in (batch.designs, batch.origin)), *answers(batch.results))
        for batch in store.batches
    ]


def answers(results: Results) -> tuple[bytes, ...]:
    return results.outcome.tobytes(), results.cause.tobytes(), results.margins.tobytes()


def learned(store: Store) -> tuple[int, dict[str, bytes]]:
    """Every bit of what was learned last, and when."""
    saved = store.latest_state()
    assert saved is not None
    return saved[0], {name: array.tobytes() for name, array in saved[1].items()}


def designs(store: Store, origin: int) -> Array:
    return np.concatenate([batch.designs[batch.origin == origin] for batch in store.batches])


@pytest.fixture(scope="module")
def uninterrupted() -> Store:
    return take(disc())


# --- what a campaign is ------------------------------------------------------------------------------------------


def test_a_campaign_spends_its_budget_in_whole_batches_seed_first(uninterrupted: Store) -> None:
    assert [len(batch) for batch in uninterrupted.batches] == [BATCH] * COMMITS
    assert [batch.iteration for batch in uninterrupted.batches] == [0, 0, 0, 1, 2, 3, 4]
    origins = [INITIAL] * INITIAL_COMMITS + [ACTIVE] * (COMMITS - INITIAL_COMMITS)
    assert [set(batch.origin.tolist()) for batch in uninterrupted.batches] == [{origin} for origin in origins]


@pytest.mark.parametrize(("initial", "budget", "batch"), [(5, 12, 4), (2, 3, 10), (6, 6, 4)])
def test_a_budget_that_batches_do_not_divide_is_spent_to_the_last_simulation(
    initial: int, budget: int, batch: int
) -> None:
    store = take(disc(initial=initial, budget=budget, batch=batch))
    assert sum(len(one) for one in store.batches) == budget
    assert len(designs(store, INITIAL)) == initial
    assert max(len(one) for one in store.batches) <= batch


def test_the_seed_is_one_latin_hypercube_however_it_is_cut_into_batches(uninterrupted: Store) -> None:
    X = designs(uninterrupted, INITIAL)
    space = disc().space
    assert X.tobytes() == initial_designs(disc()).tobytes()
    assert (np.sort(np.floor(space.to_unit(X) * INITIAL_SIZE), axis=0) == np.arange(INITIAL_SIZE)[:, None]).all()


def test_every_design_lies_in_the_space_and_none_is_simulated_twice(uninterrupted: Store) -> None:
    X = np.concatenate([batch.designs for batch in uninterrupted.batches])
    assert disc().space.contains(X).all()
    assert len(np.unique(X, axis=0)) == BUDGET


def test_the_record_holds_what_the_simulator_answers_in_the_order_of_the_designs(uninterrupted: Store) -> None:
    for batch in uninterrupted.batches:
        assert answers(batch.results) == answers(Disc().run(batch.designs))


def test_campaigns_with_other_seeds_share_no_design(uninterrupted: Store) -> None:
    mine, others = (np.concatenate([b.designs for b in s.batches]) for s in (uninterrupted, take(disc(seed=2))))
    assert not np.isin(mine, others).any()


class Alike:
    """A simulator that answers every design alike."""

    outcomes, causes, margins, releases_gil = Disc.outcomes, Disc.causes, Disc.margins, True

    def __init__(self, outcome: int) -> None:
        self.outcome = outcome

    def run(self, X: Array) -> Results:
        n = len(X)
        return Results(np.full(n, self.outcome, dtype=np.int8), np.zeros(n, dtype=np.int8), np.ones((n, 1)), np.ones(n))


@pytest.mark.parametrize("outcome", [0, 1])
def test_a_campaign_that_sees_one_outcome_only_goes_on_and_expects_more_of_it(outcome: int) -> None:
    campaign = disc(Alike(outcome), initial=6, budget=10, batch=2)
    store = take(campaign)
    assert sum(len(batch) for batch in store.batches) == 10
    probabilities = current(campaign, store, write=False).classifier.probabilities(designs(store, INITIAL))
    assert (probabilities[:, outcome] > 0.5).all()


# --- what it finds -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["entropy", "bald"])
def boundary_campaigns(request: pytest.FixtureRequest) -> list[tuple[Campaign, Store]]:
    """Four campaigns that differ in their seeds."""
    criterion = f'acquisition.criterion = "{request.param}"'
    campaigns = [disc(seed=seed, initial=20, budget=60, batch=10, extra=criterion) for seed in range(4)]
    return [(campaign, take(campaign)) for campaign in campaigns]


def test_the_chosen_designs_crowd_along_the_true_boundary(boundary_campaigns: list[tuple[Campaign, Store]]) -> None:
    for _, store in boundary_campaigns:
        active, seed = (float(np.median(np.abs(distance(designs(store, o))))) for o in (ACTIVE, INITIAL))
        assert active < seed / 2.0


def test_chosen_designs_teach_more_than_static_ones_and_more_than_the_seed_did(
    boundary_campaigns: list[tuple[Campaign, Store]],
) -> None:
    errors = []
    for campaign, store in boundary_campaigns:
        X = campaign.space.from_unit(np.random.default_rng(9).random((1000, 2)))
        outcome = Disc().run(X).outcome
        hypercube = campaign.space.latin_hypercube(60, stream(campaign.settings.seed, "static", 60))
        with one_thread():
            known = History.of(store.batches).through(0).training
            seed = train(known.designs, known.outcome, Disc.outcomes, campaign.features, VariationalGP())
            static = train(hypercube, Disc().run(hypercube).outcome, Disc.outcomes, campaign.features, VariationalGP())
            active = current(campaign, store, write=False).classifier
            errors.append([1.0 - accuracy(classifier, 1, X, outcome) for classifier in (seed, static, active)])
    seed_error, static_error, active_error = np.mean(errors, axis=0)
    assert active_error < 0.7 * static_error
    assert static_error < 0.7 * seed_error
    assert all(active < seed for seed, _, active in errors)


# --- numerical failures ------------------------------------------------------------------------------------------

FOGGY = Disc(blind=-1.0)


def test_numerical_failures_are_recorded_and_counted_but_never_learned_from() -> None:
    seen: list[Progress] = []
    campaign = disc(FOGGY, extra="limits.numerical_failures = 1.0")
    store = take(campaign, observer=Observer(seen.append))
    outcome = np.concatenate([batch.results.outcome for batch in store.batches])
    failures = int((outcome == NUMERICAL_FAILURE).sum())
    assert failures > 0
    assert (seen[-1].numerical_failures, seen[-1].done, int(seen[-1].counts.sum())) == (
        failures,
        BUDGET,
        BUDGET - failures,
    )
    classifier = current(campaign, store, write=False).classifier
    assert len(classifier.latents[0].trained.labels) == BUDGET - failures
    known = History.of(store.batches).training
    X, labels = known.designs, known.outcome
    assert FOGGY.run(X).outcome.tobytes() == labels.tobytes()
    assert NUMERICAL_FAILURE not in labels


def test_a_campaign_with_numerical_failures_learns_what_it_would_without_those_rows() -> None:
    campaign = disc(FOGGY, extra="limits.numerical_failures = 1.0")
    foggy = take(campaign, budget=INITIAL_SIZE)
    X = initial_designs(campaign)
    X = X[X[:, 0] >= FOGGY.blind]
    probe = campaign.space.sobol(64, np.random.default_rng(0))
    with one_thread():
        clear = train(X, Disc().run(X).outcome, Disc.outcomes, campaign.features, VariationalGP())
        learned = current(campaign, foggy, write=False).classifier
        assert np.array_equal(learned.probabilities(probe), clear.probabilities(probe))


@pytest.mark.parametrize("every", some([False, True], False))
def test_a_design_that_failed_numerically_is_not_proposed_again_nor_after_an_interruption(every: bool) -> None:
    campaign = disc(Brittle(), seed=6, extra="limits.numerical_failures = 1.0")
    store = take(campaign)
    X = np.concatenate([batch.designs for batch in store.batches])
    assert len(np.unique(X, axis=0)) == BUDGET
    assert sum((batch.results.outcome == NUMERICAL_FAILURE).sum() for batch in store.batches) > 1
    for commits in range(INITIAL_COMMITS, COMMITS) if every else (INITIAL_COMMITS + 1, COMMITS - 1):
        interrupted = MemoryStore(campaign.schema)
        take(campaign, interrupted, observer=stop_after(commits, interrupted))
        assert recorded(take(campaign, interrupted)) == recorded(store)


@pytest.mark.faults
def test_too_many_numerical_failures_stop_the_campaign_with_counts_limit_and_a_record() -> None:
    campaign = disc(Disc(blind=0.5), initial=24)
    store = MemoryStore(campaign.schema)
    with pytest.raises(SimulationError) as stopped:
        take(campaign, store)
    progress = standing(campaign, History.of(store.batches), BUDGET)
    # Twenty is the least number of simulations whose share is judged.
    assert progress.done == 20
    assert progress.numerical_failures == sum(int((b.designs[:, 0] < 0.5).sum()) for b in store.batches)
    message = str(stopped.value)
    assert f"{progress.numerical_failures} of 20 simulations" in message
    assert "0.05" in message
    assert "limits.numerical_failures" in message


class Broken(Disc):
    """A disc before its simulator was fixed."""

    def run(self, X: Array) -> Results:
        raise ZeroDivisionError("the stiffness vanished")


@pytest.mark.faults
def test_a_simulator_that_raises_stops_the_campaign_with_what_it_raised_and_where() -> None:
    campaign = disc(Broken(), initial=24)
    store = MemoryStore(campaign.schema)
    with pytest.raises(SimulationError, match="20 of 20 simulations failed numerically") as stopped:
        take(campaign, store)
    first = initial_designs(campaign)[0].tolist()
    fault = f"design {first}: ZeroDivisionError: the stiffness vanished ({__file__}:"
    assert f"Why the first simulation failed: {fault}" in str(stopped.value)
    assert {cause_name(Disc.causes, int(c)) for one in store.batches for c in one.results.cause} == {"raised"}


@pytest.mark.faults
@pytest.mark.parametrize("asynchronous", [False, True])
def test_the_caller_receives_the_faults_of_all_simulations_of_a_call_and_of_no_earlier_one(asynchronous: bool) -> None:
    extra = "validation.size = 20\nlimits.numerical_failures = 0.9"
    campaign = disc(Raising(), budget=BUDGET, asynchronous=asynchronous, extra=extra)
    store, observer, faults = MemoryStore(campaign.schema), Observer(), []
    with ThreadExecutor(2) as executor:
        for budget in (BUDGET - BATCH, BUDGET):
            assert run(campaign, store, executor, budget, observer)
            faults.append(list(observer.faults))
    validation = store.read_set("validation-0")
    assert validation is not None
    X = np.concatenate([validation[0], *(batch.designs for batch in store.batches)])
    failed = X[X[:, 0] > 1.5]
    assert len(failed) > 3
    assert [fault.split(": ")[0] for received in faults for fault in received] == [
        f"design {x.tolist()}" for x in failed
    ]


def test_a_share_of_numerical_failures_up_to_the_limit_is_borne() -> None:
    campaign = disc(FOGGY, initial=24, budget=24, extra="limits.numerical_failures = 0.3")
    progress = standing(campaign, History.of(take(campaign).batches), 24)
    assert 0.05 * 24 < progress.numerical_failures <= 0.3 * 24


@pytest.mark.faults
def test_a_simulator_that_never_answers_is_given_up_after_twenty_simulations() -> None:
    with pytest.raises(SimulationError, match="20 of 20 simulations"):
        take(disc(Alike(NUMERICAL_FAILURE), initial=24))


@pytest.mark.faults
def test_a_campaign_without_any_answer_stops_and_goes_on_with_other_initial_designs_once_mended() -> None:
    broken, mended = disc(Broken(), budget=48), disc(budget=48)
    store = MemoryStore(mended.schema)
    for sets in (1, 2):
        with pytest.raises(SimulationError) as stopped:
            take(broken, store)
        done, first = sets * INITIAL_SIZE, initial_designs(broken, sets)[-INITIAL_SIZE].tolist()
        message = str(stopped.value)
        assert f"None of the {done} simulations gave an outcome" in message
        assert "The first failed with cause `raised`." in message
        assert "`activefail resume DIR` continues" in message
        assert f"Why the first simulation failed: design {first}: ZeroDivisionError: the stiffness vanished" in message
        assert standing(broken, History.of(store.batches), 48).numerical_failures == done
    # Its failures are no reason to stop by their share: they were those of another simulator.
    take(mended, store)
    X = np.concatenate([batch.designs for batch in store.batches])
    assert len(np.unique(X, axis=0)) == 48
    assert designs(store, INITIAL).tobytes() == initial_designs(mended, 3).tobytes()
    classifier = current(mended, store, write=False).classifier
    assert len(classifier.latents[0].trained.labels) == 48 - 2 * INITIAL_SIZE


@pytest.mark.faults
def test_failures_before_the_first_answer_are_no_reason_to_stop_once_the_simulator_is_mended() -> None:
    broken, mended = disc(Broken(), initial=50, budget=60), disc(initial=50, budget=60)
    store = MemoryStore(mended.schema)
    for failed in (20, 40):
        # Each time it tries as many as tell that something is wrong.
        with pytest.raises(SimulationError, match="20 of 20 simulations failed numerically"):
            take(broken, store)
        assert standing(broken, History.of(store.batches), 60).numerical_failures == failed
    take(mended, store)
    assert designs(store, INITIAL).tobytes() == initial_designs(mended).tobytes()
    # Neither are they later: a campaign that is taken on counts from its first answer, too.
    with pytest.raises(SimulationError, match="4 of 24 simulations failed numerically"):
        take(broken, store, budget=80)


@pytest.mark.faults
@pytest.mark.parametrize(("initial", "budget", "needed"), [(12, 8, 12), (12, 12, 24), (4, 4, 8)])
def test_a_budget_that_is_too_small_for_other_initial_designs_is_told(initial: int, budget: int, needed: int) -> None:
    campaign = disc(Broken(), initial=initial, budget=28, batch=2)
    store = MemoryStore(campaign.schema)
    words = f"`activefail resume DIR --budget {needed}` continues"
    with pytest.raises(SimulationError, match=words) as stopped:
        take(campaign, store, budget=budget)
    assert "the stiffness vanished" in str(stopped.value)
    if budget == initial:
        # Nothing is simulated now, but the record has the causes.
        with pytest.raises(SimulationError, match=f"The first failed with cause `raised`.*{words}") as stopped:
            take(campaign, store, budget=budget)
        assert "the stiffness vanished" not in str(stopped.value)
    take(disc(initial=initial, batch=2, extra="limits.numerical_failures = 1.0"), store, budget=28)
    assert sum(map(len, store.batches)) == 28


# --- what a caller hears -----------------------------------------------------------------------------------------


def test_progress_is_told_after_every_batch_and_ends_at_the_budget(uninterrupted: Store) -> None:
    seen: list[Progress] = []
    store = take(disc(), observer=Observer(seen.append))
    assert [progress.done for progress in seen] == [0, 4, 8, 12, 16, 20, 24, 28]
    assert [progress.iteration for progress in seen] == [0, 0, 0, 0, 1, 2, 3, 4]
    assert {progress.budget for progress in seen} == {BUDGET}
    assert {progress.accuracy for progress in seen} == {None}
    outcome = np.concatenate([batch.results.outcome for batch in store.batches])
    assert seen[-1].counts.tolist() == [int((outcome == 0).sum()), int((outcome == 1).sum())]
    # Listening changes nothing.
    assert recorded(store) == recorded(uninterrupted)


def test_stages_are_named_in_the_order_of_the_algorithm() -> None:
    stages: list[str] = []
    take(disc(initial=8, budget=12, extra="validation.size = 10"), observer=Observer(stage=stages.append))
    assert stages == [
        "simulating the validation set",
        "simulating the initial design",
        "simulating the initial design",
        "learning",
        "proposing",
        "simulating",
        "learning",
    ]


def test_the_validation_set_is_outside_the_budget_and_changes_no_choice(uninterrupted: Store) -> None:
    seen: list[Progress] = []
    campaign = disc(extra="validation.size = 200")
    store = take(campaign, observer=Observer(seen.append))
    assert recorded(store) == recorded(uninterrupted)
    saved = store.read_set("validation-0")
    assert saved is not None
    X, results = saved
    assert len(X) == 200
    assert not np.isin(X, np.concatenate([batch.designs for batch in store.batches])).any()
    right = [
        (latent.moments(campaign.features(X)).mean > 0.0) == (results.outcome == 1)
        for latent in current(campaign, store, write=False).classifier.latents
    ]
    assert seen[-1].accuracy == np.mean(right[0])
    whole = sum(np.sum(results.outcome == code) * share for code, share in enumerate(seen[-1].recall.values()))
    assert whole == pytest.approx(np.sum(right[0]))
    assert [progress.accuracy is None for progress in seen] == [True] * INITIAL_COMMITS + [False] * 5


def test_the_validation_set_is_simulated_once() -> None:
    simulator = Counting()
    campaign = disc(simulator, extra="validation.size = 50")
    take(campaign, take(campaign, budget=16))
    assert simulator.rows == 50 + BUDGET


def test_asked_to_stop_the_campaign_ends_after_a_whole_batch_and_says_that_it_is_not_done() -> None:
    campaign = disc()
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(2) as executor:
        assert run(campaign, store, executor, BUDGET, stop_after(2, store)) is False
        assert [len(batch) for batch in store.batches] == [BATCH, BATCH]
        assert run(campaign, store, executor, BUDGET, stop_after(5, store)) is False
        assert [len(batch) for batch in store.batches] == [BATCH] * 5
        assert run(campaign, store, executor, BUDGET) is True
        assert run(campaign, store, executor, BUDGET) is True
    assert len(store.batches) == COMMITS


# --- interruption ------------------------------------------------------------------------------------------------


@pytest.mark.faults
def test_killed_after_any_event_and_resumed_a_campaign_is_the_uninterrupted_one_bit_for_bit(
    uninterrupted: Store, tmp_path: Path
) -> None:
    campaign, folder = disc(), tmp_path / "run"
    with FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store:
        take(campaign, store)
    for number, journal in enumerate(first_events(folder / "journal")[1:]):
        (folder / "journal").write_bytes(journal)
        if number % 2:
            # Otherwise there is the checkpoint of a later time.
            (folder / "checkpoint.h5").unlink(missing_ok=True)
        with FolderStore.open(folder, campaign.schema, write=True) as store:
            take(campaign, store)
            assert recorded(store) == recorded(uninterrupted)
            assert learned(store) == learned(uninterrupted)


@pytest.mark.faults
def test_stopped_after_every_batch_a_campaign_is_the_uninterrupted_one_bit_for_bit(uninterrupted: Store) -> None:
    store = MemoryStore(disc().schema)
    for commits in range(COMMITS + 1):
        take(disc(), store, observer=stop_after(commits, store))
    assert recorded(store) == recorded(uninterrupted)
    assert learned(store) == learned(uninterrupted)


def test_with_inducing_points_too_a_resumed_campaign_is_the_uninterrupted_one_bit_for_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for limit, points in (("EXACT", INITIAL_SIZE + BATCH), ("LEARNED_ON", INITIAL_SIZE), ("COARSE", INITIAL_SIZE - 4)):
        monkeypatch.setattr(fitting, limit, points)
    whole, store = take(disc()), MemoryStore(disc().schema)
    for commits in range(INITIAL_COMMITS, COMMITS + 1):
        take(disc(), store, observer=stop_after(commits, store))
    assert recorded(store) == recorded(whole)
    assert learned(store) == learned(whole)
    assert "broken/inducing" in learned(whole)[1]


@pytest.mark.parametrize("criterion", ["entropy", "globalmi"])
def test_shares_that_a_batch_cannot_hold_are_carried_over_an_interruption(criterion: str) -> None:
    extra = f'acquisition.criterion = "{criterion}"\nacquisition.exploration = 0.3'
    store = MemoryStore(disc().schema)
    for commits in range(INITIAL_COMMITS, COMMITS + 1):
        campaign = disc(extra=extra)
        take(campaign, store, observer=stop_after(commits, store))
    assert recorded(store) == recorded(take(disc(extra=extra)))
    # 30 % of 4, 8, 12 and 16 designs, rounded, are no choice of a classifier: they come first in their batch.
    for iteration, explored in enumerate([1, 1, 2, 1], start=1):
        rng = stream(campaign.settings.seed, "propose", iteration)
        drawn = campaign.space.latin_hypercube(explored, rng)
        X = store.batches[INITIAL_COMMITS + iteration - 1].designs
        assert np.array_equal(X[:explored], drawn)


class Struck:
    """A disc that receives Ctrl-C once, during the simulation with this number."""

    outcomes, causes, margins, releases_gil = Disc.outcomes, Disc.causes, Disc.margins, True

    def __init__(self, at: int) -> None:
        self.left = at

    def run(self, X: Array) -> Results:
        left, self.left = self.left, self.left - len(X)
        if 0 <= left < len(X):
            # An exception of this name that a simulator raises is its own fault, not Ctrl-C.
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        return Disc().run(X)


@pytest.mark.faults
@pytest.mark.parametrize("at", [0, 5, 14, 27])
def test_interrupted_in_the_middle_of_a_batch_and_resumed_a_campaign_is_the_uninterrupted_one(
    at: int, uninterrupted: Store
) -> None:
    campaign = disc(Struck(at))
    store = MemoryStore(campaign.schema)
    with pytest.raises(KeyboardInterrupt):
        take(campaign, store, workers=1)
    assert len(store.batches) == at // BATCH
    take(disc(), store)
    assert recorded(store) == recorded(uninterrupted)
    assert learned(store) == learned(uninterrupted)


@pytest.mark.parametrize("commits", [INITIAL_COMMITS, INITIAL_COMMITS + 2, COMMITS])
def test_what_was_learned_is_learned_again_when_its_file_is_gone(
    commits: int, uninterrupted: Store, tmp_path: Path
) -> None:
    campaign = disc()
    with FolderStore.create(tmp_path / "run", campaign.settings.text(), campaign.schema) as store:
        take(campaign, store, observer=stop_after(commits, store))
    (tmp_path / "run" / "checkpoint.h5").unlink()
    with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store:
        take(campaign, store)
        assert recorded(store) == recorded(uninterrupted)
        assert learned(store) == learned(uninterrupted)


def test_an_older_state_does_as_well_as_the_newest(uninterrupted: Store, tmp_path: Path) -> None:
    campaign = disc()
    with FolderStore.create(tmp_path / "run", campaign.settings.text(), campaign.schema) as store:
        take(campaign, store, observer=stop_after(6, store))
    with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store:
        newest = store.latest_state()
        assert newest is not None
        store.reject_state(newest[0], "is not used")
        assert store.latest_state() is not None
        take(campaign, store)
        assert recorded(store) == recorded(uninterrupted)
        assert learned(store) == learned(uninterrupted)


def test_reading_what_was_learned_writes_nothing_and_gives_what_the_running_loop_has(
    uninterrupted: Store, tmp_path: Path
) -> None:
    campaign = disc()
    with FolderStore.create(tmp_path / "run", campaign.settings.text(), campaign.schema) as store:
        take(campaign, store)
    (tmp_path / "run" / "checkpoint.h5").unlink()
    probe = campaign.space.sobol(64, np.random.default_rng(0))

    def predicted(of: Store) -> bytes:
        classifier: Classifier = current(campaign, of, write=False).classifier
        return classifier.probabilities(probe).tobytes()

    with FolderStore.open(tmp_path / "run", campaign.schema, write=False) as store, one_thread():
        assert predicted(store) == predicted(uninterrupted)
    assert not (tmp_path / "run" / "checkpoint.h5").exists()


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_the_number_of_workers_changes_no_bit(workers: int, uninterrupted: Store) -> None:
    store = take(disc(), workers=workers)
    assert recorded(store) == recorded(uninterrupted)
    assert learned(store) == learned(uninterrupted)


@pytest.mark.parametrize("budget", [INITIAL_SIZE, INITIAL_SIZE + 2 * BATCH])
def test_taken_beyond_its_budget_a_campaign_is_the_one_that_had_the_larger_budget(
    budget: int, uninterrupted: Store
) -> None:
    campaign = disc(budget=budget)
    store = take(campaign)
    assert sum(len(batch) for batch in store.batches) == budget
    take(campaign, store, BUDGET)
    assert recorded(store) == recorded(uninterrupted)
    assert learned(store) == learned(uninterrupted)


def test_a_budget_that_is_spent_already_changes_nothing() -> None:
    store = take(disc())
    before = recorded(store), learned(store)
    take(disc(), store, budget=20)
    assert (recorded(store), learned(store)) == before


@pytest.mark.parametrize("budget", [2, 6, 8])
def test_halted_within_the_seed_by_a_smaller_budget_and_resumed_a_campaign_goes_on_with_the_whole_seed(
    budget: int,
) -> None:
    campaign = disc()
    store = take(campaign, budget=budget)
    take(campaign, store)
    assert designs(store, INITIAL).tobytes() == initial_designs(campaign).tobytes()
    assert sum(len(batch) for batch in store.batches) == BUDGET
    # Cut into other batches or not, the seed is the same, and so is all that was learned from it.
    straight = take(campaign)
    assert designs(store, ACTIVE).tobytes() == designs(straight, ACTIVE).tobytes()
    assert learned(store) == learned(straight)


# --- killed --------------------------------------------------------------------------------------------------------

# With a budget that is never reached: the killer may come late.
ENDLESS = "seed = 11\nsampling = { initial = 40, budget = 5000, batch = 5 }\n"


def kill_after(command: list[str], folder: Path, number: int, delay: float) -> None:
    """Start a command and kill it -9 some time after there are so many batches, wherever it is by then."""
    log = folder.parent / f"killed-{number}.txt"
    with log.open("w") as file:
        process = subprocess.Popen([sys.executable, "-m", "activefail.cli", *command], stdout=file, stderr=file)
    give_up = time.monotonic() + PATIENCE
    try:
        while _batches(folder) < number:
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < give_up, log.read_text()
            time.sleep(0.002)
        time.sleep(delay)
    finally:
        process.kill()
    assert process.wait() == -signal.SIGKILL, log.read_text()


def _batches(folder: Path) -> int:
    if not (folder / "campaign.toml").exists():
        return 0
    with FolderStore.open(folder, write=False) as store:
        return len(store.batches)


@pytest.mark.faults
def test_a_campaign_killed_twice_and_resumed_is_the_uninterrupted_one_bit_for_bit(tmp_path: Path) -> None:
    write_campaign(tmp_path / "made.toml", ENDLESS)
    folder = tmp_path / "run"
    delays = np.random.default_rng(time.time_ns()).uniform(0.0, 0.2, 2).tolist()
    begin = ["run", str(tmp_path / "made.toml"), "--out", str(folder), "--workers", "2"]
    kill_after(begin, folder, 2, delays[0] / 10.0)
    kill_after(["resume", str(folder), "--workers", "1"], folder, 9, delays[1])

    campaign = Campaign.of(read_settings(tmp_path / "made.toml"), tmp_path)
    with open_campaign(folder, write=True, code=tmp_path) as (reopened, store):
        assert len(store.batches) >= 9
        budget = max(120, 5 * len(store.batches) + 5)
        straight = take(campaign, budget=budget, workers=2)
        take(reopened, store, budget=budget)
        assert recorded(store) == recorded(straight)
        assert learned(store) == learned(straight)
