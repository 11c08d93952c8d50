"""The paper's Figures 3 to 5: contours of P(failure) in planes of two features, and predictions along lines in them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.figures.contours import PROBABILITY_LEVELS, axis_limits
from activefail.figures.style import BLUE, GREY, VERMILION, styled
from activefail.space import Array

if TYPE_CHECKING:
    from activefail.paper.study import PaperProcess

LABELS = ("$D_{ratio}$", "$T_b/T_p$", "$\\mu/A_p$", "$h_{sl}/D_{sl}$", "$h_{rim}/D_{sl}$", "$k_{norm}$")
_HELD_AT_MEDIAN = (3, 4, 5)
_GRID = 120
_WIDTHS = [0.7, 0.7, 1.6, 0.7, 0.7]

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


def _points(axes: Axes, x: Array, y: Array, failed: NDArray[np.bool_]) -> None:
    for value, colour, marker in ((False, BLUE, "o"), (True, VERMILION, "^")):
        rows = failed == value
        axes.scatter(x[rows], y[rows], s=18, c=colour, marker=marker, edgecolors="white", linewidths=0.4, zorder=3)


def _beyond(outside: int) -> str:
    """Text for a title: how many points of a slice are beyond the axes."""
    return f"  ({outside} beyond)" if outside else ""


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

    def draw_contours(self, panel: Axes, third: float) -> ScalarMappable:
        """Contours of P(failure) at a value of the third feature, with the training points near it."""
        plane, F, failed = self.plane, self.process.F, self.process.failed
        x, y = np.meshgrid(np.linspace(*self.x_limits, _GRID), np.linspace(*self.y_limits, _GRID))
        mean, sd = self.moments(x, y, third)
        probability = ndtr(mean / np.sqrt(1.0 + sd**2))
        shades = panel.contourf(x, y, probability, levels=np.linspace(0.0, 1.0, 11), cmap="cividis", alpha=0.5)
        panel.contour(x, y, probability, levels=PROBABILITY_LEVELS, colors=GREY, linewidths=_WIDTHS)
        inside = (F[:, plane.x] <= self.x_limits[1]) & (F[:, plane.y] <= self.y_limits[1])
        shown = self.near(plane.third, third)
        _points(panel, F[shown & inside, plane.x], F[shown & inside, plane.y], failed[shown & inside])
        beyond = _beyond(int(np.sum(shown & ~inside)))
        panel.set_title(f"{LABELS[plane.third]} = {third:g} ± {SLICE * third:.2f}{beyond}")
        panel.set(xlabel=LABELS[plane.x], ylabel=LABELS[plane.y], xlim=self.x_limits, ylim=self.y_limits)
        return shades

    def draw_line(self, panel: Axes, line: float) -> None:
        """The prediction along y at a value of x and the middle value of the third feature."""
        plane, F, failed = self.plane, self.process.F, self.process.failed
        along, middle = np.linspace(*self.y_limits, 200), plane.values[1]
        mean, sd = self.moments(np.full_like(along, line), along, middle)
        low, high = (2.0 * ndtr(mean + sign * 1.96 * sd) - 1.0 for sign in (-1.0, 1.0))
        panel.fill_between(along, low, high, color=GREY, alpha=0.25, linewidth=0.0)
        panel.plot(along, 2.0 * ndtr(mean / np.sqrt(1.0 + sd**2)) - 1.0, color="black")
        shown = self.near(plane.third, middle) & self.near(plane.x, line)
        kept = shown & (F[:, plane.y] <= self.y_limits[1])
        _points(panel, F[kept, plane.y], np.where(failed[kept], 1.0, -1.0), failed[kept])
        panel.set_title(f"{LABELS[plane.x]} = {line:g} ± {SLICE * line:.2f}{_beyond(int(np.sum(shown & ~kept)))}")
        panel.set(xlabel=LABELS[plane.y], ylabel="−1 no failure … 1 failure", xlim=self.y_limits)
        panel.set_ylim(-1.15, 1.15)


@styled()
def plot_plane(plane: Plane, process: "PaperProcess") -> Figure:
    """Three panels of contours of P(failure), and below them predictions along the dotted lines."""
    F = process.F
    slices = _Slices(plane, process, axis_limits(F[:, plane.x]), axis_limits(F[:, plane.y]))
    figure = Figure(figsize=(10.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 3)
    for panel, third in zip(axes[0], plane.values, strict=True):
        shades = slices.draw_contours(panel, third)
    for line in plane.lines:
        axes[0][1].axvline(line, color="black", linestyle=":", linewidth=1.4)
    bar = figure.colorbar(
        ScalarMappable(shades.norm, shades.cmap), ax=axes[0], ticks=PROBABILITY_LEVELS, pad=0.01, alpha=0.5
    )
    bar.set_label("P(failure)")
    bar.ax.hlines(PROBABILITY_LEVELS, 0.0, 1.0, colors=GREY, linewidths=_WIDTHS)
    for panel, line in zip(axes[1], plane.lines, strict=True):
        slices.draw_line(panel, line)
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
    fixed = ", ".join(f"{LABELS[i]} = {np.median(F[:, i]):.2f}" for i in _HELD_AT_MEDIAN)
    figure.suptitle(
        f"P(failure) at the medians {fixed}; lower panels: along the dotted lines, "
        f"{LABELS[plane.third]} = {plane.values[1]:g} ± {SLICE * plane.values[1]:.2f}",
        fontsize=9.5,
    )
    return figure
