"""The most probable failure under a classifier, and the reliability index of the first-order reliability method."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.estimates.integral import Standardised
from activefail.learning.criteria.by_margin import doubt
from activefail.learning.criteria.population import population
from activefail.space.space import Array, DesignSpace

_SIZE = 20_000
"""Designs of the population in which the search begins."""

_STARTS = 5
"""Designs from which the search begins."""

_STEP = 1e-4
"""Step of numerical gradients in standard normal space."""

_ON_BOUNDARY = 0.05
"""Largest distance of a point from the boundary on the middle's side, in the latent's mean/sd."""


@dataclass(frozen=True)
class DesignPoint:
    """The point of the boundary nearest to the middle of standard normal space [HasoferLind1974].

    Attributes:
        Z: (d,) the point in standard normal space.
        X: (d,) the same point as a design.
        beta: Hasofer and Lind's reliability index: its distance from the middle; negative if the middle fails.
    """

    Z: Array
    X: Array
    beta: float

    @property
    def probability(self) -> float:
        """Φ(−β): the probability beyond a plane boundary through the point."""
        return float(ndtr(-self.beta))

    @property
    def importance(self) -> Array:
        """Squared direction cosines of the point, (d,), which sum to 1: how much each variable moves the outcome."""
        total = float(self.Z @ self.Z)
        return self.Z**2 / total if total > 0.0 else np.zeros_like(self.Z)


def design_point(standardised: Standardised, space: DesignSpace, rng: np.random.Generator) -> DesignPoint | None:
    """The design point under a classifier; None if it puts no design beyond the boundary, or all.

    The search begins at the nearest designs of a population on the other side than the middle, so that of several
    modes the nearest is found. Constrained minimisation by SLSQP refines each; the numerical gradients are of the
    latent alone.

    Args:
        standardised: the latent's mean/sd as a function of designs.
        space: the design space.
        rng: generator of the population.
    """
    middle_fails = bool(standardised(space.from_normal(np.zeros((1, space.dimension))))[0] > 0.0)

    def other_side(Z: Array) -> Array:
        """Positive on the other side of the boundary than the middle, (n,)."""
        side = standardised(space.from_normal(Z))
        return -side if middle_fails else side

    drawn = population(space, _SIZE, lambda X: _doubtful(standardised(X)), rng)
    beyond = drawn.Z[other_side(drawn.Z) > 0.0]
    if not len(beyond):
        return None
    starts = _spread_out(beyond[np.argsort((beyond**2).sum(axis=1), kind="stable")])
    nearest = min((_refined(other_side, start) for start in starts), key=lambda Z: float(Z @ Z))
    beta = float(np.linalg.norm(nearest))
    return DesignPoint(nearest, space.from_normal(nearest[None])[0], -beta if middle_fails else beta)


def _doubtful(z: Array) -> Array:
    return np.asarray(ndtr(z) + doubt(z))


def _spread_out(nearest: Array) -> Array:
    """A few of the points, (n, d) nearest first, in different directions, (k, d)."""
    chosen: list[Array] = []
    for Z in nearest:
        cosines = [float(Z @ other / np.sqrt((Z @ Z) * (other @ other))) for other in chosen]
        if all(cosine < 0.8 for cosine in cosines):
            chosen.append(Z)
        if len(chosen) == _STARTS:
            break
    return np.array(chosen)


def _refined(other_side: Standardised, start: Array) -> Array:
    """A point of the boundary nearer to the middle than a point beyond it, or that point itself, (d,)."""
    from scipy.optimize import minimize

    d = len(start)

    def gradient(Z: NDArray[np.float64]) -> Array:
        moved = np.concatenate([Z + _STEP * np.eye(d), Z - _STEP * np.eye(d)])
        values = other_side(moved)
        return np.asarray((values[:d] - values[d:]) / (2.0 * _STEP))

    constraint = {"type": "ineq", "fun": lambda Z: float(other_side(Z[None])[0]), "jac": gradient}
    optimum = minimize(
        lambda Z: 0.5 * float(Z @ Z),
        start,
        jac=lambda Z: Z,
        method="SLSQP",
        constraints=[constraint],
        options={"maxiter": 100},
    )
    Z = np.asarray(optimum.x)
    is_beyond = bool(np.isfinite(Z).all()) and bool(other_side(Z[None])[0] > -_ON_BOUNDARY)
    return Z if is_beyond and start @ start > Z @ Z else start
