"""How outcomes look in every figure of a campaign: a colour and a marker each, so that neither has to be told alone."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from activefail.campaign.quantities import plain, words
from activefail.figures.style import BLACK, BLUE, GREEN, ORANGE, OUTCOME_COLOURS, PURPLE, SKY_BLUE, VERMILION
from activefail.space import Array

_OTHER_COLOURS = (BLUE, ORANGE, VERMILION, PURPLE, GREEN, SKY_BLUE, BLACK)
_MARKERS = "oD^sPvX"
_MOST_MARKS = 500


def outcome_colour(outcomes: Sequence[str], index: int) -> str:
    """The colour of an outcome: the project's for the bearing's, else the palette's in the order of severity."""
    if set(outcomes) <= OUTCOME_COLOURS.keys():
        return OUTCOME_COLOURS[outcomes[index]]
    if len(outcomes) == 2:
        return (BLUE, VERMILION)[index]
    return _OTHER_COLOURS[index % len(_OTHER_COLOURS)]


def outcome_marker(outcomes: Sequence[str], index: int) -> str:
    """The marker of an outcome; of two the more severe has the last one of three."""
    return _MARKERS[(2 * index if len(outcomes) == 2 else index) % len(_MARKERS)]


def scatter_outcomes(
    axes: Axes, x: Array, y: Array, outcome: NDArray[np.int8], outcomes: Sequence[str], size: float
) -> None:
    """Designs at (x, y), (n,) each, by outcome, the more severe on top; many of them as a picture inside the figure."""
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


def outcome_handles(outcomes: Sequence[str], more: str = "") -> list[Line2D]:
    """Entries of a legend, one an outcome."""
    return [
        Line2D(
            [],
            [],
            linestyle="",
            color=outcome_colour(outcomes, index),
            marker=outcome_marker(outcomes, index),
            label=f"{plain(words(name))}{more}",
        )
        for index, name in enumerate(outcomes)
    ]
