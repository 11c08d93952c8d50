"""Campaigns without batches: the record alone says what is in flight, however they were interrupted."""

import hashlib
import os
import re
import signal
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import HIGH, LOW, Brittle, Disc, Dozing, disc
from cases import some
from commandline import activefail, record, started, wait_for
from patience import PATIENCE, until
from pounding import write_campaign

from activefail.campaign.assembly import Campaign
from activefail.errors import InputError, SimulationError
from activefail.execution.executor import Arrived
from activefail.execution.local import ProcessExecutor, ThreadExecutor
from activefail.loop.asking import ask
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.initial import initial_designs
from activefail.loop.learning import classifier_after, current
from activefail.loop.progress import Observer, Progress
from activefail.loop.running import run
from activefail.loop.telling import add, correct, tell
from activefail.record.batch import ACTIVE, INITIAL
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.record.store import Store
from activefail.simulators.interface import Results, Simulator
from activefail.space.space import Array

INITIAL_SIZE, BUDGET, SIZE = 12, 30, 4


def plan(
    simulator: Simulator | None = None, budget: int = BUDGET, batch: int = SIZE, extra: str = "", seed: int = 1
) -> Campaign:
    return disc(simulator, seed, initial=INITIAL_SIZE, budget=budget, batch=batch, asynchronous=True, extra=extra)


class Arbitrary:
    """Answers some of the designs that it has, in an order that looks random and depends on the designs alone."""

    def __init__(self) -> None:
        self.waiting: dict[int, Array] = {}
        self.simulator: Simulator = Disc()
        self.most = 0

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        return simulator.run(X)

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        assert not any(np.array_equal(x, other) for other in self.waiting.values())
        self.waiting[ticket] = x
        self.simulator = simulator
        self.most = max(self.most, len(self.waiting))

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        order = sorted(self.waiting, key=lambda ticket: hashlib.sha256(self.waiting[ticket].tobytes()).digest())
        share = 1 + hashlib.sha256(self.waiting[order[0]].tobytes()).digest()[0] % len(order)
        return [(ticket, self.simulator.run(self.waiting.pop(ticket)[None])) for ticket in order[:share]]

    def __enter__(self) -> "Arbitrary":
        return self

    def __exit__(self, *exception: object) -> None: ...


def take(
    campaign: Campaign, store: Store | None = None, budget: int = BUDGET, observer: Observer | None = None
) -> Store:
    store = store or MemoryStore(campaign.schema)
    run(campaign, store, Arbitrary(), budget, observer)
    return store


def kept(store: Store) -> list[tuple[int, bytes, bytes, bytes, bytes]]:
    return [
        (b.iteration, b.id.tobytes(), b.designs.tobytes(), b.origin.tobytes(), b.results.outcome.tobytes())
        for b in store.batches
    ]


def first_events(journal: Path) -> list[bytes]:
    """A journal as it was after each of its events."""
    data = journal.read_bytes()
    begins = [match.start() for match in re.finditer(rb"activefail [0-9a-f]{64} ", data)]
    return [data[:end] for end in (*begins[1:], len(data))]


@pytest.fixture(scope="module")
def uninterrupted() -> Store:
    return take(plan())


def test_every_design_is_asked_for_once_and_the_initial_ones_first(uninterrupted: Store) -> None:
    campaign = plan()
    X = np.concatenate([batch.designs for batch in uninterrupted.batches])
    origin = np.concatenate([batch.origin for batch in uninterrupted.batches])
    assert len(X) == BUDGET
    assert len(np.unique(X, axis=0)) == BUDGET
    initial = initial_designs(campaign)
    assert sorted(map(tuple, X[origin == INITIAL])) == sorted(map(tuple, initial))
    assert (origin == ACTIVE).sum() == BUDGET - INITIAL_SIZE
    # Chosen designs were begun before the last of the initial ones was answered, which is the point of it.
    assert np.flatnonzero(origin == INITIAL).max() > np.flatnonzero(origin == ACTIVE).min()
    assert [batch.iteration for batch in uninterrupted.batches] == sorted(b.iteration for b in uninterrupted.batches)
    training = History.of(uninterrupted.batches).training
    assert sorted(map(tuple, training.designs[training.initial])) == sorted(map(tuple, initial))


def test_as_many_designs_are_in_flight_as_the_campaign_says_whatever_the_workers() -> None:
    campaign, executor = plan(), Arbitrary()
    run(campaign, MemoryStore(campaign.schema), executor, BUDGET)
    assert executor.most == SIZE


