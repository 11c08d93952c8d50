"""Tables: one reader of CSV, whole or in constant memory, and of Python's tables; one writer, safe for spreadsheets."""

import codecs
import csv
import difflib
import math
import operator
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol, Self

import numpy as np

from activefail.errors import InputError
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.text.files import replacing, target_of
from activefail.text.numerals import number_in

ROWS_AT_ONCE = 2048

_LONGEST_HEADER = 1_000_000
"""Most characters that are read in search of a header."""

_FORMULA = re.compile(r"\s*[=+\-@＝＋－＠]|[\t\r]")
"""How a formula begins, also in full-width characters."""

_DECIMAL = re.compile(r"(\s*[+-]?(?=[.,]?\d)\d*)([.,])(\d*(?:[eE][+-]?\d+)?\s*)")
"""A number with a decimal mark: a comma in many countries, whose spreadsheets separate columns by semicolons."""

Source = Path | IO[bytes]
"""Where a table comes from: a file, or a stream such as standard input."""


class TextStream(Protocol):
    """A stream of text, such as standard output."""

    def write(self, text: str, /) -> object:
        """Write a text."""
        ...

    def flush(self) -> None:
        """Pass on what was written."""
        ...


Target = Path | TextStream
"""Where a table goes: a file that gets its name once complete, or a stream that gets rows as they are computed."""


class Kept(NamedTuple):
    """A table that can be read again.

    Attributes:
        path: its file, or a temporary copy of the whole stream.
        name: of the table in messages.
    """

    path: Path
    name: str


Check = Callable[[Array], str | None]
"""A rule for one design, (d,): None if it holds, otherwise "column: rule, got value", without the row."""

