"""The files and folders reserved in a run folder."""

import os
from pathlib import Path

from activefail.errors import InputError, StoreError
from activefail.text.trust import refuse_links

SETTINGS = "campaign.toml"
"""The frozen copy of the settings."""

LARGEST_SETTINGS = 1_000_000
"""Most bytes in a frozen copy: more than any design space needs, yet quick to read."""

JOURNAL = "journal"
"""All events of the record."""

QUARANTINE = "journal.quarantine"
"""Where entries go that a crash has cut."""

CHECKPOINT = "checkpoint.h5"
"""The simulations as columns and the last states; it can be made again."""

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

RESERVED = (SETTINGS, JOURNAL, QUARANTINE, CHECKPOINT, REPORT, SIMULATIONS, COMPARISON)
"""What activefail reads and writes in a run folder."""


def check_run_folder(folder: Path) -> None:
    """Check that a folder may be a run folder.

    Raises:
        InputError: if it has no settings, or too long ones.
        StoreError: if it has symbolic links, or is one of version 0.1.
    """
    path = folder / SETTINGS
    refuse_links(folder, RESERVED)
    refuse_format_1(folder)
    if not os.path.isfile(path):
        reason = "it is a file" if folder.is_file() else f"it has no {SETTINGS}"
        raise InputError(f"{folder}: is not a run folder; {reason}.")
    if path.stat().st_size > LARGEST_SETTINGS:
        raise InputError(f"{path}: must have at most {LARGEST_SETTINGS} bytes, has {path.stat().st_size}.")


def refuse_format_1(folder: Path) -> None:
    """Raise StoreError for a run folder of version 0.1, with the way over."""
    if os.path.isdir(folder / "segments") and not os.path.exists(folder / JOURNAL):
        raise StoreError(
            f"{folder} was written by activefail 0.1. Continue it with that version (`activefail resume`), or move its "
            "simulations to a new campaign: `activefail export` there, `activefail add` here."
        )


def check_output(option: str, path: Path | None) -> None:
    """Check, before any work, that an output path is not reserved by a run folder."""
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
        names = (SETTINGS, JOURNAL, QUARANTINE, CHECKPOINT, SIMULATIONS) if candidate == path else (SIMULATIONS,)
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
    return (folder / SETTINGS).is_file() and (folder / JOURNAL).is_file()
