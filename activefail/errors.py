"""What activefail raises: a mistake of the user's, or a fault that the run folder or the machine has."""

import errno
import resource
import signal
import sysconfig
import traceback
from pathlib import Path


class ActivefailError(Exception):
    """Base of every error that activefail raises on purpose; its text is meant for the user."""


class InputError(ActivefailError, ValueError):
    """A value, file or option that the user gave breaks a rule; the text names it, the rule and the value."""


class StoreError(ActivefailError):
    """A run folder cannot be read or written as it is; nothing in it was changed."""


class BusyError(StoreError):
    """Another process is writing to the run folder."""


class DamagedError(StoreError):
    """A file is not what was written, or holds what activefail never writes; the text completes "<file> ..."."""


class SyncError(StoreError):
    """fsync failed: the kernel may have dropped the pages, so neither a retry nor a later commit can be trusted."""


class SimulationError(ActivefailError):
    """The simulator did not do its work: too many numerical failures, or workers that keep dying."""


def reason_of(error: OSError) -> str:
    """The system's reason, and the limit where too many files are open."""
    reason = error.strerror or str(error)
    if error.errno in (errno.EMFILE, errno.ENFILE):
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        reason += f" (this process may open {limit}; `ulimit -n` sets the limit)"
    return reason


def signal_name(number: int) -> str:
    """The name of a signal, such as SIGKILL, or its number: Python has no names for most real-time signals."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def description_of(error: BaseException) -> str:
    """An error's class and message. The message may be the user's code, too, and fail itself."""
    name = type(error).__name__
    try:
        return f"{name}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException as again:
        return f"{name}, whose message cannot be read ({type(again).__name__})"


def place_of(error: BaseException) -> str:
    """Where an error was raised, as " (file:line)".

    Of the frames that were left, the innermost one in the user's code; the innermost one of all if none is the user's.
    """
    places = [(frame.f_code.co_filename, line) for frame, line in traceback.walk_tb(error.__traceback__)]
    users = [(file, line) for file, line in places if _is_users(file)]
    return "".join(f" ({file}:{line})" for file, line in (users or places)[-1:])


def _is_users(file: str) -> bool:
    """Whether a file of Python code belongs neither to Python, nor to a library, nor to activefail."""
    path = Path(file)
    libraries = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"), Path(__file__).parent)
    return (
        not file.startswith("<")  # code without a file
        and not {"site-packages", "dist-packages"}.intersection(path.parts)
        and not any(path.is_relative_to(library) for library in libraries)
    )
