"""What a label says of the latent: closed expectations against quadrature, autograd and sampling."""

import gpytorch
import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.stats import norm
from surrogate.labelled import Mislabelled

from activefail.learning.model.likelihoods import Probit, expectations, expected_precision, probability


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("label", [1.0, 0.0])
@pytest.mark.parametrize(("mean", "sd"), [(0.0, 1.0), (2.5, 0.3), (-4.0, 2.0), (30.0, 3.0)])
def test_the_probit_expectations_are_those_of_adaptive_quadrature(label, mean, sd):
    sign = 2.0 * label - 1.0

    def expectation(function):
        return quad(lambda f: function(f) * norm.pdf(f, mean, sd), mean - 12 * sd, mean + 12 * sd, limit=400)[0]

    def ratio(f):
        return np.exp(norm.logpdf(f) - norm.logcdf(sign * f))

    expected = (
        expectation(lambda f: norm.logcdf(sign * f)),
        expectation(lambda f: sign * ratio(f)),
        expectation(lambda f: ratio(f) * (ratio(f) + sign * f)),
    )
    got = [float(value) for value in expectations(Probit(), *(tensor(value) for value in (label, mean, sd**2)))]
    # 20 nodes over a latent four times as wide as the likelihood's step.
    assert got == pytest.approx(expected, rel=5e-4, abs=1e-9)


def test_another_likelihoods_expectations_are_gpytorchs_and_their_derivatives():
    class Other(gpytorch.likelihoods.BernoulliLikelihood):
        """The probit, but not recognised as such."""

    at = tensor(1.0, 0.0, 1.0, 0.0), tensor(0.0, 1.5, -2.0, 3.0), tensor(1.0, 0.2, 2.0, 0.5)
    for ours, closed in zip(expectations(Other(), *at), expectations(Probit(), *at), strict=True):
        assert torch.allclose(ours, closed, rtol=2e-3, atol=1e-5)  # GPyTorch's log Φ has three digits
    assert (expectations(Mislabelled().double(), *at)[2] >= 0.0).all()  # it is not log-concave


def test_the_expected_precision_of_a_label_is_that_of_sampling():
    rng = np.random.default_rng(0)
    for mean, sd in [(0.0, 1.0), (1.5, 0.4), (-2.0, 2.0)]:
        f = mean + sd * rng.standard_normal(400_000)
        y = np.where(rng.uniform(size=f.size) < norm.cdf(mean / np.sqrt(1 + sd**2)), 1.0, -1.0)
        ratio = np.exp(norm.logpdf(f) - norm.logcdf(y * f))
        found = float(expected_precision(Probit(), *tensor(mean, sd**2)))
        assert found == pytest.approx(np.mean(ratio * (ratio + y * f)), rel=0.02)


def test_the_probability_of_a_label_is_its_expectation_over_the_latent():
    mean, sd = np.array([0.0, 1.5, -2.0]), np.array([1.0, 0.4, 2.0])
    assert probability(Probit(), mean, sd) == pytest.approx(norm.cdf(mean / np.sqrt(1.0 + sd**2)), abs=1e-12)
    likelihood = Mislabelled().double()
    share = likelihood.share.item()
    expected = share + (1.0 - 2.0 * share) * norm.cdf(mean / np.sqrt(1.0 + sd**2))
    assert probability(likelihood, mean, sd) == pytest.approx(expected, abs=1e-12)
