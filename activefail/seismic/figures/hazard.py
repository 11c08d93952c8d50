"""The pulses of a hazard with the boundary of a campaign's design space, those that fail, and the hazard curve."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from activefail.campaign.assembly import Campaign
from activefail.pages.figures.axes import panel, plain_log
from activefail.pages.figures.risk import SIZE, STEPS
from activefail.pages.figures.style import BLACK, BLUE, GREY, LIGHT_GREY, ORANGE, VERMILION, save_png_and_svg, styled
from activefail.seismic.bearing.pulse import velocity_of
from activefail.seismic.hazard.deaggregation import Deaggregation
from activefail.seismic.hazard.hazard import Hazard
from activefail.seismic.hazard.pulse_table import velocities
from activefail.seismic.hazard.summary import HazardSummary
from activefail.seismic.hazard.velocity import AMPLITUDE, PERIOD
from activefail.seismic.quantities import QUANTITIES
from activefail.space.space import Array, DesignSpace
from activefail.text.quantities import plain, quantity
from activefail.visible import words

_CONTOURS = (0.5, 0.9, 0.99)
"""Shares of the pulses inside the contours of their density."""

_EDGE = 200
"""Points along each side of the design space."""


def write_hazard(summary: HazardSummary, folder: Path, campaign: Campaign | None = None) -> list[Path]:
    """Write the figure into a folder as PNG and SVG; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    return save_png_and_svg(plot_hazard(summary, None if campaign is None else campaign.space), folder, "hazard")


@styled()
def plot_hazard(summary: HazardSummary, space: DesignSpace | None = None) -> Figure:
    """The joint distribution of T_p and PGV, and the hazard curve if there is one.

    Args:
        summary: of the hazard.
        space: of a campaign, whose boundary is drawn.
    """
    number = 2 if summary.curve else 1
    figure = Figure(figsize=(5.6 * number, 5.2), layout="constrained")
    panels = figure.subplots(1, number, squeeze=False)[0]
    axes = panels[0]
    if summary.hazard.rows is not None:
        _scatter(axes, summary.hazard)
    else:
        _contours(axes, summary)
    if space is not None:
        _boundary(axes, space)
    axes.set(xscale="log", yscale="log", xlabel="pulse period T$_p$ [s]", ylabel="peak ground velocity PGV [m/s]")
    axes.set_title("Pulses")
    plain_log(axes.xaxis)
    plain_log(axes.yaxis)
    # The design space rises to the right, and leaves this corner.
    axes.legend(loc="lower right")
    if summary.curve:
        _curve(panels[1], summary)
    return figure


def _contours(axes: Axes, summary: HazardSummary) -> None:
    """Contours of the lognormal density: ellipses of the logarithms, dashed with added uncertainty."""
    hazard = summary.hazard
    period, _, pgv, _ = summary.spreads
    angle = np.linspace(0.0, 2.0 * math.pi, 241)

    def ellipse(share: float, median: float, dispersion: float, rho: float) -> tuple[Array, Array]:
        # The squared radius of two standard normal variables is exponential with mean 2.
        radius = math.sqrt(-2.0 * math.log1p(-share))
        one, other = radius * np.cos(angle), radius * np.sin(angle)
        x = period.median * np.exp(period.dispersion * one)
        y = median * np.exp(dispersion * (rho * one + math.sqrt(1.0 - rho * rho) * other))
        return x, y

    for share, alpha in zip(_CONTOURS, (0.45, 0.25, 0.12), strict=True):
        x, y = ellipse(share, pgv.median, pgv.dispersion, summary.correlation)
        axes.fill(x, y, facecolor=BLUE, alpha=alpha, linewidth=0.0, label=f"{100.0 * share:g} % of the pulses")
    if hazard.added_dispersion or hazard.bias:
        total = math.hypot(pgv.dispersion, hazard.added_dispersion)
        rho = summary.correlation * pgv.dispersion / total
        x, y = ellipse(0.9, pgv.median * math.exp(-hazard.bias), total, rho)
        axes.plot(x, y, color=ORANGE, linestyle="--", label="90 %, with the added uncertainty")
    axes.plot(period.median, pgv.median, color=BLACK, marker="+", linestyle="", label="medians")


def _scatter(axes: Axes, hazard: Hazard) -> None:
    """The rows, with areas in proportion to their weights."""
    rows = hazard.rows
    assert rows is not None
    area = 60.0 * rows.weight / rows.weight.max()
    axes.scatter(
        rows.column(PERIOD),
        velocities(rows),
        s=np.maximum(area, 0.5),
        c=BLUE,
        alpha=0.5,
        linewidths=0.0,
        rasterized=len(area) > 500,
        label="pulses; the area shows the weight",
    )


def _boundary(axes: Axes, space: DesignSpace) -> None:
    """The campaign's range of T_p and A_p: A_p is PGV/T_p up to a factor, so two sides are slanted."""
    known = dict(zip(space.names, space.parameters, strict=True))
    period, amplitude = known[PERIOD], known[AMPLITUDE]
    x = np.geomspace(max(period.low, 1e-3 * period.high), period.high, _EDGE)
    ends = max(amplitude.low, 1e-3 * amplitude.high), amplitude.high
    low, high = (velocity_of(np.full(_EDGE, end), x) for end in ends)
    outline = np.concatenate([x, x[::-1], x[:1]]), np.concatenate([low, high[::-1], low[:1]])
    axes.plot(*outline, color=VERMILION, linewidth=1.6, label="the campaign's design space")
    axes.fill(*outline, facecolor=LIGHT_GREY, alpha=0.3, zorder=0)


def _curve(axes: Axes, summary: HazardSummary) -> None:
    pgv, rate = np.array(summary.curve).T
    axes.plot(pgv, rate, color=BLUE, marker="o", label="hazard curve")
    axes.axvline(summary.hazard.median_velocity, color=GREY, linestyle=":", label="median PGV of the pulses")
    axes.set(xscale="log", yscale="log", xlabel="peak ground velocity PGV [m/s]", title="Hazard curve")
    axes.set_ylabel("annual rate of exceedance [1/year]")
    plain_log(axes.xaxis)
    axes.legend(loc="best")


@styled()
def plot_pulses(deaggregation: Deaggregation, outcome: str) -> Figure | None:
    """The pulses that cause an outcome under a hazard: shares in bins of T_p and PGV; None if it is too rare."""
    if deaggregation.failures is None:
        return None
    figure, axes = panel(*SIZE)
    shares = 100.0 * deaggregation.failures.share.T
    mesh = axes.pcolormesh(deaggregation.period, deaggregation.velocity, shares, cmap="Greys", vmin=0.0)
    axes.set(xscale="log", yscale="log", xlabel=QUANTITIES["T_p"].axis, ylabel=quantity("PGV", "m/s").axis)
    axes.set_title(f"Pulses that cause {plain(words(outcome))} under the hazard")
    axes.grid(visible=False)
    for axis in (axes.xaxis, axes.yaxis):
        plain_log(axis, STEPS)
    median = deaggregation.pulses.period.p50, deaggregation.pulses.velocity.p50
    axes.plot(*median, "+", color=VERMILION, markersize=10, label="median pulse of the hazard")
    axes.legend(loc="lower left")
    figure.colorbar(mesh, ax=axes, label="share of the failures [%]")
    return figure
