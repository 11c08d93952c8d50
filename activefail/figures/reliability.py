"""Reliability diagrams: how often a classifier's predictions come true, with Wilson's intervals."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from statsmodels.stats.proportion import proportion_confint

from activefail.figures.axes import plain_log
from activefail.figures.style import GREY, LINE_COLOURS, LINE_MARKERS, styled
from activefail.space import Array


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
    figure = Figure(figsize=(6.4, 7.0), layout="constrained")
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
