"""Executors on this machine, and the number of workers: threads for compiled simulators, processes for all others."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Self

from activefail.errors import SimulationError
from activefail.execution.answering import answer, finished
from activefail.execution.processes import Guards
from activefail.simulators.interface import Results, Simulator, unanswered
from activefail.space import Array

_WAIT = 0.5
"""Longest wait for a result before pending signals are handled [s]."""

_ROWS_A_CALL = 16
"""Most rows per call: short calls show progress and shorten the wait after an interrupt."""


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
        self._workers, self._answer, self._rows_a_call = workers, answer, rows_a_call
        self._pool = ThreadPoolExecutor(workers)
        self._done: SimpleQueue[tuple[int, Future[Results]]] = SimpleQueue()

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""
        n = len(X)
        if n == 0:
            return unanswered(simulator, 0)
        rows = max(1, min(self._rows_a_call, n // (4 * self._workers)))
        try:
            parts = [self._submit(simulator, X[first : first + rows]) for first in range(0, n, rows)]
            for part in _as_completed(parts):
                done = len(part.result())
                if progress is not None:
                    progress(done)
        except BaseException:
            self._stop()
            raise
        return Results.concatenate([part.result() for part in parts])

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Queue a design, (d,), for simulation (see AsynchronousExecutor)."""
        future = self._submit(simulator, x[None])
        future.add_done_callback(lambda done: self._done.put((ticket, done)))

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and results that arrived (see AsynchronousExecutor)."""
        answers = []
        try:
            with suppress(Empty):
                answers.append(self._done.get(timeout=seconds))
                while True:
                    answers.append(self._done.get_nowait())
            return [(ticket, future.result()) for ticket, future in answers]
        except BaseException:
            self._stop()
            raise

    def _submit(self, simulator: Simulator, X: Array) -> Future[Results]:
        try:
            return self._pool.submit(self._simulate, simulator, X)
        except RuntimeError as error:  # the system refuses another thread
            raise SimulationError(f"A simulation cannot be started: {error}. Try fewer --workers.") from None

    def _simulate(self, simulator: Simulator, X: Array) -> Results:
        return finished(simulator, self._answer(simulator, X))

    def _stop(self) -> None:
        """Cancel pending simulations, without waiting."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        # A second Ctrl-C may leave one of the pool's locks held, so that a thread never ends. After an exception the
        # threads are therefore not awaited; those that simulate end by themselves.
        self._pool.shutdown(wait=exception[0] is None, cancel_futures=True)


def _as_completed(futures: Sequence[Future[Results]]) -> Iterator[Future[Results]]:
    """The futures in the order in which they complete.

    A wait without a timeout can miss a Ctrl-C that arrives just before it: Python handles it when the wait ends.
    """
    completed: SimpleQueue[Future[Results]] = SimpleQueue()
    for future in futures:
        future.add_done_callback(completed.put)
    for _ in futures:
        yield _first(completed)


def _first(completed: "SimpleQueue[Future[Results]]") -> "Future[Results]":
    while True:
        with suppress(Empty):
            return completed.get(timeout=_WAIT)


class ProcessExecutor:
    """Spawned processes, for simulators that hold the interpreter's lock; the simulator is pickled to them.

    Each gets one design at a time, so that its death fails one simulation only. A thread waits for each process.

    Args:
        workers: number of processes.
        time_limit: most seconds per simulation; None means no limit.
    """

    def __init__(self, workers: int, time_limit: float | None = None) -> None:
        self._guards = Guards(answer, time_limit)
        self._threads = ThreadExecutor(workers, self._answer, rows_a_call=1)

    def _answer(self, simulator: Simulator, X: Array) -> Results:
        return self._guards.of_this_thread().answer(simulator, X)

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""
        with self._stopping_after_errors():
            return self._threads.run(simulator, X, progress)

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Queue a design, (d,), for simulation (see AsynchronousExecutor)."""
        self._threads.start(simulator, ticket, x)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and results that arrived (see AsynchronousExecutor)."""
        with self._stopping_after_errors():
            return self._threads.answered(seconds)

    @contextmanager
    def _stopping_after_errors(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._guards.stop()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._guards.stop()
        # Nothing keeps the threads waiting any more, whatever ended the context.
        self._threads.__exit__(None, None, None)
        self._guards.close()


def local_executor(
    simulator: Simulator, workers: int | None = None, time_limit: float | None = None
) -> ThreadExecutor | ProcessExecutor:
    """The executor for a simulator on this machine; `workers=None` uses all cores.

    Args:
        time_limit: most seconds per simulation; a compiled simulator limits its own steps and ignores it.
    """
    workers = workers or os.cpu_count() or 1
    return ThreadExecutor(workers) if simulator.releases_gil else ProcessExecutor(workers, time_limit)
