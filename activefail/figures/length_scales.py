"""Draws the length scales that a classifier has learned."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from activefail.figures.axes import legend_outside, panel, plain_log
from activefail.figures.marks import outcome_colour, outcome_marker
from activefail.figures.style import GREY, LIGHT_GREY, styled
from activefail.findings.quantities import Quantity, plain, words
from activefail.space import Array
from activefail.surrogate.classifier import Classifier

LONG = 4.0
"""Length scale [standard deviations over the space] beyond which a feature hardly matters: longer than its range."""


def length_scales(classifier: Classifier) -> Array | None:
    """Length scales in standard deviations of each feature over the design space, (boundaries, m).

    None if the kernel is the user's.
    """
    scales = [latent.length_scales for latent in classifier.latents]
    known = [of_boundary for of_boundary in scales if of_boundary is not None]
    return np.stack(known) if len(known) == len(scales) else None


@styled()
def plot_length_scales(scales: Array, quantities: Sequence[Quantity], outcomes: Sequence[str]) -> Figure:
    """Plot length scales, (boundaries, m), with a marker for each boundary, sorted by those of the last boundary."""
    order = np.argsort(scales[-1])
    figure, axes = panel(7.6, 1.3 + 0.3 * len(quantities))
    end = max(2.0 * float(scales.max()), 2.0 * LONG)
    axes.axvspan(LONG, end, color=LIGHT_GREY, alpha=0.5, label="hardly matters")
    for severity, row in enumerate(scales, start=1):
        axes.plot(
            row[order],
            range(len(order)),
            linestyle="",
            marker=outcome_marker(outcomes, severity),
            color=outcome_colour(outcomes, severity),
            markersize=7,
            label=f"{plain(words(outcomes[severity]))} boundary",
        )
    for row, column in enumerate(order):
        axes.plot([scales[:, column].min(), scales[:, column].max()], [row, row], color=GREY, linewidth=0.8, zorder=1)
    axes.set_yticks(range(len(order)), [quantities[column].symbol for column in order])
    axes.set_xscale("log")
    plain_log(axes.xaxis)
    axes.set_xlim(0.5 * float(scales.min()), end)
    axes.set_xlabel("length scale [standard deviations of the feature over the design space]")
    axes.invert_yaxis()
    legend_outside(figure, "outside upper left")
    return figure
