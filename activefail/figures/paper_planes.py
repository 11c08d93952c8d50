"""The paper's Figures 3 to 5: contours of P(failure) in planes of two features, and predictions along lines in them."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.special import ndtr
from statsmodels.stats.proportion import proportion_confint

from activefail.figures.style import BLUE, GREEN, GREY, PURPLE, VERMILION, styled
from activefail.paper.study import PaperProcess
from activefail.space import Array

LABELS = ("$D_{ratio}$", "$T_b/T_p$", "$\\mu/A_p$", "$h_{sl}/D_{sl}$", "$h_{rim}/D_{sl}$", "$k_{norm}$")
_HELD_AT_MEDIAN = (3, 4, 5)
_GRID = 120
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)

SLICE = 0.02 / 0.11
"""Half-width of a slice over its value, from the only one that the paper states: μ/A_p = 0.11 ± 0.02."""


@dataclass(frozen=True)
class Plane:
    """One of the paper's figures.

    Attributes:
        name: of the figure.
        x, y, third: columns of the features.
        values: of the third feature, one for each upper panel.
        lines: values of x of the lower panels, which run along y at the middle value of the third feature.
    """

    name: str
    x: int
    y: int
    third: int
    values: tuple[float, float, float]
    lines: tuple[float, float, float]


PLANES = (
    Plane("figure3", x=1, y=0, third=2, values=(0.11, 0.16, 0.25), lines=(1.0, 1.5, 2.5)),
    Plane("figure4", x=2, y=0, third=1, values=(1.0, 1.5, 2.5), lines=(0.11, 0.16, 0.25)),
    Plane("figure5", x=2, y=1, third=0, values=(0.5, 1.0, 2.0), lines=(0.11, 0.16, 0.25)),
)
"""The paper's figures; it states μ/A_p = 0.11, the other values are round numbers where Table 1 has many designs."""


def _limits(column: Array) -> tuple[float, float]:
    """The range of nine tenths of the training points; over the ratios' long tails the boundary would be tiny."""
    low, high = np.quantile(column, [0.0, 0.9])
    return float(low), float(high)


def _points(axes: Axes, x: Array, y: Array, failed: NDArray[np.bool_]) -> None:
    for value, colour, marker in ((False, BLUE, "o"), (True, VERMILION, "^")):
        rows = failed == value
        axes.scatter(x[rows], y[rows], s=18, c=colour, marker=marker, edgecolors="white", linewidths=0.4, zorder=3)


def _beyond(outside: int) -> str:
    """Text for a title: how many points of a slice are beyond the axes."""
    return f"  ({outside} beyond)" if outside else ""


