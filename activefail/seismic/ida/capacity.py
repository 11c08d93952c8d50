"""The lowest intensity of each record at which an outcome is reached: a ladder of levels, then bisection."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.seismic.motions.intensity import Intensity
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space.space import Array

LEVELS, BISECTIONS = 10, 5
"""Levels of the ladder, and of the bisection after it."""

STEP, HALVINGS = 0.1, 2
"""Step from a predicted capacity to the other side of the true one, which doubles, and the bisections of one step."""

LOWEST = 1.0 / 16.0
"""The lowest level of the ladder over the highest."""

Runs = Sequence[tuple[int, float]]
"""Simulations: of each the record, by its place in the set, and the level."""


class Answers(NamedTuple):
    """What n simulations showed."""

    outcome: NDArray[np.int8]  # (n,) severity, or NUMERICAL_FAILURE
    lifted: NDArray[np.bool_]  # (n,) whether the bearing failed without a rim touch: a plate lifted off


Simulate = Callable[[Runs], Answers]


@dataclass(frozen=True, eq=False)
class Capacities:
    """What the levels of each of n records showed."""

    severity: int  # of the outcome that is sought, or a worse one
    levels: tuple[Array, ...]  # for each record its levels, rising, and their outcomes
    outcomes: tuple[NDArray[np.int8], ...]
    lifted: NDArray[np.int64]  # (n,) levels at which a plate lifted off and the bearing failed before any rim touch

    @cached_property
    def _brackets(self) -> Array:
        pairs = zip(self.levels, self.outcomes, strict=True)
        return np.array([_bracket(levels, outcomes, self.severity) for levels, outcomes in pairs]).reshape(-1, 2)

    @property
    def below(self) -> Array:
        """(n,) highest level below the capacity that was survived; 0 if the lowest one was not."""
        return self._brackets[:, 0]

    @property
    def capacity(self) -> Array:
        """(n,) lowest level with the outcome; infinite if none has it."""
        return self._brackets[:, 1]

    @property
    def resurrections(self) -> NDArray[np.int64]:
        """(n,) levels above the capacity that were survived."""
        parts = zip(self.levels, self.outcomes, self.capacity, strict=True)
        return np.array([(_survived(one, self.severity) & (at > lowest)).sum() for at, one, lowest in parts])

    @property
    def numerical_failures(self) -> NDArray[np.int64]:
        """(n,) levels without an outcome."""
        return np.array([(one == NUMERICAL_FAILURE).sum() for one in self.outcomes])

    @property
    def if_lost_fail(self) -> "Capacities":
        """The same if the levels without an outcome had the outcome that is sought."""
        worst = (np.where(one == NUMERICAL_FAILURE, self.severity, one).astype(np.int8) for one in self.outcomes)
        return replace(self, outcomes=tuple(worst))

    @property
    def runs(self) -> int:
        """Number of simulations."""
        return sum(map(len, self.levels))

    def on_ladder(self, rungs: Array) -> NDArray[np.int8]:
        """The outcomes at the k levels of the ladder, (n, k), without those of the bisections."""
        pairs = zip(self.levels, self.outcomes, strict=True)
        return np.array([outcomes[np.isin(levels, rungs)] for levels, outcomes in pairs], dtype=np.int8)


@dataclass(frozen=True)
class Agreement:
    """Numbers of levels by their predicted and their simulated outcome."""

    both_fail: int
    both_survive: int
    missed: int  # failures that were not predicted
    false: int  # predicted failures that did not occur

    @classmethod
    def of(cls, fails: NDArray[np.bool_], predicted: NDArray[np.bool_]) -> "Agreement":
        """Of simulated and predicted failures, (n,) each."""
        pairs = (fails & predicted, ~fails & ~predicted, fails & ~predicted, ~fails & predicted)
        return cls(*(int(pair.sum()) for pair in pairs))

    @property
    def same(self) -> int:
        """Levels with the same outcome."""
        return self.both_fail + self.both_survive

    @property
    def levels(self) -> int:
        """All levels."""
        return self.same + self.missed + self.false


def ladder(intensity: Intensity, highest: float | None = None) -> Array:
    """The rising levels of the ladder, with equal ratios between them."""
    top = intensity.highest if highest is None else highest
    if not 0.0 < top < np.inf:
        raise InputError(f"--to: must be positive and finite, got {top:g}.")
    return np.geomspace(LOWEST * top, top, LEVELS)


def capacities(simulate: Simulate, records: int, rungs: Array, bisections: int, severity: int) -> Capacities:
    """Simulate records at the levels of a ladder, then between the two levels that hold each capacity.

    The whole ladder is simulated, because a higher level may be survived than one that is not. A level without an
    outcome, a numerical failure, is neither survived nor failed.

    Args:
        simulate: the outcomes of records at levels.
        records: their number n.
        rungs: (k,) rising levels of the ladder.
        bisections: levels between the last survived and the first failed one of the ladder.
        severity: of the outcome that is sought, or a worse one.
    """
    levels = [rungs.copy() for _ in range(records)]
    lifted = np.zeros(records, dtype=np.int64)

    def outcomes_at(runs: Runs) -> NDArray[np.int8]:
        answers = simulate(runs)
        np.add.at(lifted, [k for k, _ in runs], answers.lifted)
        return answers.outcome

    first = outcomes_at([(k, level) for k in range(records) for level in rungs.tolist()])
    outcomes = list(first.reshape(records, -1))
    for _ in range(bisections):
        brackets = [_bracket(*one, severity) for one in zip(levels, outcomes, strict=True)]
        middles = [(k, 0.5 * (below + above)) for k, (below, above) in enumerate(brackets) if np.isfinite(above)]
        # A numerical failure in the middle leaves the bracket as it is: another run would be the same.
        runs = [(k, middle) for k, middle in middles if middle not in levels[k]]
        if not runs:
            break
        for (k, middle), outcome_there in zip(runs, outcomes_at(runs), strict=True):
            _insert(levels, outcomes, k, middle, outcome_there)
    return Capacities(severity, tuple(levels), tuple(outcomes), lifted)


def capacities_near(
    simulate: Simulate,
    known: Sequence[tuple[Array, NDArray[np.int8]]],
    starts: Array,
    ends: tuple[float, float],
    severity: int,
) -> Capacities:
    """Simulate each record at its predicted capacity, beyond it by steps that double, and between the two.

    Args:
        simulate: the outcomes of records at levels.
        known: rising levels of each of n records, and their outcomes, that need no simulation.
        starts: (n,) predicted capacities.
        ends: lowest and highest level.
        severity: of the outcome that is sought, or a worse one.
    """
    levels, outcomes = [one for one, _ in known], [one for _, one in known]
    while True:
        nexts = [_next(*one, ends, severity) for one in zip(levels, outcomes, starts.tolist(), strict=True)]
        # A level without an outcome is not simulated again.
        runs = [(k, level) for k, level in enumerate(nexts) if level is not None and level not in levels[k]]
        if not runs:
            return Capacities(severity, tuple(levels), tuple(outcomes), np.zeros(len(levels), dtype=np.int64))
        for (k, level), outcome_there in zip(runs, simulate(runs).outcome, strict=True):
            _insert(levels, outcomes, k, level, outcome_there)


def _next(
    levels: Array, outcomes: NDArray[np.int8], start: float, ends: tuple[float, float], severity: int
) -> float | None:
    """The next level of a record; None if its capacity is known well enough, or lies beyond an end."""
    below, above = _bracket(levels, outcomes, severity)
    if above <= below * (1.0 + STEP):
        narrow = (1.0 + STEP) ** (0.5**HALVINGS)
        return math.sqrt(below * above) if above > 1.0001 * narrow * below else None
    # What lies between an end and a level is divided by ratios.
    middle = math.sqrt(max(below, ends[0]) * min(above, ends[1]))
    while start in levels and below < start < above:
        start *= (1.0 + STEP) ** 0.3  # that level has no outcome, and steps must not lead back to it
    if start <= below:
        # Levels without an outcome count, so that steps grow beyond them.
        step = 1.0 + STEP * 2.0 ** ((levels >= start) & (levels < above)).sum() / 2.0
        return None if below >= ends[1] else min(below * step, middle if above < np.inf else ends[1])
    if start >= above:
        step = 1.0 + STEP * 2.0 ** ((levels > below) & (levels <= start)).sum() / 2.0
        return None if above <= ends[0] else max(above / step, middle if below > 0.0 else ends[0])
    return min(start, ends[1])


def _insert(levels: list[Array], outcomes: list[NDArray[np.int8]], k: int, level: float, outcome: np.int8) -> None:
    place = int(np.searchsorted(levels[k], level))
    levels[k], outcomes[k] = np.insert(levels[k], place, level), np.insert(outcomes[k], place, outcome)


def _survived(outcomes: NDArray[np.int8], severity: int) -> NDArray[np.bool_]:
    return np.asarray((outcomes != NUMERICAL_FAILURE) & (outcomes < severity))


def _bracket(levels: Array, outcomes: NDArray[np.int8], severity: int) -> tuple[float, float]:
    """The highest survived level below the lowest failed one, and that one."""
    failed = levels[outcomes >= severity]
    above = float(failed[0]) if len(failed) else np.inf
    survived = levels[_survived(outcomes, severity) & (levels < above)]
    return float(survived[-1]) if len(survived) else 0.0, above
