"""What `activefail status` shows: the summary of a run folder and the command that continues it."""

import math
from dataclasses import dataclass
from pathlib import Path

from activefail.errors import DamagedError, StoreError
from activefail.files import read_regular
from activefail.findings.choices import sentence
from activefail.findings.summary import Summary, is_verified, read_summary
from activefail.record.attachments import decode_state
from activefail.record.layout import state_file
from activefail.shares import lognormal_interval
from activefail.visible import quoted, visible

_LARGEST_STATE = 100_000_000
"""Largest state that is read [bytes]."""


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
        title = visible(self.summary.settings.description or self.folder.name)
        return [("campaign", title), *self.summary.lines, *self.learned]

    @property
    def learned(self) -> list[tuple[str, str]]:
        """Titles and texts of what is learned from margins, from the state of the last iteration; empty without it."""
        summary, lines = self.summary, []
        path = state_file(self.folder, summary.iteration)
        try:
            state = decode_state(read_regular(path, _LARGEST_STATE), summary.iteration, {summary.digest})
            for outcome in summary.outcomes[1:]:
                margin, _, *scores, _ = state[f"{outcome}/choice"].tolist()
                name = "" if margin < 0 else summary.margins[int(margin)]
                if text := sentence(outcome, name, *scores):
                    lines.append(("learned", text))
            if "stop/looks" in state:
                _, probability, sd, error = state["stop/looks"][-1].tolist()
                low, high = lognormal_interval(probability, math.hypot(sd, error))
                seen = all(summary.counts[:-1])
                interval = f"95 % interval {low:.2g} to {high:.2g}" if seen else "without an interval"
                if int(state["stop/known"]):
                    lines.append(("stop rule", "met; `activefail resume` with --ignore-stop continues"))
                lines.append(
                    (
                        "estimate",
                        f"probability {probability:.3g} under the classifier, {interval}; "
                        "`activefail probability` estimates it from fresh simulations",
                    )
                )
        except (OSError, LookupError, ValueError, TypeError, StoreError, DamagedError, ArithmeticError):
            # No state yet, without choices, or not this record's: the next writer will make one.
            return []
        return lines

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
