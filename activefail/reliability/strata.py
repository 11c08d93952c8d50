"""A probability that is not rare, and its interval, from fresh simulations in strata of the classifier's doubt.

A stratum has similar probabilities of a wrong prediction, and lies on one side of the boundary. Its share of wrong
predictions has a Beta posterior. These shares correct the classifier's probability. A part of the simulations is drawn
by volume, so that an interval claims no more than the simulations show where the classifier is sure.
docs/decisions/0019 compares other priors, and the importance sampling of mistakes (`estimate`).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.acquisition.population import population
from activefail.reliability.estimate import RADIAL, ProbabilityEstimate, estimated
from activefail.reliability.integral import OfBoundary, Standardised
from activefail.space import REACH, Array, DesignSpace
from activefail.weighted import WeightedRows

_EDGES = (0.0005, 0.02, 0.15)
"""Probabilities of being wrong that separate the strata of each side. The first falls with a rarer outcome."""

_BY_VOLUME = 0.5
"""Share of the simulations that is allocated to strata by volume."""

_PRIOR = (0.2, 1.5)
"""The prior of the share q of wrong predictions of a stratum is Beta(0.2 + q, 1.5 − q), q by the classifier. The 0.2
falls with a rarer outcome."""

_RIGHT_BELOW = 0.2
"""At the lower end of an interval, the prior of a stratum beyond the boundary is Beta(0.2 + q, 0.2): a classifier that
is wrong there must not raise the end."""

_LEAST_DOUBT = 1e-4
"""Least doubt of a stratum for the number of its simulations."""

_DRAWS = 10_000
"""Draws of the posterior, always the same random numbers."""

_SEQUENCES, _SEQUENCE_LENGTHS = 8, (1024, 4096)
"""Randomised Sobol' sequences that integrate the classifier, and their lengths, the second if the first is short."""

_ACCURACY = 0.03
"""Relative standard error of the classifier's probability above which sequences are too short."""

_RARE, _LEAST = 0.01, 0.001
"""Probability below which an outcome is rare, and least one for strata. With the full prior, the simulations by volume
would make the interval of a rare outcome too wide. So the failures that the prior expects where the classifier is
surest fall in proportion to the probability."""

_IMAGINED = 16
"""Imagined sets of outcomes that predict the width of an interval."""


