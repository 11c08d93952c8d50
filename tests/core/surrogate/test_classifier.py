from typing import NamedTuple

import numpy as np
import pytest
import torch
from scipy.stats import norm
from surrogate.labelled import MATERN52, RBF

from activefail.learning.features import feature_map
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.fitting import fit
from activefail.learning.model.moments import Moments
from activefail.learning.model.training import train
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SPACE = DesignSpace((Parameter("a", -1.0, 3.0), Parameter("b", 10.0, 20.0)))
FEATURES = feature_map("design", SPACE)
OUTCOMES = ("calm", "hit", "broken")
X = SPACE.latin_hypercube(150, np.random.default_rng(0))


def outcome_of(X):
    level = X[:, 0] + 0.2 * (X[:, 1] - 15.0)
    return np.digitize(level, [0.6, 1.4]).astype(np.int8)


@pytest.fixture(scope="module")
def trained():
    return train(X, outcome_of(X), OUTCOMES, FEATURES, RBF)


@pytest.fixture(scope="module")
def fresh():
    return SPACE.latin_hypercube(2000, np.random.default_rng(1))


def test_outcomes_are_those_of_independent_boundaries_that_do_not_contradict_each_other(trained, fresh):
    hit, broken = (trained.latent(name).moments(FEATURES(fresh)).probability for name in OUTCOMES[1:])
    joint = np.stack([(1 - hit) * (1 - broken), hit * (1 - broken), hit * broken], axis=1)
    expected = joint / (1 - (1 - hit) * broken)[:, None]
    p = trained.probabilities(fresh)
    assert p == pytest.approx(expected, abs=1e-12)
    assert p.sum(axis=1) == pytest.approx(1.0, abs=1e-12)


def test_an_outcome_alone_beyond_its_boundary_has_its_latents_probability(fresh):
    two = train(X[:60], (outcome_of(X[:60]) > 0).astype(np.int8), ("calm", "hit"), FEATURES, RBF)
    moments = two.latent("hit").moments(FEATURES(fresh))
    expected = norm.cdf(moments.mean / np.sqrt(1.0 + moments.sd**2))
    assert two.probabilities(fresh)[:, 1] == pytest.approx(expected, abs=1e-12)


class Fixed(NamedTuple):
    """A latent of known mean, the same everywhere, without doubt."""

    mean: float
    margin_data: None = None

    def moments(self, F):
        return Moments(np.full(len(F), self.mean), np.zeros(len(F)))


def test_boundaries_that_contradict_each_other_share_the_blame():
    classifier = Classifier(OUTCOMES, FEATURES, (Fixed(-50.0), Fixed(50.0)))
    p = classifier.probabilities(SPACE.low[None])[0]
    assert p == pytest.approx([0.5, 0.0, 0.5], abs=1e-12)


def test_smooth_boundaries_are_learned_whatever_the_order_of_the_designs(trained, fresh):
    assert np.mean(trained.probabilities(fresh).argmax(axis=1) == outcome_of(fresh)) > 0.97
    reversed_order = train(X[::-1].copy(), outcome_of(X[::-1]), OUTCOMES, FEATURES, RBF)
    assert reversed_order.probabilities(fresh) == pytest.approx(trained.probabilities(fresh), abs=5e-3)


def test_boundaries_that_train_at_the_same_time_have_the_bits_of_one_after_the_other():
    F, outcome = torch.from_numpy(FEATURES(X)), outcome_of(X)
    together = train(X, outcome, OUTCOMES, FEATURES, MATERN52)
    for severity, latent in enumerate(together.latents, start=1):
        alone = fit(F, torch.from_numpy((outcome >= severity).astype(float)), MATERN52.default_prior)
        for name, array in alone.prior.arrays.items():
            assert latent.trained.prior.arrays[name].tobytes() == array.tobytes()
        assert all(torch.equal(*pair) for pair in zip(latent.trained.sites, alone.sites, strict=True))
