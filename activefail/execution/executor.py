"""The executor seam: who runs the simulations of a batch, and what a simulation costs that goes wrong.

A simulation that raises, gives no usable answer, kills its worker or takes too long is one numerical failure with a
cause of its own; the others of its batch keep their answers. Where it ran in a worker process, the machine may be to
blame, or what earlier simulations did to the process: it is tried once more, in a fresh one, before it is given up.
"""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Lock
from typing import Protocol, Self

import numpy as np

from activefail.errors import ActivefailError, SimulationError, place_of
from activefail.execution.processes import Guards
from activefail.simulators.interface import (
    NUMERICAL_FAILURE,
    OUT_OF_MEMORY,
    RAISED,
    UNUSABLE_ANSWER,
    Results,
    Simulator,
    UnusableAnswerError,
    unanswered,
)
from activefail.space import Array
from activefail.visible import visible

_TOLD = 2000
"""Characters of a fault that a message repeats."""

_ROWS_A_CALL = 16
"""Most rows of one call: short calls show progress and leave little to wait for on an interrupt."""


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


class _LocalExecutor:
    """Threads of this process that each see to one simulation, or a few, at a time."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool = ThreadPoolExecutor(workers)
        self._come: SimpleQueue[tuple[int, Future[Results]]] = SimpleQueue()
        self._lock = Lock()
        self.first_fault = ""

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""
        n = len(X)
        if n == 0:
            return unanswered(simulator, 0)
        rows = self._rows(n)
        try:
            parts = [self._submitted(simulator, X[first : first + rows]) for first in range(0, n, rows)]
            for part in as_completed(parts):
                done = len(part.result())
                if progress is not None:
                    progress(done)
        except BaseException:
            self._stop()
            raise
        return Results.concatenate([part.result() for part in parts])

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Have a design, (d,), simulated (see Executor)."""
        future = self._submitted(simulator, x[None])
        future.add_done_callback(lambda done: self._come.put((ticket, done)))

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and answers that came (see Executor)."""
        answers = []
        try:
            with suppress(Empty):
                answers.append(self._come.get(timeout=seconds))
                while True:
                    answers.append(self._come.get_nowait())
            return [(ticket, future.result()) for ticket, future in answers]
        except BaseException:
            self._stop()
            raise

    def _submitted(self, simulator: Simulator, X: Array) -> Future[Results]:
        try:
            return self._pool.submit(self._see_to, simulator, X)
        except RuntimeError as error:  # the system starts no more threads
            raise SimulationError(f"A simulation cannot be started: {error}. Fewer --workers may do.") from None

    def _see_to(self, simulator: Simulator, X: Array) -> Results:
        results, fault = self._answer(simulator, X)
        if fault:
            with self._lock:
                self.first_fault = self.first_fault or as_told(fault)
        return results

    def _answer(self, simulator: Simulator, X: Array) -> tuple[Results, str]:
        raise NotImplementedError

    def _rows(self, n: int) -> int:
        """Of n designs, how many are handed to a thread at a time."""
        raise NotImplementedError

    def _stop(self) -> None:
        """Begin nothing any more, and wait for nothing."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._pool.shutdown(cancel_futures=True)


