"""Simulations in worker processes: one that fails in a used process or is lost there is repeated in a fresh one."""

import multiprocessing
import pickle
import select
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import spawn
from multiprocessing.reduction import ForkingPickler
from threading import get_ident
from typing import Any

import numpy as np

from activefail.errors import ActivefailError, SimulationError, description_of
from activefail.execution.answering import answer
from activefail.execution.processes import LostError, Worker
from activefail.simulators.interface import (
    NOT_FINITE,
    RAISED,
    UNUSABLE_ANSWER,
    Results,
    Simulator,
    design_in_words,
    unanswered,
)
from activefail.space.space import Array

TRIES = 2
"""Attempts at one simulation before it is abandoned."""

_START_LIMIT = 300.0
"""Seconds in which a worker must load the simulator: a large library on a slow disk takes a while."""


_Packed = tuple[int, int, bytes, float, dict[int, str]]
"""A result as plain data, which takes a tenth of the time of pickled arrays."""


class StoppedError(Exception):
    """The guards were stopped while a thread waited for an answer."""


@dataclass
class _Loaded:
    """A worker with its simulator, pickled too, and the number of simulations it was asked for."""

    worker: Worker
    simulator: Simulator
    data: bytes
    asked: int = 0

    def may_continue(self, simulator: Simulator) -> bool:
        """Whether it can run another simulation, of this simulator, within the simulator's limit per process."""
        same = simulator is self.simulator or bytes(ForkingPickler.dumps(simulator)) == self.data
        most = getattr(simulator, "renew", None)
        return same and (most is None or self.asked < most) and self.worker.is_idle()


class Guards:
    """Simulates designs in a worker process for each calling thread; a failure there costs one simulation at most.

    Args:
        time_limit: most seconds per simulation; None means no limit.

    Raises:
        ValueError: if the time limit is not positive.
    """

    def __init__(self, time_limit: float | None = None) -> None:
        if time_limit is not None and not time_limit > 0.0:
            raise ValueError(f"`time_limit > 0` must hold, got {time_limit}.")
        self._time_limit = time_limit
        self._loaded: dict[int, _Loaded] = {}
        self._stopped = False

    def answer(self, simulator: Simulator, X: Array) -> Results:
        """The result of a design, (1, d), with the faults of all attempts as one.

        A failed simulation is repeated once in a fresh process before it is abandoned: the record must not depend on
        earlier simulations in the process, nor on a brief shortage of memory.

        Raises:
            SimulationError: if a worker cannot be started or cannot load the simulator.
            ActivefailError: if the simulator raised one.
            StoppedError: after `stop`.
        """
        design, contents, reasons = (
            f"{design_in_words(simulator, X[0])}: ",
            np.asarray(X, dtype=np.float64).tobytes(),
            [],
        )
        while True:
            loaded = self._ready(simulator)
            loaded.asked += 1
            try:
                results = _unpacked(*loaded.worker.ask(self._time_limit, _simulate, contents))
            except LostError as error:
                results = unanswered(simulator, 1, error.cause, error.why)
            self._check_stopped()
            if not results.faults:
                return results
            # Even if the worker is alive, the failure may have corrupted it.
            self._close_worker()
            reasons.append(results.faults[0].removeprefix(design))
            # An isolated simulator runs each attempt in a fresh process anyway.
            fresh = loaded.asked == 1 or getattr(simulator, "isolated", False)
            if len(reasons) == TRIES or (fresh and results.cause[0] in (RAISED, UNUSABLE_ANSWER, NOT_FINITE)):
                _check_output()
                return replace(results, faults={0: design + _joined(reasons)})

    def _ready(self, simulator: Simulator) -> _Loaded:
        """A worker of the calling thread that has loaded the simulator."""
        loaded = self._loaded.get(get_ident())
        if loaded is not None and loaded.may_continue(simulator):
            return loaded
        self._close_worker()
        loaded = _Loaded(Worker(), simulator, bytes(ForkingPickler.dumps(simulator)))
        self._loaded[get_ident()] = loaded
        try:
            self._check_stopped()  # from here on `stop` ends the worker
            # The worker runs the main module again, which takes time, so only if the simulator refers to it.
            preparation = _preparation(main=b"__main__" in loaded.data)
            why = loaded.worker.ask(_START_LIMIT, _load, preparation, loaded.data)
        except LostError as error:
            self._check_stopped()
            why = error.why
        except ActivefailError:
            self._close_worker()
            raise
        if why:
            self._close_worker()
            raise SimulationError(f"A worker process could not load the simulator: {why}.")
        return loaded

    def _close_worker(self) -> None:
        """End the worker of the calling thread."""
        if (loaded := self._loaded.pop(get_ident(), None)) is not None:
            loaded.worker.close()

    def _check_stopped(self) -> None:
        if self._stopped:
            raise StoppedError

    def stop(self) -> None:
        """End all workers at once, from any thread; waiting threads then raise StoppedError."""
        self._stopped = True
        for loaded in list(self._loaded.values()):
            loaded.worker.kill()

    def close(self) -> None:
        """Release all workers; no thread may be waiting for them."""
        while self._loaded:
            self._loaded.popitem()[1].worker.close()


