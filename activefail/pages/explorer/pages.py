"""What a site of the explorer is: pages, and the panels on them.

A page is a form. A panel is a part of it that the server makes from the form's values: `page.js` sends the form and
shows the HTML that comes back, whenever a field changes, when a button is pressed, or after a while.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Protocol

from markupsafe import Markup

from activefail.pages.explorer.fields import Values
from activefail.pages.report.environment import page_environment
from activefail.version import __version__

Panel = Callable[[Values], str]
"""Makes HTML from a form; raises InputError if a value is invalid."""


_PACKAGE = "activefail.pages.explorer"

_templates = cache(page_environment)


def page(name: str, package: str = _PACKAGE, **values: Any) -> Markup:
    """Render the template of a page or of a panel, from a package that may extend the explorer's templates."""
    template = _templates(*dict.fromkeys((package, _PACKAGE))).get_template(f"{name}.html.j2")
    return Markup(template.render({"version": __version__, "home": "", "others": {}} | values))


class CampaignPage(Protocol):
    """A page of a campaign that a plug-in brings; thread-safe."""

    def page(self, **links: Any) -> str:
        """The page, with its links to others."""

    @property
    def panels(self) -> Mapping[str, Panel]:
        """Its panels by name."""


class Site(Protocol):
    """Pages and panels; thread-safe."""

    def page(self, path: str) -> str | None:
        """The page at a path such as "/"; None if there is none. Raises InputError, StoreError."""

    def panel(self, name: str) -> Panel | None:
        """The panel with this name; None if there is none. Raises InputError, StoreError."""

    def below(self, name: str, anew: bool) -> "Site | None":
        """The site of a campaign in the folder of this one, None if there is none; `anew`, if its record has changed.

        Raises InputError, StoreError.
        """
