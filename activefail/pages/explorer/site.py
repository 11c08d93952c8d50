"""The site of one campaign: the page of one design, and the pages of plug-ins for campaigns like it."""

from functools import cached_property
from typing import Any

from activefail.analyses.findings.results import Findings
from activefail.pages.explorer.campaign import OneDesign, Slow
from activefail.pages.explorer.jobs import Jobs
from activefail.pages.explorer.pages import CampaignPage, Panel
from activefail.plugins import brought


class CampaignSite:
    """The pages of a campaign; implements `Site`.

    Attributes:
        one: the page of one design.
    """

    def __init__(self, findings: Findings, slow: Slow, jobs: Jobs, home: str = "") -> None:
        self.one, self._jobs, space = OneDesign(findings, slow), jobs, findings.campaign.space
        offered = {path: of(space) for path, of in brought("explorer_pages").items()}
        self._offered = {path: one for path, one in offered.items() if one is not None}
        self._links: dict[str, Any] = {"home": home, "others": {path: one[0] for path, one in self._offered.items()}}

    @cached_property
    def others(self) -> dict[str, CampaignPage]:
        """The pages of plug-ins, by path."""
        return {path: make(self.one, self._jobs) for path, (_, make) in self._offered.items()}

    @cached_property
    def _first(self) -> str:
        return self.one.page(**self._links)

    def page(self, path: str) -> str | None:
        """As `Site.page`."""
        if path == "/":
            return self._first
        return self.others[path[1:]].page(**self._links) if path[1:] in self._offered else None

    def panel(self, name: str) -> Panel | None:
        """As `Site.panel`."""
        if name in self.one.panels:
            return self.one.panels[name]
        return next((page.panels[name] for page in self.others.values() if name in page.panels), None)

    def below(self, name: str, anew: bool) -> None:
        """As `Site.below`: none."""
