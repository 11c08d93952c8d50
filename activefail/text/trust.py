"""The rules for what comes from someone else, and where each is enforced; here: sizes and links of files.

- **Code** runs only from a folder that the user names, or named before for the same run folder, and never from the run
  folder itself (`simulators.user_code`, `campaign.known_code`). Nothing is unpickled, and expressions are parsed
  (`expressions`). No library reads settings in the current folder (`current_folder`).
- **Folders of records** that a run folder names are read where code would run (`motions`).
- **Links** in a run folder are refused once, when it is opened (`refuse_links`); a table that a
  hazard or a campaign file names lies in its folder (`path_beside`). A path that the user names may be a link.
- **Sizes** are bounded where bytes enter: a file of a run folder or of a record by `read_regular`, TOML by its reader,
  a table that comes with a hazard or with records by its rows; a table of designs is read in parts (`csv_table`).
- **Text** leaves with its control characters escaped: errors by themselves (`errors.ActivefailError`), all output of a
  command by `screen`, and foreign text in a line of the program by `visible`.
"""

import os
import stat
from collections.abc import Sequence
from pathlib import Path

from activefail.errors import InputError, StoreError


def read_regular(path: Path, most: int, follow: bool = False, private: bool = False) -> bytes:
    """The content of a regular file; pipes and devices, which may never end, are refused.

    Args:
        path: path of the file.
        most: most bytes; a larger file is not read.
        follow: whether to follow a symbolic link.
        private: whether to refuse a file that another user owns or may write.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is not a regular file, too large or not private; the text completes "<file> ...".
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW))
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ValueError("is not a regular file")
        if private and (status.st_uid != os.geteuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
            raise ValueError("is not a file that only this user may write")
        with open(descriptor, "rb", closefd=False) as file:
            # One byte more than allowed: the file may grow meanwhile.
            data = b"" if status.st_size > most else file.read(min(most, max(status.st_size, 1 << 20)) + 1)
    finally:
        os.close(descriptor)
    if status.st_size > most or len(data) > most:
        raise ValueError(f"is larger than {most} bytes")
    return data


def path_beside(folder: Path, name: str, of: str) -> Path:
    """The path of a file that another one, `of`, names: it may come from someone else, and messages quote cells.

    Raises:
        InputError: if it is not in the folder.
    """
    path = folder / name
    if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise InputError(f"must be a file in the folder of the {of}, got {name!r}.")
    return path


def refuse_links(folder: Path, names: Sequence[str]) -> None:
    """Check that no file or folder that activefail uses in a run folder is a symbolic link.

    Writing through a link could replace or remove the user's files. The check runs once, when the folder is opened: it
    covers links that come with a folder, not later changes. The path to the run folder itself may contain links.

    Args:
        folder: the run folder.
        names: its files, and its folders, whose entries are checked too.

    Raises:
        StoreError: naming the link.
    """
    for name in names:
        paths = [folder / name]
        if os.path.isdir(paths[0]) and not os.path.islink(paths[0]):
            try:
                paths += sorted(paths[0].iterdir())
            except OSError as error:
                raise StoreError(f"Cannot read {paths[0]}: {error.strerror or error}.") from error
        for path in filter(os.path.islink, paths):
            raise StoreError(
                f"{path} is a symbolic link; activefail follows no links inside a run folder. Replace it "
                "with the file it points to."
            )
