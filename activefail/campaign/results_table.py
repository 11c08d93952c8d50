"""Tables of results for `tell` and `add`: their columns, whether their designs match, which rows are refused."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign import sections
from activefail.campaign.assembly import Campaign
from activefail.errors import InputError, naming
from activefail.simulators.interface import (
    EXECUTION_CAUSES,
    NUMERICAL_FAILURE,
    NotFiniteError,
    Results,
    UnusableAnswerError,
    settled,
)
from activefail.simulators.returned import read_answer
from activefail.space.expressions import Expression, outputs_of
from activefail.space.space import Array, DesignSpace
from activefail.text.csv_table import Table, may_be

_ID, _OUTCOME, _CAUSE, _SECONDS = "id", "outcome", "cause", "seconds"

_SAME, _SIMILAR = 1e-5, 1e-2
"""Distances (`_distance`) within which a value is the one handed out: with any digits, and rounded (`_unit`)."""


_EXPORTED = ("iteration", "origin")
"""Columns of an exported table that say how a campaign came to a simulation."""

_SHOWN = 10
"""Most rows that a message names."""

_REMEDY = "keep the others: `--skip-invalid`, or `skip_invalid=True` in Python"


def refusal(faults: Sequence[str]) -> InputError:
    """The error of a table with rows that break rules, one text for each."""
    if len(faults) == 1:
        return InputError(faults[0])
    more = [f"and {len(faults) - _SHOWN} more"] * (len(faults) > _SHOWN)
    return InputError(
        "\n  ".join([f"{len(faults)} rows break rules; nothing is recorded ({_REMEDY}):", *faults[:_SHOWN], *more])
    )


@dataclass(frozen=True)
class Reading:
    """How a table of results is read.

    Attributes:
        names: the table's own names, units and words: for a column or an outcome of the campaign, what the table has
            in its place (`Table.named`).
        skip_invalid: whether to leave out rows that break a rule.
        keeps_outside: whether simulations that were not asked for may lie outside the design space.
    """

    names: Mapping[str, str] = field(default_factory=dict)
    skip_invalid: bool = False
    keeps_outside: bool = False

    def table(self, campaign: Campaign, table: Table) -> Table:
        """The table in the campaign's names, units and words.

        Raises:
            InputError: if a name is unknown, or its column is missing or has another unit.
        """
        outcomes, known = (*campaign.simulator.outcomes, "numerical_failure"), _known(campaign)
        for name in self.names:
            if name not in (*outcomes, *known):
                raise InputError(f"map: must name one of {', '.join((*known, *outcomes))}, got {name!r}.")
        _check_units(campaign.space, table, self.names)
        words = {name: text for name, text in self.names.items() if name in outcomes}
        return table.named({name: text for name, text in self.names.items() if name not in words}, words, _OUTCOME)


@dataclass(frozen=True)
class ResultTable:
    """The results in a table.

    Attributes:
        table: the n rows that hold a result.
        ids: (n,) int64, of the designs; empty in a table of simulations that were not asked for.
        designs: (n, d) float64, NaN where the table has no such column.
        results: of the n designs.
        skipped: why other rows were left out.
    """

    table: Table
    ids: NDArray[np.int64]
    designs: Array
    results: Results
    skipped: tuple[str, ...] = ()

    @classmethod
    def told(cls, campaign: Campaign, table: Table, reading: Reading) -> Self:
        """The results of designs that were handed out.

        A row without any result is skipped in a file, which is filled in bit by bit. In Python, NaN may be a result.
        """
        table = reading.table(campaign, table)
        _require(table, [_ID])
        _require_result(campaign, table)
        answers = [name for name in (_OUTCOME, *campaign.simulator.margins, _CAUSE) if name in table.columns]

        def has_result(row: int) -> bool:
            return any(table.cell(row, name) is not None for name in answers)

        def check(row: int, _: Array) -> None:
            if not has_result(row):
                raise InputError(
                    f"{table.places[row]}: must have a result, but has NaN or None as {' and '.join(answers)}. Drop "
                    'the row if there is no result yet; if there will be none, its outcome is "numerical_failure".'
                )

        if table.is_file:
            table = table.only([row for row in range(len(table.rows)) if has_result(row)])
        return cls._of_rows(campaign, table, reading, lambda row: _whole(table, row), check)

    @classmethod
    def added(cls, campaign: Campaign, table: Table, reading: Reading) -> Self:
        """Simulations that were not asked for."""
        table = reading.table(campaign, table)
        space = campaign.space
        _require(table, space.names)
        _require_result(campaign, table)

        def check(row: int, design: Array) -> None:
            if not reading.keeps_outside:
                _check_inside(space, table, row, design)
                return
            with naming(f"{table.places[row]}: "):
                if not space.reaches(design[None]).all():
                    raise InputError(f"{space.row(design)} is too far outside the design space.")
                campaign.features.to_learn(design[None])

        added = cls._of_rows(campaign, table, reading, lambda _: 0, check)
        return replace(added, ids=np.empty(0, dtype=np.int64))

    @classmethod
    def _of_rows(
        cls,
        campaign: Campaign,
        table: Table,
        reading: Reading,
        id_of: Callable[[int], int],
        check: Callable[[int, Array], None],
    ) -> Self:
        rows, ids, designs, results, faults = [], [], [], [], []
        for row in range(len(table.rows)):
            try:
                number, design = id_of(row), _design(campaign, table, row)
                check(row, design)
                results.append(_result(campaign, table, row))
            except InputError as error:
                faults.append(str(error))
                continue
            rows.append(row)
            ids.append(number)
            designs.append(campaign.space.rounded(design[None])[0])
        if faults and not reading.skip_invalid:
            raise refusal(faults)
        return cls(
            table.only(rows),
            np.array(ids, dtype=np.int64),
            np.array(designs).reshape(len(rows), campaign.space.dimension),
            _joined(campaign, results),
            tuple(faults),
        )

    def labels(self, campaign: Campaign) -> list[dict[str, str]]:
        """The cells of the user's own columns that are not empty, by row."""
        known = {*_known(campaign), *_EXPORTED, ""}
        own = [name for name in self.table.columns if name not in known]
        rows = range(len(self.table.rows))
        return [{name: str(cell) for name in own if (cell := self.table.cell(row, name)) is not None} for row in rows]

    def without(self, faults: Mapping[int, str]) -> Self:
        """The results without rows that cannot be recorded, for these reasons."""
        rows = [row for row in range(len(self.table.rows)) if row not in faults]
        ids = self.ids[rows] if len(self.ids) else self.ids
        skipped = (*self.skipped, *faults.values())
        return type(self)(
            self.table.only(rows), ids, self.designs[rows], self.results[np.array(rows, dtype=int)], skipped
        )

    def warnings(self, campaign: Campaign) -> list[str]:
        """Likely mistakes: misspelt columns, and margins that are missing or contradict the outcome."""
        simulator, names = campaign.simulator, self.table.columns
        known = _known(campaign)
        absent = [one for one in known if one not in (*names, _ID)]
        texts = []
        if self.skipped:
            more = f" and {len(self.skipped) - _SHOWN} more" if len(self.skipped) > _SHOWN else ""
            rows = "1 row is" if len(self.skipped) == 1 else f"{len(self.skipped)} rows are"
            texts.append(f"{rows} skipped: {' '.join(self.skipped[:_SHOWN])}{more}")
        # An exported table has all of these; `tell` requires the id.
        lost = (
            {*_EXPORTED, *([_ID] if len(self.ids) < len(self.results) else [])}
            if not {*_EXPORTED} <= {*names}
            else set()
        )
        for name in names:
            missing = [one for one in absent if may_be(one, name)]
            if name not in known and missing:
                texts.append(
                    f"{self.table.name}column {name!r} is ignored; {missing[0]!r} is missing{_way(missing[0], name)}."
                )
            if name in lost:
                texts.append(f"{self.table.name}column {name!r} is not kept, for `export` has one; rename it.")
        system = campaign.system
        if not (_levels(campaign) or system) or campaign.settings.classifier.learns == "outcomes":
            return texts
        name, worst = campaign.learnable[0], simulator.outcomes[-1]
        outcome, margins = self.results.outcome, self.results.margins
        margin = margins[:, 0] if system is None else system(margins)
        rules = {
            f"{name} is {{margin}}; no boundary can be learned from it.": np.isinf(margin),
            f"{name} is missing. A boundary is learned from a margin only if all simulations less severe than {worst} "
            "have it.": np.isnan(margin) & (outcome < len(simulator.outcomes) - 1),
            f"{name} {{margin!r}} contradicts the outcome {{outcome}}.": campaign.contradicts(self.results),
        }
        for text, breaks in rules.items():
            if (breaks & (outcome >= 0)).any():
                row = int(np.argmax(breaks & (outcome >= 0)))
                said = text.format(margin=float(margin[row]), outcome=simulator.outcomes[outcome[row]])
                texts.append(f"{self.table.places[row]}: {said}")
        return texts

    def checked(
        self, campaign: Campaign, ids: NDArray[np.int64], designs: Array, reading: Reading, changed: bool
    ) -> Self:
        """The results, with the designs that were handed out, or changed since if that is allowed.

        Args:
            campaign, ids, designs: as for `changed`.
            reading: how the table is read.
            changed: whether designs may differ from those that were handed out.
        """
        if not changed:
            faults = self.changed(campaign, ids, designs)
            if faults and not reading.skip_invalid:
                raise refusal(list(faults.values()))
            return self.without(faults)
        place = {number: k for k, number in enumerate(ids.tolist())}
        asked = np.array([designs[place[number]] if number in place else design for number, design in self._named()])
        simulated = np.where(np.isnan(self.designs), asked.reshape(self.designs.shape), self.designs)
        faults = {}
        for row in [row for row, number in enumerate(self.ids.tolist()) if number in place]:  # `tell` reports others
            try:
                _check_inside(campaign.space, self.table, row, simulated[row])
            except InputError as error:
                faults[row] = str(error)
        if faults and not reading.skip_invalid:
            raise refusal(list(faults.values()))
        return replace(self, designs=simulated).without(faults)

    def _named(self) -> list[tuple[int, Array]]:
        return list(zip(self.ids.tolist(), self.designs, strict=True))

    def changed(self, campaign: Campaign, ids: NDArray[np.int64], designs: Array) -> dict[int, str]:
        """Why rows have other designs than were handed out, by row.

        Args:
            campaign: the campaign.
            ids: (k,) of the designs that were handed out.
            designs: (k, d) these designs.
        """
        faults: dict[int, str] = {}
        place = {number: k for k, number in enumerate(ids.tolist())}
        for row, (number, told) in enumerate(zip(self.ids.tolist(), self.designs, strict=True)):
            if number not in place:
                continue  # `tell` reports an unknown id
            asked, given = designs[place[number]], ~np.isnan(told)
            if np.array_equal(told[given], asked[given]):
                continue
            distance = _distance(campaign.space, told, designs)[:, given]
            own = distance[place[number]]
            rounded = (np.abs(told - asked) <= [_unit(value) for value in told])[given] & (own <= _SIMILAR)
            values = zip(campaign.space.parameters, told, asked, strict=True)
            is_step = np.array([one.step is None or one.rounded(x) == one.rounded(y) for one, x, y in values])[given]
            is_same = (rounded | (own <= _SAME)) & is_step
            # Two designs that differ by no more than their rounding may have been exchanged.
            is_nearest = own.max() <= distance.max(axis=1).min()
            if not (is_same.all() and is_nearest):
                worst = np.flatnonzero(given)[int(np.argmax(np.where(is_same, 0.0, 1.0) + own))]
                way = "`tell --changed` records another design"
                one = campaign.space.parameters[worst]
                shown = [one.written(x[worst]) if one.choices else float(x[worst]) for x in (asked, told)]
                rule = f"must be {shown[0]!r}, as handed out with id {number} ({way})"
                faults[row] = str(self.table.broken(row, one.name, rule, shown[1]))
        return faults


