"""Files that have their names only once they are whole, and files that are read without trust in their names."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

from activefail.errors import InputError

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


def end_of(path: Path, most: int) -> bytes:
    """The last bytes of a file, `most` at the most, however large it is.

    Raises:
        OSError: if it cannot be read.
    """
    with path.open("rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - most))
        return file.read(most)
