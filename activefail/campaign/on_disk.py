"""Campaigns on disk: read a campaign file; create and open a run folder, with its record."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.campaign.provenance import provenance
from activefail.campaign.settings import read_settings
from activefail.errors import InputError, StoreError, naming
from activefail.record.layout import JOURNAL, SETTINGS, check_run_folder
from activefail.record.run_folder import FolderStore
from activefail.text.files import writing_to
from activefail.text.toml import read_toml


def read_campaign(
    path: Path,
    seed: int | None = None,
    budget: int | None = None,
    *,
    code: Path | None = None,
    run: Path | None = None,
    features: bool = True,
    frozen: bool = False,
) -> Campaign:
    """Read the campaign of a file.

    Args:
        path: the campaign file.
        seed, budget: replace those of the file.
        code, run, features: see `Campaign.of`.
        frozen: whether the file is that of a run folder whose features were checked when it was created.
    """
    settings = read_settings(path, seed, budget)
    with naming(f"{path}: "):
        return Campaign.of(settings, code, run, custom_features=features, check_features=not frozen)


def create_folder(folder: Path, campaign: Campaign) -> FolderStore:
    """Create a run folder for a campaign, open for writing.

    Raises:
        BusyError, StoreError: as `FolderStore.create` does.
    """
    return FolderStore.create(
        folder,
        campaign.settings.text(),
        campaign.schema,
        provenance=provenance(campaign.settings.used) | campaign.sources,
        decisive=campaign.decisive,
    )


def opened(folder: Path, write: bool, code: Path | None = None, features: bool = True) -> tuple[Campaign, FolderStore]:
    """Open a run folder: its campaign and its record.

    Args:
        folder: the run folder.
        write: make this process the only writer.
        code: folder of the user's code, which is executed (see `Campaign.of`).
        features: whether features that are a Python function are needed; counting outcomes does not need them.

    Raises:
        InputError: if the folder holds no campaign or its settings are invalid.
        StoreError: if the record cannot be read.
        BusyError: if another process is writing to it.
    """
    check_run_folder(folder)
    campaign = read_campaign(folder / SETTINGS, code=code, run=folder, features=features, frozen=True)
    store = FolderStore.open(
        folder,
        campaign.schema,
        write=write,
        provenance=provenance(campaign.settings.used) | campaign.sources,
        decisive=campaign.decisive,
    )
    designs = store.asked.designs
    # With a tolerance: bounds that the file leaves out are computed, on another machine perhaps in other last digits.
    low, high = campaign.space.low, campaign.space.high
    slack = 1e-9 * (high - low)
    is_asked = ((low - slack <= designs) & (designs <= high + slack)).all()  # false for NaN too
    if not (is_asked and all(campaign.space.reaches(batch.designs).all() for batch in store.batches)):
        store.close()
        raise StoreError(f"{folder / JOURNAL} lists designs outside the design space; restore it from a copy.")
    return campaign, store


@contextmanager
def open_campaign(
    folder: Path, write: bool, code: Path | None = None, features: bool = True
) -> Iterator[tuple[Campaign, FolderStore]]:
    """Like `opened`, as a context manager that closes the record."""
    campaign, store = opened(folder, write, code, features)
    with store:
        yield campaign, store


FOLDER = "campaigns"


def shipped_folder() -> Path:
    """The folder of the shipped campaigns: in the installed package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
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