def _unit(value: float) -> float:
    """The unit of the last digit but zeros at the end, 0.01 of 33.74 and 33.740: rounding moves a value by less."""
    exponent = Decimal(repr(float(value))).normalize().as_tuple().exponent
    return 10.0**exponent if isinstance(exponent, int) else 0.0


def _distance(space: DesignSpace, design: Array, designs: Array) -> Array:
    """Distances of a design, (d,), from others, (k, d), by variable: the larger of two scales, infinite for no number.

    One is the variable's own, in standard deviations, on which a log-uniform value is not near another decade. The
    other is the range, on which values far out in a tail differ too.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # no logarithm of a negative value
        own = np.abs(space.standardised(design[None]) - space.standardised(designs))
    distance = np.maximum(own, np.abs(design - designs) / (space.high - space.low))
    return np.where(np.isnan(distance), np.inf, distance)


def _known(campaign: Campaign) -> list[str]:
    """The names of the columns that a table of results may have."""
    simulator, space = campaign.simulator, campaign.space
    return [_ID, _OUTCOME, _CAUSE, _SECONDS, *simulator.margins, *space.names, *space.fixed]


def _check_units(space: DesignSpace, table: Table, names: Mapping[str, str]) -> None:
    """Check that columns whose titles state another unit than the variable's have a factor; without one, no percent."""
    units = {one.name: one.unit for one in space.parameters}
    for name, text in names.items():
        known = units.get(name, "")
        title = re.fullmatch(rf".*[\[(]\s*(.*?)\s*[\])]|{re.escape(name)}_(\w+)", text, re.IGNORECASE)
        if (
            title
            and text in table.columns
            and (title[1] or title[2]) != known
            and (known or (title[1] or title[2]) == "%")
        ):
            own = f"{name} [{known}]" if known else name
            raise InputError(
                f"map: {text!r} may have another unit than {own}: write a factor, such as {text}/1000; with {text}*1 "
                "it is the same."
            )


