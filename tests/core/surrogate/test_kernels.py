"""The built-in kernels are GPyTorch's, with closed derivatives; a prior's density is that of the logarithms."""

import math

import gpytorch
import pytest
import torch
from scipy.stats import norm
from surrogate.labelled import points, prior

from activefail.learning.model.fitting import outcome_prior
from activefail.learning.model.margin import margin_prior

STOCK = {"rbf": gpytorch.kernels.RBFKernel, "matern52": gpytorch.kernels.MaternKernel}
SCALES = torch.tensor([0.67, 2.5, 1.1], dtype=torch.float64)


def stock(kernel):
    """The kernel by GPyTorch alone, with parameters that are the logarithms of its scales."""
    positive = gpytorch.constraints.Positive(transform=torch.exp, inv_transform=torch.log)
    base = STOCK[kernel](ard_num_dims=3, lengthscale_constraint=positive)
    module = gpytorch.kernels.ScaleKernel(base, outputscale_constraint=positive).double()
    module.initialize(outputscale=8.0)
    base.initialize(lengthscale=SCALES)
    return module


@pytest.mark.parametrize("kernel", STOCK)
@pytest.mark.parametrize("same", [False, True])
def test_values_and_derivatives_by_the_scales_are_gpytorchs(kernel, same):
    F = points(40, 3)[0]
    G = F if same else points(30, 3, seed=2)[0]
    by_K = torch.randn(len(F), len(G), generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    ours, theirs = prior(kernel, 3, outputscale=8.0, lengthscale=SCALES), stock(kernel)
    ours.covar_module.requires_grad_(True)
    K, expected = ours.covariance(F, G), theirs(F, G).to_dense()
    assert torch.allclose(K, expected, rtol=1e-7, atol=1e-9)
    assert torch.allclose(ours.variance(F), theirs(F, diag=True), rtol=1e-12)
    gradients = [
        torch.autograd.grad(value, [of.raw_outputscale, of.base_kernel.raw_lengthscale], by_K)
        for value, of in ((K, ours.covar_module), (expected, theirs))
    ]
    for own, other in zip(*gradients, strict=True):
        assert torch.allclose(own, other, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("kernel", STOCK)
def test_derivatives_by_the_features_are_gpytorchs(kernel):
    F, G = points(6, 3)[0].requires_grad_(), points(5, 3, seed=2)[0]
    ours, theirs = prior(kernel, 3, outputscale=8.0, lengthscale=SCALES).covar_module, stock(kernel)
    one, other = (torch.autograd.grad(of(F, G).to_dense().sum(), F)[0] for of in (ours, theirs))
    assert torch.allclose(one, other, rtol=1e-9, atol=1e-12)


def test_a_margins_prior_is_that_of_gpytorch_with_a_linear_kernel():
    F, G = points(6, 3)[0].requires_grad_(), points(5, 3, seed=2)[0]
    ours = margin_prior(3)
    ours.covar_module.initialize(outputscale=8.0, slope=0.3)
    ours.covar_module.base_kernel.initialize(lengthscale=SCALES)
    linear = gpytorch.kernels.LinearKernel().double()
    linear.initialize(variance=0.3)
    theirs = stock("matern52") + linear
    for of, other in ((F, F), (F, G)):
        assert torch.allclose(ours.covariance(of, other), theirs(of, other).to_dense(), rtol=1e-7, atol=1e-9)
    assert torch.allclose(ours.variance(F), theirs(F, diag=True), rtol=1e-12)
    assert torch.allclose(ours.covar_module(F, diag=True), theirs(F, diag=True), rtol=1e-12)
    one, other = (torch.autograd.grad(of(F, G).to_dense().sum(), F)[0] for of in (ours.covar_module, theirs))
    assert torch.allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kernel", STOCK)
def test_a_points_covariance_with_itself_is_the_output_scale_to_the_last_digit(kernel):
    F, of = points(5, 3)[0], prior(kernel, 3)
    K = of.covariance(F)
    assert K.diagonal().tolist() == [float(of.covar_module.outputscale)] * 5
    assert torch.equal(K, K.mT)


def test_the_density_of_a_prior_is_that_of_the_scales_logarithms():
    of = prior("rbf", 3, outputscale=8.0, lengthscale=SCALES)
    by_hand = norm.logpdf(math.log(8.0), math.log(10.0), 2.0)
    by_hand += norm.logpdf(SCALES.log().numpy(), math.sqrt(2.0) + 0.5 * math.log(3.0), math.sqrt(3.0)).sum()
    # GPyTorch keeps means and deviations in single precision.
    assert float(of.log_density()) == pytest.approx(by_hand, rel=1e-6)


def test_the_length_scales_are_those_of_a_built_in_kernel():
    assert prior("rbf", 3, lengthscale=SCALES).length_scales == pytest.approx(SCALES.numpy(), rel=1e-12)
    assert outcome_prior(lambda m: gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernel()), 3).length_scales is None
