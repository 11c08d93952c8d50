"""A campaign found again in its run folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.campaign.provenance import provenance
from activefail.campaign.settings import read_settings
from activefail.errors import InputError
from activefail.record.layout import LARGEST_SETTINGS, SETTINGS, refuse_links
from activefail.record.run_folder import FolderStore


def read_campaign(
    path: Path,
    seed: int | None = None,
    budget: int | None = None,
    *,
    code: Path | None = None,
    run: Path | None = None,
    features: bool = True,
) -> Campaign:
    """The campaign of a file, with a command line's seed and budget instead of its own where they are given.

    Args:
        path: of the file.
        seed, budget: of the command line.
        code, run, features: see `Campaign.of`.

    Raises:
        InputError: naming the file and the rule, if the file cannot be read, is not valid, or its pieces do not fit.
    """
    settings = read_settings(path).with_overrides(seed, budget)
    try:
        return Campaign.of(settings, code, run, custom_features=features)
    except InputError as unfit:
        raise InputError(f"{path}: {unfit}") from None


def create_folder(folder: Path, campaign: Campaign) -> FolderStore:
    """A new run folder for a campaign, open for writing.

    Raises:
        BusyError, StoreError: as `FolderStore.create` does.
    """
    return FolderStore.create(
        folder, campaign.settings.text(), campaign.schema, provenance=provenance() | campaign.sources
    )


def opened(folder: Path, write: bool, code: Path | None = None, features: bool = True) -> tuple[Campaign, FolderStore]:
    """The campaign of a run folder and its record; with `write`, this process becomes its only writer.

    Args:
        folder: of the run.
        write: whether to.
        code: folder of the user's code, which is then run (see `Campaign.of`).
        features: whether they are needed; who only counts does without those that are a function of the user's.

    Raises:
        InputError: if there is no campaign in the folder or its settings are not valid.
        StoreError: if the record cannot be read.
        BusyError: if another process is writing to it.
    """
    path = folder / SETTINGS
    refuse_links(folder)
    if not path.is_file():
        raise InputError(f"{folder}: is not a run folder; there is no campaign.toml in it.")
    if path.stat().st_size > LARGEST_SETTINGS:  # before it is parsed
        raise InputError(f"{path}: must have at most {LARGEST_SETTINGS} bytes, has {path.stat().st_size}.")
    campaign = read_campaign(path, code=code, run=folder, features=features)
    return campaign, FolderStore.open(folder, campaign.schema, write=write, provenance=provenance() | campaign.sources)


@contextmanager
def open_campaign(
    folder: Path, write: bool, code: Path | None = None, features: bool = True
) -> Iterator[tuple[Campaign, FolderStore]]:
    """The same, for a block that closes the record at its end."""
    campaign, store = opened(folder, write, code, features)
    with store:
        yield campaign, store
