"""Filled contours of probabilities and uncertainties in a plane, with their colour bar and axes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from activefail.figures.style import GREY
from activefail.space import Array

PROBABILITY_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)
_PROBABILITY, _UNCERTAINTY = ("cividis", 0.6), ("Purples", 0.9)
"""Colour map and opacity; pale enough for marks on probabilities, strong enough to show a small uncertainty."""

NOWHERE: dict[str, Any] = {"hatch": "////", "edgecolor": (GREY, 0.45)}
"""Hatching where there is no design; plain white means no uncertainty."""


def axis_limits(column: Array, share: float = 0.9) -> tuple[float, float]:
    """The range of a share of a column, from its minimum; over the ratios' long tails the boundary would be tiny."""
    low, high = np.quantile(column, [0.0, share])
    return float(low), float(high) if high > low else float(low) + 1.0


def filled_contours(axes: Axes, x: Array, y: Array, Z: Array, uncertainty: bool = False) -> ScalarMappable:
    """Shades and lines of a probability, or shades of an uncertainty, both between 0 and 1; blank where NaN."""
    colours, opacity = _UNCERTAINTY if uncertainty else _PROBABILITY
    Z = np.ma.masked_invalid(Z)
    # Rasterised: as outlines the shades would be most of a page.
    shades = axes.contourf(x, y, Z, levels=np.linspace(0.0, 1.0, 11), cmap=colours, alpha=opacity)
    shades.set_rasterized(True)
    if Z.mask.any():
        # Start at the last points that are designs, so that hatching and shades touch.
        nowhere = axes.contourf(x, y, np.ma.getmaskarray(Z).astype(float), levels=[1e-6, 2.0], colors="none")
        nowhere.set(**NOWHERE, linewidth=0.0)
    if not uncertainty and Z.count() and Z.min() < max(PROBABILITY_LEVELS) and Z.max() > min(PROBABILITY_LEVELS):
        axes.contour(x, y, Z, levels=PROBABILITY_LEVELS, colors=GREY, linewidths=[0.6, 0.6, 1.7, 0.6, 0.6])
    return ScalarMappable(shades.norm, shades.cmap)


def colour_bar(
    figure: Figure,
    axes: Axes | Sequence[Axes],
    shades: ScalarMappable,
    title: str,
    uncertainty: bool = False,
    fraction: float = 0.15,
) -> None:
    """Add a colour bar to filled contours, on a fraction of their width; that of a probability names the lines."""
    opacity = (_UNCERTAINTY if uncertainty else _PROBABILITY)[1]
    ticks = np.linspace(0.0, 1.0, 6) if uncertainty else PROBABILITY_LEVELS
    bar = figure.colorbar(shades, ax=axes, ticks=ticks, pad=0.01, fraction=fraction, alpha=opacity)
    bar.set_label("width of the 95 % interval [–]" if uncertainty else f"{title} [–]")
