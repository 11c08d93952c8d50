"""Which margins may teach a boundary, when the choice is made again, and its result; `training` chooses.

A margin carries more information than its sign, unless the simulation ends at failure or the margin jumps there.
Evidence decides: the log probability that each model gives to the side of a design that was left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.space.space import Array
from activefail.space.systems import System

OUTCOMES = -1
"""The choice of the outcomes alone."""

_JUST = 1e-9
"""Distance of a level below the least margin, in units of that."""

_GROWTH = 0.5
"""Growth of the number of simulations after which the models are compared again."""


class Choice(NamedTuple):
    """What a boundary is learned from.

    Attributes:
        margin: column of the margin, 0 for a system of all, or OUTCOMES.
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


def usable(margin: Array, beyond: NDArray[np.bool_], system: System | None = None) -> str:
    """Why a margin, (n,), or those of a system, (n, k), cannot tell the side of a boundary; empty if it can.

    It can if it is at most 0 exactly beyond the boundary. It may be undefined (NaN) there, but not elsewhere. Two
    different positive margins are needed.

    Args:
        margin: (n,) or (n, k) of the simulations.
        beyond: (n,) whether each outcome is beyond the boundary.
        system: of the margins, each of which needs two different values.
    """
    if system is not None:
        for name, of_mode in zip(system.names, margin.T, strict=True):
            if np.isinf(of_mode).any() or len(np.unique(of_mode[np.isfinite(of_mode)])) < 2:
                return f"{name} is infinite, or has fewer than two different values"
        margin = system(margin)
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


def defined(margin: Array, is_levelled: bool = True) -> tuple[Array, bool, float]:
    """The margins with 0 where they are undefined, whether any is, and the level from which they count.

    It is 0 if any margin is at most 0. Otherwise the simulations with a margin show the boundary from one side only, as
    those of a solver that gives up before failure do: then it is just below the least margin. Former versions took 0.
    """
    undefined = np.isnan(margin)
    has_undefined, least = bool(undefined.any()), np.nanmin(margin)
    level = float(least * (1.0 - _JUST)) if is_levelled and has_undefined and least > 0.0 else 0.0
    return np.where(undefined, 0.0, margin - level), has_undefined, level


def is_due(previous: Choice | None, n: int, beyond: NDArray[np.bool_]) -> bool:
    """Whether the models must be compared (again)."""
    if previous is None or n >= (1.0 + _GROWTH) * previous.simulations:
        return True
    return bool(previous.one_sided and beyond.any() and not beyond.all())


def taken(margins: Array, column: int, system: System | None) -> Array:
    """What a boundary is learned from, of margins, (n, k): those of one column, (n,), or all of a system."""
    return margins if system is not None else margins[:, column]


@dataclass(frozen=True)
class LearnableMargins:
    """The margins that a classifier may learn from.

    Attributes:
        values: (b, n, k) float64, for each boundary one column for each of the simulator's margins, at most 0 beyond.
        levels: (b, k) at or below which a margin of the simulator is beyond each boundary.
        columns: those that may be chosen.
        required: whether the one column must be used, without a comparison.
        system: of all margins, which are then learned together as column 0; None if each is learned alone.
    """

    values: Array
    levels: Array
    columns: tuple[int, ...]
    required: bool = False
    system: System | None = None

    def of(self, severity: int, column: int) -> Array:
        """What a boundary is learned from: the margin of a column, (n,), or those of the system, (n, k)."""
        return taken(self.values[severity - 1], column, self.system)


def learned_with(choices: Sequence[Choice], severity: int) -> int:
    """The boundary whose latent a boundary shares: the most severe one that is learned from the same margin."""
    if not choices or (margin := choices[severity - 1].margin) == OUTCOMES:
        return severity
    return max(other for other, choice in enumerate(choices, start=1) if choice.margin == margin)


def level_of(margins: LearnableMargins | None, choices: Sequence[Choice], severity: int) -> float:
    """The level of a boundary's margin, in relation to the boundary whose latent it shares."""
    assert margins is not None
    levels = margins.levels[:, choices[severity - 1].margin]
    return float(levels[severity - 1] - levels[learned_with(choices, severity) - 1])
