"""The lowest intensity of each record at which a bearing reaches an outcome: a ladder of levels, then bisection."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import Model, Tolerance
from activefail.bearing.outcome import CAUSES, OUTCOMES
from activefail.bearing.simulation import simulate_records
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array

_LIFTED = CAUSES.index("failure_without_rim_touch")
_FAILURE = len(OUTCOMES) - 1


@dataclass(frozen=True, eq=False)
class Capacities:
    """What the levels of each of n records showed.

    Attributes:
        below: (n,) highest level below the capacity that the bearing survived; 0 if it failed at the lowest.
        capacity: (n,) lowest level with the outcome; infinite if none has it.
        resurrections: (n,) levels above the capacity that the bearing survived.
        numerical_failures: (n,) levels without an outcome.
        lifted: (n,) levels at which a plate lifted off the slider by more than the rim's height before any rim touch.
        levels, outcomes: for each record its levels, rising, and their outcomes.
    """

    below: Array
    capacity: Array
    resurrections: NDArray[np.int64]
    numerical_failures: NDArray[np.int64]
    lifted: NDArray[np.int64]
    levels: tuple[Array, ...]
    outcomes: tuple[NDArray[np.int8], ...]

    @property
    def runs(self) -> int:
        """Number of simulations."""
        return sum(map(len, self.levels))


def capacities(
    bearing: Array,
    records: Sequence[Accelerogram],
    own: Array,
    ladder: Array,
    bisections: int,
    severity: int,
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Capacities:
    """Simulate a bearing under records at the levels of a ladder, then between the two levels that hold its capacity.

    The whole ladder is simulated, because a bearing may survive a higher level than one at which it fails. A level
    without an outcome, a numerical failure, is neither survived nor failed.

    Under a pulse of Table 1 no bearing fails before a rim touch, so `simulate` takes that for a numerical failure.
    Under records of some 3 g the slider rocks until a plate is above its rim: a failure by the model's own criterion,
    with an energy imbalance of 1e-6. Left out, it would bias the fragility, so it is a failure here, and counted.

    Args:
        bearing: (7,) a row of `simulate_records`.
        records: n records.
        own: (n,) intensity of the records as they are.
        ladder: (k,) rising levels of the intensity.
        bisections: levels between the last survived and the first failed one of the ladder.
        severity: of the outcome that is sought, or a worse one.
        model, tolerance, threads: as for `simulate_records`.
        progress: called with the numbers of simulations that ended; their total is n (k + bisections) at most.

    Raises:
        InputError: as `simulate_records` does.
    """
    levels = [ladder.copy() for _ in records]
    lifted = np.zeros(len(records), dtype=np.int64)

    def outcomes_at(asked: Sequence[tuple[int, float]]) -> NDArray[np.int8]:
        moved = [records[k].scaled(level / own[k]) for k, level in asked]
        answers = simulate_records(np.tile(bearing, (len(asked), 1)), moved, model, tolerance, threads, progress)
        is_lifted = answers.cause == _LIFTED
        np.add.at(lifted, [k for k, _ in asked], is_lifted)
        return np.where(is_lifted, _FAILURE, answers.outcome).astype(np.int8)

    first = outcomes_at([(k, level) for k in range(len(records)) for level in ladder.tolist()])
    outcomes = list(first.reshape(len(records), -1))
    for _ in range(bisections):
        brackets = [_bracket(*one, severity) for one in zip(levels, outcomes, strict=True)]
        middles = [(k, 0.5 * (below + above)) for k, (below, above) in enumerate(brackets) if np.isfinite(above)]
        # A numerical failure in the middle leaves the bracket as it is: another run would be the same.
        asked = [(k, middle) for k, middle in middles if middle not in levels[k]]
        if not asked:
            break
        for (k, middle), outcome_there in zip(asked, outcomes_at(asked), strict=True):
            place = int(np.searchsorted(levels[k], middle))
            levels[k] = np.insert(levels[k], place, middle)
            outcomes[k] = np.insert(outcomes[k], place, outcome_there)
    brackets = [_bracket(*one, severity) for one in zip(levels, outcomes, strict=True)]
    below, capacity = np.array(brackets).T
    resurrections, failures = [], []
    for own_levels, outcome, lowest in zip(levels, outcomes, capacity.tolist(), strict=True):
        answered = outcome != NUMERICAL_FAILURE
        resurrections.append(int((answered & (outcome < severity) & (own_levels > lowest)).sum()))
        failures.append(int((~answered).sum()))
    return Capacities(
        below, capacity, np.array(resurrections), np.array(failures), lifted, tuple(levels), tuple(outcomes)
    )


def on_ladder(found: Capacities, ladder: Array) -> NDArray[np.int8]:
    """The outcomes at the levels of the ladder, (n, k), without those of the bisections."""
    pairs = zip(found.levels, found.outcomes, strict=True)
    return np.array([outcomes[np.isin(levels, ladder)] for levels, outcomes in pairs], dtype=np.int8)


def _bracket(levels: Array, outcomes: NDArray[np.int8], severity: int) -> tuple[float, float]:
    """The highest survived level below the lowest failed one, and that one."""
    failed = levels[outcomes >= severity]
    above = float(failed[0]) if len(failed) else np.inf
    survived = levels[(outcomes != NUMERICAL_FAILURE) & (outcomes < severity) & (levels < above)]
    return float(survived[-1]) if len(survived) else 0.0, above
