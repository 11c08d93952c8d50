"""What activefail raises: a mistake of the user's, or a fault that the run folder or the machine has."""

import errno
import resource


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


def place_of(error: BaseException) -> str:
    """Where something was raised, as " (file:line)": what a user needs to find it in code of their own."""
    place, trace = "", error.__traceback__
    while trace is not None:
        place, trace = f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})", trace.tb_next
    return place
