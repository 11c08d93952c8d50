"""Fragility curves with verified levels, and the pulses that contribute the failures."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from activefail.figures.axes import legend_outside, plain_log
from activefail.figures.marks import outcome_colour, outcome_marker
from activefail.figures.style import BLACK, VERMILION, styled
from activefail.findings.quantities import plain, quantity, words
from activefail.risk.fragility.deaggregation import Deaggregation
from activefail.risk.fragility.findings import BoundaryFragility, FragilityFindings

_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""Labels in a decade of an axis."""


@styled()
def plot_fragility_findings(findings: FragilityFindings) -> Figure:
    """The curves of all boundaries; beside them, under a hazard, the pulses that cause the most severe outcome.

    The curve is the result. The lognormal curve, dotted, shows how far it is from one.
    """
    deaggregation = findings.boundaries[-1].deaggregation
    is_shown = deaggregation is not None and deaggregation.failures is not None
    figure = Figure(figsize=(10.4 if is_shown else 6.4, 4.8), layout="constrained")
    axes = figure.subplots(1, 2 if is_shown else 1, squeeze=False)[0]
    _draw_curves(axes[0], findings)
    legend_outside(figure)
    if deaggregation is not None and is_shown:
        _draw_pulses(figure, axes[1], deaggregation, findings.boundaries[-1].outcome)
    return figure


def _draw_curves(axes: Axes, findings: FragilityFindings) -> None:
    outcomes = ("", *(one.outcome for one in findings.boundaries))
    for index, one in enumerate(findings.boundaries, start=1):
        _draw_boundary(axes, one, outcome_colour(outcomes, index), outcome_marker(outcomes, index))
    if findings.median is not None:
        axes.axvline(findings.median, color=BLACK, linewidth=0.9, linestyle="-.", label="median of the hazard")
    if findings.ladder.is_log:
        axes.set_xscale("log")
        plain_log(axes.xaxis, _STEPS)
    variable = quantity(findings.ladder.name, findings.ladder.unit)
    axes.set(xlabel=variable.axis, ylabel="probability of this outcome or worse [–]", ylim=(-0.02, 1.02))
    axes.set_xlim(*_shown_levels(findings))
    axes.set_title(plain(findings.title))


def _draw_boundary(axes: Axes, one: BoundaryFragility, colour: str, marker: str) -> None:
    levels, name = one.curve.ladder.levels, plain(words(one.outcome))
    axes.plot(levels, one.curve.probability, color=colour, linewidth=1.8, label=name)
    if one.alone is not None:
        alone = one.alone.ladder.levels, one.alone.probability
        axes.plot(*alone, color=colour, linewidth=1.0, linestyle="--", label=f"{name}, pulses alone")
    if (fit := one.lognormal) is not None:
        axes.plot(levels, fit.at(levels), color=colour, linewidth=1.0, linestyle=":", label=f"{name}, lognormal")
    if one.verified:
        estimates = [level.estimate for level in one.verified]
        middle, low, high = np.array([(it.probability, it.low, it.high) for it in estimates]).T
        # An estimate near 0 or 1 may round beyond its interval's end.
        lengths = np.maximum([middle - low, high - middle], 0.0)
        label = f"{name}, verified ({100.0 * estimates[0].confidence:g} % intervals)"
        look: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": "", "capsize": 2.5, "linewidth": 1.0}
        axes.errorbar([level.level for level in one.verified], middle, lengths, label=label, **look)


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


def _draw_pulses(figure: Figure, axes: Axes, deaggregation: Deaggregation, outcome: str) -> None:
    assert deaggregation.failures is not None
    shares = 100.0 * deaggregation.failures.share.T
    mesh = axes.pcolormesh(deaggregation.period, deaggregation.velocity, shares, cmap="Greys", vmin=0.0)
    axes.set(xscale="log", yscale="log", xlabel=quantity("T_p").axis, ylabel=quantity("PGV", "m/s").axis)
    axes.set_title(f"Pulses that cause {plain(words(outcome))} under the hazard")
    axes.grid(visible=False)
    for axis in (axes.xaxis, axes.yaxis):
        plain_log(axis, _STEPS)
    median = deaggregation.pulses.period.p50, deaggregation.pulses.velocity.p50
    axes.plot(*median, "+", color=VERMILION, markersize=10, label="median pulse of the hazard")
    axes.legend(loc="lower left")
    figure.colorbar(mesh, ax=axes, label="share of the failures [%]")