class ThreadExecutor(_LocalExecutor):
    """Threads that simulate, for compiled simulators that release the interpreter's lock."""

    def _answer(self, simulator: Simulator, X: Array) -> tuple[Results, str]:
        return answer(simulator, X)

    def __exit__(self, *exception: object) -> None:
        # A second Ctrl-C may have met one of the pool's own locks, so that a thread waits for ever: after an exception
        # nobody waits for it, and those that simulate end by themselves.
        self._pool.shutdown(wait=exception[0] is None, cancel_futures=True)

    def _rows(self, n: int) -> int:
        return max(1, min(_ROWS_A_CALL, n // (4 * self._workers)))


class ProcessExecutor(_LocalExecutor):
    """Spawned processes, for simulators that hold the interpreter's lock; the simulator is pickled to them.

    Each is handed one design at a time, so that what befalls it costs one simulation.

    Args:
        workers: side by side.
        time_limit: seconds that one simulation may take; for ever if None.
    """

    def __init__(self, workers: int, time_limit: float | None = None) -> None:
        super().__init__(workers)
        self._guards = Guards(answer, time_limit)

    def _answer(self, simulator: Simulator, X: Array) -> tuple[Results, str]:
        return self._guards.of_this_thread().answer(simulator, X)

    def _rows(self, n: int) -> int:
        return 1

    def _stop(self) -> None:
        super()._stop()
        self._guards.stop()

    def __exit__(self, *exception: object) -> None:
        self._guards.stop()
        super().__exit__(*exception)
        self._guards.close()


def local_executor(
    simulator: Simulator, workers: int | None = None, time_limit: float | None = None
) -> ThreadExecutor | ProcessExecutor:
    """The executor that suits a simulator on this machine; all cores when `workers` is None.

    Args:
        time_limit: seconds that one simulation may take; a compiled simulator bounds its own steps and needs none.
    """
    workers = workers or os.cpu_count() or 1
    return ThreadExecutor(workers) if simulator.releases_gil else ProcessExecutor(workers, time_limit)


def answer(simulator: Simulator, X: Array) -> tuple[Results, str]:
    """A simulator's answers to designs, (n, d), and what befell the first of them that has none; "" if all have.

    Raises:
        ActivefailError: if the simulator raised one, on purpose.
    """
    try:
        return _usable(simulator, X, simulator.run(X))
    except ActivefailError:
        raise
    except Exception as error:
        if len(X) == 1:
            return unanswered(simulator, 1, _cause(error)), _told(X[0], error)
    # One row at a time: one bad design must not cost those beside it.
    parts = [answer(simulator, X[row : row + 1]) for row in range(len(X))]
    return Results.concatenate([results for results, _ in parts]), next((fault for _, fault in parts if fault), "")


def _usable(simulator: Simulator, X: Array, results: Results) -> tuple[Results, str]:
    """Results as the record holds them; rows without an outcome that has a name are numerical failures."""
    n, k = len(X), len(simulator.margins)
    if not isinstance(results, Results):
        raise UnusableAnswerError(f"the simulator must return Results, got {type(results).__name__}")
    if results.margins.shape != (n, k):
        raise UnusableAnswerError(f"the margins must have shape {(n, k)}, got {results.margins.shape}")
    try:
        outcome, cause, margins, seconds = (
            np.asarray(column, dtype=np.float64)
            for column in (results.outcome, results.cause, results.margins, results.seconds)
        )
    except (TypeError, ValueError) as error:
        raise UnusableAnswerError(f"the answers must be numbers: {error}") from error
    # Comparisons with NaN are false, so that NaN is no outcome either.
    has_outcome = (outcome >= NUMERICAL_FAILURE) & (outcome < len(simulator.outcomes)) & (outcome % 1 == 0)
    has_cause = (cause >= 0) & (cause < len(simulator.causes)) & (cause % 1 == 0)
    timed = (seconds >= 0) & (seconds < np.inf)
    good = has_outcome & has_cause & timed
    fault = ""
    if not good.all():
        row = int(np.argmin(good))
        got = f"outcome {results.outcome[row]}, cause {results.cause[row]}, seconds {results.seconds[row]}"
        rule = (
            f"outcome in -1 to {len(simulator.outcomes) - 1}, cause in 0 to {len(simulator.causes) - 1}, seconds >= 0"
        )
        fault = f"design {X[row].tolist()}: the answer must have {rule}, got {got}"
    usable = Results(
        np.where(good, outcome, NUMERICAL_FAILURE).astype(np.int8),
        np.where(good, cause, UNUSABLE_ANSWER).astype(np.int8),
        # Bit for bit where it is float64 already.
        np.where(good[:, None], margins, np.nan),
        np.where(timed, seconds, 0.0),
    )
    return usable, fault


def as_told(fault: str) -> str:
    """A fault as messages show it: a simulator may say anything, at any length."""
    return visible(fault[:_TOLD])


def _cause(error: Exception) -> int:
    match error:
        case MemoryError():
            return OUT_OF_MEMORY
        case UnusableAnswerError():
            return UNUSABLE_ANSWER
        case _:
            return RAISED


def _told(design: Array, error: Exception) -> str:
    if isinstance(error, UnusableAnswerError):
        return f"design {design.tolist()}: {error}"
    return f"design {design.tolist()}: {type(error).__name__}: {error}{place_of(error)}"
