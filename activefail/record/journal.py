"""The journal of a run folder: a file of events that only grows, with the lock of its one writer.

An event is durable once it is acknowledged.

Its first line names the format. An entry that a crash has cut is dropped by the next writer, into a file beside the
journal. An entry that is damaged before other entries is refused by its place.
"""

import errno
import fcntl
import os
import re
import stat
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from activefail.errors import BusyError, DamagedError, InputError, StoreError
from activefail.record.events import Entry, Event, pack, unpack
from activefail.record.layout import JOURNAL, QUARANTINE
from activefail.text.files import refused, sync_file, sync_folder, write_all
from activefail.text.trust import read_regular

FORMAT = 2
"""Version of the journal and of what its events mean."""

FIRST_LINE = f"activefail-journal, format {FORMAT}".encode().ljust(31) + b"\n"

LARGEST_JOURNAL = 16_000_000_000
"""Most bytes of a journal: nearly a hundred million simulations of nine variables and twelve margins."""

_ENTRY = re.compile(rb"activefail [0-9a-f]{64} \d{1,15} \[")
"""Where an entry begins."""

_PATIENCE = 5, 0.02
"""How often a writer tries to take the lock, and the seconds between: `is_being_written` has it for a moment."""

_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, 524)
"""Errors of a file system without flock; 524 is Linux's own ENOTSUPP, which some cluster file systems return."""


