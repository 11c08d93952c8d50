"""Weighted samples of the design measure that reach rare failure.

A plain sample of the design measure holds no design of a failure with probability 10⁻⁶. A population is drawn from a
wider distribution in standard normal space, and each design has a weight, the ratio of both densities, so that weighted
means are means over the design measure [OwenZhou2000, deterministic mixture].
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from activefail.errors import InputError
from activefail.learning.features import FeatureMap
from activefail.space.space import REACH, Array, DesignSpace, radius
from activefail.space.weighted import WeightedRows

_PER_PARENT, _PARENTS = 400, 100
"""Designs of a population for each parent of its local part, and most parents."""

_AT_ONCE = 4096
"""Most rows of a density at once, which limits its memory."""

_CORRELATIONS = (0.9, 0.7)
"""Correlation of a local point with its parent, of each half of the local part."""

_EFFORT, _ROUND = 64, 2**17
"""Most points that are tried for each feasible design that is wanted, and most that are tried at once."""


class Population(NamedTuple):
    """A weighted sample of the design measure, of feasible designs alone: weighted means are means over the measure.

    Attributes:
        Z: (n, d) points of standard normal space; NaN for weighted rows, which have none.
        X: (n, d) the same points as designs.
        weight: (n,) density of the design measure over that of the sample.
        wide: (n,) density of the radial distribution over that of the sample; `weight` for weighted rows.
    """

    Z: Array
    X: Array
    weight: Array
    wide: Array


Importance = Callable[[Array], Array]
"""Designs, (n, d) -> how much each one matters, (n,), at least 0."""


def _directions(n: int, d: int, rng: np.random.Generator) -> Array:
    Z = rng.standard_normal((n, d))
    return np.asarray(Z / np.linalg.norm(Z, axis=1, keepdims=True))


def _radial(n: int, d: int, rng: np.random.Generator) -> Array:
    """Points in all directions: half with the distance of the normal distribution, half with a uniform one."""
    from scipy.stats import chi

    half = n // 2
    distances = np.concatenate([chi.rvs(d, size=half, random_state=rng), radius(REACH, d) * rng.random(n - half)])
    return np.asarray(_directions(n, d, rng) * distances[:, None])


def _radial_ratio(Z: Array) -> Array:
    """Density of `_radial` over the normal density, (n,)."""
    from scipy.stats import chi

    d, farthest = Z.shape[1], radius(REACH, Z.shape[1])
    distance = np.linalg.norm(Z, axis=1)
    with np.errstate(divide="ignore", over="ignore"):
        uniform = np.where(distance <= farthest, np.exp(-chi.logpdf(distance, d)) / farthest, 0.0)
    return np.asarray(0.5 + 0.5 * uniform)


def _local(parents: Array, n: int, rng: np.random.Generator) -> Array:
    """Points correlated with the parents, in equal numbers around each."""
    d, moved = parents.shape[1], []
    for part, correlation in enumerate(_CORRELATIONS):
        count = n * (part + 1) // len(_CORRELATIONS) - n * part // len(_CORRELATIONS)
        around = parents[np.arange(count) % len(parents)]
        moved.append(correlation * around + math.sqrt(1.0 - correlation**2) * rng.standard_normal((count, d)))
    return np.concatenate(moved)


def _local_ratio(Z: Array, parents: Array) -> Array:
    """Density of `_local` over the normal density, (n,)."""
    d, ratio = Z.shape[1], np.empty(len(Z))
    for first in range(0, len(Z), _AT_ONCE):
        part = Z[first : first + _AT_ONCE]
        products, squares = part @ parents.T, (part**2).sum(axis=1)
        total = np.zeros(len(part))
        for correlation in _CORRELATIONS:
            variance = 1.0 - correlation**2
            # |z|²/2 − |z − ρa|²/(2(1 − ρ²)) − log of the determinant's root
            exponent = products * (correlation / variance)
            exponent -= (0.5 * correlation**2 / variance) * (squares[:, None] + (parents**2).sum(axis=1))
            exponent -= 0.5 * d * math.log(variance)
            np.minimum(exponent, 700.0, out=exponent)
            total += np.exp(exponent, out=exponent).mean(axis=1)
        ratio[first : first + len(part)] = total / len(_CORRELATIONS)
    return ratio


def integration_points(space: DesignSpace | WeightedRows, n: int) -> tuple[Array, Array]:
    """Fixed points that integrate a probability that is not rare, (n, d), with weights whose mean is 1, (n,).

    A scrambled Sobol' sequence; all rows of weighted rows.

    Args:
        space: the design space, or weighted rows.
        n: number of points; a power of two.
    """
    if isinstance(space, WeightedRows):
        return space.X, space.weight
    return space.sobol(n, np.random.default_rng(0)), np.ones(n)


def finite(features: FeatureMap, X: Array) -> Array:
    """Scaled features of designs of a population, (n, d) -> (n, m).

    Raises:
        InputError: naming the feature and the design, if a feature is not finite there. A population reaches farther
            out than the sample that checks features when a campaign begins.
    """
    with np.errstate(all="ignore"):
        F = features(X)
    bad = ~np.isfinite(F)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"classifier.features: {features.names[column]} must be finite wherever designs may lie, got "
            f"{F[row, column]} for {features.space.row(X[row])}. Exclude such designs with bounds or a larger "
            "sampling.reach."
        )
    return F


def population(
    space: DesignSpace | WeightedRows, n: int, importance: Importance | None, rng: np.random.Generator
) -> Population:
    """A population of n designs, all feasible; of weighted rows all, whatever n.

    Half of it is radial: it fills the ball outside which the probability is `REACH`, in all directions. The other half
    is local, around parents that are drawn from another radial sample in proportion to weight times importance. Parents
    from the same sample would bias the weighted means.

    Args:
        space: the design space, or weighted rows.
        n: number of designs. Under constraints there are a few more, or fewer if `_EFFORT` times as many points have
            too few feasible ones among them.
        importance: of designs; without it, the population is radial.
        rng: generator of the sample.

    Raises:
        InputError: if hardly any design is feasible.
    """
    if isinstance(space, WeightedRows):
        return Population(np.full_like(space.X, np.nan), space.X, space.weight, space.weight)
    count = min(_PARENTS, max(1, n // _PER_PARENT))
    parents = None if importance is None else first_parents(space, n, count, importance, rng)
    return around(space, n, parents, rng)


def first_parents(
    space: DesignSpace, n: int, count: int, importance: Importance, rng: np.random.Generator
) -> Array | None:
    """So many parents of a population of n designs, (count, d), from a radial sample; None if no design matters."""
    drawn = around(space, n // 2, None, rng)
    return next_parents(drawn, count, importance(drawn.X), rng)


def next_parents(drawn: Population, count: int, importance: Array, rng: np.random.Generator) -> Array | None:
    """Parents of another population, (count, d), from this one, whose designs matter so much, (n,)."""
    values = drawn.weight * importance
    if not values.sum() > 0.0:
        return None
    return np.asarray(drawn.Z[rng.choice(len(values), count, p=values / values.sum())])


def around(space: DesignSpace, n: int, parents: Array | None, rng: np.random.Generator) -> Population:
    """A population of n designs around parents, (k, d), that are independent of it; radial without parents."""

    def tried(count: int) -> tuple[Array, Array, Array]:
        """Points, and the densities of the normal and the radial distribution over theirs."""
        if parents is None:
            Z = _radial(count, space.dimension, rng)
            return Z, 1.0 / _radial_ratio(Z), np.ones(count)
        Z = np.concatenate([_radial(count // 2, space.dimension, rng), _local(parents, count - count // 2, rng)])
        share, wide = (count // 2) / count, _radial_ratio(Z)
        ratio = share * wide + (1.0 - share) * _local_ratio(Z, parents)
        return Z, 1.0 / ratio, wide / ratio

    if not space.constraints:
        Z, weight, wide = tried(n)
        return Population(Z, space.from_normal(Z), weight, wide)
    return _feasible(space, n, tried)


def _feasible(space: DesignSpace, n: int, tried: Callable[[int], tuple[Array, Array, Array]]) -> Population:
    """About n feasible designs of the points that are tried, which have weights conditional on the constraints.

    Raises:
        InputError: if hardly any design is feasible.
    """
    space.check_feasible()
    found, trials, count = list[Population](), 0, 0
    while count < n and trials < _EFFORT * n:
        # In equal rounds, whose points have one density.
        size = min(_ROUND, max(n, math.ceil(n / space.feasible_share)))
        Z, weight, wide = tried(size)
        X = space.from_normal(Z)
        kept = space.meets_constraints(X)
        found.append(Population(Z[kept], X[kept], weight[kept], wide[kept]))
        trials, count = trials + size, count + int(kept.sum())
    Z, X, weight, wide = (np.concatenate(of) for of in zip(*found, strict=True))
    # A mean over the points that were tried, of what an infeasible one has no part in.
    return Population(Z, X, weight * (count / trials / space.feasible_share), wide)
