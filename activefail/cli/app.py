"""The application: its entry, and how a fault ends it."""

import os
import sys
from typing import Annotated

import typer

from activefail.errors import ActivefailError, InputError

app = typer.Typer(
    help="Learn where a seismic isolation bearing fails, with as few simulations as possible.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Plain help: markup would take a unit in brackets for a style.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; a user's mistake ends in one message and exit code 2, another fault in 1."""
    try:
        app()
    except ActivefailError as error:
        print(f"activefail: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InputError) else 1)
    except BrokenPipeError:
        # `| head`, say. The rest of the output goes nowhere, so that closing it at exit does not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(
            "activefail: stopped, since the reader of its output went away; what was recorded is safe", file=sys.stderr
        )
        sys.exit(1)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"activefail: {error.filename or 'output'}: {error.strerror}", file=sys.stderr)
        sys.exit(1)


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