_FACTOR = r"\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+"
_SCALED = re.compile(
    rf"(.*?)(?:\s*([*/])\s*(-?(?:{_FACTOR})))?(?:(?(2)\s*|(?:\s+(?=[+-]\s)|(?<=[\])}}])\s*))([+-])\s*({_FACTOR}))?"
)
"""A column with a factor, an offset or both, such as "Load [kN]*-1000", "T [°C]+273.15" and "T + 273.15".

Right after a name without brackets a sign belongs to the name: T-1.
"""


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of a user's table.

    Attributes:
        name: how messages begin: its file, or nothing.
        columns: their names.
        rows: their cells, text or numbers.
        places: how messages name each row.
        decimal_marks: those of the numbers that were read so far, if they may be commas; None if they are points.
    """

    name: str
    columns: tuple[str, ...]
    rows: list[list[Any]]
    places: list[str]
    decimal_marks: set[str] | None = None

    @property
    def is_file(self) -> bool:
        """Whether it was read from a file or a stream, not from Python data."""
        return bool(self.name)

    @classmethod
    def of_csv(cls, source: Source, most: int | None = None) -> "Table":
        """The table in a CSV file or stream.

        Args:
            source: its file or stream.
            most: most rows, if there is a limit.

        Raises:
            InputError: as `parts_of` does, or if there are more rows.
        """
        with rereadable(source) as kept:
            parts = parts_of(kept, most)
            table = next(parts)
            if any(part.rows for part in parts):
                raise InputError(f"{table.name}must have at most {most} rows.")
        return table

    @classmethod
    def of_python(cls, table: Any) -> Self:
        """A pandas DataFrame, a mapping of columns, a sequence of mappings, one for each row, or a single row."""
        import pandas as pd

        rule = "table: must be a DataFrame, a dictionary of columns, or a list of dictionaries"
        # To pandas, None is a table without rows.
        is_table = isinstance(table, pd.DataFrame | pd.Series | Mapping | Sequence | np.ndarray)
        if not is_table or isinstance(table, str | bytes):
            raise InputError(f"{rule}, got {type(table).__name__}.")
        if isinstance(table, pd.Series) or (
            isinstance(table, Mapping) and not any(_is_column(value) for value in table.values())
        ):
            table = [table]
        try:
            frame = table if isinstance(table, pd.DataFrame) else pd.DataFrame(table)
        except (TypeError, ValueError, AttributeError) as error:  # the last where kinds of rows are mixed
            raise InputError(f"{rule}: {error}.") from None
        columns = _distinct("", map(str, frame.columns))
        # By column: rows of a frame of mixed types would turn whole numbers into floats.
        cells = [frame.iloc[:, column].tolist() for column in range(len(columns))]
        rows = [list(row) for row in zip(*cells, strict=True)] if columns else []
        return cls("", columns, rows, [f"row {row}" for row in range(len(rows))])

    def require(self, names: Sequence[str]) -> None:
        """Check that columns exist."""
        for name in names:
            if name not in self.columns:
                close = next((column for column in self.columns if may_be(name, column)), "")
                hint = f" It may be {close!r}." * bool(close)
                raise InputError(
                    f"{self.name}column {name!r}: required, but missing; the required columns are {','.join(names)}."
                    f"{hint}"
                )

    def named(self, names: Mapping[str, str], words: Mapping[str, str], of: str) -> Self:
        """The table with other names of columns, and other units and words in its cells.

        Args:
            names: for a name, the column that has it here, perhaps with a factor and an offset: "Load [kN]*1000",
                "time [ms]/1000", "T [F]/1.8-17.78", "T + 273.15" (with blanks after a name without brackets).
            words: for a word of the column `of`, the one in its cells here.
            of: a column of `names` or of this table.

        Raises:
            InputError: if a column is missing, or the table has the name already.
        """
        columns, scales = list(self.columns), {}
        for name, text in names.items():
            scaled = None if text in columns else _SCALED.fullmatch(text)
            column = scaled[1] if scaled else text
            if column not in self.columns:
                raise InputError(f"{self.name}column {column!r}: missing; the columns are {','.join(self.columns)}.")
            if name in self.columns and name != column:
                raise InputError(f"{self.name}column {name!r}: occurs already, beside {column!r}, which is to be it.")
            place = self.columns.index(column)
            columns[place] = name
            if scaled:
                factor, offset = float(scaled[3] or 1.0), float((scaled[4] or "") + (scaled[5] or "0"))
                if not (0.0 < abs(factor) < math.inf and abs(offset) < math.inf):
                    raise InputError(f"{self.name}column {name!r}: the factor must not be 0, got {text!r}.")
                scales[place] = operator.truediv if scaled[2] == "/" else operator.mul, factor, offset
        word_at, known = columns.index(of) if of in columns else -1, {there: here for here, there in words.items()}

        def cell(place: int, value: Any) -> Any:
            if place == word_at and isinstance(value, str):
                return known.get(value.strip(), value)
            if place not in scales or _is_missing(value):
                return value
            try:
                apply, factor, offset = scales[place]
                return apply(self._number_of(value), factor) + offset
            except (TypeError, ValueError, ArithmeticError):
                return value

        rows = [[cell(place, value) for place, value in enumerate(row)] for row in self.rows]
        return replace(self, columns=tuple(columns), rows=rows)

    def only(self, rows: Sequence[int]) -> Self:
        """The table of these rows."""
        return replace(self, rows=[self.rows[row] for row in rows], places=[self.places[row] for row in rows])

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.columns)}

    def cell(self, row: int, name: str) -> Any:
        """A cell; None if it is empty or its column is missing."""
        if (place := self._places.get(name)) is None:
            return None
        value = self.rows[row][place]
        if isinstance(value, str):
            return value.strip() or None
        return None if _is_missing(value) else value

    def number(self, row: int, name: str) -> float:
        """A cell as a number, infinity and NaN included; NaN if it is empty."""
        value = self.cell(row, name)
        if value is None:
            return math.nan
        try:
            number = self._number_of(value)
        except (TypeError, ValueError, ArithmeticError):
            has_other_mark = self.decimal_marks and _DECIMAL.fullmatch(str(value))
            rule = "must be a number" + " with the decimal mark of the others" * bool(has_other_mark)
            raise self.broken(row, name, rule, value) from None
        if math.isinf(number) and isinstance(value, str) and value.lower().strip("+-") not in ("inf", "infinity"):
            raise self.broken(row, name, "must fit a float64, at most 1.8e308 in size", value)
        return number

    def finite(self, row: int, name: str) -> float:
        """A cell as a finite number."""
        number = self.number(row, name)
        if not math.isfinite(number):
            raise self.broken(row, name, "must be a finite number", self.cell(row, name))
        return number

    def value(self, row: int, of: Parameter) -> float:
        """A variable's cell as a finite number, that of the choice if it has choices."""
        if not of.choices:
            return self.finite(row, of.name)
        cell = self.cell(row, of.name)
        if cell is None:
            raise self.broken(row, of.name, of.rule, cell)
        try:
            return of.number_of(cell if of.has_texts else self._number_of(cell))
        except (TypeError, ValueError, ArithmeticError):
            raise self.broken(row, of.name, of.rule, cell) from None

    def designs(self, space: DesignSpace) -> Array:
        """The designs in columns, (rows, d)."""
        self.require(space.names)
        X = np.empty((len(self.rows), space.dimension))
        of_choices = [bool(one.choices) for one in space.parameters]
        for column in np.flatnonzero(of_choices):
            X[:, column] = [self.value(row, space.parameters[column]) for row in range(len(self.rows))]
        X[:, np.logical_not(of_choices)] = self.numbers([one.name for one in space.parameters if not one.choices])
        return X

    def numbers(self, names: Sequence[str]) -> Array:
        """The finite numbers in columns, (rows, names), such as the designs of a table."""
        self.require(names)
        columns = [self.columns.index(name) for name in names]
        try:
            X = np.array([[self._number_of(cells[column]) for column in columns] for cells in self.rows], dtype=float)
        except (TypeError, ValueError, ArithmeticError):
            X = np.array([math.nan])
        if not np.isfinite(X).all():
            for row in range(len(self.rows)):
                for name in names:
                    self.finite(row, name)
        return X.reshape(len(self.rows), len(names))

    def _number_of(self, value: Any) -> float:
        """The number in a cell; a ValueError if there is none, as in 1_000, which only Python reads as a number."""
        if isinstance(value, bool | np.bool_):
            raise ValueError
        if not isinstance(value, str):
            return float(value)
        if self.decimal_marks is not None and (parts := _DECIMAL.fullmatch(value)):
            if self.decimal_marks - {parts[2]}:
                raise ValueError
            self.decimal_marks.add(parts[2])
            value = f"{parts[1]}.{parts[3]}"
        return number_in(value)

    def broken(self, row: int, column: str, rule: str, value: object) -> InputError:
        """The error of a cell that breaks a rule; the value is None if the cell is empty."""
        shown = "an empty cell" if value is None else repr(value)
        return InputError(f"{self.places[row]}, column {column}: {rule}, got {shown}.")


