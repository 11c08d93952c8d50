"""A campaign's simulations: counts of outcomes, and designs in pairs of features."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, NullLocator
from numpy.typing import NDArray

from activefail.pages.figures.axes import legend_outside, outcome_colour, outcome_handles, panel, scatter_outcomes
from activefail.pages.figures.style import BLACK, GREY, fitting_size, letters, styled
from activefail.space.space import Array
from activefail.text.quantities import Quantity, plain
from activefail.visible import words

MOST_SHOWN = 500
"""Most designs of a group in a panel: more would hide each other and make the page too large."""

_HATCHES = ("", "//", "xx", "..", "\\\\", "oo", "++")


@styled()
def plot_counts(counts: dict[str, NDArray[np.int64]], outcomes: Sequence[str]) -> Figure:
    """Shares of the outcomes in groups of simulations, as bars with their counts.

    Args:
        counts: (number of outcomes,) by the group's title; empty groups are omitted.
        outcomes: names, least severe first.
    """
    shown = {title: numbers for title, numbers in counts.items() if numbers.sum()}
    figure, axes = panel(5.4, 1.1 + 0.5 * len(shown))
    shares = np.array([100.0 * numbers / numbers.sum() for numbers in shown.values()])
    left = np.zeros(len(shown))
    for index, name in enumerate(outcomes):
        share, hatch = shares[:, index], _HATCHES[index % len(_HATCHES)]
        look: dict[str, Any] = {"color": outcome_colour(outcomes, index), "edgecolor": "white", "hatch": hatch}
        axes.barh(range(len(shown)), share, left=left, label=plain(words(name)), **look)
        for bar in np.flatnonzero(share > 4.0).tolist():
            count = str(list(shown.values())[bar][index])
            box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.2}
            axes.text(float(left[bar] + share[bar] / 2), bar, count, ha="center", va="center", bbox=box)
        left = left + share
    axes.set_yticks(range(len(shown)), [f"{title} ({counts[title].sum()})" for title in shown])
    axes.set(xlabel="share of the simulations [%]", xlim=(0, 100))
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    legend_outside(figure, "outside upper left")
    return figure


@styled()
def plot_pairs(
    F: Array,
    outcome: NDArray[np.int8],
    chosen: NDArray[np.bool_],
    quantities: Sequence[Quantity],
    logarithmic: Sequence[bool],
    outcomes: Sequence[str],
) -> Figure:
    """Designs in every pair of features: the initial design below the diagonal, active designs above it.

    Each group is thinned evenly to `MOST_SHOWN` designs, except on the diagonal.

    Args:
        F: (n, m) features before scaling.
        outcome: (n,) index into the outcomes.
        chosen: (n,) whether a design is active.
        quantities: (m,) of the columns.
        logarithmic: (m,) whether an axis is logarithmic.
        outcomes: names, least severe first.
    """
    m = len(quantities)
    inch = {1: 3.6, 2: 3.0, 3: 2.5}.get(m, 1.6)
    below, above = (_picked(np.flatnonzero(rows)) for rows in (~chosen, chosen))
    handles = [
        *outcome_handles(outcomes),
        Line2D([], [], color=GREY, linestyle="--", label="initial (below the diagonal)"),
        Line2D([], [], color=BLACK, label="active (above)"),
    ]
    labels = [
        quantity.axis.replace(" [", "\n[") if letters(quantity.axis) > 12.0 * inch else quantity.axis
        for quantity in quantities
    ]
    size = fitting_size((line for label in labels for line in label.split("\n")), inch)
    figure = Figure(figsize=(max(4.6, inch * m + 1.0), inch * m + 1.2), layout="constrained")
    grid = figure.subplots(m, m, squeeze=False)
    for row in range(m):
        for column in range(m):
            axes = grid[row, column]
            if row == column:
                _histogram(axes, F[:, row], chosen, logarithmic[row])
            else:
                shown = above if column > row else below
                scatter_outcomes(axes, F[shown, column], F[shown, row], outcome[shown], outcomes, 9.0)
                axes.set_yscale("log" if logarithmic[row] else "linear")
                axes.set_ylim(*_with_margins(F[:, row], logarithmic[row]))
            axes.set_xscale("log" if logarithmic[column] else "linear")
            axes.set_xlim(*_with_margins(F[:, column], logarithmic[column]))
            _label_pair(axes, row, column, labels, logarithmic)
            axes.xaxis.label.set_size(size)
            axes.yaxis.label.set_size(size)
    legend_outside(figure, "outside upper center", handles)
    return figure


def _label_pair(axes: Axes, row: int, column: int, labels: Sequence[str], logarithmic: Sequence[bool]) -> None:
    """Labels and ticks of one panel: names only at the margins of the grid."""
    last = len(labels) - 1
    for axis, is_log, is_labelled in (
        (axes.xaxis, logarithmic[column], row == last),
        (axes.yaxis, row != column and logarithmic[row], column == 0),
    ):
        if is_log:
            # Over less than a decade matplotlib would label minor ticks too.
            axis.set_minor_formatter(NullFormatter())
            if not is_labelled:
                axis.set_minor_locator(NullLocator())
    axes.tick_params(labelsize=7.5)
    if row == last:
        axes.set_xlabel(labels[column])
    else:
        axes.tick_params(labelbottom=False)
    if row == 0 and column == last > 0:
        # The first panel of this row is a histogram with another scale.
        axes.yaxis.set_label_position("right")
        axes.tick_params(labelleft=False, labelright=True)
        axes.set_ylabel(labels[row])
    elif column == 0 and row > 0:
        axes.set_ylabel(labels[row])
    else:
        axes.tick_params(labelleft=False)
    if row == column:
        axes.tick_params(left=False, which="both")
        axes.grid(axis="y", visible=False)
        axes.set_title("share of designs", fontsize=8)


def _picked(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """These rows, thinned evenly to `MOST_SHOWN`."""
    return rows[np.linspace(0, len(rows) - 1, MOST_SHOWN).astype(np.int64)] if len(rows) > MOST_SHOWN else rows


def _with_margins(column: Array, logarithmic: bool) -> tuple[float, float]:
    """A column's range with four per cent on both sides."""
    low, high = float(column.min()), float(column.max())
    if logarithmic:
        # A design far outside the space; an axis needs decades beyond it.
        low, high = max(low, 1e-100), min(high, 1e100)
        margin = (high / low) ** 0.04 if high > low else 1.1
        return low / margin, high * margin
    margin = 0.04 * (high - low) or 1.0
    return low - margin, high + margin


def _histogram(axes: Axes, column: Array, chosen: NDArray[np.bool_], logarithmic: bool) -> None:
    """Histograms of one feature over the initial and the active designs."""
    low, high = _with_margins(column, logarithmic)
    edges = np.geomspace(low, high, 15) if logarithmic else np.linspace(low, high, 15)
    for rows, colour, line in ((~chosen, GREY, "--"), (chosen, BLACK, "-")):
        if rows.any():
            share = np.histogram(column[rows], edges)[0] / rows.sum()
            axes.stairs(share, edges, linewidth=1.1, color=colour, linestyle=line)
    axes.set_ylim(bottom=0.0)
