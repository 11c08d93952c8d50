"""Simulations that activefail does not run itself."""

from dataclasses import dataclass

from activefail.errors import InputError
from activefail.simulators.interface import Results
from activefail.space.space import Array


@dataclass(frozen=True)
class ElsewhereSimulator:
    """The outcomes and margins of simulations that are made elsewhere: by hand, in a batch queue, in a laboratory.

    Attributes:
        outcomes, margins, causes: the names that a result may contain; the first cause is none.
    """

    outcomes: tuple[str, ...]
    margins: tuple[str, ...]
    failing: tuple[int, ...] = ()
    impossible: tuple[int, ...] = ()
    causes: tuple[str, ...] = ("",)

    releases_gil = True

    def run(self, X: Array) -> Results:
        """Refuse: there is nothing to call.

        Raises:
            InputError: always.
        """
        raise InputError("simulator.elsewhere: activefail does not run these simulations.")
