"""The bivariate normal distribution on arrays: how a label depends on the sign of a latent elsewhere."""

import numpy as np
from scipy.special import ndtr

from activefail.space import Array

_STEPS = ((0.1, 4), (0.3, 6), (0.75, 12), (0.925, 20))
"""Upper limits of |ρ| with the number of quadrature nodes below each; beyond, an expansion around |ρ| = 1 is used."""

_FARTHEST = 38.0
"""Standard deviations beyond which Φ is 0 or 1 in double precision."""

_NEAREST = 1.0 - 1e-15
"""Largest |ρ|: the expansion divides by 1 − ρ²."""


def _nodes(number: int) -> tuple[list[float], list[float]]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(number)
    return (0.5 * (x + 1.0)).tolist(), (0.5 * w).tolist()


def _density_integral(a: Array, b: Array, rho: Array, number: int) -> Array:
    """∫₀^ρ φ₂(a, b; r) dr by Gauss-Legendre [DreznerWesolowsky1990]."""
    half_squares, product = -0.5 * (a * a + b * b), a * b
    total = np.zeros(rho.shape)
    for node, weight in zip(*_nodes(number), strict=True):
        r = node * rho
        rest = 1.0 - r * r
        total += weight / np.sqrt(rest) * np.exp((half_squares + product * r) / rest)
    return np.asarray(rho * total / (2.0 * np.pi))


def _nearly_dependent(a: Array, b: Array, rho: Array) -> Array:
    """BVN(a, b; ρ) for |ρ| near 1: the limit minus an integral with a known singular part [Genz2004, section 2]."""
    # As upper tails of (h, k) with a positive correlation.
    h, k = -a, np.where(rho > 0.0, -b, b)
    hk = h * k
    rest = (1.0 - rho) * (1.0 + rho)
    root = np.sqrt(rest)
    gap = np.abs(h - k)
    square = gap * gap
    c, d = (4.0 - hk) / 8.0, (12.0 - hk) / 16.0
    series = 1.0 - c * (square - rest) * (1.0 - d * square / 5.0) / 3.0 + c * d * rest * rest / 5.0
    value = root * np.exp(-0.5 * (square / rest + hk)) * series
    # For large −hk the gap is many roots wide, and this would be a huge number times an underflow.
    tail = np.sqrt(2.0 * np.pi) * ndtr(-gap / root) * gap * (1.0 - c * square * (1.0 - d * square / 5.0) / 3.0)
    value -= np.where(hk > -100.0, np.exp(-0.5 * np.maximum(hk, -100.0)) * tail, 0.0)
    for node, weight in zip(*_nodes(20), strict=True):
        x = (node * root) ** 2
        r = np.sqrt(1.0 - x)
        smooth = np.exp(-0.5 * hk * (1.0 - r) / (1.0 + r)) / r - (1.0 + c * x * (1.0 + d * x))
        value += weight * root * np.exp(np.maximum(-0.5 * (square / x + hk), -700.0)) * smooth
    value = -value / (2.0 * np.pi)
    return np.asarray(np.where(rho > 0.0, value + ndtr(-np.maximum(h, k)), np.maximum(ndtr(k) - ndtr(h), 0.0) - value))


def label_covariance(a: Array, b: Array, rho: Array) -> Array:
    """BVN(a, b; ρ) − Φ(a)·Φ(b): the covariance of the events x < a and y < b.

    Below |ρ| = 0.925 it is the integral of the density over ρ, so that small covariances keep their relative accuracy.
    The absolute error is below 1e-10.

    Args:
        a, b, rho: arrays that broadcast; −1 < ρ < 1.
    """
    a, b, rho = np.broadcast_arrays(a, b, np.clip(rho, -_NEAREST, _NEAREST))
    a, b = np.clip(a, -_FARTHEST, _FARTHEST), np.clip(b, -_FARTHEST, _FARTHEST)
    size = np.abs(rho)
    value = np.empty(rho.shape)
    lower = 0.0
    for bound, number in _STEPS:
        chosen = (size >= lower) & (size < bound)
        if chosen.any():
            value[chosen] = _density_integral(a[chosen], b[chosen], rho[chosen], number)
        lower = bound
    chosen = size >= lower
    if chosen.any():
        h, k = a[chosen], b[chosen]
        value[chosen] = _nearly_dependent(h, k, rho[chosen]) - ndtr(h) * ndtr(k)
    return value


def bivariate_cdf(a: Array, b: Array, rho: Array) -> Array:
    """BVN(a, b; ρ) = P(x < a, y < b) of standard normals with correlation ρ; absolute error below 1e-10.

    Sources: [DreznerWesolowsky1990], [Genz2004].

    Args:
        a, b, rho: arrays that broadcast; −1 < ρ < 1.
    """
    return np.asarray(ndtr(a) * ndtr(b) + label_covariance(a, b, rho))
