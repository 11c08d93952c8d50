"""The command that continues a campaign."""

from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.campaign.known_code import known_code
from activefail.visible import quoted


def resume_command(folder: Path, campaign: Campaign | None = None, changes_code: bool = False) -> str:
    """The command that continues a campaign, quoted for a shell, with the folder of the user's code where it is needed.

    It is not needed where activefail remembers it.

    Args:
        folder: the run folder.
        campaign: its campaign; None if it has no custom code. If it was opened without its code and activefail
            remembers none, the command names no folder (see `how_to_continue`).
        changes_code: whether the user changes the code before: functions that have changed must be named.
    """
    command = f"activefail resume {quoted(folder)}"
    if campaign is None or not campaign.settings.needs_code:
        return command
    known = known_code(folder)
    code = known.folder if campaign.code is None and known is not None else campaign.code
    is_known = known is not None and not known.is_changed and known.folder == code
    if code is None or (is_known and not (changes_code and campaign.functions)):
        return command
    return f"{command} --code {quoted(code)}"


def continue_command(folder: Path, campaign: Campaign) -> str:
    """The command that continues a campaign: `ask` if its simulations are made elsewhere, otherwise `resume`."""
    return ask_command(folder, campaign) if campaign.is_elsewhere else resume_command(folder, campaign)


def ask_command(folder: Path, campaign: Campaign) -> str:
    """The command that hands out a batch of designs."""
    return f"activefail ask {quoted(folder)} --n {campaign.settings.sampling.batch} --csv todo.csv"


def how_to_continue(folder: Path, campaign: Campaign) -> str:
    """How to continue a campaign, as a clause; if its code is unknown, with what the command needs."""
    clause = f"`{continue_command(folder, campaign)}` continues it"
    if campaign.settings.needs_code and campaign.code is None and known_code(folder) is None:
        clause += ", with --code and the folder of the custom code"
    return clause
