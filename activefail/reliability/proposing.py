"""Designs whose margin would teach most about a failure probability (stepwise uncertainty reduction)."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.reliability.population import Population
from activefail.space import Array
from activefail.surrogate.margin import MarginLatent

REFERENCES, CANDIDATES = 300, 50

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()

_LEAST = 1e-300


def doubt(standardised: Array) -> Array:
    """√(p(1 − p)) of p = Φ(z): the standard deviation of the side of the boundary, (n,)."""
    return np.asarray(np.sqrt(ndtr(standardised) * ndtr(-standardised)))


def expected_doubt(mean: Array, sd: Array, variance: Array, covariance: Array) -> Array:
    """Expected √(p(1−p)) at R references after the margin of each of n candidates becomes known, (n, R).

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


def propose_by_margin(
    latent: MarginLatent, F: Array, standardised: Array, weight: Array, q: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Rows of q designs of a population whose margins reduce the doubt about the failure probability most.

    The doubt is Σ w √(p(1 − p)), which bounds the standard deviation of the probability [BectEtAl2012]. References and
    candidates are drawn from the population in proportion to their part of it. After each choice, the margin is taken
    to be its mean (kriging believer).

    Args:
        latent: of the boundary.
        F: (n, m) features of the population.
        standardised: (n,) the latent's mean/sd there.
        weight: (n,) of the population.
        q: number of designs.
        rng: generator of the draws.
    """
    part = weight * doubt(standardised) + _LEAST
    part = part / part.sum()
    references = rng.choice(len(F), REFERENCES, p=part)
    candidates = np.unique(rng.choice(len(F), CANDIDATES + 4 * q, p=part))
    mean, covariance = latent.joint(np.concatenate([F[candidates], F[references]]))
    covariance = covariance.copy()
    n, chosen = len(candidates), list[int]()
    first = doubt(mean[n:] / np.sqrt(covariance.diagonal()[n:]))
    for _ in range(q):
        variance = np.maximum(covariance.diagonal(), 1e-12)
        after = expected_doubt(mean[n:], np.sqrt(variance[n:]), variance[:n], covariance[:n, n:])
        value = (after / np.maximum(first, _LEAST)).mean(axis=1)
        value[chosen] = math.inf
        best = int(np.argmin(value))
        chosen.append(best)
        column = covariance[:, best].copy()
        covariance -= np.outer(column, column) / variance[best]
    return candidates[chosen]


def probability(moments_side: Array, population: Population) -> float:
    """The failure probability under a latent."""
    return float(np.mean(population.weight * moments_side))


def posterior_sd(latent: MarginLatent, F: Array, standardised: Array, weight: Array, rng: np.random.Generator) -> float:
    """Standard deviation of the failure probability under the latent's posterior.

    From 200 joint paths at 300 points that are drawn in proportion to weight times doubt.
    """
    uncertain = doubt(standardised)
    part = weight * uncertain + _LEAST
    total = float(part.mean())
    rows = rng.choice(len(F), REFERENCES, p=part / part.sum())
    mean, covariance = latent.joint(F[rows])
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    paths = mean + rng.standard_normal((200, len(rows))) @ root.T
    p = ndtr(standardised[rows])
    deviations = ((paths > 0.0) - p) / np.maximum(uncertain[rows], _LEAST)
    return total * float(deviations.mean(axis=1).std())


def hidden_places(known: Array, outside: float, count: int, rng: np.random.Generator) -> Array:
    """Points of standard normal space, (count, d), far from the known ones (n, d) and from each other.

    They lie in the ball outside which the probability is `outside` (maximin; [JohnsonEtAl1990]).
    """
    from scipy.spatial.distance import cdist

    from activefail.space import radius

    d = known.shape[1]
    neighbours, places = known, []
    R = radius(outside, d)
    for _ in range(count):
        Z = rng.standard_normal((2048, d))
        Z *= (R * rng.random(len(Z)) ** (1.0 / d) / np.linalg.norm(Z, axis=1))[:, None]
        best = int(np.argmax(cdist(Z, neighbours).min(axis=1)))
        places.append(Z[best])
        neighbours = np.concatenate([neighbours, Z[best : best + 1]])
    return np.stack(places)