def _way(name: str, column: str) -> str:
    return f' (--map "{name}={column}", with a factor if the unit differs)'


def _require(table: Table, names: Sequence[str]) -> None:
    """Check that columns exist."""
    try:
        table.require(names)
    except InputError as error:
        missing = next(name for name in names if name not in table.columns)
        close = next((column for column in table.columns if may_be(missing, column)), "")
        named = (
            f"{str(error)[:-1]}{_way(missing, close)}." if close else f'{error} Another name: --map "{missing}=NAME".'
        )
        raise InputError(named) from None


def _require_result(campaign: Campaign, table: Table) -> None:
    """Check that a table has the outcome, or the only margin, if that decides it."""
    deciding = [_OUTCOME, *(_returned(campaign) if _levels(campaign) or campaign.system else ())]
    if not set(deciding) & set(table.columns):
        names = " or ".join(map(repr, deciding))
        close = [(name, column) for name in deciding for column in table.columns if may_be(name, column)]
        another = f' Another name: --map "{deciding[0]}=NAME".'
        hint = f" {close[0][1]!r} may be it{_way(*close[0])}." if close else another
        raise InputError(
            f"{table.name}column {names}: required, but missing; the columns are {','.join(table.columns)}.{hint}"
        )


def _levels(campaign: Campaign) -> tuple[float, ...]:
    custom = campaign.settings.simulator
    return custom.levels_of_number if isinstance(custom, sections.OutcomeSettings) else ()


