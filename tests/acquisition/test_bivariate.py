import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import multivariate_normal, norm

from activefail.acquisition.bivariate import bivariate_cdf, label_covariance

CORRELATIONS = [0.0, 0.05, 0.0999, 0.2, 0.31, 0.5, 0.7499, 0.8, 0.9249, 0.926, 0.95, 0.99, 0.999, 1 - 1e-5, 1 - 1e-9]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", CORRELATIONS)
def test_the_bivariate_cdf_is_scipys(size, sign):
    rho = sign * size
    rng = np.random.default_rng(0)
    a = rng.uniform(-5.0, 5.0, 60)
    # A third of them where the mass lies: near the line that a large correlation draws.
    b = np.where(rng.random(60) < 0.3, sign * a + 0.05 * rng.standard_normal(60), rng.uniform(-5.0, 5.0, 60))
    normal = multivariate_normal(cov=[[1.0, rho], [rho, 1.0]], allow_singular=True)
    assert bivariate_cdf(a, b, rho) == pytest.approx(normal.cdf(np.column_stack([a, b])), abs=1e-10)


arguments = st.floats(-6.0, 6.0)


@given(a=arguments, b=arguments, rho=st.floats(-0.999999, 0.999999))
def test_swapping_the_two_and_turning_one_around_are_exact_symmetries(a, b, rho):
    a, b, rho = np.array([a]), np.array([b]), np.array([rho])
    assert bivariate_cdf(a, b, rho) == pytest.approx(bivariate_cdf(b, a, rho), abs=1e-11)
    assert bivariate_cdf(a, b, rho) + bivariate_cdf(a, -b, -rho) == pytest.approx(ndtr(a), abs=1e-11)
    assert label_covariance(a, b, rho) == pytest.approx(label_covariance(-a, -b, rho), abs=1e-11)


def test_the_covariance_grows_with_the_correlation_through_all_changes_of_method():
    rho = np.linspace(-0.99999, 0.99999, 20_001)
    for a, b in [(0.0, 0.0), (0.5, -1.0), (1.7, 1.6), (-2.0, 0.3)]:
        assert np.diff(label_covariance(np.array(a), np.array(b), rho)).min() > -1e-11


def test_a_small_covariance_has_its_own_digits():
    a, b, rho = np.array([0.3, -1.2]), np.array([0.7, 2.0]), 1e-9
    expected = rho * norm.pdf(a) * norm.pdf(b)
    assert label_covariance(a, b, rho) == pytest.approx(expected, rel=1e-6, abs=0.0)


def test_full_dependence_is_the_limit():
    a, b = np.meshgrid(np.linspace(-3, 3, 13), np.linspace(-3, 3, 13))
    assert bivariate_cdf(a, b, 1.0) == pytest.approx(ndtr(np.minimum(a, b)), abs=1e-7)
    assert bivariate_cdf(a, b, -1.0) == pytest.approx(np.maximum(ndtr(a) + ndtr(b) - 1.0, 0.0), abs=1e-7)


def test_arguments_without_end_are_no_trouble():
    far = np.array([-1e6, -38.0, 0.0, 38.0, 1e6])
    a, b, rho = (x.ravel() for x in np.meshgrid(far, far, [-1.0, -0.95, -0.5, 0.05, 0.95, 1.0]))
    assert np.isfinite(label_covariance(a, b, rho)).all()
    assert (np.abs(label_covariance(a, b, rho)) <= 0.25 + 1e-12).all()
