"""The executor seam: who runs the simulations of a batch, and what a simulation costs that goes wrong.

A simulation that raises, gives no usable answer, kills its worker or takes too long is one numerical failure with a
cause of its own; the others of its batch keep their answers. Where it ran in a worker process, the machine may be to
blame, or what earlier simulations did to the process: it is tried once more, in a fresh one, before it is given up.
"""

from collections.abc import Callable
from typing import Protocol, Self

from activefail.simulators.interface import (
    Results,
    Simulator,
)
from activefail.space import Array


class Executor(Protocol):
    """Runs the simulations of a batch."""

    @property
    def first_fault(self) -> str:
        """Why the first simulation that was abandoned here failed, with its design; empty if none was."""
        ...

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d); `progress` is called with the number of rows just done.

        The results come in the order of the designs, whoever computed them. A simulation that raises, gives no usable
        answer, or costs its worker is a numerical failure with a cause.

        Raises:
            SimulationError: if the workers cannot do it at all; they are not asked again then.
        """
        ...

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


class AsynchronousExecutor(Executor, Protocol):
    """Runs simulations one after the other as they are asked for, too."""

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Have a design, (d,), simulated as soon as a worker is free, in the order of these calls."""
        ...

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and answers, of one design each, that came since this was asked last, in the order of their coming.

        Waits up to so many seconds for a first one.

        Raises:
            SimulationError: as `run` does.
        """
        ...
