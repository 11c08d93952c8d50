"""A batch of designs to simulate next: a criterion maximised over the physical variables, point after point."""

from collections.abc import Callable

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.special import log_ndtr

from activefail.features import FeatureMap
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Latent

POOL = 4096
"""Designs of the Sobol' pool that is screened first; a power of two."""

SHORTLIST = 512
"""Designs whose joint posterior the batch is chosen from."""

_REFINEMENTS = (0.05, 0.02, 0.008)
"""Standard deviations of the local searches around the best designs so far, in units of the variables' ranges."""

_NODES, _WEIGHTS = hermegauss(20)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def expected_site_precision(mean: float, sd: float) -> float:
    """λ = E_y E_f[−∂² log Φ(yf)/∂f²]: what one label at a point would add to the posterior's precision there.

    The label's probability is the predictive one, the latent's distribution the present one.
    """
    f = mean + sd * _NODES
    p = float(np.exp(log_ndtr(mean / np.sqrt(1.0 + sd**2))))
    total = 0.0
    for y, probability in ((1.0, p), (-1.0, 1.0 - p)):
        z = y * f
        ratio = np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_ndtr(z))
        total += probability * float(ratio * (ratio + z) @ _WEIGHTS)
    return total


def greedy_batch(
    mean: Array, covariance: Array, q: int, criterion: Callable[[Array, Array], Array]
) -> NDArray[np.intp]:
    """Rows of q candidates, each the criterion's best given those before it.

    A chosen point is fantasised by its site: the mean stays, the covariance loses
    Σ_·* Σ_*·/(Σ_** + 1/λ*), as if a label of yet unknown value had been seen there.

    Args:
        mean: (n,) latent means of the candidates.
        covariance: (n, n) their joint covariance.
        q: how many to choose, at most n.
        criterion: (mean, sd) -> value, larger is better.
    """
    covariance = covariance.copy()
    chosen: list[int] = []
    for _ in range(q):
        sd = np.sqrt(np.clip(covariance.diagonal(), 0.0, None))
        value = criterion(mean, sd)
        value[chosen] = -np.inf
        best = int(np.argmax(value))
        chosen.append(best)
        variance = float(covariance[best, best])
        precision = expected_site_precision(float(mean[best]), float(np.sqrt(max(variance, 0.0))))
        column = covariance[:, best].copy()
        covariance -= np.outer(column, column) / (variance + 1.0 / max(precision, 1e-300))
    return np.array(chosen, dtype=np.intp)


def propose(
    latent: Latent,
    features: FeatureMap,
    space: DesignSpace,
    criterion: Callable[[Array, Array], Array],
    q: int,
    rng: np.random.Generator,
) -> Array:
    """q designs, (q, d), where one more label is worth most for the latent's boundary.

    A Sobol' pool over the design space is screened; the best of it are improved by local random searches, which need
    neither gradients nor smooth features; the batch is chosen greedily from the best of all.
    """
    pool = space.sobol(POOL, rng)
    values = criterion(*latent.moments(features(pool)))
    for spread in _REFINEMENTS:
        best = np.argsort(-values, kind="stable")[:SHORTLIST]
        unit = space.to_unit(pool[best])
        moved = space.from_unit(np.clip(unit + spread * rng.standard_normal(unit.shape), 0.0, 1.0))
        moved_values = criterion(*latent.moments(features(moved)))
        # A search from each start replaces its start: the shortlist stays spread over the whole boundary.
        improved = moved_values > values[best]
        pool = np.where(improved[:, None], moved, pool[best])
        values = np.where(improved, moved_values, values[best])
    mean, covariance = latent.joint(features(pool))
    return np.asarray(pool[greedy_batch(mean, covariance, min(q, len(pool)), criterion)])
