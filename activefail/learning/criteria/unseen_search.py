"""Search for outcomes that were never seen, about which a classifier knows nothing."""

import numpy as np
from scipy.spatial.distance import cdist

from activefail.space.space import Array, DesignSpace

WIDENINGS = (1.0, 1.5, 2.0, 2.5, 3.0)
"""Factors that widen the variables' normal distributions, used in turn."""

_POOL = 1024
"""Candidates per design; a power of two."""


def search(space: DesignSpace, known: Array, first: int, q: int, rng: np.random.Generator) -> Array:
    """q designs, (q, d), far from the known ones and from each other, with normal variables widened.

    An outcome that a Latin hypercube misses is rare, and rare outcomes mostly lie where several variables are far from
    their means. So each design is the candidate farthest from its nearest neighbour (maximin; [JohnsonEtAl1990]) in the
    variables' standardised values, and the candidates use the factors of `WIDENINGS` in turn.

    Args:
        space: the design space.
        known: (n, d) designs that were simulated or are in flight.
        first: number of earlier search designs, which determines the next factor.
        q: number of designs.
        rng: generator for the candidates.
    """
    neighbours = space.positions(known)
    designs = []
    for number in range(first, first + q):
        drawn = space.sobol(_POOL, rng)
        wide = space.widened(drawn, WIDENINGS[number % len(WIDENINGS)])
        candidates = np.where(space.meets_constraints(wide)[:, None], wide, drawn)
        Z = space.positions(candidates)
        distances = cdist(Z, neighbours).min(axis=1) if len(neighbours) else np.linalg.norm(Z, axis=1)
        best = int(np.argmax(distances))
        designs.append(candidates[best])
        neighbours = np.concatenate([neighbours, Z[best : best + 1]])
    return np.stack(designs) if designs else np.empty((0, space.dimension))
