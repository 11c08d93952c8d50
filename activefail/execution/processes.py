"""Starts, guards and ends worker processes: a simulation whose worker dies or hangs is tried again, then given up."""

import math
import os
import secrets
import select
import signal
import socket
import subprocess
import threading
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler
from typing import Protocol, runtime_checkable

import numpy as np

from activefail.errors import ActivefailError, SimulationError, reason_of, signal_name
from activefail.execution.frames import (
    MOST_TEXT,
    QUESTION,
    SECRET,
    BrokenFrameError,
    Frame,
    FrameKind,
    Question,
    QuestionKind,
    decode_frame,
    longest_answer,
    receive,
    request_senders,
    unpack_answer,
    unpack_error,
    unpack_text,
)
from activefail.execution.starting import ignoring_ctrl_c, preparation, python_command, search_path
from activefail.execution.supervisor import NO_PROCESS, STATUS
from activefail.execution.worker import LOST, Answer
from activefail.simulators.interface import (
    RAISED,
    TIME_LIMIT,
    UNUSABLE_ANSWER,
    WORKER_DIED,
    Results,
    Simulator,
    unanswered,
)
from activefail.space import Array

TRIES = 2
"""Attempts at one simulation before it is abandoned."""

_START_LIMIT = 300.0
"""Seconds in which a worker must load the simulator: a large library on a slow disk takes a while."""

_END_LIMIT = 20.0
"""Seconds in which a supervisor must end its worker: longer than its own wait for a process that hangs."""

_LONGEST_WAIT = 3600.0
"""Most seconds per wait: the system counts milliseconds in a small integer."""

SUPERVISOR_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[4:]; "
    "from activefail.execution.supervisor import main; main(*map(int, sys.argv[1:4]))"
)
"""The program of a new Python process, which has the module path of this one."""


@runtime_checkable
class _Renewed(Protocol):
    """A simulator that limits the simulations per process; None means no limit."""

    @property
    def renew(self) -> int | None: ...


@runtime_checkable
class _Isolated(Protocol):
    """A simulator that reports whether each simulation runs in a new process, besides the worker's."""

    @property
    def isolated(self) -> bool: ...


class StoppedError(Exception):
    """The guard was stopped while it waited for an answer."""


class _LostError(Exception):
    """A question got no answer; holds the cause, one of EXECUTION_CAUSES, and the reason."""

    def __init__(self, cause: int, why: str) -> None:
        super().__init__(why)
        self.cause, self.why = cause, why


