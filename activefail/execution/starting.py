"""How processes of Python are started: deaf to Ctrl-C, and without modules from the current folder."""

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
    """Processes that are started within take no modules from the current folder and never hear a Ctrl-C.

    Around what makes locks or pools, too: the first lock starts a process that keeps count of them.
    """
    with _without_this_folder():
        # Its start would unblock what is blocked then.
        resource_tracker.ensure_running()
        with ignoring_ctrl_c():
            yield


@contextmanager
def ignoring_ctrl_c() -> Iterator[None]:
    """Processes that are started within never hear a Ctrl-C, not even while they load their libraries.

    A terminal sends it to all of them, and it is for the parent to judge. One that comes meanwhile is heard at the end.
    """
    heard = False

    def hear(number: int, frame: object) -> None:
        nonlocal heard
        heard = True

    # Blocked for those that are started, who inherit this; and heard by another thread, it must not break off a start.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, hear) if main else None
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if main:
            signal.signal(signal.SIGINT, handler)
        if heard:
            signal.raise_signal(signal.SIGINT)


_SAFE_PATH, _OURS = "PYTHONSAFEPATH", "activefail"
"""A variable of Python's, and what it is set to where it is not the user's."""


@contextmanager
def _without_this_folder() -> Iterator[None]:
    """For a process that is started as `python -c`, which would look for Python's own modules here first.

    The current folder may be a run folder that comes from someone else, with a `multiprocessing.py` in it.
    """
    ours = not os.environ.get(_SAFE_PATH)
    if ours:
        os.environ[_SAFE_PATH] = _OURS
    try:
        yield
    finally:
        if ours:
            del os.environ[_SAFE_PATH]


def begin_worker() -> None:
    """What a process does first that was started so: a program of Python's that it starts has its own folder back."""
    if os.environ.get(_SAFE_PATH) == _OURS:
        del os.environ[_SAFE_PATH]


def python_command() -> list[str]:
    """Python as this process was started, but never looking for modules in the current folder first.

    That may be a run folder which comes from someone else, with a `pickle.py` in it.
    """
    flags: list[str] = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined]
    return [sys.executable, *flags, "-P"]


def search_path() -> list[str]:
    """Where this process finds modules."""
    places: list[object] = spawn.get_preparation_data("")["sys_path"]
    return [place for place in places if isinstance(place, str)]


def preparation(main: bool) -> dict[str, Any]:
    """What makes another process like this one: its arguments, and its main module if asked for."""
    known = spawn.get_preparation_data("")
    wanted = ("sys_argv", "orig_dir", *(("init_main_from_name", "init_main_from_path") if main else ()))
    return {name: known[name] for name in wanted if name in known}