def test_what_is_chosen_lies_apart_from_what_is_in_flight(uninterrupted: Store) -> None:
    X = (np.concatenate([batch.designs for batch in uninterrupted.batches]) - LOW) / (HIGH - LOW)
    distances = np.linalg.norm(X[:, None] - X[None], axis=2)[np.triu_indices(len(X), 1)]
    assert distances.min() > 1e-3


def test_asked_to_stop_it_waits_for_what_is_in_flight_and_begins_nothing_more() -> None:
    campaign = plan()
    store, executor = MemoryStore(campaign.schema), Arbitrary()
    assert not run(campaign, store, executor, BUDGET, Observer(stop=lambda: sum(map(len, store.batches)) >= 16))
    assert executor.waiting == {}
    done = sum(map(len, store.batches))
    assert 16 <= done <= 16 + 2 * SIZE
    assert run(campaign, store, Arbitrary(), BUDGET)
    assert sum(map(len, store.batches)) == BUDGET


@pytest.mark.slow
def test_killed_after_any_event_it_goes_on_to_the_same_campaign(
    uninterrupted: Store, tmp_path: Path, every_fault: bool
) -> None:
    campaign = plan()
    with FolderStore.create(tmp_path / "run", campaign.settings.text(), campaign.schema) as store:
        take(campaign, store)
        assert kept(store) == kept(uninterrupted)
    journals = first_events(tmp_path / "run" / "journal")
    for journal in journals if every_fault else journals[1::7]:
        # With the checkpoint of a later time, and without any.
        (tmp_path / "run" / "journal").write_bytes(journal)
        with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store:
            take(campaign, store)
            assert kept(store) == kept(uninterrupted)
            assert len(HandedOut.of(store).in_flight) == 0


class Paced(ThreadExecutor):
    """One worker. When an answer is wanted it has simulated all designs in flight, or no more than are answered."""

    def __init__(self, ahead: bool) -> None:
        super().__init__(1, self.permitted)
        self.ahead, self.flight, self.permits = ahead, 0, threading.Semaphore(0)

    def permitted(self, simulator: Simulator, X: Array) -> Results:
        assert self.permits.acquire(timeout=PATIENCE)
        return simulator.run(X)

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        self.flight += 1
        if self.ahead:
            self.permits.release()
        super().start(simulator, ticket, x)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        if self.ahead:
            until(lambda: self._done.qsize() == self.flight, "all designs in flight")
        else:
            self.permits.release()
        arrived = super().answered(PATIENCE)
        self.flight -= len(arrived)
        return arrived


def paced(store: Store, ahead: bool) -> list[tuple[int, bytes, bytes, bytes, bytes]]:
    with Paced(ahead) as executor:
        run(plan(batch=3), store, executor, BUDGET)
    return kept(store)


@pytest.mark.slow
def test_with_one_worker_the_campaign_does_not_depend_on_its_speed_and_goes_on_the_same_after_a_kill(
    tmp_path: Path,
) -> None:
    campaign = plan(batch=3)
    with FolderStore.create(tmp_path / "run", campaign.settings.text(), campaign.schema) as store:
        slow = paced(store, ahead=False)
    assert paced(MemoryStore(campaign.schema), ahead=True) == slow
    for journal in first_events(tmp_path / "run" / "journal")[5::30]:
        (tmp_path / "run" / "journal").write_bytes(journal)
        with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store:
            assert paced(store, ahead=True) == slow


def test_a_finished_campaign_has_nothing_in_flight_and_continues_to_a_larger_budget() -> None:
    campaign = plan()
    store = take(campaign, budget=20)
    assert len(HandedOut.of(store).in_flight) == 0
    take(campaign, store)
    assert len(np.unique(History.of(store.batches).designs, axis=0)) == BUDGET


def test_designs_are_asked_for_added_and_corrected_beside_the_loop() -> None:
    campaign = plan()
    store = take(campaign, budget=16)
    asked = ask(campaign, store, 3, BUDGET).designs
    X = campaign.space.from_unit(np.array([[0.3, 0.6]]))
    assert add(campaign, store, X, campaign.simulator.run(X)) == 1
    first = History.of(store.batches)[:1]
    results = campaign.simulator.run(first.designs)
    wrong = Results((1 - results.outcome).astype(np.int8), results.cause, results.margins, results.seconds)
    assert correct(campaign, store, first.id, wrong) == correct(campaign, store, first.id, results) == 1
    take(campaign, store)
    handed = HandedOut.of(store)
    assert (handed.in_flight.id.tolist(), handed.history.asked_for) == (asked.id.tolist(), BUDGET - 3)
    assert tell(campaign, store, asked.id, campaign.simulator.run(asked.designs)) == 3
    history = History.of(store.batches)
    assert (history.asked_for, len(np.unique(history.designs, axis=0))) == (BUDGET, BUDGET + 1)
    # What is learned follows from the record: which iteration each result belongs to.
    read = current(campaign, store, write=False).classifier
    again = classifier_after(campaign, History.of(store.batches))
    assert np.array_equal(read.probabilities(history.designs), again.probabilities(history.designs))


