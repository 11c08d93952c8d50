"""Files that have their names only once they are whole, durably or not, and files read without trust in their names."""

import errno
import os
import secrets
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

from activefail.errors import InputError, StoreError, SyncError

TEMPORARY = ".tmp-"
"""Prefix of a file of a record that is being written; whoever holds the lock of its run folder may remove it."""

_NEW = ".new-"
"""Prefix of any other file that is being written, which may be in a run folder, too, and has no lock."""


def temporary_beside(path: Path, prefix: str = TEMPORARY) -> Path:
    """A new name in the folder of a path, short: the path's own name may be as long as names can be."""
    return path.with_name(f"{prefix}{secrets.token_hex(8)}")


@contextmanager
def replacing(path: Path, mode: Literal["x", "xb"] = "x") -> Iterator[IO[Any]]:
    """A file to write, UTF-8 if text, that takes its name at the end of the block, or is gone if that fails.

    A file that had the name before stays as it is: other names of it (hard links) keep their content.

    Raises:
        OSError: if it cannot be written.
    """
    temporary = temporary_beside(path, _NEW)
    try:
        encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
        with open(temporary, mode, encoding=encoding, newline=newline) as file:
            yield file
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise


@contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Names the file or folder of a fault of writing.

    Raises:
        InputError: instead of what the system raised.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from None


def check_file(path: Path | None, what: str, suffixes: Sequence[str]) -> None:
    """Check that a file to be written has a folder and one of these suffixes; nothing for None.

    Raises:
        InputError: naming the file and the rule.
    """
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: the folder {path.absolute().parent} does not exist.")
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: the name of {what} must end in {', '.join(suffixes[:-1])} or {suffixes[-1]}.")


def target_of(path: Path) -> Path:
    """The file that a user's path leads to, links followed: a link keeps pointing where it did.

    Raises:
        InputError: if there is something else than a file, as a device or a pipe.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: must be a file, and is something else.")
    return path


def read_regular(path: Path, most: int, follow: bool = False) -> bytes:
    """The content of a regular file; a pipe or a device, which may never end, is not read.

    Args:
        path: of the file.
        most: bytes that it may have; a larger one is not read.
        follow: whether the name may be a symbolic link.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is no regular file, or larger; the text completes "<file> ...".
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW))
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise ValueError("is not a regular file")
        with open(descriptor, "rb", closefd=False) as file:
            # One more than it may have: it may grow as it is read.
            data = b"" if found.st_size > most else file.read(most + 1)
    finally:
        os.close(descriptor)
    if found.st_size > most or len(data) > most:
        raise ValueError(f"is larger than {most} bytes")
    return data


MOST_DOTS = 200
"""Dots in a line of TOML: the time that a dotted key takes to read grows with the square of their number."""


def check_dots(text: str) -> None:
    """Check that TOML can be read in no time.

    Raises:
        ValueError: naming the line that has too many dots.
    """
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > MOST_DOTS:
            raise ValueError(f"line {number}: must have at most {MOST_DOTS} dots, has {line.count('.')}")


def end_of(path: Path, most: int) -> bytes:
    """The last bytes of a file, `most` at the most, however large it is.

    Raises:
        OSError: if it cannot be read.
    """
    with path.open("rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - most))
        return file.read(most)


WRITE_BYTES = 1 << 20


NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK)


_NO_RIGHT_TO_SYNC = (errno.EACCES, errno.EPERM, errno.EINVAL, errno.ENOTSUP)


def publish(path: Path, data: bytes) -> None:
    """Write a new file durably; it is there, whole, from the moment of os.link on.

    Raises:
        SyncError: if fsync failed.
        StoreError: if the file exists already, or with the system's reason.
    """
    temporary = _write_temporary(path, data)
    try:
        # Unlike a rename, a link fails if the name is taken: it fences a second writer even without the lock.
        os.link(temporary, path)
    except FileExistsError:
        raise StoreError(f"{path} exists already: another writer got there first. Open the folder again.") from None
    except OSError as error:
        hint = " The folder's file system must support hard links." if error.errno in NO_LINKS else ""
        raise StoreError(_refused(path, error) + hint) from error
    finally:
        with suppress(OSError):
            os.unlink(temporary)
    sync_folder(path.parent)


def replace(path: Path, data: bytes) -> None:
    """Write a file durably in the place of an older one, for content that can be rebuilt.

    Raises:
        SyncError: if fsync failed.
        StoreError: with the system's reason; the older file is still there.
    """
    temporary = _write_temporary(path, data)
    try:
        os.replace(temporary, path)
    except OSError as error:
        with suppress(OSError):
            os.unlink(temporary)
        raise StoreError(_refused(path, error)) from error
    sync_folder(path.parent)


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it that are missing, each durable in the one above it before the next is made.

    The nearest one that is there already may have been made a moment ago, by a program that was interrupted: its name
    is made durable too, where the folder above it may be read.

    Raises:
        SyncError: if fsync failed.
        OSError: if one cannot be made.
    """
    missing = not folder.is_dir()
    if missing:
        if folder.parent.is_dir() or not os.path.lexists(folder.parent):
            make_folder(folder.parent)
        try:
            os.mkdir(folder)
        except FileExistsError:
            if not folder.is_dir():
                raise
    try:
        sync_folder(folder.parent)
    except SyncError as error:
        # Whoever made it may have rights above it that we have not.
        if missing or getattr(error.__cause__, "errno", None) not in _NO_RIGHT_TO_SYNC:
            raise


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable.

    Raises:
        SyncError: if that fails.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise SyncError(_unsynced(folder, error)) from error


def _write_temporary(path: Path, data: bytes) -> Path:
    """Write and fsync `data` under a temporary name beside `path`; nothing is left of it if that fails."""
    temporary = temporary_beside(path)
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            _write_all(descriptor, data)
            _sync_file(descriptor, path)
            size = os.fstat(descriptor).st_size
        finally:
            os.close(descriptor)
        if size != len(data):
            raise StoreError(f"Cannot write {path}: {size} bytes are on the disk, {len(data)} were written.")
    except (OSError, StoreError) as error:
        with suppress(OSError):
            os.unlink(temporary)
        if isinstance(error, OSError):
            raise StoreError(_refused(path, error)) from error
        raise
    return temporary


def _write_all(descriptor: int, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        written = os.write(descriptor, rest[:WRITE_BYTES])
        if written == 0:
            raise OSError(errno.EIO, "the system writes nothing more")
        rest = rest[written:]


def _sync_file(descriptor: int, path: Path) -> None:
    try:
        os.fsync(descriptor)
    except OSError as error:
        raise SyncError(_unsynced(path, error)) from error


def _refused(path: Path, error: OSError) -> str:
    return f"Cannot write {path}: {error.strerror or error}. What was there before is whole; resume when it is cured."


def _unsynced(path: Path, error: OSError) -> str:
    if error.errno in (errno.EINVAL, errno.ENOTSUP):
        return (
            f"Cannot make {path} durable: its file system has no fsync ({error.strerror}). Existing data is intact. "
            f"Use a folder on another file system."
        )
    return (
        f"Cannot make {path} durable: {error.strerror or error} (fsync). The disk may be failing, so this run writes "
        f"nothing more; what was acknowledged before is whole. Check the disk, then resume."
    )
