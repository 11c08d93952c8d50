"""The paper's Figures 3 to 5: contours of P(failure) in planes of two features, and predictions along lines in them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtr

from activefail.report.style import BLUE, GREEN, GREY, PURPLE, VERMILION, styled
from activefail.space import Array

Moments = Callable[[Array], tuple[Array, Array]]
"""Latent mean and standard deviation, each (n,), at features in the paper's units, (n, 6)."""

LABELS = ("$D_{ratio}$", "$T_b/T_p$", "$\\mu/A_p$", "$h_{sl}/D_{sl}$", "$h_{rim}/D_{sl}$", "$k_{norm}$")
_HELD_AT_MEDIAN = (3, 4, 5)
_GRID = 120


@dataclass(frozen=True)
class Plane:
    """One of the paper's figures: axes, the third feature with its three values, and where the lines below are.

    Attributes:
        name: of the figure.
        x, y, third: columns of the features.
        quantiles: of the third feature at which the panels are.
    """

    name: str
    x: int
    y: int
    third: int
    quantiles: tuple[float, float, float] = (0.25, 0.5, 0.75)


PLANES = (
    Plane("figure3", x=1, y=0, third=2),
    Plane("figure4", x=2, y=0, third=1),
    Plane("figure5", x=2, y=1, third=0),
)
"""The paper's three; the lower panels run along y at constant x, for the middle value of the third feature."""


def _limits(column: Array) -> tuple[float, float]:
    """Where nine tenths of the training points are: the ratios' long tails would leave the boundary in a corner."""
    low, high = np.quantile(column, [0.0, 0.9])
    return float(low), float(high)


def _points(axes: Axes, x: Array, y: Array, failed: Array) -> None:
    for value, colour, marker in ((False, BLUE, "o"), (True, VERMILION, "^")):
        rows = failed == value
        axes.scatter(x[rows], y[rows], s=14, c=colour, marker=marker, edgecolors="white", linewidths=0.4, zorder=3)


def plot_plane(plane: Plane, moments: Moments, F: Array, failed: Array) -> Figure:
    """Three panels of contours of P(failure), and three of the label's prediction with its 95 % band.

    Args:
        moments: of the failure latent.
        F: (n, 6) features of the training points in the paper's units.
        failed: (n,) bool.
    """
    medians = np.median(F, axis=0)
    thirds = np.quantile(F[:, plane.third], plane.quantiles)
    # Half of the distance between neighbouring panels, so that a point is shown in one panel only.
    half_width = 0.5 * float(np.min(np.diff(thirds)))
    x_low, x_high = _limits(F[:, plane.x])
    y_low, y_high = _limits(F[:, plane.y])
    lines = x_low + np.array([0.15, 0.4, 0.75]) * (x_high - x_low)

    def at(x: Array, y: Array, third: float) -> tuple[Array, Array]:
        rows = np.tile(medians, (x.size, 1))
        rows[:, plane.x], rows[:, plane.y], rows[:, plane.third] = x.ravel(), y.ravel(), third
        mean, sd = moments(rows)
        return mean.reshape(x.shape), sd.reshape(x.shape)

    with styled():
        figure = Figure(figsize=(10.0, 6.6), layout="constrained")
        axes = figure.subplots(2, 3)
        x, y = np.meshgrid(np.linspace(x_low, x_high, _GRID), np.linspace(y_low, y_high, _GRID))
        for panel, third in zip(axes[0], thirds, strict=True):
            mean, sd = at(x, y, third)
            probability = ndtr(mean / np.sqrt(1.0 + sd**2))
            panel.contourf(x, y, probability, levels=np.linspace(0.0, 1.0, 11), cmap="cividis", alpha=0.35)
            drawn = panel.contour(x, y, probability, levels=[0.1, 0.3, 0.5, 0.7, 0.9], colors=GREY, linewidths=0.9)
            panel.clabel(drawn, fontsize=7)
            near = np.abs(F[:, plane.third] - third) <= half_width
            _points(panel, F[near, plane.x], F[near, plane.y], failed[near])
            panel.set_title(f"{LABELS[plane.third]} = {third:.2f} (points: ± {half_width:.2f})")
            panel.set_xlabel(LABELS[plane.x])
            panel.set_ylabel(LABELS[plane.y])
            panel.set_xlim(x_low, x_high)
            panel.set_ylim(y_low, y_high)
        for line in lines:
            axes[0][1].axvline(line, color="black", linestyle=":", linewidth=1.2)
        line_width = 0.1 * (x_high - x_low)
        along = np.linspace(y_low, y_high, 200)
        near_third = np.abs(F[:, plane.third] - thirds[1]) <= half_width
        for panel, line in zip(axes[1], lines, strict=True):
            mean, sd = at(np.full_like(along, line), along, thirds[1])
            low, high = (2.0 * ndtr(mean + sign * 1.96 * sd) - 1.0 for sign in (-1.0, 1.0))
            panel.fill_between(along, low, high, color=GREY, alpha=0.25, linewidth=0.0, label="95 % of the latent")
            probability = ndtr(mean / np.sqrt(1.0 + sd**2))
            panel.plot(along, 2.0 * probability - 1.0, color="black", label="2 P(failure) − 1")
            near = near_third & (np.abs(F[:, plane.x] - line) <= line_width)
            _points(panel, F[near, plane.y], np.where(failed[near], 1.0, -1.0), failed[near])
            panel.set_title(
                f"{LABELS[plane.x]} = {line:.2f} ± {line_width:.2f}, {LABELS[plane.third]} = {thirds[1]:.2f}"
            )
            panel.set_xlabel(LABELS[plane.y])
            panel.set_ylabel("−1 no failure … 1 failure")
            panel.set_xlim(y_low, y_high)
            panel.set_ylim(-1.15, 1.15)
        axes[1][0].legend(loc="center right")
        fixed = ", ".join(f"{LABELS[i]} = {medians[i]:.2f}" for i in _HELD_AT_MEDIAN)
        figure.suptitle(
            f"Contours of P(failure) at {fixed}; dotted: the lines of the panels below.  "
            "● no failure   ▲ failure (training points)",
            fontsize=9,
        )
    return figure


def plot_reliability(probabilities: dict[str, Array], failed: Array, bins: int = 10) -> Figure:
    """Observed share of failures against predicted probability, one line a method; perfect is the diagonal.

    Args:
        probabilities: (n,) of failure, by the method's title.
        failed: (n,) bool.
        bins: of equal width.
    """
    with styled():
        figure = Figure(figsize=(5.4, 5.0), layout="constrained")
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=GREY, linestyle=":", label="perfect")
        for (title, p), colour, marker in zip(
            probabilities.items(), (BLUE, VERMILION, GREEN, PURPLE), "osD^", strict=True
        ):
            place = np.clip((p * bins).astype(int), 0, bins - 1)
            counts = np.bincount(place, minlength=bins)
            shown = counts > 0
            predicted = np.bincount(place, weights=p, minlength=bins)[shown] / counts[shown]
            observed = np.bincount(place, weights=failed, minlength=bins)[shown] / counts[shown]
            axes.plot(predicted, observed, color=colour, marker=marker, label=title)
        axes.set_xlabel("predicted P(failure)")
        axes.set_ylabel("share of failures among fresh designs")
        axes.legend(loc="upper left")
    return figure
