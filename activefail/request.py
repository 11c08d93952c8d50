"""The shape of every analysis: a request, whose options are declared once, and its findings, which are data.

The command line (`cli/analyses.py`), the methods of `Run` and the reference pages are made from the declarations.
"""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Concatenate,
    Generic,
    Literal,
    NamedTuple,
    ParamSpec,
    Protocol,
    TypeVar,
    get_args,
    get_origin,
)

from activefail.arguments import check_whole
from activefail.csv_table import Target
from activefail.errors import InputError
from activefail.progress import Begin, Stage, silent, uncounted

if TYPE_CHECKING:
    from activefail.execution.executor import Executor
    from activefail.run import Run

P = ParamSpec("P")


class Findings(Protocol):
    """What an analysis found: data that prints itself."""

    @property
    def lines(self) -> Sequence[str]:
        """The findings as lines of a terminal."""

    @property
    def exit_code(self) -> int:
        """Of the command: 0 if the question has an answer."""

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values; docs/reference/json.md describes the keys."""


F = TypeVar("F", bound=Findings)
F_co = TypeVar("F_co", bound=Findings, covariant=True)


class Option(NamedTuple):
    """An option of a request.

    Attributes:
        help: what it is, for the command line and for Python.
        kind: type of its words on the command line.
        low, high: its least and largest value; None without a limit.
        names: on the command line, if they are not the field's.
        is_argument: whether the command line takes it by its place, without a name.
        metavar: what stands for its value there, if it is not the type.
        parse: makes the value of a word.
        with_out: whether it is for the pages alone, and so off without `--out`.
        default: of a shared declaration.
        parts: if the value is an object: the options of the command line that make it, by the names of its arguments.
        needs, bars: the option without which, or beside which, this one has no effect, so that it is refused.
    """

    help: str
    kind: Any
    low: float | None = None
    high: float | None = None
    names: tuple[str, ...] = ()
    is_argument: bool = False
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None
    with_out: bool = False
    default: Any = None
    parts: Mapping[str, "Option"] = {}
    needs: str = ""
    bars: str = ""

    def value(self, words: Mapping[str, Any]) -> Any:
        """The object with these words for its parts. Its class is loaded only now, because it may need libraries."""
        module, name = self.kind.split(":")
        return getattr(import_module(module), name)(**{name: words[name] for name in self.parts})

    @property
    def is_of_one_way(self) -> bool:
        """Whether it belongs to one of several ways of answering."""
        return bool(self.needs or self.bars)

    def words(self, name: str) -> str:
        """The option of a field, or those of its parts, as the command line has them."""
        named = {part: of.names for part, of in self.parts.items()} or {name: self.names}
        return " or ".join((names or (f"--{part.replace('_', '-')}",))[0] for part, names in named.items())

    def is_given(self, value: Any) -> bool:
        """Whether a value is one that the user gave; a flag is given if it is set."""
        if value is None or value is False or value == self.default:
            return False
        return not self.parts or value != self.value({name: of.default for name, of in self.parts.items()})


def declared(of: Option) -> Any:
    """A field of a request with this declaration, which others share.

    One that belongs to one way of answering is None until `Request` has seen whether it was given.
    """
    return field(default=None if of.is_of_one_way else of.default, metadata={"option": of})


def option(default: Any, help: str, kind: Any = None, **more: Any) -> Any:
    """A field of a request that is an option (see `Option`); without a default it is required."""
    return declared(Option(help, kind or type(default), default=default, **more))


REQUIRED: Any = MISSING
"""The default of an option that must be given."""


@dataclass(frozen=True)
class Request(Generic[F_co]):
    """A question, to a run folder unless `of_run` says otherwise.

    Attributes:
        executor: runs fresh simulations; all cores of this machine by default.
        stage: called with each stage of the work.
        begin: called with the number of steps of the work; returns a callback for finished ones.

    Raises:
        InputError: naming the option, the rule and the value.
    """

    executor: "Executor | None" = field(default=None, kw_only=True, repr=False)
    stage: Stage = field(default=silent, kw_only=True, repr=False)
    begin: Begin = field(default=uncounted, kw_only=True, repr=False)

    of_run: ClassVar[Option | None] = None
    """What the run folder is for, if the question has an answer without one."""

    writes: ClassVar[bool] = True
    """Whether it simulates or saves, so that the run folder is opened for writing."""

    @classmethod
    def is_written(cls, words: Mapping[str, Any]) -> bool:
        """Whether a command with these words opens the run folder for writing."""
        return cls.writes

    table: ClassVar[str] = ""
    """What the table of `--csv` holds; empty if there is none."""

    pages: ClassVar[str] = ""
    """What the folder of `--out` gets; empty if nothing."""

    counts: ClassVar[str] = ""
    """Title of the progress bar that `begin` moves; empty if there is none."""

    def __post_init__(self) -> None:
        for one, of in options(type(self)):
            if of.is_of_one_way:
                if not of.is_given(getattr(self, one.name)):
                    object.__setattr__(self, one.name, of.default)
                elif of.needs and getattr(self, of.needs) is None:
                    raise InputError(f"{of.words(one.name)}: requires --{of.needs}.")
                elif of.bars and getattr(self, of.bars) is not None:
                    raise InputError(f"{of.words(one.name)}: cannot be combined with --{of.bars}.")
            _check(one.name, getattr(self, one.name), of)

    def answer(self, run: Any) -> F_co:
        """The findings.

        Args:
            run: the open run folder, a `Run`; None if the question has an answer without one.

        Raises:
            InputError: if an option is invalid for this run, or its initial design is not finished.
        """
        raise NotImplementedError

    def write_table(self, findings: Any, target: Target) -> None:
        """Write the table of `--csv`."""

    def write_pages(self, findings: Any, run: Any, out: Path) -> list[Path]:
        """Write the files of `--out` into a folder; returns them."""
        return []


def options(request: type[Request[Any]]) -> list[tuple[Field[Any], Option]]:
    """The options of a request, in the order in which they are declared."""
    return [(one, one.metadata["option"]) for one in fields(request) if "option" in one.metadata]


def _check(name: str, value: Any, declared: Option) -> None:
    if get_origin(declared.kind) is Literal and value not in (words := get_args(declared.kind)):
        raise InputError(f"{name}: must be {' or '.join(words)}, got {value!r}.")
    if value is None or declared.kind not in (int, float):
        return
    low, high = declared.low, declared.high
    if declared.kind is int:
        check_whole(name, value, int(low or 0), math.inf if high is None else high)
    elif isinstance(value, bool) or not isinstance(value, float | int):
        raise InputError(f"{name}: must be a number, got {value!r}.")
    elif low is not None and not value >= low:
        raise InputError(f"{name}: must be at least {low:g}, got {value}.")
    elif high is not None and not value <= high:
        raise InputError(f"{name}: must be at most {high:g}, got {value}.")


def method_of(name: str, request: Callable[P, Request[F]]) -> "Callable[Concatenate[Run, P], F]":
    """The method of `Run` that asks: its arguments are the fields of the request, and it returns the findings."""

    def method(run: "Run", /, *arguments: P.args, **keywords: P.kwargs) -> F:
        return request(*arguments, **keywords).answer(run)

    itself = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    _declare(method, f"Run.{name}", request, [itself], [])
    return method


def function_of(name: str, request: Callable[..., Request[F]]) -> Callable[..., F]:
    """The function that asks without a run folder, or with one as the argument `run`."""

    def function(*arguments: Any, run: "Run | None" = None, **keywords: Any) -> F:
        return request(*arguments, **keywords).answer(run)

    folder = inspect.Parameter("run", inspect.Parameter.KEYWORD_ONLY, default=None, annotation="Run | None")
    _declare(function, name, request, [], [folder])
    return function


def _declare(
    function: Any, name: str, request: Any, before: list[inspect.Parameter], after: list[inspect.Parameter]
) -> None:
    """Give a function the signature and the docstring of a request."""
    signature = inspect.signature(request)
    function.__name__, function.__qualname__, function.__doc__ = name.rpartition(".")[2], name, _docstring(request)
    (findings,) = get_args(request.__orig_bases__[0])
    defaults = {one.name: of.default for one, of in options(request) if of.is_of_one_way}
    own = [one.replace(default=defaults.get(name, one.default)) for name, one in signature.parameters.items()]
    parameters = [*before, *own, *after]
    function.__signature__ = signature.replace(parameters=parameters, return_annotation=findings.__forward_arg__)


def _docstring(request: type[Request[Any]]) -> str:
    declared = "\n".join(f"    {one.name}: {_lowered(of.help)}" for one, of in options(request))
    common = (Request.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    shared = "\n".join(line[4:] for line in common.splitlines())
    raises = "Raises:\n    InputError: if an option is invalid, or the initial design is not finished."
    if request.of_run is not None:
        declared += f"\n    run: {_lowered(request.of_run.help)}"
    return f"{inspect.cleandoc(request.__doc__ or '')}\n\nArgs:\n{declared}\n{shared}\n\n{raises}\n"


def _lowered(help: str) -> str:
    """A help text as the meaning of an argument."""
    return help[:1].lower() + help[1:]
