"""The prior of a latent: a constant mean and an ARD covariance, with priors for the scales of a classifier of outcomes.

Training and prediction use the values and derivatives of this module. `gpytorch_model.covariance_module` is the same
covariance in GPyTorch, for BoTorch's model; tests compare the two.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from activefail.space import Array

if TYPE_CHECKING:
    import torch
    from torch import Tensor
else:
    from activefail.surrogate import lazy_torch as torch

JITTER = 1e-6
"""Added to the diagonal of K, as in the GPyTorch model of the result."""

OUTPUTSCALE_PRIOR = (math.log(10.0), 2.0)
"""Mean and standard deviation of the output scale's logarithm. Flat, because a sharp boundary needs a latent many times
as large as the likelihood's unit width."""


def length_scale_prior(dimension: int) -> tuple[float, float]:
    """Mean and standard deviation of a length scale's logarithm, in units of the features' spread.

    The length scale grows with the root of the dimension [HvarfnerEtAl2024].
    """
    return math.sqrt(2.0) + 0.5 * math.log(dimension), math.sqrt(3.0)


class Hyperparameters(NamedTuple):
    """Hyperparameters of a constant mean and an ARD covariance, in the features' standard units."""

    mean: float
    log_outputscale: float
    log_lengthscale: Array  # (m,)

    @property
    def lengthscale(self) -> Array:
        """Length scales, (m,)."""
        return np.asarray(torch.from_numpy(self.log_lengthscale).exp())


class SavedHyperparameters(Hyperparameters):
    """Hyperparameters for predictions without torch, whose exponential may differ from NumPy's in the last bit."""

    __slots__ = ()

    @property
    def lengthscale(self) -> Array:
        """Length scales, (m,)."""
        return np.exp(self.log_lengthscale)


def check_kernel(kernel: str) -> None:
    """Check the name of a kernel.

    Raises:
        ValueError: if it is unknown.
    """
    if kernel not in ("rbf", "matern52"):
        raise ValueError(f"The covariance must be rbf or matern52, got {kernel!r}.")


def log_prior(hyperparameters: Hyperparameters) -> tuple[float, Tensor]:
    """Log density of the scales' logarithms, and its gradient, (1 + m,), by log output scale and log length scales.

    The mode of this density does not depend on the scales' units.
    """
    log_lengthscale = torch.from_numpy(hyperparameters.log_lengthscale)
    scales = torch.cat([log_lengthscale.new_tensor([hyperparameters.log_outputscale]), log_lengthscale])
    m = len(log_lengthscale)
    mean, sd = torch.tensor([OUTPUTSCALE_PRIOR, *[length_scale_prior(m)] * m], dtype=torch.float64).T
    away = (scales - mean) / sd
    return float((-0.5 * away**2 - sd.log() - 0.5 * math.log(2.0 * math.pi)).sum()), -away / sd


def covariance_array(kernel: str, hyperparameters: Hyperparameters, F: Array, G: Array) -> Array:
    """k(f, g) of features, (n, m) and (l, m) -> (n, l).

    Args:
        kernel: "rbf" (squared exponential, the paper's) or "matern52".

    Raises:
        ValueError: if the kernel is unknown.
    """
    check_kernel(kernel)
    scale = hyperparameters.lengthscale
    F_scaled, G_scaled = F / scale, G / scale
    s2 = math.exp(hyperparameters.log_outputscale)
    if kernel == "rbf":
        K = cdist(F_scaled, G_scaled, "sqeuclidean")
        K *= -0.5
        np.exp(K, out=K)
        K *= s2
        return np.asarray(K)
    # s² (1 + d + d²/3) exp(−d), d = √5 r; in place, because memory access dominates the time for many points.
    d = cdist(F_scaled, G_scaled)
    d *= math.sqrt(5.0)
    fall = np.exp(-d)
    fall *= s2
    K = d * d
    K /= 3.0
    K += d
    K += 1.0
    K *= fall
    return np.asarray(K)


def covariance(kernel: str, hyperparameters: Hyperparameters, F: Tensor, G: Tensor) -> Tensor:
    """As `covariance_array`, of tensors."""
    return torch.from_numpy(covariance_array(kernel, hyperparameters, F.numpy(), G.numpy()))


def covariance_gradient(
    kernel: str, hyperparameters: Hyperparameters, F: Tensor, G: Tensor, K: Tensor, by_K: Tensor
) -> Tensor:
    """Gradient of Σ by_K k(F, G), (1 + m,), by log output scale and log length scales.

    Args:
        K: k(F, G), (n, l).
        by_K: derivative by each entry of K, (n, l).
    """
    scale = hyperparameters.lengthscale
    F_scaled, G_scaled = F.numpy() / scale, G.numpy() / scale
    by_logarithm = K * by_K
    by_outputscale = by_logarithm.sum().reshape(1)
    # ∂k/∂log ℓ = h (f − g)²/ℓ², where h is k itself (rbf) or s² (5/3) (1 + d) exp(−d) (matern52).
    H = by_logarithm.numpy()
    if kernel == "matern52":
        d = cdist(F_scaled, G_scaled)
        d *= math.sqrt(5.0)
        H *= 5.0 * (1.0 + d) / (3.0 + d * (3.0 + d))
    by_lengthscale = (
        H.sum(1) @ F_scaled**2 + H.sum(0) @ G_scaled**2 - 2.0 * np.einsum("im,im->m", F_scaled, H @ G_scaled)
    )
    return torch.cat([by_outputscale, torch.from_numpy(by_lengthscale)])


def prior_covariance(features: Tensor, kernel: str, hyperparameters: Hyperparameters) -> Tensor:
    """K at the training points with its jitter, shape (n, n)."""
    K = covariance(kernel, hyperparameters, features, features)
    K.diagonal().add_(JITTER)
    return K
