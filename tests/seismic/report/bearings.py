"""Pages of campaigns on the bearing."""

from report.test_report import SCRIPT, TINY

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings


def settings(features: str = "paper", budget: int = 30, description: str = SCRIPT, extra: str = "") -> Campaign:
    """A small campaign over the paper's variables, with a hostile name."""
    text = TINY.format(features=features, budget=budget, description=description, extra=extra)
    return Campaign.of(parse_settings(text, "tiny"))
