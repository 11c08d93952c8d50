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

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()

LEAST = 1e-300
"""Lower bound for divisors."""


def doubt(standardised: Array) -> Array:
    """√(p(1 − p)) of p = Φ(z): the standard deviation of the side of the boundary, (n,)."""
    return np.asarray(np.sqrt(ndtr(standardised) * ndtr(-standardised)))


def expected_doubt(mean: Array, sd: Array, variance: Array, covariance: Array) -> Array:
    """Expected √(p(1 − p)) at R references after the margin of each of n candidates becomes known, (n, R).

    A candidate's margin moves a reference's mean by covariance/√variance times a standard normal number, and reduces
    its variance. Five nodes of Gauss–Hermite quadrature give the expectation.

    Args:
        mean, sd: (R,) of the latent at references.
        variance: (n,) of the latent at candidates.
        covariance: (n, R) between both.
    """
    shift = covariance / np.sqrt(variance)[:, None]
    left = np.sqrt(np.maximum(sd**2 - shift**2, 1e-12 * sd**2))
    total = np.zeros_like(shift)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        total += weight * doubt((mean + node * shift) / left)
    return total


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
