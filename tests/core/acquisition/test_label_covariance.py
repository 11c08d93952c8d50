"""How a label depends on the sign of a latent elsewhere: the bivariate normal distribution."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import multivariate_normal, norm

from activefail.learning.criteria.criteria import _LabelCovariance

CORRELATIONS = [0.0, 0.05, 0.31, 0.5, 0.8, 0.926, 0.95, 0.99, 0.999, 1 - 1e-5, 1 - 1e-9]


def label_covariance(a, b, rho):
    return _LabelCovariance.apply(*(torch.as_tensor(np.atleast_1d(x)) for x in (a, b, rho))).numpy()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", CORRELATIONS)
def test_it_is_that_of_scipys_distribution(size, sign):
    rho = sign * size
    rng = np.random.default_rng(0)
    a = rng.uniform(-5.0, 5.0, 60)
    # A third of them where the mass lies: near the line that a large correlation draws.
    b = np.where(rng.random(60) < 0.3, sign * a + 0.05 * rng.standard_normal(60), rng.uniform(-5.0, 5.0, 60))
    a[0] = b[1] = 0.0
    normal = multivariate_normal(cov=[[1.0, rho], [rho, 1.0]], allow_singular=True)
    expected = normal.cdf(np.column_stack([a, b])) - ndtr(a) * ndtr(b)
    assert label_covariance(a, b, rho) == pytest.approx(expected, abs=1e-10)


# Not nearer to 0: there the product of two, by which they are on one side of it, underflows.
arguments = st.floats(-6.0, 6.0).map(lambda x: round(x, 9))


@given(a=arguments, b=arguments, rho=st.floats(-0.999999, 0.999999))
def test_swapping_the_two_and_turning_both_around_are_exact_symmetries(a, b, rho):
    expected = pytest.approx(label_covariance(a, b, rho), abs=1e-11)
    assert label_covariance(b, a, rho) == expected
    assert label_covariance(-a, -b, rho) == expected
    assert -label_covariance(a, -b, -rho) == expected


def test_a_small_covariance_is_the_densities_times_the_correlation():
    a, b, rho = np.array([0.3, -1.2]), np.array([0.7, 2.0]), 1e-9
    assert label_covariance(a, b, rho) == pytest.approx(rho * norm.pdf(a) * norm.pdf(b), rel=1e-5, abs=0.0)


def test_it_is_finite_wherever_the_latent_is():
    far = np.array([-1e6, -38.0, 0.0, 38.0, 1e6])
    a, b, rho = (x.ravel() for x in np.meshgrid(far, far, [-1.0, -0.95, -0.5, 0.0, 0.05, 0.95, 1.0]))
    assert np.isfinite(label_covariance(a, b, rho)).all()
    assert (np.abs(label_covariance(a, b, rho)) <= 0.25 + 1e-12).all()


def test_its_derivatives_are_finite_differences():
    rng = np.random.default_rng(1)
    at = [torch.from_numpy(rng.uniform(-high, high, 20)).requires_grad_() for high in (2.0, 2.0, 0.95)]
    assert torch.autograd.gradcheck(_LabelCovariance.apply, at, atol=1e-7)
