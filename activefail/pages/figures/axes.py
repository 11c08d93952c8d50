"""Panels, axes, legends, colours and markers of outcomes, and filled contours, which the figures share."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib import pyplot
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from activefail.pages.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    OUTCOME_COLOURS,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    letters,
)
from activefail.space.space import Array
from activefail.text.quantities import plain
from activefail.visible import words


def panel(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of this size [in] with one panel; its layout makes room for labels, and for legends outside."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def own_axes(axes: Axes | None) -> Axes:
    """The axes, or new ones of pyplot, which a notebook shows."""
    return pyplot.subplots()[1] if axes is None else axes


def plain_log(axis: Axis, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Label a logarithmic axis at these steps of each decade, with numbers without exponents."""
    axis.set_major_locator(LogLocator(10.0, subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def log_sizes(axes: Axes, sizes: set[int]) -> None:
    """A logarithmic horizontal axis that is labelled at some numbers of simulations."""
    ticks = sorted(sizes)
    axes.set_xscale("log")
    axes.set_xticks(ticks, [str(tick) for tick in ticks], rotation=45)
    axes.minorticks_off()


Place = Literal["outside lower center", "outside upper center", "outside upper left"]


def legend_outside(
    figure: Figure, place: Place = "outside lower center", handles: Sequence[Artist] | None = None
) -> None:
    """One legend outside the panels, with each label once, in as many columns as fit.

    Args:
        figure: the figure.
        place: of the legend.
        handles: its entries; those of all panels if None.
    """
    if handles is None:
        labelled = [entry for axes in figure.axes for entry in zip(*axes.get_legend_handles_labels(), strict=True)]
        by_label = {label: handle for handle, label in reversed(labelled)}
        labels = list(dict.fromkeys(label for _, label in labelled))
        handles = [by_label[label] for label in labels]
    else:
        labels = [str(handle.get_label()) for handle in handles]
    columns = _columns(labels, float(figure.get_size_inches()[0]))
    figure.legend(handles, labels, loc=place, ncols=columns)


def _columns(labels: Sequence[str], width: float) -> int:
    """The most columns of a legend with these labels that fit into a width [in]."""
    lengths = [letters(label) for label in labels]
    for columns in range(len(lengths), 1, -1):
        # Its parts, as matplotlib distributes entries; an entry is its mark and the letters of its label.
        if sum(0.55 + 0.07 * max(part) for part in np.array_split(lengths, columns)) <= width:
            return columns
    return 1


PROBABILITY_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)
_PROBABILITY = LinearSegmentedColormap.from_list("probability", [BLUE, "white", VERMILION]), 0.45
_UNCERTAINTY = "Purples", 0.9
"""Colour map and opacity; pale enough for marks on probabilities, strong enough to show a small uncertainty."""

_NOWHERE: dict[str, Any] = {"hatch": "////", "edgecolor": (GREY, 0.45)}
"""Hatching where there is no design; plain white means no uncertainty."""


_UNDECIDED: dict[str, Any] = {"hatch": "---", "edgecolor": (GREY, 0.8)}
"""Lines where the outcome is unknown; dots would be most of a page."""


def region_handles(Z: Array, undecided: NDArray[np.bool_]) -> list[Patch]:
    """Legend entries for the hatching, if some of the values is NaN, and for the lines, if a design is undecided."""
    return [
        Patch(facecolor="white", **looks, linewidth=0.6, label=label)
        for looks, label, is_there in (
            (_NOWHERE, "no design in the space", np.isnan(Z).any()),
            (_UNDECIDED, "unknown: no simulation is near", undecided.any()),
        )
        if is_there
    ]


def axis_limits(column: Array, share: float = 0.9) -> tuple[float, float]:
    """The range of a share of a column, from its minimum; over the ratios' long tails the boundary would be tiny."""
    low, high = np.quantile(column, [0.0, share])
    return float(low), float(high) if high > low else float(low) + 1.0


def filled_contours(
    axes: Axes, x: Array, y: Array, Z: Array, undecided: NDArray[np.bool_], uncertainty: bool = False
) -> ScalarMappable:
    """Shades and lines of a probability, or shades of an uncertainty, both between 0 and 1; blank where NaN.

    Where a design is undecided, horizontal lines lie over the shades. All arrays have the shape (m, n).
    """
    colours, opacity = _UNCERTAINTY if uncertainty else _PROBABILITY
    Z = np.ma.masked_invalid(Z)
    # Rasterised: as outlines the shades would be most of a page.
    shades = axes.contourf(x, y, Z, levels=np.linspace(0.0, 1.0, 11), cmap=colours, alpha=opacity)
    shades.set_rasterized(True)
    if Z.mask.any():
        # Start at the last points that are designs, so that hatching and shades touch.
        nowhere = axes.contourf(x, y, np.ma.getmaskarray(Z).astype(float), levels=[1e-6, 2.0], colors="none")
        nowhere.set(**_NOWHERE, linewidth=0.0)
    if undecided.any():
        unknown = axes.contourf(x, y, undecided.astype(float), levels=[0.5, 2.0], colors="none")
        unknown.set(**_UNDECIDED, linewidth=0.0)
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


_OTHER_COLOURS = (BLUE, ORANGE, VERMILION, PURPLE, GREEN, SKY_BLUE, BLACK)
_MARKERS = "oD^sPvX"
_MOST_MARKS = 500


def outcome_colour(outcomes: Sequence[str], index: int) -> str:
    """The colour of an outcome: fixed for the bearing's outcomes, otherwise from the palette by severity."""
    if set(outcomes) <= OUTCOME_COLOURS.keys():
        return OUTCOME_COLOURS[outcomes[index]]
    if len(outcomes) == 2:
        return (BLUE, VERMILION)[index]
    return _OTHER_COLOURS[index % len(_OTHER_COLOURS)]


def outcome_marker(outcomes: Sequence[str], index: int) -> str:
    """The marker of an outcome; the more severe of two outcomes takes the third marker."""
    return _MARKERS[(2 * index if len(outcomes) == 2 else index) % len(_MARKERS)]


def scatter_outcomes(
    axes: Axes,
    x: Array,
    y: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    size: float,
    opacity: float = 1.0,
) -> None:
    """Scatter designs at (x, y), (n,) each, by outcome, the more severe on top; rasterised if there are many."""
    for index in range(len(outcomes)):
        rows = outcome == index
        axes.scatter(
            x[rows],
            y[rows],
            s=size,
            c=outcome_colour(outcomes, index),
            marker=outcome_marker(outcomes, index),
            edgecolors="white",
            alpha=opacity,
            linewidths=0.6,
            zorder=3,
            rasterized=len(x) > _MOST_MARKS,
        )


def outcome_handles(outcomes: Sequence[str], suffix: str = "") -> list[Line2D]:
    """Legend entries, one per outcome."""
    return [
        Line2D(
            [],
            [],
            linestyle="",
            color=outcome_colour(outcomes, index),
            marker=outcome_marker(outcomes, index),
            label=f"{plain(words(name))}{suffix}",
        )
        for index, name in enumerate(outcomes)
    ]
