"""Learning curves: accuracy against simulations, active beside static."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from activefail.report.style import BLUE, VERMILION, styled
from activefail.study.compare import Score


def plot_learning_curves(scores: Sequence[Score], boundary: str, test_size: int) -> Figure:
    """Accuracy with its 95 % interval against the number of simulations, one line a sampling."""
    with styled():
        figure = Figure(figsize=(7.0, 4.6), layout="constrained")
        axes = figure.add_subplot()
        looks = {"active": (BLUE, "o", "-"), "static": (VERMILION, "s", "--")}
        names = {"active": "active sampling", "static": "static Latin hypercube"}
        for sampling, (colour, marker, line) in looks.items():
            rows = [score for score in scores if score.sampling == sampling]
            n = np.array([row.simulations for row in rows])
            mean, low, high = (np.array([getattr(row, key) for row in rows]) for key in ("accuracy", "low", "high"))
            axes.fill_between(n, 100.0 * low, 100.0 * high, color=colour, alpha=0.15, linewidth=0.0)
            axes.plot(n, 100.0 * mean, color=colour, marker=marker, linestyle=line, label=names[sampling])
        axes.set_xlabel("simulations trained on")
        axes.set_ylabel(f"accuracy for {boundary} on fresh designs [%]")
        axes.set_title(
            f"Band: 95 % interval over test sets of {test_size} designs (one set, shared by both)", fontsize=9
        )
        axes.legend(loc="lower right")
    return figure
