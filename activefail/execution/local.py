"""Executors on this machine, and the number of workers: threads for compiled simulators, processes for all others."""

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Self, TypeVar

from activefail.errors import SimulationError
from activefail.execution.answering import answer, finished
from activefail.execution.executor import Arrived
from activefail.execution.guards import Guards
from activefail.simulators.interface import Results, Simulator, unanswered
from activefail.space.space import Array

_WAIT = 0.5
"""Longest wait for a result before pending signals are handled [s]."""

_ROWS_A_CALL = 16
"""Most rows per call: short calls show progress and shorten the wait after an interrupt."""

T = TypeVar("T")


def taken(queue: "SimpleQueue[T]", seconds: float, most: float = math.inf) -> list[T]:
    """What a queue holds, in order, at most so many items; waits up to `seconds` for the first one.

    A wait without a limit could miss a Ctrl-C that arrives just before it: Python handles it when the wait ends.
    """
    items = []
    with suppress(Empty):
        items.append(queue.get(timeout=seconds))
        while len(items) < most:
            items.append(queue.get_nowait())
    return items


_Done = SimpleQueue[tuple[int, Future[Results]]]


class ThreadExecutor:
    """Threads, for compiled simulators that release the interpreter's lock.

    Args:
        workers: number of threads.
        answer: simulates designs, (n, d), in a thread.
        rows_a_call: most designs that a thread gets at a time.
    """

    def __init__(
        self,
        workers: int,
        answer: Callable[[Simulator, Array], Results] = answer,
        rows_a_call: int = _ROWS_A_CALL,
    ) -> None:
        self.workers, self._answer, self._rows_a_call = workers, answer, rows_a_call
        self._pool = ThreadPoolExecutor(workers)
        self._done: _Done = SimpleQueue()

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""
        n = len(X)
        if n == 0:
            return unanswered(simulator, 0)
        rows = max(1, min(self._rows_a_call, n // (4 * self.workers)))
        firsts = range(0, n, rows)
        done: _Done = SimpleQueue()
        parts: dict[int, Results] = {}
        with self._stopping_after_errors():
            for first in firsts:
                self._submit(simulator, first, X[first : first + rows], done)
            while len(parts) < len(firsts):
                for first, part in taken(done, _WAIT):
                    parts[first] = part.result()
                    if arrived is not None:
                        arrived(first, parts[first])
        return Results.concatenate([parts[first] for first in firsts])

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Queue a design, (d,), for simulation (see AsynchronousExecutor)."""
        self._submit(simulator, ticket, x[None], self._done)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and results that arrived (see AsynchronousExecutor)."""
        # One worker answers in order. One by one, what is learned from its results does not depend on its speed.
        most = 1 if self.workers == 1 else math.inf
        with self._stopping_after_errors():
            return [(ticket, future.result()) for ticket, future in taken(self._done, seconds, most)]

    def _submit(self, simulator: Simulator, ticket: int, X: Array, done: _Done) -> None:
        try:
            future = self._pool.submit(self._simulate, simulator, X)
        except RuntimeError as error:  # the system refuses another thread
            raise SimulationError(f"A simulation cannot be started: {error}. Try fewer --workers.") from None
        future.add_done_callback(lambda future: done.put((ticket, future)))

    def _simulate(self, simulator: Simulator, X: Array) -> Results:
        return finished(simulator, self._answer(simulator, X))

    @contextmanager
    def _stopping_after_errors(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._stop()
            raise

    def _stop(self) -> None:
        """Cancel pending simulations, without waiting."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        # A second Ctrl-C may leave one of the pool's locks held, so that a thread never ends. After an exception the
        # threads are therefore not awaited; those that simulate end by themselves.
        self._pool.shutdown(wait=exception[0] is None, cancel_futures=True)


class ProcessExecutor(ThreadExecutor):
    """Spawned processes, for simulators that hold the interpreter's lock; the simulator is pickled to them.

    Each gets one design at a time, so that its death fails one simulation only. A thread waits for each process.

    Args:
        workers: number of processes.
        time_limit: most seconds per simulation; None means no limit.
    """

    def __init__(self, workers: int, time_limit: float | None = None) -> None:
        self._guards = Guards(time_limit)
        super().__init__(workers, self._guards.answer, rows_a_call=1)

    def _stop(self) -> None:
        super()._stop()
        self._guards.stop()

    def __exit__(self, *exception: object) -> None:
        self._guards.stop()
        # Nothing keeps the threads waiting any more, whatever ended the context.
        super().__exit__(None, None, None)
        self._guards.close()


def local_executor(simulator: Simulator, workers: int | None = None, time_limit: float | None = None) -> ThreadExecutor:
    """The executor for a simulator on this machine; `workers=None` uses all cores, for as many as each needs.

    Args:
        time_limit: most seconds per simulation; a compiled simulator limits its own steps and ignores it.
    """
    workers = workers or max(1, (os.cpu_count() or 1) // getattr(simulator, "cores", 1))
    return ThreadExecutor(workers) if simulator.releases_gil else ProcessExecutor(workers, time_limit)
