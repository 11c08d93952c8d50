"""Predictions from a saved state, without torch, against those of the classifier that was saved."""

import subprocess
import sys

import numpy as np
import pytest
from surrogate.labelled import MATERN52, RBF

from activefail.learning.features import feature_map
from activefail.learning.model import fitting, margin, margin_data
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.margin_choice import LearnableMargins
from activefail.learning.model.saved import saved_classifier
from activefail.learning.model.state import classifier_from_state, classifier_state
from activefail.learning.model.training import train
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SPACE = DesignSpace((Parameter("a", -1.0, 3.0), Parameter("b", 1.0, 20.0, distribution="log_uniform")))
FEATURES = feature_map("design", SPACE)
OUTCOMES = ("calm", "hit", "broken")
LEARNERS = {"rbf": RBF, "matern52": MATERN52, "noisy": VariationalGP("rbf", repeatable=False)}
FAR = np.array([[1e300, 0.0], [-1e300, 1e5], [0.0, 0.0]])
FRESH = np.concatenate([FEATURES(SPACE.latin_hypercube(500, np.random.default_rng(1))), FAR])


def level(X):
    return X[:, 0] + 0.2 * (X[:, 1] - 10.0)


def trained(kernel, truncated=None, gives_up=0.0):
    """A classifier of 120 designs and what it was trained on; its boundaries are learned from margins if asked for.

    Simulations give up if the margin of the most severe outcome is smaller.
    """
    X = SPACE.latin_hypercube(120, np.random.default_rng(0))
    noise = 0.2 * np.random.default_rng(2).standard_normal(len(X)) if kernel == "noisy" else 0.0
    outcome = np.digitize(level(X) + noise, [0.6, 1.4 - gives_up]).astype(np.int8)
    margins = None
    if truncated is not None:
        values = np.stack([(limit - level(X) - noise)[:, None] for limit in (0.6, 1.4)])
        # A simulation that ends at failure reports 0.
        values = np.where(truncated & (values < 0.0), 0.0, values)
        if gives_up:
            values[:, outcome == 2] = np.nan
        margins = LearnableMargins(values, np.array([[-0.6], [-1.4]]), (0,), required=True)
    given = (X, outcome, OUTCOMES, FEATURES)
    return train(*given, LEARNERS[kernel], None, margins), given, margins


CASES = {
    "rbf": ("rbf",),
    "matern52": ("matern52",),
    "rbf, inducing": ("rbf",),
    "matern52, inducing": ("matern52",),
    "margin": ("rbf", False),
    "truncated margin": ("rbf", True),
    "margin that gives up": ("rbf", False, 0.3),
    "noisy margin": ("noisy", False),
    "truncated noisy margin": ("noisy", True),
    "margin, part of the designs": ("rbf", False),
    "truncated margin, part of the designs": ("rbf", True),
}


@pytest.fixture(scope="module", params=CASES)
def learned(request):
    """A classifier, what it was trained on, and the name of its kernel."""
    with pytest.MonkeyPatch.context() as patch:
        if "inducing" in request.param:
            patch.setattr(fitting, "EXACT", 80)
        if "part" in request.param:
            for name, size in (("EXACT", 40), ("MOST", 80), ("MOST_CENSORED", 20)):
                patch.setattr(margin_data, name, size)
            for name, size in (("EXACT", 40), ("LEARNED_ON", 60), ("WARPED_ON", 50), ("INDUCING", 30)):
                patch.setattr(margin, name, size)
        yield *trained(*CASES[request.param]), CASES[request.param][0]


def saved(state, given, margins, kernel):
    X, _, outcomes, features = given
    return saved_classifier(state, X, outcomes, features, kernel, margins)


def bits(latent):
    return np.stack(latent.moments(FRESH)).tobytes()


def test_the_moments_without_torch_are_those_of_the_classifier(learned):
    classifier, given, margins, kernel = learned
    without_torch = saved(classifier_state(classifier), given, margins, kernel)
    assert without_torch.features(given[0]).tobytes() == FEATURES(given[0]).tobytes()
    for ours, theirs in zip(without_torch.latents, classifier.latents, strict=True):
        # At the training points variances are the smallest.
        for F in (FRESH, theirs.features):
            one, other = ours.moments(F), theirs.moments(F)
            assert type(one) is type(other)
            # `MarginFit.model` rounds its mean to single precision; a noisy one's unit is its noise.
            rounded = 1e-9 if margins is None else 2e-6 if kernel == "noisy" else 2e-7
            assert one.mean == pytest.approx(other.mean, rel=1e-9, abs=rounded)
            # Far away the trend's variance is the difference of numbers a million times as large.
            assert one.sd == pytest.approx(other.sd, rel=1e-8, abs=1e-9)


def test_a_margin_of_a_former_version_has_no_trend():
    _, given, margins = trained("rbf", False)
    state = classifier_state(train(*given, LEARNERS["rbf"], None, margins))
    former = {name: array for name, array in state.items() if not name.endswith("raw_slope")}
    assert len(former) < len(state)
    without_torch = saved(former, given, margins, "rbf")
    for ours, theirs in zip(
        without_torch.latents, classifier_from_state(former, *given, LEARNERS["rbf"], margins).latents, strict=True
    ):
        one, other = ours.moments(FRESH), theirs.moments(FRESH)
        assert one.mean == pytest.approx(other.mean, rel=1e-9, abs=2e-7)
        assert one.sd == pytest.approx(other.sd, rel=1e-9, abs=1e-9)


def test_a_state_gives_the_bits_of_the_classifier_that_was_just_trained(learned):
    classifier, given, margins, kernel = learned
    state = classifier_state(classifier)
    restored = classifier_from_state(state, *given, LEARNERS[kernel], margins)
    assert [bits(latent) for latent in restored.latents] == [bits(latent) for latent in classifier.latents]
    assert classifier_state(restored).keys() == state.keys()


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("hit/mean_module.raw_constant", np.float64(np.nan)),
        ("hit/covar_module.base_kernel.raw_lengthscale", np.zeros((1, 3))),
        ("hit/covar_module.raw_outputscale", np.float64(1e300)),
        ("hit/site_linear", np.zeros(3)),
    ],
)
def test_a_state_that_training_cannot_produce_is_refused(name, array):
    classifier, given, _ = trained("rbf")
    state = classifier_state(classifier) | {name: array}
    for read in (
        lambda: saved(state, given, None, "rbf"),
        lambda: classifier_from_state(state, *given, RBF),
    ):
        with pytest.raises((ArithmeticError, LookupError, RuntimeError, TypeError, ValueError)):
            read()


@pytest.mark.parametrize("module", ["saved", "classifier"])
def test_what_predicts_from_a_saved_state_loads_no_torch(module):
    code = (
        f"import sys, activefail.learning.model.{module}; print(*{{'torch', 'gpytorch', 'botorch'}} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