def _expressions(campaign: Campaign) -> dict[str, Expression]:
    custom = campaign.settings.simulator
    return {} if isinstance(custom, str) else custom.expressions


def _returned(campaign: Campaign) -> tuple[str, ...]:
    """The numbers that a simulation returns: the outputs in the margins' expressions, or the margins."""
    return outputs_of(_expressions(campaign)) or campaign.simulator.margins


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


def _design(campaign: Campaign, table: Table, row: int) -> Array:
    """The design of a row, (d,), NaN where a column is missing. Fixed quantities must have their values.

    Raises:
        InputError: if a cell is no finite number or choice.
    """
    variables = campaign.space.parameters
    design = np.array([table.value(row, one) if one.name in table.columns else np.nan for one in variables])
    for name, value in campaign.space.fixed.items():
        if name not in table.columns:
            continue
        cell = table.finite(row, name)
        if abs(cell - value) > max(_SAME * abs(value), min(_unit(cell), 1e-3 * abs(value))):
            raise table.broken(row, name, f"must be {value!r}, its fixed value", table.cell(row, name))
    return design


def _check_inside(space: DesignSpace, table: Table, row: int, design: Array) -> None:
    """Check that the design of a row, (d,), lies in the design space."""
    if broken := space.broken_rule(design):
        raise table.broken(row, *broken)


