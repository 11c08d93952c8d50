from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import norm

from activefail.features import feature_map
from activefail.parameter import Parameter
from activefail.space import DesignSpace
from activefail.surrogate.classifier import Classifier, Moments, train

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


def test_outcomes_are_those_of_independent_boundaries_that_do_not_contradict_each_other(trained, fresh):
    hit, broken = (trained.latent(name).moments(trained.features(fresh)).probability for name in OUTCOMES[1:])
    joint = np.stack([(1 - hit) * (1 - broken), hit * (1 - broken), hit * broken], axis=1)
    expected = joint / (1 - (1 - hit) * broken)[:, None]
    assert trained.probabilities(fresh) == pytest.approx(expected, abs=1e-12)


def test_an_outcome_alone_beyond_its_boundary_has_its_latents_probability(fresh):
    X = SPACE.latin_hypercube(60, np.random.default_rng(0))
    two = train(X, (outcome_of(X) > 0).astype(np.int8), ("calm", "hit"), feature_map("design", SPACE), "rbf")
    moments = two.latent("hit").moments(two.features(fresh))
    expected = norm.cdf(moments.mean / np.sqrt(1.0 + moments.sd**2))
    assert two.probabilities(fresh)[:, 1] == pytest.approx(expected, abs=1e-12)


class Fixed(NamedTuple):
    """A latent of known mean, the same everywhere, without doubt."""

    mean: float

    def moments(self, F):
        return Moments(np.full(len(F), self.mean), np.zeros(len(F)))


def test_boundaries_that_contradict_each_other_share_the_blame():
    classifier = Classifier(OUTCOMES, feature_map("design", SPACE), (Fixed(-50.0), Fixed(50.0)))
    p = classifier.probabilities(SPACE.low[None])[0]
    assert p == pytest.approx([0.5, 0.0, 0.5], abs=1e-12)


def test_smooth_boundaries_are_learned(trained, fresh):
    assert np.mean(trained.probabilities(fresh).argmax(axis=1) == outcome_of(fresh)) > 0.97


def test_the_order_of_the_training_points_does_not_matter(trained, fresh):
    X = SPACE.latin_hypercube(150, np.random.default_rng(0))[::-1].copy()
    repeated = train(X, outcome_of(X), OUTCOMES, feature_map("design", SPACE), "rbf")
    assert repeated.probabilities(fresh) == pytest.approx(trained.probabilities(fresh), abs=5e-3)


def test_the_uncertainty_is_the_priors_far_away_and_smaller_at_the_points(trained):
    X = SPACE.latin_hypercube(150, np.random.default_rng(0))
    latent = trained.latent("broken")
    far = latent.moments(trained.features(np.array([[40.0, 100.0]]))).sd[0]
    at_points = latent.moments(trained.features(X)).sd
    assert far == pytest.approx(np.exp(0.5 * latent.trained.hyperparameters.log_outputscale), rel=1e-3)
    assert at_points.max() < 0.75 * far
    assert np.median(at_points) < 0.4 * far


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
