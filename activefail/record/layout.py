"""The files and folders reserved in a run folder, and the refusal of symbolic links among them."""

import errno
import os
from collections.abc import Sequence
from pathlib import Path

from activefail.errors import InputError, StoreError
from activefail.visible import visible

SETTINGS = "campaign.toml"
"""The frozen copy of the settings."""

LARGEST_SETTINGS = 1_000_000
"""Most bytes in a frozen copy: more than any design space needs, yet quick to read."""

LOCK = ".lock"

SEGMENTS, STATES, SETS = "segments", "state", "sets"
FOLDERS = (SEGMENTS, STATES, SETS)
"""Folders of the record: batches, saved states, and sets of designs outside the budget."""

ASKED = "asked.h5"
"""The designs that were handed out to be simulated elsewhere."""

CORRECTIONS = "corrections.h5"
"""The results that replaced others."""

SIMULATIONS = "simulations"
"""The folder in which custom programs run."""

COMPARISON = "compare"
"""The folder to which `compare` writes."""

SCORES = "scores.csv"
"""The table of a comparison."""

CURVES = "learning_curves"
"""The picture of a comparison, without its suffix."""

REPORT = "report.html"
"""The default output of `report`."""

ESTIMATE = "probability.json"
"""The last estimate of `probability`, for readers that do not repeat it."""

DESIGNS = "designs.json"
"""Where the simulations of verified designs are, for readers that do not repeat the search."""

_RESERVED = (SETTINGS, LOCK, ASKED, CORRECTIONS, REPORT, ESTIMATE, DESIGNS, *FOLDERS, SIMULATIONS, COMPARISON)


def state_file(folder: Path, iteration: int) -> Path:
    """The file of the state saved after an iteration."""
    return folder / STATES / f"{iteration:09d}.h5"


def set_file(folder: Path, name: str) -> Path:
    """The file of a part of a set."""
    return folder / SETS / f"{name}.h5"


def refuse_links(folder: Path, names: Sequence[str] = _RESERVED) -> None:
    """Check that no file or folder that activefail uses in a run folder is a symbolic link.

    A run folder may come from someone else, and writing through a link in it could replace or remove the user's files.
    The check runs once, when the folder is opened: it covers links that come with a folder, not later changes. The path
    to the run folder itself may contain links.

    Args:
        folder: the run folder.
        names: its files, and its folders, whose entries are checked too.

    Raises:
        StoreError: naming the link.
    """
    for name in names:
        path = folder / name
        if os.path.islink(path):
            raise _link_error(path)
        try:
            with os.scandir(path) as entries:
                link = next((entry.name for entry in entries if entry.is_symlink()), None)
        except OSError as error:
            if error.errno in _NO_FOLDER:
                continue
            raise StoreError(f"Cannot read {path}: {error.strerror or error}.") from error
        if link is not None:
            raise _link_error(path / link)


_NO_FOLDER = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG)
"""The system's errors for a path that is not a folder; its reader reports what is wrong with it."""


def _link_error(path: Path) -> StoreError:
    # Without these files the record would have other results.
    removing = "" if path.name in (ASKED, CORRECTIONS) else ", or remove it"
    return StoreError(
        f"{visible(str(path))} is a symbolic link; activefail follows no links inside a run folder. Replace it with "
        f"the file it points to{removing}."
    )


def check_output(option: str, path: Path | None) -> None:
    """Check, before any work, that an output path is not reserved by a run folder.

    Raises:
        InputError: naming the option and the file.
    """
    if path is None:
        return
    if run_folder_owning(path) is not None:
        raise InputError(f"{option}: {path} is one of the run folder's own files; choose another.")
    if (link := link_in_run_folder(path)) is not None:
        raise InputError(
            f"{option}: {link} is a symbolic link in a run folder. No such link is followed; choose another path."
        )


def run_folder_owning(path: Path) -> Path | None:
    """The run folder that reserves a path, or a folder that contains it; None if there is none.

    Links are followed, as writing would.
    """
    path = Path(os.path.realpath(path))
    for candidate in (path, *path.parents):
        folder = candidate.parent
        if not _is_run_folder(folder):
            continue
        names = (
            (SETTINGS, LOCK, ASKED, CORRECTIONS, *FOLDERS, SIMULATIONS)
            if candidate == path
            else (*FOLDERS, SIMULATIONS)
        )
        # Compare through the file system, which may ignore case; by name if the file does not exist yet.
        if candidate.name in names or any(_is_same(candidate, folder / name) for name in names):
            return folder
    return None


def _is_same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:
        return False


def link_in_run_folder(path: Path) -> Path | None:
    """The first symbolic link between a run folder and a path in it; None if there is none."""
    path = path.absolute()
    for folder in reversed(path.parents):
        if _is_run_folder(folder):
            inside = path.relative_to(folder).parts
            steps = (folder.joinpath(*inside[:depth]) for depth in range(1, len(inside) + 1))
            return next((step for step in steps if step.is_symlink()), None)
    return None


def _is_run_folder(folder: Path) -> bool:
    # A user's campaign file may also be named campaign.toml, next to a folder named simulations.
    return (folder / SETTINGS).is_file() and ((folder / FOLDERS[0]).is_dir() or (folder / LOCK).is_file())
