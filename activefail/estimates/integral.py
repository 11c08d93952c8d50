"""The probability beyond each boundary under a distribution, by the classifier alone: the one integrator.

Its points are always the same, so that one classifier gives one number wherever it is shown. Those of an estimate are
drawn with it, because its interval includes their error. Randomised Sobol' sequences integrate what is not rare.
Populations that gather where the probability comes from integrate the rest, each around parents that an earlier one has
found [CappeEtAl2004].
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr, ndtri_exp

from activefail.campaign.question import Question
from activefail.learning.criteria.by_margin import doubt
from activefail.learning.criteria.population import around, finite, first_parents, next_parents
from activefail.learning.features import FeatureMap
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import Latent
from activefail.learning.model.moments import predicted
from activefail.space.space import REACH, Array, DesignSpace
from activefail.space.weighted import WeightedRows

Standardised = Callable[[Array], Array]
"""Designs, (n, d) -> probit of P(at least as severe as one outcome), (n,); positive beyond the boundary."""

Boundaries = Callable[[Array], Array]
"""Designs, or values of a distribution's variables, (n, d) -> probits of P(at least as severe), (n, b)."""

ACCURACY = 0.02
"""Relative standard error that ends the integration."""

SEQUENCES, _LENGTHS, _LONGER = 8, (128, 512), (2048, 8192)
"""Randomised Sobol' sequences, and their lengths: the second if the first is not accurate; more for an estimate."""

_STUDENTS = ((SEQUENCES - 1.0) / (SEQUENCES - 3.0)) ** 0.5
"""Standard deviation of Student's t: the means of the sequences are few."""

_COUNTED = (6.0 * SEQUENCES) ** -0.5
"""Least standard error of the mean of the sequences, in points of one: each counts a whole number beyond a sharp
boundary, the one below or above at random, and all may count the same. The variance is 1/6 on average."""

_LEAST_LENGTH_SHARE = 0.1
"""Share of feasible designs below which a sequence, which is drawn until it has enough of them, is not longer."""

_MOST_ROWS = 4096
"""Most weighted rows that are integrated; of more, a systematic sample is taken."""

_SEEN = 50.0
"""Least number of points beyond a boundary, as the probability says, for a standard error of the sequences."""

_POPULATION, _PARENTS, _ROUNDS = 8192, 100, 40
"""Designs of a population and their parents, and most populations."""


_BLIND = 6
"""Populations without any design beyond the boundary, after which there is none."""

Share = Callable[[Array], Array]
"""Probits, of any shape -> the shares that designs count with."""

Contains = Callable[[Array], NDArray[np.bool_]]
"""Designs, (n, d), or values of variables -> whether the campaign's space contains the designs, (n,)."""


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


Lost = Literal["learned", "none", "all"]
"""Which of the designs that probably give no result count as beyond a boundary: as the boundary was learned, or so."""


@dataclass(frozen=True)
class BoundariesOf:
    """All boundaries of a classifier as one function of designs; the features are computed once.

    Designs that do not exist are beyond no boundary; `exists` says which do.

    Attributes:
        classifier: the classifier.
        features: map from designs to its inputs.
        lost: what a run without a known result counts as.
        outcome: the only one whose boundary is wanted; all if None.
    """

    classifier: Classifier
    features: FeatureMap
    lost: Lost = "learned"
    outcome: str | None = None

    def __call__(self, X: Array) -> Array:
        """The probits of P(at least as severe) of designs, (n, d) -> (n, b)."""
        F = finite(self.features, X)
        z = predicted(self.classifier, X, F).boundaries
        if self.outcome is not None:
            z = z[:, [self.classifier.outcomes.index(self.outcome) - 1]]
        if self.classifier.unknown is not None and self.lost != "learned":
            unknown = _probit_lost(self.classifier.unknown, F)
            z = both(z, -unknown) if self.lost == "none" else -both(-z, -unknown)
        if self.classifier.impossible is not None:
            impossible = _probit_lost(self.classifier.impossible, F)
            z = both(z, -impossible)
        return z

    @property
    def exists(self) -> Boundaries | None:
        """Where designs exist, as a boundary of its own; None if all do."""
        impossible = self.classifier.impossible
        if impossible is None:
            return None
        return lambda X: -_probit_lost(impossible, finite(self.features, X))


def _probit_lost(latent: Latent, F: Array) -> Array:
    """The probits of P(lost), (n, 1): with the noise of labels, because runs may also be lost at random."""
    return latent.moments(F).standardised[:, None]


def both(a: Array, b: Array) -> Array:
    """The probits of Φ(a) Φ(b)."""
    return np.asarray(ndtri_exp(log_ndtr(a) + log_ndtr(b)))


