"""What `activefail status` shows: the summary of a run folder and the command that continues it."""

from dataclasses import dataclass
from pathlib import Path

from activefail.findings.summary import Summary, is_verified, read_summary
from activefail.visible import quoted, visible


@dataclass(frozen=True)
class Status:
    """The state of a run folder.

    Attributes:
        folder: the run folder.
        summary: of its campaign.
        warnings: of its record; empty if it is intact.
    """

    folder: Path
    summary: Summary
    warnings: tuple[str, ...] = ()

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Titles and texts, the campaign's description first."""
        return [("campaign", visible(self.summary.settings.description or self.folder.name)), *self.summary.lines]

    @property
    def continuation(self) -> list[tuple[str, str]]:
        """Titles and texts of how to continue; empty once the budget is spent."""
        settings = self.summary.settings
        if self.summary.done >= settings.budget:
            return []
        command = f"activefail resume {quoted(self.folder)}{' --code FOLDER' if settings.custom_code else ''}"
        lines = [("continue", command)]
        if is_verified(self.folder, self.summary):
            lines.append(("", f"{command} --ignore-stop, if it ended by its stop rule"))
        return lines


def read_status(folder: Path) -> Status:
    """The status of a run folder; safe while the campaign runs.

    Opens the record only if the summary cannot be read without it (see `read_summary`).

    Raises:
        InputError: if the folder holds no campaign or its settings are invalid.
        StoreError: if the record cannot be read.
    """
    if (summary := read_summary(folder)) is not None:
        return Status(folder, summary)
    from activefail.campaign.opening import open_campaign

    with open_campaign(folder, write=False, features=False) as (campaign, store):
        warnings = store.new_warnings()
        return Status(
            folder, Summary.of(campaign.settings.text(), campaign.simulator.outcomes, store.batches), warnings
        )
