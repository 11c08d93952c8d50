"""The paper's Figures 3 to 5: contours of P(failure) in planes of two features, and predictions along lines in them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.pages.figures.axes import (
    axis_limits,
    colour_bar,
    filled_contours,
    legend_outside,
    outcome_handles,
    scatter_outcomes,
)
from activefail.pages.figures.outcome_planes import Plane
from activefail.pages.figures.style import BLACK, GREY, styled
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.seismic.paper.study import PaperProcess

LABELS = ("$D_{ratio}$", "$T_b/T_p$", "$\\mu/A_p$", "$h_{sl}/D_{sl}$", "$h_{rim}/D_{sl}$", "$k_{norm}$")
_HELD_AT_MEDIAN = (3, 4, 5)
_GRID = 120

SLICE = 0.02 / 0.11
"""Half-width of a slice over its value, from the only one that the paper states: μ/A_p = 0.11 ± 0.02."""


@dataclass(frozen=True)
class PaperFigure:
    """One of the paper's figures.

    Attributes:
        name: of the figure.
        plane: of two features; each value of the third has an upper panel.
        lines: values of x of the lower panels, which run along y at the middle value of the third feature.
    """

    name: str
    plane: Plane
    lines: tuple[float, float, float]


FIGURES = (
    PaperFigure("figure3", Plane(x=1, y=0, third=2, values=(0.11, 0.16, 0.25)), lines=(1.0, 1.5, 2.5)),
    PaperFigure("figure4", Plane(x=2, y=0, third=1, values=(1.0, 1.5, 2.5)), lines=(0.11, 0.16, 0.25)),
    PaperFigure("figure5", Plane(x=2, y=1, third=0, values=(0.5, 1.0, 2.0)), lines=(0.11, 0.16, 0.25)),
)
"""The paper's figures; it states μ/A_p = 0.11, the other values are round numbers where Table 1 has many designs."""


OUTCOMES = ("no failure", "failure")


def _title(label: str, value: float, beyond: int) -> str:
    """The slice of a panel, and how many of its points are beyond the axes."""
    return f"{label} = {value:g} ± {SLICE * value:.2f}{f'  ({beyond} beyond)' if beyond else ''}"


@dataclass(frozen=True)
class _Slices:
    """The training points and predictions of a process near and in a plane.

    Attributes:
        plane: the plane.
        process: the Gaussian process.
        x_limits, y_limits: of the axes.
    """

    plane: Plane
    process: "PaperProcess"
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]

    def moments(self, x: Array, y: Array, third: float) -> tuple[Array, Array]:
        """Latent mean and standard deviation at points of the plane, in the shape of x and y."""
        rows = np.tile(np.median(self.process.F, axis=0), (x.size, 1))
        rows[:, self.plane.x], rows[:, self.plane.y], rows[:, self.plane.third] = x.ravel(), y.ravel(), third
        mean, sd = self.process.moments(rows)
        return mean.reshape(x.shape), sd.reshape(x.shape)

    def near(self, column: int, value: float) -> NDArray[np.bool_]:
        """Which training points are in the slice around a value."""
        return np.asarray(np.abs(self.process.F[:, column] - value) <= SLICE * value)

    def scatter(self, panel: Axes, x: Array, y: Array, shown: NDArray[np.bool_]) -> None:
        """The training points that are shown, at (x, y), (n,) each."""
        outcome = self.process.failed.astype(np.int8)
        scatter_outcomes(panel, x[shown], y[shown], outcome[shown], OUTCOMES, 18.0)

    def draw_contours(self, panel: Axes, third: float) -> ScalarMappable:
        """Contours of P(failure) at a value of the third feature, with the training points near it."""
        plane, F = self.plane, self.process.F
        x, y = np.meshgrid(np.linspace(*self.x_limits, _GRID), np.linspace(*self.y_limits, _GRID))
        mean, sd = self.moments(x, y, third)
        nowhere = np.zeros(x.shape, dtype=bool)
        shades = filled_contours(panel, x, y, ndtr(mean / np.sqrt(1.0 + sd**2)), nowhere)
        inside = (F[:, plane.x] <= self.x_limits[1]) & (F[:, plane.y] <= self.y_limits[1])
        shown = self.near(plane.third, third)
        self.scatter(panel, F[:, plane.x], F[:, plane.y], shown & inside)
        panel.set_title(_title(LABELS[plane.third], third, int(np.sum(shown & ~inside))))
        panel.set(xlabel=LABELS[plane.x], ylabel=LABELS[plane.y], xlim=self.x_limits, ylim=self.y_limits)
        return shades

    def draw_line(self, panel: Axes, line: float) -> None:
        """The prediction along y at a value of x and the middle value of the third feature."""
        plane, F = self.plane, self.process.F
        along, middle = np.linspace(*self.y_limits, 200), plane.values[1]
        mean, sd = self.moments(np.full_like(along, line), along, middle)
        low, high = (2.0 * ndtr(mean + sign * 1.96 * sd) - 1.0 for sign in (-1.0, 1.0))
        panel.fill_between(along, low, high, color=GREY, alpha=0.25, linewidth=0.0, label="95 % of the latent")
        panel.plot(along, 2.0 * ndtr(mean / np.sqrt(1.0 + sd**2)) - 1.0, color=BLACK, label="2 P(failure) − 1")
        shown = self.near(plane.third, middle) & self.near(plane.x, line)
        kept = shown & (F[:, plane.y] <= self.y_limits[1])
        self.scatter(panel, F[:, plane.y], np.where(self.process.failed, 1.0, -1.0), kept)
        panel.set_title(_title(LABELS[plane.x], line, int(np.sum(shown & ~kept))))
        panel.set(xlabel=LABELS[plane.y], ylabel="−1 no failure … 1 failure", xlim=self.y_limits)
        panel.set_ylim(-1.15, 1.15)


@styled()
def plot_plane(of_paper: PaperFigure, process: "PaperProcess") -> Figure:
    """Three panels of contours of P(failure), and below them predictions along the dotted lines."""
    F, plane = process.F, of_paper.plane
    slices = _Slices(plane, process, axis_limits(F[:, plane.x]), axis_limits(F[:, plane.y]))
    figure = Figure(figsize=(10.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 3)
    for panel, third in zip(axes[0], plane.values, strict=True):
        shades = slices.draw_contours(panel, third)
    for line in of_paper.lines:
        axes[0][1].axvline(line, color=BLACK, linestyle=":", linewidth=1.4)
    colour_bar(figure, axes[0], shades, "P(failure)", fraction=0.02)
    for panel, line in zip(axes[1], of_paper.lines, strict=True):
        slices.draw_line(panel, line)
    handles = [
        *outcome_handles(OUTCOMES, " (training)"),
        Line2D([], [], color=BLACK, linestyle=":", label="where the lower panels are"),
        *axes[1][0].get_legend_handles_labels()[0],
    ]
    legend_outside(figure, handles=handles)
    fixed = ", ".join(f"{LABELS[i]} = {np.median(F[:, i]):.2f}" for i in _HELD_AT_MEDIAN)
    along = _title(LABELS[plane.third], plane.values[1], 0)
    figure.suptitle(f"P(failure) at the medians {fixed}; lower panels: along the dotted lines, {along}", fontsize=9.5)
    return figure
