"""Worker processes that may die, hang or run out of memory without taking the batch with them."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, Protocol, runtime_checkable

import numpy as np
from threadpoolctl import threadpool_limits

from activefail.campaign.simulator import OUT_OF_MEMORY, TIME_LIMIT, WORKER_DIED, Results, Simulator, unanswered
from activefail.errors import ActivefailError, SimulationError
from activefail.space import Array

Answer = Callable[[Simulator, Array], tuple[Results, str]]
"""Answers designs: results, and what befell the first one without an answer ("" if all have one)."""

TRIES = 2
"""Workers that one simulation may cost before it is given up."""

_START_LIMIT = 300.0
"""Seconds in which a worker must have loaded the simulator: a large library on a slow disk takes a while."""

_READY, _ANSWERED, _REFUSED, _UNLOADABLE = range(4)
"""What a worker tells: it has the simulator; its answer; an error of activefail's own; it cannot load the simulator.

What befalls it instead is a cause of EXECUTION_CAUSES, below 0.
"""

_starting = threading.Lock()
"""Held while a process is started: not all that this touches is made for threads."""


@runtime_checkable
class _Prepared(Protocol):
    """A simulator with something to load before its first simulation, whose time limit that must not count to."""

    def prepare(self) -> None: ...


class StoppedError(Exception):
    """A guard was stopped while it waited for an answer."""


class _Worker:
    """A process and our end of its pipe."""

    def __init__(self, answer: Answer) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other, answer), daemon=True)
        with _starting, _may_have_children(), starting_processes():
            self.process.start()
        # Only the worker may hold it: its death must close the pipe.
        other.close()

    def ask(self, data: bytes, limit: float | None) -> tuple[Any, ...]:
        """What it tells about what it is sent, or what befell it within so many seconds."""
        # The monotonic clock: setting the machine's clock must neither end a simulation nor let one go on.
        deadline = np.inf if limit is None else time.monotonic() + limit
        with suppress(OSError):  # it is dead already, which its pipe tells
            self.connection.send_bytes(data)
        while True:
            left = deadline - time.monotonic()
            # A second at most: what a worker has started may hold its pipes open after its death.
            told = wait([self.connection, self.process.sentinel], min(1.0, max(0.0, left)))
            if told or not self.process.is_alive():
                # What it told last is still in the pipe.
                return self._heard() or self._death()
            if left <= 0.0:
                return TIME_LIMIT, f"it took longer than {limit:g} s"

    def _heard(self) -> tuple[Any, ...] | None:
        try:
            return tuple(self.connection.recv()) if self.connection.poll() else None
        except (EOFError, OSError):
            return None

    def _death(self) -> tuple[int, str]:
        self.process.join(1.0)
        return WORKER_DIED, f"its worker process died ({_ending(self.process.exitcode)})"

    def kill(self) -> None:
        """End it, and whatever it has started."""
        if self.process.pid is not None:
            with suppress(ProcessLookupError):  # it had not come as far as to have a group
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()

    def close(self) -> None:
        """End it and let go of it."""
        self.kill()
        self.process.join()
        self.connection.close()


class Guard:
    """Answers one design after the other in a worker process, which is replaced when it dies or hangs.

    Args:
        answer: what the process does; a function of a module.
        time_limit: seconds for one simulation; for ever if None.
    """

    def __init__(self, answer: Answer, time_limit: float | None = None) -> None:
        self._answer = answer
        self._time_limit = time_limit
        self._simulator: Simulator | None = None
        self._worker: _Worker | None = None
        self._stopped = False
        self._lock = threading.Lock()

    def answer(self, simulator: Simulator, X: Array) -> tuple[Results, str]:
        """The answer to a design, (1, d), and what befell it; "" if it has one.

        Raises:
            SimulationError: if a worker cannot load the simulator.
            ActivefailError: that the simulator raised.
            StoppedError: after `stop`.
        """
        told = ""
        for _ in range(TRIES):
            worker = self._loaded(simulator)
            kind, *content = worker.ask(bytes(ForkingPickler.dumps(X)), self._time_limit)
            if self._stopped:
                raise StoppedError
            if kind == _REFUSED:
                raise content[0]
            if kind == _ANSWERED:
                results, fault = content
                return results, fault
            # Replaced even where it still lives: a worker that once lacked memory is not used again.
            self.close()
            told = content[0]
        return unanswered(simulator, 1, kind), f"design {X[0].tolist()}: {told}, twice"

    def _loaded(self, simulator: Simulator) -> _Worker:
        if self._worker is not None and not self._worker.process.is_alive():
            self.close()
        with self._lock:
            if self._stopped:
                raise StoppedError
            if self._worker is None:
                self._worker, self._simulator = _Worker(self._answer), None
            worker = self._worker
        if simulator is not self._simulator:
            kind, *content = worker.ask(bytes(ForkingPickler.dumps(simulator)), _START_LIMIT)
            if self._stopped:
                raise StoppedError
            if kind == _REFUSED:
                raise content[0]
            if kind != _READY:
                raise SimulationError(f"A worker process could not load the simulator: {content[0]}.")
            self._simulator = simulator
        return worker

    def stop(self) -> None:
        """End the worker at once, from another thread; the one that waits for it hears of it and lets go of it."""
        with self._lock:
            self._stopped = True
            if self._worker is not None:
                self._worker.kill()

    def close(self) -> None:
        """End the worker; nobody waits for it."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None


