"""Panels, axes and legends that the figures share."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from activefail.figures.style import letters


def panel(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of this size [in] with one panel; its layout makes room for labels, and for legends outside."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


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