def existence(boundaries: Boundaries) -> Boundaries | None:
    """Where designs exist, of boundaries that know it; None if all do."""
    exists: Boundaries | None = getattr(boundaries, "exists", None)
    return exists


@dataclass(frozen=True)
class BoundaryOf:
    """One boundary of a classifier as a function of designs, (n, d) -> (n,).

    Attributes:
        boundaries: of which it is the only one.
    """

    boundaries: BoundariesOf

    def __call__(self, X: Array) -> Array:
        """The probits, (n,), of designs, (n, d)."""
        return self.boundaries(X)[:, 0]

    @property
    def exists(self) -> Boundaries | None:
        """As of `BoundariesOf`."""
        return self.boundaries.exists


def boundary_of(classifier: Classifier, features: FeatureMap, outcome: str, lost: Lost = "learned") -> BoundaryOf:
    """The boundary of an outcome as a function of designs."""
    return BoundaryOf(BoundariesOf(classifier, features, lost, outcome))


def integrate(
    boundaries: Boundaries,
    space: DesignSpace | WeightedRows,
    resolution: float = 0.0,
    accuracy: float | Array = ACCURACY,
    designs: Callable[[Array], Array] = lambda X: X,
    contains: Contains | None = None,
    share: Share = ndtr,
    rng: np.random.Generator | None = None,
) -> Integral:
    """The share of a distribution that a classifier puts beyond each boundary: the mean of Φ(z), of designs that exist.

    Args:
        boundaries: of designs.
        space: the distribution.
        resolution: standard error that is small enough, whatever the probability.
        accuracy: relative standard error that is small enough, () or (b,).
        designs: the designs of values of the distribution's variables.
        contains: whether the campaign's space contains designs; all if None.
        share: of a design with z that counts, Φ by default. Where it is searched for is decided by z itself.
        rng: draws the points, of which there may be more; if None, they are always the same.
    """
    integral = _integrated(
        lambda X: boundaries(designs(X)),
        space,
        resolution,
        accuracy,
        None if contains is None else lambda X: contains(designs(X)),
        share,
        rng,
    )
    if (exists := existence(boundaries)) is None:
        return integral
    existing = _integrated(lambda X: exists(designs(X)), space, 0.0, accuracy, None, rng=rng)
    probability = integral.probability / existing.probability
    error = np.hypot(integral.error, probability * existing.error) / existing.probability
    return integral._replace(probability=np.minimum(probability, 1.0), error=error)


def integral_of(question: Question, boundaries: Boundaries, space: DesignSpace, resolution: float = 0.0) -> Integral:
    """The share of a question that a campaign's classifier puts beyond each boundary.

    Args:
        question: of a campaign.
        boundaries: of its designs.
        space: of the campaign.
        resolution: standard error of the integration that is small enough, whatever the probability.
    """
    contains = None if question.is_own else space.spans
    return integrate(boundaries, question.space, resolution, designs=question.designs, contains=contains)


def _integrated(
    boundaries: Boundaries,
    space: DesignSpace | WeightedRows,
    resolution: float,
    accuracy: float | Array,
    contains: Contains | None,
    share: Share = ndtr,
    rng: np.random.Generator | None = None,
) -> Integral:
    if isinstance(space, WeightedRows):
        return _of_rows(boundaries, space.thinned(_MOST_ROWS), contains, share)
    lengths = _LENGTHS if rng is None or space.feasible_share < _LEAST_LENGTH_SHARE else (*_LENGTHS, *_LONGER)
    X = sequences(space, lengths[-1], rng).reshape(SEQUENCES, lengths[-1], -1)
    beyond, accurate, integral = np.empty((SEQUENCES, 0, 0)), np.zeros(1, dtype=bool), Integral(*np.zeros((3, 1)))
    for length in lengths:
        # The beginning of a sequence is one too.
        new = X[:, beyond.shape[1] : length]
        of_new = share(boundaries(new.reshape(-1, new.shape[-1]))).reshape(*new.shape[:2], -1)
        beyond = np.concatenate([beyond, of_new], axis=1) if beyond.size else of_new
        found = _of_sequences(beyond, X[:, :length], contains)
        if rng is not None:
            found = found._replace(error=np.maximum(_STUDENTS * found.error, _COUNTED / length))
        # What was accurate with fewer points keeps its number, whatever else is integrated beside it.
        integral = Integral(*(np.where(accurate, *pair) for pair in zip(integral, found, strict=True)))
        # Of a probability near 1, the rest is what is rare.
        rarer = np.minimum(integral.probability, 1.0 - integral.probability)
        limit = np.maximum(accuracy * rarer, resolution)
        # A share that no point shows may be as large as three points.
        seen = (rarer * SEQUENCES * length >= _SEEN) | (3.0 / (SEQUENCES * length) <= resolution)
        accurate = accurate | ((integral.error <= limit) & seen)
        # What the longest would hardly see is for populations.
        if ((accurate | (rarer * SEQUENCES * lengths[-1] < _SEEN)).all() and length >= _LENGTHS[-1]) or accurate.all():
            break
    if resolution:
        accurate = np.ones_like(accurate)
    accuracies = np.broadcast_to(accuracy, accurate.shape)
    for column in np.flatnonzero(~accurate):
        is_common = integral.probability[column] > 0.5
        own = np.random.default_rng(0) if rng is None else rng
        of_column = _by_populations(boundaries, int(column), space, contains, accuracies[column], share, is_common, own)
        if rng is not None and seen[column] and integral.error[column] <= of_column[1]:
            continue
        # Of a probability near 1, the sequences know where it comes from.
        for known, value in zip(integral[: 2 if is_common else 3], of_column, strict=False):
            known[column] = value
    # Populations have their own errors, by which boundaries must not cross.
    return integral._replace(probability=np.minimum.accumulate(np.minimum(integral.probability, 1.0)))


