"""The executor interface: what runs the simulations of a batch, and how failures are contained.

A simulation that raises, returns an unusable answer, kills its worker or exceeds its time limit is one numerical
failure with a cause; the other simulations of the batch keep their results. If it ran in a worker process, the machine
or earlier simulations in that process may be at fault, so it is repeated once in a fresh process.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from activefail.simulators.interface import NUMERICAL_FAILURE, Results, Simulator
from activefail.space.space import Array
from activefail.text.progress import Begin

Arrived = Callable[[int, Results], None]
"""Called with the results of consecutive rows as soon as they are there: the first of these rows, and their results."""


class Executor(Protocol):
    """Runs the simulations of a batch; a context manager that ends its workers.

    **Order.** Row i of the results belongs to row i of the designs, whichever worker computed it and whenever it
    arrived. The results are the simulator's, bit for bit, except for `seconds`.

    **Failures.** A simulation that raises, returns an unusable answer, kills its worker, or exceeds its time limit is
    one numerical failure: outcome NUMERICAL_FAILURE, a cause of EXECUTION_CAUSES, margins NaN. Its row of `faults` says
    why, in visible characters and cut to a readable length. The other simulations of the batch keep their results, and
    the executor continues; it keeps nothing of a failure. An ActivefailError of the simulator is not a numerical
    failure: it reaches the caller.

    **Threads and processes.** Only the campaign's main thread calls an executor. If `simulator.releases_gil` is true,
    `Simulator.run` is called in several threads at a time. Otherwise the simulator is pickled to worker processes, and
    each gets one design at a time; a failure in a process that has simulated before is repeated once in a fresh one.

    **Arrays.** The caller owns the designs and leaves them unchanged until their results are returned. The caller owns
    the results.

    **Exceptions.** After an exception the caller leaves the context and does not use the executor again.

    **Exit.** Leaving the context cancels simulations that have not begun, and ends the worker processes that the
    executor started on this machine. Simulations in threads are awaited, unless an exception ended the context. On a
    cluster they run to their end or time limit, and their results are discarded.
    """

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        """Simulate designs; may be called again, with another simulator too.

        Args:
            simulator: the simulator to run.
            X: (n, d), n >= 0. Without designs no worker is needed.
            arrived: called in the caller's thread with newly completed rows, n in total. Its exceptions reach the
                caller.

        Returns:
            Results of the n designs, in their order.

        Raises:
            SimulationError: if the workers cannot load the simulator, or cannot be started or reached.
            ActivefailError: if the simulator raised one.
        """
        ...

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


class AsynchronousExecutor(Executor, Protocol):
    """An executor that also runs single simulations in the background.

    `run` may be called while single simulations are running. It neither waits for them nor takes their results.
    """

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Queue a design, (d,), for simulation, first in, first out; returns at once.

        Args:
            simulator: the simulator to run.
            ticket: identifies the result; the caller uses each ticket once.
            x: the design, which the caller leaves unchanged until its result is returned.

        Raises:
            SimulationError: if it cannot be started.
        """
        ...

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and results, one design each, that arrived since the last call, in order of arrival.

        Each ticket is returned once; with one worker on this machine, one in a call. Waits up to `seconds` for the
        first result; the list is empty if none arrives.

        Raises:
            SimulationError, ActivefailError: as `run` does.
        """
        ...


@dataclass(frozen=True)
class CountingExecutor:
    """An executor that tells how many designs it has simulated.

    Attributes:
        executor: simulates.
        counting: entered for the designs of a call; gives what `progress_bar` does.
    """

    executor: Executor
    counting: Callable[[], AbstractContextManager[Begin]]

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        """As `Executor.run`."""
        with self.counting() as begin:
            count = begin(len(X))

            def advance(row: int, results: Results) -> None:
                count(len(results))
                if arrived is not None:
                    arrived(row, results)

            return self.executor.run(simulator, X, advance)

    @property
    def workers(self) -> int:
        """How many designs it simulates at a time; 1 if that is unknown."""
        return getattr(self.executor, "workers", 1)

    def __enter__(self) -> Self:
        self.executor.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self.executor.__exit__(*exception)


def run_keeping(
    executor: Executor,
    simulator: Simulator,
    X: Array,
    keep: Callable[[Array, Results], object],
    progress: Callable[[int], None] = lambda _: None,
) -> Results:
    """As `Executor.run`; what has an outcome when an exception ends it, such as Ctrl-C, is kept.

    Args:
        executor, simulator, X: as for `Executor.run`.
        keep: called with the designs and results that are kept. Failures are not: they may be the interruption's.
        progress: called with the number of newly completed rows.
    """
    parts: dict[int, Results] = {}

    def arrived(row: int, results: Results) -> None:
        parts[row] = results
        progress(len(results))

    try:
        return executor.run(simulator, X, arrived)
    except BaseException:
        if parts:
            rows, results = sorted(parts), Results.concatenate([parts[row] for row in sorted(parts)])
            there = np.concatenate([X[row : row + len(parts[row])] for row in rows])
            has_outcome = results.outcome != NUMERICAL_FAILURE
            keep(there[has_outcome], results[has_outcome])
        raise