class Guards:
    """A guard for each thread that asks.

    Args:
        answer, time_limit: see Guard.

    Raises:
        ValueError: if no simulation could keep the time limit.
    """

    def __init__(self, answer: Answer, time_limit: float | None = None) -> None:
        if time_limit is not None and not time_limit > 0.0:
            raise ValueError(f"`time_limit > 0` must hold, got {time_limit}.")
        self._answer, self._time_limit = answer, time_limit
        self._mine = threading.local()
        self._all: list[Guard] = []
        self._lock = threading.Lock()
        self._stopped = False

    def of_this_thread(self) -> Guard:
        """The guard of the thread that asks."""
        if not hasattr(self._mine, "guard"):
            self._mine.guard = Guard(self._answer, self._time_limit)
            with self._lock:
                self._all.append(self._mine.guard)
                if self._stopped:
                    self._mine.guard.stop()
        guard: Guard = self._mine.guard
        return guard

    def stop(self) -> None:
        """End all workers at once; threads that wait for them hear of it."""
        with self._lock:
            self._stopped = True
            for guard in self._all:
                guard.stop()

    def close(self) -> None:
        """Let go of all workers; nobody waits for them."""
        for guard in self._all:
            guard.close()


@contextmanager
def _may_have_children() -> Iterator[None]:
    """For a process that is itself a daemon, as a cluster's workers are, and that would be refused children.

    Ours end with it, which is what the rule is there for (`_end_with_parent`).
    """
    settings = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    daemon = settings.pop("daemon", None)
    try:
        yield
    finally:
        if daemon is not None:
            settings["daemon"] = daemon


@contextmanager
def starting_processes() -> Iterator[None]:
    """Processes that are started within take no modules from the current folder and never hear a Ctrl-C.

    Around what makes locks or pools, too: the first lock starts a process that keeps count of them.
    """
    with _without_this_folder(), _deaf_to_ctrl_c():
        yield


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Processes that are started within never hear a Ctrl-C, not even while they load their libraries.

    A terminal sends it to all of them, and it is for the parent to judge. One that comes meanwhile is heard at the end.
    """
    heard = False

    def hear(number: int, frame: object) -> None:
        nonlocal heard
        heard = True

    # Its start would unblock what is blocked here.
    resource_tracker.ensure_running()
    # Blocked for those that are started, who inherit this; and heard by another thread, it must not break off a start.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, hear) if main else None
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if main:
            signal.signal(signal.SIGINT, handler)
        if heard:
            signal.raise_signal(signal.SIGINT)


_SAFE_PATH, _OURS = "PYTHONSAFEPATH", "activefail"
"""A variable of Python's, and what it is set to where it is not the user's."""


@contextmanager
def _without_this_folder() -> Iterator[None]:
    """For a process that is started as `python -c`, which would look for Python's own modules here first.

    The current folder may be a run folder that comes from someone else, with a `multiprocessing.py` in it.
    """
    ours = not os.environ.get(_SAFE_PATH)
    if ours:
        os.environ[_SAFE_PATH] = _OURS
    try:
        yield
    finally:
        if ours:
            del os.environ[_SAFE_PATH]


def begin_worker() -> None:
    """What a process does first that was started so: a program of Python's that it starts has its own folder back."""
    if os.environ.get(_SAFE_PATH) == _OURS:
        del os.environ[_SAFE_PATH]


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"{name}, out of memory perhaps" if name == "SIGKILL" else name
    return f"exit code {code}"


def _work(connection: Connection, answer: Answer) -> None:
    """What a worker does: load what it is sent, and answer."""
    # A group of its own: what it starts can be ended with it.
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    begin_worker()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # Side by side, workers must not each start a thread a core: not in libraries that are loaded, nor in later ones.
    threadpool_limits(1)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    simulator: Simulator | None = None
    while True:
        try:
            data = connection.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            content = ForkingPickler.loads(data)
        except Exception as error:
            connection.send((_UNLOADABLE, f"{type(error).__name__}: {error}"))
            return
        if not isinstance(content, np.ndarray):
            simulator = content
            try:
                if isinstance(simulator, _Prepared):
                    simulator.prepare()
                connection.send((_READY,))
            except ActivefailError as error:
                connection.send((_REFUSED, error))
            continue
        assert simulator is not None
        try:
            results, fault = answer(simulator, content)
        except ActivefailError as error:
            connection.send((_REFUSED, error))
            continue
        if (results.cause == OUT_OF_MEMORY).any():
            connection.send((OUT_OF_MEMORY, fault.partition(": ")[2]))
            return
        connection.send((_ANSWERED, results, fault))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    # Ourselves with whatever the simulation has started: a program would go on for hours for nobody.
    os.killpg(0, signal.SIGKILL)
