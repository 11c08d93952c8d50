"""Options of the command line from declared ones."""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

from activefail.cli.app import Quiet, Verbose, set_level
from activefail.run.analysis import REQUIRED, Option

Parameters = dict[str, tuple[Any, Any]]
"""The parameters of a command by name: annotation and default, from which typer makes its options."""


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command that typer can read, with -q and -v, of one whose defaults may be options, or what their parts make."""
    own = inspect.signature(command).parameters
    objects = {name: one.default for name, one in own.items() if isinstance(one.default, Option) and one.default.parts}

    @wraps(command)
    def wrapper(quiet: bool, verbose: bool, **words: Any) -> None:
        set_level(quiet, verbose)
        made = {name: of.value(words) for name, of in objects.items()}
        command(**{name: made[name] if name in made else words[name] for name in own})

    parameters: Parameters = {}
    for name, one in own.items():
        of = one.default
        parameters |= parameters_of(name, of) if isinstance(of, Option) else {name: (one.annotation, of)}
    sign(wrapper, parameters | {"quiet": (Quiet, False), "verbose": (Verbose, False)})
    return wrapper


def parameters_of(name: str, of: Option) -> Parameters:
    """The parameter of an option, or those of its parts."""
    if of.parts:
        return {part: one for name, declared in of.parts.items() for part, one in parameters_of(name, declared).items()}
    required = of.default is REQUIRED
    default = None if of.parse is not None or required else of.with_out or of.default
    kind = of.kind if required or default is not None else of.kind | None
    # A flag that is off has no opposite.
    names = of.names or ((f"--{name.replace('_', '-')}",) if default is False else ())
    make: Any = typer.Argument if of.is_argument else typer.Option
    help = f"{of.help[:-1]}, with --out." if of.with_out else of.help
    shown = make(*names, help=help, min=of.low, max=of.high, metavar=of.metavar, show_default=default not in (None, ""))
    return {name: (Annotated[kind, shown], REQUIRED if required else default)}


def sign(command: Any, parameters: Parameters) -> None:
    """Give a command the signature from which typer makes its options."""
    kind = inspect.Parameter.KEYWORD_ONLY
    command.__signature__ = inspect.Signature(
        [inspect.Parameter(name, kind, default=default, annotation=of) for name, (of, default) in parameters.items()]
    )
    command.__annotations__ = {name: of for name, (of, _) in parameters.items()} | {"return": None}
