"""A campaign found again in its run folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from activefail.campaign.campaign import Campaign
from activefail.campaign.config import read_settings
from activefail.campaign.provenance import provenance
from activefail.campaign.store import FolderStore
from activefail.errors import InputError


@contextmanager
def open_campaign(folder: Path, write: bool) -> Iterator[tuple[Campaign, FolderStore]]:
    """The campaign of a run folder and its record; with `write`, this process becomes its only writer.

    Raises:
        InputError: if there is no campaign in the folder or its settings are not valid.
        StoreError: if the record cannot be read.
        BusyError: if another process is writing to it.
    """
    path = folder / "campaign.toml"
    if not path.is_file():
        raise InputError(f"{folder}: is not a run folder; there is no campaign.toml in it.")
    campaign = Campaign.of(read_settings(path))
    with FolderStore.open(folder, campaign.schema, write=write, provenance=provenance()) as store:
        yield campaign, store
