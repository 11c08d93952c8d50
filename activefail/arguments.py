"""Checks of what a Python user passes: paths, tables, names and numbers."""

import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex, cast

from activefail.errors import InputError

if TYPE_CHECKING:
    from activefail.campaign.results_table import ResultTable, Table
    from activefail.csv_table import Source, Target


def _file(file: Any) -> Any:
    """The path that a string or another library's path names; anything else is returned unchanged."""
    return Path(os.fsdecode(file)) if isinstance(file, str | os.PathLike) else file


def path_of(name: str, file: Any) -> Path:
    """A file in an argument.

    Raises:
        InputError: if it is no path.
    """
    if not isinstance(file := _file(file), Path):
        raise InputError(f"{name}: must be a path, got {type(file).__name__}.")
    return file


def names_of(argument: str, names: Any) -> tuple[str, ...]:
    """Names in an argument; a single one may be a string.

    Raises:
        InputError: if they are something else.
    """
    if isinstance(names, str):
        return (names,)
    found = tuple(names) if isinstance(names, Iterable) else (names,)
    if not all(isinstance(name, str) for name in found):
        raise InputError(f"{argument}: must be names of variables, got {names!r}.")
    return found


def source_of(name: str, source: Any) -> "Source":
    """A table to read in an argument: a file, or a binary stream.

    Raises:
        InputError: if it is something else.
    """
    source = _file(source)
    if isinstance(source, io.TextIOBase):
        raise InputError(f"{name}: must be a file that was opened in binary mode, or its path.")
    if not isinstance(source, Path) and not hasattr(source, "read"):
        raise InputError(f"{name}: must be a path or a binary stream, got {type(source).__name__}.")
    return cast("Source", source)


def target_of(name: str, target: Any) -> "Target":
    """A table to write in an argument: a file, or a text stream.

    Raises:
        InputError: if it is something else.
    """
    target = _file(target)
    is_binary = isinstance(target, io.RawIOBase | io.BufferedIOBase)
    if not isinstance(target, Path) and (is_binary or not hasattr(target, "write")):
        raise InputError(f"{name}: must be a path or a text stream, got {type(target).__name__}.")
    return cast("Target", target)


def table_of(table: Any) -> "Table":
    """A table of results or simulations in an argument: a CSV file, or Python data (see `Run.tell`).

    Raises:
        InputError: if it is something else, or breaks a rule of tables.
    """
    from activefail.campaign.results_table import Table

    is_file = isinstance(table, str | os.PathLike) or hasattr(table, "read")
    return Table.of_csv(source_of("table", table)) if is_file else Table.of_python(table)


@contextmanager
def rows_named(results: "ResultTable") -> Iterator[None]:
    """Name the row of the user's table in the error of a result that cannot be recorded.

    Raises:
        InputError: in place of a RowError.
    """
    from activefail.loop.asking import RowError

    try:
        yield
    except RowError as error:
        raise InputError(f"{results.table.places[results.rows[error.row]]}: {error}.") from None


def check_whole(name: str, number: SupportsIndex, least: int) -> None:
    """Check an argument that is a whole number.

    Raises:
        InputError: naming the argument, the rule and the value.
    """
    try:
        if isinstance(number, bool):
            raise TypeError
        whole = index(number)
    except TypeError:
        raise InputError(f"{name}: must be a whole number, got {number!r}.") from None
    if whole < least:
        raise InputError(f"{name}: must be at least {least}, got {whole}.")


def check_confidence(confidence: float) -> None:
    """Check a confidence.

    Raises:
        InputError: if it is not between 0 and 1.
    """
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence: must be between 0 and 1, got {confidence}.")
