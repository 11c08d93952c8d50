"""Colours and markers of outcomes in all figures. Both differ, so that no reader depends on colour alone."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from activefail.figures.style import BLACK, BLUE, GREEN, ORANGE, OUTCOME_COLOURS, PURPLE, SKY_BLUE, VERMILION
from activefail.findings.quantities import plain, words
from activefail.space import Array

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
    axes: Axes, x: Array, y: Array, outcome: NDArray[np.int8], outcomes: Sequence[str], size: float
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
            linewidths=0.3,
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
