"""Predictions of a campaign's classifier in planes: those of a plug-in if they suit it, else of variables."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import NamedTuple, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from activefail.analyses.findings.quantities import variables
from activefail.analyses.findings.results import Findings, Prediction, predict
from activefail.pages.figures.axes import (
    axis_limits,
    colour_bar,
    filled_contours,
    legend_outside,
    outcome_handles,
    own_axes,
    panel,
    region_handles,
    scatter_outcomes,
)
from activefail.pages.figures.style import GREY, fitting_size, letters, styled
from activefail.plugins import brought
from activefail.space.space import Array, DesignSpace
from activefail.text.quantities import Quantity, plain
from activefail.visible import words

_TITLE = 52
"""Letters in a line of a small title."""

GRID, _FINE = 44, 150
"""Points along each side of a plane of the report, and of a single one."""


@dataclass(frozen=True)
class Plane:
    """A plane of two coordinates.

    Attributes:
        x, y, third: columns of the coordinates; no third if -1.
        values: of the third, one for each panel.
    """

    x: int
    y: int
    third: int
    values: tuple[float, ...]


@dataclass(frozen=True)
class Coordinates:
    """Coordinates of planes, and predictions at points in them.

    A plug-in brings them for the campaigns that they suit: its `planes` are functions of findings that return
    coordinates, or None.

    Attributes:
        quantities: (m,) of the coordinates.
        F: (n, m) coordinates of the simulated designs.
        middle: (m,) values of the coordinates that a plane does not vary.
        predict: maps coordinates, (rows, m), to predictions of designs with them.
        planes: the planes to draw.
        widths: half-widths of the slices at the values of a plane's third coordinate.
        choices: columns of the coordinates without order.
        are_features: whether they are features; else variables.
    """

    quantities: Sequence[Quantity]
    F: Array
    middle: Array
    predict: Callable[[Array], Prediction]
    planes: Sequence[Plane]
    widths: Callable[[Plane, float], float]
    choices: Sequence[int] = ()
    are_features: bool = False


def coordinates(findings: Findings) -> Coordinates:
    """The planes of a plug-in that suit a campaign, else planes of the most influential variables."""
    suited = filter(None, (of(findings) for of in brought("planes").values()))
    return next(suited, None) or _variable_coordinates(findings)


def _variable_coordinates(findings: Findings) -> Coordinates:
    campaign = findings.campaign
    space = campaign.space
    # By length scale if the features are the variables; other features cannot be varied alone, so then by the
    # variables' influence on the prediction.
    scales = findings.classifier.latents[campaign.severity - 1].length_scales
    if campaign.features.names == space.names and scales is not None:
        order = np.argsort(scales)
    else:
        order = np.argsort(-findings.influence, kind="stable")
    middle, (lows, highs) = space.middle, space.usual
    # Choices have no axes; the most influential ones take the place of a third variable.
    is_choice = np.array([bool(one.choices) for one in space.parameters])
    first = [int(column) for column in order if not is_choice[column]][:3]

    of_choices: list[Plane] = []

    def plane(x: int, y: int, third: int) -> Plane:
        low, high, one = lows[third], highs[third], space.parameters[third]
        values = tuple(float(one.rounded(low + share * (high - low))) for share in (0.2, 0.5, 0.8))
        return Plane(x, y, third, values)

    for column in [int(column) for column in order if is_choice[column]][: len(first) // 2]:
        probable = np.argsort(-np.array(space.parameters[column].probabilities), kind="stable")[:3]
        values = tuple(np.sort(probable).astype(float).tolist())
        of_choices.append(Plane(first[0], first[1], column, values))
    match first:
        case [a, b, c]:
            planes = [plane(a, b, c), plane(a, c, b), plane(b, c, a)]
        case [a, b] if not of_choices:
            planes = [Plane(a, b, -1, (0.0,))]
        case _:
            planes = []

    def at(rows: Array) -> Prediction:
        return predict(campaign, findings.classifier, space.nearest(rows))

    width = np.where(is_choice, 0.0, 0.15 * (highs - lows))
    shown = [*of_choices, *planes]
    return Coordinates(
        variables(campaign),
        findings.history.designs,
        middle,
        at,
        shown,
        lambda plane, _: float(width[plane.third]),
        np.flatnonzero(is_choice).tolist(),
    )


_MOST_HELD = 8
"""Most variables that a title names with the values at which they are held."""


def held_in_words(space: DesignSpace, X: Array, shown: Sequence[int]) -> str:
    """At which values of a design, (d,), the variables stand that a plane does not show; empty if it shows all."""
    others = [column for column in range(space.dimension) if column not in shown]
    values = space.written(dict(zip(space.names, X.tolist(), strict=True)))
    of_each = [
        f"{plain(name)} = {value:.4g}" if isinstance(value, float) else f"{plain(name)} = {plain(str(value))}"
        for name, value in ((space.names[column], values[space.names[column]]) for column in others[:_MOST_HELD])
    ]
    rest = [f"{len(others) - _MOST_HELD} more at their medians"] * (len(others) > _MOST_HELD)
    return ", ".join(one.replace(" ", "\N{NO-BREAK SPACE}") for one in [*of_each, *rest])


@styled()
def draw_boundary(findings: Findings, x: int, y: int, X: Array, axes: Axes | None) -> Axes:
    """The probability of the target boundary's outcome or worse in a plane of two variables, and the simulations.

    Args:
        findings: of the campaign.
        x, y: columns of the two variables.
        X: (d,) values of the others.
        axes: to draw on; new ones of pyplot, which a notebook shows, if None.
    """
    axes = own_axes(axes)
    campaign, space, named = findings.campaign, findings.campaign.space, variables(findings.campaign)
    low, high = space.usual
    across, up = np.meshgrid(*(np.linspace(low[column], high[column], _FINE) for column in (x, y)))
    rows = np.tile(X, (across.size, 1))
    rows[:, x], rows[:, y] = across.ravel(), up.ravel()
    prediction = predict(campaign, findings.classifier, space.nearest(rows))
    beyond, undecided = prediction.beyond, prediction.undecided
    shades = filled_contours(axes, across, up, beyond.reshape(across.shape), undecided.reshape(across.shape))
    draw_marks(axes, marks_in(findings, X, [x, y]), campaign.simulator.outcomes, 28.0)
    colour_bar(cast(Figure, axes.get_figure(root=True)), axes, shades, f"P({plain(findings.beyond)})")
    axes.set(xlabel=named[x].axis, ylabel=named[y].axis, xlim=(low[x], high[x]), ylim=(low[y], high[y]))
    axes.legend(handles=[*outcome_handles(campaign.simulator.outcomes), *region_handles(beyond, undecided)])
    title, influence = held_in_words(space, X, (x, y)), findings.influence
    if (most := int(np.argmax(influence))) not in (x, y) and influence[most] > max(influence[[x, y]]):
        title += f"; {plain(space.names[most])} decides more than both axes"
    axes.set_title(fill(title, _TITLE), fontsize="small")
    return axes


class Marks(NamedTuple):
    """Simulated designs in a plane.

    Attributes:
        places: (k, 2) in the plane.
        outcome: (k,) int8.
        opacity: of the marks.
    """

    places: Array
    outcome: NDArray[np.int8]
    opacity: float


_PALE = 0.3
"""Opacity of the marks of designs that differ from those of the plane."""

_NEAR = 0.25
"""Root mean square difference in the other variables, over their ranges, up to which a plane shows a mark in full."""


def marks_in(findings: Findings, design: Array, plane: list[int]) -> list[Marks]:
    """The simulated designs in a plane through a design, (d,), those like it last.

    The others are pale: they have another choice, or differ much in the other variables.
    """
    known, space = findings.history.training, findings.campaign.space
    X, outcome = known.designs, known.outcome
    is_choice = np.array([bool(one.choices) for one in space.parameters])
    numbers = np.setdiff1d(np.flatnonzero(~is_choice), plane)
    apart = (space.to_unit(X) - space.to_unit(design[None]))[:, numbers]
    near = (apart**2).sum(axis=1) <= _NEAR**2 * len(numbers)
    near &= np.all(X[:, is_choice] == design[is_choice], axis=1)
    return [Marks(X[some][:, plane], outcome[some], opacity) for some, opacity in ((~near, _PALE), (near, 1.0))]


def draw_marks(axes: Axes, marks: Sequence[Marks], outcomes: Sequence[str], size: float) -> None:
    """Draw designs in a plane."""
    for places, outcome, opacity in marks:
        scatter_outcomes(axes, places[:, 0], places[:, 1], outcome, outcomes, size, opacity)


@styled()
def plot_variable_plane(
    quantities: tuple[Quantity, Quantity],
    along: tuple[Array, Array],
    values: Array,
    undecided: NDArray[np.bool_],
    title: str,
    marks: Sequence[Marks],
    outcomes: Sequence[str],
    uncertainty: bool = False,
) -> Figure:
    """A probability, or the uncertainty of one, in the plane of two variables, with simulated designs.

    Args:
        quantities: of the two axes.
        along: (n,) and (m,) values on the axes.
        values: (m, n) between 0 and 1; NaN where there is no design.
        undecided: (m, n) where the outcome is unknown.
        title: of the values.
        marks: the designs.
        outcomes: names, for the marks' looks.
        uncertainty: whether the values are an uncertainty.
    """
    x, y = along
    figure, axes = panel(4.0, 3.4)
    shades = filled_contours(axes, *np.meshgrid(x, y), values, undecided, uncertainty)
    draw_marks(axes, marks, outcomes, 22.0)
    axes.set(xlabel=quantities[0].axis, ylabel=quantities[1].axis, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    colour_bar(figure, axes, shades, title, uncertainty)
    axes.set_title(title if uncertainty else f"{title}; thick line: one half")
    if regions := region_handles(values, undecided):
        legend_outside(figure, handles=regions)
    return figure


def plot_outcome_planes(plane: Plane, c: Coordinates, findings: Findings) -> list[Figure]:
    """Probabilities of all outcomes but the least severe, and the uncertainty: a figure per third value."""
    return [_at_value(plane, value, c, findings) for value in plane.values]


@styled()
def _at_value(plane: Plane, third: float, c: Coordinates, findings: Findings) -> Figure:
    campaign = findings.campaign
    outcomes = campaign.simulator.outcomes
    F, outcome = c.F[findings.history.answered], findings.history.training.outcome
    share = 0.9 if c.are_features else 1.0
    x_limits, y_limits = (axis_limits(F[:, column], share) for column in (plane.x, plane.y))
    if not c.are_features:
        lows, highs = campaign.space.usual
        x_limits, y_limits = ((float(lows[axis]), float(highs[axis])) for axis in (plane.x, plane.y))
    shown = (F[:, plane.x] <= x_limits[1]) & (F[:, plane.y] <= y_limits[1])
    x, y = np.meshgrid(np.linspace(*x_limits, GRID), np.linspace(*y_limits, GRID))
    rows = np.tile(c.middle, (x.size, 1))
    rows[:, plane.x], rows[:, plane.y] = x.ravel(), y.ravel()
    title = ""
    if plane.third >= 0:
        rows[:, plane.third] = third
        width, symbol = c.widths(plane, third), c.quantities[plane.third].symbol
        shown = shown & (np.abs(F[:, plane.third] - third) <= width)
        exact = "" if width else plain(str(campaign.space.parameters[plane.third].written(third)))
        value = f"{third:.3g} ± {width:.2g}" if width else exact
        between = "\n" if letters(symbol) > 16 else " "
        title = f"{symbol}{between}= {value}"
    if not c.are_features and (held := held_in_words(campaign.space, c.middle, (plane.x, plane.y, plane.third))):
        title = "\n".join(filter(None, (title, fill(held, _TITLE))))
    others = [column for column in c.choices if column != plane.third]
    alike = np.all(F[:, others] == c.middle[others], axis=1)
    marks = [
        Marks(F[some][:, [plane.x, plane.y]], outcome[some], opacity)
        for some, opacity in ((shown & ~alike, _PALE), (shown & alike, 1.0))
    ]
    prediction = c.predict(rows)
    layers = [*prediction.probabilities.T[1:], prediction.high - prediction.low]
    titles = [f"P({plain(words(name))})" for name in outcomes[1:]] + [f"uncertainty of P({plain(findings.beyond)})"]
    figure = Figure(figsize=(3.9, 2.8 * len(layers) + 0.9), layout="constrained")
    grid = figure.subplots(len(layers), 1, squeeze=False, sharex=True)[:, 0]
    size = fitting_size([*titles, *(c.quantities[axis].axis for axis in (plane.x, plane.y))], 2.6)
    for axes, layer, name in zip(grid, layers, titles, strict=True):
        last = axes is grid[-1]
        undecided = prediction.undecided.reshape(x.shape)
        shades = filled_contours(axes, x, y, layer.reshape(x.shape), undecided, uncertainty=last)
        draw_marks(axes, marks, outcomes, 28.0)
        axes.set(xlim=x_limits, ylim=y_limits)
        axes.set_ylabel(f"{name}\n{c.quantities[plane.y].axis}", fontsize=size)
        colour_bar(figure, axes, shades, name, uncertainty=last, fraction=0.06)
    grid[0].set_title(title, fontsize="small")
    grid[-1].set_xlabel(c.quantities[plane.x].axis, fontsize=size)
    handles: list[Line2D | Patch] = [*outcome_handles(outcomes, " (simulated)")]
    handles.append(Line2D([], [], color=GREY, linewidth=1.7, label="probability 0.5"))
    legend_outside(figure, "outside upper center", [*handles, *region_handles(prediction.beyond, prediction.undecided)])
    return figure
