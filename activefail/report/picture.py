"""A figure of a page, as inline SVG with a text for screen readers."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from markupsafe import Markup

from activefail.figures.svg import inline

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure of the page; the template has its caption."""

    svg: Markup
    wide: bool = False


def picture(figure: "Figure", name: str, alternative: str) -> Picture:
    """A figure as inline SVG.

    Args:
        figure: to draw.
        name: prefix of its ids, unique on the page.
        alternative: text for screen readers.
    """
    return Picture(inline(figure, name, alternative), float(figure.get_size_inches()[0]) > 8.0)
