"""A pool of processes for the parts of a long computation, which can be stopped at any time."""

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
    """Computes calls in spawned processes, side by side; a context manager.

    What its users may rely on:

    - A Ctrl-C reaches this process alone, also while the others start.
    - The processes find no modules in the current folder.
    - After `ask_to_stop`, `stopping()` is true in all of them: a call that asks may end early.
    - At the end of the block, calls that wait are cancelled, but for a few that the processes have been given already.
      The block waits for these and for what is being computed.
    - If an exception leaves the block, or this process dies, the others end at once, whatever they do.
    - If one of them dies, the block raises SimulationError.

    Args:
        processes: side by side.
        kept: what is kept if one of them dies; completes the message of the error.
    """

    def __init__(self, processes: int, kept: str) -> None:
        self._kept = kept
        context = multiprocessing.get_context("spawn")
        with ExitStack() as resources:
            # Two pipes whose other ends this process alone has: it tells by closing them, and so does its death.
            # An event would wait for all whom it tells: a process that was killed never hears it.
            end, self._life = context.Pipe(duplex=False)
            stop, self._patience = context.Pipe(duplex=False)
            for connection in (end, self._life, stop, self._patience):
                resources.enter_context(connection)
            with starting_processes():
                self._executor = ProcessPoolExecutor(processes, context, _begin, (end, stop))
            self._resources = resources.pop_all()

    def submit(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Have a function of a module called in one of the processes."""
        with starting_processes():  # they start when there is work
            return self._executor.submit(function, *args, **kwargs)

    def ask_to_stop(self) -> None:
        """Make `stopping()` true in all processes."""
        self._patience.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # A Ctrl-C while the processes are waited for ends them, too: it closes the pipes.
        with self._resources:
            if kind is not None:
                self._life.close()
            self._executor.shutdown(cancel_futures=True)
        if kind is not None and issubclass(kind, BrokenProcessPool):
            raise SimulationError(f"A worker process died (killed, or out of memory); {self._kept}.") from None


_stop: Connection | None = None
"""In a process of a pool: at its end once the process is asked to stop."""


def stopping() -> bool:
    """Whether this process belongs to a pool and was asked to stop."""
    return _stop is not None and _stop.poll()


def _begin(end: Connection, stop: Connection) -> None:
    """What a process of a pool does first."""
    global _stop
    _stop = stop
    begin_worker()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def wait() -> None:
        end.poll(None)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
