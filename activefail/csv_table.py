"""Reads and writes CSV tables of designs in constant memory; the caller states the rules for a row."""

import csv
import io
import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np

from activefail.errors import InputError
from activefail.files import replacing, target_of
from activefail.space import Array

ROWS_AT_ONCE = 2048

_LONGEST_HEADER = 1_000_000
"""Most characters that are read in search of a header."""

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

Check = Callable[[Array], str | None]
"""A rule for one design, (d,): None if it holds, otherwise "column: rule, got value", without the row."""


@dataclass(frozen=True)
class DesignTable:
    """A CSV table with a header and at least the named columns; other columns are kept.

    Attributes:
        source: its file, or a stream that can be read again.
        header: names of all columns.
        names: names of a design's columns, in order.
        rows: number of rows.
    """

    source: Source
    header: tuple[str, ...]
    names: tuple[str, ...]
    rows: int

    @classmethod
    def checked(cls, source: Source, names: Sequence[str], adds: Sequence[str], check: Check) -> "DesignTable":
        """Read the whole table once and check each cell of the named columns.

        Args:
            source: its file, or a stream that can be read again (see `rereadable`).
            names: names of a design's columns, in order.
            adds: output columns, which the table must not contain.
            check: a rule for each design, in addition to finite numbers.

        Raises:
            InputError: naming the file, and row, column, rule and value of the first invalid cell.
        """
        path = name_of(source)
        with _reading(source) as lines:
            header = _header(path, next(lines, None), f" with the columns {', '.join(names)}")
            missing = [name for name in names if name not in header]
            if missing:
                _check_commas(path, header)
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
        return cls(source, header, tuple(names), rows)

    def chunks(self) -> Iterator[tuple[list[list[str]], Array]]:
        """The rows as text with their designs, (n, d), up to ROWS_AT_ONCE at a time."""
        columns = [self.header.index(name) for name in self.names]
        with _reading(self.source) as lines:
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


def number_of(text: str) -> float:
    """The number in a cell; a ValueError if there is none, as in 1_000, which only Python reads as a number."""
    return float(text.replace("_", "?"))


def _problem(cells: list[str], header: Sequence[str], columns: list[int], check: Check) -> str | None:
    if len(cells) != len(header):
        return f"must have {len(header)} cells, like the header, has {len(cells)}"
    design = np.empty(len(columns))
    for index, column in enumerate(columns):
        text = cells[column].strip()
        try:
            design[index] = number_of(text)
        except ValueError:
            return f"column {header[column]}: must be a number, got {text!r}"
        if not math.isfinite(design[index]):
            return f"column {header[column]}: must be finite, got {text!r}"
    return check(design)


@contextmanager
def rereadable(source: Source) -> Iterator[Source]:
    """A source that can be read twice: the file itself, or a temporary copy of the whole stream.

    Raises:
        InputError: if the stream cannot be read or copied.
    """
    if isinstance(source, Path):
        yield source
        return
    with tempfile.TemporaryFile(buffering=0) as file, _Copy(file, name_of(source)) as copy:
        try:
            shutil.copyfileobj(source, copy)
            copy.flush()
        except OSError as error:
            folder = tempfile.gettempdir()
            raise InputError(f"{name_of(source)}: cannot be copied to {folder}: {error.strerror or error}.") from None
        yield copy


class _Copy(io.BufferedRandom):
    """A temporary copy of a stream.

    Attributes:
        title: the name of the stream in messages.
    """

    def __init__(self, file: io.FileIO, title: str) -> None:
        super().__init__(file)
        self.title = title


def name_of(source: Source) -> str:
    """A table's source in messages."""
    if isinstance(source, Path):
        return str(source)
    if isinstance(source, _Copy):
        return source.title
    if source is getattr(sys.stdin, "buffer", None):
        return "standard input"
    name = getattr(source, "name", None)  # the number of a pipe says nothing
    return name if isinstance(name, str) else "the table"


@contextmanager
def _opened(source: Source) -> Iterator[IO[str]]:
    # utf-8-sig: spreadsheets write a byte order mark.
    if isinstance(source, Path):
        if source.exists() and not (source.is_file() or source.is_dir()):
            raise InputError(
                f"{source}: must be a regular file, because it is read twice: first to check it, then to use it."
            )
        with source.open(encoding="utf-8-sig", newline="") as file:
            yield file
        return
    source.seek(0)
    text = io.TextIOWrapper(source, encoding="utf-8-sig", newline="")
    try:
        yield text
    finally:
        text.detach()  # keeps the stream open


@contextmanager
def _reading(source: Source) -> Iterator[Any]:
    path, lines = name_of(source), None
    try:
        with _opened(source) as file:
            lines = csv.reader(file, strict=True)
            yield lines
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: must be UTF-8 text: {error.reason} at byte {error.start}.") from None
    except csv.Error as error:
        place = f" at line {lines.line_num}" if lines is not None else ""
        raise InputError(f"{path}: not valid CSV{place}: {error}.") from None


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
            (quoting if any("\r" in str(cell) for cell in row) else plain).writerow(row)
        then()

    return append


def read_cells(source: Source) -> tuple[tuple[str, ...], list[list[str]], list[int]]:
    """The header of a CSV file, its rows as text without blank lines, and the line at which each row ends.

    Raises:
        InputError: naming the file, and row and line, if it cannot be read, has no header or two columns of one name,
            or a row has another number of cells than the header.
    """
    rows: list[list[str]] = []
    ends: list[int] = []
    path = name_of(source)
    with _reading(source) as lines:
        header = _header(path, next(lines, None), "")
        _check_commas(path, header)
        for cells in filter(None, lines):
            if len(cells) != len(header):
                place = f"{path}: row {len(rows) + 1} (line {lines.line_num})"
                raise InputError(f"{place}: must have {len(header)} cells, like the header, has {len(cells)}.")
            rows.append(cells)
            ends.append(lines.line_num)
    return header, rows, ends


def likely_header(path: Path) -> list[str]:
    """The names of the columns of a file that need not be a valid table, whatever separates them.

    Raises:
        InputError: if the file cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            # Of UTF-16, the zeros are left.
            line = file.readline(_LONGEST_HEADER).replace("\0", "")
            return [name.strip(' "\n') for name in re.split("[,;\t]", line)]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None


def _check_commas(path: str, header: Sequence[str]) -> None:
    """Check that a header is not one column because of another separator.

    Raises:
        InputError: naming the separator.
    """
    for separator in (";", "\t"):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"{path}: columns must be separated by commas, not by {separator!r}.")


def _header(path: object, cells: list[str] | None, required: str) -> tuple[str, ...]:
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
