"""Drawings of the sensitivity of a probability."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from activefail.figures.axes import legend_outside, panel
from activefail.figures.style import BLUE, GREY, ORANGE, VERMILION, styled
from activefail.findings.quantities import Quantity, significant
from activefail.risk.sensitivity.findings import Move
from activefail.risk.sensitivity.sobol import Index


@styled()
def plot_indices(indices: Sequence[Index], confidence: float, quantities: Mapping[str, Quantity]) -> Figure:
    """Plot first and total Sobol' indices with their intervals, the largest on top.

    Args:
        indices: in the order of the rows.
        confidence: of the intervals.
        quantities: of the variables, by name.
    """
    figure, axes = panel(6.4, 1.3 + 0.4 * len(indices))
    for title, colour, marker, lift, estimates in (
        ("first index: the variable alone", BLUE, "o", -0.12, [index.first for index in indices]),
        ("total index: with all interactions", VERMILION, "s", 0.12, [index.total for index in indices]),
    ):
        axes.errorbar(
            [one.value for one in estimates],
            [row + lift for row in range(len(indices))],
            xerr=[[one.value - one.low for one in estimates], [one.high - one.value for one in estimates]],
            linestyle="",
            marker=marker,
            color=colour,
            capsize=3,
            label=title,
        )
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set_yticks(range(len(indices)), [quantities[index.name].symbol for index in indices])
    axes.set_xlabel(f"Sobol' index, with {100 * confidence:g} % intervals of the sampling")
    axes.invert_yaxis()
    legend_outside(figure, "outside upper left")
    return figure


@styled()
def plot_moves(moves: Sequence[Move], probability: float, outcome: str, quantities: Mapping[str, Quantity]) -> Figure:
    """Plot the probability at the low and the high value of each variable, the largest effect on top.

    Args:
        moves: in the order of the rows.
        probability: with all variables at their base values.
        outcome: whose probability it is, in words.
        quantities: of the variables, by name.
    """
    figure, axes = panel(6.4, 1.3 + 0.4 * len(moves))
    axes.axvline(probability, color=GREY, linestyle=":", label="base values")
    for row, move in enumerate(moves):
        axes.plot([move.at_low, probability, move.at_high], [row] * 3, color=GREY, linewidth=0.8, zorder=1)
    rows = range(len(moves))
    axes.plot([move.at_low for move in moves], rows, "v", color=BLUE, label="low value")
    axes.plot([move.at_high for move in moves], rows, "^", color=ORANGE, label="high value")
    names = [
        f"{quantities[move.name].symbol}: {significant(move.low)}, {significant(move.value)}, "
        f"{significant(move.high)} {quantities[move.name].unit}".rstrip()
        for move in moves
    ]
    axes.set_yticks(rows, names)
    axes.set_xlabel(f"P({outcome}) by the classifier, without intervals")
    axes.set_xlim(left=0.0)
    axes.invert_yaxis()
    legend_outside(figure, "outside upper left")
    return figure
