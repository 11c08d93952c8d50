"""Confidence bounds by beta distributions: on a share from strata, and on the probability of an unseen event."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.space.space import Array

BOUND_CONFIDENCE = 0.9
"""One-sided confidence of the bounds without a classifier."""


@dataclass(frozen=True)
class StratifiedCount:
    """Designs sampled in parts of a design space, and how many of them were hits (for example, misclassified).

    The share of hits is θ = Σ V_k p_k. `studies/verification.py` measures the coverage of its bounds, above all
    for few hits or none. Each bound is a quantile of the beta distribution with the mean and the variance of
    Σ V_k B_k, where B_k follows a beta distribution:

    - lower bound: B_k ~ Beta(x_k, n_k − x_k + 1), as in the bound of [ClopperPearson1934] for each part;
    - upper bound: B_j ~ Beta(x_j + 1, n_j − x_j), Clopper and Pearson's, for one part j, and Jeffreys' Beta(x_k + ½,
      n_k − x_k + ½) for the others; j is the part with the largest quantile. [FayFeuer1997] likewise assumes one
      further hit in one part. A part with only hits takes Clopper and Pearson's too, and so do all parts for a
      confidence above 0.95, where Jeffreys' coverage is too low.

    With a single part both are Clopper and Pearson's exact bounds. The lower bound can fall slightly when a part gets
    its first hit, because the beta distribution then covers the volume of one more part.

    Attributes:
        volumes: V, (k,) of the parts, as shares of the space.
        counted: n, (k,) designs sampled in each part.
        hits: x, (k,) hits among them.
        pool: number of random designs that estimated the volumes, for their uncertainty; 0 if the volumes are exact.
    """

    volumes: Array
    counted: Array
    hits: Array
    pool: int = 0

    @property
    def unseen_volume(self) -> float:
        """Volume of the parts without a sampled design."""
        return float(self.volumes[self.counted == 0].sum())

    def estimate(self, expected: Array) -> float:
        """Σ V_k x_k/n_k; a part without a sampled design takes its expected share, (k,)."""
        shares = np.divide(self.hits, self.counted, out=expected.astype(np.float64), where=self.counted > 0)
        return float(self.volumes @ shares)

    def lower(self, confidence: float) -> float:
        """One-sided lower confidence bound on the share."""
        hit = self.hits > 0
        if not hit.any():
            return 0.0
        x, n, V = self.hits[hit], self.counted[hit], self.volumes[hit]
        mean, variance = _beta_moments(x, n - x + 1.0)
        m, v = float(V @ mean), float(V**2 @ variance) + self._of_volumes(V, mean)
        # The bound covers only the parts with hits and cannot exceed their volume.
        return _quantile(m, v, float(V.sum()), 1.0 - confidence)

    def upper(self, confidence: float) -> float:
        """One-sided upper confidence bound on the share."""
        sampled = self.counted > 0
        x, n, V = self.hits[sampled], self.counted[sampled], self.volumes[sampled]
        mean_further, variance_further = _beta_moments(x + 1.0, n - x)
        mean, variance = _beta_moments(x + 0.5, n - x + 0.5)
        further = (x == n) | (confidence > 0.95)
        mean, variance = np.where(further, mean_further, mean), np.where(further, variance_further, variance)
        bounds = []
        for j in range(len(V)):
            m = float(V @ mean + V[j] * (mean_further[j] - mean[j]))
            v = float(V**2 @ variance + V[j] ** 2 * (variance_further[j] - variance[j])) + self._of_volumes(V, mean)
            bounds.append(_quantile(m, v, float(V.sum()), confidence))
        return min(1.0, self.unseen_volume + max(bounds, default=0.0))

    def _of_volumes(self, volumes: Array, shares: Array) -> float:
        """The variance due to volumes estimated from a pool, a multinomial sample."""
        return float(volumes @ shares**2 - (volumes @ shares) ** 2) / self.pool if self.pool else 0.0


def _beta_moments(a: Array, b: Array) -> tuple[Array, Array]:
    """Mean and variance of Beta(a, b), (k,) each; b = 0 is the point 1."""
    total = a + b
    return a / total, a * b / (total**2 * (total + 1.0))


def _quantile(mean: float, variance: float, scale: float, q: float) -> float:
    """The quantile of `scale` times a beta variable, whose product has this mean and variance."""
    mean, variance = mean / scale, variance / scale**2
    if variance <= 0.0 or mean >= 1.0:
        return scale * mean
    # Imported here to keep `activefail status` fast.
    from scipy.stats import beta

    total = mean * (1.0 - mean) / variance - 1.0
    return scale * float(beta.ppf(q, mean * total, (1.0 - mean) * total))


def upper_bound(hits: int, draws: int, confidence: float) -> float:
    """One-sided upper bound on a probability from independent draws [ClopperPearson1934]; 1 if none is no hit."""
    if hits >= draws:
        return 1.0
    if hits == 0:
        return float(-np.expm1(np.log1p(-confidence) / draws))
    from scipy.stats import beta

    return float(beta.ppf(confidence, hits + 1, draws - hits))


def unseen_outcomes(outcomes: Sequence[str], counts: NDArray[np.int64]) -> tuple[str, ...]:
    """The outcomes without a simulation, in order of severity.

    Args:
        outcomes: names of all outcomes.
        counts: (number of outcomes,) simulations by outcome; further entries are ignored.
    """
    return tuple(name for name, count in zip(outcomes, counts, strict=False) if not count)
