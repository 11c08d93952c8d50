"""Drawings of risk: fragility curves, required values, and sensitivities."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.design.required_chart import RequiredChart
from activefail.analyses.design.stored import StoredDesign
from activefail.analyses.fragility.findings import BoundaryFragility, FragilityFindings
from activefail.analyses.sensitivity.findings import Move
from activefail.analyses.sensitivity.sobol import Index
from activefail.analyses.stripes.findings import StripeFindings
from activefail.pages.figures.axes import legend_outside, outcome_colour, outcome_marker, panel, plain_log
from activefail.pages.figures.style import BLACK, BLUE, GREY, LINE_COLOURS, LINE_MARKERS, ORANGE, VERMILION, styled
from activefail.plugins import brought
from activefail.space.shares import significant
from activefail.text.quantities import Quantity, plain, quantity
from activefail.visible import words

STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""Labels in a decade of an axis."""


SIZE = 4.8, 4.4
"""Width and height of a curve [in]."""


@styled()
def plot_fragility_findings(findings: FragilityFindings, shown: Mapping[str, Quantity]) -> dict[str, Figure]:
    """The curves of all boundaries and, under a hazard, the pulses that cause the most severe outcome, by file name.

    The curve is the result. The lognormal curve of the capacities of finitely many values is dotted.

    Args:
        findings: the curves.
        shown: the variables, by name.
    """
    figure, axes = panel(*SIZE)
    _draw_curves(axes, findings, shown)
    legend_outside(figure)
    figures, deaggregation = {"fragility": figure}, findings.boundaries[-1].deaggregation
    if deaggregation is not None:
        drawn = brought("figures")[deaggregation.figure](deaggregation, findings.boundaries[-1].outcome)
        figures |= {} if drawn is None else {deaggregation.figure: drawn}
    return figures


def _draw_curves(axes: Axes, findings: FragilityFindings, shown: Mapping[str, Quantity]) -> None:
    outcomes = ("", *(one.outcome for one in findings.boundaries))
    for index, one in enumerate(findings.boundaries, start=1):
        _draw_boundary(axes, one, findings.loads, outcome_colour(outcomes, index), outcome_marker(outcomes, index))
    if findings.median is not None:
        axes.axvline(findings.median, color=BLACK, linewidth=0.9, linestyle="-.", label="median of the hazard")
    if findings.ladder.is_log:
        axes.set_xscale("log")
        plain_log(axes.xaxis, STEPS)
    variable = quantity(findings.ladder.name, findings.ladder.unit, shown)
    axes.set(xlabel=variable.axis, ylabel="probability of this outcome or worse [–]", ylim=(-0.02, 1.02))
    axes.set_xlim(*_shown_levels(findings))
    axes.set_title(plain(findings.title))


def _draw_boundary(axes: Axes, one: BoundaryFragility, loads: str, colour: str, marker: str) -> None:
    levels, name = one.curve.ladder.levels, plain(words(one.outcome))
    axes.plot(levels, one.curve.probability, color=colour, linewidth=1.8, label=name)
    if one.alone is not None:
        alone = one.alone.ladder.levels, one.alone.probability
        axes.plot(*alone, color=colour, linewidth=1.0, linestyle="--", label=f"{name}, {loads} alone")
    if one.fit is not None:
        axes.plot(
            levels, one.fit.fit.at(levels), color=colour, linewidth=1.0, linestyle=":", label=f"{name}, lognormal"
        )
    if one.verified:
        estimates = [level.estimate for level in one.verified]
        middle, low, high = np.array([(it.probability, it.low, it.high) for it in estimates]).T
        # An estimate near 0 or 1 may round beyond its interval's end.
        lengths = np.maximum([middle - low, high - middle], 0.0)
        label = f"{name}, verified ({100.0 * estimates[0].confidence:g} % intervals)"
        look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "capsize": 2.5, "linewidth": 1.0}
        at = [level.level for level in one.verified]
        axes.errorbar(at, middle, lengths, label=label, **look)
        others = [it.others or (np.nan, np.nan) for it in estimates if isinstance(it, StripeFindings)]
        if others and np.isfinite(others).any():
            axes.vlines(at, *np.transpose(others), color=colour, linewidth=0.6, label=f"{name}, other values")


