"""The built-in kernels on arrays: the one formula behind the GPyTorch kernels and the predictions without torch."""

import math

import numpy as np
from scipy.spatial.distance import cdist

from activefail.space.space import Array

JITTER = 1e-6
"""Added to the variance of a latent that is learned from outcomes."""

NUGGET = 1e-6
"""Variance of a margin's noise in units of the prior variance, for a margin computed to a finite accuracy."""


def correlation(kernel: str, A: Array, B: Array, with_slope: bool = False) -> tuple[Array, Array | None]:
    """k(a, b)/σ², (n, l), of features in units of their length scales ℓ, (n, m) and (l, m), and its slope h, (n, l).

    Args:
        kernel: "rbf" (squared exponential, the paper's) or "matern52".
        A, B: the features.
        with_slope: whether to compute h with ∂k/∂log ℓ_i = σ² h (a_i − b_i)².
    """
    # In place, because memory access dominates the time for many points.
    if kernel == "rbf":
        K = cdist(A, B, "sqeuclidean")
        K *= -0.5
        np.exp(K, out=K)
        return np.asarray(K), K
    # (1 + d + d²/3) exp(−d) and (5/3) (1 + d) exp(−d), d = √5 r
    d = cdist(A, B)
    d *= math.sqrt(5.0)
    fall = np.exp(-d)
    K = d * d
    K /= 3.0
    K += d
    K += 1.0
    K *= fall
    if not with_slope:
        return np.asarray(K), None
    d += 1.0
    d *= fall
    d *= 5.0 / 3.0
    return np.asarray(K), d
