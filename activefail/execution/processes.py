"""Worker processes that may die, hang or run out of memory without taking the batch with them."""

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
    ask_for_senders,
    longest_answer,
    opened,
    received,
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
"""Workers that one simulation may cost before it is given up."""

_START_LIMIT = 300.0
"""Seconds in which a worker must have loaded the simulator: a large library on a slow disk takes a while."""

_END_LIMIT = 20.0
"""Seconds in which a supervisor must have ended its worker: longer than it waits for one that hangs in the kernel."""

_LONGEST_WAIT = 3600.0
"""Seconds that the system is asked to wait at a time: it counts milliseconds, and not far."""

_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[4:]; "
    "from activefail.execution.supervisor import main; main(*map(int, sys.argv[1:4]))"
)
"""What a new process of Python runs; it finds modules where this one does."""


@runtime_checkable
class _Renewed(Protocol):
    """A simulator that says how many simulations one process may run; any number if None."""

    @property
    def renew(self) -> int | None: ...


@runtime_checkable
class _Isolated(Protocol):
    """A simulator that says whether each simulation has a process of its own, beside that of the worker."""

    @property
    def isolated(self) -> bool: ...


class StoppedError(Exception):
    """A guard was stopped while it waited for an answer."""


class _LostError(Exception):
    """A question has no answer: the cause, one of EXECUTION_CAUSES, and why."""

    def __init__(self, cause: int, why: str) -> None:
        super().__init__(why)
        self.cause, self.why = cause, why


