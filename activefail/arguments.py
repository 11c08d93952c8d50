"""What a Python user passes, checked: paths, tables, names, numbers, hazards and questions."""

import io
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex, cast

from activefail.errors import InputError

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.campaign.hazard import Hazard
    from activefail.campaign.question import Question
    from activefail.campaign.results_table import ResultTable, Table
    from activefail.csv_table import Source, Target
    from activefail.space import DesignSpace


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
    listed = tuple(names) if isinstance(names, Iterable) else (names,)
    if not all(isinstance(name, str) for name in listed):
        raise InputError(f"{argument}: must be names of variables, got {names!r}.")
    return listed


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


def values_of(space: "DesignSpace", fixed: "Mapping[str, float] | Path | str | None") -> dict[str, float]:
    """Values of variables in an argument: by name, or in a TOML file.

    Raises:
        InputError: if a name is not a variable, or a value is not a number.
    """
    from activefail.campaign.question import checked_values, read_fixed

    if fixed is None:
        return {}
    if isinstance(fixed, str | Path):
        return read_fixed(Path(fixed), space)
    if not isinstance(fixed, Mapping):
        raise InputError(f"fixed: must be values by name, or a path, got {type(fixed).__name__}.")
    return checked_values(fixed, space)


def question_asked(
    campaign: "Campaign",
    question: "Question | Path | str | None",
    fixed: "Mapping[str, float] | Path | str | None",
) -> "Question":
    """A question in an argument (see `Run.asked`).

    Raises:
        InputError: naming the file, the key, the rule and the value.
    """
    from activefail.campaign.question import Question, question_of
    from activefail.campaign.question_files import check_designs_of, read_question

    values = values_of(campaign.space, fixed)
    if isinstance(question, Question):
        # Without values a campaign's own design measure stays what it is, with its stored simulations.
        resolved = question.at(values) if values else question
    elif question is not None:
        resolved = read_question(path_of("question", question), campaign.settings, campaign.space, values)
    else:
        resolved = question_of(campaign.settings, campaign.space, values) if values else campaign.question
    source = next((str(given) for given in (fixed, question) if isinstance(given, str | Path)), "")
    check_designs_of(resolved, campaign.simulator, source)
    return resolved


def site_and_question(
    campaign: "Campaign",
    hazard: "Hazard | Path | str | None",
    question: "Question | Path | str | None",
    fixed: "Mapping[str, float] | Path | str | None",
    free: Collection[str] = (),
) -> "tuple[Hazard | None, Question]":
    """The hazard in an argument and the question that it asks, or a question alone.

    Args:
        campaign: the campaign that is asked.
        hazard, question, fixed: as for `Run.design`.
        free: variables that get their values later. Under rows of pulses they have none in the question.

    Raises:
        InputError: if both are given, or a file is invalid.
    """
    from activefail.campaign.hazard import Hazard, hazard_question, is_hazard, read_hazard
    from activefail.campaign.question_files import check_designs_of, middles

    if hazard is not None and question is not None:
        raise InputError("question: cannot be combined with hazard.")
    if isinstance(question, Path | str) and is_hazard(Path(question)):
        hazard, question = question, None
    if hazard is None:
        return None, question_asked(campaign, question, fixed)
    space = campaign.space
    site = hazard if isinstance(hazard, Hazard) else read_hazard(path_of("hazard", hazard))
    values, file = values_of(space, fixed), str(hazard) if isinstance(hazard, Path | str) else ""
    # The pulses of a file have no distribution of other variables beside them.
    meanwhile = middles(space, [name for name in free if name not in values]) if site.rows is not None else {}
    try:
        resolved = hazard_question(site, campaign.settings, space, {**meanwhile, **values})
    except InputError as error:
        raise InputError(f"{file}: {error}" if file else str(error)) from None
    check_designs_of(resolved, campaign.simulator, str(fixed) if isinstance(fixed, Path | str) else file)
    values_fixed = {name: value for name, value in resolved.fixed.items() if name not in meanwhile}
    return site, replace(resolved, fixed=values_fixed)
