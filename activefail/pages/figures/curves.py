"""Learning curves of active and static sampling, and probabilities against one variable."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from activefail.analyses.comparison.equivalent import equivalent
from activefail.analyses.comparison.static import by_size
from activefail.analyses.findings.results import Prediction
from activefail.estimates.scores import Score
from activefail.pages.figures.axes import legend_outside, log_sizes, own_axes, panel
from activefail.pages.figures.style import (
    BLACK,
    BLUE,
    GREY,
    VERMILION,
    fitting_size,
    styled,
)
from activefail.space.space import Array
from activefail.text.quantities import Quantity

_LOGARITHMIC = 5
"""Ratio of the largest to the smallest number of simulations from which the axis is logarithmic."""

_SAMPLINGS = {
    "active": {"color": BLUE, "marker": "o", "linestyle": "-", "label": "active sampling"},
    "static": {"color": VERMILION, "marker": "s", "linestyle": "--", "label": "static Latin hypercube"},
}


@styled()
def plot_learning_curves(scores: Sequence[Score], boundary: str, test_size: int, width: float = 5.4) -> Figure:
    """`draw_learning_curves` on a figure of its own, of this width [in]."""
    figure, axes = panel(width, 1.5 + 0.45 * width)
    draw_learning_curves(axes, scores, boundary, test_size)
    legend_outside(figure)
    return figure


@styled()
def draw_learning_curves(axes: Axes | None, scores: Sequence[Score], boundary: str, test_size: int) -> Axes:
    """Accuracy with its 95 % interval against the number of simulations, one line for each sampling.

    Args:
        axes: to draw on; new ones of pyplot, which a notebook shows, if None.
        scores: of one or two samplings.
        boundary: its outcome, as mathtext.
        test_size: designs in the set of the scores.
    """
    axes = own_axes(axes)
    for sampling, look in _SAMPLINGS.items():
        groups = by_size([score for score in scores if score.sampling == sampling])
        if groups:
            n = np.array([group[0].simulations for group in groups])
            middle, low, high = 100.0 * np.array([_accuracy_of(group) for group in groups]).T
            axes.fill_between(n, low, high, color=look["color"], alpha=0.15, linewidth=0.0)
            axes.plot(n, middle, **look)  # type: ignore[arg-type]
    sizes = {name: {score.simulations for score in scores if score.sampling == name} for name in _SAMPLINGS}
    every = sizes["active"] | sizes["static"]
    if max(every) >= _LOGARITHMIC * min(every):
        log_sizes(axes, {min(every), max(sizes["active"], default=min(every)), *sizes["static"]})
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if (same := equivalent(scores)) is not None and (same.size is None or same.size > same.simulations):
        # From the campaign's last accuracy to where the static curve reaches it, or past its end.
        end = same.largest if same.size is None else same.size
        axes.plot([same.simulations, end], [100.0 * same.accuracy] * 2, color=GREY, linestyle=":", zorder=0)
    axes.set(xlabel="simulations trained on", ylabel=f"accuracy for {boundary} on fresh designs [%]")
    shared = " (one set for both)" if all(sizes.values()) else ""
    several = max(score.hypercube for score in scores) + 1
    static = f"\nstatic: lowest to highest of {several} designs of each size" if several > 1 else ""
    title = f"Band: 95 % interval over test sets of {test_size} designs{shared}{static}"
    width = cast(Figure, axes.get_figure(root=True)).get_size_inches()[0]
    axes.set_title(title, fontsize=fitting_size(title.split("\n"), width - 0.8))
    return axes


def _accuracy_of(group: Sequence[Score]) -> tuple[float, float, float]:
    """Accuracy of designs of one size with its band: the interval of a single one, or the range of several."""
    if len(group) == 1:
        return group[0].accuracy, group[0].low, group[0].high
    values = [score.accuracy for score in group]
    return float(np.median(values)), min(values), max(values)


@styled()
def plot_fragility(
    values: Array, prediction: Prediction, along: Quantity, beyond: str, current: float, colour: str
) -> Figure:
    """A probability with its interval against one variable, with all others fixed.

    Args:
        values: (n,) of the variable.
        prediction: (n,) of the probability and its interval.
        along: the variable.
        beyond: the event of the probability, as mathtext.
        current: the point's value of the variable.
        colour: of the curve.
    """
    figure, axes = panel(4.0, 3.2)
    low, high = prediction.low, prediction.high
    axes.fill_between(values, low, high, color=colour, alpha=0.2, linewidth=0.0, label="95 % interval")
    axes.plot(values, prediction.beyond, color=colour, linewidth=1.8, label=f"P({beyond})")
    axes.axvline(current, color=BLACK, linestyle=":", label="this point")
    axes.axhline(0.5, color=GREY, linewidth=0.8, linestyle="--")
    axes.set(xlim=(values[0], values[-1]), ylim=(-0.02, 1.02))
    _name_axes(figure, axes, along.axis, f"P({beyond}) [–]")
    return figure


@styled()
def plot_required_value(
    values: Array, probability: Array, target: float, required: float, along: Quantity, beyond: str, colour: str
) -> Figure:
    """A probability against the variable that must be chosen, (n,) each, with a target and the value that it requires.

    Args:
        values: of the variable.
        probability: without interval.
        target: largest acceptable probability.
        required: value that meets it; NaN if none does.
        along: the variable.
        beyond: the event of the probability, as mathtext.
        colour: of the curve.
    """
    figure, axes = panel(5.0, 3.6)
    axes.plot(values, 100.0 * probability, color=colour, linewidth=1.8, marker=".", label=f"P({beyond})")
    axes.axhline(100.0 * target, color=GREY, linewidth=1.0, linestyle="--", label="target")
    if np.isfinite(required):
        axes.axvline(required, color=BLACK, linestyle=":", label="required")
    top = 100.0 * min(1.0, 1.1 * max(float(probability.max()), 1.5 * target))
    axes.set(xlim=(values[0], values[-1]), ylim=(0.0, top))
    _name_axes(figure, axes, along.axis, f"P({beyond}) [%]")
    return figure


def _name_axes(figure: Figure, axes: Axes, x: str, y: str) -> None:
    """Labels of the axes that fit beside the panel, and the legend above it."""
    width, height = figure.get_size_inches().tolist()
    axes.set_xlabel(x, fontsize=fitting_size([x], width - 0.9))
    axes.set_ylabel(y, fontsize=fitting_size([y], height - 0.9))
    legend_outside(figure, "outside upper center")
