"""Options of the command line from the declarations of requests."""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

from activefail.request import REQUIRED, Option

Parameters = dict[str, tuple[Any, Any]]
"""The parameters of a command by name: annotation and default, from which typer makes its options."""


def with_options(**declared: Option) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare parameters of a command; one with parts gets the object that these make."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command).parameters

        @wraps(command)
        def wrapper(**words: Any) -> None:
            objects = {name: of.value(words) for name, of in declared.items() if of.parts}
            command(**{name: objects[name] if name in objects else words[name] for name in own})

        parameters: Parameters = {}
        for name, one in own.items():
            of = declared.get(name)
            parameters |= {name: (one.annotation, one.default)} if of is None else parameters_of(name, of)
        sign(wrapper, parameters)
        return wrapper

    return decorate


def parameters_of(name: str, of: Option) -> Parameters:
    """The parameter of an option, or those of its parts."""
    if of.parts:
        return {part: one for name, declared in of.parts.items() for part, one in parameters_of(name, declared).items()}
    required = of.default is REQUIRED
    default = None if of.parse is not None or required else of.with_out or of.default
    kind = of.kind if required or default is not None else of.kind | None
    make: Any = typer.Argument if of.is_argument else typer.Option
    has_default = default not in (None, "")
    shown = make(*of.names, help=of.help, min=of.low, max=of.high, metavar=of.metavar, show_default=has_default)
    return {name: (Annotated[kind, shown], inspect.Parameter.empty if required else default)}


def sign(command: Any, parameters: Parameters) -> None:
    """Give a command the signature from which typer makes its options."""
    kind = inspect.Parameter.KEYWORD_ONLY
    command.__signature__ = inspect.Signature(
        [inspect.Parameter(name, kind, default=default, annotation=of) for name, (of, default) in parameters.items()]
    )
    command.__annotations__ = {name: of for name, (of, _) in parameters.items()} | {"return": None}
