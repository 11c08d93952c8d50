"""The probability under a classifier's posterior, and the places where failure may hide from it."""

import numpy as np
import pytest
from scipy.special import ndtr

from activefail.estimates.hidden import OUTSIDE, hidden_places
from activefail.estimates.model_probability import model_probability
from activefail.learning.features import feature_map
from activefail.learning.model.boundary_gp import joint
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import Latent, VariationalGP
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace, radius

SPACE = DesignSpace(tuple(Parameter(name, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for name in ("x", "y")))
FEATURES = feature_map("design", SPACE)


def trained(n: int, exists_below: float = np.inf) -> Classifier:
    X = np.clip(2.0 * SPACE.latin_hypercube(n, np.random.default_rng(n)), -6.4, 6.4)
    latent = MarginLatent(fit_margin(FEATURES(X), 3.0 - X[:, 0] + 0.3 * np.sin(3.0 * X[:, 1])))
    lost = X[:, 0] > exists_below
    impossible = VariationalGP().learned(FEATURES(X), lost) if lost.any() else None
    return Classifier(("safe", "failure"), FEATURES, (latent,), impossible=impossible)


@pytest.mark.parametrize(("n", "exists_below"), [(8, np.inf), (20, 3.5)])
def test_the_posterior_of_the_probability_is_that_of_paths_everywhere(n: int, exists_below: float) -> None:
    classifier, rng = trained(n, exists_below), np.random.default_rng(1)
    mean, sd, error = model_probability(classifier, FEATURES, SPACE, "failure", 20_000, rng)
    assert error < 0.03 * mean
    latent = classifier.latents[0]
    # Paths on a grid that covers the plane.
    axis = np.linspace(-5.0, 5.0, 41)
    grid = np.stack([one.ravel() for one in np.meshgrid(axis, axis)], axis=1)
    weight = np.exp(-0.5 * (grid**2).sum(axis=1))
    weight /= weight.sum()

    def paths(latent: Latent | MarginLatent) -> Array:
        center, covariance = joint(latent.model, FEATURES(grid))
        values, vectors = np.linalg.eigh(covariance)
        return center + rng.standard_normal((400, len(grid))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T

    beyond = paths(latent) > 0.0
    exists = 1.0 if classifier.impossible is None else ndtr(-paths(classifier.impossible))
    shares = (beyond * exists) @ weight / np.mean((np.ones(beyond.shape) * exists) @ weight)
    assert mean == pytest.approx(shares.mean(), rel=0.15)
    assert sd == pytest.approx(shares.std(), rel=0.25)


def test_more_simulations_make_the_posterior_narrower() -> None:
    few, many = (
        model_probability(trained(n), FEATURES, SPACE, "failure", 12_000, np.random.default_rng(0)) for n in (8, 40)
    )
    assert many[1] / many[0] < 0.5 * few[1] / few[0]


def test_hidden_places_lie_in_the_ball_that_matters_and_away_from_all_that_is_known() -> None:
    known = SPACE.latin_hypercube(30, np.random.default_rng(0))
    probability = float(ndtr(-3.0))
    places = hidden_places(SPACE, known, probability, 8, np.random.default_rng(1))
    assert places.shape == (8, 2)
    assert (np.linalg.norm(places, axis=1) <= radius(OUTSIDE * probability, 2) + 1e-9).all()
    everything = np.concatenate([known, places])
    for row in range(8):
        others = np.delete(everything, 30 + row, axis=0)
        assert np.linalg.norm(others - places[row], axis=1).min() > 0.7


def test_distances_of_hidden_places_are_those_of_the_given_coordinates() -> None:
    # Only the first variable counts, so the places spread along it.
    known = np.zeros((1, 1))
    places = hidden_places(SPACE, known, 0.01, 8, np.random.default_rng(1), lambda Z: Z[:, :1])
    along, across = np.sort(places[:, 0]), places[:, 1]
    assert np.diff(along).min() > 0.3
    assert along[-1] - along[0] > 4.0
    assert np.abs(across).min() < 0.3


def test_a_probability_near_one_still_gives_a_ball() -> None:
    places = hidden_places(SPACE, np.zeros((1, 2)), 1.0, 3, np.random.default_rng(1))
    assert np.isfinite(places).all()