def may_be(name: str, column: str) -> bool:
    """Whether a column may be the one of this name, misspelt or with a unit: load [kN], Load, load_kN, laod."""
    name, plain = name.casefold(), re.sub(r"\s*[\[({].*$", "", column).strip().casefold()
    is_same = plain == name or re.match(rf"{re.escape(name)}[\s_,.-]", plain)
    return bool(is_same or difflib.get_close_matches(plain, [name], 1, 0.75))


def _is_column(value: object) -> bool:
    return (isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)) or hasattr(value, "to_numpy")


def _is_missing(value: object) -> bool:
    """Whether a cell is None, NaN or pandas' NA."""
    try:
        return value is None or bool(value != value)
    except (TypeError, ValueError, ArithmeticError):  # pandas' NA has no truth value
        return type(value).__name__ == "NAType"


@dataclass(frozen=True)
class DesignTable:
    """A CSV table of designs that is read in constant memory, however long; other columns are kept.

    Attributes:
        source: where it can be read again.
        header: names of all columns.
        space: whose designs they are.
        rows: number of rows.
    """

    source: Kept
    header: tuple[str, ...]
    space: DesignSpace
    rows: int

    @classmethod
    def checked(cls, source: Kept, space: DesignSpace, adds: Sequence[str], check: Check) -> "DesignTable":
        """Read the whole table once and check each cell of a design.

        Args:
            source: the table (see `rereadable`).
            space: whose designs they are.
            adds: output columns, which the table must not contain.
            check: a rule for each design, in addition to finite numbers.
        """
        rows = 0
        for part in parts_of(source, ROWS_AT_ONCE):
            X = part.designs(space)
            for name in adds:
                if name in part.columns:
                    raise InputError(
                        f"{part.name}column {name!r}: would be overwritten by the output; rename or remove it."
                    )
            for place, design in zip(part.places, X, strict=True):
                if problem := check(design):
                    raise InputError(f"{place}, {problem}.")
            rows += len(part.rows)
        return cls(source, part.columns, space, rows)

    def chunks(self) -> Iterator[tuple[list[list[str]], Array]]:
        """The rows as text with their designs, (n, d), up to ROWS_AT_ONCE at a time."""
        for part in parts_of(self.source, ROWS_AT_ONCE):
            if part.rows:
                X = part.designs(self.space)
                for place in [part.columns.index(one.name) for one in self.space.parameters if not one.has_texts]:
                    for cells in part.rows if part.decimal_marks else ():
                        cells[place] = cells[place].replace(",", ".")
                yield part.rows, X


