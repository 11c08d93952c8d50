"""The errors that activefail raises, for invalid input and for faults of a run folder or the machine."""

import errno
import resource
import signal
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from activefail.visible import visible

LONGEST_MESSAGE = 20_000
"""Most characters of a message: a stranger's key or value in it may be as long as its file."""


class ActivefailError(Exception):
    """Base class of activefail's errors; the text is for the user, with a stranger's control characters escaped."""

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) > LONGEST_MESSAGE:
            text = f"{text[: LONGEST_MESSAGE // 2]} ... {text[-LONGEST_MESSAGE // 2 :]}"
        return visible(text, keep="\n")


class InputError(ActivefailError, ValueError):
    """A value, file or option breaks a rule; the text names it, the rule and the value."""


class StoreError(ActivefailError):
    """A run folder cannot be read or written; its data is intact."""


class BusyError(StoreError):
    """Another process is writing to the run folder."""


class DamagedError(StoreError):
    """A file was altered or contains what activefail never writes; the text completes "<file> ..."."""


class SyncError(StoreError):
    """fsync failed: the kernel may have dropped pages, so neither a retry nor a later commit is reliable."""


class SimulationError(ActivefailError):
    """The simulations failed: too many numerical failures, or workers that cannot run."""


class SelfTestError(ActivefailError):
    """A self-test of the installation has a wrong result."""


class TableWarning(UserWarning):
    """A table is probably wrong, or partly outside the design space."""


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Begin the text of an InputError with its place, such as "site.toml: " or "question."."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error}") from None


def reason_of(error: OSError) -> str:
    """The system's reason for an error, with the limit if too many files are open."""
    reason = error.strerror or str(error)
    if error.errno in (errno.EMFILE, errno.ENFILE):
        limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        reason += f" (this process may open {limit}; `ulimit -n` sets the limit)"
    return reason


def signal_name(number: int) -> str:
    """The name of a signal, such as SIGKILL; Python names most real-time signals by number only."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def description_of(error: BaseException) -> str:
    """An error's class and message. The message may come from the user's code, which may fail too."""
    name = type(error).__name__
    try:
        return f"{name}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException as message_error:
        return f"{name}, whose message cannot be read ({type(message_error).__name__})"


def place_of(error: BaseException, users: bool = False) -> str:
    """Where an error was raised, as " (file:line)": the innermost frame of user code, or else of all code.

    Args:
        error: the error.
        users: whether only user code is a place; empty then if none raised it.
    """
    lines = [(frame.f_code.co_filename, line) for frame, line in traceback.walk_tb(error.__traceback__)]
    user_lines = [(file, line) for file, line in lines if _is_user_code(file)]
    return "".join(f" ({file}:{line})" for file, line in (user_lines or lines * (not users))[-1:])


def _is_user_code(file: str) -> bool:
    """Whether a file belongs to neither Python, a library nor activefail."""
    path = Path(file)
    libraries = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"), Path(__file__).parent)
    return (
        not file.startswith("<")  # code without a file
        and not {"site-packages", "dist-packages"}.intersection(path.parts)
        and not any(path.is_relative_to(library) for library in libraries)
    )