def _joined(campaign: Campaign, parts: Sequence[Results]) -> Results:
    """The results of rows."""
    k = len(campaign.simulator.margins)
    empty = Results(
        np.empty(0, dtype=np.int8), np.empty(0, dtype=np.int8), np.empty((0, k)), np.empty(0, dtype=np.float64)
    )
    return settled(campaign.simulator, Results.concatenate([empty, *parts]))


def _result(campaign: Campaign, table: Table, row: int) -> Results:
    outcomes, margins = campaign.simulator.outcomes, _returned(campaign)
    levels, expressions = _levels(campaign), _expressions(campaign)
    values = {name: table.number(row, name) for name in campaign.simulator.margins}
    given = {name: values[name] for name in margins if table.cell(row, name) is not None}
    seconds = 0.0 if table.cell(row, _SECONDS) is None else table.number(row, _SECONDS)
    if not 0.0 <= seconds < math.inf:
        raise table.broken(row, _SECONDS, "`0 <= seconds < inf` must hold", seconds)
    name = table.cell(row, _OUTCOME)
    known = (*outcomes, "numerical_failure")
    if isinstance(name, str) and name not in known:  # a spreadsheet may have "Failed"
        name = next((one for one in known if one.casefold() == name.casefold()), name)
    cause = np.array([_cause(campaign, table, row)], dtype=np.int8)
    if isinstance(name, str) and name == "numerical_failure":
        return Results(
            np.array([NUMERICAL_FAILURE], dtype=np.int8), cause, np.array([[*values.values()]]), np.array([seconds])
        )
    if not table.is_file and (levels or campaign.system) and cause[0] >= 0:
        # There NaN may be what was simulated; code that compares, such as `g <= 0`, calls it safe.
        given |= {name: values[name] for name in margins if name in table.columns}
    answer: object
    if name is None:
        if not (levels or campaign.system):
            raise table.broken(row, _OUTCOME, f"must be one of {', '.join(outcomes)}", None)
        answer = given if campaign.system or expressions else values[margins[0]]
    elif not isinstance(name, str) or name not in outcomes:
        rule = f'must be one of {", ".join(known)} (or a WORD of --map "{outcomes[-1]}=WORD")'
        raise table.broken(row, _OUTCOME, rule, name)
    else:
        answer = {"outcome": name} | (given if expressions else {"margins": given})
        levels = ()
    try:
        truncated = tuple(getattr(campaign.settings.simulator, "truncated", ()))
        result = read_answer(answer, outcomes, margins, levels, seconds, campaign.system, ("",), truncated, expressions)
    except UnusableAnswerError as error:
        way = '; if there is no result, its outcome is "numerical_failure"' * isinstance(error, NotFiniteError)
        raise InputError(f"{table.places[row]}: {error}{way}.") from None
    is_failure = cause[0] in getattr(campaign.simulator, "failing", ()) and result.outcome[0] == len(outcomes) - 1
    if cause[0] < 0 and not is_failure:
        rule = f"must be empty beside the outcome {outcomes[result.outcome[0]]}, which it contradicts"
        raise table.broken(row, _CAUSE, rule, table.cell(row, _CAUSE))
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