def test_numerical_failures_leave_the_flight_too() -> None:
    campaign = plan(Disc(blind=-1.0), extra="limits.numerical_failures = 1.0")
    store = take(campaign)
    assert sum(map(len, store.batches)) == BUDGET
    assert any((batch.results.outcome == -1).any() for batch in store.batches)


def test_a_design_that_failed_numerically_is_not_asked_for_again() -> None:
    campaign = plan(Brittle(), extra="limits.numerical_failures = 1.0", seed=3)
    store = take(campaign)
    X = np.concatenate([batch.designs for batch in store.batches])
    assert len(np.unique(X, axis=0)) == BUDGET
    assert sum((batch.results.outcome == -1).sum() for batch in store.batches) > 1


FOGGED = Disc(blind=np.inf)
"""A disc that never answers."""


def test_a_campaign_without_any_answer_stops_and_goes_on_with_other_initial_designs_once_mended() -> None:
    broken, mended = plan(FOGGED, 48), plan(budget=48)
    store = MemoryStore(mended.schema)
    for done in (12, 24):
        with pytest.raises(SimulationError, match=f"None of the {done} simulations .* first failed with cause `fog`"):
            take(broken, store, 48)
        assert sum(map(len, store.batches)) == done
    take(mended, store, 48)
    X = np.concatenate([batch.designs for batch in store.batches])
    origin = np.concatenate([batch.origin for batch in store.batches])
    assert len(np.unique(X, axis=0)) == 48
    assert sorted(map(tuple, X[origin == INITIAL])) == sorted(map(tuple, initial_designs(mended, 3)))


@dataclass(frozen=True)
class Reticent(Disc):
    """A disc that answers no design of some."""

    silent: tuple[tuple[float, ...], ...] = ()

    def run(self, X: Array) -> Results:
        return (FOGGED if tuple(X[0].tolist()) in self.silent else Disc()).run(X)


def test_where_only_the_last_initial_design_is_answered_all_others_are_waited_for_before_any_is_chosen() -> None:
    store = MemoryStore(plan().schema)
    with pytest.raises(SimulationError):
        take(plan(FOGGED), store)
    order = [tuple(row) for batch in store.batches for row in batch.designs.tolist()]
    campaign = plan(Reticent(silent=tuple(order[:-1])), extra="limits.numerical_failures = 1.0")
    store = take(campaign)
    X = np.concatenate([batch.designs for batch in store.batches])
    origin = np.concatenate([batch.origin for batch in store.batches])
    assert (origin[:INITIAL_SIZE] == INITIAL).all()
    assert (origin[INITIAL_SIZE:] == ACTIVE).all()
    assert [tuple(row) for row in X[:INITIAL_SIZE].tolist()] == order
    assert len(np.unique(X, axis=0)) == BUDGET


def test_a_rule_about_its_error_ends_it_when_it_is_verified(tmp_path: Path) -> None:
    campaign = plan(budget=200, extra="stop = { error = 0.2, confidence = 0.5, simulations = 20, every = 2 }")
    store = take(campaign, budget=200)
    assert INITIAL_SIZE <= sum(map(len, store.batches)) < 200


@pytest.mark.parametrize("every", some([False, True], False))
def test_interrupted_it_looks_at_its_error_when_it_would_have_without(
    monkeypatch: pytest.MonkeyPatch, every: bool
) -> None:
    # Every look that is due is taken, and none of them ends it.
    monkeypatch.setattr("activefail.estimates.error.could_show", lambda *_: True)
    campaign = plan(extra="stop = { error = 0.49, confidence = 0.999999, simulations = 10, every = 3 }")

    def looks(stopped: int | None) -> list[tuple[int, bool]]:
        verified: dict[int, bool] = {}

        class Stop(Exception):  # noqa: N818  (at once, as a kill would)
            pass

        def note(progress: Progress) -> None:
            verified[progress.done] = progress.error is not None
            if progress.done >= (stopped or BUDGET + 1) and progress.done != resumed_at:
                raise Stop

        store, resumed_at = MemoryStore(campaign.schema), -1
        try:
            take(campaign, store, observer=Observer(note))
        except Stop:
            resumed_at = sum(len(batch) for batch in store.batches)
            stopped = None
            take(campaign, store, observer=Observer(note))
        return sorted(verified.items())

    whole = looks(None)
    assert [looked for _, looked in whole].count(True) == 2
    first = [looked for _, looked in whole].index(True)
    # Before the first look, at it and after it.
    for done, _ in whole[1:-2] if every else whole[first - 1 : first + 2]:
        assert looks(done) == whole


