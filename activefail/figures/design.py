"""The value of a variable that targets require, with verified designs."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from activefail.figures.axes import legend_outside
from activefail.figures.style import BLACK, GREY, LINE_COLOURS, LINE_MARKERS, styled
from activefail.findings.quantities import Quantity, plain, words
from activefail.risk.design.findings import DesignFindings
from activefail.risk.design.required_chart import RequiredChart
from activefail.risk.design.stored import StoredDesign

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
def plot_required(chart: RequiredChart, shown: Mapping[str, Quantity], marks: Sequence[Mark] = ()) -> Figure:
    """The required variable against another: a panel for each target, a line for each value of a third variable.

    Args:
        chart: what is required.
        shown: the variables, by name.
        marks: designs, each in the panel of its target.
    """
    figure = Figure(figsize=(2.2 + 2.9 * len(chart.targets), 3.9), layout="constrained")
    panels = figure.subplots(1, len(chart.targets), sharex=True, sharey=True, squeeze=False)[0]
    required, along = shown[chart.name], shown[chart.lines].symbol
    labels = [
        f"{along} = {value:.3g}" + (f": no {required.symbol} meets a target" if np.isnan(line).all() else "")
        for value, line in zip(chart.values, chart.required.swapaxes(0, 1), strict=True)
    ]
    for axes, target, lines in zip(panels, chart.targets, chart.required, strict=True):
        for colour, marker, label, line in zip(LINE_COLOURS, LINE_MARKERS, labels, lines, strict=False):
            axes.plot(chart.x, line, color=colour, marker=marker, markersize=4, label=label)
        if np.isnan(lines).all():
            why = textwrap.fill(f"no {required.symbol} in its range meets this target", _WIDTH)
            axes.text(0.5, 0.35, why, transform=axes.transAxes, ha="center", va="center", color=GREY)
        for mark in marks:
            if np.isclose(mark.target, target):
                label = mark.status if mark.line is None else f"{mark.status}: {along} = {mark.line:.3g}"
                axes.plot([mark.x], [mark.y], label=label, **_look(mark.status))
        axes.set_title(f"P({plain(words(chart.outcome))}) ≤ {100.0 * target:g} %")
        axes.set_xlabel(shown[chart.across].axis)
    panels[0].set_ylabel(f"required {required.axis}")
    legend_outside(figure)
    return figure


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
