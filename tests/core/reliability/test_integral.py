"""One function for the probabilities of outcomes and one integrator: coherent, accurate where rare, the same always."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr, ndtri
from scipy.stats import ncx2

from activefail.estimates.estimate import baseline
from activefail.estimates.integral import ACCURACY, integrate
from activefail.learning.model.moments import nested_probits, outcome_probabilities
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows


def normals(d: int) -> DesignSpace:
    return DesignSpace(tuple(Parameter(f"x{i}", -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for i in range(d)))


def plane(d: int, beta: float, width: float = 0.1):
    """A boundary at this distance from the middle, and its probability."""

    def boundary(X: Array) -> Array:
        return ((X.sum(axis=1) / np.sqrt(d) - beta) / width)[:, None]

    return boundary, float(ndtr(-beta / np.sqrt(1.0 + width**2)))


@pytest.mark.parametrize(("d", "beta"), [(1, 0.5), (2, 2.3), (2, 4.5), (5, 3.7)])
def test_a_probability_is_integrated_to_its_stated_accuracy_however_rare_it_is(d: int, beta: float) -> None:
    boundary, true = plane(d, beta)
    integral = integrate(boundary, normals(d))
    assert integral.error[0] <= ACCURACY * integral.probability[0]
    assert abs(integral.probability[0] - true) < 4.0 * max(integral.error[0], 0.002 * true)
    # The points never change, so neither does the number.
    assert integrate(boundary, normals(d)).probability[0] == integral.probability[0]


@pytest.mark.parametrize("beta", [2.5, 3.2, 4.5])
def test_of_a_probability_near_one_the_rest_is_integrated_as_accurately(beta: float) -> None:
    def beyond(X: Array) -> Array:
        return ((beta - X[:, 0]) / 0.1)[:, None]

    integral = integrate(beyond, normals(2))
    rest = float(ndtr(-beta / np.sqrt(1.01)))
    assert abs(1.0 - integral.probability[0] - rest) < 4.0 * max(integral.error[0], 0.002 * rest)
    assert integral.error[0] <= ACCURACY * rest * 1.1


def test_predictions_are_counted_on_an_island_that_no_prediction_leads_to() -> None:
    # 4.6e-6 of the probability, 4.3 standard deviations away; its classifier is sure of nothing farther than 0.3.
    def island(X: Array) -> Array:
        return (0.5 - np.sqrt((X[:, 0] - 4.3) ** 2 + X[:, 1] ** 2 + X[:, 2] ** 2)) / 0.01

    true = float(ncx2.cdf(0.25, 3, 4.3**2))
    found = baseline(lambda X: island(X)[:, None], normals(5), 0.02, np.random.default_rng(0))
    assert found.of(0).probability == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize("true", [0.99, 0.9, 0.3])
def test_the_error_of_an_estimate_holds_though_all_sequences_count_the_same(true: float) -> None:
    def plane(X: Array) -> Array:
        return 1e4 * (X[:, :1] - float(ndtri(1.0 - true)))

    found = [baseline(plane, normals(2), 0.002, np.random.default_rng(seed)).of(0) for seed in range(40)]
    held = sum(abs(one.probability - true) <= 1.645 * one.error for one in found)
    # Of 90 %, 31 or fewer of forty come by chance in one case of sixty.
    assert held >= 32
    assert max(one.error for one in found) <= 0.003 * min(true, 1.0 - true)


def test_the_error_of_a_share_of_what_exists_is_that_of_both_integrals() -> None:
    def beyond(X: Array) -> Array:
        return 1e4 * np.minimum(X[:, :1], X[:, 1:])

    beyond.exists = lambda X: 1e4 * (X[:, 1:] + 0.3 * X[:, :1] ** 2)  # type: ignore[attr-defined]
    alone = integrate(lambda X: beyond(X), normals(2), accuracy=0.01, rng=np.random.default_rng(0))
    share, again = (integrate(beyond, normals(2), accuracy=0.01, rng=np.random.default_rng(seed)) for seed in (0, 1))
    assert share.error[0] / share.probability[0] > 1.05 * alone.error[0] / alone.probability[0]
    assert share.probability[0] / alone.probability[0] != again.probability[0] / alone.probability[0]


def test_two_far_regions_are_both_found() -> None:
    def both(X: Array) -> Array:
        return ((np.abs(X[:, 0]) - 4.0) / 0.1)[:, None]

    true = 2.0 * float(ndtr(-4.0 / np.sqrt(1.01)))
    assert integrate(both, normals(4)).probability[0] == pytest.approx(true, rel=0.08)


def test_weighted_rows_are_summed() -> None:
    rows = WeightedRows(("x",), np.linspace(-1.0, 1.0, 5)[:, None], np.arange(1.0, 6.0))
    integral = integrate(lambda X: np.where(X > 0.2, np.inf, -np.inf), rows, contains=lambda X: X[:, 0] < 0.8)
    assert integral.probability[0] == pytest.approx(9.0 / 15.0)
    assert integral.outside[0] == pytest.approx(5.0 / 9.0)


def test_boundaries_with_latents_of_their_own_never_cross() -> None:
    rng = np.random.default_rng(0)
    z = 4.0 * rng.standard_normal((500, 2))
    p = outcome_probabilities(z, False)
    assert_allclose(p.sum(axis=1), 1.0, rtol=1e-12)
    probits = nested_probits(z, False)
    assert (probits[:, 1] <= probits[:, 0]).all()
    assert_allclose(ndtr(probits), np.column_stack([p[:, 1:].sum(axis=1), p[:, 2]]), rtol=1e-9)
    # A pulse far below friction cannot fail, whatever the latent of failure says there.
    assert ndtr(nested_probits(np.array([[-9.0, 0.3]]), False))[0, 1] < 1e-15


def test_levels_of_one_latent_keep_their_probabilities_to_the_last_digit() -> None:
    z = np.array([[3.0, -2.0], [-8.0, -8.5], [9.0, 8.0]])
    assert nested_probits(z, True) is z
    p = outcome_probabilities(z, True)
    assert_allclose(p[:, 2], ndtr(z[:, 1]), rtol=1e-12)
    assert_allclose(p[:, 0], ndtr(-z[:, 0]), rtol=1e-12)
    assert p[1, 1] == pytest.approx(float(ndtr(-8.0) - ndtr(-8.5)), rel=1e-12)
    assert p[2, 1] == pytest.approx(float(ndtr(-8.0) - ndtr(-9.0)), rel=1e-12)
