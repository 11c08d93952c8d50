"""Simulations done elsewhere: handed out once, told in any order, with the bits of the loop."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import CENTRE, Disc, disc
from hypothesis import settings as examples
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import create_folder
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError, SimulationError
from activefail.execution.local import ThreadExecutor
from activefail.loop import proposing
from activefail.loop.asking import ask
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.initial import initial_designs
from activefail.loop.learning import Learned, classifier_after, current
from activefail.loop.running import run
from activefail.loop.telling import RowsError, add, correct, drop, tell
from activefail.record.asked import Asked
from activefail.record.batch import GIVEN, INITIAL, columns_of
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space.space import Array

INITIAL_SIZE, BUDGET, BATCH = 12, 28, 4


def take(campaign: Campaign, store: Store | None = None, budget: int = BUDGET) -> Store:
    store = MemoryStore(campaign.schema) if store is None else store
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, budget)
    return store


def asked_and_told(campaign: Campaign, parts: Callable[[Asked], list[Asked]], store: Store | None = None) -> Store:
    """The store of a campaign whose every batch was asked for, and told in parts."""
    store = MemoryStore(campaign.schema) if store is None else store
    while len(designs := ask(campaign, store, BATCH, BUDGET).designs):
        for part in parts(designs):
            tell(campaign, store, part.id, campaign.simulator.run(part.designs))
    return store


def rows(store: Store) -> list[bytes]:
    """Every bit of a record but the wall times and the borders of commits."""
    columns = [columns_of(batch) | {"iteration": np.full(len(batch), batch.iteration)} for batch in store.batches]
    return [np.concatenate([one[name] for one in columns]).tobytes() for name in columns[0] if name != "seconds"]


def state(store: Store) -> tuple[int, dict[str, bytes]]:
    saved = store.latest_state()
    assert saved is not None
    return saved[0], {name: array.tobytes() for name, array in saved[1].items()}


@pytest.fixture(scope="module")
def looped() -> Store:
    return take(disc())


def whole(designs: Asked) -> list[Asked]:
    return [designs]


def in_two(designs: Asked) -> list[Asked]:
    return [designs[:1], designs[1:]]


def reversed_rows(designs: Asked) -> list[Asked]:
    return [designs[np.arange(len(designs))[::-1]]]


@pytest.mark.parametrize("parts", [whole, in_two, reversed_rows])
def test_a_campaign_that_is_asked_for_and_told_has_the_bits_of_the_loop(
    looped: Store, parts: Callable[[Asked], list[Asked]]
) -> None:
    told = asked_and_told(disc(), parts)
    assert rows(told) == rows(looped)
    current(disc(), told, write=True)
    assert state(told) == state(looped)


def test_the_bits_are_the_same_if_the_classifier_is_read_between_two_parts(looped: Store) -> None:
    campaign = disc()
    told = MemoryStore(campaign.schema)
    while len(designs := ask(campaign, told, BATCH, BUDGET).designs):
        for part in in_two(designs):
            tell(campaign, told, part.id, campaign.simulator.run(part.designs))
            current(campaign, told, write=True)
    assert rows(told) == rows(looped)
    current(campaign, told, write=True)
    assert state(told) == state(looped)


def test_the_bits_are_the_same_if_a_process_remembers_what_it_has_learned(looped: Store) -> None:
    campaign, learned = disc(), None
    told = MemoryStore(campaign.schema)
    while len((proposed := ask(campaign, told, BATCH, BUDGET, before=learned)).designs):
        for part in in_two(proposed.designs):
            tell(campaign, told, part.id, campaign.simulator.run(part.designs))
            # After the first part, what is remembered lacks a part of its iteration.
            learned = current(campaign, told, write=True, before=learned)
    assert rows(told) == rows(looped)
    assert state(told) == state(looped)


def test_what_is_remembered_is_not_learned_again_and_holds_until_its_iteration_goes_on() -> None:
    campaign = disc()
    store = take(campaign, budget=INITIAL_SIZE)

    def learned_since(before: Learned | None) -> Learned:
        return current(campaign, store, write=True, before=before)

    first = learned_since(None)
    proposed = ask(campaign, store, 2, BUDGET, before=first)
    assert learned_since(first) is proposed.learned is first
    tell(campaign, store, proposed.designs.id[:1], campaign.simulator.run(proposed.designs.designs[:1]))
    assert first.holds(HandedOut.of(store).history)
    second = learned_since(first)
    assert second is not first
    tell(campaign, store, proposed.designs.id[1:], campaign.simulator.run(proposed.designs.designs[1:]))
    assert not second.holds(HandedOut.of(store).history)


@pytest.mark.parametrize("loop_first", [True, False])
@pytest.mark.parametrize("at", [4, 12, 20])
def test_a_campaign_goes_from_the_loop_to_asking_and_back_with_the_same_bits(
    looped: Store, loop_first: bool, at: int
) -> None:
    campaign = disc()
    store: Store = MemoryStore(campaign.schema)
    if loop_first:
        take(campaign, store, at)
        asked_and_told(campaign, whole, store)
    else:
        while len(HandedOut.of(store).history) < at:
            designs = ask(campaign, store, BATCH, BUDGET).designs
            tell(campaign, store, designs.id, campaign.simulator.run(designs.designs))
        take(campaign, store)
    assert rows(store) == rows(looped)


def test_the_initial_design_is_handed_out_first_and_a_batch_ends_with_it() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    first = ask(campaign, store, 7, BUDGET)
    second = ask(campaign, store, 7, BUDGET)
    assert (len(first.designs), first.reason) == (7, "")
    assert (len(second.designs), second.reason) == (5, "the initial design ends here")
    third = ask(campaign, store, 7, BUDGET)
    assert len(third.designs) == 0
    assert "no simulation has given an outcome yet" in third.reason
    handed = HandedOut.of(store).in_flight
    assert handed.id.tolist() == list(range(12))
    assert (handed.origin == INITIAL).all()


def test_proposals_keep_away_from_the_designs_in_flight() -> None:
    campaign = disc()
    store = take(campaign, budget=INITIAL_SIZE)
    one_by_one = [ask(campaign, store, 1, BUDGET).designs for _ in range(8)]
    X = np.concatenate([one.designs for one in one_by_one])
    assert len(np.unique(X, axis=0)) == 8
    unit = campaign.space.to_unit(X)
    gaps = np.linalg.norm(unit[:, None] - unit[None], axis=2)[np.triu_indices(8, 1)]
    assert gaps.min() > 0.01
    assert [int(one.id[0]) for one in one_by_one] == list(range(12, 20))


def test_the_budget_counts_designs_in_flight_and_says_so() -> None:
    campaign = disc()
    store = take(campaign, budget=BUDGET - 3)
    proposed = ask(campaign, store, 5, BUDGET)
    assert len(proposed.designs) == 3
    assert "the campaign's budget of 28 simulations" in proposed.reason
    assert len(ask(campaign, store, 5, BUDGET).designs) == 0
    assert len(ask(campaign, store, 5, None).designs) == 5


def test_dropped_designs_are_neither_proposed_again_nor_counted() -> None:
    campaign = disc()
    store = take(campaign, budget=INITIAL_SIZE)
    first = ask(campaign, store, 4, BUDGET).designs
    assert drop(store, first.id[:2]) == 2
    assert drop(store, first.id[:2]) == 0
    assert HandedOut.of(store).in_flight.id.tolist() == first.id[2:].tolist()
    later = ask(campaign, store, 4, BUDGET).designs
    gaps = np.linalg.norm(
        campaign.space.to_unit(later.designs)[:, None] - campaign.space.to_unit(first.designs)[None, :2], axis=2
    )
    assert gaps.min() > 0.01
    with pytest.raises(RowsError, match=r"id 12 was dropped \(use `add` to record its result\); this row has safe"):
        tell(campaign, store, first.id[:1], results(0))


def results(*outcomes: int, margin: float = 0.5) -> Results:
    n = len(outcomes)
    return Results(np.array(outcomes, dtype=np.int8), np.zeros(n, dtype=np.int8), np.full((n, 1), margin), np.zeros(n))


def test_a_result_that_is_told_twice_is_recorded_once_and_another_one_is_refused() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    designs = ask(campaign, store, 2, BUDGET).designs
    assert tell(campaign, store, designs.id, results(0, 1)) == 2
    assert tell(campaign, store, designs.id, results(0, 1)) == 0
    way = r"\(to replace it: `tell --correct`, or `correct=True` in Python\)"
    with pytest.raises(
        RowsError, match=rf"id 1 already has the result broken, distance 0\.5 {way}; this row has safe, distance 0\.5"
    ):
        tell(campaign, store, designs.id, results(0, 0))
    assert len(HandedOut.of(store).history) == 2


def test_a_table_of_results_is_recorded_whole_or_not_at_all() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    designs = ask(campaign, store, 2, BUDGET).designs
    with pytest.raises(RowsError, match="id 7 is unknown") as caught:
        tell(campaign, store, np.array([0, 7]), results(0, 1))
    assert list(caught.value.reasons) == [1]
    with pytest.raises(
        RowsError, match=r"id 0 has the result safe, distance 0\.5 in an earlier row; this row has broken"
    ):
        tell(campaign, store, np.array([0, 0]), results(0, 1))
    assert store.batches == ()
    assert tell(campaign, store, np.array([0, 0]), results(0, 0)) == 1
    assert HandedOut.of(store).in_flight.id.tolist() == [1]
    assert len(designs) == 2


def test_added_simulations_are_learned_from_and_cover_the_initial_design_but_no_budget() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    X = campaign.space.from_unit(np.random.default_rng(5).random((40, 2)))
    assert add(campaign, store, X, campaign.simulator.run(X)) == 40
    assert add(campaign, store, X, campaign.simulator.run(X)) == 0
    take(campaign, store)
    history = HandedOut.of(store).history
    assert ((history.origin == GIVEN).sum(), history.asked_for, history.initial.sum()) == (40, BUDGET, 2)
    inside = current(campaign, store, write=False).classifier.probabilities(campaign.space.from_unit(CENTRE[None]))
    assert inside[0, 1] > 0.9


def test_an_added_design_in_flight_or_with_another_result_is_refused() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    designs = ask(campaign, store, 2, BUDGET).designs
    with pytest.raises(
        RowsError, match=r"the design is in flight with id 0 \(use `tell` to record its result\); this row has"
    ):
        add(campaign, store, designs.designs[:1], results(0))
    tell(campaign, store, designs.id, results(0, 1))
    way = r"\(to replace it: `tell --correct`, or `correct=True` in Python\)"
    with pytest.raises(
        RowsError,
        match=rf"the same design has the result safe, distance 0\.5 as id 0 {way}; if both .*; this row has broken",
    ):
        add(campaign, store, designs.designs[:1], results(1))
    assert add(campaign, store, designs.designs, results(0, 1)) == 0


def test_a_dropped_design_may_be_added_later() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    designs = ask(campaign, store, 2, BUDGET).designs
    drop(store, designs.id[:1])
    assert add(campaign, store, designs.designs[:1], results(1)) == 1
    handed = HandedOut.of(store)
    assert (handed.in_flight.id.tolist(), handed.history.id.tolist()) == ([1], [2])


def test_ids_count_what_entered_the_campaign_in_the_order_of_entering() -> None:
    campaign = disc()
    store = take(campaign, budget=INITIAL_SIZE)
    first = ask(campaign, store, 2, BUDGET).designs
    X = campaign.space.from_unit(np.array([[0.1, 0.2]]))
    add(campaign, store, X, campaign.simulator.run(X))
    second = ask(campaign, store, 2, BUDGET).designs
    assert (first.id.tolist(), second.id.tolist()) == ([12, 13], [15, 16])
    tell(campaign, store, second.id, campaign.simulator.run(second.designs))
    tell(campaign, store, first.id, campaign.simulator.run(first.designs))
    assert HandedOut.of(store).history.id.tolist() == [*range(12), 14, 15, 16, 12, 13]


def test_the_loop_leaves_designs_in_flight_alone_and_within_the_budget() -> None:
    campaign = disc()
    store = take(campaign, budget=INITIAL_SIZE)
    flight = ask(campaign, store, 3, BUDGET).designs
    take(campaign, store)
    handed = HandedOut.of(store)
    assert (handed.in_flight.id.tolist(), len(handed.history)) == (flight.id.tolist(), BUDGET - 3)
    tell(campaign, store, flight.id, campaign.simulator.run(flight.designs))
    assert len(HandedOut.of(store).history) == BUDGET


def test_the_loop_simulates_what_is_left_of_an_initial_design_and_waits_for_a_first_result() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    flight = ask(campaign, store, 5, BUDGET).designs
    take(campaign, store, INITIAL_SIZE)
    assert len(HandedOut.of(store).history) == INITIAL_SIZE - 5
    assert len(np.unique(np.concatenate([flight.designs, HandedOut.of(store).history.designs]), axis=0)) == 12
    empty = MemoryStore(campaign.schema)
    ask(campaign, empty, INITIAL_SIZE, BUDGET)
    with pytest.raises(InputError, match="Nothing can be simulated: no simulation has given an outcome yet"):
        take(campaign, empty)


@pytest.mark.parametrize("given", [False, True])
def test_a_design_in_flight_while_all_others_fail_leaves_a_campaign_that_can_learn(given: bool) -> None:
    store = MemoryStore(disc().schema)
    flight = ask(disc(), store, 1, BUDGET).designs
    with pytest.raises(
        SimulationError,
        match=r"Nothing can be simulated: no simulation has given an outcome yet.*`activefail tell`",
    ):
        take(disc(Disc(blind=np.inf)), store)
    campaign = disc()
    with pytest.raises(SimulationError, match="Nothing can be simulated"):  # nothing is simulated with it in flight
        take(campaign, store)
    if given:
        X = campaign.space.from_unit(np.array([[0.1, 0.2]]))
        add(campaign, store, X, campaign.simulator.run(X))
    tell(campaign, store, flight.id, campaign.simulator.run(flight.designs))
    assert set(HandedOut.of(store).history.iteration.tolist()) == {0}
    assert len(ask(campaign, store, 2, BUDGET).designs) == 2
    take(campaign, store)
    history = HandedOut.of(store).history
    assert (history.asked_for, history.last_iteration) == (BUDGET - 2, 4)


def test_a_given_design_of_a_later_hypercube_does_not_begin_it() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    X = initial_designs(campaign, 2)[-1:]
    add(campaign, store, X, campaign.simulator.run(X))
    assert len(HandedOut.of(store).initial_left(campaign)) == INITIAL_SIZE - 1
    take(campaign, store)
    assert HandedOut.of(store).history.initial.sum() == INITIAL_SIZE - 1


def test_an_initial_design_in_which_everything_failed_is_followed_by_another() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    first = ask(campaign, store, INITIAL_SIZE, BUDGET).designs
    tell(campaign, store, first.id, results(*[NUMERICAL_FAILURE] * INITIAL_SIZE, margin=np.nan))
    second = ask(campaign, store, 4, BUDGET).designs
    assert (second.origin == INITIAL).all()
    assert not np.isin(second.designs[:, 0], first.designs[:, 0]).any()


# --- any order of anything ---------------------------------------------------------------------------------------


class Interleaved(RuleBasedStateMachine):
    """Any order of ask, tell, drop, add, corrections, the loop, crash and reopening, in a run folder."""

    folder: Path

    @initialize(asynchronous=st.booleans())
    def begin(self, asynchronous: bool) -> None:
        self.campaign = disc(initial=4, budget=1000, batch=2, asynchronous=asynchronous)
        Interleaved.number += 1
        self.place = self.folder / str(Interleaved.number)
        self.store = create_folder(self.place, self.campaign)
        self.asked: dict[int, bytes] = {}
        self.told: dict[int, int] = {}
        self.dropped: set[int] = set()
        self.given: dict[bytes, int] = {}
        self.looped: dict[int, int] = {}

    number = 0

    def outcome(self, X: Array) -> Results:
        return self.campaign.simulator.run(X)

    @rule(n=st.integers(1, 3))
    def ask(self, n: int) -> None:
        proposed = ask(self.campaign, self.store, n, 1000)
        assert len(proposed.designs) == n or proposed.reason
        for number, design in zip(proposed.designs.id.tolist(), proposed.designs.designs, strict=True):
            assert number not in self.asked
            assert design.tobytes() not in {*self.asked.values(), *self.given}
            self.asked[number] = design.tobytes()

    def flight(self) -> list[int]:
        return sorted(self.asked.keys() - self.told.keys() - self.dropped)

    @precondition(lambda self: self.flight())
    @rule(data=st.data())
    def tell(self, data: st.DataObject) -> None:
        ids = data.draw(st.lists(st.sampled_from(self.flight()), min_size=1, unique=True))
        X = np.array([np.frombuffer(self.asked[number]) for number in ids])
        told = self.outcome(X)
        assert tell(self.campaign, self.store, np.array(ids), told) == len(ids)
        self.told |= dict(zip(ids, told.outcome.tolist(), strict=True))

    @precondition(lambda self: self.told)
    @rule(data=st.data(), other=st.booleans())
    def tell_again(self, data: st.DataObject, other: bool) -> None:
        number = data.draw(st.sampled_from(sorted(self.told)))
        if not other:
            assert tell(self.campaign, self.store, np.array([number]), self.result(number, self.told[number])) == 0
            return
        with pytest.raises(InputError, match="already"):
            tell(self.campaign, self.store, np.array([number]), self.result(number, 1 - self.told[number]))

    def result(self, number: int, outcome: int) -> Results:
        answer = self.outcome(np.frombuffer(self.asked[number])[None])
        return Results(np.array([outcome], dtype=np.int8), answer.cause, answer.margins, answer.seconds)

    @precondition(lambda self: self.given or self.looped)
    @rule(data=st.data())
    def correct_what_was_never_asked_for(self, data: st.DataObject) -> None:
        handed = HandedOut.of(self.store)
        rows_of = np.flatnonzero(~np.isin(handed.history.id, list(self.told)))
        row = data.draw(st.sampled_from(rows_of.tolist()))
        number, history = int(handed.history.id[row]), handed.history[row : row + 1]
        answer = self.outcome(history.designs)
        other = 1 - history.outcome
        results = Results(other, answer.cause, answer.margins, answer.seconds)
        assert correct(self.campaign, self.store, np.array([number]), results) == 1
        if history.origin[0] == GIVEN:
            self.given[history.designs.tobytes()] = int(other[0])
        else:
            self.looped[number] = int(other[0])

    @precondition(lambda self: self.told)
    @rule(data=st.data())
    def correct(self, data: st.DataObject) -> None:
        ids = data.draw(st.lists(st.sampled_from(sorted(self.told)), min_size=1, max_size=3, unique=True))
        results = Results.concatenate([self.result(number, 1 - self.told[number]) for number in ids])
        assert correct(self.campaign, self.store, np.array(ids), results) == len(ids)
        self.told |= {number: 1 - self.told[number] for number in ids}

    @precondition(lambda self: self.flight())
    @rule(data=st.data())
    def drop(self, data: st.DataObject) -> None:
        number = data.draw(st.sampled_from(self.flight()))
        assert drop(self.store, np.array([number])) == 1
        self.dropped.add(number)

    @rule(u=st.floats(0.01, 0.99), v=st.floats(0.01, 0.99))
    def add(self, u: float, v: float) -> None:
        X = self.campaign.space.from_unit(np.array([[u, v]]))
        before = X.tobytes() in self.given
        if before and self.given[X.tobytes()] != self.outcome(X).outcome[0]:
            with pytest.raises(InputError, match="the same design has the result"):
                add(self.campaign, self.store, X, self.outcome(X))
            return
        assert add(self.campaign, self.store, X, self.outcome(X)) == (not before)
        self.given.setdefault(X.tobytes(), int(self.outcome(X).outcome[0]))

    @rule()
    def loop(self) -> None:
        """The loop simulates what is left of the initial design, or a batch, beside the designs in flight."""
        handed = HandedOut.of(self.store)
        known = {*handed.history.id.tolist(), *handed.asked.id.tolist()}
        budget = handed.history.asked_for + len(handed.in_flight) + 2
        refused = ""
        try:
            take(self.campaign, self.store, budget)
        except InputError as error:
            refused = str(error)
        # The whole initial design may be in flight or dropped.
        assert not refused or "no simulation has given an outcome" in refused
        handed = HandedOut.of(self.store)
        outcome = dict(zip(handed.history.id.tolist(), handed.history.outcome.tolist(), strict=True))
        new = {number: outcome[number] for number in outcome.keys() - known}
        assert len(new) <= 2
        self.looped |= new

    @rule()
    def reopen(self) -> None:
        self.store.close()
        self.store = FolderStore.open(self.place, self.campaign.schema, write=True)

    @rule(before=st.booleans(), kind=st.sampled_from(["ask", "tell", "drop", "add", "correct"]))
    def crash(self, before: bool, kind: str) -> None:
        """Die in the one write of a command, before or after it is durable, and open the folder again."""
        flight, told = self.flight(), sorted(self.told)
        if (kind in ("tell", "drop") and not flight) or (kind == "correct" and not told):
            return
        X = self.campaign.space.from_unit(np.array([[0.3, 0.001 * (1 + len(self.given))]]))
        with pytest.MonkeyPatch.context() as patch:
            for name in ("commit", "hand_out", "drop", "correct"):
                original = getattr(self.store, name)

                def dies(*values: object, original: Callable[..., None] = original) -> None:
                    if not before:
                        original(*values)
                    raise DiedError

                patch.setattr(self.store, name, dies)
            try:
                if kind == "ask":
                    ask(self.campaign, self.store, 2, 1000)
                elif kind == "drop":
                    drop(self.store, np.array(flight[:1]))
                elif kind == "add":
                    add(self.campaign, self.store, X, self.outcome(X))
                elif kind == "correct":
                    other = self.result(told[0], 1 - self.told[told[0]])
                    correct(self.campaign, self.store, np.array(told[:1]), other)
                else:
                    answer = self.outcome(np.frombuffer(self.asked[flight[0]])[None])
                    tell(self.campaign, self.store, np.array(flight[:1]), answer)
            except DiedError:
                pass
            else:
                return
        self.reopen()
        # What was not acknowledged may be there, but whole: the folder says which.
        handed = HandedOut.of(self.store)
        if not before and kind == "ask":
            new = handed.asked[np.isin(handed.asked.id, [*self.asked, *self.looped], invert=True)]
            assert len(new)
            self.asked |= {n: x.tobytes() for n, x in zip(new.id.tolist(), new.designs, strict=True)}
        elif not before and kind == "drop":
            self.dropped.add(flight[0])
        elif not before and kind == "add":
            self.given[X.tobytes()] = int(self.outcome(X).outcome[0])
        elif not before and kind == "correct":
            self.told[told[0]] = 1 - self.told[told[0]]
        elif not before:
            self.told[flight[0]] = int(answer.outcome[0])

    @invariant()
    def every_design_is_in_flight_answered_or_dropped(self) -> None:
        if not hasattr(self, "store"):
            return
        handed = HandedOut.of(self.store)
        assert len(np.unique(handed.asked.designs, axis=0)) == len(handed.asked)
        handed = replace(handed, asked=handed.asked[handed.asked.loop == 0])
        designs = [design.tobytes() for design in handed.asked.designs]
        assert dict(zip(handed.asked.id.tolist(), designs, strict=True)) == self.asked
        answered = set(handed.asked.id.tolist()) & set(handed.history.id.tolist())
        dropped = set(handed.asked.id[handed.asked.dropped == 1].tolist())
        flight = set(handed.in_flight.id.tolist())
        assert (answered, dropped, flight) == (set(self.told), self.dropped, set(self.flight()))
        assert len(answered) + len(dropped) + len(flight) == len(handed.asked)
        assert len(handed.history) == len(self.told) + len(self.given) + len(self.looped)
        outcome = dict(zip(handed.history.id.tolist(), handed.history.outcome.tolist(), strict=True))
        recorded = self.told | self.looped
        assert {number: outcome[number] for number in recorded} == recorded
        given = handed.history[handed.history.origin == GIVEN]
        assert dict(zip(map(bytes, given.designs), given.outcome.tolist(), strict=True)) == self.given
        assert len(set(handed.history.id.tolist())) == len(handed.history.id)

    def teardown(self) -> None:
        if hasattr(self, "store"):
            self.store.close()


class DiedError(Exception):
    """The process would be gone."""


@pytest.mark.slow
def test_any_order_of_ask_tell_drop_add_correct_loop_crash_and_reopening_keeps_every_design_in_one_place(
    tmp_path: Path, every_fault: bool, request: pytest.FixtureRequest
) -> None:
    Interleaved.folder = tmp_path
    machine = Interleaved.TestCase
    tried = 1000 if every_fault else 25 if request.config.getoption("--exhaustive") else 14
    machine.settings = examples(max_examples=tried, stateful_step_count=15, deadline=None)
    machine().runTest()


# --- one rule for the loop and for asking ------------------------------------------------------------------------

EXPLORING = "acquisition.exploration = 0.25"


@pytest.mark.parametrize("criterion", ["entropy", "eavc"])
@pytest.mark.parametrize("fate", ["in flight", "dropped"])
def test_the_loop_never_simulates_a_design_that_was_handed_out(criterion: str, fate: str) -> None:
    budget = INITIAL_SIZE + 3 * BATCH
    campaign = disc(extra=f'{EXPLORING}\n        acquisition.criterion = "{criterion}"')
    store = take(campaign, budget=INITIAL_SIZE)
    flight = ask(campaign, store, 4, BUDGET).designs
    if fate == "dropped":
        drop(store, flight.id)
    take(campaign, store, budget)
    handed = HandedOut.of(store)
    simulated = {design.tobytes() for design in handed.history.designs}
    assert not simulated & {design.tobytes() for design in flight.designs}
    assert handed.in_flight.id.tolist() == ([] if fate == "dropped" else flight.id.tolist())
    assert len(handed.history) == (budget if fate == "dropped" else budget - 4)


@pytest.mark.parametrize("at", [12, 14, 16])
def test_exploring_campaigns_have_the_bits_of_the_loop_from_wherever_asking_begins(at: int) -> None:
    campaign = disc(extra="acquisition.exploration = 0.15")
    store = take(campaign, budget=at)
    designs = ask(campaign, store, BATCH, BUDGET).designs
    tell(campaign, store, designs.id, campaign.simulator.run(designs.designs))
    looped = take(campaign, take(campaign, budget=at), budget=at + BATCH)
    assert rows(store) == rows(looped)


def test_given_failures_are_neither_failures_of_the_simulator_nor_another_initial_design() -> None:
    campaign, store = disc(), MemoryStore(disc().schema)
    X = campaign.space.from_unit(np.random.default_rng(7).random((31, 2)))
    add(campaign, store, X, results(0, *[NUMERICAL_FAILURE] * 30, margin=np.nan))
    assert len(HandedOut.of(store).initial_left(campaign)) == INITIAL_SIZE - 1  # one has an outcome
    take(campaign, store)
    assert HandedOut.of(store).history.asked_for == BUDGET


def test_after_a_lost_batch_ids_are_not_given_again(tmp_path: Path) -> None:
    campaign = disc()
    with create_folder(tmp_path / "run", campaign) as store:
        first = ask(campaign, store, 6, BUDGET).designs
        tell(campaign, store, first.id, campaign.simulator.run(first.designs))
        X = campaign.space.from_unit(np.random.default_rng(5).random((5, 2)))
        add(campaign, store, X, results(*[NUMERICAL_FAILURE] * 5, margin=np.nan))
        assert ask(campaign, store, 2, BUDGET).designs.id.tolist() == [11, 12]
    path = tmp_path / "run" / "journal"
    for lost in (2, 1):
        # The designs that were asked for last, then the batch that was added.
        data = path.read_bytes()
        last = [match.start() for match in re.finditer(rb"activefail [0-9a-f]{64} ", data)][-1]
        path.write_bytes(data[: last + 100])
        FolderStore.open(tmp_path / "run", campaign.schema, write=True).close()
        assert len(data) > path.stat().st_size, lost
    with FolderStore.open(tmp_path / "run", campaign.schema, write=True) as store:
        assert HandedOut.of(store).history.id.tolist() == [0, 1, 2, 3, 4, 5]
        assert ask(campaign, store, 1, BUDGET).designs.id.tolist() == [6]
        assert add(campaign, store, X, campaign.simulator.run(X)) == 5
        ids = HandedOut.of(store).history.id.tolist()
        assert len(set(ids)) == 11


def test_a_reader_keeps_the_list_that_it_opened(tmp_path: Path) -> None:
    campaign = disc()
    with create_folder(tmp_path / "run", campaign) as store:
        first = ask(campaign, store, 3, BUDGET).designs
        with FolderStore.open(tmp_path / "run", campaign.schema, write=False) as reader:
            tell(campaign, store, first.id, campaign.simulator.run(first.designs))
            X = campaign.space.from_unit(np.random.default_rng(5).random((5, 2)))
            add(campaign, store, X, campaign.simulator.run(X))
            ask(campaign, store, 2, BUDGET)
            handed = HandedOut.of(reader)
            assert (handed.in_flight.id.tolist(), handed.history.id.tolist()) == ([0, 1, 2], [])


def test_a_dropped_design_does_not_block_the_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    streams: list[tuple[str | int, ...]] = []

    def noted(seed: int, *names: str | int) -> np.random.Generator:
        streams.append(names)
        return stream(seed, *names)

    monkeypatch.setattr(proposing, "stream", noted)
    # The search for failure, of which nothing is known, ends in the same corner whatever its random numbers are.
    text = """
        seed = 1
        sampling = { initial = 6, budget = 28, batch = 1 }
        simulator = { elsewhere = true, outcomes = ["safe", "failure"] }
        [space]
        x = { distribution = "truncated_normal", mean = 0.0, sd = 1.0, low = -3.0, high = 3.0 }
        y = { distribution = "truncated_normal", mean = 0.0, sd = 1.0, low = -3.0, high = 3.0 }
        """
    campaign = Campaign.of(parse_settings(text, "corner"))
    store = MemoryStore(campaign.schema)
    first = ask(campaign, store, 6, BUDGET).designs
    nothing = np.zeros(6, dtype=np.int8)
    tell(campaign, store, first.id, Results(nothing, nothing, np.empty((6, 0)), np.zeros(6)))
    for _ in range(4):
        designs = ask(campaign, store, 1, BUDGET).designs
        assert len(designs) == 1
        drop(store, designs.id)
    asked = HandedOut.of(store).asked
    assert len(np.unique(asked.designs, axis=0)) == len(asked) == 10
    # An attempt never draws the random numbers of another, for whatever number of designs.
    assert len(set(streams)) == len(streams)
    assert len(streams) > 4


def test_a_hypercube_that_was_begun_is_finished_whatever_became_of_the_one_before() -> None:
    campaign, store = disc(initial=6), MemoryStore(disc().schema)
    first = ask(campaign, store, 6, BUDGET).designs
    drop(store, first.id)
    second = ask(campaign, store, 1, BUDGET).designs
    tell(campaign, store, second.id, results(0))
    assert len(HandedOut.of(store).initial_left(campaign)) == 5
    third = ask(campaign, store, 6, BUDGET).designs
    assert (third.origin.tolist(), len(third)) == ([INITIAL] * 5, 5)


def begun(campaign: Campaign, store: Store, batches: int, wrong: tuple[int, ...] = ()) -> Store:
    """A store with told batches of an initial design, in which some ids got wrong results."""
    for _ in range(batches):
        designs = ask(campaign, store, BATCH, BUDGET).designs
        results = campaign.simulator.run(designs.designs)
        outcome = np.where(np.isin(designs.id, wrong), 1 - results.outcome, results.outcome).astype(np.int8)
        tell(campaign, store, designs.id, Results(outcome, results.cause, results.margins, results.seconds))
    return store


def right(campaign: Campaign, store: Store, ids: list[int]) -> tuple[np.ndarray, Results]:
    handed = HandedOut.of(store)
    rows = [handed.history.id.tolist().index(number) for number in ids]
    return np.array(ids), campaign.simulator.run(handed.history.designs[rows])


def test_a_corrected_campaign_goes_on_bit_for_bit_like_one_that_was_told_right_results(looped: Store) -> None:
    campaign = disc()
    store = begun(campaign, MemoryStore(campaign.schema), INITIAL_SIZE // BATCH, wrong=(1, 6))
    wrong = current(campaign, store, write=True)
    assert correct(campaign, store, *right(campaign, store, [1, 2, 6])) == 2
    asked_and_told(campaign, whole, store)
    assert rows(store) == rows(looped)
    current(campaign, store, write=True)
    assert state(store) == state(looped)
    X = campaign.space.from_unit(np.random.default_rng(0).random((50, 2)))
    assert not np.array_equal(
        wrong.classifier.probabilities(X), classifier_after(campaign, History.of(store.batches[:3])).probabilities(X)
    )


def test_a_correction_after_proposals_gives_the_same_bits_whoever_is_interrupted(tmp_path: Path) -> None:
    campaign = disc()
    folders = [tmp_path / name for name in ("straight", "interrupted")]
    for number, folder in enumerate(folders):

        def opened(folder: Path = folder) -> FolderStore:
            return FolderStore.open(folder, campaign.schema, write=True)

        create_folder(folder, campaign).close()
        with opened() as store:
            begun(campaign, store, 5, wrong=(3, 14))
            current(campaign, store, write=True)
            correct(campaign, store, *right(campaign, store, [3, 14]))
            if number == 0:
                # The process that corrects continues; the other one ends, and its successors learn in two parts.
                asked_and_told(campaign, whole, store)
                current(campaign, store, write=True)
                continue
        for _ in range(2):
            with opened() as store:
                current(campaign, store, write=True)
        (folder / "checkpoint.h5").unlink()
        with opened() as store:
            asked_and_told(campaign, whole, store)
            current(campaign, store, write=True)
    stores = [FolderStore.open(folder, campaign.schema, write=False) for folder in folders]
    assert rows(stores[0]) == rows(stores[1])
    assert state(stores[0]) == state(stores[1])
    assert stores[0].corrections.place.tolist() == stores[1].corrections.place.tolist() != []


def test_a_correction_may_turn_a_failed_simulation_into_a_result_and_back() -> None:
    campaign = disc()
    store = begun(campaign, MemoryStore(campaign.schema), 3)
    ids, results = right(campaign, store, [0])
    failed = Results(np.full(1, NUMERICAL_FAILURE, dtype=np.int8), *(results.cause, results.margins, results.seconds))
    for one, failures in ((failed, 1), (results, 0)):
        assert correct(campaign, store, ids, one) == 1
        assert len(HandedOut.of(store).history.failed_designs) == failures
        current(campaign, store, write=False)


def test_only_recorded_results_are_corrected_and_all_of_a_table_or_none() -> None:
    campaign = disc()
    store = begun(campaign, MemoryStore(campaign.schema), 1)
    ask(campaign, store, 2, BUDGET)
    drop(store, np.array([5]))
    ids, results = right(campaign, store, [0])
    other = Results((1 - results.outcome).astype(np.int8), results.cause, results.margins, results.seconds)
    for number, way in (
        (4, "it is in flight: `tell` it without `correct`"),
        (5, "it was dropped"),
        (9, "no design was handed out with this id"),
    ):
        with pytest.raises(RowsError, match=f"id {number} has no result to correct \\({way}") as caught:
            correct(campaign, store, np.array([0, number]), Results.concatenate([other, results]))
        assert list(caught.value.reasons) == [1]
    with pytest.raises(RowsError, match=r"id 0 has the result .* in an earlier row"):
        correct(campaign, store, np.array([0, 0]), Results.concatenate([other, results]))
    assert len(store.corrections) == 0
    with pytest.raises(RowsError, match="to replace it: `tell --correct`, or `correct=True` in Python"):
        tell(campaign, store, ids, other)
    assert correct(campaign, store, np.array([0, 0]), Results.concatenate([other, other])) == 1
    assert tell(campaign, store, ids, other) == 0
    with pytest.raises(RowsError):
        tell(campaign, store, ids, results)


def test_given_results_and_those_of_the_loop_are_corrected_too(looped: Store) -> None:
    campaign = disc()
    store = take(campaign, budget=16)
    X = campaign.space.from_unit(np.array([[0.3, 0.6]]))
    add(campaign, store, X, campaign.simulator.run(X))
    ids, results = right(campaign, store, [15, 16])
    other = Results((1 - results.outcome).astype(np.int8), results.cause, results.margins, results.seconds)
    assert correct(campaign, store, ids, other) == 2
    take(campaign, store, budget=20)
    assert HandedOut.of(store).history.outcome[[15, 16]].tolist() == other.outcome.tolist()
    assert correct(campaign, store, ids, results) == 2
    assert rows(store)[1][:16] == rows(looped)[1][:16]
