"""Durable writes: a new file gets its name only once it is complete and on the disk."""

import errno
import os
import re
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

from activefail.errors import InputError, StoreError, SyncError

TEMPORARY = ".tmp-"
"""Prefix of an unfinished file of a record; the holder of the run folder's lock may remove it (`is_temporary`)."""

_NEW = ".new-"
"""Prefix of any other unfinished file, which may also be in a run folder, but without a lock."""

WRITE_BYTES = 1 << 20
"""Most bytes in one system call that writes."""

_NO_RIGHT_TO_SYNC = (errno.EACCES, errno.EPERM, errno.EINVAL, errno.ENOTSUP)
"""The system's errors where a folder cannot be synchronised, whatever the disk."""


def as_path(file: Any) -> Any:
    """The path that a string or another library's path names; anything else is returned unchanged."""
    return Path(os.fsdecode(file)) if isinstance(file, str | os.PathLike) else file


def path_of(name: str, file: Any) -> Path:
    """A file in an argument."""
    if not isinstance(file := as_path(file), Path):
        raise InputError(f"{name}: must be a path, got {type(file).__name__}.")
    return file


def temporary_next_to(path: Path, prefix: str = TEMPORARY) -> Path:
    """A new name in the folder of a path; short, because the path's name may have the maximal length."""
    return path.with_name(f"{prefix}{secrets.token_hex(8)}")


def is_temporary(name: str) -> bool:
    """Whether a file of this name is an unfinished file of a record; other names are the user's."""
    return re.fullmatch(rf"{re.escape(TEMPORARY)}[0-9a-f]{{16}}", name) is not None


@contextmanager
def replacing(path: Path, mode: Literal["x", "xb"] = "x") -> Iterator[IO[Any]]:
    """A new file, UTF-8 if text, that gets its name at the end of the block and is removed if the block fails.

    An older file of this name is not modified: other hard links to it keep their content.

    Raises:
        OSError: if the file cannot be written.
    """
    temporary = temporary_next_to(path, _NEW)
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
    """Name the file or folder in errors of writing.

    Raises:
        InputError: in place of OSError.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from None


def check_file(path: Path | None, what: str, suffixes: Sequence[str]) -> None:
    """Check that an output file has an existing folder and one of these suffixes; None is not checked."""
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: the folder {path.absolute().parent} does not exist.")
    if path.suffix.lower() not in suffixes:
        *others, last = suffixes
        known = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{path}: the name of {what} must end in {known}.")


def target_of(path: Path) -> Path:
    """The target of a user's path, with links followed, so that writing does not replace a link.

    Raises:
        InputError: if the target is neither a file nor a folder, such as a device or a pipe.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: must be a file, not a device or a pipe.")
    return path


def end_of(path: Path, most: int) -> bytes:
    """The last bytes of a file, at most `most`.

    Raises:
        OSError: if the file cannot be read.
    """
    with path.open("rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - most))
        return file.read(most)


def replace(path: Path, data: bytes, check: Callable[[], None] = lambda: None) -> None:
    """Write a file durably; it appears as a whole, in place of an older one.

    Args:
        path: path of the file.
        data: its content.
        check: called between the writing and the rename; may raise StoreError. If it checks that the folder is still
            the right one, no file appears in another folder: there the temporary file does not exist.

    Raises:
        SyncError: if fsync failed.
        StoreError: if the file cannot be written; the older one remains.
    """
    temporary = temporary_next_to(path)
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            write_all(descriptor, data)
            sync_file(descriptor, path)
            size = os.fstat(descriptor).st_size
        finally:
            os.close(descriptor)
        if size != len(data):
            raise StoreError(f"Cannot write {path}: {size} bytes are on the disk, {len(data)} were written.")
        check()
        os.replace(temporary, path)
    except (OSError, StoreError) as error:
        with suppress(OSError):
            os.unlink(temporary)
        if isinstance(error, OSError):
            raise StoreError(refused(path, error)) from error
        raise
    sync_folder(path.parent)


def make_folder(folder: Path) -> None:
    """Create a folder and its missing parents, each durable in its parent before the next is created.

    The nearest existing folder may come from a program that was interrupted a moment ago: its name is made durable too,
    if its parent is readable.

    Raises:
        SyncError: if fsync failed.
        OSError: if a folder cannot be created.
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
        # An existing folder may lie in one that this user cannot sync.
        if missing or getattr(error.__cause__, "errno", None) not in _NO_RIGHT_TO_SYNC:
            raise


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable.

    Raises:
        SyncError: if fsync failed.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise SyncError(_unsynced(folder, error)) from error


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of some bytes to an open file.

    Raises:
        OSError: if the system does not take them; a part may be written.
    """
    rest = memoryview(data)
    while rest:
        written = os.write(descriptor, rest[:WRITE_BYTES])
        if written == 0:
            raise OSError(errno.EIO, "the system accepted no more bytes")
        rest = rest[written:]


def sync_file(descriptor: int, path: Path) -> None:
    """Make the content of an open file durable.

    Raises:
        SyncError: if the system cannot.
    """
    try:
        os.fsync(descriptor)
    except OSError as error:
        raise SyncError(_unsynced(path, error)) from error


def refused(path: Path, error: OSError) -> str:
    """The message for a file that cannot be written."""
    return f"Cannot write {path}: {error.strerror or error}. Existing data is intact. Fix the problem, then resume."


def _unsynced(path: Path, error: OSError) -> str:
    if error.errno in (errno.EINVAL, errno.ENOTSUP):
        return (
            f"Cannot make {path} durable: its file system has no fsync ({error.strerror}). Existing data is intact. "
            f"Use a folder on another file system."
        )
    return (
        f"Cannot make {path} durable: {error.strerror or error} (fsync). The disk may be failing, so this run writes "
        f"nothing more. Batches that were committed before are intact. Check the disk, then resume."
    )
