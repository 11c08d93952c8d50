"""The files and folders that a run folder keeps for itself, and whether a path is one of them."""

import os
from pathlib import Path

SETTINGS = "campaign.toml"
"""The frozen copy of the settings."""

LOCK = ".lock"

FOLDERS = ("segments", "state", "sets")
"""Folders of the record."""

SIMULATIONS = "simulations"
"""Where programs that simulate have their folders."""


def run_folder_owning(path: Path) -> Path | None:
    """The run folder whose own file or folder a path is, or in whose own folder it lies; None if there is none.

    Links are followed, as writing would.
    """
    path = Path(os.path.realpath(path))
    for folder in path.parents:
        name = path.relative_to(folder).parts[0]
        own = path == folder / name if name in (SETTINGS, LOCK) else name in (*FOLDERS, SIMULATIONS)
        if own and _is_run_folder(folder):
            return folder
    return None


def _is_run_folder(folder: Path) -> bool:
    # A campaign file of the user's may be called campaign.toml, too, and a folder beside it simulations.
    return (folder / SETTINGS).is_file() and ((folder / FOLDERS[0]).is_dir() or (folder / LOCK).is_file())
