"""Proposals from a margin: the designs that leave the least doubt about the boundary."""

import numpy as np
import pytest
import torch
from rare import four_branch
from scipy.integrate import quad
from scipy.special import ndtr
from scipy.stats import norm

from activefail.learning.criteria import by_margin
from activefail.learning.criteria.batch_proposal import propose
from activefail.learning.criteria.by_margin import doubt, doubtful_population
from activefail.learning.criteria.criteria import criterion
from activefail.learning.features import feature_map
from activefail.learning.model.boundary_gp import joint
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SPACE = DesignSpace(tuple(Parameter(name, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for name in ("x", "y")))
FEATURES = feature_map("design", SPACE)


def latent(n: int = 20, seed: int = 0) -> MarginLatent:
    # Twice as wide as the design measure, so that some designs fail.
    X = np.clip(2.0 * SPACE.latin_hypercube(n, np.random.default_rng(seed)), -6.4, 6.4)
    return MarginLatent(fit_margin(FEATURES(X), four_branch(X)))


def expected_doubt(*arrays: np.ndarray) -> np.ndarray:
    return by_margin.expected_doubt(*(torch.from_numpy(array) for array in arrays)).numpy()


def proposed(surrogate: MarginLatent, q: int, **known: np.ndarray) -> np.ndarray:
    return propose(surrogate, FEATURES, SPACE, criterion("entropy"), q, np.random.default_rng(1), **known)


def test_the_expected_doubt_is_that_over_the_margins_that_may_come() -> None:
    rng = np.random.default_rng(3)
    A = rng.standard_normal((4, 4))
    K, mean = A @ A.T + np.eye(4), np.array([0.5, -0.3, 1.0, 0.0])
    expected = expected_doubt(mean[1:], np.sqrt(K.diagonal()[1:]), K[:1, 0], K[:1, 1:])[0]
    z = rng.standard_normal(200_000)
    for row in range(3):
        shift = K[0, row + 1] / np.sqrt(K[0, 0])
        left = np.sqrt(K[row + 1, row + 1] - shift**2)
        simulated = doubt((mean[row + 1] + shift * z) / left)
        assert expected[row] == pytest.approx(simulated.mean(), abs=3e-3)
    # What is learned never adds doubt on average.
    assert (expected <= doubt(mean[1:] / np.sqrt(K.diagonal()[1:])) + 1e-3).all()


@pytest.mark.parametrize("rho", [0.1, 0.6, 0.9, 0.99, 0.999, 0.99999])
def test_the_expected_doubt_is_that_of_numerical_integration_at_every_correlation(rho: float) -> None:
    for b in np.linspace(-4.0, 4.0, 9):
        left = np.sqrt(1.0 - rho**2)

        def integrand(z: float, b: float = b, left: float = left) -> float:
            return float(doubt(np.array(z)) * norm.pdf((left * z - b) / rho) * left / rho)

        parts = [(-40.0, -3.0), (-3.0, 0.0), (0.0, 3.0), (3.0, 40.0)]
        exact = sum(quad(integrand, low, high, epsabs=0.0, epsrel=1e-10)[0] for low, high in parts)
        one = np.ones(1)
        # The sum of Gaussian functions is accurate to 3e-5.
        assert expected_doubt(b * one, one, one, rho * np.ones((1, 1)))[0, 0] == pytest.approx(exact, rel=4e-5)


def test_a_known_margin_leaves_no_doubt_where_it_was_simulated() -> None:
    assert expected_doubt(np.array([0.2]), np.array([1.0]), np.array([1.0]), np.array([[1.0]]))[0, 0] < 1e-6


def test_proposals_lie_where_the_side_is_in_doubt_and_differ() -> None:
    surrogate = latent()
    designs = proposed(surrogate, 6)
    assert designs.shape == (6, 2)
    assert SPACE.contains(designs).all()
    assert len(np.unique(designs, axis=0)) == 6
    moments = surrogate.moments(FEATURES(designs))
    assert (np.abs(moments.standardised) < 3.5).all()
    # In units of the posterior they are apart: none repeats another.
    _, covariance = joint(surrogate.model, FEATURES(designs))
    correlation = covariance / np.sqrt(np.outer(covariance.diagonal(), covariance.diagonal()))
    assert (np.abs(correlation - np.eye(6)) < 0.98).all()


def test_pending_and_failed_designs_are_not_proposed_again() -> None:
    surrogate = latent()
    first = proposed(surrogate, 4)
    for known in ({"pending": first}, {"failed": first}):
        again = proposed(surrogate, 4, **known)
        assert np.linalg.norm(again[:, None] - first[None], axis=2).min() > 0.05


def test_a_doubtful_population_holds_many_designs_in_doubt() -> None:
    surrogate = latent()
    drawn, F, standardised = doubtful_population(surrogate.model, FEATURES, SPACE, 4000, np.random.default_rng(0))
    np.testing.assert_array_equal(F, FEATURES(drawn.X))
    plain = SPACE.from_unit(np.random.default_rng(0).random((4000, 2)))
    share = np.mean(np.abs(surrogate.moments(FEATURES(plain)).standardised) < 2.0)
    assert np.mean(np.abs(standardised) < 2.0) > 2.0 * share
    assert np.mean(drawn.weight * ndtr(standardised)) < 0.2
