"""Expectation propagation for margins of which only the sign is known: each is at most 0.

A Gaussian site stands for the step of each margin [RasmussenWilliams2006, section 3.6 with a step in place of the
probit].
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.special import erfcx, log_ndtr

from activefail.space.space import Array

_SWEEPS, _DAMPING, _TOLERANCE = 300, 0.7, 1e-9
"""Most sweeps of expectation propagation, its share of a step, and the relative change of precisions that ends it."""

_FARTHEST = 30.0
"""Largest mean of a censored point's cavity in its standard deviations."""


class CensoredSites(NamedTuple):
    """Gaussian sites of the k censored points: exp(linear f − precision f²/2)."""

    linear: Array  # (k,)
    precision: Array  # (k,)


def censored_posterior(mean: Array, S: Array, sites: CensoredSites) -> tuple[CensoredSites, float]:
    """Sites and log evidence of f ~ N(mean, S), (k,) and (k, k), with f ≤ 0 in every entry, from initial sites.

    All sites take a damped step at once: a site after the other needs k times the algebra.
    """
    linear, precision = sites
    for _ in range(_SWEEPS):
        _, m, variance, _ = _with_sites(mean, S, linear, precision)
        cavity_precision, cavity_mean, z = _cavities(m, variance, linear, precision)
        sd = cavity_precision**-0.5
        ratio = math.sqrt(2.0 / math.pi) / erfcx(-z / math.sqrt(2.0))  # φ(z)/Φ(z)
        # Far above 0 the tilted variance is about sd²/z², which the difference loses to rounding.
        shrunk = np.maximum(1.0 - ratio * (z + ratio), 0.3 / (1.0 + z * z))
        tilted_precision = cavity_precision / shrunk
        new_precision = np.maximum(tilted_precision - cavity_precision, 0.0)
        new_linear = tilted_precision * (cavity_mean - sd * ratio) - cavity_precision * cavity_mean
        moved = np.abs(new_precision - precision) / (1.0 / variance + precision)
        linear = linear + _DAMPING * (new_linear - linear)
        precision = precision + _DAMPING * (new_precision - precision)
        if moved.max() <= _TOLERANCE:
            break
    log_determinant, m, variance, quadratic = _with_sites(mean, S, linear, precision)
    cavity_precision, cavity_mean, z = _cavities(m, variance, linear, precision)
    # log ∫ N(f; mean, S) Π t_i(f_i), each site scaled so that it has the step's integral against its cavity.
    scale = log_ndtr(z) + 0.5 * np.log1p(precision / cavity_precision)
    tilted = (cavity_precision * cavity_mean + linear) ** 2 / (cavity_precision + precision)
    scale += 0.5 * (cavity_precision * cavity_mean**2 - tilted)
    return CensoredSites(linear, precision), float(scale.sum()) + quadratic - 0.5 * log_determinant


def _with_sites(mean: Array, S: Array, linear: Array, precision: Array) -> tuple[float, Array, Array, float]:
    """Of N(mean, S) times Gaussian sites: log |I + P S|, its mean and variances, and the exponent of its integral."""
    root = np.sqrt(precision)
    L = cholesky(np.eye(len(mean)) + root[:, None] * S * root, lower=True)
    whitened = solve_triangular(L, root[:, None] * S, lower=True)
    pull = linear - precision * mean
    step = S @ pull - whitened.T @ (whitened @ pull)
    quadratic = float(linear @ mean - 0.5 * mean @ (precision * mean) + 0.5 * pull @ step)
    variance = np.maximum(S.diagonal() - np.einsum("ij,ij->j", whitened, whitened), 1e-12 * S.diagonal())
    return 2.0 * float(np.log(L.diagonal()).sum()), mean + step, variance, quadratic


def _cavities(m: Array, variance: Array, linear: Array, precision: Array) -> tuple[Array, Array, Array]:
    """Precisions and means of the marginals without their own sites, and z with P(f ≤ 0) = Φ(z)."""
    cavity_precision = np.maximum(1.0 / variance - precision, 1e-6 / variance)
    cavity_mean = (m / variance - linear) / cavity_precision
    # Only a line search meets cavities this far above 0; sites that follow them would diverge.
    cavity_mean = np.minimum(cavity_mean, _FARTHEST / np.sqrt(cavity_precision))
    return cavity_precision, cavity_mean, -cavity_mean * np.sqrt(cavity_precision)


def first_sites(censored: NDArray[np.bool_], scale: float) -> CensoredSites:
    """Initial sites of censored points, (n,), of margins with a standard deviation."""
    k = int(censored.sum())
    return CensoredSites(np.full(k, -0.1 / scale), np.full(k, 0.1 / scale**2))
