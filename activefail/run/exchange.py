"""Simulations done elsewhere: designs are handed out, and results and other simulations are recorded.

Each function is a method of `Run`.
"""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import index
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from activefail.errors import InputError, TableWarning
from activefail.session.arguments import check_whole, table_of
from activefail.session.session import Session, propose, recording

if TYPE_CHECKING:
    from pandas import DataFrame

    from activefail.campaign.results_table import Reading, ResultTable
    from activefail.loop.in_flight import HandedOut
    from activefail.text.csv_table import Table

_LARGEST_ID = 2**53
"""Largest id; none is that large."""


def ask(run: Session, n: int = 1, *, beyond: bool = False, ignore_stop: bool = False) -> "DataFrame":
    """Hand out designs to be simulated elsewhere; they are in flight, and durable, once this returns.

    None of them is handed out again, not even after a crash; `in_flight` lists them. The proposals are those of
    `take`: the initial design first, then what the criterion chooses, given the designs in flight.

    Args:
        n: number of designs.
        beyond: whether to hand out designs beyond the budget.
        ignore_stop: whether to hand out designs even if the stop rule is met.

    Returns:
        The columns of `in_flight`. If there are not n, `attrs["reason"]` says why; otherwise it is empty.

    Raises:
        InputError: if n is no whole number or below 1.
        StoreError: if the run is not open for writing, or the designs cannot be recorded.

    Example:
        >>> while len(designs := run.ask(8)):
        ...     run.tell(designs.assign(outcome=[simulate(design) for _, design in designs.iterrows()]))
    """
    from activefail.analyses.findings.tables import designs_frame

    check_whole("n", n, 1)
    proposed = propose(run, n, None if beyond else run.settings.sampling.budget, ignore_stop)
    frame = designs_frame(run.campaign, proposed.designs)
    frame.attrs["reason"] = proposed.reason
    return frame


def tell(
    run: Session,
    table: Any,
    *,
    correct: bool = False,
    changed: bool = False,
    names: Mapping[str, str] | None = None,
    skip_invalid: bool = False,
) -> int:
    """Record results of designs in flight, or correct recorded ones; they are durable once this returns.

    A result that was told before is ignored. If a row breaks a rule, nothing of the table is recorded, and the message
    names the first ten such rows. A correction replaces the result of a simulation, whether it was told, added or
    simulated by the loop; `corrections` keeps the former one. The classifier learns again as if it had got the right
    result at first.

    Args:
        table: a DataFrame, a dictionary of columns, a list of dictionaries, one row as a dictionary or a Series,
            or a CSV file (its path, or opened in binary mode). Its columns are `id`, `outcome`, the campaign's
            margins (empty where undefined) or the outputs in their expressions, and optionally `cause`, `seconds` and
            the variables, which must not have changed. The outcome "numerical_failure" is that of a simulation without
            a result. Where one margin has levels, the outcome may be left out. Other columns are labels, which
            `simulations` has too. Rows without outcome and margins are ignored in a CSV file, and refused elsewhere,
            for NaN may be a simulation's result; so is NaN beside an outcome that the margin decides, unless
            `simulator.truncated` names it.
        correct: whether the table corrects recorded results; it must then hold no others.
        changed: whether the variables in the table are what was simulated, where they differ from the design that was
            handed out, as after rounding. They must lie in the design space.
        names: the table's own names: for a column or an outcome of the campaign, what the table has in its place,
            such as {"load": "Load [N]/1000", "failure": "collapsed"}.
        skip_invalid: whether to leave out rows that break a rule, with a warning.

    Returns:
        Number of new, or corrected, results.

    Raises:
        InputError: naming row, column, rule and value.
        StoreError: if the run is not open for writing, or the results cannot be recorded.
    """
    from activefail.campaign.results_table import Reading
    from activefail.loop import telling

    if correct and changed:
        raise InputError("changed: cannot be combined with correct; designs that have a result stay as they are.")
    checked = table_of(table)
    if not checked.columns:
        return 0
    # What was learned came from the former results.
    with recording(run, relearns=correct):
        told, handed_out = _told(run, checked, Reading(names or {}, skip_invalid), changed)
        if not correct:
            return _record(run, told, telling.tell, "ids", skip_invalid, changed=changed)
        lost = telling.lost_margins(run.campaign, told.ids, told.results, handed_out)
        return _record(run, told, telling.correct, "ids", skip_invalid, lost)


