"""The lock of a run folder: one writer at a time, if the file system supports locks."""

import errno
import fcntl
import os
import stat
from pathlib import Path

from activefail.errors import BusyError, StoreError
from activefail.record.layout import LOCK

_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Errors of a file system without flock."""


class FolderLock:
    """The lock of a run folder, held until `release` or the end of the process, when the kernel releases it.

    Only the kernel's lock counts, not the existence of the file. So a kill never leaves a folder locked, and a folder
    may move between file systems with and without locks.

    Attributes:
        held: False if the file system has no locks. Two writers are then separated by `link` alone.

    Raises:
        BusyError: if another process holds the lock.
        StoreError: if the lock cannot be taken, with the system's reason.
    """

    def __init__(self, folder: Path) -> None:
        self._descriptor = -1
        self.held = False
        try:
            # Neither truncate nor follow: the name may be a link to a user's file.
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
            self._descriptor = os.open(folder / LOCK, flags, 0o666)
            if not stat.S_ISREG(os.fstat(self._descriptor).st_mode):
                raise StoreError(f"Cannot write to {folder}: {LOCK} is not a regular file. Remove {LOCK}.")
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.held = True
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
        except BlockingIOError:
            self.release()
            raise BusyError(
                f"Another process is writing to {folder}. Wait until it ends, or stop it; reading is possible "
                f"meanwhile."
            ) from None
        except OSError as error:
            self.release()
            raise StoreError(f"Cannot write to {folder}: {error.strerror or error}.") from error
        except BaseException:
            self.release()
            raise

    def is_in(self, folder: Path) -> bool:
        """Whether the file that this object opened is still the lock of a folder, with or without locks.

        It is not if the folder was moved or removed, even if another run folder now has its name.

        Raises:
            OSError: if the system cannot tell.
        """
        try:
            named = os.stat(folder / LOCK, follow_symlinks=False)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(named, os.fstat(self._descriptor))

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            self._close(descriptor)

    # At the end of the interpreter, modules may be gone before this object.
    _close = staticmethod(os.close)

    def __del__(self) -> None:
        # A store that was not closed must not keep its folder locked.
        self.release()
