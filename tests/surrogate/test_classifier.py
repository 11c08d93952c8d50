import numpy as np
import pytest
from scipy.stats import norm

from activefail.features import feature_map
from activefail.space import DesignSpace, Parameter
from activefail.surrogate.classifier import train

SPACE = DesignSpace((Parameter("a", -1.0, 3.0), Parameter("b", 10.0, 20.0)))
OUTCOMES = ("calm", "hit", "broken")


def outcome_of(X):
    level = X[:, 0] + 0.2 * (X[:, 1] - 15.0)
    return np.digitize(level, [0.6, 1.4]).astype(np.int8)


@pytest.fixture(scope="module")
def trained():
    X = SPACE.latin_hypercube(150, np.random.default_rng(0))
    return train(X, outcome_of(X), OUTCOMES, feature_map("design", SPACE), "rbf")


@pytest.fixture(scope="module")
def fresh():
    return SPACE.latin_hypercube(2000, np.random.default_rng(1))


def test_the_probabilities_of_the_outcomes_sum_to_one(trained, fresh):
    p = trained.probabilities(fresh)
    assert p.shape == (2000, 3)
    assert p.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert p.min() >= 0.0


def test_the_probability_of_the_worst_outcome_is_its_own_latents(trained, fresh):
    moments = trained.latent("broken").moments(trained.features(fresh))
    expected = norm.cdf(moments.mean / np.sqrt(1.0 + moments.sd**2))
    assert trained.probabilities(fresh)[:, 2] == pytest.approx(expected, abs=1e-12)


def test_smooth_boundaries_are_learned(trained, fresh):
    assert np.mean(trained.probabilities(fresh).argmax(axis=1) == outcome_of(fresh)) > 0.97


def test_the_order_of_the_training_points_does_not_matter(trained, fresh):
    X = SPACE.latin_hypercube(150, np.random.default_rng(0))[::-1].copy()
    again = train(X, outcome_of(X), OUTCOMES, feature_map("design", SPACE), "rbf")
    assert again.probabilities(fresh) == pytest.approx(trained.probabilities(fresh), abs=5e-3)


def test_the_uncertainty_is_larger_away_from_the_points(trained):
    X = SPACE.latin_hypercube(150, np.random.default_rng(0))
    latent = trained.latent("broken")
    far = trained.features(np.array([[40.0, 100.0]]))
    assert latent.moments(far).sd[0] > 2.0 * latent.moments(trained.features(X)).sd.max()


def test_joint_and_marginal_moments_agree(trained, fresh):
    latent, F = trained.latent("hit"), trained.features(fresh[:50])
    mean, covariance = latent.joint(F)
    moments = latent.moments(F)
    assert mean == pytest.approx(moments.mean, abs=1e-9)
    assert np.sqrt(covariance.diagonal()) == pytest.approx(moments.sd, abs=1e-6)


def test_botorch_sees_an_ordinary_posterior(trained, fresh):
    import torch

    F = trained.features(fresh[:6])
    posterior = trained.latent("hit").model.posterior(torch.from_numpy(F).unsqueeze(1))
    assert posterior.mean.shape == (6, 1, 1)
    assert posterior.mean.squeeze().numpy() == pytest.approx(trained.latent("hit").moments(F).mean, abs=1e-9)
