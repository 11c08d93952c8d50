"""The site of one campaign: the page of one design, and the page Design where it has a pulse and a capacity."""

from functools import cached_property
from typing import TYPE_CHECKING, Any

from activefail.analyses.findings.results import Findings
from activefail.campaign.hazard import has_hazards
from activefail.pages.explorer.campaign import OneDesign, Slow
from activefail.pages.explorer.jobs import Jobs
from activefail.pages.explorer.pages import Panel
from activefail.seismic.hazard.hazard import CAPACITY

if TYPE_CHECKING:
    from activefail.pages.explorer.design import DesignPage


class CampaignSite:
    """The pages of a campaign; implements `Site`.

    Attributes:
        one: the page of one design.
        has_design: whether there is the page Design.
    """

    def __init__(self, findings: Findings, slow: Slow, jobs: Jobs, home: str = "") -> None:
        self.one, self._jobs, space = OneDesign(findings, slow), jobs, findings.campaign.space
        has_capacity = any(one.name == CAPACITY and not one.choices for one in space.parameters)
        self.has_design = has_capacity and has_hazards(space)
        self._links: dict[str, Any] = {"home": home, "has_design": self.has_design}

    @cached_property
    def design(self) -> "DesignPage":
        """The page Design."""
        from activefail.pages.explorer.design import DesignPage  # it loads torch

        return DesignPage(self.one, self._jobs)

    @cached_property
    def _first(self) -> str:
        return self.one.page(**self._links)

    def page(self, path: str) -> str | None:
        """As `Site.page`."""
        if path == "/design" and self.has_design:
            return self.design.page(**self._links)
        return self._first if path == "/" else None

    def panel(self, name: str) -> Panel | None:
        """As `Site.panel`."""
        if name in ("required", "verify"):
            return self.design.panels[name] if self.has_design else None
        return self.one.panels.get(name)

    def below(self, name: str, anew: bool) -> None:
        """As `Site.below`: none."""
