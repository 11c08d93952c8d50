"""The style of all figures: a palette for colour-blind readers, matplotlib settings, and saving.

Importing this module does not import matplotlib; entering `styled` does.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any

from activefail.text.files import replacing, target_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
YELLOW = "#F0E442"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
"""The palette of [OkabeIto2008]."""

GREY = "#6B7280"
LIGHT_GREY = "#D5DAE1"

LINE_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE, BLACK, YELLOW)
LINE_MARKERS = "os^vPX*d"
"""Of lines that are no outcomes. Both differ, so that no reader depends on colour alone."""

OUTCOME_COLOURS = {"no_impact": BLUE, "impact": ORANGE, "failure": VERMILION, "numerical_failure": GREY}
"""One colour for each outcome, in all figures."""

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
    # Derive the ids of an SVG from its content, so that the same figure gives the same bytes.
    "svg.hashsalt": "activefail",
}
"""matplotlib's settings for all figures."""


_DRAWING = RLock()


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style within a block, and restore the user's settings afterwards; one thread at a time.

    All threads share matplotlib's settings.
    """
    import matplotlib

    with _DRAWING, matplotlib.rc_context(RC):
        yield


def lay_out(figure: "Figure") -> None:
    """Arrange a figure by its layout, and then remove the layout.

    matplotlib draws a figure that has a layout twice when it saves it, the first time only to arrange it.
    """
    layout = figure.get_layout_engine()
    if layout is not None:
        with styled():
            layout.execute(figure)
        figure.set_layout_engine(None)


def letters(text: str) -> int:
    """The number of letters that a label shows, without the signs of mathtext."""
    return len(text) - sum(text.count(sign) for sign in "${}_\\")


def fitting_size(lines: Iterable[str], length: float) -> float:
    """The size of text [pt], at most that of labels, at which lines fit into a length [in]."""
    return min(float(RC["axes.labelsize"]), 72.0 * length / (0.65 * max(letters(line) for line in lines)))


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure in the format of the path's suffix; the file appears under its name only when complete.

    An SVG has no date, so that the same figure gives the same bytes.

    Raises:
        OSError: if it cannot be written.
    """
    kind = path.suffix.removeprefix(".").lower()
    lay_out(figure)
    with replacing(target_of(path), "xb") as file:
        figure.savefig(file, format=kind, metadata={"Date": None} if kind == "svg" else None)


def save_png_and_svg(figure: "Figure", folder: Path, name: str) -> list[Path]:
    """Write a figure to `<name>.png` and `<name>.svg` in a folder; returns these paths.

    Raises:
        OSError: if one cannot be written.
    """
    paths = [folder / f"{name}.{suffix}" for suffix in ("png", "svg")]
    for path in paths:
        save_figure(figure, path)
    return paths
