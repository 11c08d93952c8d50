"""Handle Ctrl-C and SIGTERM: the first one stops work cleanly, the second ends it at once."""

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

INTERRUPTED = 130
"""Exit code after Ctrl-C, by the convention of shells."""


@contextmanager
def stop_on_signals(stopping: str = "stopping after this batch") -> Iterator[Callable[[], bool]]:
    """Handle signals in a block: the first requests a stop and prints `stopping`, the second raises KeyboardInterrupt.

    Yields a function that returns whether a stop was requested.
    """
    stop_requested = at_once = False

    def request_stop(number: int, frame: object) -> None:
        nonlocal stop_requested, at_once
        if stop_requested:
            at_once = True
            raise KeyboardInterrupt
        stop_requested = True
        # The signal may arrive while the stream writes, and a stream does not write meanwhile.
        with suppress(RuntimeError):
            print(f"\n{stopping}; Ctrl-C again to stop now", file=sys.stderr)

    handlers = {number: signal.signal(number, request_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: stop_requested
    except Exception as error:
        # An interrupt inside one of Python's locks surfaces as that lock's error.
        if at_once:
            raise KeyboardInterrupt from error
        raise
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def repeating_missed_ctrl_c() -> Iterator[None]:
    """Repeat a Ctrl-C that arrives in a callback from compiled code, where Python cannot raise it.

    After the block the program is ending: a Ctrl-C during cleanup loses nothing and ends it without a traceback.
    """
    timers: list[threading.Timer] = []

    def unraisable(event: "sys.UnraisableHookArgs") -> None:
        if issubclass(event.exc_type, KeyboardInterrupt):
            timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
            timer.daemon = True
            timer.start()
            timers.append(timer)
        else:
            sys.__unraisablehook__(event)

    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    try:
        yield
    finally:
        for timer in timers:
            timer.cancel()
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_DFL)
        sys.unraisablehook = hook


def end_without_waiting() -> None:
    """End the process after Ctrl-C without waiting for its threads.

    If Ctrl-C interrupts the start of a thread, Python may wait for it forever, or abort while compiled code still runs
    in it.
    """
    # The exit functions also end child processes.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(INTERRUPTED)