@dataclass(frozen=True, eq=False)
class StratifiedPlan:
    """Fresh designs that correct a classifier's probability stratum by stratum.

    Attributes:
        designs: (m, k).
        stratum: (m,) of each design.
        standardised: (m,) the latent's mean/sd.
        volume: (s,) of the strata, as shares of the distribution; their sum is 1. The classifier puts the second half
            of them beyond the boundary.
        doubt: (s,) share of wrong predictions that the classifier expects in each stratum.
        standard_error: of the classifier's probability, from its integration.
        fallibility: factor on the first parameter of the prior, 1 unless the outcome is rare.
    """

    designs: Array
    stratum: NDArray[np.int_]
    standardised: Array
    volume: Array
    doubt: Array
    standard_error: float
    fallibility: float = 1.0

    @property
    def is_beyond(self) -> NDArray[np.bool_]:
        """Whether the classifier puts each stratum beyond the boundary, (s,)."""
        return np.asarray(np.arange(len(self.volume)) >= len(self.volume) // 2)

    @property
    def predicted(self) -> NDArray[np.bool_]:
        """Whether the classifier puts each design beyond the boundary, (m,)."""
        return self.standardised > 0.0

    @property
    def probability(self) -> float:
        """The share of the distribution for which the classifier predicts the outcome."""
        return float(self.volume[self.is_beyond].sum())

    @property
    def counts(self) -> NDArray[np.int_]:
        """Simulations of each stratum, (s,)."""
        return np.asarray(np.bincount(self.stratum, minlength=len(self.volume)))

    @property
    def ratio(self) -> Array:
        """Density of the distribution over that of the draws, (m,)."""
        return np.asarray(len(self.stratum) * (self.volume / np.maximum(self.counts, 1))[self.stratum])

    @property
    def surest(self) -> tuple[int, float]:
        """Simulations where the classifier is surest that the outcome does not occur, and the volume of this part."""
        return int(self.counts[0]), float(self.volume[0])

    def estimate(
        self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float
    ) -> ProbabilityEstimate:
        """The estimate from the outcomes of the simulations (see `estimate.Plan.estimate`)."""
        tails = 0.5 - 0.5 * confidence
        low = float(np.quantile(self._posterior(beyond & answered, _RIGHT_BELOW), tails))
        high = float(np.quantile(self._posterior(beyond | ~answered), 1.0 - tails))
        interval = sum(self._counted(np.where(answered, beyond, self.predicted))), low, high
        outcomes, recall = (self.standardised, beyond, answered), self._recall(beyond, answered, confidence)
        return estimated(interval, recall, outcomes, confidence, "strata of the classifier's doubt")

    def expected_half_width(self, confidence: float, rng: np.random.Generator) -> float:
        """Expected distance from the estimate to its upper bound, if the classifier's own probabilities are right."""
        likely = ndtr(self.standardised)
        widths = []
        for _ in range(_IMAGINED):
            beyond = rng.random(len(likely)) < likely
            high = np.quantile(self._posterior(beyond), 0.5 + 0.5 * confidence)
            widths.append(float(high) - sum(self._counted(beyond)))
        return float(np.mean(widths))

    def _wrong(self, beyond: NDArray[np.bool_]) -> Array:
        """Wrong predictions of each stratum, (s,)."""
        wrong = (beyond != self.predicted).astype(np.float64)
        return np.asarray(np.bincount(self.stratum, weights=wrong, minlength=len(self.volume)))

    def _shares(self, beyond: NDArray[np.bool_], right: float = np.inf) -> Array:
        """Draws of the strata's shares of wrong predictions, (draws, s).

        Args:
            beyond: (m,) whether each outcome is beyond the boundary.
            right: greatest second parameter of the prior of the strata beyond the boundary.
        """
        wrong, n, (a, b) = self._wrong(beyond), self.counts, _PRIOR
        second = np.minimum(b - self.doubt, np.where(self.is_beyond, right, np.inf))
        rng = np.random.default_rng(0)
        return np.asarray(rng.beta(a * self.fallibility + self.doubt + wrong, second + n - wrong, (_DRAWS, len(n))))

    def _parts(self, shares: Array) -> tuple[Array, Array]:
        """Probability of what the classifier puts beyond the boundary rightly, and of what it misses."""
        side = self.is_beyond
        hit = ((1.0 - shares) * self.volume)[..., side].sum(axis=-1)
        return hit, (shares * self.volume)[..., ~side].sum(axis=-1)

    def _counted(self, beyond: NDArray[np.bool_]) -> tuple[float, float]:
        """The parts of the probability (see `_parts`), by the shares of wrong predictions that were counted."""
        n = self.counts
        hit, missed = self._parts(np.divide(self._wrong(beyond), n, out=self.doubt.copy(), where=n > 0))
        return float(hit), float(missed)

    def _posterior(self, beyond: NDArray[np.bool_], right: float = np.inf) -> Array:
        """Draws of the probability, (draws,); the arguments are those of `_shares`."""
        hit, missed = self._parts(self._shares(beyond, right))
        of_integration = self.standard_error * np.random.default_rng(1).standard_normal(len(hit))
        return np.asarray(hit + missed + of_integration)

    def _recall(self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float) -> tuple[float, float]:
        """The share of the probability that the classifier puts beyond the boundary, and its lower bound.

        Two bounds enter the lower one, each of which errs half as often as it may: of the probability that is rightly
        counted, and of the one that is missed. Numerical failures are missed, or wrongly counted.
        """
        hit, missed = self._counted(np.where(answered, beyond, self.predicted))
        if hit + missed <= 0.0:
            return float("nan"), 0.0
        of_hits, of_missed = self._parts(self._shares(np.where(answered, beyond, ~self.predicted)))
        error = 0.5 * (1.0 - confidence)
        hit_low, missed_high = float(np.quantile(of_hits, error)), float(np.quantile(of_missed, 1.0 - error)) + REACH
        return hit / (hit + missed), hit_low / (hit_low + missed_high)


def plan_strata(
    standardised: Standardised, space: DesignSpace | WeightedRows, m: int, rng: np.random.Generator
) -> StratifiedPlan | None:
    """Plan m fresh simulations in strata of the classifier's doubt; None if the outcome is rare (`plan_wide_strata`).

    Randomised Sobol' sequences integrate the classifier and hold the designs to simulate; they are drawn without
    replacement. Weighted rows are the distribution itself, and are drawn with replacement by their weights.
    """
    if isinstance(space, WeightedRows):
        z = standardised(space.X)
        if float((space.weight * (z > 0.0)).mean()) < _RARE:
            return None
        return _planned(space.X, space.weight, z, m, rng, 0.0, with_replacement=True)
    for length in _SEQUENCE_LENGTHS:
        X = np.concatenate([space.sobol(length, rng) for _ in range(_SEQUENCES)])
        z = standardised(X)
        means = (z > 0.0).reshape(_SEQUENCES, length).mean(axis=1)
        probability, error = float(means.mean()), float(means.std(ddof=1) / np.sqrt(_SEQUENCES))
        if probability >= _RARE and error <= _ACCURACY * probability:
            return _planned(X, np.ones(len(X)), z, m, rng, error, with_replacement=False)
    return None


def plan_wide_strata(
    standardised: Standardised,
    space: DesignSpace | WeightedRows,
    of_classifier: OfBoundary,
    m: int,
    rng: np.random.Generator,
) -> StratifiedPlan | None:
    """Plan m fresh simulations of a rare outcome in strata of the classifier's doubt; None if it is too rare.

    The designs come from a wider sample of the distribution, and are drawn by their weights.

    Args:
        standardised: mean/sd of the latent.
        space: the distribution.
        of_classifier: its share of predictions.
        m: number of simulations.
        rng: draws them.
    """
    if of_classifier.probability < _LEAST:
        return None
    drawn = population(space, RADIAL, None, rng)
    z, error = standardised(drawn.X), of_classifier.error
    if not isinstance(space, WeightedRows):
        # The simulations are drawn from a population, which itself is a sample.
        error = float(np.sqrt(error**2 + np.sum(drawn.weight**2 * ndtr(-np.abs(z))) / len(z) ** 2))
    plan = _planned(drawn.X, drawn.weight, z, m, rng, error, True, min(1.0, of_classifier.probability / _RARE))
    if not 0.0 < plan.probability < 1.0:
        return None
    # The population says how each side is divided, the integral how large it is.
    beyond = of_classifier.probability / plan.probability
    short = (1.0 - of_classifier.probability) / (1.0 - plan.probability)
    return replace(plan, volume=plan.volume * np.where(plan.is_beyond, beyond, short))


def _planned(
    X: Array,
    weight: Array,
    z: Array,
    m: int,
    rng: np.random.Generator,
    error: float,
    with_replacement: bool,
    fallibility: float = 1.0,
) -> StratifiedPlan:
    """The plan with m designs of a weighted sample.

    Args:
        X: (n, k) the sample.
        weight: (n,) with mean 1.
        z: (n,) the latent's mean/sd.
        m: number of simulations; without replacement at most n.
        rng: draws them.
        error: standard error of the classifier's probability.
        with_replacement: whether a row may be drawn again.
        fallibility: of the prior.
    """
    wrong = ndtr(-np.abs(z))
    sides = 1 + len(_EDGES)
    stratum = np.searchsorted((fallibility * _EDGES[0], *_EDGES[1:]), wrong, side="right")
    stratum = stratum + sides * (z > 0.0)
    volume = np.bincount(stratum, weights=weight, minlength=2 * sides) / weight.sum()
    in_doubt = np.bincount(stratum, weights=weight * wrong, minlength=2 * sides) / weight.sum()
    doubt = np.divide(in_doubt, volume, out=np.zeros(2 * sides), where=volume > 0.0)
    neyman = volume * np.sqrt(np.maximum(doubt, _LEAST_DOUBT * fallibility**2) * (1.0 - doubt))
    rows_of = [np.flatnonzero((stratum == k) & (weight > 0.0)) for k in range(2 * sides)]
    most = np.array([m if with_replacement and len(rows) else len(rows) for rows in rows_of])
    counts = rounded(m * ((1.0 - _BY_VOLUME) * neyman / neyman.sum() + _BY_VOLUME * volume), most)
    drawn = []
    for rows, count in zip(rows_of, counts, strict=True):
        if count:
            drawn.append(rng.choice(rows, count, replace=with_replacement, p=weight[rows] / weight[rows].sum()))
    chosen = np.concatenate(drawn)
    return StratifiedPlan(
        designs=X[chosen],
        stratum=stratum[chosen],
        standardised=z[chosen],
        volume=volume,
        doubt=doubt,
        standard_error=error,
        fallibility=fallibility,
    )


def rounded(shares: Array, most: NDArray[np.int_]) -> NDArray[np.int_]:
    """Whole numbers near the shares, (s,), with the same sum, none above its greatest number, (s,)."""
    total = round(float(shares.sum()))
    counts = np.minimum(np.floor(shares).astype(np.int_), most)
    while counts.sum() < total:
        counts[np.argmax(np.where(counts < most, shares - counts, -np.inf))] += 1
    return counts