class Journal:
    """The journal in a run folder. A writer holds its lock until `close` or the end of the process.

    Attributes:
        path: of the file.
        has_lock: False if the file system has no locks. A second writer is then refused when it writes.
        damage: where and how the last entry was damaged; empty if it was not.

    Raises:
        BusyError: if another process is writing.
        StoreError: if it cannot be opened.
    """

    def __init__(self, folder: Path, write: bool, create: bool = False) -> None:
        self.path = folder / JOURNAL
        self.has_lock = True
        self._descriptor = -1
        self._end = 0
        self._digest = ""
        self._tail = b""
        self.damage = ""
        if not write:
            return
        try:
            # Neither truncate nor follow: the name may be a link to a user's file.
            flags = os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | (os.O_CREAT if create else 0)
            self._descriptor = os.open(self.path, flags, 0o666)
            if not stat.S_ISREG(os.fstat(self._descriptor).st_mode):
                raise StoreError(f"Cannot write to {folder}: {JOURNAL} is not a regular file.")
            try:
                self._lock()
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
                self.has_lock = False
        except BlockingIOError:
            self.close()
            raise BusyError(
                f"Another process is writing to {folder}. Wait until it ends, or stop it; reading is possible "
                "meanwhile."
            ) from None
        except OSError as error:
            self.close()
            raise StoreError(f"Cannot write to {folder}: {error.strerror or error}.") from error
        except BaseException:
            self.close()
            raise

    def _lock(self) -> None:
        tries, seconds = _PATIENCE
        for left in reversed(range(tries)):
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if not left:
                    raise
            time.sleep(seconds)

    @property
    def is_writer(self) -> bool:
        """Whether this object may write; not after `close`."""
        return self._descriptor >= 0

    def begin(self, event: Event) -> None:
        """Write the first line and the first event of a new campaign, over what an interrupted creation left.

        Raises:
            InputError: if the journal has later events, or the file is none of activefail's.
            StoreError: if it cannot be written.
        """
        data = self._read()
        # A loss of power may leave zeros.
        if data.strip(b"\0") and not data.startswith(FIRST_LINE):
            raise InputError(
                f"{self.path.parent} is not empty: its {JOURNAL} was not written by activefail. Choose another folder."
            )
        if len(_ENTRY.findall(data)) > 1:
            raise InputError(f"{self.path.parent} is not empty: its {JOURNAL} holds a campaign. Choose another folder.")
        try:
            os.ftruncate(self._descriptor, 0)
        except OSError as error:
            raise StoreError(refused(self.path, error)) from error
        parts, self._digest, _ = pack(event, "")
        self._write([FIRST_LINE, *parts])
        sync_folder(self.path.parent)

    def entries(self) -> Iterator[Entry]:
        """All entries; a damaged last one is left out.

        Raises:
            StoreError: if the journal cannot be read, has another format, or is damaged before other entries.
        """
        data = self._read()
        if not data.startswith(FIRST_LINE):
            named = re.match(rb"activefail-journal, format (\d{1,9}) *\n", data)
            version = "" if named is None or int(named[1]) == FORMAT else f"has format {int(named[1])}, not {FORMAT}: "
            raise StoreError(
                f"{self.path} {version}this version of activefail cannot read it. Use the version that wrote it, or "
                "restore the file from a copy."
            )
        self._end, self._digest = len(FIRST_LINE), ""
        while self._end < len(data):
            try:
                entry = unpack(data, self._end, self._digest)
            except DamagedError as error:
                if _ENTRY.search(data, self._end + 1):
                    raise StoreError(
                        f"{self.path}, byte {self._end}: the entry {error}, and others follow it. Nothing was changed. "
                        "Restore the journal from a copy."
                    ) from None
                # What is incomplete may be being written.
                if self.is_writer or "incomplete" not in str(error):
                    self._tail = data[self._end :]
                    self.damage = f"{JOURNAL}, byte {self._end}: the last entry {error}"
                return
            yield entry
            self._digest, self._end = entry.digest, entry.end

    def set_aside(self) -> str:
        """Move what follows the last entry into a file of its own, as a writer; what was done, empty for nothing.

        Raises:
            StoreError: with the system's reason.
        """
        if not self._tail:
            return ""
        aside = self.path.with_name(QUARANTINE)
        try:
            descriptor = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666)
            try:
                write_all(descriptor, self._tail)
                sync_file(descriptor, aside)
            finally:
                os.close(descriptor)
            sync_folder(aside.parent)
            os.ftruncate(self._descriptor, self._end)
        except OSError as error:
            raise StoreError(refused(aside, error)) from error
        return f"{self.damage}; it was moved to {QUARANTINE}. What it held is asked for or simulated again."

    def append(self, events: Sequence[Event]) -> list[str]:
        """Append events; all are durable when this returns. Their own digests.

        Raises:
            SyncError: if fsync failed.
            StoreError: if they cannot be written; none of them is there then.
        """
        parts: list[bytes] = []
        digest, contents = self._digest, []
        for event in events:
            entry, digest, content = pack(event, digest)
            parts += entry
            contents.append(content)
        self._write(parts)
        self._digest = digest
        return contents

    def _write(self, parts: Sequence[bytes]) -> None:
        data = b"".join(parts)
        if self._end + len(data) > LARGEST_JOURNAL:
            raise StoreError(
                f"Cannot write {self.path}: it would be larger than {LARGEST_JOURNAL} bytes, and could not be read "
                "again. Existing data is intact. Continue in a new campaign."
            )
        try:
            # Without locks, or after a write that could not be undone.
            if os.fstat(self._descriptor).st_size != self._end:
                raise StoreError(f"{self.path} is not as this process left it. Existing data is intact. Resume.")
            try:
                write_all(self._descriptor, data)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._descriptor, self._end)
                raise
            size = os.fstat(self._descriptor).st_size
        except OSError as error:
            raise StoreError(refused(self.path, error)) from error
        if size != self._end + len(data):
            raise StoreError(
                f"Cannot write {self.path}: it should have {self._end + len(data)} bytes, and has {size}. Another "
                "process may write to it. Resume."
            )
        sync_file(self._descriptor, self.path)
        self._end = size

    def _read(self) -> bytes:
        try:
            return read_regular(self.path, LARGEST_JOURNAL)
        except (OSError, MemoryError) as error:
            reason = getattr(error, "strerror", None) or "it does not fit into memory"
            raise StoreError(f"Cannot read {self.path}: {reason}.") from error
        except ValueError as error:
            raise StoreError(f"{self.path} {error}.") from None

    def is_in(self, folder: Path) -> bool:
        """Whether the file that this object opened is still the journal of a folder.

        It is not if the folder was moved or removed, even if another run folder now has its name.

        Raises:
            OSError: if the system cannot tell.
        """
        try:
            named = os.stat(folder / JOURNAL, follow_symlinks=False)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(named, os.fstat(self._descriptor))

    def close(self) -> None:
        """Release the lock; a second call does nothing."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            # All that was acknowledged is synchronised.
            with self._ignoring:
                self._close(descriptor)

    # At the end of the interpreter, modules may be gone before this object.
    _close, _ignoring = staticmethod(os.close), suppress(OSError)

    def __del__(self) -> None:
        # A store that was not closed must not keep its folder locked.
        self.close()


def is_being_written(folder: Path) -> bool:
    """Whether a process has a run folder open for writing; False where the file system has no locks."""
    try:
        descriptor = os.open(folder / JOURNAL, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    finally:
        os.close(descriptor)
    return False