def is_told(run: Session, table: Any) -> bool:
    """Whether a table holds no result that `tell` would record.

    Args:
        table: as for `tell`.

    Raises:
        InputError: as `tell` does.
    """
    from activefail.campaign.results_table import Reading
    from activefail.loop.telling import new_results

    told, handed_out = _told(run, table_of(table), Reading())
    return not new_results(run.campaign, told.ids, told.results, handed_out)


def _told(run: Session, table: "Table", reading: "Reading", changed: bool = False) -> "tuple[ResultTable, HandedOut]":
    """The results in a table, with designs as they were handed out or simulated, and the designs of the record."""
    from activefail.campaign.results_table import ResultTable

    told, handed_out = ResultTable.told(run.campaign, table, reading), run.handed_out
    ids = np.concatenate([handed_out.asked.id, handed_out.history.id])
    designs = handed_out.history.designs.reshape(-1, run.space.dimension)
    return told.checked(
        run.campaign, ids, np.concatenate([handed_out.asked.designs, designs]), reading, changed
    ), handed_out


def drop(run: Session, ids: Iterable[int] | int) -> int:
    """Give up designs in flight: they get no result and are not proposed again.

    Args:
        ids: of the designs.

    Returns:
        Number of designs that were in flight; one that was dropped before is not counted.

    Raises:
        InputError: if an id is unknown or has a result; nothing is dropped then.
        StoreError: if the run is not open for writing, or this cannot be recorded.
    """
    from activefail.loop import telling

    if isinstance(ids, Iterable) and not isinstance(ids, str | bytes | np.ndarray):
        ids = list(ids)
    numbers = np.atleast_1d(np.asarray(ids, dtype=object)).tolist()
    for number in numbers:
        check_whole("ids", number, 0, _LARGEST_ID)
    with recording(run):
        return telling.drop(run.store, np.array([index(number) for number in numbers], dtype=np.int64))


def add(
    run: Session,
    table: Any,
    *,
    names: Mapping[str, str] | None = None,
    skip_invalid: bool = False,
    outside: Literal["refuse", "keep"] = "refuse",
) -> int:
    """Record simulations that were not asked for, such as last year's; they are durable once this returns.

    The classifier learns from them. They do not count towards the budget. Those with an outcome and inside the design
    space take the place of designs of the initial design that were not handed out yet, but for two: only the
    initial design is a sample of the design space. A simulation that is recorded already is ignored.

    Args:
        table: as for `tell`, with all variables in place of `id`.
        names, skip_invalid: as for `tell`.
        outside: what to do with a design outside the design space: "refuse" it, or "keep" it, so that the classifier
            learns from it.

    Returns:
        Number of new simulations.

    Raises:
        InputError: naming row, column, rule and value.
        StoreError: if the run is not open for writing, or they cannot be recorded.
    """
    from activefail.campaign.results_table import Reading, ResultTable
    from activefail.loop import telling

    if outside not in ("refuse", "keep"):
        raise InputError(f'outside: must be "refuse" or "keep", got {outside!r}.')
    checked = table_of(table)
    if not checked.columns:
        return 0
    added = ResultTable.added(run.campaign, checked, Reading(names or {}, skip_invalid, outside == "keep"))
    with recording(run):
        return _record(run, added, telling.add, "designs", skip_invalid)


def _record(
    run: Session,
    results: "ResultTable",
    record: Callable[..., int],
    which: Literal["ids", "designs"],
    skip_invalid: bool,
    more: Sequence[str] = (),
    changed: bool = False,
) -> int:
    """Record results of a table, with warnings of likely mistakes in it; returns how many are new.

    Args:
        results: in the table.
        record: a function of `activefail.loop.telling`.
        which: what names the designs.
        skip_invalid: whether to leave out rows that cannot be recorded.
        more: further warnings.
        changed: whether the designs of the table are those that were simulated.
    """
    from activefail.campaign.results_table import refusal
    from activefail.loop.telling import RowsError

    def warn() -> None:
        # Before the commit, because warnings may be raised as errors. Attributed to the caller of `tell` or `add`.
        for text in (*results.warnings(run.campaign), *more):
            warnings.warn(text, TableWarning, stacklevel=5)

    while True:
        beside = {"labels": results.labels(run.campaign)} | ({"simulated": results.designs} if changed else {})
        try:
            return record(run.campaign, run.store, getattr(results, which), results.results, warn, **beside)
        except RowsError as error:
            reasons = {row: f"{results.table.places[row]}: {reason}." for row, reason in error.reasons.items()}
            if not skip_invalid:
                raise refusal(list(reasons.values())) from None
            results = results.without(reasons)