def plot_plane(plane: Plane, process: PaperProcess) -> Figure:
    """Three panels of contours of P(failure), and below them predictions along the dotted lines."""
    F, failed = process.F, process.failed
    medians = np.median(F, axis=0)
    x_low, x_high = _limits(F[:, plane.x])
    y_low, y_high = _limits(F[:, plane.y])
    inside = (F[:, plane.x] <= x_high) & (F[:, plane.y] <= y_high)

    def at(x: Array, y: Array, third: float) -> tuple[Array, Array]:
        rows = np.tile(medians, (x.size, 1))
        rows[:, plane.x], rows[:, plane.y], rows[:, plane.third] = x.ravel(), y.ravel(), third
        mean, sd = process.moments(rows)
        return mean.reshape(x.shape), sd.reshape(x.shape)

    def near(column: int, value: float) -> NDArray[np.bool_]:
        return np.asarray(np.abs(F[:, column] - value) <= SLICE * value)

    with styled():
        figure = Figure(figsize=(10.0, 7.2), layout="constrained")
        axes = figure.subplots(2, 3)
        x, y = np.meshgrid(np.linspace(x_low, x_high, _GRID), np.linspace(y_low, y_high, _GRID))
        for panel, third in zip(axes[0], plane.values, strict=True):
            mean, sd = at(x, y, third)
            probability = ndtr(mean / np.sqrt(1.0 + sd**2))
            shades = panel.contourf(x, y, probability, levels=np.linspace(0.0, 1.0, 11), cmap="cividis", alpha=0.5)
            panel.contour(x, y, probability, levels=_LEVELS, colors=GREY, linewidths=[0.7, 0.7, 1.6, 0.7, 0.7])
            shown = near(plane.third, third)
            _points(panel, F[shown & inside, plane.x], F[shown & inside, plane.y], failed[shown & inside])
            beyond = _beyond(int(np.sum(shown & ~inside)))
            panel.set_title(f"{LABELS[plane.third]} = {third:g} ± {SLICE * third:.2f}{beyond}")
            panel.set(xlabel=LABELS[plane.x], ylabel=LABELS[plane.y], xlim=(x_low, x_high), ylim=(y_low, y_high))
        for line in plane.lines:
            axes[0][1].axvline(line, color="black", linestyle=":", linewidth=1.4)
        bar = figure.colorbar(ScalarMappable(shades.norm, shades.cmap), ax=axes[0], ticks=_LEVELS, pad=0.01, alpha=0.5)
        bar.set_label("P(failure)")
        bar.ax.hlines(_LEVELS, 0.0, 1.0, colors=GREY, linewidths=[0.7, 0.7, 1.6, 0.7, 0.7])
        along = np.linspace(y_low, y_high, 200)
        middle = plane.values[1]
        for panel, line in zip(axes[1], plane.lines, strict=True):
            mean, sd = at(np.full_like(along, line), along, middle)
            low, high = (2.0 * ndtr(mean + sign * 1.96 * sd) - 1.0 for sign in (-1.0, 1.0))
            panel.fill_between(along, low, high, color=GREY, alpha=0.25, linewidth=0.0)
            panel.plot(along, 2.0 * ndtr(mean / np.sqrt(1.0 + sd**2)) - 1.0, color="black")
            shown = near(plane.third, middle) & near(plane.x, line)
            kept = shown & (F[:, plane.y] <= y_high)
            _points(panel, F[kept, plane.y], np.where(failed[kept], 1.0, -1.0), failed[kept])
            panel.set_title(f"{LABELS[plane.x]} = {line:g} ± {SLICE * line:.2f}{_beyond(int(np.sum(shown & ~kept)))}")
            panel.set(xlabel=LABELS[plane.y], ylabel="−1 no failure … 1 failure", xlim=(y_low, y_high))
            panel.set_ylim(-1.15, 1.15)
        figure.legend(
            handles=[
                Line2D([], [], color=BLUE, marker="o", linestyle="", label="no failure (training point)"),
                Line2D([], [], color=VERMILION, marker="^", linestyle="", label="failure (training point)"),
                Line2D([], [], color="black", linestyle=":", label="where the lower panels are"),
                Line2D([], [], color="black", label="2 P(failure) − 1"),
                Patch(color=GREY, alpha=0.25, label="95 % of the latent"),
            ],
            loc="outside lower center",
            ncols=5,
        )
        fixed = ", ".join(f"{LABELS[i]} = {medians[i]:.2f}" for i in _HELD_AT_MEDIAN)
        figure.suptitle(
            f"P(failure) at the medians {fixed}; lower panels: along the dotted lines, "
            f"{LABELS[plane.third]} = {middle:g} ± {SLICE * middle:.2f}",
            fontsize=9.5,
        )
    return figure


def plot_reliability(
    probabilities: dict[str, Array],
    failed: NDArray[np.bool_],
    samples: int,
    bins: int = 10,
    labels: tuple[str, str] = ("share of failures among fresh designs", "predicted P(failure)"),
) -> Figure:
    """Observed share of failures against predicted probability, with the number of designs at each point.

    Args:
        probabilities: (n,) of failure, by the method's title; at most four.
        failed: (n,) bool.
        samples: number of pooled samples on the same designs; bands are for the designs of one sample.
        bins: number of bins of equal width.
        labels: of the axes, observed share and predicted probability.
    """
    with styled():
        figure = Figure(figsize=(6.4, 7.0), layout="constrained")
        axes, counts_axes = figure.subplots(2, 1, sharex=True, height_ratios=[3.0, 1.0])
        axes.plot([0, 1], [0, 1], color=GREY, linestyle=":", label="perfect")
        for (title, p), colour, marker in zip(
            probabilities.items(), (BLUE, VERMILION, GREEN, PURPLE), "osD^", strict=False
        ):
            bin_index = np.clip((p * bins).astype(int), 0, bins - 1)
            counts = np.bincount(bin_index, minlength=bins)
            shown = counts > 0
            predicted = np.bincount(bin_index, weights=p, minlength=bins)[shown] / counts[shown]
            failures = np.bincount(bin_index, weights=failed, minlength=bins)[shown]
            axes.plot(predicted, failures / counts[shown], color=colour, marker=marker, label=title)
            low, high = proportion_confint(failures / samples, counts[shown] / samples, method="wilson")
            axes.fill_between(predicted, low, high, color=colour, alpha=0.12, linewidth=0.0)
            counts_axes.plot(predicted, counts[shown] / samples, color=colour, marker=marker)
        axes.set_ylabel(labels[0])
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16 if len(probabilities) > 1 else 1.08), ncols=2)
        counts_axes.set_yscale("log")
        counts_axes.set(xlabel=labels[1], ylabel="designs in a bin")
    return figure
