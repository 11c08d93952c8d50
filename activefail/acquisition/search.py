"""Designs that look for an outcome that was never seen, of which a classifier cannot know anything."""

import numpy as np
from scipy.spatial.distance import cdist

from activefail.space import Array, DesignSpace

WIDENINGS = (1.0, 1.5, 2.0, 2.5, 3.0)
"""Factors by which the variables' normal distributions are widened, one design after the other."""

_POOL = 1024
"""Candidates for one design; a power of two."""


def search(space: DesignSpace, known: Array, first: int, q: int, rng: np.random.Generator) -> Array:
    """q designs, (q, d), far from all that are known and from each other, and further out than the space's own.

    An outcome that a Latin hypercube has missed is rare, and rare outcomes mostly lie where several variables are far
    from their means. So each design is the candidate farthest from its nearest neighbour (maximin; [JohnsonEtAl1990])
    in the variables' standardised values, and candidates have one width after the other of `WIDENINGS`.

    Args:
        space: of the designs.
        known: (n, d) designs that were simulated or are in flight.
        first: designs that were searched for before these, by which the widths take turns.
        q: how many.
        rng: of the candidates.
    """
    chosen = space.standardised(known)
    found = []
    for number in range(first, first + q):
        candidates = space.widened(space.sobol(_POOL, rng), WIDENINGS[number % len(WIDENINGS)])
        places = space.standardised(candidates)
        distances = cdist(places, chosen).min(axis=1) if len(chosen) else np.linalg.norm(places, axis=1)
        best = int(np.argmax(distances))
        found.append(candidates[best])
        chosen = np.concatenate([chosen, places[best : best + 1]])
    return np.stack(found) if found else np.empty((0, space.dimension))
