"""The process between the main program and a worker: it ends the worker, and whatever that has started.

The worker runs the user's code, which may hold the interpreter for hours, start programs in sessions of their own, or
die. The supervisor does nothing but wait, so that it can always act. On Linux it adopts every process that the worker
starts and whose parent ends (PR_SET_CHILD_SUBREAPER), so that none escapes it; elsewhere it ends the worker's process
group alone. It is started by `workers`, and loads little: two processes a worker should not cost twice the memory.
"""

import os
import select
import signal
import sys
import time
from contextlib import suppress
from typing import NoReturn

STATUS = 4
"""Bytes in which a supervisor reports how its worker ended, as `os.waitpid` has it."""

NO_PROCESS = 72
"""Exit code that a supervisor reports for a worker which it could not start."""

_LOOK = 1.0
"""Seconds between two looks at whether the main program is there: a copy of its end of the leash may survive it."""

_PATIENCE = 10.0
"""Seconds in which killed processes must have ended; one that hangs in the kernel may not."""

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
"""Of Linux's <sys/prctl.h>."""


def main(program: int, answers: int, leash: int) -> NoReturn:
    """Start a worker, wait until it ends or the main program lets go of the leash, and end all that is left.

    Args:
        program: the main program's process.
        answers: descriptor over which the worker is asked and answers.
        leash: descriptor of a socket whose other end the main program alone has. How the worker ended is written to it
            when nothing is left of it.
    """
    # On a terminal it goes to all processes, and is for the main program to judge. It was blocked until now.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    for descriptor in (answers, leash):
        os.set_inheritable(descriptor, False)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    # Python writes a byte there when the handler is called.
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
    """What the worker does."""
    leave, code = os._exit, 1
    try:
        # A session and a group of its own, which can be ended as one.
        os.setsid()
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() == supervisor:
            from activefail.execution.worker import serve

            serve(answers)
    except SystemExit as left:
        code = left.code & 0xFF if isinstance(left.code, int) else int(left.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        # Never further up: a process that the simulator forked may come back out of it, too.
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        leave(code)


def _watch(worker: int, program: int, leash: int, woken: int) -> int | None:
    """How the worker ended, as `os.waitpid` has it; None where the main program lets go of the leash before."""
    while True:
        ready, _, _ = select.select([leash, woken], [], [], _LOOK)
        if woken in ready:
            os.read(woken, 4096)
        # Adopted processes end here, too.
        with suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                if ended[0] == worker:
                    return ended[1]
        if leash in ready or os.getppid() != program:
            return None


def _end(worker: int, alive: bool) -> None:
    """End all that a worker has started, and the worker where it is alive."""
    give_up = time.monotonic() + _PATIENCE
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(worker, signal.SIGKILL)
    processes = {worker} if alive else set()  # it may not have a group yet
    while time.monotonic() < give_up:
        # Those of one that is killed are adopted, and are found the next time.
        for process in processes | _children():
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        processes.clear()
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.001)


def _children() -> set[int]:
    """The processes whose parent this one is, where the system says so."""
    found: set[int] = set()
    # Of all processes: not every kernel lists those of one.
    with suppress(OSError):
        for process in filter(str.isdigit, os.listdir("/proc")):
            with suppress(OSError, ValueError, IndexError), open(f"/proc/{process}/stat", "rb") as file:
                # After the name in brackets, which may hold anything: the state, and the parent.
                if int(file.read().rpartition(b")")[2].split()[1]) == os.getpid():
                    found.add(int(process))
    return found


def _prctl(option: int, value: int) -> None:
    """Set an attribute of this process, where the system has it."""
    if sys.platform == "linux":
        with suppress(ImportError, OSError, AttributeError):
            import ctypes

            ctypes.CDLL(None).prctl(option, value, 0, 0, 0)
