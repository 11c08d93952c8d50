"""`ask`, `tell`, `drop`, `add`: designs go in flight, and the results of simulations done elsewhere are recorded.

The proposals are those of the loop with batches: `ask` proposes what the loop would simulate next, and `tell` records
it as the loop does. Asked for and told batch by batch, a campaign has the same bits. Proposals take the designs in
flight into account.
"""

import bisect
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import InputError
from activefail.loop.in_flight import HandedOut
from activefail.loop.learning import Memory, current
from activefail.record.asked import NEVER, Asked
from activefail.record.batch import CHECK, GIVEN, INITIAL, Batch
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space import Array


@dataclass(frozen=True)
class Proposed:
    """What `ask` hands out.

    Attributes:
        designs: with their ids, in flight from now on.
        reason: why there are fewer than were asked for, or more; empty if there are as many.
    """

    designs: Asked
    reason: str = ""


def check_batches(campaign: Campaign) -> None:
    """Check that a campaign's results may arrive in any way.

    Raises:
        InputError: if it is asynchronous: its designs in flight follow from the record alone.
    """
    if campaign.settings.sampling.asynchronous:
        raise InputError(
            "sampling.asynchronous: `ask`, `add` and corrections work only on campaigns in batches, because the "
            "designs in flight of an asynchronous campaign follow from its results. Create a campaign without this "
            "setting and `add` the table of `activefail export` to it: `ask` learns from all results so far, in any "
            "order."
        )


def ask(
    campaign: Campaign,
    store: Store,
    n: int,
    budget: int | None,
    ignore_stop: bool = False,
    memory: Memory | None = None,
) -> Proposed:
    """Hand out n designs; they are in flight once this returns.

    Args:
        campaign: the campaign.
        store: its record, open for writing.
        n: number of designs.
        budget: simulations in all, those in flight included; None for no limit.
        ignore_stop: whether to propose designs although the stop rule is met.
        memory: as for `current`.

    Raises:
        InputError: if the campaign is asynchronous.
        StoreError: if the designs cannot be recorded.
    """
    check_batches(campaign)
    handed = HandedOut.of(store)
    flight, none = handed.in_flight, Asked.none(campaign.space.dimension)
    reason = ""
    room = None if budget is None else max(0, budget - handed.history.asked_for - len(flight))
    if room is not None and room < n:
        n = room
        reason = f"the campaign's budget of {budget} simulations allows no more (in flight: {len(flight)})"
        if n == 0:
            return Proposed(none, reason)
    left = handed.initial_left(campaign)
    if len(left):
        if len(left) < n:
            reason = "the initial design ends here"
        return _hand_out(store, handed, left[:n], INITIAL, NEVER, reason)
    if not handed.history.answered.any():
        return Proposed(none, "no simulation has given an outcome yet, so there is nothing to learn from")
    if (flight.origin == CHECK).any():
        ids = ", ".join(map(str, flight.id[flight.origin == CHECK].tolist()))
        return Proposed(none, f"the stop rule waits for the results of its check, ids {ids}")
    learned = current(campaign, store, write=True, memory=memory)
    if learned.looks.is_known and not ignore_stop:
        return Proposed(none, "the stop rule is met")
    # Loads torch, which the other commands do without.
    from activefail.loop.choosing import choose

    chosen = choose(campaign, handed, learned, n, room)
    if not reason and len(chosen.designs) > n:
        reason = f"the {len(chosen.designs)} designs of the stop rule's check belong together"
    elif not reason and len(chosen.designs) < n:
        reason = "the stop rule's check has no more" if chosen.origin == CHECK else "the criterion found no others"
    return _hand_out(store, handed, chosen.designs, chosen.origin, handed.history.last_iteration, reason)


def _hand_out(store: Store, handed: HandedOut, designs: Array, origin: int, learned: int, reason: str) -> Proposed:
    first = handed.next_id
    new = Asked.of(np.arange(first, first + len(designs)), np.array(designs), origin, learned)
    store.write_asked(handed.asked.and_then(new))
    return Proposed(new, reason)


def tell(
    campaign: Campaign,
    store: Store,
    ids: NDArray[np.int64],
    results: Results,
    handed_out: HandedOut | None = None,
    before_commit: Callable[[], None] = lambda: None,
) -> int:
    """Record the results of designs that were handed out; they are durable once this returns.

    Args:
        campaign: the campaign.
        store: its record, open for writing.
        ids: (n,) of the designs. They may be any of those in flight, in any order.
        results: of the n designs.
        handed_out: the designs of the store, if the caller has them already.
        before_commit: called once the results are checked; nothing is recorded if it raises.

    Returns:
        Number of new results. A result that was told before is not counted.

    Raises:
        InputError: if an id is unknown or was dropped, or has another result already; nothing is recorded then.
        StoreError: if the results cannot be recorded.
    """
    handed = handed_out or HandedOut.of(store)
    new = new_results(campaign, store, ids, results, handed)
    before_commit()
    if not new:
        return 0
    place = {number: k for k, number in enumerate(handed.asked.id.tolist())}
    numbers = sorted(new)
    designs = handed.asked[np.array([place[number] for number in numbers])]
    store.commit(
        Batch(
            handed.next_iteration(campaign),
            designs.designs,
            designs.origin,
            results[np.array([new[number] for number in numbers])],
        )
    )
    return len(new)