class _Worker:
    """A worker process with its supervisor, and our ends of the connections to both.

    Attributes:
        answered: how many simulations.

    Raises:
        SimulationError: if it cannot be started.
    """

    def __init__(self) -> None:
        self.answered = 0
        self._secret = secrets.token_bytes(SECRET)
        self._process: int | None = None
        self._said_more = False
        self._closed = False
        try:
            self._connection, theirs = socket.socketpair()
            self._leash, held = socket.socketpair()
            ask_for_senders(self._connection)
            with theirs, held, ignoring_ctrl_c():
                descriptors = (theirs.fileno(), held.fileno())
                self._supervisor = subprocess.Popen(
                    [*python_command(), "-c", _PROGRAM, str(os.getpid()), *map(str, descriptors), *search_path()],
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
        """Have it load a simulator.

        Raises:
            SimulationError: if it cannot.
            ActivefailError: that the simulator raised.
        """
        data = bytes(ForkingPickler.dumps(simulator))
        # The main module is run anew there, which takes time, and only where something of it is needed.
        content = bytes(ForkingPickler.dumps((answer, preparation(main=b"__main__" in data), data)))
        try:
            if self._process is None:
                self._ask(QuestionKind.GREETING, self._secret, _START_LIMIT, 0)
            frame = self._ask(QuestionKind.SIMULATOR, content, _START_LIMIT, MOST_TEXT)
            why = "" if frame.kind == FrameKind.READY else unpack_text(frame.payload)
        except BrokenFrameError as broken:
            why = _invalid(broken)
        except _LostError as lost:
            why = lost.why
        if why:
            raise SimulationError(f"A worker process could not load the simulator: {why}.")

    def simulate(self, simulator: Simulator, X: Array, limit: float | None) -> tuple[Results, str]:
        """The answer to a design, (1, d), and why there is none; "" if there is one.

        Raises:
            ActivefailError: that the simulator raised.
        """
        try:
            design = np.asarray(X, dtype=np.float64).tobytes()
            frame = self._ask(QuestionKind.DESIGN, design, limit, longest_answer(simulator))
            self.answered += 1
            if frame.kind != FrameKind.ANSWERED:
                raise BrokenFrameError("it is no answer to a design")
            return unpack_answer(frame.payload, simulator)
        except BrokenFrameError as broken:
            return unanswered(simulator, 1, WORKER_DIED), _invalid(broken)
        except _LostError as lost:
            return unanswered(simulator, 1, lost.cause), lost.why

    def is_sound(self) -> bool:
        """Whether it lives and has said nothing but what it was asked."""
        return not self._said_more and not self._events.poll(0)

    def _ask(self, kind: QuestionKind, content: bytes, limit: float | None, most: int) -> Frame:
        """What it answers within so many seconds, in so many bytes at most."""
        # The monotonic clock: setting the machine's clock must neither end a simulation nor let one go on.
        deadline = np.inf if limit is None else time.monotonic() + limit
        question, data = Question.about(content), b""
        self._connection.settimeout(None if limit is None else min(limit, _LONGEST_WAIT))
        # Where that fails it has died, or has closed its connection and will die of it.
        with suppress(OSError):
            self._connection.sendall(QUESTION.pack(question.ticket, kind, len(content)) + content)
        while True:
            left = deadline - time.monotonic()
            ready = self._events.poll(math.ceil(1e3 * min(max(0.0, left), _LONGEST_WAIT)))
            # First what it said: that is still there when it has died.
            if any(descriptor == self._connection.fileno() for descriptor, _ in ready):
                data += self._heard()
                frame = self._opened(data, question, most)
                if frame is not None:
                    return frame
            elif ready:
                raise self._death()
            elif left <= 0.0:
                if self._closed:
                    raise _LostError(WORKER_DIED, _ending(LOST))
                raise _LostError(TIME_LIMIT, f"it took longer than {limit:g} s")
            if self._closed:
                # No answer can come any more; its supervisor, which says how it ended, may have been stopped.
                deadline = min(deadline, time.monotonic() + _END_LIMIT)

    def _heard(self) -> bytes:
        """What has come, of the worker itself."""
        try:
            data, sender = received(self._connection)
        except OSError:  # it ended with something unread
            data, sender = b"", None
        if not data:
            self._closed = True
            self._events.unregister(self._connection)
        elif sender is not None:
            if self._process is None:
                # The first one that is heard is the worker: nothing of the user's has run there yet.
                self._process = sender
            if sender != self._process:
                raise BrokenFrameError("another process sent it")
        return data

    def _opened(self, data: bytes, question: Question, most: int) -> Frame | None:
        """The frame that has come, if it is complete."""
        frame = opened(data, self._secret, question, self._process, most)
        if frame is not None:
            self._process = frame.process
            self._said_more = frame.more
            if frame.kind == FrameKind.REFUSED:
                raise unpack_error(frame.payload)
        return frame

    def _death(self) -> _LostError:
        with suppress(OSError):
            status = self._leash.recv(STATUS)
            if status:
                return _LostError(WORKER_DIED, _ending(os.waitstatus_to_exitcode(int.from_bytes(status, "little"))))
        # The supervisor was killed, and its worker with it.
        return _LostError(WORKER_DIED, _ending(self._supervisor.wait()))

    def kill(self) -> None:
        """End it, and whatever it has started; from any thread."""
        with suppress(OSError):
            self._leash.shutdown(socket.SHUT_WR)
        self._supervisor.send_signal(signal.SIGCONT)  # should somebody have stopped it

    def close(self) -> None:
        """End it and let go of it."""
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
    """Answers one design after the other in a worker process, which is replaced when it dies, hangs or fails.

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
        """The answer to a design, (1, d), and why it has none; "" if it has one.

        A simulation that fails is tried once more, in a fresh process, before it is given up: what is recorded must not
        depend on which simulations that process has run before, nor on a machine that lacked memory for a moment.

        Raises:
            SimulationError: if a worker cannot be started, or cannot load the simulator.
            ActivefailError: that the simulator raised.
            StoppedError: after `stop`.
        """
        reasons: list[str] = []
        while True:
            worker = self._ready(simulator)
            fresh = worker.answered == 0
            try:
                results, why = worker.simulate(simulator, X, self._time_limit)
            except ActivefailError:
                self._check_stopped()
                raise
            self._check_stopped()
            if not why:
                return results, ""
            # Even where it still lives: what failed there may have spoilt it.
            self.close()
            reasons.append(why.removeprefix(f"design {X[0].tolist()}: "))
            # The program of an isolated simulator has had a fresh process each time.
            settled = results.cause[0] in (RAISED, UNUSABLE_ANSWER) and (fresh or _is_isolated(simulator))
            if settled or len(reasons) == TRIES:
                _check_output()
                return results, f"design {X[0].tolist()}: {_in_words(reasons)}"

    def _ready(self, simulator: Simulator) -> _Worker:
        """A sound worker that has loaded the simulator."""
        if self._worker is not None and not (self._worker.is_sound() and _may_answer(self._worker, simulator)):
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
                    # A second answer to the last question may have come in between, or the process was spoilt.
                    return self._ready(simulator)
                raise
            self._check_stopped()
            self._simulator = simulator
        return worker

    def _check_stopped(self) -> None:
        if self._stopped:
            raise StoppedError

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


def _check_output() -> None:
    """Check that what reads this program's output is still there.

    Workers write to the same streams: a simulation that prints would fail for no fault of its own.

    Raises:
        BrokenPipeError: if it is not.
    """
    streams = select.poll()
    for descriptor in (1, 2):
        streams.register(descriptor, 0)
    if any(event & (select.POLLERR | select.POLLHUP) for _, event in streams.poll(0)):
        raise BrokenPipeError("the output pipe was closed")


def _may_answer(worker: _Worker, simulator: Simulator) -> bool:
    """Whether a worker has not yet run as many simulations as one process may."""
    most = simulator.renew if isinstance(simulator, _Renewed) else None
    return most is None or worker.answered < most


def _is_isolated(simulator: Simulator) -> bool:
    return isinstance(simulator, _Isolated) and simulator.isolated


def _in_words(reasons: list[str]) -> str:
    """Why a simulation was given up, by the reasons of its tries."""
    if len(reasons) == 1:
        return reasons[0]
    first, second = reasons
    return f"{first}, twice" if first == second else f"{first}; then, in a fresh process: {second}"


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


def _ending(code: int) -> str:
    """How a worker died, by its exit code; that of a signal is below 0."""
    how = f"exit code {code}"
    if code == LOST:
        how = "its connection was closed or replaced"
    elif code == NO_PROCESS:
        how = "no process could be started for it"
    elif code < 0:
        how = signal_name(-code)
        if how == "SIGKILL":
            how = f"{how}, out of memory perhaps"
    return f"its worker process died ({how})"


def _invalid(broken: BrokenFrameError) -> str:
    return f"its answer was not a valid frame: {broken}"