def parts_of(source: Kept, at_once: int | None) -> Iterator[Table]:
    """The rows of a CSV table without blank lines, in parts of at most so many; the last part may have none.

    Columns may also be separated by tabs, or by semicolons; numbers may then have decimal commas.

    Raises:
        InputError: naming the file, and row and line, if it cannot be read, has no header or two columns of one name,
            or a row has another number of cells than the header.
    """
    (path, name), lines = source, None
    rows: list[list[str]] = []
    places: list[str] = []
    try:
        with path.open("rb") as start:
            mark = start.read(4)
        if mark in (b"PK\3\4", b"\xd0\xcf\x11\xe0"):
            raise InputError(f"{name}: is a workbook or an archive; save the table as CSV.")
        # Spreadsheets write a byte order mark.
        encoding = "utf-16" if mark.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
        with path.open(encoding=encoding, newline="") as file:
            title = re.sub(r'"[^"]*"|\[[^]]*\]|\([^)]*\)', "", file.readline())
            file.seek(0)
            separator = max(",;\t", key=title.count)
            decimal_marks = set[str]() if separator == ";" else None
            lines = csv.reader(file, delimiter=separator, strict=True)
            columns = _header(name, next(lines, None))
            for number, cells in enumerate(filter(None, lines), 1):
                # A spreadsheet adds empty rows and columns.
                while len(cells) > len(columns) and not cells[-1].strip():
                    cells.pop()
                if not any(map(str.strip, cells)):
                    continue
                place = f"{name}: row {number} (line {lines.line_num})"
                if len(cells) != len(columns):
                    first = " The header must be the first line." if len(columns) == 1 else ""
                    raise InputError(
                        f"{place}: must have {len(columns)} cells, like the header, has {len(cells)}.{first}"
                    )
                rows.append(cells)
                places.append(place)
                if len(rows) == at_once:
                    yield Table(f"{name}: ", columns, rows, places, decimal_marks)
                    rows, places = [], []
            yield Table(f"{name}: ", columns, rows, places, decimal_marks)
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{name}: must be UTF-8 text (of a spreadsheet: CSV UTF-8): {error.reason} at byte {error.start}."
        ) from None
    except csv.Error as error:
        line = "" if lines is None else f" at line {lines.line_num}"
        raise InputError(f"{name}: not valid CSV{line}: {error}.") from None


def _header(table: str, cells: list[str] | None) -> tuple[str, ...]:
    """The names of a table's columns."""
    if cells is None:
        raise InputError(f"{table}: is empty; a header is required.")
    names = [name.strip() for name in cells]
    while len(names) > 1 and not names[-1]:
        names.pop()
    return _distinct(f"{table}: ", iter(names))


def _distinct(place: str, names: Iterator[str]) -> tuple[str, ...]:
    counts = Counter(names)
    for name, times in counts.items():
        if times > 1:
            raise InputError(f"{place}column {name!r}: must occur only once, occurs {times} times.")
    return tuple(counts)


@contextmanager
def rereadable(source: Source) -> Iterator[Kept]:
    """A table that can be read twice: first to check it, then to use it.

    Raises:
        InputError: if the file is a pipe or a device, or the stream cannot be read or copied.
    """
    if isinstance(source, Path):
        if source.exists() and not (source.is_file() or source.is_dir()):
            raise InputError(f"{source}: must be a regular file, because it is read twice.")
        yield Kept(source, str(source))
        return
    named = "standard input" if source is getattr(sys.stdin, "buffer", None) else getattr(source, "name", None)
    name = named if isinstance(named, str) else "the table"  # the number of a pipe says nothing
    with tempfile.NamedTemporaryFile() as copy:
        try:
            shutil.copyfileobj(source, copy)
            copy.flush()
        except OSError as error:
            folder = tempfile.gettempdir()
            raise InputError(f"{name}: cannot be copied to {folder}: {error.strerror or error}.") from None
        yield Kept(Path(copy.name), name)


@contextmanager
def writing(target: Target, header: Sequence[str]) -> Iterator[Callable[[Sequence[Sequence[Any]]], None]]:
    """Write a table; yields a function that appends rows.

    A file gets its name once it is complete. A stream gets the rows of each call at once.

    Raises:
        InputError: if the file cannot be written.
        OSError: if the stream cannot be written.
    """
    if not isinstance(target, Path):
        write_through = _appending(target, target.flush)
        write_through([header])
        yield write_through
        return
    try:
        target = target_of(target)
        with replacing(target) as file:
            write = _appending(file)
            write([header])
            yield write
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}.") from None


def _appending(file: TextStream, then: Callable[[], None] = lambda: None) -> Callable[[Sequence[Sequence[Any]]], None]:
    plain = csv.writer(file, lineterminator="\n")
    # The plain writer does not quote a lone carriage return, which would end the row for a reader.
    quoting = csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL)

    def append(rows: Sequence[Sequence[Any]]) -> None:
        for row in rows:
            (quoting if any("\r" in str(cell) for cell in row) else plain).writerow(map(harmless, row))
        then()

    return append


def harmless(cell: Any) -> Any:
    """A cell that no spreadsheet takes for a formula: foreign text that looks like one gets an apostrophe.

    >>> [harmless(cell) for cell in ("=1+1", "-0.5", "@x", "a=b", -2.0)]
    ["'=1+1", '-0.5', "'@x", 'a=b', -2.0]
    """
    if not isinstance(cell, str) or not _FORMULA.match(cell):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def likely_header(path: Path) -> list[str]:
    """The names of the columns of a file that need not be a valid table, whatever separates them."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            # Of UTF-16, the zeros are left.
            line = file.readline(_LONGEST_HEADER).replace("\0", "")
            return [name.strip(' "\n') for name in re.split("[,;\t]", line)]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None
