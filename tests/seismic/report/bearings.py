"""Pages of campaigns on the bearing."""

from collections.abc import Iterator
from contextlib import contextmanager

from report.pictures import slow_pictures_empty
from report.test_report import SCRIPT, TINY

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.seismic.views import bearing


def settings(features: str = "paper", budget: int = 30, description: str = SCRIPT, extra: str = "") -> Campaign:
    """A small campaign over the paper's variables, with a hostile name."""
    text = TINY.format(features=features, budget=budget, description=description, extra=extra)
    return Campaign.of(parse_settings(text, "tiny"))


@contextmanager
def slow_pictures_of_bearings_empty() -> Iterator[None]:
    """Leave those pictures empty that take most of a page's time, those of bearings too."""
    with slow_pictures_empty((bearing, "plot_snapshots")):
        yield
