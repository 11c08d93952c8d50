"""Options, executors and warnings shared by the commands."""

import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from activefail.errors import InputError, TableWarning
from activefail.record.layout import check_output
from activefail.session.display import is_quiet, is_verbose
from activefail.text.json_text import json_text
from activefail.text.screen import table_stream
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.analyses.findings.summary import Summary
    from activefail.run.run import Run
    from activefail.text.csv_table import Target


def _shipped(incomplete: str) -> list[str]:
    """The names of shipped campaigns that begin so; the shell completes files where there are none."""
    from activefail.campaign.on_disk import shipped_campaigns

    return [name for name in shipped_campaigns() if name.startswith(incomplete)]


CampaignFile = Annotated[
    Path,
    typer.Argument(
        help="Campaign file, or the name of a shipped campaign (`activefail campaigns`).",
        metavar="CAMPAIGN.toml",
        show_default=False,
        autocompletion=_shipped,
    ),
]

RunFolder = Annotated[Path, typer.Argument(help="Run folder of a campaign.", metavar="DIR", show_default=False)]

Code = Annotated[
    Path | None,
    typer.Option(
        help="Folder with the code of the custom simulator or features; activefail executes this code.",
        exists=True,
        file_okay=False,
        show_default=False,
    ),
]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

_BEGAN = time.monotonic()
"""The start of the program, nearly: this module is imported first."""

STANDARD = tuple(map(Path, ("-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")))
"""Standard input or output in place of a file. (Descriptor 1 is that of the error stream, see `program`.)"""


def table_input(path: Path) -> Path | IO[bytes]:
    """The table that a command reads: the file, or standard input for "-".

    Raises:
        InputError: if standard input is closed.
    """
    if path not in STANDARD:
        return path
    if sys.stdin is None:
        raise InputError("standard input: cannot be read: it is closed.")
    return sys.stdin.buffer


@contextmanager
def table_output(option: str, path: Path) -> "Iterator[Target]":
    """The table that a command writes: the file, or standard output for "-".

    Everything else that is printed meanwhile, by custom code too, then goes to standard error.

    Raises:
        InputError: if the file is reserved by a run folder, or standard output is closed.
    """
    if path not in STANDARD:
        check_output(option, path)
        yield path
        return
    if sys.stdout is None:
        raise InputError("standard output: cannot be written: it is closed.")
    table = table_stream(sys.stdout)
    with redirect_stdout(sys.stderr):
        yield table


def check_out(out: Path | None) -> None:
    """Check, before any work, the folder that --out names; None is valid.

    Raises:
        InputError: if it is reserved by a run folder, or a file.
    """
    check_output("--out", out)
    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"--out: {out} must be a folder, but is a file.")


def check_table(option: str, path: Path | None) -> None:
    """Check, before any work, the table that an option names; None and "-" are valid.

    Raises:
        InputError: if it is reserved by a run folder, or a folder.
    """
    if path is None or path in STANDARD:
        return
    check_output(option, path)
    if path.is_dir():
        raise InputError(f"{option}: {path} must be a file, but is a folder.")


def name_of(path: Path) -> str:
    """A table in messages."""
    return "standard output" if path in STANDARD else visible(str(path))


@contextmanager
def opened_run(
    folder: Path, *, write: bool = False, code: Path | None = None, simulates: bool | None = None
) -> Iterator["Run"]:
    """Open a run folder and print the warnings of its record (see `open_run`)."""
    from activefail.run.opening import open_run

    with open_run(folder, write=write, code=code, simulates=simulates) as run:
        show_warnings(run.store.new_warnings())
        yield run
        show_warnings(run.store.new_warnings())


def print_json(values: Mapping[str, object]) -> None:
    """Print figures as JSON."""
    print(json_text(values))


def show_stage(text: str) -> None:
    """Print the current stage to the error stream, unless it is quiet; with `-v`, the time since the command began."""
    if is_quiet():
        return
    print(f"{time.monotonic() - _BEGAN:.1f} s: {text}" if is_verbose() else text, file=sys.stderr, flush=True)


def show_unseen(summary: "Summary") -> None:
    """Print warnings to the error stream if an outcome has no simulation, or a margin may be a flag."""
    show_warnings([summary.unseen_warning, summary.flag_warning])


def show_warnings(warnings: Iterable[str]) -> None:
    """Print warnings to the error stream; skip empty texts."""
    for warning in filter(None, warnings):
        print(f"warning: {visible(warning)}", file=sys.stderr)


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print warnings about tables as those of the command line at the end of a block, and others as Python does."""
    caught: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", TableWarning)
            yield
    finally:
        for one in caught:
            if issubclass(one.category, TableWarning):
                show_warnings([str(one.message)])
            else:
                warnings.showwarning(one.message, one.category, one.filename, one.lineno)
