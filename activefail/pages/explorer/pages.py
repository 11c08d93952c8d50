"""What a site of the explorer is: pages, and the panels on them.

A page is a form. A panel is a part of it that the server makes from the form's values: `page.js` sends the form and
shows the HTML that comes back, whenever a field changes, when a button is pressed, or after a while.
"""

from collections.abc import Callable
from typing import Any, Protocol

from markupsafe import Markup

from activefail.pages.explorer.fields import Values
from activefail.pages.report.environment import page_environment
from activefail.version import __version__

Panel = Callable[[Values], str]
"""Makes HTML from a form; raises InputError if a value is invalid."""


_TEMPLATES = page_environment("activefail.pages.explorer")


def page(name: str, **values: Any) -> Markup:
    """Render the template of a page or of a panel."""
    return Markup(
        _TEMPLATES.get_template(f"{name}.html.j2").render(
            {"version": __version__, "home": "", "has_design": False} | values
        )
    )


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
