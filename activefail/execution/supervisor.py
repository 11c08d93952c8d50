"""The process between the program and a worker: it ends the worker with all that the worker has started.

The worker runs the user's code, which may hold the interpreter for hours, start programs in new sessions, or die. The
supervisor only waits, so that it can always act. On Linux it adopts every orphaned descendant of the worker
(PR_SET_CHILD_SUBREAPER), so that none escapes; elsewhere it ends the worker's process group. `processes` starts it. It
imports little, because two processes per worker should not double the memory.
"""

import os
import signal
import sys
import time
from contextlib import suppress

SIGNALLED = 128
"""Added to the number of the signal that ended a worker, in the supervisor's exit code, as shells do."""

_LOOK = 1.0
"""Seconds between checks that the program lives."""

_PATIENCE = 10.0
"""Seconds to wait for killed processes; one that hangs in the kernel may not end."""

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
"""From Linux's <sys/prctl.h>."""


def main(program: int, connection: int) -> None:
    """Start a worker, wait until it ends, the program ends or SIGTERM comes, and end all remaining processes.

    Exits with the worker's exit code.

    Args:
        program: process id of the program.
        connection: descriptor of the worker's end of its connection to the program.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the program decides what follows from Ctrl-C
    # Standard output belongs to the program: it may be a table or JSON.
    with suppress(OSError):
        os.dup2(2, 1)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    signals = {signal.SIGCHLD, signal.SIGALRM, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    worker = os.fork()
    if worker == 0:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signals | {signal.SIGINT})
        os.setsid()  # also a new process group, which can be killed as one
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        from activefail.execution.worker import serve

        serve(connection)
    os.close(connection)
    signal.setitimer(signal.ITIMER_REAL, _LOOK, _LOOK)
    status = None
    while status is None and os.getppid() == program and signal.sigwait(signals) != signal.SIGTERM:
        status = _reap(worker)
    _end(worker, status is None)
    code = 0 if status is None else os.waitstatus_to_exitcode(status)
    os._exit(code if code >= 0 else SIGNALLED - code)


def _reap(worker: int) -> int | None:
    """Collect ended child processes, adopted ones too; the worker's status, as from `os.waitpid`, if it has ended."""
    status = None
    with suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            if ended[0] == worker:
                status = ended[1]
    return status


def _end(worker: int, alive: bool) -> None:
    """Kill all processes that a worker started, and the worker if it is alive."""
    deadline = time.monotonic() + _PATIENCE
    processes = {worker} if alive else set()  # it may not have a group yet
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(worker, signal.SIGKILL)
    while time.monotonic() < deadline:
        # Children of a killed process are adopted, and appear in the next round.
        for process in processes:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.001)
        processes = _children()


def _children() -> set[int]:
    """The child processes of this one, if the system lists processes."""
    pids: set[int] = set()
    # Over all processes: not every kernel lists the children of one.
    with suppress(OSError):
        for process in filter(str.isdigit, os.listdir("/proc")):
            with suppress(OSError, ValueError, IndexError), open(f"/proc/{process}/stat", "rb") as file:
                # State and parent follow the name in brackets, which may contain anything.
                if int(file.read().rpartition(b")")[2].split()[1]) == os.getpid():
                    pids.add(int(process))
    return pids


def _prctl(option: int, value: int) -> None:
    """Set an attribute of this process, if the system supports it."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)
