"""An executor on an existing Dask cluster: simulations on any number of machines."""

import logging
import platform
from asyncio import CancelledError
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Self

from activefail.errors import ActivefailError, InputError, SimulationError
from activefail.execution.answering import answer, shown_fault
from activefail.execution.processes import Guards
from activefail.simulators.interface import WORKER_DIED, Results, Simulator, unanswered
from activefail.space import Array

if TYPE_CHECKING:
    from distributed import Future

    _Answer = tuple[Results, str] | BaseException
    _Came = SimpleQueue[tuple[int, str, _Answer]]

Versions = Callable[[], Mapping[str, str]]
_Told = tuple[tuple[str, str], ...]

_CONNECT = 10.0
"""Seconds in which a scheduler must answer."""

_LOOK = 0.5
"""Seconds between two looks at whether the scheduler is still there."""


class DaskExecutor:
    """Simulates on the workers of a Dask scheduler, which need the same activefail and libraries.

    A compiled simulator runs in the threads of a worker. Any other runs in a process of its own beside the worker's
    thread, as it does on this machine, so that one that dies or hangs costs one simulation and not the worker. A design
    whose worker is lost is given to another one by Dask, and given up where it has cost several.

    Args:
        scheduler: its address, like "tcp://head:8786".
        time_limit: seconds that one simulation may take; for ever if None.
        tell: is given a line for the user where simulations wait for workers, of which there are none.
        versions: a function of a module that tells what simulations depend on, by name; a worker on which it tells
            something else than here is refused. None: no worker is asked.

    Raises:
        InputError: if Dask is not installed, or no scheduler answers there.
    """

    def __init__(
        self,
        scheduler: str,
        time_limit: float | None = None,
        tell: Callable[[str], None] = lambda _: None,
        versions: Versions | None = None,
    ) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(
                "--executor dask: needs the package distributed; install it with `pip install 'activefail[cluster]'`."
            ) from None
        # Its own accounts of a lost connection, tracebacks among them: what matters of them is told by what is raised.
        for name in logging.root.manager.loggerDict:
            if name.split(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        # Kept though its making fails: it would close itself as Python ends, wait in vain and leave a traceback.
        self._client = Client.__new__(Client)
        try:
            self._client.__init__(scheduler, timeout=_CONNECT, set_as_default=False, name="activefail")
        # Whatever: what answers may be no scheduler at all, and its bytes are taken for sizes of arrays.
        except Exception as error:
            with suppress(Exception):
                self._client.close(timeout=_LOOK)
            raise InputError(f"--scheduler: no Dask scheduler answers at {scheduler!r}: {error}.") from None
        self._scheduler = scheduler
        self._time_limit = time_limit
        self._tell = tell
        self._expected = None if versions is None else (versions, tuple(sorted(versions().items())))
        self._waits_for_workers = False
        self._came: _Came = SimpleQueue()
        self._out: dict[str, tuple[Future, Simulator, Array]] = {}
        self.first_fault = ""

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""
        if len(X) == 0:
            return unanswered(simulator, 0)
        # Not among the answers to single designs, which may be in flight: a rule about the error is looked at then.
        came: _Came = SimpleQueue()
        answers: dict[int, Results] = {}
        for row, x in enumerate(X):
            self._submit(simulator, row, x, came)
        while len(answers) < len(X):
            for row, results in self._heard(came, _LOOK):
                answers[row] = results
                if progress is not None:
                    progress(1)
        return Results.concatenate([answers[row] for row in range(len(X))])

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Have a design, (d,), simulated (see AsynchronousExecutor)."""
        self._submit(simulator, ticket, x, self._came)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and answers that came (see AsynchronousExecutor).

        Raises:
            SimulationError: if the scheduler is lost, or the workers cannot do it at all.
        """
        return self._heard(self._came, seconds)

    def _submit(self, simulator: Simulator, ticket: int, x: Array, came: "_Came") -> None:
        future = self._client.submit(_answer_there, simulator, x[None], self._time_limit, self._expected, pure=False)
        self._out[future.key] = future, simulator, x

        async def hear() -> None:
            answer: _Answer
            try:
                answer = await future
            except (Exception, CancelledError) as error:
                answer = error
            came.put((ticket, future.key, answer))

        # Among what the client does beside us: a worker may die with its answer before that is read, and the wait for
        # another one's must keep nobody from seeing that the scheduler is lost, or from stopping.
        self._client.loop.add_callback(hear)

    def _heard(self, queue: "_Came", seconds: float) -> list[tuple[int, Results]]:
        came = []
        with suppress(Empty):
            came.append(queue.get(timeout=seconds))
            while True:
                came.append(queue.get_nowait())
        # Not those of status "lost", whose answers died with their workers: Dask has them computed anew.
        forgotten = any(future.status == "cancelled" for future, _, _ in self._out.values())
        if forgotten or self._client.status not in ("running", "connecting"):
            raise self._lost()
        if came:
            # There were workers: should none be left, that is news again.
            self._waits_for_workers = False
        else:
            self._look_for_workers()
        return [(ticket, self._result(key, answer)) for ticket, key, answer in came]

    def _look_for_workers(self) -> None:
        """Tell once that simulations wait for workers, whenever there are none."""
        waited = self._waits_for_workers
        with suppress(OSError):  # a scheduler that was lost is seen at the next look, one that hangs asked once more
            workers = self._client.sync(self._client.scheduler.ncores, callback_timeout=_LOOK)
            self._waits_for_workers = len(self._out) > 0 and not workers
        if self._waits_for_workers and not waited:
            self._tell(f"waiting for workers at {self._scheduler}")

    def _lost(self) -> SimulationError:
        return SimulationError(
            f"The Dask scheduler at {self._scheduler} was lost, or has forgotten what it was asked for. "
            f"What was recorded is safe; go on once it is there again."
        )

    def _result(self, key: str, answer: "_Answer") -> Results:
        from distributed import KilledWorker

        future, simulator, x = self._out.pop(key)
        match answer:
            case KilledWorker():
                results = unanswered(simulator, 1, WORKER_DIED)
                fault = f"design {x.tolist()}: the workers that had it were lost: {answer}"
            case ActivefailError():
                raise answer
            case OSError() | CancelledError() if future.status != "error":
                # Not the simulation's, which was done, but of the connection by which its answer was to come.
                raise self._lost() from answer
            case BaseException():
                # A worker without activefail or with another version of it.
                raise SimulationError(
                    f"The Dask cluster at {self._scheduler} could not answer design {x.tolist()}: "
                    f"{type(answer).__name__}: {' '.join(str(answer).split())} "
                    f"The workers need the same activefail, Python and Dask."
                ) from answer
            case _:
                results, fault = answer
        self.first_fault = self.first_fault or shown_fault(fault)
        return results

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        # What is running there goes on to its end or its time limit; nobody hears of it.
        self._client.cancel([future for future, _, _ in self._out.values()], force=True)
        self._client.close(timeout=_CONNECT)


@cache
def _check_versions(versions: Versions, expected: _Told) -> None:
    """Check, once on each worker, that simulations depend there on what they depend on where they are asked for.

    Raises:
        SimulationError: naming what differs.
    """
    there = versions()
    differs = [
        f"{name} {there.get(name, 'missing')} there, {here} here" for name, here in expected if there.get(name) != here
    ]
    if differs:
        raise SimulationError(
            f"A worker on {platform.node()} differs from this machine: {'; '.join(differs)}. Its answers would be "
            f"others; nothing of it was recorded. Give the cluster's workers the versions of this machine, or run "
            f"activefail with theirs."
        )


@cache
def _guards(time_limit: float | None) -> Guards:
    """Of a worker: a process beside each of its threads."""
    return Guards(answer, time_limit)


def _answer_there(
    simulator: Simulator, X: Array, time_limit: float | None, expected: tuple[Versions, _Told] | None
) -> tuple[Results, str]:
    """What a worker does for a design, (1, d).

    Raises:
        SimulationError: if the worker is another than expected.
    """
    if expected is not None:
        _check_versions(*expected)
    if simulator.releases_gil:
        return answer(simulator, X)
    return _guards(time_limit).of_this_thread().answer(simulator, X)
