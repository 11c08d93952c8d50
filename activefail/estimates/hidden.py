"""Where failure may hide from a classifier that believes it knows the boundary, and what simulations there show."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.learning.model.system import AnyLatent, ByMargins
from activefail.space.space import Array, DesignSpace, radius

_POOL = 2048
"""Candidates for each place."""

OUTSIDE = 0.3
"""Probability outside the searched ball, in units of the failure probability."""

_FARTHEST = 4.0
"""Largest deviation of a check's margin from its prediction, in standard deviations."""

_ANSWERED = 0.75
"""Least share of a check's designs that must give an outcome."""


@dataclass(frozen=True)
class ModeCheck:
    """What the simulations of a check show of a classifier that has not seen them.

    Their designs are chosen for their distance. They are no sample, so they never enter an estimate.

    Attributes:
        simulations: number of designs.
        unanswered: numerical failures among them, which contradict nothing.
        contradictions: how many ended on another side of the boundary than the classifier predicts.
        deviation: of their margins from the classifier's (see `estimate.deviation_of_margins`).
    """

    simulations: int
    unanswered: int
    contradictions: int
    deviation: float = 1.0

    @property
    def is_whole(self) -> bool:
        """Whether enough designs gave an outcome."""
        return is_whole(self.simulations, self.simulations - self.unanswered)


def designs_of_check(dimension: int) -> int:
    """Number of designs of a check in a space of this dimension."""
    return 4 + 2 * dimension


def is_whole(designs: int, answered: int) -> bool:
    """Whether enough designs of a check gave an outcome."""
    return answered >= _ANSWERED * designs


def contradictions(
    latent: AnyLatent, F: Array, beyond: NDArray[np.bool_], margin: Array | None, repeatable: bool = True
) -> NDArray[np.bool_]:
    """Which simulations, (n,), contradict a latent that has not seen them: a wrong side, or a margin far off.

    Args:
        latent: of the boundary.
        F: (n, m) scaled features.
        beyond: (n,) whether each simulation ended beyond the boundary.
        margin: (n,) in relation to the boundary; None if only the side counts.
        repeatable: whether equal designs have equal results; otherwise noise explains a side that is not improbable.
    """
    moments = latent.moments(F)
    wrong = (moments.mean > 0.0) != beyond
    if not repeatable:
        wrong &= np.abs(moments.standardised) > _FARTHEST
    if isinstance(latent, ByMargins) and margin is not None:
        wrong |= np.abs(latent.deviations(F, margin)) > _FARTHEST
    return np.asarray(wrong)


def hidden_places(
    space: DesignSpace,
    known: Array,
    probability: float,
    count: int,
    rng: np.random.Generator,
    seen: Callable[[Array], Array] = lambda Z: Z,
    exists: Callable[[Array], Array] | None = None,
) -> Array:
    """Designs, (count, d), far from the known ones and from each other (maximin; [JohnsonEtAl1990]).

    They lie in the ball of standard normal space that leaves out `OUTSIDE` of the failure probability: failure that is
    hidden farther out could not change the probability much.

    Args:
        space: of the designs.
        known: (n, m) coordinates of the simulated designs.
        probability: the failure probability so far.
        count: number of designs.
        rng: generator of the candidates.
        seen: points of standard normal space, (k, d), as the coordinates that distances are measured in, (k, m).
        exists: designs, (k, d), to what is positive where they probably exist, (k, 1); None if all do.
    """
    from scipy.spatial.distance import cdist

    d = space.dimension
    neighbours, places = known, np.empty((0, d))
    farthest = radius(min(0.5, OUTSIDE * probability), d)
    for _ in range(count):
        Z = rng.standard_normal((_POOL, d))
        Z *= (farthest * rng.random(_POOL) ** (1.0 / d) / np.linalg.norm(Z, axis=1))[:, None]
        if space.constraints:
            feasible = Z[space.meets_constraints(space.from_normal(Z))]
            Z = feasible if len(feasible) else space.to_normal(space.random(_POOL, rng))
        if exists is not None and (existing := exists(space.from_normal(Z))[:, 0] > 0.0).any():
            Z = Z[existing]
        if any(one.step is not None for one in space.parameters):
            Z = space.to_normal(space.from_normal(Z))  # so that a known design has no distance from itself
        at = seen(Z)
        best = int(np.argmax(cdist(at, neighbours).min(axis=1)))
        places, neighbours = (
            np.concatenate([places, Z[best : best + 1]]),
            np.concatenate([neighbours, at[best : best + 1]]),
        )
    return space.from_normal(places)
