"""Tables of designs as CSV: every cell checked before anything is done, read and written in constant memory."""

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
"""A rule on one design, (d,): None when it holds, else "column: rule, got value" without the row."""


@dataclass(frozen=True)
class DesignTable:
    """A CSV file with a header and at least the named columns; others are carried along.

    Attributes:
        path: of the file.
        header: all its columns.
        names: the columns that make a design, in its order.
        rows: how many.
    """

    path: Path
    header: tuple[str, ...]
    names: tuple[str, ...]
    rows: int

    @classmethod
    def checked(cls, path: Path, names: Sequence[str], adds: Sequence[str], check: Check) -> "DesignTable":
        """Read the whole file once and check each cell of the named columns.

        Args:
            adds: columns that will be added, which the file must not have.
            check: a rule on each design beyond its cells being finite numbers.

        Raises:
            InputError: naming the file, and row, column, rule and value of the first bad cell.
        """
        with _reading(path) as lines:
            header = next(lines, None)
            if header is None:
                raise InputError(f"{path}: is empty; a header with the columns {', '.join(names)} is needed.")
            header = [name.strip() for name in header]
            for name in header:
                if header.count(name) > 1:
                    raise InputError(f"{path}: column {name!r}: must come once, comes {header.count(name)} times.")
            missing = [name for name in names if name not in header]
            for separator in (";", "\t"):
                if missing and len(header) == 1 and separator in header[0]:
                    raise InputError(f"{path}: columns must be separated by commas, not by {separator!r}.")
            if missing:
                raise InputError(
                    f"{path}: column {missing[0]!r}: required, but not there; needed are {','.join(names)}."
                )
            for name in adds:
                if name in header:
                    raise InputError(f"{path}: column {name!r}: will be written and must not be there already.")
            columns = [header.index(name) for name in names]
            rows = 0
            for cells in filter(None, lines):  # blank lines are no rows
                rows += 1
                problem = _problem(cells, header, columns, check)
                if problem is not None:
                    raise InputError(f"{path}: row {rows} (line {lines.line_num}), {problem}.")
        return cls(path, tuple(header), tuple(names), rows)

    def chunks(self) -> Iterator[tuple[list[list[str]], Array]]:
        """The rows as text and their designs, (n, d), a few thousand at a time."""
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


def _problem(cells: list[str], header: list[str], columns: list[int], check: Check) -> str | None:
    if len(cells) != len(header):
        return f"must have {len(header)} cells as the header does, has {len(cells)}"
    design = np.empty(len(columns))
    for place, column in enumerate(columns):
        text = cells[column].strip()
        try:
            # Python's own 1_000 is no number to anyone else.
            design[place] = float(text.replace("_", "?"))
        except ValueError:
            return f"column {header[column]}: must be a number, got {text!r}"
        if not math.isfinite(design[place]):
            return f"column {header[column]}: must be finite, got {text!r}"
    return check(design)


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    lines = None
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: must be a regular file, as it is read twice: checked, then used.")
        # utf-8-sig: spreadsheets put a byte order mark in front.
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
    """Write a table under its final name only once it is whole; yields a function that appends rows.

    Raises:
        InputError: if the folder cannot be written to or is full.
    """
    try:
        path = target_of(path)
        with replacing(path) as file:
            plain = csv.writer(file, lineterminator="\n")
            # The plain writer does not quote a lone carriage return, at which a reader would end the row.
            quoting = csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_ALL)

            def write(rows: Sequence[Sequence[Any]]) -> None:
                for row in rows:
                    (quoting if any("\r" in str(cell) for cell in row) else plain).writerow(row)

            write([header])
            yield write
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}.") from None