def _shown_levels(findings: FragilityFindings) -> tuple[float, float]:
    """The ladder without the levels at which every curve is flat at 0 or 1."""
    levels = findings.ladder.levels
    curves = np.array([one.curve.probability for one in findings.boundaries])
    moving = np.flatnonzero(((curves > 0.001) & (curves < 0.999)).any(axis=0))
    if not len(moving):
        return float(levels[0]), float(levels[-1])
    first, last = max(0, moving[0] - 1), min(len(levels) - 1, moving[-1] + 1)
    low, high = float(levels[first]), float(levels[last])
    if findings.median is not None:
        low, high = min(low, 0.95 * findings.median), max(high, 1.05 * findings.median)
    return low, high


_WIDTH = 26
"""Letters in a line of text that fits into a panel."""

_OTHER = "other look"
"""Status of another look of a search, which is no result."""


class Mark(NamedTuple):
    """A design in a chart.

    Attributes:
        x: its value of the chart's axis.
        y: its value of the required variable.
        line: its value of the lines' variable; None if it is not shown.
        target: what it was verified for.
        status: of the design, or "other look".
    """

    x: float
    y: float
    line: float | None
    target: float
    status: str


@styled()
def plot_required(chart: RequiredChart, shown: Mapping[str, Quantity], marks: Sequence[Mark] = ()) -> dict[str, Figure]:
    """The required variable against another, a line for each value of a third variable; a figure for each target.

    Args:
        chart: what is required.
        shown: the variables, by name.
        marks: designs, each in the figure of its target.

    Returns:
        The figures, whose axes have the same ends, by file name.
    """
    figures = {}
    required, along = shown[chart.name], shown[chart.lines].symbol
    for target, lines in zip(chart.targets.tolist(), chart.required, strict=True):
        figures[f"required_{100.0 * target:g}"], axes = panel(3.9, 3.9)
        for colour, marker, value, line in zip(LINE_COLOURS, LINE_MARKERS, chart.values, lines, strict=False):
            label = f"{along} = {value:.3g}" + (": none" if np.isnan(line).all() else "")
            axes.plot(chart.x, line, color=colour, marker=marker, markersize=4, label=label)
        if np.isnan(lines).all():
            why = textwrap.fill(f"no {required.symbol} in its range meets this target", _WIDTH)
            axes.text(0.5, 0.35, why, transform=axes.transAxes, ha="center", va="center", color=GREY)
        for mark in marks:
            if np.isclose(mark.target, target):
                label = mark.status if mark.line is None else f"{mark.status}: {along} = {mark.line:.3g}"
                axes.plot([mark.x], [mark.y], label=label, **_look(mark.status))
        axes.set_title(f"P({plain(words(chart.outcome))}) ≤ {100.0 * target:g} %")
        axes.set(xlabel=shown[chart.across].axis, ylabel=f"required {required.axis}")
    panels = [figure.axes[0] for figure in figures.values()]
    ends = np.array([[*axes.get_xlim(), *axes.get_ylim()] for axes in panels])
    left, right, low, high = np.where([True, False, True, False], ends.min(axis=0), ends.max(axis=0)).tolist()
    for figure, axes in zip(figures.values(), panels, strict=True):
        axes.set(xlim=(left, right), ylim=(low, high))
        legend_outside(figure)
    return figures


def _look(status: str) -> dict[str, Any]:
    if status == _OTHER:
        return {"marker": "x", "linestyle": "", "color": GREY, "zorder": 3}
    face = BLACK if status == "verified" else "none"
    return {"marker": "D", "linestyle": "", "color": BLACK, "markerfacecolor": face, "zorder": 4}


def marks_of(findings: DesignFindings) -> list[Mark]:
    """The marks of a design and of the other looks; none where the chart does not have its values."""
    chart, designed, values = findings.chart, findings.designed, findings.bearing
    if chart is None or chart.across not in values or chart.name not in values:
        return []
    target, x = designed.task.requirements[0].target, values[chart.across]
    others = [look.candidate.values for look in designed.looks if look is not designed.result]
    marks = [Mark(tried.get(chart.across, x), tried[chart.name], None, target, _OTHER) for tried in others]
    return [*marks, Mark(x, values[chart.name], values.get(chart.lines), target, designed.status)]


