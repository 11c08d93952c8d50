"""The process between the main program and a worker: it kills the worker and all processes that the worker started.

The worker runs the user's code, which may hold the interpreter for hours, start programs in new sessions, or die. The
supervisor only waits, so that it can always act. On Linux it adopts every orphaned descendant of the worker
(PR_SET_CHILD_SUBREAPER), so that none escapes; elsewhere it ends only the worker's process group. `processes` starts
it. It imports little, because two processes per worker should not double the memory.
"""

import os
import select
import signal
import sys
import time
from contextlib import suppress
from typing import NoReturn

STATUS = 4
"""Bytes in which a supervisor reports its worker's exit status, as from `os.waitpid`."""

NO_PROCESS = 72
"""Exit code that a supervisor reports for a worker that it could not start."""

_LOOK = 1.0
"""Seconds between checks that the main program lives: a copy of its end of the leash may outlive it."""

_PATIENCE = 10.0
"""Seconds to wait for killed processes; one that hangs in the kernel may not end."""

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
"""From Linux's <sys/prctl.h>."""


def main(program: int, answers: int, leash: int) -> NoReturn:
    """Start a worker, wait until it ends or the main program closes the leash, and end all remaining processes.

    Args:
        program: process id of the main program.
        answers: descriptor of the connection for questions and answers.
        leash: descriptor of a socket whose other end only the main program holds. The worker's exit status is written
            to it once all its processes have ended.
    """
    # A terminal sends Ctrl-C to all processes; the main program handles it. It was blocked until now.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    for descriptor in (answers, leash):
        os.set_inheritable(descriptor, False)
    prctl(_PR_SET_CHILD_SUBREAPER, 1)
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    # Python writes a byte to the pipe on each signal that has a handler.
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    supervisor = os.getpid()
    try:
        worker = os.fork()
    except OSError:
        with suppress(OSError):
            os.write(leash, (NO_PROCESS << 8).to_bytes(STATUS, "little"))
        os._exit(0)
    if worker == 0:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for descriptor in (leash, woken, wake):
            os.close(descriptor)
        _work(supervisor, answers)
    os.close(answers)
    status = _watch(worker, program, leash, woken)
    _end(worker, status is None)
    with suppress(OSError):
        os.write(leash, (status or 0).to_bytes(STATUS, "little"))
    os._exit(0)


def _work(supervisor: int, answers: int) -> NoReturn:
    """Run the worker."""
    leave, code = os._exit, 1
    try:
        # A new session and process group, which can be killed as one.
        os.setsid()
        prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() == supervisor:
            from activefail.execution.worker import serve

            serve(answers)
    except SystemExit as error:
        code = error.code & 0xFF if isinstance(error.code, int) else int(error.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        # Never return: a process that the simulator forked may get here, too.
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        leave(code)


def _watch(worker: int, program: int, leash: int, woken: int) -> int | None:
    """The worker's exit status, as from `os.waitpid`; None if the main program closes the leash before."""
    while True:
        ready, _, _ = select.select([leash, woken], [], [], _LOOK)
        if woken in ready:
            os.read(woken, 4096)
        # This also reaps adopted processes.
        with suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                if ended[0] == worker:
                    return ended[1]
        if leash in ready or os.getppid() != program:
            return None


def _end(worker: int, alive: bool) -> None:
    """Kill all processes that a worker started, and the worker if it is alive."""
    deadline = time.monotonic() + _PATIENCE
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(worker, signal.SIGKILL)
    processes = {worker} if alive else set()  # it may not have a group yet
    while time.monotonic() < deadline:
        # Children of a killed process are adopted, and appear in the next round.
        for process in processes | children():
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        processes.clear()
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.001)


def children() -> set[int]:
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


def prctl(option: int, value: int) -> None:
    """Set an attribute of this process, if the system supports it."""
    if sys.platform == "linux":
        with suppress(ImportError, OSError, AttributeError):
            import ctypes

            ctypes.CDLL(None).prctl(option, value, 0, 0, 0)
