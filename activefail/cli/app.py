"""The application: its entry, and how a fault ends it."""

import errno
import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand

from activefail.errors import ActivefailError, InputError, place_of, reason_of
from activefail.interrupts import INTERRUPTED, end_without_waiting, hearing_every_ctrl_c
from activefail.screen import OUTPUT, visible_output

app = typer.Typer(
    help="Learn where a seismic isolation bearing fails, with as few simulations as possible.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Plain help: markup would take a unit in brackets for a style.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def program() -> None:
    """Run the command line as a process of its own, and end it."""
    try:
        main()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            end_without_waiting()
        raise


def main() -> None:
    """Run the command line; a user's mistake ends in one message and exit code 2, another fault in 1."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A description or a folder's name may have letters that the terminal's encoding has not.
        sys.stdout.reconfigure(errors="backslashreplace")
    with visible_output():
        _main()


def _main() -> None:
    try:
        with hearing_every_ctrl_c():
            app()
    except ActivefailError as error:
        _end(str(error), 2 if isinstance(error, InputError) else 1)
    except ImportError as error:
        _end(f"a library cannot be loaded: {error}. Is it installed, and is there memory enough for it?", 1)
    except MemoryError:
        _end("out of memory; what was recorded is safe", 1)
    except BrokenPipeError:
        # `| head`, say.
        _silence()
        print(
            "activefail: stopped, since the reader of its output went away; what was recorded is safe", file=sys.stderr
        )
        sys.exit(1)
    except OSError as error:
        if error.filename == OUTPUT:
            _silence()
        _end(_description_of(error), 2 if error.errno in _NO_NAMES else 1)


def _end(message: str, code: int) -> NoReturn:
    """End with a message. Its first line alone begins at the margin: what follows may quote a stranger's text."""
    first, *more = f"activefail: {message}".split("\n")
    print("\n".join([first, *(line if line.startswith("  ") else f"  {line}" for line in more)]), file=sys.stderr)
    sys.exit(code)


class Command(TyperCommand):
    """A command whose option errors name the value that was given, too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The arguments that are left, as `TyperCommand` parses them."""
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as fault:
            fault.message = _with_value(fault)
            raise


def _with_value(fault: typer.BadParameter) -> str:
    """What is said of an option's value: the rule, and the value."""
    from pydantic import ValidationError

    # Others name the value themselves.
    if not isinstance(fault.__cause__, ValidationError):
        return fault.message
    error = fault.__cause__.errors()[0]
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return message
    rule = message.replace("Input should be", "must be").partition(", unable to parse")[0]
    return f"{rule}, got {error['input']!r}"


def ends_on_ctrl_c(command: Callable[..., None]) -> Callable[..., None]:
    """A command that a Ctrl-C ends in a message and exit code 130, where it has no more to say itself."""

    @wraps(command)
    def ended(*arguments: Any, **options: Any) -> None:
        try:
            command(*arguments, **options)
        except KeyboardInterrupt:
            print("activefail: stopped; what was recorded is safe", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None

    return ended


def _description_of(error: OSError) -> str:
    """The file that the system refused, or where the program called the system, and the reason."""
    return f"{error.filename or f'a system call failed{place_of(error)}'}: {reason_of(error)}"


_NO_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
"""What the system says of a name that can be no file's: a mistake of who gave it."""


def _silence() -> None:
    """Send the rest of the output nowhere, so that closing it at exit does not fail again."""
    # There may be none: closed (`>&-`), or replaced by what is no file.
    with suppress(AttributeError, io.UnsupportedOperation):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_version(asked: bool) -> None:
    if asked:
        from activefail import __version__

        print(f"activefail {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None: ...
