"""Where failure may hide from a classifier that believes it knows the boundary."""

import numpy as np

from activefail.space import Array, DesignSpace, radius

_POOL = 2048
"""Candidates for each place."""

OUTSIDE = 0.3
"""Probability outside the searched ball, in units of the failure probability."""


def hidden_places(space: DesignSpace, known: Array, probability: float, count: int, rng: np.random.Generator) -> Array:
    """Designs, (count, d), far from the known ones and from each other (maximin; [JohnsonEtAl1990]).

    They lie in the ball of standard normal space that leaves out `OUTSIDE` of the failure probability: failure that is
    hidden farther out could not change the probability much.

    Args:
        space: the design space.
        known: (n, d) simulated designs.
        probability: the failure probability so far.
        count: number of designs.
        rng: generator of the candidates.
    """
    from scipy.spatial.distance import cdist

    d = space.dimension
    neighbours, places = space.to_normal(known), np.empty((0, d))
    farthest = radius(min(0.5, OUTSIDE * probability), d)
    for _ in range(count):
        Z = rng.standard_normal((_POOL, d))
        Z *= (farthest * rng.random(_POOL) ** (1.0 / d) / np.linalg.norm(Z, axis=1))[:, None]
        best = int(np.argmax(cdist(Z, neighbours).min(axis=1)))
        places, neighbours = (
            np.concatenate([places, Z[best : best + 1]]),
            np.concatenate([neighbours, Z[best : best + 1]]),
        )
    return space.from_normal(places)