def test_too_many_in_flight_for_the_initial_design_are_refused() -> None:
    with pytest.raises(InputError, match=r"`initial` must be at least twice `batch` if asynchronous, got 12 and 7"):
        plan(batch=7)


@pytest.mark.parametrize("executor", [ThreadExecutor, ProcessExecutor])
def test_real_workers_answer_in_the_order_of_their_coming_and_the_record_says_all(
    executor: type[ThreadExecutor] | type[ProcessExecutor],
) -> None:
    campaign = plan(Dozing())
    store = MemoryStore(campaign.schema)
    with executor(3) as workers:
        assert run(campaign, store, workers, BUDGET)
    X = np.concatenate([batch.designs for batch in store.batches])
    assert len(np.unique(X, axis=0)) == BUDGET


@pytest.mark.usefixtures("without_pictures")
def test_an_asynchronous_campaign_of_the_command_line_is_run_resumed_and_reported(tmp_path: Path) -> None:
    text = "seed = 2\nsampling = { initial = 20, budget = 30, batch = 4, asynchronous = true }\n"
    write_campaign(tmp_path / "mine.toml", text)
    assert activefail("run", tmp_path / "mine.toml", "--out", tmp_path / "run", "--budget", "26").code == 0
    assert activefail("resume", tmp_path / "run", "--budget", "30").code == 0
    rows = record(tmp_path / "run")
    assert len(rows) == 30
    assert sum(row["origin"] == "seed" for row in rows) == 20
    assert "30 simulations, 26 planned" in activefail("status", tmp_path / "run").out
    assert activefail("report", tmp_path / "run").code == 0


NOTING = """
import itertools, pathlib, time
def run(design):
    folder = pathlib.Path(__file__).parent
    # Which one in order this is, of all processes: a name is given to one link only.
    for number in itertools.count(1):
        try:
            (folder / f"begun-{number}").symlink_to(repr(design["x"]))
            break
        except FileExistsError:
            pass
    while number > 13 and not (folder / "open").exists():
        time.sleep(0.02)
    return "failure" if design["x"] > 1.5 else "safe"
"""

TOML = """
seed = 5
sampling = { initial = 12, budget = 200, batch = 4, asynchronous = true }
simulator = { python = "noting:run", repeatable = true }
[space]
x = { low = 0.0, high = 4.0 }
y = { low = 1.0, high = 3.0 }
"""


@pytest.mark.parametrize("signals", [1, 2])
def test_ctrl_c_says_what_becomes_of_the_simulations_in_flight(tmp_path: Path, signals: int) -> None:
    (tmp_path / "noting.py").write_text(NOTING)
    (tmp_path / "mine.toml").write_text(TOML)
    folder = tmp_path / "run"

    def begun() -> set[str]:
        return {os.readlink(path) for path in tmp_path.glob("begun-*")}

    with started("run", tmp_path / "mine.toml", "--out", folder, "--workers", "4") as process:
        until(lambda: process.poll() is not None or len(begun()) == 13 + SIZE, "four that are held")
        assert process.poll() is None, process.communicate()
        process.send_signal(signal.SIGINT)
        wait_for(process.stderr, "stopping: waiting for the simulations in flight")
        if signals == 2:
            process.send_signal(signal.SIGINT)
        else:
            (tmp_path / "open").touch()
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert "batch" not in err
    in_flight, recorded = begun(), {row["x"] for row in record(folder)}
    if signals == 1:
        assert err.splitlines()[-1].startswith("stopped with nothing in flight. Continue with: activefail resume")
        assert recorded == in_flight
    else:
        last = "stopped; recorded simulations are safe, those in flight will be simulated again. Continue with: "
        assert err.splitlines()[-1].startswith(last)
        assert len(in_flight - recorded) == SIZE
        (tmp_path / "open").touch()
        result = activefail("resume", folder, "--code", tmp_path, "--budget", str(len(in_flight)))
        assert result.code == 0, result.err
        assert {row["x"] for row in record(folder)} == begun() == in_flight
