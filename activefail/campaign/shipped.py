"""The campaigns that come with activefail, by name: `paper` stands for the file paper.toml."""

import shutil
from pathlib import Path

import activefail
from activefail.campaign.settings import read_toml
from activefail.errors import InputError
from activefail.files import writing_to

FOLDER = "campaigns"


def shipped_folder() -> Path:
    """The folder of the shipped campaigns: in the installed package, or beside it in a checkout."""
    package = Path(activefail.__file__).parent
    installed = package / FOLDER
    return installed if installed.is_dir() else package.parent / FOLDER


def shipped_campaigns() -> dict[str, Path]:
    """The shipped campaign files, by name."""
    return {file.stem: file for file in sorted(shipped_folder().glob("*.toml"))}


def description_of(file: Path) -> str:
    """The description in a campaign file.

    Raises:
        InputError: if the file cannot be read.
    """
    return str(read_toml(file).get("description", ""))


def campaign_file(name_or_path: Path) -> Path:
    """The campaign file that a user means: a file, or else the shipped campaign of this name.

    A file of the user takes precedence.

    Raises:
        InputError: if a name without a suffix is neither.
    """
    if name_or_path.suffix or name_or_path.name != str(name_or_path) or name_or_path.exists():
        return name_or_path
    shipped = shipped_campaigns()
    if name_or_path.name not in shipped:
        raise InputError(f"{name_or_path}: is neither a campaign file nor a shipped campaign ({', '.join(shipped)}).")
    return shipped[name_or_path.name]


def copy_shipped(folder: Path) -> list[Path]:
    """Copy the shipped campaigns, with their code and hazards, into a new folder; returns the copies.

    Raises:
        InputError: if the folder exists, or cannot be written.
    """
    if folder.exists():
        raise InputError(f"{folder}: exists already; name a new folder.")
    with writing_to(folder):
        shutil.copytree(shipped_folder(), folder, ignore=shutil.ignore_patterns("__pycache__"))
    return sorted(path for path in folder.rglob("*") if path.is_file())
