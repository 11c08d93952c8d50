"""The value of a variable that targets require, with verified designs."""

import textwrap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from activefail.figures.axes import legend_outside
from activefail.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY_BLUE, VERMILION, styled
from activefail.risk.design.findings import DesignFindings
from activefail.risk.design.required_chart import RequiredChart
from activefail.risk.design.stored import StoredDesign
from activefail.space import DesignSpace

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY_BLUE)
_MARKERS = ("o", "s", "^", "v", "P", "X")
"""Of the lines. A line with one value is a single marker; the diamond is a design's."""

_WIDTH = 26
"""Letters in a line of text that fits into a panel."""


class Mark(NamedTuple):
    """A design in a chart.

    Attributes:
        x: its value of the chart's axis.
        y: its value of the required variable.
        target: what it was verified for.
        label: in the legend.
        is_verified: whether it meets the target with confidence.
        is_result: whether it is a result, and not another look of a search.
    """

    x: float
    y: float
    target: float
    label: str
    is_verified: bool = True
    is_result: bool = True


@styled()
def plot_required(chart: RequiredChart, space: DesignSpace, marks: Sequence[Mark] = ()) -> Figure:
    """The required variable against another: a panel for each target, a line for each value of a third variable.

    Args:
        chart: what is required.
        space: of the campaign; has the units.
        marks: designs, each in the panel of its target.
    """
    figure = Figure(figsize=(2.2 + 2.9 * len(chart.targets), 3.9), layout="constrained")
    panels = figure.subplots(1, len(chart.targets), sharex=True, sharey=True, squeeze=False)[0]
    labels = [
        f"{chart.lines} = {value:.3g}" + (f": no {chart.name} meets a target" if np.isnan(required).all() else "")
        for value, required in zip(chart.values, chart.required.swapaxes(0, 1), strict=True)
    ]
    for axes, target, lines in zip(panels, chart.targets, chart.required, strict=True):
        for colour, marker, label, required in zip(_COLOURS, _MARKERS, labels, lines, strict=False):
            axes.plot(chart.x, required, color=colour, marker=marker, markersize=4, label=label)
        if np.isnan(lines).all():
            why = textwrap.fill(f"no {chart.name} in its range meets this target", _WIDTH)
            axes.text(0.5, 0.35, why, transform=axes.transAxes, ha="center", va="center", color=GREY)
        _draw_marks(axes, [mark for mark in marks if np.isclose(mark.target, target)])
        axes.set_title(f"P({chart.outcome}) ≤ {100.0 * target:g} %")
        axes.set_xlabel(_labelled(chart.across, space))
    panels[0].set_ylabel(f"required {_labelled(chart.name, space)}")
    legend_outside(figure)
    return figure


def marks_of(findings: DesignFindings) -> list[Mark]:
    """The marks of a design and of the other looks; none where the chart does not have its values."""
    chart, designed, values = findings.chart, findings.designed, findings.bearing
    if chart is None or chart.across not in values or chart.name not in values:
        return []
    target, x = designed.task.requirements[0].target, values[chart.across]
    others = [look.candidate.values for look in designed.looks if look is not designed.result]
    marks = [
        Mark(tried.get(chart.across, x), tried[chart.name], target, "other look", is_verified=False, is_result=False)
        for tried in others
    ]
    verified = designed.status == "verified"
    label = f"{designed.status}: {chart.lines} = {values.get(chart.lines, float('nan')):.3g}"
    return [*marks, Mark(x, values[chart.name], target, label, is_verified=verified)]


def marks_of_stored(chart: RequiredChart, designs: Sequence[StoredDesign]) -> list[Mark]:
    """The marks of stored designs."""
    return [
        Mark(
            one.bearing[chart.across],
            one.bearing[chart.name],
            one.requirement.target,
            f"verified: {chart.lines} = {one.bearing[chart.lines]:.3g}",
        )
        for one in designs
    ]


def _draw_marks(axes: Axes, marks: Sequence[Mark]) -> None:
    for mark in marks:
        if not mark.is_result:
            axes.plot([mark.x], [mark.y], "x", color=GREY, label=mark.label, zorder=3)
            continue
        face = BLACK if mark.is_verified else "none"
        axes.plot([mark.x], [mark.y], "D", color=BLACK, markerfacecolor=face, label=mark.label, zorder=4)


def _labelled(name: str, space: DesignSpace) -> str:
    unit = next((parameter.unit for parameter in space.parameters if parameter.name == name), "")
    return f"{name} [{unit or '–'}]"
