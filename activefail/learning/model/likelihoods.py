"""What a label says about the latent: the probit likelihood, and what training needs of any likelihood."""

import math
from typing import Any

import gpytorch
import numpy as np
import torch
from gpytorch.distributions import MultivariateNormal
from linear_operator.operators import DiagLinearOperator
from torch import Tensor

from activefail.space.space import Array

_NODES, _WEIGHTS = (torch.from_numpy(array) for array in np.polynomial.hermite_e.hermegauss(20))
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()

_BOTH = torch.tensor([0.0, 1.0], dtype=torch.float64)
"""Both labels."""


def marginals(mean: Tensor, variance: Tensor) -> MultivariateNormal:
    """Independent normal distributions, each (n,)."""
    return MultivariateNormal(mean, DiagLinearOperator(variance))


Probit = gpytorch.likelihoods.BernoulliLikelihood
"""P(label 1) = Φ(f)."""


def _of_probit(labels: Tensor, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As `expectations`, of log Φ(±f), in closed form at GPyTorch's nodes.

    The curvature uses Stein's lemma, E[−∂²l] = −E[l′·(f − mean)]/variance: the three are then value and exact
    derivatives of one quadrature, so that the sites maximise the reported bound. The second derivative is nearly a step
    in f, which the nodes resolve poorly where the latent is wide.
    """
    sd = variance.sqrt()
    f = mean.unsqueeze(-1) + sd.unsqueeze(-1) * _NODES  # n -> n x 20
    y = (2.0 * labels - 1.0).unsqueeze(-1)
    log_cdf = torch.special.log_ndtr(y * f)
    slope = y * torch.exp(-0.5 * f * f - 0.5 * math.log(2.0 * math.pi) - log_cdf)  # yφ/Φ
    # Negative only by rounding: the slope decreases with f.
    curvature = (-(slope @ (_WEIGHTS * _NODES)) / sd).clamp_min(0.0)
    return log_cdf @ _WEIGHTS, slope @ _WEIGHTS, curvature


def expectations(likelihood: Any, labels: Tensor, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """E[log p(y | f)], its derivative by the mean, and minus twice that by the variance, each (n,).

    The last is E[−∂² log p/∂f²], at least 0: a likelihood that is not log-concave may have negative ones, which no
    Gaussian site has.

    Args:
        likelihood: a one-dimensional GPyTorch likelihood.
        labels: (n,) of 0 and 1.
        mean, variance: (n,) of the latent.
    """
    if type(likelihood) is Probit:
        return _of_probit(labels, mean, variance)
    with torch.enable_grad():
        mean, variance = mean.detach().requires_grad_(), variance.detach().requires_grad_()
        value = likelihood.expected_log_prob(labels, marginals(mean, variance))
        by_mean, by_variance = torch.autograd.grad(value.sum(), (mean, variance))
    return value.detach(), by_mean, (-2.0 * by_variance).clamp_min(0.0)


def expected_precision(likelihood: Any, mean: Tensor, variance: Tensor) -> Tensor:
    """Precision that an observation is expected to add at a point, of scalars.

    For labels it is E_y E[−∂² log p(y | f)/∂f²], where y has its predictive probability.
    """
    if isinstance(likelihood, gpytorch.likelihoods.GaussianLikelihood):
        return torch.as_tensor(1.0 / likelihood.noise.detach().squeeze())
    mean, variance = mean.reshape(1), variance.reshape(1)
    if type(likelihood) is Probit:
        p = torch.special.ndtr(mean / (1.0 + variance).sqrt())
    else:
        p = likelihood.marginal(marginals(mean, variance)).probs.detach()
    _, _, (of_zero, of_one) = expectations(likelihood, _BOTH, mean.expand(2), variance.expand(2))
    return torch.as_tensor((p * of_one + (1.0 - p) * of_zero).clamp_min(1e-300).squeeze())


def probability(likelihood: Any, mean: Array, sd: Array) -> Array:
    """P(label 1), (n,), of a latent with a mean and a standard deviation, each (n,)."""
    with torch.no_grad():
        of_label = likelihood.marginal(marginals(torch.from_numpy(mean), torch.from_numpy(sd**2)))
    return np.asarray(of_label.probs.numpy())
