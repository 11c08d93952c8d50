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
    """Runs the simulations of a batch; a context manager that ends its workers.

    **Order.** Row i of the results answers row i of the designs, whoever computed it and in whatever order the answers
    came. The results are the simulator's own, bit for bit, but for `seconds`.

    **What fails.** A simulation that raises, returns nothing usable, kills its worker, or exceeds its time limit is one
    numerical failure: outcome NUMERICAL_FAILURE, a cause of EXECUTION_CAUSES, margins NaN. The other simulations of the
    batch keep their answers, and the executor goes on. An ActivefailError of the simulator is no numerical failure: it
    reaches the caller.

    **Threads and processes.** One thread calls an executor, the one that leads the campaign. Where
    `simulator.releases_gil`, `Simulator.run` is called in threads, several at a time. Otherwise the simulator is
    pickled to worker processes, and each is given one design at a time; a failure in a process that has simulated
    before is tried once more in a fresh one.

    **Arrays.** The designs stay the caller's, who leaves them unchanged until they are answered. The results are the
    caller's.

    **Exceptions.** After an exception the caller leaves the context and uses the executor no more.

    **The end.** Leaving the context cancels what has not begun, and ends the worker processes that the executor has
    started on this machine. What is running in threads is waited for, unless an exception has ended the context. On a
    cluster it runs to its end or its time limit, and its result is discarded.
    """

    @property
    def first_fault(self) -> str:
        """Why the first simulation that was abandoned here failed, with its design; empty if none was."""
        ...

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs; may be called again, with another simulator too.

        Args:
            simulator: that answers.
            X: (n, d), n >= 0. No design needs no worker.
            progress: called in the caller's thread with the number of rows just done, in sum n. What it raises reaches
                the caller.

        Returns:
            Results of the n designs, in their order.

        Raises:
            SimulationError: if the workers cannot do it at all: they cannot load the simulator, or cannot be started or
                reached.
            ActivefailError: what the simulator raised on purpose.
        """
        ...

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


class AsynchronousExecutor(Executor, Protocol):
    """An executor that also runs single simulations, as they are asked for.

    `run` may be called while single simulations are running. It neither waits for them nor takes their answers.
    """

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Have a design, (d,), simulated as soon as a worker is free, in the order of these calls; returns at once.

        Args:
            simulator: that answers.
            ticket: by which the answer is known; the caller gives no ticket twice.
            x: the design, which the caller leaves unchanged until it is answered.

        Raises:
            SimulationError: if it cannot be started.
        """
        ...

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and answers, of one design each, that came since the last call, in the order of their arrival.

        Each ticket comes once. Waits up to so many seconds for the first answer, and returns an empty list where none
        came.

        Raises:
            SimulationError, ActivefailError: as `run` does.
        """
        ...
