"""Values, derivatives and priors of the covariance are those of GPyTorch's, which a trained classifier has."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import norm

from activefail.surrogate.covariance import (
    Hyperparameters,
    covariance,
    covariance_gradient,
    log_prior,
)
from activefail.surrogate.gpytorch_model import covariance_module, set_hyperparameters

SCALES = Hyperparameters(0.3, 2.1, np.array([-0.4, 0.9, 0.1]))


def gpytorch_s(kernel):
    module = covariance_module(kernel, 3)
    set_hyperparameters(module, SCALES)
    return module


def features(n, seed):
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((n, 3)))


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
@pytest.mark.parametrize("same", [False, True])
def test_values_are_gpytorch_s(kernel, same):
    F = features(40, 1)
    G = F if same else features(30, 2)
    expected = gpytorch_s(kernel)(F, G).to_dense().detach()
    assert torch.allclose(covariance(kernel, SCALES, F, G), expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
@pytest.mark.parametrize("same", [False, True])
def test_derivatives_by_the_scales_are_gpytorch_s(kernel, same):
    F = features(40, 1)
    G = F if same else features(30, 2)
    by_K = torch.from_numpy(np.random.default_rng(3).standard_normal((len(F), len(G))))
    module = gpytorch_s(kernel)
    module(F, G).to_dense().backward(by_K)
    expected = [module.raw_outputscale.grad.item(), *module.base_kernel.raw_lengthscale.grad.flatten().tolist()]
    K = covariance(kernel, SCALES, F, G)
    assert covariance_gradient(kernel, SCALES, F, G, K, by_K).tolist() == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_the_prior_of_the_scales_is_gpytorch_s_as_a_density_of_their_logarithms():
    module = gpytorch_s("rbf")
    prior = torch.zeros((), dtype=torch.float64)
    for _, owner, density, closure, _ in module.named_priors():
        scale = closure(owner)
        prior = prior + (density.log_prob(scale) + scale.log()).sum()
    prior.backward()
    expected = [module.raw_outputscale.grad.item(), *module.base_kernel.raw_lengthscale.grad.flatten().tolist()]
    value, gradient = log_prior(SCALES)
    assert value == pytest.approx(prior.item())
    assert gradient.tolist() == pytest.approx(expected)
    # GPyTorch keeps means and deviations in single precision.
    by_hand = norm.logpdf(SCALES.log_outputscale, math.log(10.0), 2.0)
    by_hand += norm.logpdf(SCALES.log_lengthscale, math.sqrt(2.0) + 0.5 * math.log(3.0), math.sqrt(3.0)).sum()
    assert value == pytest.approx(by_hand, rel=1e-14)


def test_a_point_s_covariance_with_itself_is_the_output_scale_to_the_last_digit():
    F = features(5, 4)
    for kernel in ("rbf", "matern52"):
        K = covariance(kernel, SCALES, F, F)
        assert K.diagonal().tolist() == [math.exp(SCALES.log_outputscale)] * 5
        assert torch.equal(K, K.mT)
