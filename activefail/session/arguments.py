"""What a Python user passes, checked: tables, names, numbers and executors."""

import io
import math
import os
from collections.abc import Iterable
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex, cast

from activefail.errors import InputError
from activefail.text.files import as_path
from activefail.text.progress import Stage, silent

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.execution.executor import AsynchronousExecutor
    from activefail.text.csv_table import Source, Table, Target


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
    """A table to read in an argument: a file, or a binary stream."""
    source = as_path(source)
    if isinstance(source, io.TextIOBase):
        raise InputError(f"{name}: must be a file that was opened in binary mode, or its path.")
    if not isinstance(source, Path) and not hasattr(source, "read"):
        raise InputError(f"{name}: must be a path or a binary stream, got {type(source).__name__}.")
    return cast("Source", source)


def target_of(name: str, target: Any) -> "Target":
    """A table to write in an argument: a file, or a text stream."""
    target = as_path(target)
    is_binary = isinstance(target, io.RawIOBase | io.BufferedIOBase)
    if not isinstance(target, Path) and (is_binary or not hasattr(target, "write")):
        raise InputError(f"{name}: must be a path or a text stream, got {type(target).__name__}.")
    return cast("Target", target)


def table_of(table: Any) -> "Table":
    """A table of results or simulations in an argument: a CSV file, or Python data (see `Run.tell`)."""
    from activefail.text.csv_table import Table

    is_file = isinstance(table, str | os.PathLike) or hasattr(table, "read")
    return Table.of_csv(source_of("table", table)) if is_file else Table.of_python(table)


def check_whole(name: str, number: SupportsIndex, least: int, most: float = math.inf) -> None:
    """Check an argument that is a whole number."""
    try:
        if isinstance(number, bool):
            raise TypeError
        whole = index(number)
    except TypeError:
        raise InputError(f"{name}: must be a whole number, got {number!r}.") from None
    if whole < least:
        raise InputError(f"{name}: must be at least {least}, got {whole}.")
    if whole > most:
        raise InputError(f"{name}: must be at most {most:g}, got {whole}.")


def executor_named(
    campaign: "Campaign", workers: int | None, name: str, scheduler: str | None, stage: Stage = silent
) -> "AsynchronousExecutor":
    """The executor that options select: "local", this machine, or "dask", a cluster.

    Raises:
        InputError: if simulations are made elsewhere, the options are inconsistent, or the cluster cannot be reached.
    """
    campaign.check_simulates()
    if name == "local":
        from activefail.execution.local import local_executor

        if scheduler is not None:
            raise InputError("--scheduler requires --executor dask.")
        return local_executor(campaign.simulator, workers, campaign.time_limit)
    from activefail.campaign.provenance import simulation_versions
    from activefail.execution.dask import DaskExecutor

    if scheduler is None:
        raise InputError("--executor dask requires --scheduler.")
    if workers is not None:
        raise InputError("--workers requires --executor local; the Dask cluster determines the number of workers.")
    return DaskExecutor(scheduler, campaign.time_limit, stage, simulation_versions)
