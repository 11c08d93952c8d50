"""The stop rule for a probability in campaigns without batches: its check runs while other designs are in flight."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from loop.test_asynchronous import Arbitrary, kept
from loop.test_probability_rule import PROBABILITY, FourBranch, campaign_on

from activefail.campaign.assembly import Campaign
from activefail.loop.asynchronous import Course, learned_so_far, resumed
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.progress import Observer, Progress
from activefail.record.batch import ACTIVE, CHECK, INITIAL, Batch
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.surrogate.state import classifier_state
from activefail.surrogate.threads import one_thread

FLIGHT, BUDGET = 6, 120


def plan(seed: int = 2, **changes: object) -> Campaign:
    return campaign_on(FourBranch(), seed=seed, sampling__batch=FLIGHT, sampling__asynchronous=True, **changes)


def take(campaign: Campaign, store: Store, observer: Observer | None = None, **options: bool) -> Store:
    run(campaign, store, Arbitrary(), BUDGET, observer, **options)
    return store


def bits(course: Course) -> tuple[object, ...]:
    check = None if course.check is None else (course.check.waiting.tobytes(), course.check.answered)
    state = {} if course.classifier is None else classifier_state(course.classifier)
    looks = (course.looks.table.tobytes(), course.looks.is_known, course.known_through)
    return course.iteration, course.flight.tobytes(), looks, check, {name: one.tobytes() for name, one in state.items()}


def copied(campaign: Campaign, store: Store) -> MemoryStore:
    """The record alone, without saved states."""
    bare = MemoryStore(campaign.schema)
    for batch in store.batches:
        bare.commit(batch)
    return bare


@pytest.fixture(scope="module")
def ended() -> tuple[Campaign, Store]:
    """A campaign that ended while designs were in flight.

    Rounding, and with it the course of a campaign, differs between processors: the seed is the first with such an end.
    """
    for seed in range(2, 12):
        campaign = plan(seed)
        store = take(campaign, MemoryStore(campaign.schema))
        if last_of_check(store) < len(store.batches) and len(History.of(store.batches)) < BUDGET:
            return campaign, store
    pytest.fail("no seed from 2 to 11 has designs in flight at its end")


@pytest.fixture(scope="module")
def checking(ended: tuple[Campaign, Store], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Course]:
    """A run folder at the beginning of a check, and its course."""
    campaign, whole = ended
    first = next(number for number, batch in enumerate(whole.batches) if (batch.origin == CHECK).any())
    folder = tmp_path_factory.mktemp("checking") / "run"
    with FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store, one_thread():
        for batch in whole.batches[:first]:
            store.commit(batch)
        return folder, resumed(campaign, store)


def test_it_ends_by_itself_after_a_check_that_contradicted_nothing(ended: tuple[Campaign, Store]) -> None:
    campaign, store = ended
    history = History.of(store.batches)
    assert len(history) < BUDGET
    assert set(history.origin.tolist()) == {INITIAL, ACTIVE, CHECK}
    assert (history.origin == CHECK).sum() >= 4 + 2 * 2
    learned = learned_so_far(campaign, store, write=False)
    assert learned.looks.is_known
    assert learned.looks.probability == pytest.approx(PROBABILITY, rel=0.25)
    # A check is simulated beside active designs: no more than these are in flight.
    commits = [set(batch.origin.tolist()) for batch in store.batches]
    assert sum(CHECK in origins for origins in commits) > 1


def test_resumed_after_its_end_it_simulates_nothing_more(ended: tuple[Campaign, Store]) -> None:
    campaign, store = ended
    again = copied(campaign, store)
    again.write_state(*store.latest_state())
    take(campaign, again)
    assert kept(again) == kept(store)


def last_of_check(store: Store) -> int:
    """Number of commits through the last one of a check; 0 without one."""
    checks = (number for number, batch in enumerate(store.batches, start=1) if (batch.origin == CHECK).any())
    return max(checks, default=0)


@pytest.fixture(scope="module")
def stopped(ended: tuple[Campaign, Store], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The folder of the campaign as stops within its check and right after it leave it."""
    campaign, whole = ended
    last, folder = last_of_check(whole), tmp_path_factory.mktemp("stopped")
    with FolderStore.create(folder / "run", campaign.settings.text(), campaign.schema) as store, one_thread():

        class Stop(Exception):  # noqa: N818  (at once, as a kill would)
            pass

        def halt(progress: Progress) -> None:
            if len(store.batches) == last - 1:
                shutil.copytree(folder / "run", folder / "within", dirs_exist_ok=True)
            if len(store.batches) == last:
                raise Stop

        with pytest.raises(Stop):
            take(campaign, store, Observer(halt))
    return {"within the check": folder / "within", "after the check": folder / "run"}


@pytest.mark.parametrize("when", ["within the check", "after the check"])
def test_stopped_at_once_it_continues_to_the_same_campaign(
    ended: tuple[Campaign, Store], stopped: dict[str, Path], tmp_path: Path, when: str
) -> None:
    campaign, whole = ended
    commits = last_of_check(whole) - (when == "within the check")
    # Some designs were in flight when the check passed; they belong to the campaign.
    assert commits < len(whole.batches)
    folder = shutil.copytree(stopped[when], tmp_path / "run")
    with FolderStore.open(folder, campaign.schema, write=True) as store:
        assert len(store.batches) == commits
        with one_thread():
            saved = resumed(campaign, store)
            assert bits(saved) == bits(resumed(campaign, copied(campaign, store)))
        assert (saved.check is None, saved.looks.is_known) == (when == "after the check",) * 2
        assert (saved.known_through > 0) == (when == "after the check")
    with FolderStore.open(folder, campaign.schema, write=True) as store:
        take(campaign, store)
        assert kept(store) == kept(whole)


