"""A pool of processes for the parts of a long computation, with a clean stop at any time."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from multiprocessing.connection import Connection
from typing import ParamSpec, Self, TypeVar

from activefail.errors import SimulationError
from activefail.execution.starting import begin_worker, starting_processes

P = ParamSpec("P")
T = TypeVar("T")


class ProcessPool:
    """Runs calls in parallel, in spawned processes; a context manager.

    It guarantees:

    - Ctrl-C reaches this process only, even while the others start.
    - The processes do not import modules from the current folder.
    - After `ask_to_stop`, `stopping()` is true in all of them, so that a call can end early.
    - The end of the block cancels waiting calls, except a few that the processes already hold. It waits for these and
      for running calls.
    - If an exception leaves the block, or this process dies, the others end at once.
    - If one of them dies, the block raises SimulationError.

    Args:
        processes: number of processes.
        kept: what is kept if a process dies; completes the error message.
    """

    def __init__(self, processes: int, kept: str) -> None:
        self._kept = kept
        context = multiprocessing.get_context("spawn")
        with ExitStack() as resources:
            # Two pipes whose other ends only this process holds: it signals by closing them, and so does its death.
            # Setting an Event would wait for every process, and a killed one never responds.
            end, self._life = context.Pipe(duplex=False)
            stop, self._patience = context.Pipe(duplex=False)
            for connection in (end, self._life, stop, self._patience):
                resources.enter_context(connection)
            with starting_processes():
                self._executor = ProcessPoolExecutor(processes, context, _begin, (end, stop))
            self._resources = resources.pop_all()

    def submit(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call a module-level function in one of the processes."""
        with starting_processes():  # the pool starts processes on demand
            call = self._executor.submit(function, *args, **kwargs)
            # The executor begins to watch a process that it has just started only when a result or another call
            # arrives. Until then the death of that process would go unnoticed.
            self._executor.submit(_nothing)
            return call

    def ask_to_stop(self) -> None:
        """Make `stopping()` true in all processes."""
        self._patience.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # Ctrl-C during the wait also closes the pipes, which ends the processes.
        with self._resources:
            if kind is not None:
                self._life.close()
            self._executor.shutdown(cancel_futures=True)
        if kind is not None and issubclass(kind, BrokenProcessPool):
            raise SimulationError(f"A worker process died (killed, or out of memory); {self._kept}.") from None


_stop: Connection | None = None
"""In a process of a pool: readable once the process is asked to stop. Such a process keeps data between calls only in a
module."""


def stopping() -> bool:
    """Whether this process belongs to a pool and was asked to stop."""
    return _stop is not None and _stop.poll()


def _nothing() -> None:
    """A call that does nothing."""


def _begin(end: Connection, stop: Connection) -> None:
    """Initialise a process of a pool."""
    global _stop
    _stop = stop
    begin_worker()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def wait() -> None:
        end.poll(None)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