class _Worker:
    """A worker process with its supervisor, and this process's ends of the connections to both.

    Attributes:
        answered: number of simulations answered.

    Raises:
        SimulationError: if it cannot be started.
    """

    def __init__(self) -> None:
        self.answered = 0
        self._secret = secrets.token_bytes(SECRET)
        self._process: int | None = None
        self._has_trailing = False
        self._closed = False
        try:
            self._connection, worker_end = socket.socketpair()
            self._leash, leash_end = socket.socketpair()
            request_senders(self._connection)
            with worker_end, leash_end, ignoring_ctrl_c():
                descriptors = (worker_end.fileno(), leash_end.fileno())
                self._supervisor = subprocess.Popen(
                    [
                        *python_command(),
                        "-c",
                        SUPERVISOR_PROGRAM,
                        str(os.getpid()),
                        *map(str, descriptors),
                        *search_path(),
                    ],
                    stdin=subprocess.DEVNULL,
                    pass_fds=descriptors,
                    start_new_session=True,
                )
        except OSError as error:
            raise SimulationError(f"A worker process cannot be started: {reason_of(error)}.") from None
        self._events = select.poll()
        for end in (self._connection, self._leash):
            self._events.register(end, select.POLLIN)

    def load(self, simulator: Simulator, answer: Answer) -> None:
        """Load a simulator in the worker.

        Raises:
            SimulationError: if the worker cannot load it.
            ActivefailError: if the simulator raised one.
        """
        data = bytes(ForkingPickler.dumps(simulator))
        # The worker runs the main module again, which takes time, so only if the simulator refers to it.
        content = bytes(ForkingPickler.dumps((answer, preparation(main=b"__main__" in data), data)))
        try:
            if self._process is None:
                self._ask(QuestionKind.GREETING, self._secret, _START_LIMIT, 0)
            frame = self._ask(QuestionKind.SIMULATOR, content, _START_LIMIT, MOST_TEXT)
            why = "" if frame.kind == FrameKind.READY else unpack_text(frame.payload)
        except BrokenFrameError as error:
            why = _invalid(error)
        except _LostError as error:
            why = error.why
        if why:
            raise SimulationError(f"A worker process could not load the simulator: {why}.")

    def simulate(self, simulator: Simulator, X: Array, limit: float | None) -> Results:
        """The result of a design, (1, d), with its fault.

        Raises:
            ActivefailError: if the simulator raised one.
        """
        try:
            design = np.asarray(X, dtype=np.float64).tobytes()
            frame = self._ask(QuestionKind.DESIGN, design, limit, longest_answer(simulator))
            self.answered += 1
            if frame.kind != FrameKind.ANSWERED:
                raise BrokenFrameError("it is not a reply to a design")
            return unpack_answer(frame.payload, simulator)
        except BrokenFrameError as error:
            return unanswered(simulator, 1, WORKER_DIED, _invalid(error))
        except _LostError as error:
            return unanswered(simulator, 1, error.cause, error.why)

    def is_sound(self) -> bool:
        """Whether the worker is alive and has sent nothing but its answers."""
        return not self._has_trailing and not self._events.poll(0)

    def _ask(self, kind: QuestionKind, content: bytes, limit: float | None, most: int) -> Frame:
        """The answer to a question within `limit` seconds, with at most `most` bytes of payload."""
        # The monotonic clock: setting the system clock must not change the limit.
        deadline = np.inf if limit is None else time.monotonic() + limit
        question, data = Question.about(content), b""
        self._connection.settimeout(None if limit is None else min(limit, _LONGEST_WAIT))
        # If sending fails, the worker has died, or has closed its connection and will exit.
        with suppress(OSError):
            self._connection.sendall(QUESTION.pack(question.ticket, kind, len(content)) + content)
        while True:
            left = deadline - time.monotonic()
            ready = self._events.poll(math.ceil(1e3 * min(max(0.0, left), _LONGEST_WAIT)))
            # Read first: a worker's last answer outlives it.
            if any(descriptor == self._connection.fileno() for descriptor, _ in ready):
                data += self._receive()
                frame = self._decode(data, question, most)
                if frame is not None:
                    return frame
            elif ready:
                raise self._death()
            elif left <= 0.0:
                if self._closed:
                    raise _LostError(WORKER_DIED, _ending(LOST))
                raise _LostError(TIME_LIMIT, f"it took longer than {limit:g} s")
            if self._closed:
                # No answer can arrive any more. Bound the wait for the supervisor's report; it may have been stopped.
                deadline = min(deadline, time.monotonic() + _END_LIMIT)

    def _receive(self) -> bytes:
        """Bytes that the worker sent; those of other processes raise."""
        try:
            data, sender = receive(self._connection)
        except OSError:  # the worker ended with unread data
            data, sender = b"", None
        if not data:
            self._closed = True
            self._events.unregister(self._connection)
        elif sender is not None:
            if self._process is None:
                # The first sender is the worker: no user code has run there yet.
                self._process = sender
            if sender != self._process:
                raise BrokenFrameError("another process sent it")
        return data

    def _decode(self, data: bytes, question: Question, most: int) -> Frame | None:
        """The received frame, or None while it is incomplete."""
        frame = decode_frame(data, self._secret, question, self._process, most)
        if frame is not None:
            self._process = frame.process
            self._has_trailing = frame.has_trailing
            if frame.kind == FrameKind.REFUSED:
                raise unpack_error(frame.payload)
        return frame

    def _death(self) -> _LostError:
        with suppress(OSError):
            status = self._leash.recv(STATUS)
            if status:
                return _LostError(WORKER_DIED, _ending(os.waitstatus_to_exitcode(int.from_bytes(status, "little"))))
        # The supervisor was killed, and the worker with it.
        return _LostError(WORKER_DIED, _ending(self._supervisor.wait()))

    def kill(self) -> None:
        """End the worker and all processes that it started; from any thread."""
        with suppress(OSError):
            self._leash.shutdown(socket.SHUT_WR)
        self._supervisor.send_signal(signal.SIGCONT)  # it may have been stopped

    def close(self) -> None:
        """End the worker and release its resources."""
        self.kill()
        self._leash.settimeout(_END_LIMIT)
        try:
            self._leash.recv(STATUS)
        except OSError:
            self._supervisor.kill()
        self._supervisor.wait()
        self._connection.close()
        self._leash.close()


