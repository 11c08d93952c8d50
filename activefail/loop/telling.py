"""`tell`, `correct`, `drop` and `add`: results of designs in flight, other results, and simulations of one's own.

A table is recorded whole or not at all.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import InputError
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.record.asked import Asked, bits_of
from activefail.record.batch import GIVEN, Batch
from activefail.record.labels import Labels, new_labels
from activefail.record.store import NOTHING, Remembered, Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space.space import Array

_CORRECTING = "to replace it: `tell --correct`, or `correct=True` in Python"


_IF_NOISY = "; if both are right, the campaign needs `simulator.repeatable = false`"


class RowsError(InputError):
    """Rows of a table of results that cannot be recorded.

    Attributes:
        reasons: by row of the table of results, from 0.
    """

    def __init__(self, reasons: dict[int, str], campaign: Campaign, results: Results) -> None:
        self.reasons = {
            row: f"{reason}; this row has {_shown(campaign, results, row)}" for row, reason in reasons.items()
        }
        super().__init__("\n".join(self.reasons.values()))


@contextmanager
def _rows_of(campaign: Campaign, results: Results) -> Iterator[dict[int, str]]:
    """Collects why rows cannot be recorded; raises RowsError at the end if there are any."""
    reasons: dict[int, str] = {}
    yield reasons
    if reasons:
        raise RowsError(reasons, campaign, results)


def record(store: Store, designs: Asked, results: Results, also: Remembered = NOTHING) -> None:
    """Record the results of designs in flight; they are durable once this returns."""
    store.commit(Batch(store.asked.next_iteration, designs.id, designs.designs, designs.origin, results), also)


def _remember(store: Store, also: Remembered) -> None:
    for of, value in also.items():
        store.remember(of, value)


def tell(
    campaign: Campaign,
    store: Store,
    ids: NDArray[np.int64],
    results: Results,
    before_commit: Callable[[], None] = lambda: None,
    simulated: Array | None = None,
    labels: Labels = (),
) -> int:
    """Record the results of designs that were handed out; they are durable once this returns.

    Args:
        campaign: the campaign.
        store: its record, open for writing.
        ids: (n,) of the designs. They may be any of those in flight, in any order.
        results: of the n designs.
        before_commit: called once the results are checked; nothing is recorded if it raises.
        simulated: (n, d) designs that were simulated in place of those that were handed out; None if these were.
        labels: by name, of the n simulations, recorded in the same write; or none.

    Returns:
        Number of new results. A result that was told before is not counted.

    Raises:
        InputError: if an id is unknown or was dropped, or has another result already; nothing is recorded then.
        StoreError: if the results cannot be recorded.
    """
    handed = HandedOut.of(store)
    new = new_results(campaign, ids, results, handed)
    before_commit()
    also = new_labels(store, ids.tolist(), labels)
    if not new:
        _remember(store, also)
    else:
        numbers = sorted(new)
        designs, rows = handed.asked[np.searchsorted(handed.asked.id, numbers)], [new[number] for number in numbers]
        if simulated is not None:
            designs = replace(designs, designs=simulated[rows])
        record(store, designs, results[np.array(rows)], also)
    return len(new)


def new_results(campaign: Campaign, ids: NDArray[np.int64], results: Results, handed: HandedOut) -> dict[int, int]:
    """The rows of the results that are not recorded yet, by the ids of their designs.

    Args:
        campaign, ids, results: as for `tell`.
        handed: the designs of the store.
    """
    recorded, known = _places(handed.history.id), _places(handed.asked.id)
    new: dict[int, int] = {}
    with _rows_of(campaign, results) as reasons:
        for number, row in _rows(ids, results, campaign, reasons).items():
            if number in recorded:
                if not _is_same(handed.history, recorded[number], results, row):
                    former = _shown(campaign, handed.history, recorded[number])
                    reasons[row] = f"id {number} already has the result {former} ({_CORRECTING})"
            elif number not in known:
                reasons[row] = f"id {number} is unknown: no design was handed out with this id"
            elif handed.asked.dropped[known[number]]:
                reasons[row] = f"id {number} was dropped (use `add` to record its result)"
            else:
                new[number] = row
    return new


def correct(
    campaign: Campaign,
    store: Store,
    ids: NDArray[np.int64],
    results: Results,
    before_commit: Callable[[], None] = lambda: None,
    labels: Labels = (),
) -> int:
    """Replace recorded results that were wrong; the corrections are durable, all of them, once this returns.

    The campaign learns from the beginning as if it had got the right results then. Its designs stay what they are. The
    former results stay in the record.

    Args:
        campaign, store, before_commit, labels: as for `tell`.
        ids: (n,) of simulations with a result, told, given or simulated by the loop.
        results: of the n simulations.

    Returns:
        Number of results that were replaced. One that is recorded already is not counted.

    Raises:
        InputError: if an id has no result yet, or two; nothing is recorded then.
        StoreError: if the corrections cannot be recorded.
    """
    handed = HandedOut.of(store)
    recorded = _places(handed.history.id)
    with _rows_of(campaign, results) as reasons:
        rows = _rows(ids, results, campaign, reasons)
        for number, row in rows.items():
            if number not in recorded:
                if number in handed.in_flight.id:
                    way = "it is in flight: `tell` it without `correct`"
                else:
                    way = "it was dropped" if number in handed.asked.id else "no design was handed out with this id"
                reasons[row] = f"id {number} has no result to correct ({way})"
    wrong = [one for one, row in rows.items() if not _is_same(handed.history, recorded[one], results, row)]
    before_commit()
    also = new_labels(store, ids.tolist(), labels)
    if not wrong:
        _remember(store, also)
    else:
        places = np.array([recorded[number] for number in wrong], dtype=np.int64)
        store.correct(places, results[np.array([rows[number] for number in wrong])], also)
    return len(wrong)


def lost_margins(campaign: Campaign, ids: NDArray[np.int64], results: Results, handed: HandedOut) -> list[str]:
    """Margins that corrections would leave empty, as sentences; the arguments are those of `new_results`."""
    recorded, texts = _places(handed.history.id), []
    for row, number in enumerate(ids.tolist()):
        if number not in recorded or results.outcome[row] == NUMERICAL_FAILURE:
            continue
        former = handed.history.margins[recorded[number]]
        for name, was, now in zip(campaign.simulator.margins, former, results.margins[row], strict=True):
            if np.isnan(now) and not np.isnan(was):
                texts.append(f"id {number}: the correction has no value for {name}, which was {float(was)!r}.")
    return texts


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
    for number in ids.tolist():
        if number in handed.history.id:
            raise InputError(
                f"ids: must be of designs in flight; id {number} has a result (withdraw it with `tell --correct`, as a "
                "numerical_failure)."
            )
        if number not in handed.asked.id:
            raise InputError(f"ids: must be of designs in flight; id {number} is unknown.")
    dropped = np.intersect1d(ids, handed.in_flight.id)
    if len(dropped):
        store.drop(dropped)
    return len(dropped)


def add(
    campaign: Campaign,
    store: Store,
    X: Array,
    results: Results,
    before_commit: Callable[[], None] = lambda: None,
    labels: Labels = (),
) -> int:
    """Record simulations that were not asked for; they are durable once this returns.

    The classifier learns from them. They are not part of the initial design, and do not count towards the budget.

    Args:
        campaign: the campaign.
        store: its record, open for writing.
        X: (n, d) designs.
        results: of the n designs.
        before_commit, labels: as for `tell`.

    Returns:
        Number of new simulations. One that is recorded already with this result is not counted, unless the simulator
        does not repeat: then every row is a run of its own.

    Raises:
        InputError: if a design is in flight, or is recorded with another result although the simulator repeats; nothing
            is recorded then.
        StoreError: if the simulations cannot be recorded.
    """
    handed = HandedOut.of(store)
    history = handed.history
    in_flight = dict(zip(bits_of(handed.in_flight.designs), handed.in_flight.id.tolist(), strict=True))
    recorded: dict[bytes | int, int] = {design: row for row, design in enumerate(bits_of(history.designs))}
    new: dict[bytes | int, int] = {}
    ids, place_of, first = [], dict[bytes | int, int](), handed.next_id
    with _rows_of(campaign, results) as reasons:
        for row, design in enumerate(bits_of(X)):
            known: History | Results
            if design in in_flight and campaign.settings.is_repeatable:
                reasons[row] = f"the design is in flight with id {in_flight[design]} (use `tell` to record its result)"
                continue
            own = design if campaign.settings.is_repeatable else row
            if own in recorded:
                known, place = history, recorded[design]
                where = f"as id {history.id[place]} ({_CORRECTING})"
                ids.append(int(history.id[place]))
            else:
                ids.append(first + place_of.setdefault(own, len(new)))
                known, place, where = results, new.setdefault(own, row), "in an earlier row"
            if not _is_same(known, place, results, row):
                reasons[row] = f"the same design has the result {_shown(campaign, known, place)} {where}{_IF_NOISY}"
    before_commit()
    also = new_labels(store, ids, labels)
    if not new:
        _remember(store, also)
    else:
        rows, new_ids = np.array(list(new.values())), first + np.arange(len(new))
        origin = np.full(len(rows), GIVEN, dtype=np.int8)
        store.commit(Batch(handed.asked.next_iteration, new_ids, X[rows], origin, results[rows]), also)
    return len(new)


def _places(ids: NDArray[np.int64]) -> dict[int, int]:
    return {number: place for place, number in enumerate(ids.tolist())}


def _rows(ids: NDArray[np.int64], results: Results, campaign: Campaign, reasons: dict[int, str]) -> dict[int, int]:
    """The first row of each id in a table; adds the reasons of later ones that have another result."""
    first: dict[int, int] = {}
    for row, number in enumerate(ids.tolist()):
        if not _is_same(results, first.setdefault(number, row), results, row):
            reasons[row] = f"id {number} has the result {_shown(campaign, results, first[number])} in an earlier row"
    return first


def _is_same(one: History | Results, i: int, other: Results, j: int) -> bool:
    """Whether two results are equal, but for their times."""
    return bool(
        one.outcome[i] == other.outcome[j]
        and one.cause[i] == other.cause[j]
        and np.array_equal(one.margins[i], other.margins[j], equal_nan=True)
    )


def _shown(campaign: Campaign, results: History | Results, row: int) -> str:
    """A result in words."""
    simulator, code = campaign.simulator, int(results.outcome[row])
    words = [simulator.outcomes[code] if code != NUMERICAL_FAILURE else "numerical_failure"]
    if cause := cause_name(simulator.causes, int(results.cause[row])):
        words.append(f"cause {cause}")
    pairs = zip(simulator.margins, results.margins[row].tolist(), strict=True)
    words += [f"{name} {value!r}" for name, value in pairs if not np.isnan(value)]
    return ", ".join(words)