def new_results(
    campaign: Campaign, store: Store, ids: NDArray[np.int64], results: Results, handed: HandedOut
) -> dict[int, int]:
    """The rows of the results that are not recorded yet, by the ids of their designs.

    Args:
        campaign, store, ids, results: as for `tell`.
        handed: the designs of the store.

    Raises:
        InputError: as `tell` does.
    """
    before = _rows(store)
    place = {number: k for k, number in enumerate(handed.asked.id.tolist())}
    recorded = {number: row for row, number in enumerate(handed.ids.tolist())}
    new: dict[int, int] = {}
    for row, number in enumerate(ids.tolist()):
        answer = results[row : row + 1]
        if number in recorded:
            known = before(recorded[number])
            if not _is_same(known, answer):
                reason = f"id {number} already has the result {_shown(campaign, known)} ({_CORRECTING})"
                raise RowError(row, reason, campaign, answer)
        elif number not in place:
            raise RowError(row, f"id {number} is unknown: no design was handed out with this id", campaign, answer)
        elif handed.asked.dropped[place[number]]:
            raise RowError(row, f"id {number} was dropped (use `add` to record its result)", campaign, answer)
        elif number in new and not _is_same(results[new[number] : new[number] + 1], answer):
            earlier = _shown(campaign, results[new[number] : new[number] + 1])
            raise RowError(row, f"id {number} has the result {earlier} in an earlier row", campaign, answer)
        else:
            new.setdefault(number, row)
    return new


_CORRECTING = "to replace it: `tell --correct`, or `correct=True` in Python"


def correct(
    campaign: Campaign,
    store: Store,
    ids: NDArray[np.int64],
    results: Results,
    handed_out: HandedOut | None = None,
    before_commit: Callable[[], None] = lambda: None,
) -> int:
    """Replace recorded results that were wrong; the corrections are durable, all of them, once this returns.

    The campaign learns from the beginning as if it had got the right results then. Its designs stay what they are. The
    former results stay in the record.

    Args:
        campaign, store, handed_out, before_commit: as for `tell`.
        ids: (n,) of simulations with a result, told, given or simulated by the loop.
        results: of the n simulations.

    Returns:
        Number of results that were replaced. One that is recorded already is not counted.

    Raises:
        InputError: if the campaign is asynchronous, or an id has no result yet, or two; nothing is recorded then.
        StoreError: if the corrections cannot be recorded.
    """
    check_batches(campaign)
    handed = handed_out or HandedOut.of(store)
    before, flight = _rows(store), set(handed.in_flight.id.tolist())
    handed_out_ids = set(handed.asked.id.tolist())
    recorded = {number: row for row, number in enumerate(handed.ids.tolist())}
    rows: dict[int, int] = {}
    for row, number in enumerate(ids.tolist()):
        answer = results[row : row + 1]
        if number not in recorded:
            if number in flight:
                way = "it is in flight: `tell` it without `correct`"
            else:
                way = "it was dropped" if number in handed_out_ids else "no design was handed out with this id"
            raise RowError(row, f"id {number} has no result to correct ({way})", campaign, answer)
        first = rows.setdefault(number, row)
        if not _is_same(results[first : first + 1], answer):
            earlier = _shown(campaign, results[first : first + 1])
            raise RowError(row, f"id {number} has the result {earlier} in an earlier row", campaign, answer)
    wrong = [number for number, row in rows.items() if not _is_same(before(recorded[number]), results[row : row + 1])]
    before_commit()
    if wrong:
        places = np.array([recorded[number] for number in wrong], dtype=np.int64)
        store.correct(places, results[np.array([rows[number] for number in wrong])])
    return len(wrong)


def lost_margins(
    campaign: Campaign, store: Store, ids: NDArray[np.int64], results: Results, handed: HandedOut
) -> list[str]:
    """Margins that corrections would leave empty, as sentences; the arguments are those of `correct`."""
    before = _rows(store)
    recorded = {number: row for row, number in enumerate(handed.ids.tolist())}
    texts = []
    for row, number in enumerate(ids.tolist()):
        if number not in recorded or results.outcome[row] == NUMERICAL_FAILURE:
            continue
        former = before(recorded[number]).margins[0]
        for name, was, now in zip(campaign.simulator.margins, former, results.margins[row], strict=True):
            if np.isnan(now) and not np.isnan(was):
                texts.append(f"id {number}: the correction has no value for {name}, which was {float(was)!r}.")
    return texts


