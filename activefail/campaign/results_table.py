"""Tables of results for `tell` and `add`: their columns, whether their designs match, which rows are refused."""

import difflib
import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign import sections
from activefail.campaign.assembly import Campaign
from activefail.csv_table import Table
from activefail.errors import InputError
from activefail.simulators.interface import EXECUTION_CAUSES, NUMERICAL_FAILURE, Results, UnusableAnswerError, settled
from activefail.simulators.returned import read_answer
from activefail.space import Array, DesignSpace

_ID, _OUTCOME, _CAUSE, _SECONDS = "id", "outcome", "cause", "seconds"

_SAME, _SIMILAR = 1e-5, 1e-2
"""Distances (`_distance`) within which a value is the one handed out: with any digits, and rounded to `_ROUNDED`."""

_ROUNDED = 5e-5
"""Relative error of a value of five significant digits, the fewest that programs and spreadsheets write by default."""


@dataclass(frozen=True)
class ResultTable:
    """The results in a table.

    Attributes:
        table: the n rows that hold a result.
        ids: (n,) int64, of the designs; empty in a table of simulations that were not asked for.
        designs: (n, d) float64, NaN where the table has no such column.
        results: of the n designs.
    """

    table: Table
    ids: NDArray[np.int64]
    designs: Array
    results: Results

    @classmethod
    def told(cls, campaign: Campaign, table: Table) -> Self:
        """The results of designs that were handed out. Rows without any result are skipped.

        Raises:
            InputError: naming row, column, rule and value of the first cell that breaks a rule.
        """
        table.require([_ID])
        _require_result(campaign, table)
        answers = [_OUTCOME, *campaign.simulator.margins]
        rows = range(len(table.rows))
        table = table.only([row for row in rows if any(table.cell(row, name) is not None for name in answers)])
        ids = np.array([_whole(table, row) for row in range(len(table.rows))], dtype=np.int64)
        return cls(table, ids, _designs(campaign, table), _results(campaign, table))

    @classmethod
    def added(cls, campaign: Campaign, table: Table) -> Self:
        """Simulations that were not asked for, of designs in the design space.

        Raises:
            InputError: naming row, column, rule and value of the first cell that breaks a rule.
        """
        table.require(campaign.space.names)
        _require_result(campaign, table)
        designs = _designs(campaign, table)
        for row, design in enumerate(designs.tolist()):
            for parameter, value in zip(campaign.space.parameters, design, strict=True):
                if not parameter.contains(value):
                    raise table.broken(row, parameter.name, f"{parameter.rule} must hold", value)
        none = np.empty(0, dtype=np.int64)
        return cls(table, none, designs, _results(campaign, table))

    def warnings(self, campaign: Campaign) -> list[str]:
        """Likely mistakes: misspelt columns, and margins that are missing or contradict the outcome."""
        simulator, names = campaign.simulator, self.table.columns
        known = [_ID, _OUTCOME, _CAUSE, _SECONDS, *simulator.margins, *campaign.space.names, *campaign.space.fixed]
        texts = []
        for name in names:
            # `tell` requires the id, and `add` ignores it.
            missing = [one for one in known if one not in (*names, _ID)]
            close = difflib.get_close_matches(name, missing, 1, 0.75)
            if name not in known and close:
                texts.append(f"{self.table.name}column {name!r} is ignored; {close[0]!r} is missing.")
        if not (levels := _levels(campaign)) or campaign.settings.classifier.learns == "outcomes":
            return texts
        name, worst = simulator.margins[0], simulator.outcomes[-1]
        outcome, margin = self.results.outcome, self.results.margins[:, 0]
        by_margin = sum((margin <= level).astype(np.int64) for level in levels)
        rules = {
            f"{name} is {{margin}}; no boundary can be learned from it.": np.isinf(margin),
            f"{name} is missing. A boundary is learned from a margin only if all simulations less severe than {worst} "
            "have it.": np.isnan(margin) & (outcome < len(simulator.outcomes) - 1),
            f"{name} {{margin!r}} contradicts the outcome {{outcome}}.": (by_margin != outcome) & ~np.isnan(margin),
        }
        for text, breaks in rules.items():
            if (breaks & (outcome >= 0)).any():
                row = int(np.argmax(breaks & (outcome >= 0)))
                said = text.format(margin=float(margin[row]), outcome=simulator.outcomes[outcome[row]])
                texts.append(f"{self.table.places[row]}: {said}")
        return texts

    def check_handed_out(self, campaign: Campaign, ids: NDArray[np.int64], designs: Array) -> None:
        """Check that no design was changed since it was handed out.

        Args:
            campaign: the campaign.
            ids: (k,) of the designs that were handed out.
            designs: (k, d) these designs.

        Raises:
            InputError: naming row, column and both values.
        """
        place = {number: k for k, number in enumerate(ids.tolist())}
        for row, (number, told) in enumerate(zip(self.ids.tolist(), self.designs, strict=True)):
            if number not in place:
                continue  # `tell` reports an unknown id
            asked, given = designs[place[number]], ~np.isnan(told)
            if np.array_equal(told[given], asked[given]):
                continue
            distance = _distance(campaign.space, told, designs)[:, given]
            own = distance[place[number]]
            rounded = (np.abs(told - asked) <= _ROUNDED * np.abs(asked))[given] & (own <= _SIMILAR)
            is_same = rounded | (own <= _SAME)
            # Two designs that differ by no more than their rounding may have been exchanged.
            is_nearest = own.max() <= distance.max(axis=1).min()
            if not (is_same.all() and is_nearest):
                worst = np.flatnonzero(given)[int(np.argmax(np.where(is_same, 0.0, 1.0) + own))]
                rule = f"must be {float(asked[worst])!r}, as handed out with id {number} (use `add` for another design)"
                raise self.table.broken(row, campaign.space.names[worst], rule, float(told[worst]))