class Guard:
    """Simulates one design at a time in a worker process, which is replaced when it dies, hangs or fails.

    Args:
        answer: the module-level function that the process runs.
        time_limit: most seconds per simulation; None means no limit.
    """

    def __init__(self, answer: Answer, time_limit: float | None = None) -> None:
        self._answer = answer
        self._time_limit = time_limit
        self._simulator: Simulator | None = None
        self._worker: _Worker | None = None
        self._stopped = False
        self._lock = threading.Lock()

    def answer(self, simulator: Simulator, X: Array) -> Results:
        """The result of a design, (1, d), with the faults of all attempts as one.

        A failed simulation is repeated once in a fresh process before it is abandoned: the record must not depend on
        earlier simulations in the process, nor on a brief shortage of memory.

        Raises:
            SimulationError: if a worker cannot be started or cannot load the simulator.
            ActivefailError: if the simulator raised one.
            StoppedError: after `stop`.
        """
        reasons: list[str] = []
        while True:
            worker = self._ready(simulator)
            fresh = worker.answered == 0
            try:
                results = worker.simulate(simulator, X, self._time_limit)
            except ActivefailError:
                self._check_stopped()
                raise
            self._check_stopped()
            if not results.faults:
                return results
            # Even if the worker is alive, the failure may have corrupted it.
            self.close()
            reasons.append(results.faults[0].removeprefix(f"design {X[0].tolist()}: "))
            # An isolated simulator runs each attempt in a fresh process anyway.
            settled = results.cause[0] in (RAISED, UNUSABLE_ANSWER) and (fresh or _is_isolated(simulator))
            if settled or len(reasons) == TRIES:
                _check_output()
                return replace(results, faults={0: f"design {X[0].tolist()}: {_joined(reasons)}"})

    def _ready(self, simulator: Simulator) -> _Worker:
        """A sound worker that has loaded the simulator."""
        if self._worker is not None and not (self._worker.is_sound() and _may_continue(self._worker, simulator)):
            self.close()
        with self._lock:
            self._check_stopped()
            if self._worker is None:
                self._worker, self._simulator = _Worker(), None
            worker = self._worker
        if simulator is not self._simulator:
            used = worker.answered > 0
            try:
                worker.load(simulator, self._answer)
            except ActivefailError as error:
                self._check_stopped()
                self.close()
                if used and isinstance(error, SimulationError):
                    # A second answer to the last question may have arrived, or the process was corrupted.
                    return self._ready(simulator)
                raise
            self._check_stopped()
            self._simulator = simulator
        return worker

    def _check_stopped(self) -> None:
        if self._stopped:
            raise StoppedError

    def stop(self) -> None:
        """End the worker at once, from another thread; the waiting thread then raises StoppedError."""
        with self._lock:
            self._stopped = True
            if self._worker is not None:
                self._worker.kill()

    def close(self) -> None:
        """End the worker; no thread may be waiting for it."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None


def _check_output() -> None:
    """Check that this program's output pipe is open.

    Workers share its streams: with a closed pipe, every simulation that prints would fail.

    Raises:
        BrokenPipeError: if the pipe is closed.
    """
    streams = select.poll()
    for descriptor in (1, 2):
        streams.register(descriptor, 0)
    if any(event & (select.POLLERR | select.POLLHUP) for _, event in streams.poll(0)):
        raise BrokenPipeError("the output pipe was closed")


def _may_continue(worker: _Worker, simulator: Simulator) -> bool:
    """Whether a worker may run another simulation under the simulator's limit per process."""
    most = simulator.renew if isinstance(simulator, _Renewed) else None
    return most is None or worker.answered < most


def _is_isolated(simulator: Simulator) -> bool:
    return isinstance(simulator, _Isolated) and simulator.isolated


def _joined(reasons: list[str]) -> str:
    """Why a simulation was abandoned, from the reasons of its attempts."""
    if len(reasons) == 1:
        return reasons[0]
    first, second = reasons
    return f"{first}, twice" if first == second else f"{first}; then, in a fresh process: {second}"


class Guards:
    """A guard for each calling thread.

    Args:
        answer, time_limit: see Guard.

    Raises:
        ValueError: if the time limit is not positive.
    """

    def __init__(self, answer: Answer, time_limit: float | None = None) -> None:
        if time_limit is not None and not time_limit > 0.0:
            raise ValueError(f"`time_limit > 0` must hold, got {time_limit}.")
        self._answer, self._time_limit = answer, time_limit
        self._local = threading.local()
        self._all: list[Guard] = []
        self._lock = threading.Lock()
        self._stopped = False

    def of_this_thread(self) -> Guard:
        """The guard of the calling thread."""
        if not hasattr(self._local, "guard"):
            self._local.guard = Guard(self._answer, self._time_limit)
            with self._lock:
                self._all.append(self._local.guard)
                if self._stopped:
                    self._local.guard.stop()
        guard: Guard = self._local.guard
        return guard

    def stop(self) -> None:
        """End all workers at once; waiting threads raise StoppedError."""
        with self._lock:
            self._stopped = True
            for guard in self._all:
                guard.stop()

    def close(self) -> None:
        """Release all workers; no thread may be waiting for them."""
        for guard in self._all:
            guard.close()


def _ending(code: int) -> str:
    """How a worker died, from its exit code; negative for a signal."""
    how = f"exit code {code}"
    if code == LOST:
        how = "its connection was closed or replaced"
    elif code == NO_PROCESS:
        how = "no process could be started for it"
    elif code < 0:
        how = signal_name(-code)
        if how == "SIGKILL":
            how = f"{how}, possibly out of memory"
    return f"its worker process died ({how})"


def _invalid(error: BrokenFrameError) -> str:
    return f"its reply was malformed: {error}"
