"""Independent random streams of a campaign, one for each use, so that the order of work does not change them."""

import numpy as np

STREAMS = {
    "initial": 1,
    "propose": 2,
    "validation": 3,
    "test": 4,
    "static": 5,
    "verification": 6,
    "probability": 7,
    "estimate": 8,
    "check": 9,
    "ask": 10,
    "draw": 11,
    "hidden": 12,
    "modes": 13,
    "stripe": 14,
    "exists": 15,
}
"""Spawn keys of the streams; a key never changes its meaning, so that old campaigns replay."""


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """The generator of one use of randomness: a counter-based stream keyed by seed, use and index."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(STREAMS[name], index))))
