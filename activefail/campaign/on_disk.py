"""Campaigns on disk: read a campaign file; create and open a run folder, with its record."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.campaign.provenance import provenance
from activefail.campaign.settings import read_settings
from activefail.errors import StoreError, naming
from activefail.record.layout import JOURNAL, SETTINGS, check_run_folder
from activefail.record.run_folder import FolderStore


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

    Raises:
        InputError: naming the file and the rule, if the file is unreadable, invalid or inconsistent.
    """
    settings = read_settings(path).with_overrides(seed, budget)
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
        provenance=provenance() | campaign.sources,
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
        provenance=provenance() | campaign.sources,
        decisive=campaign.decisive,
    )
    designs = store.asked.designs
    # With a tolerance: bounds that the file leaves out are computed, on another machine perhaps in other last digits.
    low, high = campaign.space.low, campaign.space.high
    slack = 1e-9 * (high - low)
    if not ((low - slack <= designs) & (designs <= high + slack)).all():  # false for NaN too
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
