"""What commands share: a run folder as argument, a progress bar, warnings, and how signals and full disks are met."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from activefail.errors import InputError

RunFolder = Annotated[Path, typer.Argument(help="Run folder of a campaign.", metavar="DIR", show_default=False)]


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

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:

        def begin(total: int) -> Callable[[int], None]:
            task = bar.add_task(title, total=total)
            return lambda done: bar.advance(task, done)

        yield begin


@contextmanager
def stop_on_signals() -> Iterator[Callable[[], bool]]:
    """The first Ctrl-C or SIGTERM asks for a stop after the batch, the second stops at once."""
    asked = False

    def ask(number: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        print("\nstopping after this batch; once more to stop now", file=sys.stderr)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def show_warnings(warnings: tuple[str, ...]) -> None:
    """Warnings of a record, on the error stream."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
