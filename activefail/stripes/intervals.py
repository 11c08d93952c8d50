"""Two intervals of a probability over finitely many values: of these values, and of others of their kind."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.space import Array

_PRIOR = (0.05, 4.95)
"""Beta prior of the share θ of predictions that are wrong although the classifier is sure of them: 1 % on average, and
more than 5 % for one question in twenty. `studies/stripes.py` measures this share, and the intervals that follow."""

_DRAWS = 4000
"""Draws of the number of wrong predictions, always the same random numbers."""

_LEAST_GROUPS = 3
"""Fewest groups from which anything follows for others, as for `activefail ida`."""


class Interval(NamedTuple):
    """Two ends."""

    low: float
    high: float


class Checked(NamedTuple):
    """What a check found: predictions, drawn at random, that were simulated too, and how many this contradicted."""

    simulated: int
    contradicted: int


def expected_wrong(predicted: NDArray[np.bool_], doubt: Array, weight: Array, checked: Checked) -> float:
    """Expected probability of the values that are predicted wrongly (see `deviations`)."""
    a, b = _PRIOR
    theta = (a + checked.contradicted) / (a + b + checked.simulated)
    return float(weight @ np.where(predicted, doubt + (1.0 - 2.0 * doubt) * theta, 0.0))


def deviations(
    beyond: NDArray[np.bool_], predicted: NDArray[np.bool_], doubt: Array, weight: Array, checked: Checked
) -> Array:
    """Draws of the probability of these values minus the predicted one, (draws,).

    A prediction is wrong with its doubt q, and with the probability θ although the classifier is sure: q + (1 − 2q) θ.
    The check gives the posterior of θ, which all predictions share.

    Args:
        beyond: (n,) on which side of the boundary each value is, or is predicted.
        predicted: (n,) whether it is predicted.
        doubt: (n,) the classifier's probability that this is wrong.
        weight: (n,) probabilities of the values.
        checked: by random predictions.
    """
    rng = np.random.default_rng(0)
    a, b = _PRIOR
    theta = rng.beta(a + checked.contradicted, b + checked.simulated - checked.contradicted, size=(_DRAWS, 1))
    q = doubt[predicted]
    is_wrong = rng.random((_DRAWS, len(q))) < q + (1.0 - 2.0 * q) * theta
    return np.asarray(is_wrong @ np.where(beyond[predicted], -weight[predicted], weight[predicted]))


def of_these(probability: float, drawn: Array, lost: tuple[float, float], confidence: float) -> Interval:
    """The interval of these values: the classifier's remaining doubt.

    Args:
        probability: of the values, by simulations and predictions.
        drawn: `deviations` from it.
        lost: probability of the values whose simulations gave no outcome, predicted to be beyond, and not to be. They
            may be on either side.
        confidence: of the interval.
    """
    tails = 0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence
    low, high = probability + np.quantile(drawn, tails, method="inverted_cdf")
    return Interval(max(0.0, float(low) - lost[0]), min(1.0, float(high) + lost[1]))


def of_others(
    beyond: NDArray[np.bool_], weight: Array, group: NDArray[np.intp], drawn: Array, confidence: float
) -> Interval | None:
    """The interval of other values of the kind, over groups; None with fewer than three.

    That of Clopper and Pearson, with as many values as would vary as much if they were independent
    [KornGraubard1998]: the variance is that of a ratio over groups, and that of the classifier's doubt. If all groups
    agree, they count as one value each.

    Args:
        beyond, weight: as for `deviations`.
        group: (n,) number of the group of each value.
        drawn: `deviations`.
        confidence: of the interval.
    """
    from scipy.stats import beta, t

    of_group = np.bincount(group, weight)
    count = int((of_group > 0.0).sum())
    if count < _LEAST_GROUPS:
        return None
    sides = beyond[weight > 0.0]
    probability = 1.0 if sides.all() else float(weight @ beyond)
    residual = np.bincount(group, weight * (beyond - probability))
    agree = bool(sides.all() or not sides.any())
    between = 0.0 if agree else float(residual @ residual) * count / (count - 1)
    counted = of_group if agree else weight
    values = 1.0 / float(counted @ counted)
    # Predictions that may be wrong move the probability away from 0 or 1.
    centre = float(np.clip(probability + drawn.mean(), 0.0, 1.0))
    variance, tail = between + float(drawn.var()), 0.5 + 0.5 * confidence
    if variance > 0.0:
        values = min(values, centre * (1.0 - centre) / variance)
    values *= (float(t.ppf(tail, len(weight) - 1)) / float(t.ppf(tail, count - 1))) ** 2
    hits = centre * values
    low = float(beta.ppf(1.0 - tail, hits, values - hits + 1.0)) if hits > 0.0 else 0.0
    high = float(beta.ppf(tail, hits + 1.0, values - hits)) if hits < values else 1.0
    return Interval(low, high)


def most_wrong(unchecked: int, checked: Checked, confidence: float) -> int:
    """An upper bound on the number of wrong ones among the predictions that were not checked, without a model.

    The check is a random sample without replacement of all predictions, so the number of wrong ones in it is
    hypergeometric.

    Args:
        unchecked: predictions from which the check was drawn, without those in it.
        checked: the check.
        confidence: one-sided, of the bound.
    """
    from scipy.stats import hypergeom

    wrong = np.arange(unchecked + 1)
    total, drawn = unchecked + checked.simulated, checked.simulated
    shares = hypergeom.cdf(checked.contradicted, total, wrong + checked.contradicted, drawn)
    return int(wrong[shares > 1.0 - confidence].max(initial=0))
