"""Two intervals of a probability over finitely many values: of these values, and of others of their kind."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.space.space import Array
from activefail.space.weighted import clopper_pearson

_PRIOR = (0.5, 4.5)
"""Beta prior of the share θ of predictions that are wrong although the classifier is sure of them. With its mean of
10 %, no classifier is taken to be right before a check. `studies/stripes.py` measures the intervals that follow."""

_EARLIER = 4.0
"""Most weight of the checks of earlier questions, in simulations, about that of one check: this one's values may be
less regular. With twice the weight, intervals after four clean checks hold too seldom over 10 % irregular values."""

_DRAWS = 4000
"""Draws of the number of wrong predictions, always the same random numbers."""

_LEAST_GROUPS = 3
"""Fewest groups from which anything follows for others, as for `activefail ida`."""


class Interval(NamedTuple):
    """Two ends."""

    low: float
    high: float


class Checked(NamedTuple):
    """What checks found: predictions, drawn at random, that were simulated too, and how many this contradicted."""

    simulated: int
    contradicted: int


class SureWrong(NamedTuple):
    """The Beta posterior of the share θ of predictions that are wrong although the classifier is sure of them."""

    a: float
    b: float

    @classmethod
    def of(cls, own: Checked, earlier: Checked) -> "SureWrong":
        """From the check of a question, and those of earlier ones."""
        weight = min(1.0, _EARLIER / max(1, earlier.simulated))
        right, earlier_right = own.simulated - own.contradicted, earlier.simulated - earlier.contradicted
        a, b = _PRIOR
        return cls(a + own.contradicted + weight * earlier.contradicted, b + right + weight * earlier_right)

    @property
    def mean(self) -> float:
        """The expected share."""
        return self.a / (self.a + self.b)

    def most(self, confidence: float) -> float:
        """An upper bound on the share, with this one-sided confidence."""
        from scipy.stats import beta

        return float(beta.ppf(confidence, self.a, self.b))


def expected_wrong(predicted: NDArray[np.bool_], doubt: Array, weight: Array, checked: Checked) -> float:
    """Expected probability of the values that are predicted wrongly, by the doubt and by the question's own check.

    A share θ of predictions, that of the check, is wrong although the classifier is sure (see `deviations`). If the
    check contradicted none, it is 0: what a small check may have missed is part of the interval.
    """
    theta = checked.contradicted / max(1, checked.simulated)
    return float(weight @ np.where(predicted, doubt + (1.0 - 2.0 * doubt) * theta, 0.0))


def deviations(
    beyond: NDArray[np.bool_], predicted: NDArray[np.bool_], doubt: Array, weight: Array, sure_wrong: SureWrong
) -> Array:
    """Draws of what wrong predictions leave out of the probability of these values, and what they put in, (2, draws).

    A prediction is wrong with its doubt q, and with the probability θ although the classifier is sure: q + (1 − 2q) θ.
    All predictions share θ.

    Args:
        beyond: (n,) on which side of the boundary each value is, or is predicted.
        predicted: (n,) whether it is predicted.
        doubt: (n,) the classifier's probability that this is wrong.
        weight: (n,) probabilities of the values.
        sure_wrong: what checks say of θ.
    """
    rng = np.random.default_rng(0)
    theta = rng.beta(*sure_wrong, size=(_DRAWS, 1))
    q = doubt[predicted]
    is_wrong = rng.random((_DRAWS, len(q))) < q + (1.0 - 2.0 * q) * theta
    sides = ~beyond[predicted], beyond[predicted]
    return np.array([is_wrong @ (weight[predicted] * side) for side in sides])


def of_these(probability: float, drawn: Array, lost: tuple[float, float], confidence: float) -> Interval:
    """The interval of these values: the classifier's remaining doubt.

    Each end counts wrong predictions of one side alone, because all of them may lie there.

    Args:
        probability: of the values, by simulations and predictions.
        drawn: `deviations`.
        lost: probability of the values whose simulations gave no outcome, predicted to be beyond, and not to be. They
            may be on either side.
        confidence: of the interval.
    """
    missed, false = np.quantile(drawn, 0.5 + 0.5 * confidence, axis=1, method="inverted_cdf").tolist()
    return Interval(max(0.0, probability - false - lost[0]), min(1.0, probability + missed + lost[1]))


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
    from scipy.stats import t

    of_group, off = np.bincount(group, weight), drawn[0] - drawn[1]
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
    centre = float(np.clip(probability + off.mean(), 0.0, 1.0))
    variance, tail = between + float(off.var()), 0.5 + 0.5 * confidence
    if variance > 0.0:
        values = min(values, centre * (1.0 - centre) / variance)
    values *= (float(t.ppf(tail, len(weight) - 1)) / float(t.ppf(tail, count - 1))) ** 2
    return Interval(*clopper_pearson(centre * values, values, tail))


def most_wrong(checked: Checked, confidence: float) -> float:
    """An upper bound on the share of the unchecked probability that is predicted wrongly, without a model.

    The check draws one prediction after another by weight, without replacement. While that share is left, each draw
    finds a wrong prediction at least with its probability. So Clopper and Pearson's bound holds.

    Args:
        checked: the check.
        confidence: one-sided, of the bound.
    """
    from scipy.stats import beta

    if checked.contradicted >= checked.simulated:
        return 1.0
    return float(beta.ppf(confidence, checked.contradicted + 1, checked.simulated - checked.contradicted))
