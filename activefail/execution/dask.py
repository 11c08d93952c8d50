"""An executor on an existing Dask cluster; simulations whose workers were lost are submitted three times in all."""

import logging
import platform
import secrets
from asyncio import CancelledError
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from queue import SimpleQueue
from typing import TYPE_CHECKING, NamedTuple, Self

from activefail.errors import ActivefailError, InputError, SimulationError
from activefail.execution.answering import answer, finished
from activefail.execution.executor import Arrived
from activefail.execution.guards import Guards
from activefail.execution.local import taken
from activefail.simulators.interface import WORKER_DIED, Results, Simulator, design_in_words, unanswered
from activefail.space.space import Array

if TYPE_CHECKING:
    from distributed import Future

    _Answer = Results | BaseException
    _Arrivals = SimpleQueue[tuple[int, str, _Answer]]

Versions = Callable[[], Mapping[str, str]]
_Expected = tuple[tuple[str, str], ...]

_CONNECT = 10.0
"""Seconds in which a scheduler must answer."""

_TRIES = 3
"""How often Dask is given a simulation, each time until it has lost as many workers as it allows (3 by default)."""

_LOOK = 0.5
"""Seconds between checks that the scheduler is reachable."""


class _Flight(NamedTuple):
    """A simulation that Dask was given, for the so many-th time."""

    future: "Future"
    simulator: Simulator
    x: Array
    tries: int


