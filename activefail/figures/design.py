"""The value of a variable that targets require, with the verified design."""

import numpy as np
from matplotlib.figure import Figure

from activefail.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY_BLUE, VERMILION, styled
from activefail.risk.design.findings import DesignFindings
from activefail.space import DesignSpace

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY_BLUE)


def plot_required(findings: DesignFindings) -> Figure:
    """The chart of a design: the required variable against another, a panel for each target, a line for each third.

    Args:
        findings: of a design with a chart.
    """
    chart, space = findings.chart, findings.campaign.space
    assert chart is not None
    with styled():
        figure = Figure(figsize=(2.2 + 2.9 * len(chart.targets), 3.9), layout="constrained")
        panels = figure.subplots(1, len(chart.targets), sharex=True, sharey=True, squeeze=False)[0]
        for axes, target, lines in zip(panels, chart.targets, chart.required, strict=True):
            for colour, value, required in zip(_COLOURS, chart.values, lines, strict=False):
                axes.plot(chart.x, required, color=colour, marker=".", label=f"{chart.lines} = {value:.3g}")
            axes.set_title(f"P({chart.outcome}) ≤ {100.0 * target:g} %")
            axes.set_xlabel(_labelled(chart.across, space))
        panels[0].set_ylabel(f"required {_labelled(chart.name, space)}")
        _mark_design(findings, panels)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(6, len(labels)))
    return figure


def _mark_design(findings: DesignFindings, panels: "np.ndarray") -> None:
    """Mark the verified design in the panels of its target, and looks that were not accepted."""
    chart, designed = findings.chart, findings.designed
    assert chart is not None
    values = findings.bearing
    if chart.across not in values or chart.name not in values:
        return
    x = values[chart.across]
    for axes, target in zip(panels, chart.targets, strict=True):
        if not np.isclose(target, designed.task.requirements[0].target):
            continue
        for look in designed.looks[:-1]:
            axes.plot(
                [look.candidate.values.get(chart.across, x)], [look.candidate.values[chart.name]], "x", color=GREY
            )
        verified = designed.status == "verified"
        shown = BLACK if verified else "none"
        label = f"{designed.status}: {chart.lines} = {values.get(chart.lines, float('nan')):.3g}"
        axes.plot([x], [values[chart.name]], "D", color=BLACK, markerfacecolor=shown, label=label)
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(handles[-1:], labels[-1:], loc="best")


def _labelled(name: str, space: DesignSpace) -> str:
    unit = next((parameter.unit for parameter in space.parameters if parameter.name == name), "")
    return f"{name} [{unit or '–'}]"