def _of_rows(boundaries: Boundaries, rows: WeightedRows, contains: Contains | None, share: Share) -> Integral:
    beyond = share(boundaries(rows.X))
    probability = (rows.weight[:, None] * beyond).mean(axis=0)
    error = rows.standard_error(beyond) if rows.is_sample else np.zeros_like(probability)
    return Integral(probability, np.asarray(error), _outside(rows.weight[:, None] * beyond, rows.X, contains))


def _outside(parts: Array, X: Array, contains: Contains | None) -> Array:
    """The shares of the parts, (n, b), of designs outside, (b,)."""
    total = parts.sum(axis=0)
    outside = np.zeros(parts.shape[1]) if contains is None else parts[~contains(X)].sum(axis=0)
    return np.asarray(np.divide(outside, total, out=np.zeros(len(total)), where=total > 0.0))


def sequences(space: DesignSpace, length: int, rng: np.random.Generator | None = None) -> Array:
    """Randomised Sobol' sequences of a length, a power of two, one after the other; without `rng` always the same."""
    return np.concatenate([space.sobol(length, rng or np.random.default_rng(n)) for n in range(SEQUENCES)])


def _of_sequences(beyond: Array, X: Array, contains: Contains | None) -> Integral:
    """The means over sequences of points X, (s, n, k), of their probabilities, (s, n, b)."""
    means = beyond.mean(axis=1)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    outside = _outside(beyond.reshape(-1, beyond.shape[-1]), X.reshape(-1, X.shape[-1]), contains)
    return Integral(means.mean(axis=0), error, outside)


def _by_populations(
    boundaries: Boundaries,
    column: int,
    space: DesignSpace,
    contains: Contains | None,
    accuracy: float,
    share: Share,
    is_common: bool,
    rng: np.random.Generator,
) -> tuple[float, float, float]:
    """One boundary's probability, its standard error, and the part from outside.

    Where the probability is above one half, the designs short of the boundary are searched for instead.
    """

    def searched(X: Array) -> Array:
        z = boundaries(X)[:, column]
        return -z if is_common else z

    def weighed(z: Array) -> Array:
        """How much designs matter: as they count; where none does, z itself shows the way."""
        counted = share(z)
        return counted if share is not ndtr and counted.any() else np.asarray(ndtr(z) + doubt(z))

    parents = first_parents(space, _POPULATION, _PARENTS, lambda X: weighed(searched(X)), rng)
    means, variances, shares = [], [], []
    for _ in range(_ROUNDS):
        drawn = around(space, _POPULATION, parents, rng)
        z = searched(drawn.X)
        parts = drawn.weight * share(z)
        means.append(float(parts.mean()))
        variances.append(float(parts.var()) / len(parts))
        shares.append(float(_outside(parts[:, None], drawn.X, contains)[0]))
        # Parents of a later population: those of the same one would bias its mean.
        parents = next_parents(drawn, _PARENTS, weighed(z), rng)
        mean, error = float(np.mean(means)), float(np.sqrt(np.sum(variances)) / len(means))
        if len(means) > 1:
            # A population that has missed a region does not know it; those that found it differ.
            error = max(error, float(np.std(means, ddof=1) / np.sqrt(len(means))))
            # Nothing is simulated farther out than `REACH`. A few populations may miss a region.
            if error <= accuracy * max(mean, REACH) and (mean > 0.0 or len(means) >= _BLIND):
                break
    outside = float(np.average(shares, weights=np.maximum(means, 1e-300)))
    return 1.0 - mean if is_common else mean, error, outside
