"""An analysis: a function of an open run folder whose options are declared once, as the defaults of its arguments.

It is a method of `Run`, or a function of the package; its command (`cli/analyses.py`) and its reference pages are made
from the declarations.
"""

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, NamedTuple, ParamSpec, Protocol, TypeVar, get_args, get_origin

from activefail.errors import InputError
from activefail.session.arguments import check_whole

P = ParamSpec("P")
F = TypeVar("F")

REQUIRED: Any = inspect.Parameter.empty
"""The default of an option that must be given."""

_WORK = {
    "executor": "runs fresh simulations; all cores of this machine by default.",
    "stage": "called with each stage of the work.",
    "begin": "called with the number of steps of the work; returns a callback for finished ones.",
}
"""Arguments that are no options: who does the work, and who hears of it."""


class Findings(Protocol):
    """What an analysis found: data that prints itself. With a table it also has `write_table(target)`."""

    @property
    def lines(self) -> Sequence[str]:
        """The findings as lines of a terminal."""

    @property
    def exit_code(self) -> int:
        """Of the command: 0 if the question has an answer."""

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values; docs/reference/json.md describes the keys."""


class Option(NamedTuple):
    """An option: the default of an argument, with all that is to be said of it.

    Attributes:
        default: REQUIRED if it must be given.
        help: what it is, for the command line and for Python.
        kind: type of its words on the command line.
        low, high: its least and largest value; None without a limit.
        names: on the command line, if they are not the argument's.
        is_argument: whether the command line takes it by its place, without a name.
        metavar: what stands for its value there, if it is not the type.
        parse: makes the value of a word; a ValueError states the rule that the word breaks.
        with_out: whether it is for the pages alone, and so off without `--out`.
        parts: if the value is an object: the options of the command line that make it, by the names of its arguments.
        needs, bars: the option without which, or beside which, this one has no effect, so that it is refused.
    """

    default: Any
    help: str
    kind: Any = str
    low: float | None = None
    high: float | None = None
    names: tuple[str, ...] = ()
    is_argument: bool = False
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None
    with_out: bool = False
    parts: Mapping[str, "Option"] = {}
    needs: str = ""
    bars: str = ""

    def value(self, words: Mapping[str, Any]) -> Any:
        """The object with these words for its parts. Its class is loaded only now, because it may need libraries."""
        return loaded(self.kind)(**{name: words[name] for name in self.parts})

    def words(self, name: str) -> str:
        """The option of an argument, or those of its parts, as the command line has them."""
        named = {part: of.names for part, of in self.parts.items()} or {name: self.names}
        return " or ".join((names or (f"--{part.replace('_', '-')}",))[0] for part, names in named.items())

    def check(self, name: str, value: Any) -> None:
        """Check the value of an argument."""
        if get_origin(self.kind) is Literal and value not in (words := get_args(self.kind)):
            raise InputError(f"{name}: must be {' or '.join(words)}, got {value!r}.")
        if value is None or self.kind not in (int, float):
            return
        if self.kind is int:
            check_whole(name, value, int(self.low or 0), math.inf if self.high is None else self.high)
        elif isinstance(value, bool) or not isinstance(value, float | int):
            raise InputError(f"{name}: must be a number, got {value!r}.")
        elif self.low is not None and not value >= self.low:
            raise InputError(f"{name}: must be at least {self.low:g}, got {value}.")
        elif self.high is not None and not value <= self.high:
            raise InputError(f"{name}: must be at most {self.high:g}, got {value}.")


def option(default: Any, help: str, kind: Any = None, **more: Any) -> Any:
    """An `Option`, of any type for the type checker, so that it may be the default of an argument."""
    return Option(default, help, kind or (str if default in (None, REQUIRED) else type(default)), **more)


def loaded(place: str) -> Any:
    """What "module:name" names; its module is loaded only now."""
    module, name = place.split(":")
    return getattr(import_module(module), name)


class Analysis(NamedTuple):
    """What the command line needs to know of an analysis.

    Attributes:
        function: answers; its first argument is the run folder, or it has an option `run`.
        options: by name, in their order.
        doc: what it does.
        example: the words of the command that ends its help.
        writes: whether it simulates or saves, so that the run folder is opened for writing; or what tells this from
            the words of the command.
        table: what the table of `--csv` holds; empty if there is none.
        pages: what the folder of `--out` gets; empty if nothing.
        writer: "module:function" that writes these pages.
        counts: title of the progress bar that `begin` moves; empty if there is none.
    """

    function: Callable[..., Findings]
    options: Mapping[str, Option]
    doc: str
    example: str
    writes: bool | Callable[[Mapping[str, Any]], bool] = True
    table: str = ""
    pages: str = ""
    writer: str = ""
    counts: str = ""

    def check(self, given: Mapping[str, Any], in_words: bool = False) -> None:
        """Check the arguments that were given, and that they go together; a flag is given if it is set.

        Args:
            given: their values by name.
            in_words: whether messages name the options of the command line instead.
        """
        named = {name: of.words(name) if in_words else name for name, of in self.options.items()}
        is_set = {name for name, value in given.items() if value is not None and value is not False}
        for name, of in self.options.items():
            if name in is_set and of.needs and of.needs not in is_set:
                raise InputError(f"{named[name]}: requires {named[of.needs]}.")
            if name in is_set and of.bars in is_set:
                raise InputError(f"{named[name]}: cannot be combined with {named[of.bars]}.")
            if name in given:
                of.check(name, given[name])

    def in_python(self, text: str) -> str:
        """A text of the command line for Python, where its options have the names of the arguments."""
        names = {of.words(name): f"`{name}`" for name, of in self.options.items()}
        return re.sub(r"--[a-z][a-z-]*", lambda found: names.get(found[0], found[0]), text)

    def write_pages(self, findings: Findings, run: Any, out: Path) -> list[Path]:
        """Write the files of `--out` into a folder; returns them."""
        files: list[Path] = loaded(self.writer)(findings, out, None if run is None else run.campaign)
        return files


_DECLARED: dict[Callable[..., Any], Analysis] = {}


def analysis(example: str = "", **more: Any) -> Callable[[Callable[P, F]], Callable[P, F]]:
    """Declare a function an analysis: its arguments are checked by their options, and its docstring gets them.

    Args:
        example, more: attributes of `Analysis`.
    """

    def declare(function: Callable[P, F]) -> Callable[P, F]:
        signature = inspect.signature(function)
        options = {name: one.default for name, one in signature.parameters.items() if isinstance(one.default, Option)}
        signature = signature.replace(
            parameters=[
                one.replace(default=options[name].default) if name in options else one
                for name, one in signature.parameters.items()
            ]
        )

        @wraps(function)
        def checked(*arguments: P.args, **keywords: P.kwargs) -> F:
            bound = signature.bind(*arguments, **keywords)
            asks.check(bound.arguments)
            bound.apply_defaults()
            return function(*bound.args, **bound.kwargs)

        doc = inspect.getdoc(function) or ""
        asks = Analysis(checked, options, doc, example, **more)  # type: ignore[arg-type]
        begun = {
            name: re.sub("^[A-Z](?![A-Z])", lambda first: first[0].lower(), of.help) for name, of in options.items()
        }
        said = {name: asks.in_python(help) for name, help in begun.items()} | _WORK
        arguments = "\n".join(f"    {name}: {said[name]}" for name in signature.parameters if name in said)
        raises = "Raises:\n    InputError: if an option is invalid, or the initial design is not finished."
        checked.__doc__ = f"{asks.in_python(doc)}\n\nArgs:\n{arguments}\n\n{raises}\n"
        checked.__signature__ = signature  # type: ignore[attr-defined]
        _DECLARED[checked] = asks
        return checked

    return declare


def declared(function: Callable[..., Any]) -> Analysis:
    """What was declared of an analysis."""
    return _DECLARED[function]
