"""Predictions from a saved state, without torch, against those of the classifier that was saved."""

import numpy as np
import pytest
import torch

from activefail.features import feature_map
from activefail.parameter import Parameter
from activefail.space import DesignSpace
from activefail.surrogate import margin
from activefail.surrogate.classifier import Latent, LearnableMargins, train
from activefail.surrogate.covariance import Hyperparameters
from activefail.surrogate.fitting import Fit
from activefail.surrogate.margin import MarginLatent
from activefail.surrogate.saved import SavedClassifier, SavedLatent
from activefail.surrogate.sites import Sites
from activefail.surrogate.state import classifier_from_state, classifier_state, saved_classifier

SPACE = DesignSpace((Parameter("a", -1.0, 3.0), Parameter("b", 1.0, 20.0, distribution="log_uniform")))
FEATURES = feature_map("design", SPACE)
OUTCOMES = ("calm", "hit", "broken")
FRESH = SPACE.latin_hypercube(500, np.random.default_rng(1))


def level(X):
    return X[:, 0] + 0.2 * (X[:, 1] - 10.0)


def trained(kernel, truncated=None):
    """A classifier of 120 designs and what it was trained on; its boundaries are learned from margins if asked for."""
    X = SPACE.latin_hypercube(120, np.random.default_rng(0))
    outcome = np.digitize(level(X), [0.6, 1.4]).astype(np.int8)
    margins = None
    if truncated is not None:
        values = np.stack([(limit - level(X))[:, None] for limit in (0.6, 1.4)])
        # A simulation that ends at failure reports 0.
        values = np.where(truncated & (values < 0.0), 0.0, values)
        margins = LearnableMargins(values, np.array([[-0.6], [-1.4]]), (0,), required=True)
    given = (X, outcome, OUTCOMES, FEATURES, kernel)
    return train(*given, None, margins), (*given, margins)


CASES = {"rbf": ("rbf",), "matern52": ("matern52",), "margin": ("rbf", False), "truncated margin": ("rbf", True)}


@pytest.fixture(scope="module", params=CASES)
def learned(request):
    return trained(*CASES[request.param])


def assert_same_moments(ours, theirs):
    # The condition of K + W⁻¹ is that of a prior of variance up to 1e4 with a jitter of 1e-6.
    assert ours.mean == pytest.approx(theirs.mean, rel=1e-8, abs=1e-8)
    assert ours.sd == pytest.approx(theirs.sd, rel=1e-6, abs=1e-8)


def test_the_moments_are_those_of_the_classifier(learned):
    classifier, given = learned
    saved = saved_classifier(classifier_state(classifier), *given)
    F = FEATURES(FRESH)
    assert saved.features(FRESH).tobytes() == F.tobytes()
    for ours, theirs in zip(saved.latents, classifier.latents, strict=True):
        assert isinstance(ours, SavedLatent | MarginLatent)
        assert_same_moments(ours.moments(F), theirs.moments(F))
        # At the training points variances are the smallest.
        assert_same_moments(ours.moments(theirs.features), theirs.moments(theirs.features))


@pytest.mark.parametrize("truncated", [False, True])
def test_a_state_gives_the_bits_of_a_classifier_with_a_support(truncated, monkeypatch):
    monkeypatch.setattr(margin, "LEARNED_ON", 50)
    monkeypatch.setattr(margin, "COARSE", 40)
    monkeypatch.setattr(margin, "EXACT", 80)
    classifier, given = trained("rbf", truncated)
    state = classifier_state(classifier)
    assert state["hit/support"] == 80
    restored = classifier_from_state(state, *given)
    for one, other in zip(classifier.latents, restored.latents, strict=True):
        assert np.stack(one.moments(FEATURES(FRESH))).tobytes() == np.stack(other.moments(FEATURES(FRESH))).tobytes()


def test_a_state_gives_the_bits_of_the_classifier_that_was_just_trained(learned):
    classifier, given = learned
    F = FEATURES(FRESH)
    here, there = SavedClassifier.of(classifier), saved_classifier(classifier_state(classifier), *given)
    for one, other in zip(here.latents, there.latents, strict=True):
        assert np.stack(one.moments(F)).tobytes() == np.stack(other.moments(F)).tobytes()


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_inducing_points_give_the_moments_of_the_classifier(kernel):
    rng = np.random.default_rng(2)
    F = torch.from_numpy(rng.normal(size=(300, 2)))
    labels = torch.where(F.sum(1) > 0.2, 1.0, -1.0).double()
    sites = Sites(labels * torch.from_numpy(rng.uniform(0.1, 2.0, 300)), torch.from_numpy(rng.uniform(0.01, 2.0, 300)))
    scales = Hyperparameters(0.3, np.log(30.0), np.log([0.8, 1.5]))
    rows = torch.from_numpy(rng.choice(300, 25, replace=False))
    latent = Latent(Fit(kernel, F, labels, scales, sites, 0.0, 0, 300, rows))
    at = FEATURES(FRESH)
    assert_same_moments(SavedLatent.of(latent).moments(at), latent.moments(at))


def test_far_outside_the_space_the_moments_are_those_of_the_classifier(learned):
    classifier, _ = learned
    F = np.array([[1e300, 0.0], [-1e300, 1e5], [0.0, 0.0]])
    for ours, theirs in zip(SavedClassifier.of(classifier).latents, classifier.latents, strict=True):
        assert_same_moments(ours.moments(F), theirs.moments(F))


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("hit/mean", np.float64(np.nan)),
        ("hit/log_lengthscale", np.zeros(3)),
        ("hit/site_linear", np.zeros(3)),
    ],
)
def test_a_state_that_training_cannot_produce_is_refused(name, array):
    classifier, given = trained("rbf")
    with pytest.raises((ArithmeticError, LookupError, RuntimeError, TypeError, ValueError)):
        saved_classifier(classifier_state(classifier) | {name: array}, *given)
