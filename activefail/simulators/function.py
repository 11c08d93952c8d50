"""Custom simulators that are functions of Python."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from activefail.errors import ActivefailError, InputError, description_of
from activefail.simulators.answers import designs_by_name, read_answer
from activefail.simulators.code_folder import import_from
from activefail.simulators.interface import Results
from activefail.simulators.user_code import SIMULATOR_KEY, load_function
from activefail.space import Array, DesignSpace


@dataclass(frozen=True)
class PythonSimulator:
    """A function that answers one design, and runs in processes of its own.

    It is given a dictionary with the values of the variables and the fixed quantities, and returns the name of the
    outcome, or a dictionary with "outcome" and, where there are any, "margins", a dictionary of numbers. What it raises
    costs that simulation alone.

    Attributes:
        space: of the designs.
        reference: of the function, "module:function".
        code: folder of its module and of those that it imports; None if it may not be run.
        outcomes, margins: what it may answer.
        source: digest that its module must have, also on another machine; "" if any will do (see `load_function`).
        folder: of the run, in which no code is looked for.
        renew: simulations that one process may run; any number if None.
    """

    space: DesignSpace
    reference: str
    code: Path | None
    outcomes: tuple[str, ...]
    margins: tuple[str, ...]
    source: str = ""
    folder: Path | None = None
    renew: int | None = None

    causes = ("",)
    releases_gil = False

    def load(self) -> str:
        """The digest of the source of the function's module, once it is imported.

        Raises:
            InputError: if there is no such function, or it may not be run.
        """
        return load_function(self.reference, self.code, SIMULATOR_KEY, self.folder)[1]

    def prepare(self) -> None:
        """Import the function's module, which is no part of a simulation's time.

        Raises:
            InputError: as `load` does.
        """
        _loaded(self.reference, self.code, self.source, self.folder)
        if self.code is not None:
            # For what it imports as it runs: another simulator may have been prepared since it was loaded.
            import_from(self.code, {})

    def run(self, X: Array) -> Results:
        """Answer designs, (n, d), one after the other.

        Raises:
            InputError: as `load` does.
            UnusableAnswerError: if what it returns is no answer.
        """
        function = _loaded(self.reference, self.code, self.source, self.folder)
        answers = []
        for design in designs_by_name(self.space, X):
            began = time.perf_counter()
            try:
                said = function(design)
            except ActivefailError as error:
                # Raised in the user's code, it is no error of ours and costs this simulation alone.
                raise RuntimeError(description_of(error)).with_traceback(error.__traceback__) from None
            answers.append(read_answer(said, self.outcomes, self.margins, time.perf_counter() - began))
        return Results.concatenate(answers)


@cache
def _loaded(
    reference: str, code: Path | None, source: str, folder: Path | None
) -> Callable[[dict[str, float]], object]:
    """The function, imported once in a process for each source that it has had."""
    function, found = load_function(reference, code, SIMULATOR_KEY, folder)
    if source and found != source:
        raise InputError(
            f"{SIMULATOR_KEY}: the module of {reference}, or one that it imports from its folder, is another one here "
            f"than where the campaign was started."
        )
    return function
