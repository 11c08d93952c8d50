"""Designs whose margins would teach most about a boundary (stepwise uncertainty reduction).

Where a boundary is learned from a margin, a simulation yields a number, not a label. The chosen design is the one whose
number would, on average, leave the least doubt Σ w √(p(1 − p)) over the design measure, which bounds the standard
deviation of the probability beyond the boundary [BectEtAl2012].
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.acquisition.population import Population, finite, population
from activefail.features import FeatureMap
from activefail.space import Array, DesignSpace
from activefail.surrogate.margin import MarginLatent

REFERENCES = 300
"""Designs of the population that represent it in the criterion."""

_CANDIDATES = 50
"""Designs of the population from which the first of a batch is chosen; each further one adds `_MORE`."""

_MORE = 4

SIZE = 12_000
"""Designs of a population."""

_HEIGHTS = (0.236799, 0.109751, 0.085693, 0.067768)
_PRECISIONS = (0.503909, 0.567564, 0.733511, 1.091334)
"""Of Gaussian functions whose sum Σ h exp(−q z²/2) is √(p(1 − p)) of p = Φ(z): the largest relative error over |z| ≤ 8
is 3·10⁻⁵. They minimise it, as a fit of four terms found."""

LEAST = 1e-300
"""Lower bound for divisors."""


def doubt(standardised: Array) -> Array:
    """√(p(1 − p)) of p = Φ(z): the standard deviation of the side of the boundary, (n,)."""
    return np.asarray(np.sqrt(ndtr(standardised) * ndtr(-standardised)))


def expected_doubt(mean: Array, sd: Array, variance: Array, covariance: Array) -> Array:
    """Expected √(p(1 − p)) at R references after the margin of each of n candidates becomes known, (n, R).

    A candidate's margin, with the correlation ρ to a reference, moves the reference's mean by ρ sd times a standard
    normal number, and reduces its variance to (1 − ρ²) sd². The doubt is a sum of Gaussian functions, so its
    expectation is Σ h √((1 − ρ²)/D) exp(−q mean²/(2 D sd²)) with D = 1 + (q − 1) ρ². Its relative error is at most that
    of the sum, whatever the correlation.

    Args:
        mean, sd: (R,) of the latent at references.
        variance: (n,) of the latent at candidates.
        covariance: (n, R) between both.
    """
    explained = np.minimum(covariance**2 / (variance[:, None] * sd**2), 1.0 - 1e-12)
    half, total = 0.5 * (mean / sd) ** 2, np.zeros_like(explained)
    for height, precision in zip(_HEIGHTS, _PRECISIONS, strict=True):
        D = 1.0 + (precision - 1.0) * explained
        total += height * np.exp(-precision * half / D) / np.sqrt(D)
    return np.asarray(total * np.sqrt(1.0 - explained))


def doubtful_population(
    latent: MarginLatent, features: FeatureMap, space: DesignSpace, n: int, rng: np.random.Generator
) -> tuple[Population, Array, Array]:
    """A population with many designs where the latent is in doubt, its features, (n, m), and mean/sd there, (n,)."""
    drawn = population(space, n, lambda X: doubt(latent.moments(finite(features, X)).standardised), rng)
    F = finite(features, drawn.X)
    return drawn, F, latent.moments(F).standardised


def propose_by_margin(
    latent: MarginLatent,
    features: FeatureMap,
    space: DesignSpace,
    q: int,
    rng: np.random.Generator,
    *,
    pending: Array | None = None,
    failed: Array | None = None,
    answers: Callable[[Array], Array] | None = None,
) -> Array:
    """q designs, (q, d), whose margins reduce the doubt about the boundary most.

    References and candidates are drawn from a population in proportion to their parts of the doubt. After each choice,
    the margin is taken to be its mean (kriging believer).

    Args:
        latent: of the boundary.
        features: map from designs to the latent's inputs.
        space: the design space.
        q: number of designs.
        rng: generator of the draws.
        pending: (k, d) designs in flight; their margins are taken as known.
        failed: (k, d) designs whose simulation was a numerical failure; nothing is to be learned near them.
        answers: probability of a result at scaled features; all are certain if None.
    """
    for known in (pending, failed):
        if known is not None and len(known):
            latent = latent.with_pending(features(known))
    drawn, F, standardised = doubtful_population(latent, features, space, SIZE, rng)
    parts, certain = drawn.weight * doubt(standardised), None if answers is None else answers(F)
    return np.asarray(drawn.X[_best_rows(latent, F, parts, q, rng, certain)])


def _best_rows(
    latent: MarginLatent, F: Array, parts: Array, q: int, rng: np.random.Generator, answers: Array | None
) -> NDArray[np.intp]:
    """Rows of q designs of a population with features F, (n, m), parts of the doubt, (n,), and chances of a result."""
    share = (parts + LEAST) / (parts + LEAST).sum()
    references = rng.choice(len(F), REFERENCES, p=share)
    candidates = np.unique(rng.choice(len(F), _CANDIDATES + _MORE * q, p=share))
    if len(candidates) < q:
        others = np.setdiff1d(np.arange(len(F)), candidates)
        candidates = np.concatenate([candidates, rng.choice(others, q - len(candidates), replace=False)])
    mean, covariance = latent.joint(np.concatenate([F[candidates], F[references]]))
    covariance = covariance.copy()
    n, chosen = len(candidates), list[int]()
    # The references were drawn in proportion to the doubt before the batch.
    before = np.maximum(doubt(mean[n:] / np.sqrt(np.maximum(covariance.diagonal()[n:], LEAST))), LEAST)
    for _ in range(q):
        variance = np.maximum(covariance.diagonal(), 1e-12)
        after = expected_doubt(mean[n:], np.sqrt(variance[n:]), variance[:n], covariance[:n, n:])
        left = (after / before).mean(axis=1)
        if answers is not None:
            left = (left - 1.0) * answers[candidates]
        left[chosen] = math.inf
        best = int(np.argmin(left))
        chosen.append(best)
        column = covariance[:, best].copy()
        covariance -= np.outer(column, column) / variance[best]
    return np.asarray(candidates[chosen])