class RowError(InputError):
    """A row of a table of results that cannot be recorded.

    Attributes:
        row: of the table of results, from 0.
    """

    def __init__(self, row: int, reason: str, campaign: Campaign, answer: Results) -> None:
        super().__init__(f"{reason}; this row has {_shown(campaign, answer)}")
        self.row = row


def drop(store: Store, ids: NDArray[np.int64]) -> int:
    """Give up designs in flight: they get no result and are not proposed again.

    Args:
        store: the record, open for writing.
        ids: (n,) of the designs.

    Returns:
        Number of designs that were in flight. A design that was dropped before is not counted.

    Raises:
        InputError: if an id is unknown or has a result; nothing is dropped then.
        StoreError: if it cannot be recorded.
    """
    handed = HandedOut.of(store)
    known = set(handed.asked.id.tolist())
    recorded = set(handed.ids.tolist())
    for number in ids.tolist():
        if number in recorded:
            raise InputError(f"ids: must be of designs in flight; id {number} has a result.")
        if number not in known:
            raise InputError(f"ids: must be of designs in flight; id {number} is unknown.")
    dropped = np.isin(handed.asked.id, ids)
    number = int((dropped & (handed.asked.dropped == 0)).sum())
    if number:
        store.write_asked(handed.asked.without(dropped))
    return number


def add(
    campaign: Campaign, store: Store, X: Array, results: Results, before_commit: Callable[[], None] = lambda: None
) -> int:
    """Record simulations that were not asked for; they are durable once this returns.

    The classifier learns from them. They are not part of the initial design, and do not count towards the budget.

    Args:
        campaign: the campaign.
        store: its record, open for writing.
        X: (n, d) designs.
        results: of the n designs.
        before_commit: as for `tell`.

    Returns:
        Number of new simulations. One that is recorded already with this result is not counted.

    Raises:
        InputError: if a design is in flight, or is recorded with another result; nothing is recorded then.
        StoreError: if the simulations cannot be recorded.
    """
    check_batches(campaign)
    handed = HandedOut.of(store)
    flight = handed.in_flight
    in_flight = {design.tobytes(): number for design, number in zip(flight.designs, flight.id.tolist(), strict=True)}
    recorded = {design.tobytes(): row for row, design in enumerate(handed.history.designs)}
    ids, known = handed.ids, _rows(store)
    new: dict[bytes, int] = {}
    for row in range(len(X)):
        design, answer = X[row].tobytes(), results[row : row + 1]
        if design in in_flight:
            number = in_flight[design]
            reason = f"the design is in flight with id {number} (use `tell` to record its result)"
            raise RowError(row, reason, campaign, answer)
        if design in recorded:
            before = known(recorded[design])
            where = f"as id {ids[recorded[design]]} ({_CORRECTING})"
        elif design in new:
            before, where = results[new[design] : new[design] + 1], "in an earlier row"
        else:
            new[design] = row
            continue
        if not _is_same(before, answer):
            raise RowError(row, f"the same design has the result {_shown(campaign, before)} {where}", campaign, answer)
    before_commit()
    if not new:
        return 0
    rows = np.array(list(new.values()))
    origin = np.full(len(rows), GIVEN, dtype=np.int8)
    store.commit(Batch(handed.next_iteration(campaign), X[rows], origin, results[rows]))
    return len(rows)


def _rows(store: Store) -> Callable[[int], Results]:
    """The result in a row of the record, by the number of the row."""
    batches = store.batches
    ends = list(itertools.accumulate(map(len, batches)))

    def result(row: int) -> Results:
        place = bisect.bisect_right(ends, row)
        start = row - (ends[place] - len(batches[place]))
        return batches[place].results[start : start + 1]

    return result


def _is_same(one: Results, other: Results) -> bool:
    """Whether two results are equal, but for their times."""
    return bool(
        one.outcome[0] == other.outcome[0]
        and one.cause[0] == other.cause[0]
        and np.array_equal(one.margins, other.margins, equal_nan=True)
    )


def _shown(campaign: Campaign, result: Results) -> str:
    """A result in words."""
    simulator, code = campaign.simulator, int(result.outcome[0])
    words = [simulator.outcomes[code] if code != NUMERICAL_FAILURE else "numerical_failure"]
    if cause := cause_name(simulator.causes, int(result.cause[0])):
        words.append(f"cause {cause}")
    pairs = zip(simulator.margins, result.margins[0].tolist(), strict=True)
    words += [f"{name} {value!r}" for name, value in pairs if not np.isnan(value)]
    return ", ".join(words)
