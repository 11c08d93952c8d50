"""Learning curves of active and static sampling, and fragility curves."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from activefail.comparison.equivalent import Equivalent, equivalent
from activefail.comparison.seeds import STATIC, Point
from activefail.comparison.static import Score, by_size
from activefail.figures.marks import legend_columns, legend_height
from activefail.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    YELLOW,
    fitting_size,
    margins,
    styled,
)
from activefail.findings.quantities import Quantity
from activefail.space import Array


def plot_learning_curves(scores: Sequence[Score], boundary: str, test_size: int) -> Figure:
    """Accuracy with its 95 % interval against the number of simulations, one line for each sampling."""
    with styled():
        figure = Figure(figsize=(7.0, 4.6), layout="constrained")
        axes = figure.add_subplot()
        looks = {"active": (BLUE, "o", "-"), "static": (VERMILION, "s", "--")}
        names = {"active": "active sampling", "static": "static Latin hypercube"}
        for sampling, (colour, marker, line) in looks.items():
            groups = by_size([score for score in scores if score.sampling == sampling])
            if not groups:
                continue
            n = np.array([group[0].simulations for group in groups])
            middle, low, high = 100.0 * np.array([_accuracy_of(group) for group in groups]).T
            axes.fill_between(n, low, high, color=colour, alpha=0.15, linewidth=0.0)
            axes.plot(n, middle, color=colour, marker=marker, linestyle=line, label=names[sampling])
        sizes = sorted({score.simulations for score in scores})
        if sizes[-1] >= _LOGARITHMIC * sizes[0]:
            axes.set_xscale("log")
            ends = [max((s.simulations for s in scores if s.sampling == name), default=sizes[0]) for name in looks]
            ticks = sorted({sizes[0], *ends, *(s.simulations for s in scores if s.sampling == "static")})
            axes.set_xticks(ticks, [str(tick) for tick in ticks], rotation=45)
            axes.minorticks_off()
        else:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        _mark_equivalent(axes, equivalent(scores))
        axes.set_xlabel("simulations trained on")
        axes.set_ylabel(f"accuracy for {boundary} on fresh designs [%]")
        shared = "one set for both" if len({score.sampling for score in scores}) > 1 else "one set"
        several = max((score.hypercube for score in scores), default=0) + 1
        static = f"\nstatic: lowest to highest of {several} designs of each size" if several > 1 else ""
        axes.set_title(f"Band: 95 % interval over test sets of {test_size} designs ({shared}){static}", fontsize=9)
        figure.legend(loc="outside lower center", ncols=2)
    return figure


_LOGARITHMIC = 5
"""Ratio of the largest to the smallest number of simulations from which the axis is logarithmic."""


def _accuracy_of(group: Sequence[Score]) -> tuple[float, float, float]:
    """Accuracy of designs of one size with its band: the interval of a single one, or the range of several."""
    if len(group) == 1:
        return group[0].accuracy, group[0].low, group[0].high
    values = [score.accuracy for score in group]
    return float(np.median(values)), min(values), max(values)


def _mark_equivalent(axes: Axes, same: Equivalent | None) -> None:
    """A line from the campaign's last accuracy to where the static curve reaches it, or past its end."""
    if same is None or (same.size is not None and same.size <= same.simulations):
        return
    end = same.largest if same.size is None else same.size
    axes.plot([same.simulations, end], [100.0 * same.accuracy] * 2, color=GREY, linestyle=":", zorder=0)


_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE, BLACK, YELLOW)
_MARKERS = "osD^vP*X"


