"""A pool of processes for the parts of a long computation, with a clean stop at any time."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, ParamSpec, Self, TypeVar

from activefail.errors import SimulationError
from activefail.execution.processes import LostError, Worker

P = ParamSpec("P")
T = TypeVar("T")


class ProcessPool:
    """Runs calls in parallel, in worker processes; a context manager.

    It guarantees:

    - Ctrl-C reaches this process only.
    - After `ask_to_stop`, `worker.stopping()` is true in all of them, so that a call can end early.
    - The end of the block cancels waiting calls, and waits for running ones.
    - If an exception leaves the block, or this process dies, the others end at once.
    - If one of them dies, all calls raise SimulationError.

    Args:
        processes: number of processes.
        kept: what is kept if a process dies; completes the error message.
    """

    def __init__(self, processes: int, kept: str) -> None:
        self._kept = kept
        self._workers = [Worker() for _ in range(processes)]
        self._idle: SimpleQueue[Worker] = SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(processes)

    def submit(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call a module-level function in one of the processes."""
        return self._threads.submit(self._call, function, *args, **kwargs)

    def _call(self, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        worker = self._idle.get()
        try:
            return worker.ask(None, function, *args, **kwargs)
        except LostError:
            self._kill()
            raise SimulationError(f"A worker process died (killed, or out of memory); {self._kept}.") from None
        finally:
            self._idle.put(worker)

    def ask_to_stop(self) -> None:
        """Make `stopping()` true in all processes."""
        for worker in self._workers:
            worker.ask_to_stop()

    def _kill(self) -> None:
        for worker in self._workers:
            worker.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is not None:
                self._kill()
            self._threads.shutdown(cancel_futures=True)
        finally:  # Ctrl-C during the wait ends the processes too
            for worker in self._workers:
                worker.close()
