"""What a classifier learned: its length scales, and how often its predictions come true, with Wilson's intervals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from statsmodels.stats.proportion import proportion_confint

from activefail.learning.model.classifier import Classifier
from activefail.pages.figures.axes import legend_outside, outcome_colour, outcome_marker, panel, plain_log
from activefail.pages.figures.style import GREY, LIGHT_GREY, LINE_COLOURS, LINE_MARKERS, styled
from activefail.space.space import Array
from activefail.text.quantities import Quantity, plain
from activefail.visible import words


@styled()
def plot_reliability(
    probabilities: dict[str, Array],
    failed: NDArray[np.bool_],
    samples: int,
    bins: int = 10,
    labels: tuple[str, str] = ("share of failures among fresh designs", "predicted P(failure)"),
) -> Figure:
    """Observed share of failures against predicted probability, with the number of designs at each point.

    Args:
        probabilities: (n,) of failure, by the method's title; at most four.
        failed: (n,) bool.
        samples: number of pooled samples on the same designs; bands are for the designs of one sample.
        bins: number of bins of equal width.
        labels: of the axes, observed share and predicted probability.
    """
    figure = Figure(figsize=(5.4, 6.0), layout="constrained")
    axes, counts_axes = figure.subplots(2, 1, sharex=True, height_ratios=[3.0, 1.0])
    axes.plot([0, 1], [0, 1], color=GREY, linestyle=":", label="perfect")
    for (title, p), colour, marker in zip(probabilities.items(), LINE_COLOURS, LINE_MARKERS, strict=False):
        bin_index = np.clip((p * bins).astype(int), 0, bins - 1)
        counts = np.bincount(bin_index, minlength=bins)
        shown = counts > 0
        predicted = np.bincount(bin_index, weights=p, minlength=bins)[shown] / counts[shown]
        failures = np.bincount(bin_index, weights=failed, minlength=bins)[shown]
        axes.plot(predicted, failures / counts[shown], color=colour, marker=marker, label=title)
        low, high = proportion_confint(failures / samples, counts[shown] / samples, method="wilson")
        axes.fill_between(predicted, low, high, color=colour, alpha=0.12, linewidth=0.0)
        counts_axes.plot(predicted, counts[shown] / samples, color=colour, marker=marker)
    axes.set_ylabel(labels[0])
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16 if len(probabilities) > 1 else 1.08), ncols=2)
    counts_axes.set_yscale("log")
    plain_log(counts_axes.yaxis, (1.0,))
    counts_axes.set(xlabel=labels[1], ylabel="designs in a bin")
    return figure


LONG = 4.0
"""Length scale [standard deviations over the space] that exceeds a feature's range.

The latent is nearly linear in the feature then, or does not depend on it."""


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
    figure, axes = panel(5.4, 1.3 + 0.3 * len(quantities))
    end = max(2.0 * float(scales.max()), 2.0 * LONG)
    axes.axvspan(LONG, end, color=LIGHT_GREY, alpha=0.5, label="nearly linear, or none")
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
