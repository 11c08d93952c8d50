"""Custom simulators that are Python functions."""

import inspect
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from activefail.errors import ActivefailError, InputError, description_of
from activefail.simulators.interface import Results
from activefail.simulators.returned import designs_by_name, objects_in, read_answer, read_objects
from activefail.simulators.user_code import SIMULATOR_KEY, load_function, not_permitted
from activefail.space.expressions import Expression
from activefail.space.space import Array, DesignSpace
from activefail.visible import visible


@dataclass(frozen=True)
class PythonSimulator:
    """A function that simulates one design, in a worker process.

    It takes a dictionary with the values of the variables and the fixed quantities. The value of a variable with a set
    is the record, scaled (`activefail.SetRecord`). It returns the name of the outcome, or a
    dictionary with "outcome" and, optionally, "margins", a dictionary of numbers, and "cause"; or the only
    margin, if it has levels; or the outputs in `expressions`, with "outcome" and "cause" or without. If it raises, only
    that simulation fails.

    Attributes:
        space: design space.
        reference: the function, as "module:function".
        code: folder of its module and of those that it imports; None if it may not be run.
        outcomes, margins, causes: the names that an answer may contain; the first cause is none.
        source: digest required of its module, on any machine; "" accepts any (see `load_function`).
        folder: the run folder, from which no code is run.
        renew: most simulations per process; None means no limit.
        levels, system, truncated, expressions: of the margins (see `read_answer`); the outputs follow the margins.
    """

    space: DesignSpace
    reference: str
    code: Path | None
    outcomes: tuple[str, ...]
    margins: tuple[str, ...]
    source: str = ""
    folder: Path | None = None
    renew: int | None = None
    levels: tuple[float, ...] = ()
    system: Callable[[Array], Array] | None = None
    truncated: tuple[str, ...] = ()
    expressions: Mapping[str, Expression] | None = None
    failing: tuple[int, ...] = ()
    impossible: tuple[int, ...] = ()
    causes: tuple[str, ...] = ("",)

    releases_gil = False

    def check_permitted(self) -> None:
        """Check that the function may be run."""
        if self.code is None:
            raise not_permitted(SIMULATOR_KEY, self.reference)

    def load(self) -> str:
        """Import the function's module and return the digest of its source.

        Raises:
            InputError: if the function does not exist, may not be run, or does not take a design.
        """
        function, digest = load_function(self.reference, self.code, SIMULATOR_KEY, self.folder)
        _check_takes_a_design(function, self.reference)
        return digest

    def prepare(self) -> None:
        """Import the function's module and read records, so that neither counts as simulation time."""
        _loaded(self.reference, self.code, self.source, self.folder)
        read_objects(self.space)

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d), one after the other.

        Raises:
            UnusableAnswerError: if a return value breaks a rule.
        """
        function = _loaded(self.reference, self.code, self.source, self.folder)
        answers = []
        read_objects(self.space)
        for design in designs_by_name(self.space, X):
            design |= objects_in(self.space, design)
            began = time.perf_counter()
            try:
                answer = function(design)
            except ActivefailError as error:
                # The user's code raised it: only this simulation fails, not the campaign.
                raise RuntimeError(description_of(error)).with_traceback(error.__traceback__) from None
            seconds = time.perf_counter() - began
            names = self.outcomes, self.margins, self.levels
            result = read_answer(answer, *names, seconds, self.system, self.causes, self.truncated, self.expressions)
            answers.append(result)
        return Results.concatenate(answers)


def _check_takes_a_design(function: Callable[..., object], reference: str) -> None:
    """Check that a function can be called with one argument, before a whole initial design fails without it."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        # Some functions of compiled modules say nothing of their arguments.
        return
    try:
        signature.bind({})
    except TypeError:
        raise InputError(
            f"{SIMULATOR_KEY}: {reference} must take one argument, a dictionary of the design's variables by name, got "
            f"the arguments {visible(str(signature))}."
        ) from None


@cache
def _loaded(
    reference: str, code: Path | None, source: str, folder: Path | None
) -> Callable[[dict[str, float]], object]:
    """The function, imported once per process and source digest."""
    function, digest = load_function(reference, code, SIMULATOR_KEY, folder)
    if source and digest != source:
        raise InputError(
            f"{SIMULATOR_KEY}: a worker process found different code from that at the start of the campaign, in the "
            f"module of {reference} or in one that it imports. Restore the files there, or stop and resume the "
            "campaign."
        )
    return function