class DaskExecutor:
    """Simulates on the workers of a Dask scheduler, which need the same activefail and libraries.

    A compiled simulator runs in the threads of a worker. Any other simulator runs in a separate process for each worker
    thread, as on this machine, so that a crash or a hang fails one simulation and not the worker. If a
    worker is lost, Dask gives its design to another one; a design that has lost several workers is abandoned.

    Args:
        scheduler: its address, such as "tcp://head:8786".
        time_limit: most seconds per simulation; None means no limit.
        report: called with a line for the user when simulations wait because there are no workers.
        versions: a module-level function that returns the versions on which results depend, by name; a worker with
            other versions is rejected. None disables the check.

    Raises:
        InputError: if Dask is not installed or no scheduler answers at the address.
    """

    def __init__(
        self,
        scheduler: str,
        time_limit: float | None = None,
        report: Callable[[str], None] = lambda _: None,
        versions: Versions | None = None,
    ) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(
                "--executor dask: requires the package distributed; install it with `pip install "
                "'activefail[cluster]'`."
            ) from None
        # Dask logs lost connections with tracebacks; the exceptions raised here report what matters.
        for name in logging.root.manager.loggerDict:
            if name.split(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        # Keep the client even if its constructor fails: closing at interpreter exit would hang and print a traceback.
        self._client = Client.__new__(Client)
        try:
            self._client.__init__(scheduler, timeout=_CONNECT, set_as_default=False, name="activefail")
        # Any exception: the server may not be a scheduler, and Dask takes its bytes for array sizes.
        except Exception as error:
            with suppress(Exception):
                self._client.close(timeout=_LOOK)
            raise InputError(f"--scheduler: no Dask scheduler answers at {scheduler!r}: {error}.") from None
        self._scheduler = scheduler
        self._time_limit = time_limit
        self._report = report
        self._expected = None if versions is None else (versions, tuple(sorted(versions().items())))
        self._waits_for_workers = False
        self._arrivals: _Arrivals = SimpleQueue()
        self._in_flight: dict[str, _Flight] = {}
        self._key = secrets.token_hex(8)

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""
        if len(X) == 0:
            return unanswered(simulator, 0)
        # A separate queue: the stop rule calls this while single designs are in flight.
        arrivals: _Arrivals = SimpleQueue()
        answers: dict[int, Results] = {}
        for row, x in enumerate(X):
            self._submit(simulator, row, x, arrivals)
        while len(answers) < len(X):
            for row, results in self._collect(arrivals, _LOOK):
                answers[row] = results
                if arrived is not None:
                    arrived(row, results)
        return Results.concatenate([answers[row] for row in range(len(X))])

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """Queue a design, (d,), for simulation (see AsynchronousExecutor)."""
        self._submit(simulator, ticket, x, self._arrivals)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """Tickets and results that arrived (see AsynchronousExecutor).

        Raises:
            SimulationError: if the scheduler is lost or the workers cannot run the simulator.
        """
        return self._collect(self._arrivals, seconds)

    def _submit(self, simulator: Simulator, ticket: int, x: Array, arrivals: "_Arrivals", tries: int = 1) -> None:
        arguments = simulator, x[None], self._time_limit, self._expected, self._key
        try:
            future = self._client.submit(answer_on_worker, *arguments, pure=False)
        except Exception:
            # The client closes itself when it cannot reach the scheduler again, also while the program learns.
            if self._is_connected:
                raise
            raise self._lost() from None
        self._in_flight[future.key] = _Flight(future, simulator, x, tries)

        async def gather() -> None:
            answer: _Answer
            try:
                answer = await future
            except (Exception, CancelledError) as error:
                answer = error
            arrivals.put((ticket, future.key, answer))

        # On the client's event loop: a worker may die before its answer is read, and waiting for the recomputed one
        # must not block the checks for a lost scheduler or an interrupt.
        self._client.loop.add_callback(gather)

    def _collect(self, queue: "_Arrivals", seconds: float) -> list[tuple[int, Results]]:
        from distributed import KilledWorker

        arrivals = taken(queue, seconds)
        # Not "lost" futures: Dask recomputes answers that were lost with their workers.
        cancelled = any(flight.future.status == "cancelled" for flight in self._in_flight.values())
        if cancelled or not self._is_connected:
            raise self._lost()
        if arrivals:
            # There were workers, so report it again if none is left.
            self._waits_for_workers = False
        else:
            self._look_for_workers()
        results = []
        for ticket, key, arrived in arrivals:
            flight = self._in_flight.pop(key)
            if isinstance(arrived, KilledWorker) and flight.tries < _TRIES:
                # Its workers were lost, as when an allocation ends.
                self._submit(flight.simulator, ticket, flight.x, queue, flight.tries + 1)
            else:
                results.append((ticket, self._result(flight, arrived)))
        return results

    def _look_for_workers(self) -> None:
        """Tell the user, once each time, that simulations wait because there are no workers."""
        waited = self._waits_for_workers
        with suppress(OSError):  # the next check detects a lost scheduler and asks a slow one again
            workers = self._client.sync(self._client.scheduler.ncores, callback_timeout=_LOOK)
            self._waits_for_workers = len(self._in_flight) > 0 and not workers
        if self._waits_for_workers and not waited:
            self._report(f"waiting for workers at {self._scheduler}")

    @property
    def _is_connected(self) -> bool:
        return self._client.status in ("running", "connecting")

    def _lost(self) -> SimulationError:
        return SimulationError(
            f"The Dask scheduler at {self._scheduler} was lost, or has dropped the simulations in flight. "
            f"Existing data is intact. Restart the scheduler, then resume."
        )

    def _result(self, flight: "_Flight", answer: "_Answer") -> Results:
        from distributed import KilledWorker

        future, simulator, x, _ = flight
        match answer:
            case KilledWorker():
                fault = f"{design_in_words(simulator, x)}: its workers were lost in each of {_TRIES} tries: {answer}"
                return finished(simulator, unanswered(simulator, 1, WORKER_DIED, fault))
            case ActivefailError():
                raise answer
            case OSError() | CancelledError() if future.status != "error":
                # The simulation succeeded, but the connection was lost before its answer arrived.
                raise self._lost() from answer
            case BaseException():
                # A worker without activefail or with another version.
                raise SimulationError(
                    f"The Dask cluster at {self._scheduler} could not simulate {design_in_words(simulator, x)}: "
                    f"{type(answer).__name__}: {' '.join(str(answer).split()).rstrip('.')}. "
                    "The workers need this machine's versions of activefail, Python and Dask."
                ) from answer
            case _:
                return finished(simulator, answer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        # A lost scheduler has neither simulations nor workers.
        with suppress(Exception):
            self._client.cancel([flight.future for flight in self._in_flight.values()], force=True)
            # The workers go on; the processes that they started for these simulations end.
            self._client.sync(self._client._run, end_processes, self._key, callback_timeout=_CONNECT)
        self._client.close(timeout=_CONNECT)


@cache
def _check_versions(versions: Versions, expected: _Expected) -> None:
    """Check, once on each worker, that it has the versions of the machine that runs the campaign.

    Raises:
        SimulationError: naming the differences.
    """
    there = versions()
    differences = [
        f"{name} {there.get(name, 'missing')} there, {here} here" for name, here in expected if there.get(name) != here
    ]
    if differences:
        raise SimulationError(
            f"A worker on {platform.node()} differs from this machine: {'; '.join(differences)}. Its results could "
            f"differ, so none was recorded. Install this machine's versions on the workers, or run activefail with "
            f"theirs."
        )


_guards: dict[str, Guards] = {}
"""A Dask worker's guards, by the executor that uses them: a process for each of its threads."""


def answer_on_worker(
    simulator: Simulator,
    X: Array,
    time_limit: float | None,
    expected: tuple[Versions, _Expected] | None,
    executor: str = "",
) -> Results:
    """Simulate a design, (1, d), on a Dask worker.

    Raises:
        SimulationError: if the worker's versions are not the expected ones.
    """
    if expected is not None:
        _check_versions(*expected)
    if simulator.releases_gil:
        return answer(simulator, X)
    return _guards.setdefault(executor, Guards(time_limit)).answer(simulator, X)


def end_processes(executor: str) -> None:
    """End the processes on a Dask worker that simulate for an executor, which is being closed."""
    if (guards := _guards.pop(executor, None)) is not None:
        guards.stop()
        guards.close()
