"""What a boundary is learned from: a margin that the simulator reports, or the outcomes alone.

A margin carries more information than its sign, unless the simulation ends at failure or the margin jumps there.
Evidence decides: the log probability that each model gives to the side of a design that was left out.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from activefail.space import Array
from activefail.surrogate.fitting import Fit, fit, leave_one_out
from activefail.surrogate.margin import MarginFit, fit_margin, is_truncated

if TYPE_CHECKING:
    import torch
else:
    from activefail.surrogate import lazy_torch as torch

OUTCOMES = -1
"""The choice of the outcomes alone."""

_COMPARED = 200
"""Most simulations on which the models are compared."""

_GROWTH = 0.5
"""Growth of the number of simulations after which the models are compared again."""


class Choice(NamedTuple):
    """What a boundary is learned from.

    Attributes:
        margin: column of the margin, or OUTCOMES.
        simulations: number of simulations when it was chosen.
        margin_score: mean log probability of left-out designs' sides under the best regression [nat]; NaN if no margin
            can be used, or nothing was compared.
        outcome_score: the same under the classifier.
        one_sided: whether all designs were on one side.
    """

    margin: int
    simulations: int
    margin_score: float = np.nan
    outcome_score: float = np.nan
    one_sided: bool = False


def usable(margin: Array, beyond: NDArray[np.bool_]) -> str:
    """Why a margin, (n,), cannot tell the side of a boundary; empty if it can.

    It can if it is at most 0 exactly beyond the boundary. It may be undefined (NaN) there, but not elsewhere. Two
    different positive margins are needed.

    Args:
        margin: (n,) of the simulations.
        beyond: (n,) whether each outcome is beyond the boundary.
    """
    short = margin[~beyond]
    if np.isnan(short).any():
        return f"it is undefined in {int(np.isnan(short).sum())} simulations on the safe side of the boundary"
    if np.isinf(margin).any():
        return f"it is infinite in {int(np.isinf(margin).sum())} simulations"
    contradictions = int((short <= 0.0).sum() + (margin[beyond] > 0.0).sum())
    if contradictions:
        return (
            f"its sign contradicts the outcome of {contradictions} simulations; a margin must be at most its level "
            "(0 by default) exactly beyond the boundary"
        )
    if len(short) < 2 or np.ptp(short) == 0.0:
        return "fewer than two different positive values are known"
    return ""


def defined(margin: Array) -> tuple[Array, bool]:
    """The margins with 0 where they are undefined, and whether any is."""
    undefined = np.isnan(margin)
    return np.where(undefined, 0.0, margin), bool(undefined.any())


def fit_defined(F: Array, margin: Array, warm: MarginFit | None = None) -> MarginFit:
    """The regression of a usable margin, (n,), at scaled features, (n, m)."""
    values, has_undefined = defined(margin)
    return fit_margin(F, values, has_undefined or is_truncated(values), warm)


def is_due(previous: Choice | None, n: int, beyond: NDArray[np.bool_]) -> bool:
    """Whether the models must be compared (again)."""
    if previous is None or n >= (1.0 + _GROWTH) * previous.simulations:
        return True
    return bool(previous.one_sided and beyond.any() and not beyond.all())


def choose(F: Array, beyond: NDArray[np.bool_], margins: Array, columns: Sequence[int], kernel: str) -> Choice:
    """Choose by the evidence of the first 200 simulations or fewer.

    With all designs on one side a classifier knows nothing, so a usable margin is chosen without a comparison.

    Args:
        F: (n, m) scaled features.
        beyond: (n,) whether each outcome is beyond the boundary.
        margins: (n, k) margins of the simulator.
        columns: the margins that may be chosen.
        kernel: of the classifier.
    """
    n, one_sided = len(F), bool(beyond.all() or not beyond.any())
    candidates = [column for column in columns if not usable(margins[:, column], beyond)]
    if not candidates:
        return Choice(OUTCOMES, n, one_sided=one_sided)
    # Evenly spread over the rows, so that both the initial design and the active designs count.
    rows = np.unique(np.linspace(0, n - 1, min(n, _COMPARED)).round().astype(int))
    scores = {}
    for column in candidates:
        if usable(margins[rows, column], beyond[rows]):
            continue
        scores[column] = fit_defined(F[rows], margins[rows, column]).sign_score()
    if not scores:
        return Choice(OUTCOMES, n, one_sided=one_sided)
    best = max(scores, key=scores.__getitem__)
    if one_sided:
        return Choice(best, n, scores[best], one_sided=True)
    labels = np.where(beyond[rows], 1.0, -1.0)
    score = outcome_score(fit(torch.from_numpy(F[rows]), torch.from_numpy(labels), kernel))
    return Choice(best if scores[best] >= score else OUTCOMES, n, scores[best], score)


def outcome_score(trained: Fit) -> float:
    """Mean log probability of left-out designs' sides under a classifier [nat]."""
    mean, sd = leave_one_out(trained)
    return float(log_ndtr(trained.labels.numpy() * mean / np.sqrt(1.0 + sd**2)).mean())
