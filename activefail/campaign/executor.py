"""The executor seam: who runs the simulations of a batch."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor as Pool
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Protocol, Self

import numpy as np
from threadpoolctl import threadpool_limits

from activefail.campaign.simulator import Results, Simulator
from activefail.errors import SimulationError
from activefail.space import Array

_ROWS_A_CALL = 16
"""Most rows of one call: short calls show progress and leave little to wait for on an interrupt."""


class Executor(Protocol):
    """Runs simulations; the results come in the order of the designs, whoever computed them."""

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d); `progress` is called with the number of rows just done.

        Raises:
            SimulationError: if the workers cannot do it.
        """
        ...

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


class _PoolExecutor:
    """What the local executors share: a batch cut into calls, collected in order."""

    def __init__(self, pool: Pool, workers: int) -> None:
        self._pool = pool
        self._workers = workers

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        n = len(X)
        if n == 0:
            return Results(
                np.empty(0, dtype=np.int8),
                np.empty(0, dtype=np.int8),
                np.empty((0, len(simulator.margins))),
                np.empty(0),
            )
        rows = max(1, min(_ROWS_A_CALL, n // (4 * self._workers)))
        parts = []
        with self._cancelling():
            for part in self._pool.map(simulator.run, [X[first : first + rows] for first in range(0, n, rows)]):
                parts.append(part)
                if progress is not None:
                    progress(len(part))
        return Results.concatenate(parts)

    @contextmanager
    def _cancelling(self) -> Iterator[None]:
        try:
            yield
        except BrokenProcessPool:
            raise SimulationError(
                "A worker process died in the middle of a simulation (killed, or out of memory); "
                "its batch was not recorded."
            ) from None
        except BaseException:
            self._pool.shutdown(wait=False, cancel_futures=True)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._pool.shutdown(cancel_futures=True)


class ThreadExecutor(_PoolExecutor):
    """Threads of this process, for compiled simulators that release the interpreter's lock."""

    def __init__(self, workers: int) -> None:
        super().__init__(ThreadPoolExecutor(workers), workers)


class ProcessExecutor(_PoolExecutor):
    """Spawned processes, for simulators that hold the interpreter's lock; the simulator is pickled to them."""

    def __init__(self, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        super().__init__(ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker), workers)


def _begin_worker() -> None:
    # A terminal sends Ctrl-C to the whole process group; whether to stop is for the parent to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Side by side, workers must not each start a thread a core: not in libraries that are loaded, nor in later ones.
    threadpool_limits(1)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"


def local_executor(simulator: Simulator, workers: int | None = None) -> ThreadExecutor | ProcessExecutor:
    """The executor that suits a simulator on this machine; all cores when `workers` is None."""
    workers = workers or os.cpu_count() or 1
    return ThreadExecutor(workers) if simulator.releases_gil else ProcessExecutor(workers)