def plot_sampling_curves(curves: dict[tuple[str, str], list[Point]], label: str, title: str) -> Figure:
    """A measure against simulations over seeds, one line for each pair of features and sampling.

    Args:
        curves: from `activefail.comparison.seeds.curves`; campaigns are solid lines, static designs dashed.
        label: of the measure, with its unit.
        title: describes lines and bands.
    """
    with styled():
        figure = Figure(figsize=(7.6, 5.0), layout="constrained")
        axes = figure.add_subplot()
        features = list(dict.fromkeys(key[0] for key in curves))
        samplings = list(dict.fromkeys(key[1] for key in curves))
        for (feature, sampling), points in curves.items():
            colour = _COLOURS[features.index(feature) % len(_COLOURS)]
            marker = _MARKERS[samplings.index(sampling) % len(_MARKERS)]
            n = np.array([point.simulations for point in points])
            values = np.array([point.values for point in points])
            axes.fill_between(n, values.min(axis=1), values.max(axis=1), color=colour, alpha=0.12, linewidth=0.0)
            line = "--" if sampling == STATIC else "-"
            name = f"{'static Latin hypercube' if sampling == STATIC else sampling}, {feature} features"
            axes.plot(n, np.median(values, axis=1), color=colour, marker=marker, linestyle=line, label=name)
        axes.set_xscale("log")
        static = {point.simulations for key, points in curves.items() if key[1] == STATIC for point in points}
        ends = {points[index].simulations for points in curves.values() for index in (0, -1)}
        ticks = sorted(static | ends)
        axes.set_xticks(ticks, [str(tick) for tick in ticks], rotation=45)
        axes.minorticks_off()
        axes.set_xlabel("simulations trained on")
        axes.set_ylabel(label)
        axes.set_title(title, fontsize=9)
        axes.legend(loc="best")
    return figure


def plot_fragility(
    values: Array,
    probability: Array,
    low: Array,
    high: Array,
    along: Quantity,
    beyond: str,
    current: float,
    colour: str,
) -> Figure:
    """A probability with its interval against one variable, (n,) each, with all others fixed.

    Args:
        values: of the variable.
        probability, low, high: the probability and its interval.
        along: the variable.
        beyond: the event of the probability, as mathtext.
        current: the point's value of the variable.
        colour: of the curve.
    """
    with styled():
        figure = Figure(figsize=(4.0, 3.2))
        axes = figure.add_subplot()
        axes.fill_between(values, low, high, color=colour, alpha=0.2, linewidth=0.0, label="95 % interval")
        axes.plot(values, probability, color=colour, linewidth=1.8, label=f"P({beyond})")
        axes.axvline(current, color=BLACK, linestyle=":", label="this point")
        axes.axhline(0.5, color=GREY, linewidth=0.8, linestyle="--")
        axes.set(xlabel=along.axis, ylabel=f"P({beyond}) [–]", xlim=(values[0], values[-1]), ylim=(-0.02, 1.02))
        _arrange(figure, axes, left=0.6)
    return figure


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
    with styled():
        figure = Figure(figsize=(5.0, 3.6))
        axes = figure.add_subplot()
        axes.plot(values, 100.0 * probability, color=colour, linewidth=1.8, marker=".", label=f"P({beyond})")
        axes.axhline(100.0 * target, color=GREY, linewidth=1.0, linestyle="--", label="target")
        if np.isfinite(required):
            axes.axvline(required, color=BLACK, linestyle=":", label="required")
        top = 100.0 * min(1.0, 1.1 * max(float(probability.max()), 1.5 * target))
        axes.set(xlabel=along.axis, ylabel=f"P({beyond}) [%]", xlim=(values[0], values[-1]), ylim=(0.0, top))
        _arrange(figure, axes, left=0.75)
    return figure


def _arrange(figure: Figure, axes: Axes, left: float) -> None:
    """The legend above the only panel, labels that fit beside it, and fixed margins.

    Args:
        figure, axes: with all that the legend names.
        left: margin for the ticks and the label of the vertical axis [in].
    """
    width, height = figure.get_size_inches().tolist()
    handles, _ = axes.get_legend_handles_labels()
    columns = legend_columns(handles, width)
    right, bottom, top = 0.25, 0.5, legend_height(handles, columns) + 0.06
    figure.subplots_adjust(**margins(width, height, left=left, right=right, bottom=bottom, top=top))
    for label, length in ((axes.xaxis.label, width - left - right), (axes.yaxis.label, height - bottom - top)):
        label.set_fontsize(fitting_size([label.get_text()], length))
    figure.legend(handles=handles, loc="upper center", ncols=columns)
