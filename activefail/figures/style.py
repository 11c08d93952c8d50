"""How the project's pictures look: colours that colour-blind readers tell apart, and one set of matplotlib's settings.

Constants only, so that naming a colour does not import matplotlib; `styled` does when it is entered.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from activefail.files import replacing, target_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from typing import Any

BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
YELLOW = "#F0E442"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
"""The palette of Okabe and Ito (2008)."""

GREY = "#6B7280"
LIGHT_GREY = "#D5DAE1"

OUTCOME_COLOURS = {"no_impact": BLUE, "impact": ORANGE, "failure": VERMILION, "numerical_failure": GREY}
"""One colour for each outcome, in every picture."""

RC: dict[Any, Any] = {
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "figure.facecolor": "white",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E5E7EB",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.fontsize": 8,
    "legend.frameon": True,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "legend.borderpad": 0.2,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.unicode_minus": True,
    # Element names of an SVG from its content: the same figure gives the same bytes.
    "svg.hashsalt": "activefail",
}
"""matplotlib's settings for all pictures of the project."""


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure to a file of the format that its suffix names; an older one is there until it is whole."""
    with replacing(target_of(path), "xb") as file:
        figure.savefig(file, format=path.suffix[1:].lower())


@contextmanager
def styled() -> Iterator[None]:
    """The project's settings for what is drawn inside; the user's own are untouched afterwards."""
    import matplotlib

    with matplotlib.rc_context(RC):
        yield
