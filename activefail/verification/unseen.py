"""Outcomes without a simulation."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def unseen_outcomes(outcomes: Sequence[str], counts: NDArray[np.int64]) -> tuple[str, ...]:
    """The outcomes without a simulation, in order of severity.

    Args:
        outcomes: names of all outcomes.
        counts: (number of outcomes,) simulations by outcome; further entries are ignored.
    """
    return tuple(name for name, count in zip(outcomes, counts, strict=False) if not count)
