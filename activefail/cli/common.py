"""What commands share: a run folder as argument, a progress bar, warnings, and how signals and full disks are met."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from activefail.cli.screen import terminal
from activefail.errors import InputError
from activefail.visible import quoted, visible

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.execution.executor import AsynchronousExecutor
    from activefail.record.run_folder import FolderStore

INTERRUPTED = 130
"""The exit code of a program that a Ctrl-C ended, as shells have it."""

RunFolder = Annotated[Path, typer.Argument(help="Run folder of a campaign.", metavar="DIR", show_default=False)]

Code = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the campaign's own code, which is then run: where its simulator or features are one's own.",
        exists=True,
        file_okay=False,
        show_default=False,
    ),
]

Workers = Annotated[int | None, typer.Option(help="Side by side; all cores by default.", min=1)]

ExecutorName = Annotated[
    Literal["local", "dask"], typer.Option(help="Where simulations run: this machine, or a Dask cluster.")
]

Scheduler = Annotated[
    str | None, typer.Option(help="Of the Dask cluster, like tcp://head:8786.", metavar="ADDRESS", show_default=False)
]


def make_executor(
    campaign: "Campaign", workers: int | None, name: str, scheduler: str | None
) -> "AsynchronousExecutor":
    """The executor that a command line asks for.

    Raises:
        InputError: if the options do not go together, or the cluster cannot be reached.
    """
    if name == "local":
        from activefail.execution.local import local_executor

        if scheduler is not None:
            raise InputError("--scheduler: is for --executor dask.")
        return local_executor(campaign.simulator, workers, campaign.time_limit)
    from activefail.execution.dask import DaskExecutor

    if scheduler is None:
        raise InputError("--scheduler: required for --executor dask.")
    if workers is not None:
        raise InputError("--workers: is for --executor local; a Dask cluster has the workers that it has.")
    return DaskExecutor(scheduler, campaign.time_limit, lambda line: print(line, file=sys.stderr, flush=True))


def resume_command(folder: Path, campaign: "Campaign | None" = None) -> str:
    """The command that goes on with a campaign, ready to be pasted; with the folder of the campaign's own code."""
    command = f"activefail resume {quoted(folder)}"
    if campaign is None or (isinstance(campaign.settings.simulator, str) and not campaign.sources):
        return command
    return f"{command} --code {'FOLDER' if campaign.code is None else quoted(campaign.code)}"


def check_output(option: str, path: Path | None) -> None:
    """Check that what is to be written is nothing that a run folder keeps for itself; before anything is done.

    Raises:
        InputError: naming the option and the file.
    """
    from activefail.record.layout import link_in_run_folder, run_folder_owning

    if path is None:
        return
    if run_folder_owning(path) is not None:
        raise InputError(f"{option}: {path} is a file of the run folder itself; name another.")
    if (link := link_in_run_folder(path)) is not None:
        raise InputError(f"{option}: {link} is a symbolic link in a run folder, which is not followed; name another.")


@contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Names the file or folder of a fault of writing.

    Raises:
        InputError: instead of what the system raised.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from None


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int], Callable[[int], None]]]:
    """A bar on a terminal, nothing otherwise; yields what takes the total and returns what takes the rows done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(file=terminal(sys.stderr), stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:

        def begin(total: int) -> Callable[[int], None]:
            task = bar.add_task(title, total=total)
            return lambda done: bar.advance(task, done)

        yield begin


@contextmanager
def stop_on_signals(stopping: str = "stopping after this batch") -> Iterator[Callable[[], bool]]:
    """The first Ctrl-C or SIGTERM asks for a stop and says what is done before it, the second stops at once."""
    asked = at_once = False

    def ask(number: int, frame: object) -> None:
        nonlocal asked, at_once
        if asked:
            at_once = True
            raise KeyboardInterrupt
        asked = True
        print(f"\n{stopping}; once more to stop now", file=sys.stderr)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    except Exception as broken:
        # An interrupt in the middle of one of Python's own locks comes out as that lock's complaint.
        if at_once:
            raise KeyboardInterrupt from broken
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def show_warnings(store: "FolderStore") -> None:
    """Warnings of a record that were not shown yet, on the error stream."""
    for warning in store.new_warnings():
        print(f"warning: {visible(warning)}", file=sys.stderr)