def _distance(space: DesignSpace, design: Array, designs: Array) -> Array:
    """Distances of a design, (d,), from others, (k, d), by variable: the larger of two scales, infinite for no number.

    One is the variable's own, in standard deviations, on which a log-uniform value is not near another decade. The
    other is the range, on which values far out in a tail differ too.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # no logarithm of a negative value
        own = np.abs(space.standardised(design[None]) - space.standardised(designs))
    distance = np.maximum(own, np.abs(design - designs) / (space.high - space.low))
    return np.where(np.isnan(distance), np.inf, distance)


def _require_result(campaign: Campaign, table: Table) -> None:
    """Check that a table has the outcome, or the only margin, if that decides it.

    Raises:
        InputError: naming the columns.
    """
    deciding = [_OUTCOME, *(campaign.simulator.margins if _levels(campaign) else ())]
    if not set(deciding) & set(table.columns):
        names = " or ".join(map(repr, deciding))
        raise InputError(
            f"{table.name}column {names}: required, but missing; the columns are {','.join(table.columns)}."
        )


def _levels(campaign: Campaign) -> tuple[float, ...]:
    custom = campaign.settings.simulator
    return custom.levels_of_number if isinstance(custom, sections.OutcomeSettings) else ()


def _whole(table: Table, row: int) -> int:
    try:
        number = table.number(row, _ID)  # pandas writes 7.0 where a column has gaps
    except InputError:
        number = math.nan
    if not number.is_integer():
        raise table.broken(row, _ID, "must be a whole number", table.cell(row, _ID))
    if abs(number) >= 2**53:
        raise table.broken(row, _ID, "must be a whole number below 2**53", table.cell(row, _ID))
    return int(number)


def _designs(campaign: Campaign, table: Table) -> Array:
    """The designs of rows, (n, d), NaN where a column is missing. Fixed quantities must have their values.

    Raises:
        InputError: if a cell is no finite number.
    """
    designs = np.full((len(table.rows), campaign.space.dimension), np.nan)
    for column, name in enumerate(campaign.space.names):
        if name in table.columns:
            designs[:, column] = table.numbers([name])[:, 0]
    for name, value in campaign.space.fixed.items():
        if name in table.columns:
            for row, number in enumerate(table.numbers([name])[:, 0].tolist()):
                if abs(number - value) > _ROUNDED * abs(value):
                    raise table.broken(row, name, f"must be {value!r}, its fixed value", table.cell(row, name))
    return designs


def _results(campaign: Campaign, table: Table) -> Results:
    """The results of rows.

    Raises:
        InputError: naming row, column, rule and value of the first cell that breaks a rule.
    """
    k = len(campaign.simulator.margins)
    empty = Results(
        np.empty(0, dtype=np.int8), np.empty(0, dtype=np.int8), np.empty((0, k)), np.empty(0, dtype=np.float64)
    )
    results = Results.concatenate([empty, *(_result(campaign, table, row) for row in range(len(table.rows)))])
    return settled(campaign.simulator, results)


def _result(campaign: Campaign, table: Table, row: int) -> Results:
    outcomes, margins = campaign.simulator.outcomes, campaign.simulator.margins
    values = {name: table.number(row, name) for name in margins}
    seconds = 0.0 if table.cell(row, _SECONDS) is None else table.number(row, _SECONDS)
    if not 0.0 <= seconds < math.inf:
        raise table.broken(row, _SECONDS, "`0 <= seconds < inf` must hold", seconds)
    name = table.cell(row, _OUTCOME)
    cause = np.array([_cause(campaign, table, row)], dtype=np.int8)
    if isinstance(name, str) and name == "numerical_failure":
        known = np.array([[values[margin] for margin in margins]]).reshape(1, len(margins))
        return Results(np.array([NUMERICAL_FAILURE], dtype=np.int8), cause, known, np.array([seconds]))
    answer: object = {"outcome": name, "margins": values}
    if name is None:
        if not (levels := _levels(campaign)):
            raise table.broken(row, _OUTCOME, f"must be one of {', '.join(outcomes)}", None)
        answer = values[margins[0]]
    elif not isinstance(name, str) or name not in outcomes:
        raise table.broken(row, _OUTCOME, f"must be one of {', '.join((*outcomes, 'numerical_failure'))}", name)
    else:
        levels = ()
    try:
        result = read_answer(answer, outcomes, margins, levels, seconds)
    except UnusableAnswerError as error:
        raise InputError(f"{table.places[row]}: {error}.") from None
    return Results(result.outcome, cause, result.margins, result.seconds)


def _cause(campaign: Campaign, table: Table, row: int) -> int:
    """The code of a cause; 0 if none is given."""
    name, causes = table.cell(row, _CAUSE), campaign.simulator.causes
    if name is None:
        return 0
    known = {**{text: code for code, text in EXECUTION_CAUSES.items()}, **{text: i for i, text in enumerate(causes)}}
    if not isinstance(name, str) or name not in known:
        raise table.broken(row, _CAUSE, f"must be empty or one of {', '.join(filter(None, known))}", name)
    return known[name]
