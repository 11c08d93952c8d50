"""The files and folders that a run folder keeps for itself, and whether a path is one of them."""

import errno
import os
from collections.abc import Sequence
from pathlib import Path

from activefail.errors import InputError, StoreError
from activefail.visible import visible

SETTINGS = "campaign.toml"
"""The frozen copy of the settings."""

LARGEST_SETTINGS = 1_000_000
"""Bytes that a frozen copy may have: more than any design space needs, and no burden to read."""

LOCK = ".lock"

FOLDERS = ("segments", "state", "sets")
"""Folders of the record."""

SIMULATIONS = "simulations"
"""Where programs that simulate have their folders."""

COMPARISON = "compare"
"""Where `compare` writes."""

REPORT = "report.html"
"""What `report` writes where it is not told another file."""

_OWN = (SETTINGS, LOCK, REPORT, *FOLDERS, SIMULATIONS, COMPARISON)


def refuse_links(folder: Path, names: Sequence[str] = _OWN) -> None:
    """Check that nothing in a run folder that activefail reads or writes there is a symbolic link.

    A run folder may come from someone else, and a link in it may lead anywhere: what is written, replaced or removed
    by its name would be the user's. Checked once, when the folder is opened: links that come with a folder are refused,
    not someone who changes the folder meanwhile. The run folder itself may be reached through links.

    Args:
        folder: of the run.
        names: of its files, and of its folders, whose entries are looked at too.

    Raises:
        StoreError: naming the link.
    """
    for name in names:
        place = folder / name
        if os.path.islink(place):
            raise _linked(place)
        try:
            with os.scandir(place) as entries:
                link = next((entry.name for entry in entries if entry.is_symlink()), None)
        except OSError as error:
            if error.errno in _NO_FOLDER:
                continue
            raise StoreError(f"Cannot read {place}: {error.strerror or error}.") from error
        if link is not None:
            raise _linked(place / link)


_NO_FOLDER = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG)
"""What the system answers for a folder that is none; what is wrong with it is for its reader to say."""


def _linked(path: Path) -> StoreError:
    return StoreError(
        f"{visible(str(path))} is a symbolic link; activefail follows no links inside a run folder. Replace it with "
        f"the file it points to, or remove it."
    )


def check_output(option: str, path: Path | None) -> None:
    """Check that what is to be written is nothing that a run folder keeps for itself; before anything is done.

    Raises:
        InputError: naming the option and the file.
    """
    if path is None:
        return
    if run_folder_owning(path) is not None:
        raise InputError(f"{option}: {path} is a file of the run folder itself; name another.")
    if (link := link_in_run_folder(path)) is not None:
        raise InputError(f"{option}: {link} is a symbolic link in a run folder, which is not followed; name another.")


def run_folder_owning(path: Path) -> Path | None:
    """The run folder whose own file or folder a path is, or in whose own folder it lies; None if there is none.

    Links are followed, as writing would.
    """
    path = Path(os.path.realpath(path))
    for place in (path, *path.parents):
        folder = place.parent
        if not _is_run_folder(folder):
            continue
        names = (SETTINGS, LOCK, *FOLDERS, SIMULATIONS) if place == path else (*FOLDERS, SIMULATIONS)
        # By the file system, which may not tell capital letters from small ones; by name where there is no file yet.
        if place.name in names or any(_is_same(place, folder / name) for name in names):
            return folder
    return None


def _is_same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:
        return False


def link_in_run_folder(path: Path) -> Path | None:
    """The first symbolic link on the way from a run folder to a path in it; None if there is none."""
    path = path.absolute()
    for folder in reversed(path.parents):
        if _is_run_folder(folder):
            inside = path.relative_to(folder).parts
            ways = (folder.joinpath(*inside[:depth]) for depth in range(1, len(inside) + 1))
            return next((way for way in ways if way.is_symlink()), None)
    return None


def _is_run_folder(folder: Path) -> bool:
    # A campaign file of the user's may be called campaign.toml, too, and a folder beside it simulations.
    return (folder / SETTINGS).is_file() and ((folder / FOLDERS[0]).is_dir() or (folder / LOCK).is_file())
