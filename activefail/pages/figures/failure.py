"""The probability of failure against simulations, and the failure domain through its most probable design."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from activefail.analyses.findings.failure import RARE, FailureFindings
from activefail.analyses.findings.results import Findings
from activefail.estimates.design_point import DesignPoint
from activefail.pages.figures.axes import legend_outside, outcome_handles, own_axes, panel, scatter_outcomes
from activefail.pages.figures.style import BLACK, BLUE, GREY, LIGHT_GREY, ORANGE, SKY_BLUE, VERMILION, styled
from activefail.space.space import Array, DesignSpace
from activefail.text.quantities import Quantity, plain

_GRID = 90
"""Points along each side of the plane."""

_SURE = 1.96
"""Least |mean/sd| of the latent where the side is decided with 95 %."""

_LEAST = 4.0
"""Least half-width of the plane in standard deviations."""


@styled()
def plot_probability(failure: FailureFindings, beyond: str, width: float = 5.4) -> Figure:
    """`draw_probability`, and below it the simulations beyond the boundary so far.

    Args:
        failure: the curve, and the estimate from fresh simulations if there is one.
        beyond: the outcomes beyond the boundary, as mathtext.
        width: of the figure [in].
    """
    figure = Figure(figsize=(width, 1.5 + 0.53 * width), layout="constrained")
    axes, counts = figure.subplots(2, 1, sharex=True, height_ratios=[3.0, 1.0])
    draw_probability(axes, failure, beyond)
    legend_outside(figure)
    counts.step(failure.simulations, failure.seen, where="post", color=BLACK)
    counts.set(xlabel="simulations", ylabel=f"{beyond}\nseen")
    counts.xaxis.set_major_locator(MaxNLocator(integer=True))
    counts.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    return figure


@styled()
def draw_probability(axes: Axes | None, failure: FailureFindings, beyond: str) -> Axes:
    """The probability with its 95 % interval under the classifier, and that from fresh simulations.

    Args:
        axes: to draw on; new ones of pyplot, which a notebook shows, if None.
        failure, beyond: as for `plot_probability`.
    """
    axes, n = own_axes(axes), failure.simulations
    positive = failure.probability > 0.0
    known = np.isfinite(failure.low) & positive
    if known.any():
        ends, label = (failure.low[known], failure.high[known]), "95 % interval under the classifier"
        axes.fill_between(n[known], *ends, color=BLUE, alpha=0.15, linewidth=0.0, label=label)
    axes.plot(n[positive], failure.probability[positive], color=BLUE, marker="o", label="classifier")
    if (estimate := failure.estimate) is not None and estimate.probability > 0.0:
        low = max(estimate.low, 1e-3 * estimate.probability)
        # Rounding may make a length negative.
        lengths = np.maximum([[estimate.probability - low], [estimate.high - estimate.probability]], 0.0)
        label = f"{estimate.simulations} fresh simulations, {100.0 * estimate.confidence:g} % interval"
        axes.errorbar([n[-1]], [estimate.probability], lengths, color=VERMILION, marker="D", capsize=4, label=label)
    if failure.best < RARE:
        axes.set_yscale("log")
        if positive.any():
            # An interval that spans many decades before the first failures must not flatten the rest.
            last = failure.probability[positive][-1]
            axes.set_ylim(max(axes.get_ylim()[0], 1e-3 * last), min(axes.get_ylim()[1], max(1e3 * last, 1e-2), 1.5))
    axes.set_ylabel(f"P({beyond}) [–]")
    return axes


def plane_of(point: DesignPoint, space: DesignSpace) -> tuple[int, int]:
    """The two variables that are farthest from their medians at the design point, in order."""
    distance = np.abs(_marginal(point.X, space))
    first, second = sorted(np.argsort(-distance, kind="stable")[:2].tolist())
    return first, second


def _marginal(x: Array, space: DesignSpace) -> Array:
    """A design, (d,), in standard normal values of each variable by itself."""
    return np.array([float(p.to_normal(np.asarray(value))) for p, value in zip(space.parameters, x, strict=True)])


@styled()
def plot_failure_domain(
    point: DesignPoint,
    standardised: Callable[[Array], Array],
    findings: Findings,
    quantities: Sequence[Quantity],
    width: float = 7.0,
) -> Figure:
    """The failure domain in the plane of the two variables that matter most, through the most probable failure.

    Args:
        point: the design point; the other variables have its values.
        standardised: the latent's mean/sd as a function of designs.
        findings: of a campaign with at least two variables.
        quantities: of the variables.
        width: of the figure [in].
    """
    space, outcomes, beyond = findings.campaign.space, findings.campaign.simulator.outcomes, plain(findings.beyond)
    known = findings.history.training
    i, j = plane_of(point, space)
    half = max(_LEAST, float(np.abs(_marginal(point.X, space)[[i, j]]).max()) + 1.0)
    line = np.linspace(-half, half, _GRID)
    pair = np.eye(2) if space.factor is None else (space.factor @ space.factor.T)[np.ix_([i, j], [i, j])]
    grid = np.stack(np.meshgrid(line, line), axis=-1)
    distance = np.sqrt(np.einsum("abi,ij,abj->ab", grid, np.linalg.inv(pair), grid))
    along = np.stack([p.from_normal(line) for p in space.parameters], axis=1)
    rows = np.tile(point.X, (_GRID * _GRID, 1))
    rows[:, i], rows[:, j] = (values.ravel() for values in np.meshgrid(along[:, i], along[:, j]))
    certainty = standardised(rows).reshape(_GRID, _GRID)
    x, y = along[:, i], along[:, j]
    figure, axes = panel(width, 0.8 * width)
    farthest = float(np.abs(certainty).max()) + 2.0 * _SURE
    sides = (SKY_BLUE, LIGHT_GREY, ORANGE)
    axes.contourf(x, y, certainty, levels=[-farthest, -_SURE, _SURE, farthest], colors=sides, alpha=0.45)
    if certainty.min() < 0.0 < certainty.max():
        axes.contour(x, y, certainty, levels=[0.0], colors=BLACK, linewidths=1.6)
    axes.contour(x, y, distance, levels=np.arange(1.0, half), colors=GREY, linestyles=":", linewidths=1.1)
    scatter_outcomes(axes, known.designs[:, i], known.designs[:, j], known.outcome, outcomes, 26.0)
    axes.plot(point.X[i], point.X[j], marker="*", markersize=14, color=BLACK, markeredgecolor="white", zorder=4)
    axes.set(xlim=(along[0, i], along[-1, i]), ylim=(along[0, j], along[-1, j]))
    axes.set(xlabel=quantities[i].axis, ylabel=quantities[j].axis)
    axes.grid(False)
    handles = [
        *outcome_handles(outcomes),
        Patch(color=sides[2], alpha=0.45, label=f"{beyond} predicted"),
        Patch(color=sides[1], alpha=0.45, label="undecided"),
        Line2D([], [], color=BLACK, linewidth=1.6, label="boundary"),
        Line2D([], [], linestyle="", marker="*", markersize=10, color=BLACK, label="design point"),
        Line2D([], [], linestyle=":", color=GREY, label="1, 2, … standard deviations"),
    ]
    legend_outside(figure, handles=handles)
    return figure