def marks_of_stored(chart: RequiredChart, designs: Sequence[StoredDesign]) -> list[Mark]:
    """The marks of stored designs."""
    return [
        Mark(
            x=one.bearing[chart.across],
            y=one.bearing[chart.name],
            line=one.bearing[chart.lines],
            target=one.requirement.target,
            status="verified",
        )
        for one in designs
    ]


@styled()
def plot_looks(findings: DesignFindings, targets: Sequence[str]) -> Figure:
    """The probability and bounds of each look for each target, which has a text, beside the target.

    Args:
        findings: of a search.
        targets: their texts.
    """
    figure, axes = panel(*SIZE)
    looks, requirements = findings.designed.looks, findings.designed.task.requirements
    for number, (colour, marker, text, one) in enumerate(
        zip(LINE_COLOURS, LINE_MARKERS, map(plain, targets), requirements, strict=False)
    ):
        estimates = [look.estimates[number] for look in looks]
        middle, low, high = 100.0 * np.array([(of.probability, of.low, of.high) for of in estimates]).T
        x = np.arange(len(looks)) + 0.1 * number
        lengths = np.maximum([middle - low, high - middle], 0.0)
        axes.errorbar(x, middle, lengths, color=colour, marker=marker, linestyle="", capsize=4)
        axes.axhline(100.0 * one.target, color=colour, linestyle="--", label=text)
    axes.set_xticks(range(len(looks)), [f"look {number}" for number in range(1, len(looks) + 1)])
    axes.set(xlim=(-0.6, len(looks) - 0.4), ylabel="probability from simulations [%]")
    axes.set_ylim(0.0, 1.1 * axes.dataLim.y1)
    legend_outside(figure)
    return figure


@styled()
def plot_indices(indices: Sequence[Index], confidence: float, quantities: Mapping[str, Quantity]) -> Figure:
    """Plot first and total Sobol' indices with their intervals, the largest on top.

    Args:
        indices: in the order of the rows.
        confidence: of the intervals.
        quantities: of the variables, by name.
    """
    figure, axes = panel(5.4, 1.3 + 0.4 * len(indices))
    for title, colour, marker, lift, estimates in (
        ("first index: the variable alone", BLUE, "o", -0.12, [index.first for index in indices]),
        ("total index: with all interactions", VERMILION, "s", 0.12, [index.total for index in indices]),
    ):
        axes.errorbar(
            [one.value for one in estimates],
            [row + lift for row in range(len(indices))],
            xerr=[[one.value - one.low for one in estimates], [one.high - one.value for one in estimates]],
            linestyle="",
            marker=marker,
            color=colour,
            capsize=3,
            label=title,
        )
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set_yticks(range(len(indices)), [quantities[index.name].symbol for index in indices])
    axes.set_xlabel(f"Sobol' index, with {100 * confidence:g} % intervals of the sampling")
    axes.invert_yaxis()
    legend_outside(figure, "outside upper left")
    return figure


@styled()
def plot_moves(moves: Sequence[Move], probability: float, outcome: str, quantities: Mapping[str, Quantity]) -> Figure:
    """Plot the probability at the low and the high value of each variable, the largest effect on top.

    Args:
        moves: in the order of the rows.
        probability: with all variables at their base values.
        outcome: whose probability it is, in words.
        quantities: of the variables, by name.
    """
    figure, axes = panel(5.4, 1.3 + 0.4 * len(moves))
    axes.axvline(probability, color=GREY, linestyle=":", label="base values")
    for row, move in enumerate(moves):
        axes.plot([move.at_low, probability, move.at_high], [row] * 3, color=GREY, linewidth=0.8, zorder=1)
    rows = range(len(moves))
    axes.plot([move.at_low for move in moves], rows, "v", color=BLUE, label="low value")
    axes.plot([move.at_high for move in moves], rows, "^", color=ORANGE, label="high value")
    names = [
        f"{quantities[move.name].symbol}: {significant(move.low)}, {significant(move.value)}, "
        f"{significant(move.high)} {quantities[move.name].unit}".rstrip()
        for move in moves
    ]
    axes.set_yticks(rows, names)
    axes.set_xlabel(f"P({outcome}) by the classifier, without intervals")
    axes.set_xlim(left=0.0)
    axes.invert_yaxis()
    legend_outside(figure, "outside upper left")
    return figure
