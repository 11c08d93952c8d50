"""Where a campaign's random numbers come from: one stream for each use, so that no order of work changes them."""

import numpy as np

STREAMS = {"initial": 1, "propose": 2, "validation": 3, "test": 4, "static": 5, "verification": 6}
"""Independent streams of random numbers; a number never changes its meaning, so that old campaigns replay."""


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """The generator of one use of randomness: a counter-based stream keyed by campaign, use and index.

    No order of work, worker or resume can change what it draws.
    """
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(STREAMS[name], index))))
