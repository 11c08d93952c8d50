"""Which rows of a weighted sample are simulated: each at most once, drawn systematically with unequal probabilities.

The rows lie in an order, such as that of the classifier's z, and every draw stands for an equal part of the expected
numbers of draws, so that the draws spread over the order [Madow1949]. With the expected number π of
draws of a row, Σ share y/π over the draws has the mean Σ share y over all rows [HorvitzThompson1952].
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.space.space import Array


class Rows(NamedTuple):
    """Different designs with their parts of a distribution.

    Attributes:
        X: (n, k) values of the distribution's variables.
        share: (n,) the parts, all positive; their sum is about 1.
        wide: (n,) parts of a distribution that reaches farther out; their sum is about 1.
        variance: (n,) of each part as an estimate; 0 if the rows are the distribution itself.
    """

    X: Array
    share: Array
    wide: Array
    variance: Array


def merged(rows: Rows, designs: Array) -> Rows:
    """The rows with a positive share, equal designs, (n, d), as one row."""
    kept = rows.share > 0.0
    if not kept.all():
        rows, designs = Rows(*(of[kept] for of in rows)), designs[kept]
    _, first, row = np.unique(designs, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(designs):
        return rows
    sums = (np.bincount(row.ravel(), weights=of).astype(np.float64) for of in rows[1:])
    return Rows(rows.X[first], *sums)


def expected_draws(shares: Array, m: int, repeats: bool = False) -> Array:
    """Expected numbers of draws, (n,), whose sum is m: in proportion to the shares, but at most 1.

    Args:
        shares: (n,) all positive.
        m: number of draws; without repeats at most n.
        repeats: whether rows may be drawn again if there are fewer than m: in proportion to the shares, but at least
            once.
    """
    n = len(shares)
    if m >= n and not repeats:
        return np.ones(n)
    # The k largest shares, or smallest, are drawn once, for the least k that leaves no other above 1, or below.
    side = 1.0 if m > n else -1.0
    order = np.argsort(side * shares, kind="stable")
    ordered = shares[order]
    rest = np.cumsum(ordered[::-1])[::-1]
    k = int(np.argmax(side * ((m - np.arange(n)) * ordered - rest) >= 0.0))
    expected = np.ones(n)
    expected[order[k:]] = (m - k) * ordered[k:] / rest[k]
    return np.asarray(np.maximum(expected, 1.0) if m > n else np.minimum(expected, 1.0))


def systematic(expected: Array, order: NDArray[np.intp], rng: np.random.Generator) -> NDArray[np.intp]:
    """The drawn rows, (m,), in an order of the rows, (n,), m the sum of the expected draws, (n,)."""
    # The whole parts apart: rounding must neither draw a row twice nor leave out one that is certain.
    whole = np.floor(expected + 1e-9)
    part = np.maximum(expected - whole, 0.0)
    below = np.cumsum(part[order])
    drawn, left = whole.astype(np.intp), round(float(below[-1]))
    if left:
        places = np.searchsorted(below * (left / below[-1]), rng.random() + np.arange(left), side="right")
        drawn[order[np.minimum(places, len(order) - 1)]] += 1
    return np.repeat(order, drawn[order])
