"""Starting Python processes that ignore Ctrl-C and do not import modules from the current folder."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker, spawn
from typing import Any


@contextmanager
def starting_processes() -> Iterator[None]:
    """Processes started in this context ignore Ctrl-C and do not import modules from the current folder.

    Also needed around the creation of locks and pools: the first lock starts the resource tracker.
    """
    with _safe_path():
        # Its start unblocks SIGINT.
        resource_tracker.ensure_running()
        with ignoring_ctrl_c():
            yield


@contextmanager
def ignoring_ctrl_c() -> Iterator[None]:
    """Processes started in this context ignore Ctrl-C, even while they load their libraries.

    A terminal sends it to all processes, but only the parent decides what follows. A Ctrl-C in the context takes effect
    at its end.
    """
    interrupted = False

    def note_interrupt(number: int, frame: object) -> None:
        nonlocal interrupted
        interrupted = True

    # Children inherit the mask. The handler is replaced too: another thread may receive the signal during a start.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, note_interrupt) if main else None
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if main:
            signal.signal(signal.SIGINT, handler)
        if interrupted:
            signal.raise_signal(signal.SIGINT)


_SAFE_PATH, _OURS = "PYTHONSAFEPATH", "activefail"
"""Python's environment variable, and the value that marks it as set here, not by the user."""


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep the current folder off the path of processes started as `python -c`.

    It may be a run folder from someone else, with a `multiprocessing.py` in it.
    """
    is_unset = not os.environ.get(_SAFE_PATH)
    if is_unset:
        os.environ[_SAFE_PATH] = _OURS
    try:
        yield
    finally:
        if is_unset:
            del os.environ[_SAFE_PATH]


def begin_worker() -> None:
    """Initialise a process started this way: Python programs that it starts find modules in their own folder again."""
    if os.environ.get(_SAFE_PATH) == _OURS:
        del os.environ[_SAFE_PATH]


def python_command() -> list[str]:
    """The command of this process's Python, with the current folder off the path.

    The folder may be a run folder from someone else, with a `pickle.py` in it.
    """
    flags: list[str] = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined]
    return [sys.executable, *flags, "-P"]


def search_path() -> list[str]:
    """The folders in which this process finds modules."""
    entries: list[object] = spawn.get_preparation_data("")["sys_path"]
    return [entry for entry in entries if isinstance(entry, str)]


def preparation(main: bool) -> dict[str, Any]:
    """Data that makes another process like this one: its arguments and, if `main`, its main module."""
    data = spawn.get_preparation_data("")
    names = ("sys_argv", "orig_dir", *(("init_main_from_name", "init_main_from_path") if main else ()))
    return {name: data[name] for name in names if name in data}
