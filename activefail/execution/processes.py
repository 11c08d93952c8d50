"""Worker processes: each answers calls within a time limit, and ends with all that it has started.

A worker runs the user's code. A call that gets no whole answer has lost its worker, and a child that the user's code
forks never answers.
"""

import os
import pickle
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import spawn
from multiprocessing.connection import Connection
from typing import Any

from activefail.errors import SimulationError, reason_of, signal_name
from activefail.execution.supervisor import SIGNALLED
from activefail.simulators.interface import TIME_LIMIT, WORKER_DIED

_LOOK = 1.0
"""Seconds between checks that a worker is alive: a process that it left behind may hold its connection open."""

_PATIENCE = 5.0
"""Seconds in which a worker that has closed its connection must end, and in which the rest of an answer must arrive."""

_LONGEST = 1 << 30
"""Most bytes of an answer."""

_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[3:]; "
    "from activefail.execution.supervisor import main; main(int(sys.argv[1]), int(sys.argv[2]))"
)
"""The program of a new Python process, which has the module path of this one."""


class LostError(Exception):
    """A call got no answer.

    Attributes:
        cause: WORKER_DIED or TIME_LIMIT.
        why: the reason, for the user.
    """

    def __init__(self, cause: int, why: str) -> None:
        super().__init__(why)
        self.cause, self.why = cause, why


class Worker:
    """A worker process with its supervisor.

    Raises:
        SimulationError: if it cannot be started.
    """

    def __init__(self) -> None:
        flags: list[str] = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined]
        path = spawn.get_preparation_data("")["sys_path"]
        try:
            self._socket, theirs = socket.socketpair()
            with theirs:
                # -P: the current folder may be a run folder from someone else, with a `pickle.py` in it.
                command = [sys.executable, *flags, "-P", "-c", _PROGRAM, str(os.getpid()), str(theirs.fileno())]
                # A Ctrl-C between the fork and the new session waits, and the supervisor then ignores it.
                mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
                try:
                    self._process = subprocess.Popen(
                        [*command, *(entry for entry in path if isinstance(entry, str))],
                        stdin=subprocess.DEVNULL,
                        pass_fds=(theirs.fileno(),),
                        start_new_session=True,  # a terminal sends Ctrl-C to its own session
                    )
                finally:
                    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            self._connection = Connection(os.dup(self._socket.fileno()))
        except OSError as error:
            raise SimulationError(f"A worker process cannot be started: {reason_of(error)}.") from None
        self._arrivals = select.poll()
        self._arrivals.register(self._socket, select.POLLIN)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", int(_PATIENCE), 0))

    def ask(self, limit: float | None, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """What a module-level function returns in the worker, within `limit` seconds.

        Raises:
            ActivefailError: if the function raises one; any other error ends the worker.
            LostError: if the worker dies or takes longer; it must then be closed.
        """
        # The monotonic clock: setting the system clock must not change the limit.
        deadline = float("inf") if limit is None else time.monotonic() + limit
        try:
            self._connection.send_bytes(pickle.dumps((function, args, kwargs)))
            while not self._arrivals.poll(1e3 * max(0.0, min(_LOOK, deadline - time.monotonic()))):
                if self._process.poll() is not None and not self._arrivals.poll(0):
                    raise EOFError
                if time.monotonic() >= deadline:
                    raise LostError(TIME_LIMIT, f"it took longer than {limit:g} s")
            content = self._connection.recv_bytes(_LONGEST)
        except (EOFError, OSError):
            raise LostError(WORKER_DIED, self._ending()) from None
        try:
            value, error = pickle.loads(content)
        except Exception:
            raise LostError(WORKER_DIED, "its reply was malformed") from None
        if error is not None:
            raise error
        return value

    def _ending(self) -> str:
        """How the worker died."""
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            return "its worker process closed or spoiled its connection"
        how = f"exit code {code}"
        if code < 0 or code > SIGNALLED:
            how = signal_name(code - SIGNALLED if code > 0 else -code)
        return f"its worker process died ({how}{', possibly out of memory' if how == 'SIGKILL' else ''})"

    def is_idle(self) -> bool:
        """Whether the worker is alive, as far as its connection shows, and has sent nothing but its answers."""
        return not self._arrivals.poll(0)

    def ask_to_stop(self) -> None:
        """Make `stopping()` true in the worker; it ends after its call."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def kill(self) -> None:
        """End the worker and all processes that it started; from any thread."""
        self._process.terminate()
        # The user's code may have stopped the supervisor.
        self._process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End the worker and release its resources."""
        self.kill()
        self._process.wait()
        self._connection.close()
        self._socket.close()