def test_a_reader_learns_the_same_from_the_record_alone(ended: tuple[Campaign, Store]) -> None:
    campaign, whole = ended
    with one_thread():
        saved, alone = (learned_so_far(campaign, one, write=False) for one in (whole, copied(campaign, whole)))
    assert alone.looks.is_known
    assert alone.looks.table.tobytes() == saved.looks.table.tobytes()


@pytest.mark.parametrize(
    ("failed", "is_wide", "known"), [(0, False, True), (2, False, True), (3, False, False), (0, True, False)]
)
def test_a_check_passes_if_enough_of_it_gave_an_outcome_and_the_posterior_is_still_narrow(
    ended: tuple[Campaign, Store],
    checking: tuple[Path, Course],
    monkeypatch: pytest.MonkeyPatch,
    failed: int,
    is_wide: bool,
    known: bool,
) -> None:
    (campaign, whole), (_, before) = ended, checking
    assert before.check is not None
    assert before.classifier is not None
    first = next(number for number, batch in enumerate(whole.batches) if (batch.origin == CHECK).any())
    X = before.check.waiting
    results = campaign.simulator.run(X)
    outcome, margins = results.outcome.copy(), results.margins.copy()
    # What the classifier expects, so that nothing contradicts it.
    moments = before.classifier.latents[0].moments(campaign.features(X))
    outcome[:] = moments.mean > 0.0
    margins[:] = np.nan
    outcome[:failed] = NUMERICAL_FAILURE
    answered = Results(outcome, results.cause, margins, results.seconds)
    batch = Batch(before.next_iteration, X, np.full(len(X), CHECK, dtype=np.int8), answered)
    row = before.looks.table[-1:] * (np.array([1.0, 1.0, 100.0, 1.0]) if is_wide else 1.0)
    monkeypatch.setattr("activefail.loop.asynchronous.look", lambda *_: row)
    monkeypatch.setattr("activefail.loop.asynchronous.learn", lambda *_: before.classifier)
    with one_thread():
        after = before.after(campaign, (*whole.batches[:first], batch))
    assert after.looks.is_known is known
    n = len(History.of(whole.batches[:first])) + len(X)
    pending = [row for row in before.flight.tolist() if row not in X.tolist()]
    assert after.known_through == (n + len(pending) if known else 0)


def test_more_simulations_than_were_in_flight_at_the_check_meet_the_rule_no_longer(
    ended: tuple[Campaign, Store],
) -> None:
    campaign, store = ended
    more = copied(campaign, store)
    more.write_state(*store.latest_state())
    with one_thread():
        known_through = resumed(campaign, more).known_through
    assert len(History.of(store.batches)) <= known_through
    run(campaign, more, Arbitrary(), known_through + 1, use_stop_rule=False)
    with one_thread():
        assert not resumed(campaign, more).looks.is_known


def test_a_contradiction_ends_the_check_and_the_search_continues(
    ended: tuple[Campaign, Store], checking: tuple[Path, Course]
) -> None:
    (campaign, store), (_, before) = ended, checking
    first = next(number for number, batch in enumerate(store.batches) if (batch.origin == CHECK).any())
    changed = MemoryStore(campaign.schema)
    for batch in store.batches[:first]:
        changed.commit(batch)
    assert before.check is not None
    batch = store.batches[first]
    rows = batch.origin == CHECK
    margins = batch.results.margins.copy()
    margins[rows] += 50.0
    results = type(batch.results)(
        np.where(rows, 0, batch.results.outcome).astype(np.int8), batch.results.cause, margins, batch.results.seconds
    )
    changed.commit(type(batch)(batch.iteration, batch.designs, batch.origin, results))
    with one_thread():
        after = before.after(campaign, changed.batches)
    assert after.check is None
    assert len(after.looks.table) == 1
    assert not after.looks.is_known


ANSWERED = np.empty(0)
"""Stands for a design that has a result."""


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("check/answered", np.array(-1)),
        ("check/answered", np.array(8)),
        ("check/known_through", np.array(10**6)),
        ("check/known_through", np.array(0.5)),
        ("check/waiting", np.zeros((2, 3))),
        ("check/waiting", np.zeros((0, 2))),
        ("check/waiting", np.full((1, 2), np.nan)),
        ("check/waiting", ANSWERED),
        ("stop/looks", np.zeros((1, 3))),
        ("stop/known", np.array(2)),
    ],
)
def test_a_saved_check_that_no_campaign_saves_is_rejected(
    ended: tuple[Campaign, Store],
    checking: tuple[Path, Course],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    key: str,
    value: np.ndarray,
) -> None:
    campaign, (folder, expected) = ended[0], checking

    def train_again(*_: object) -> None:
        raise AssertionError("trains again")

    shutil.copytree(folder, tmp_path / "run")
    with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store, one_thread():
        iteration, state = store.latest_state()
        assert {"check/waiting", "check/answered"} <= set(state)
        assert bits(resumed(campaign, store)) == bits(expected)
        wrong = History.of(store.batches).designs[:1] if value is ANSWERED else value
        store.write_state(iteration, state | {key: wrong})
        # Only the saved states before are left, and these are none.
        monkeypatch.setattr("activefail.loop.asynchronous.learn", train_again)
        with pytest.raises(AssertionError, match="trains again"):
            resumed(campaign, store)
        assert any("skipped" in warning for warning in store.warnings)
