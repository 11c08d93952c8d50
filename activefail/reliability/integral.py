"""The probability beyond each boundary under a distribution, by the classifier alone: the one integrator.

Its points are always the same, so that one classifier gives one number wherever it is shown. Randomised Sobol'
sequences integrate what is not rare. Populations that gather where the probability comes from integrate the rest, each
around parents that an earlier one has found [CappeEtAl2004].
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.acquisition.by_margin import doubt
from activefail.acquisition.population import around, finite, first_parents, next_parents
from activefail.features import FeatureMap
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier
from activefail.weighted import WeightedRows

Standardised = Callable[[Array], Array]
"""Designs, (n, d) -> probit of P(at least as severe as one outcome), (n,); positive beyond the boundary."""

Boundaries = Callable[[Array], Array]
"""Designs, or values of a distribution's variables, (n, d) -> probits of P(at least as severe), (n, b)."""

ACCURACY = 0.02
"""Relative standard error that ends the integration."""

_SEQUENCES, _LENGTHS = 8, (128, 512)
"""Randomised Sobol' sequences, and their lengths: the second if the first is not accurate."""

_MOST_ROWS = 4096
"""Most weighted rows that are integrated; of more, a systematic sample is taken."""

_SEEN = 50.0
"""Least number of points beyond a boundary, as the probability says, for a standard error of the sequences."""

_POPULATION, _PARENTS, _ROUNDS = 8192, 100, 40
"""Designs of a population and their parents, and most populations."""


Contains = Callable[[Array], NDArray[np.bool_]]
"""Values of a distribution's variables, (n, k) -> whether the campaign's space contains the designs, (n,)."""


class OfBoundary(NamedTuple):
    """The share of a distribution that a classifier puts beyond one boundary; see `Integral`."""

    probability: float
    error: float
    outside: float


class Integral(NamedTuple):
    """The share of a distribution that a classifier puts beyond each of b boundaries.

    Attributes:
        probability: (b,) the shares.
        error: (b,) standard errors of the integration.
        outside: (b,) the part of each share that comes from outside the campaign's design space.
    """

    probability: Array
    error: Array
    outside: Array

    def of(self, column: int) -> OfBoundary:
        """The numbers of one boundary."""
        return OfBoundary(*(float(numbers[column]) for numbers in self))


def boundaries_of(classifier: Classifier, features: FeatureMap) -> Boundaries:
    """All boundaries of a classifier as one function of designs; the features are computed once."""
    return lambda X: classifier.predicted(finite(features, X)).boundaries


def boundary_of(classifier: Classifier, features: FeatureMap, outcome: str) -> Standardised:
    """The boundary of an outcome as a function of designs."""
    column = classifier.outcomes.index(outcome) - 1
    return lambda X: classifier.predicted(finite(features, X)).boundaries[:, column]


def integrate(
    boundaries: Boundaries,
    space: DesignSpace | WeightedRows,
    contains: Contains | None = None,
    resolution: float = 0.0,
    accuracy: float = ACCURACY,
) -> Integral:
    """The share of a distribution that a classifier puts beyond each boundary: the mean of Φ(z).

    Args:
        boundaries: of the distribution's variables.
        space: the distribution.
        contains: whether the campaign's space contains the designs; all if None.
        resolution: standard error that is small enough, whatever the probability.
        accuracy: relative standard error that is small enough.
    """
    if isinstance(space, WeightedRows):
        return _of_rows(boundaries, space.thinned(_MOST_ROWS), contains)
    for length in _LENGTHS:
        integral = _by_sequences(boundaries, space, contains, length)
        limit = np.maximum(accuracy * integral.probability, resolution)
        # A share that no point shows may be as large as three points.
        seen = (integral.probability * _SEQUENCES * length >= _SEEN) | (3.0 / (_SEQUENCES * length) <= resolution)
        accurate = (integral.error <= limit) & seen
        if accurate.all():
            return integral
    if resolution:
        return integral
    for column in np.flatnonzero(~accurate):
        found = _by_populations(boundaries, int(column), space, contains, accuracy)
        for known, value in zip(integral, found, strict=True):
            known[column] = value
    # Populations have their own errors, by which boundaries must not cross.
    return integral._replace(probability=np.minimum.accumulate(np.minimum(integral.probability, 1.0)))


def _of_rows(boundaries: Boundaries, rows: WeightedRows, contains: Contains | None) -> Integral:
    beyond = ndtr(boundaries(rows.X))
    probability = (rows.weight[:, None] * beyond).mean(axis=0)
    error = rows.standard_error(beyond) if rows.is_sample else np.zeros_like(probability)
    return Integral(probability, np.asarray(error), _outside(rows.weight[:, None] * beyond, rows.X, contains))


def _outside(parts: Array, X: Array, contains: Contains | None) -> Array:
    """The shares of the parts, (n, b), of designs outside, (b,)."""
    total = parts.sum(axis=0)
    outside = np.zeros(parts.shape[1]) if contains is None else parts[~contains(X)].sum(axis=0)
    return np.asarray(np.divide(outside, total, out=np.zeros(len(total)), where=total > 0.0))


def _by_sequences(boundaries: Boundaries, space: DesignSpace, contains: Contains | None, length: int) -> Integral:
    X = np.concatenate([space.sobol(length, np.random.default_rng(number)) for number in range(_SEQUENCES)])
    beyond = ndtr(boundaries(X))
    means = beyond.reshape(_SEQUENCES, length, -1).mean(axis=1)
    error = means.std(axis=0, ddof=1) / np.sqrt(_SEQUENCES)
    return Integral(means.mean(axis=0), error, _outside(beyond, X, contains))


def _by_populations(
    boundaries: Boundaries,
    column: int,
    space: DesignSpace,
    contains: Contains | None,
    accuracy: float,
) -> tuple[float, float, float]:
    """One boundary's probability, its standard error, and the part from outside."""

    def importance(X: Array) -> Array:
        z = boundaries(X)[:, column]
        return np.asarray(ndtr(z) + doubt(z))

    rng = np.random.default_rng(0)
    parents = first_parents(space, _POPULATION, _PARENTS, importance, rng)
    means, variances, shares = [], [], []
    for _ in range(_ROUNDS):
        drawn = around(space, _POPULATION, parents, rng)
        z = boundaries(drawn.X)[:, column]
        parts = drawn.weight * ndtr(z)
        means.append(float(parts.mean()))
        variances.append(float(parts.var()) / len(parts))
        shares.append(float(_outside(parts[:, None], drawn.X, contains)[0]))
        # Parents of a later population: those of the same one would bias its mean.
        parents = next_parents(drawn, _PARENTS, ndtr(z) + doubt(z), rng)
        mean, error = float(np.mean(means)), float(np.sqrt(np.sum(variances)) / len(means))
        if len(means) > 1:
            # A population that has missed a region does not know it; those that found it differ.
            error = max(error, float(np.std(means, ddof=1) / np.sqrt(len(means))))
            if error <= accuracy * mean:
                break
    return mean, error, float(np.average(shares, weights=np.maximum(means, 1e-300)))
