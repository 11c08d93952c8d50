"""The application: its entry point and its error handling."""

import errno
import io
import logging
import os
import sys
import traceback
from contextlib import suppress
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand

from activefail.errors import ActivefailError, InputError, place_of, reason_of
from activefail.session.display import is_verbose
from activefail.session.interrupts import INTERRUPTED, end_without_waiting, repeating_missed_ctrl_c
from activefail.text.current_folder import MATPLOTLIB, keep_out
from activefail.text.screen import OUTPUT, visible_output

Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Show no progress; results, notes and warnings remain.")]

Verbose = Annotated[
    bool, typer.Option("-v", "--verbose", help="Show stages with their times, and where an error was raised.")
]

app = typer.Typer(
    help="Learn where a simulation fails, with as few simulations as possible.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help: markup would read a unit in brackets as a style.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def program() -> None:
    """Run the command line as the process's main program."""
    keep_out(MATPLOTLIB)
    _reserve_output()
    try:
        main()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            end_without_waiting()
        raise


def _reserve_output() -> None:
    """Give standard output another descriptor, so that compiled code that writes to descriptor 1 spoils no table."""
    before = sys.stdout
    if isinstance(before, io.TextIOWrapper) and sys.stderr is not None:
        own = open(os.dup(1), "wb", 0 if before.write_through else -1)  # noqa: SIM115
        by_line, at_once = before.line_buffering, before.write_through
        sys.stdout = io.TextIOWrapper(own, before.encoding, before.errors, None, by_line, at_once)
        os.dup2(2, 1)


def main() -> None:
    """Run the command line; exit with one message and code 2 after a user error, code 1 after another error."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # The terminal's encoding may lack letters of a description or a folder name.
        sys.stdout.reconfigure(errors="backslashreplace")
    with visible_output():
        # Standard error is the stream of this block; a handler made before would keep the former one.
        _show_log(sys.stderr)
        _main()


def _show_log(stream: TextIO) -> None:
    """Show what activefail logs, such as that it compiles, as lines of the error stream."""
    log = logging.getLogger("activefail")
    log.handlers = [logging.StreamHandler(stream)]
    log.setLevel(logging.INFO)


def _main() -> None:
    output = sys.stdout
    try:
        with repeating_missed_ctrl_c():
            try:
                app()
            finally:
                # Here its errors have a message; Python's own flush, at the exit, would end with code 120.
                if output is not None:
                    output.flush()
    except ActivefailError as error:
        _end(str(error), 2 if isinstance(error, InputError) else 1)
    except ImportError as error:
        _end(f"cannot load a library: {error}. Check that it is installed and that memory is sufficient.", 1)
    except MemoryError:
        _end("out of memory; recorded simulations are safe", 1)
    except BrokenPipeError as error:
        # For example, piped into `head`.
        _silence()
        if error.errno is None:
            print("activefail: stopped: the output pipe was closed; recorded simulations are safe", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        if error.filename == OUTPUT:
            _silence()
        _end(_description_of(error), 2 if error.errno in _NO_NAMES else 1)


def _end(message: str, code: int) -> NoReturn:
    """Exit with a message. Later lines are indented: they may quote a stranger's text that imitates a message."""
    if is_verbose():
        traceback.print_exc()
    first, *rest = f"activefail: {message}".split("\n")
    print("\n".join([first, *(line if line.startswith("  ") else f"  {line}" for line in rest)]), file=sys.stderr)
    sys.exit(code)


class Command(TyperCommand):
    """A command whose option errors include the invalid value, and that Ctrl-C ends with a message and code 130."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command as `TyperCommand` does; Ctrl-C may be handled by the command itself."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            kept = stop.args[0] if stop.args else "recorded simulations are safe"
            print(f"activefail: stopped; {kept}", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments as `TyperCommand` does."""
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as fault:
            fault.message = _with_value(fault)
            raise


def _with_value(fault: typer.BadParameter) -> str:
    """The message for an invalid option: the rule and the value."""
    from pydantic import ValidationError

    # Other errors already contain the value.
    if not isinstance(fault.__cause__, ValidationError):
        return fault.message
    error = fault.__cause__.errors()[0]
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return message
    rule = message.replace("Input should be", "must be").partition(", unable to parse")[0]
    return f"{rule}, got {error['input']!r}"


def set_level(quiet: bool, verbose: bool) -> None:
    """What is shown depends on the level of the log alone, which the options -q and -v set."""
    if quiet or verbose:
        logging.getLogger("activefail").setLevel(logging.DEBUG if verbose else logging.WARNING)


def _description_of(error: OSError) -> str:
    """The file of a failed system call, or the place of the call, and the reason."""
    return f"{error.filename or f'a system call failed{place_of(error)}'}: {reason_of(error)}"


_NO_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
"""Errors that mean an invalid file name, which is a user error."""


def _silence() -> None:
    """Discard further output, so that closing it at exit does not fail again."""
    # Standard output may be closed (`>&-`) or replaced by an object that is not a file.
    with suppress(AttributeError, io.UnsupportedOperation):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_version(requested: bool) -> None:
    if requested:
        from activefail.version import __version__

        print(f"activefail {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    set_level(quiet, verbose)
