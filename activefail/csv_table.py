"""Tables of designs as CSV, checked in full before use, and read and written in constant memory."""

import csv
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activefail.errors import InputError
from activefail.files import replacing, target_of
from activefail.space import Array

ROWS_AT_ONCE = 2048

Check = Callable[[Array], str | None]
"""A rule for one design, (d,): None if it holds, otherwise "column: rule, got value", without the row."""


@dataclass(frozen=True)
class DesignTable:
    """A CSV file with a header and at least the named columns; other columns are kept.

    Attributes:
        path: path of the file.
        header: names of all columns.
        names: names of a design's columns, in order.
        rows: number of rows.
    """

    path: Path
    header: tuple[str, ...]
    names: tuple[str, ...]
    rows: int

    @classmethod
    def checked(cls, path: Path, names: Sequence[str], adds: Sequence[str], check: Check) -> "DesignTable":
        """Read the whole file once and check each cell of the named columns.

        Args:
            adds: output columns, which the file must not contain.
            check: a rule for each design, in addition to finite numbers.

        Raises:
            InputError: naming the file, and row, column, rule and value of the first invalid cell.
        """
        with _reading(path) as lines:
            header = _header(path, next(lines, None), f" with the columns {', '.join(names)}")
            missing = [name for name in names if name not in header]
            for separator in (";", "\t"):
                if missing and len(header) == 1 and separator in header[0]:
                    raise InputError(f"{path}: columns must be separated by commas, not by {separator!r}.")
            if missing:
                raise InputError(
                    f"{path}: column {missing[0]!r}: required, but missing; the required columns are {','.join(names)}."
                )
            for name in adds:
                if name in header:
                    raise InputError(
                        f"{path}: column {name!r}: would be overwritten by the output; rename or remove it."
                    )
            columns = [header.index(name) for name in names]
            rows = 0
            for cells in filter(None, lines):  # blank lines are no rows
                rows += 1
                problem = _problem(cells, header, columns, check)
                if problem is not None:
                    raise InputError(f"{path}: row {rows} (line {lines.line_num}), {problem}.")
        return cls(path, header, tuple(names), rows)

    def chunks(self) -> Iterator[tuple[list[list[str]], Array]]:
        """The rows as text with their designs, (n, d), up to ROWS_AT_ONCE at a time."""
        columns = [self.header.index(name) for name in self.names]
        with _reading(self.path) as lines:
            next(lines, None)
            texts: list[list[str]] = []
            for cells in filter(None, lines):
                texts.append(cells)
                if len(texts) == ROWS_AT_ONCE:
                    yield texts, _designs(texts, columns)
                    texts = []
            if texts:
                yield texts, _designs(texts, columns)


def _designs(texts: list[list[str]], columns: list[int]) -> Array:
    return np.array([[float(cells[column]) for column in columns] for cells in texts])


def _problem(cells: list[str], header: Sequence[str], columns: list[int], check: Check) -> str | None:
    if len(cells) != len(header):
        return f"must have {len(header)} cells, like the header, has {len(cells)}"
    design = np.empty(len(columns))
    for index, column in enumerate(columns):
        text = cells[column].strip()
        try:
            # Reject 1_000, which only Python reads as a number.
            design[index] = float(text.replace("_", "?"))
        except ValueError:
            return f"column {header[column]}: must be a number, got {text!r}"
        if not math.isfinite(design[index]):
            return f"column {header[column]}: must be finite, got {text!r}"
    return check(design)


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    lines = None
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(
                f"{path}: must be a regular file, because it is read twice: first to check it, then to use it."
            )
        # utf-8-sig: spreadsheets write a byte order mark.
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file, strict=True)
            yield lines
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: must be UTF-8 text: {error.reason} at byte {error.start}.") from None
    except csv.Error as error:
        place = f" at line {lines.line_num}" if lines is not None else ""
        raise InputError(f"{path}: not valid CSV{place}: {error}.") from None


@contextmanager
def writing(path: Path, header: Sequence[str]) -> Iterator[Callable[[Sequence[Sequence[Any]]], None]]:
    """Write a table that gets its name once it is complete; yields a function that appends rows.

    Raises:
        InputError: if the table cannot be written.
    """
    try:
        path = target_of(path)
        with replacing(path) as file:
            plain = csv.writer(file, lineterminator="\n")
            # The plain writer does not quote a lone carriage return, which would end the row for a reader.
            quoting = csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL)

            def write(rows: Sequence[Sequence[Any]]) -> None:
                for row in rows:
                    (quoting if any("\r" in str(cell) for cell in row) else plain).writerow(row)

            write([header])
            yield write
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}.") from None


def read_cells(path: Path) -> tuple[tuple[str, ...], list[list[str]], list[int]]:
    """The header of a CSV file, its rows as text without blank lines, and the line at which each row ends.

    Raises:
        InputError: naming the file, and row and line, if it cannot be read, has no header or two columns of one name,
            or a row has another number of cells than the header.
    """
    rows: list[list[str]] = []
    ends: list[int] = []
    with _reading(path) as lines:
        header = _header(path, next(lines, None), "")
        for cells in filter(None, lines):
            if len(cells) != len(header):
                place = f"{path}: row {len(rows) + 1} (line {lines.line_num})"
                raise InputError(f"{place}: must have {len(header)} cells, like the header, has {len(cells)}.")
            rows.append(cells)
            ends.append(lines.line_num)
    return header, rows, ends


def _header(path: Path, cells: list[str] | None, required: str) -> tuple[str, ...]:
    """The names of a table's columns.

    Raises:
        InputError: if there are none, or two of one name.
    """
    if cells is None:
        raise InputError(f"{path}: is empty; a header{required} is required.")
    header = tuple(name.strip() for name in cells)
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}: column {name!r}: must occur only once, occurs {header.count(name)} times.")
    return header