def _unpacked(outcome: int, cause: int, margins: bytes, seconds: float, faults: dict[int, str]) -> Results:
    """The result of a design."""
    outcomes, causes = np.array([outcome], dtype=np.int8), np.array([cause], dtype=np.int8)
    return Results(outcomes, causes, np.frombuffer(margins)[None].copy(), np.array([seconds]), faults)


def _preparation(main: bool) -> dict[str, Any]:
    """Data that makes another process like this one: its arguments and, if `main`, its main module."""
    data = spawn.get_preparation_data("")
    names = ("sys_argv", "orig_dir", *(("init_main_from_name", "init_main_from_path") if main else ()))
    return {name: data[name] for name in names if name in data}


def _check_output() -> None:
    """Check that this program's output pipe is open.

    Workers share its streams: with a closed pipe, every simulation that prints would fail.

    Raises:
        BrokenPipeError: if the pipe is closed.
    """
    streams = select.poll()
    for stream in filter(None, (sys.stdout, sys.stderr)):
        with suppress(AttributeError, ValueError):  # a stream that is no file
            streams.register(stream.fileno(), 0)
    if any(event & (select.POLLERR | select.POLLHUP) for _, event in streams.poll(0)):
        raise BrokenPipeError("the output pipe was closed")


def _joined(reasons: list[str]) -> str:
    """Why a simulation was abandoned, from the reasons of its attempts."""
    if len(reasons) == 1:
        return reasons[0]
    first, second = reasons
    return f"{first}, twice" if first == second else f"{first}; then, in a fresh process: {second}"


# --- in the worker ------------------------------------------------------------------------------------------------

_simulator: Simulator | None = None
"""What a worker has loaded."""


def _load(preparation: dict[str, Any], data: bytes) -> str:
    """Load and prepare a simulator; returns why it cannot be loaded, or an empty text."""
    global _simulator
    process = multiprocessing.current_process()
    # multiprocessing then rejects a main module that starts processes during its import.
    process._inheriting = True  # type: ignore[attr-defined]
    try:
        spawn.prepare(preparation)
        del process._inheriting  # type: ignore[attr-defined]
        _simulator = pickle.loads(data)
        if (prepare := getattr(_simulator, "prepare", None)) is not None:
            prepare()
    except (ActivefailError, SystemExit):
        raise
    except BaseException as error:
        return description_of(error)
    return ""


def _simulate(design: bytes) -> _Packed:
    """What the worker's simulator answers to a design of float64."""
    assert _simulator is not None
    results = answer(_simulator, np.frombuffer(design)[None].copy())
    outcome, cause, seconds = results.outcome.item(), results.cause.item(), results.seconds.item()
    return outcome, cause, results.margins.tobytes(), seconds, dict(results.faults)
