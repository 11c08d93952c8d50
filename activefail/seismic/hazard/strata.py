"""Standard normal deviates in strata, for uncertainty that is added to pulses."""

import math

import numpy as np

from activefail.space.space import Array

_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Its multiples fill the unit interval evenly, modulo 1."""


def deviates(rows: int, n: int) -> Array:
    """Standard normal deviates, (rows, n): in each row one in each of n strata of equal probability.

    Their places within the strata differ from row to row, so that all rows together have the tails as well.
    """
    from scipy.special import ndtri

    shifts = (np.arange(rows) + 0.5) * _GOLDEN % 1.0
    return np.asarray(ndtri((np.arange(n) + shifts[:, None]) / n))
