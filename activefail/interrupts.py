"""How a Ctrl-C and a SIGTERM are met: asked once they stop work in order, asked twice at once."""

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

INTERRUPTED = 130
"""The exit code of a program that a Ctrl-C ended, as shells have it."""


@contextmanager
def stop_on_signals(stopping: str = "stopping after this batch") -> Iterator[Callable[[], bool]]:
    """The first Ctrl-C or SIGTERM asks for a stop and says what is done before it, the second stops at once."""
    asked = at_once = False

    def ask(number: int, frame: object) -> None:
        nonlocal asked, at_once
        if asked:
            at_once = True
            raise KeyboardInterrupt
        asked = True
        print(f"\n{stopping}; once more to stop now", file=sys.stderr)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    except Exception as broken:
        # An interrupt in the middle of one of Python's own locks comes out as that lock's complaint.
        if at_once:
            raise KeyboardInterrupt from broken
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def hearing_every_ctrl_c() -> Iterator[None]:
    """A Ctrl-C that meets a call from compiled code, from which Python can raise nothing, comes again.

    After the block the program is ending. What is cleared away at exit has nothing to lose, and a Ctrl-C more ends it
    without a traceback.
    """
    coming: list[threading.Timer] = []

    def unraisable(dropped: "sys.UnraisableHookArgs") -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            again = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
            again.daemon = True
            again.start()
            coming.append(again)
        else:
            sys.__unraisablehook__(dropped)

    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    try:
        yield
    finally:
        for again in coming:
            again.cancel()
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_DFL)
        sys.unraisablehook = hook


def end_without_waiting() -> None:
    """End the process after a Ctrl-C without waiting for its threads.

    Where a Ctrl-C meets the start of a thread, Python may wait for that thread for ever, or not at all, and then abort
    while compiled code runs on in it.
    """
    # Ends the processes that were started, too.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(INTERRUPTED)
