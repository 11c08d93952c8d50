"""The latent of a system: each mode learns its margin, and the system's side follows from them."""

import numpy as np
import pytest
import torch
from surrogate.labelled import RBF

from activefail.learning.criteria.by_margin import DoubtReduction
from activefail.learning.features import feature_map
from activefail.learning.model.boundary_gp import parts_of
from activefail.learning.model.margin import MarginLatent
from activefail.learning.model.margin_choice import OUTCOMES, LearnableMargins, usable
from activefail.learning.model.saved import saved_classifier
from activefail.learning.model.state import classifier_from_state, classifier_state
from activefail.learning.model.system import SystemLatent
from activefail.learning.model.training import fit_defined, fit_system, train
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace
from activefail.space.systems import parse_system

SPACE = DesignSpace(tuple(Parameter(name, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for name in ("x", "y")))
FEATURES = feature_map("design", SPACE)
SYSTEM = parse_system("min(a, max(b, c))", ["a", "b", "c"])
X = np.clip(2.0 * SPACE.latin_hypercube(30, np.random.default_rng(0)), -6.4, 6.4)
FRESH = FEATURES(SPACE.latin_hypercube(300, np.random.default_rng(1)))


def margins(X: np.ndarray) -> np.ndarray:
    x, y = X.T
    return np.column_stack([3.0 - x + 0.1 * y**2, 1.0 - y - 0.1 * x**2, 1.5 + x - 0.3 * y])


M = margins(X)
OUTCOME = (SYSTEM(M) <= 0.0).astype(np.int8)


def learned(M: np.ndarray, outcome: np.ndarray = OUTCOME, required: bool = False):
    known = LearnableMargins(M[None], np.zeros((1, 3)), (0,), required, SYSTEM)
    return train(X, outcome, ("safe", "failure"), FEATURES, RBF, None, known), known


def test_a_system_is_learned_from_its_modes_where_they_predict_better_than_outcomes() -> None:
    classifier, _ = learned(M)
    (latent,), (choice,) = classifier.latents, classifier.choices
    assert isinstance(latent, SystemLatent)
    assert choice.margin == 0
    assert choice.margin_score > choice.outcome_score
    fresh = SPACE.latin_hypercube(2000, np.random.default_rng(2))
    wrong = (latent.moments(FEATURES(fresh)).mean > 0.0) != (SYSTEM(margins(fresh)) <= 0.0)
    assert wrong.mean() < 0.005


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda M: -M, "its sign contradicts the outcome"),
        (lambda M: np.where([False, True, False], 1.0, M), "b is infinite, or has fewer than two different values"),
        (lambda M: np.where(np.arange(30)[:, None] == 3, np.inf, M), "a is infinite"),
        (lambda M: np.where([True, False, False], np.nan, M), "a is infinite, or has fewer"),
    ],
)
def test_margins_that_do_not_tell_the_side_are_not_used(change, reason: str) -> None:
    assert usable(change(M), OUTCOME == 1, SYSTEM).startswith(reason)
    assert learned(change(M), required=True)[0].choices[0].margin == OUTCOMES


def test_a_mode_learns_from_the_simulations_that_have_its_margin() -> None:
    decided = np.flatnonzero((M[:, 0] <= 0.0) | (M[:, 2] > 0.0))[:8]
    partly = M.copy()
    partly[decided, 1] = np.nan  # the side does not depend on it
    latent = learned(partly)[0].latents[0]
    assert isinstance(latent, SystemLatent)
    rest = np.setdiff1d(np.arange(30), decided)
    alone = MarginLatent(fit_defined(FEATURES(X[rest]), M[rest, 1]))
    assert (latent.modes[1].moments(FRESH).mean == alone.moments(FRESH).mean).all()
    assert np.isfinite(latent.left_out().side).all()


@pytest.mark.parametrize("missing", [0, 5])
def test_a_saved_system_predicts_and_learns_as_before(missing: int) -> None:
    rows = np.flatnonzero(M[:, 0] <= 0.0)[:missing]
    partly = M.copy()
    partly[rows, 2] = np.nan
    classifier, known = learned(partly)
    state = classifier_state(classifier)
    again = classifier_from_state(state, X, OUTCOME, ("safe", "failure"), FEATURES, RBF, known)
    saved = saved_classifier(state, X, ("safe", "failure"), FEATURES, "rbf", known)
    np.testing.assert_array_equal(again.latents[0].moments(FRESH), classifier.latents[0].moments(FRESH))
    assert saved.latents[0].system == SYSTEM
    for ours, theirs in zip(saved.latents[0].modes, classifier.latents[0].modes, strict=True):
        one, other = ours.moments(FRESH), theirs.moments(FRESH)
        # `MarginFit.model` rounds its mean to single precision.
        rounded = np.finfo(np.float32).eps * max(1.0, abs(theirs.trained.mean))
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=rounded)
        np.testing.assert_allclose(one.sd, other.sd, rtol=1e-9, atol=1e-9)


def test_a_design_teaches_the_mode_that_decides_there() -> None:
    latent = fit_system(FEATURES(X), M, SYSTEM)
    references = torch.from_numpy(FRESH)
    parts = parts_of(latent.model, references)
    assert (sum(part for _, part in parts) == 1.0).all()
    candidates = torch.from_numpy(FEATURES(SPACE.latin_hypercube(20, np.random.default_rng(3))))[:, None]
    weight = torch.ones(len(references), dtype=torch.float64)
    of_modes = [DoubtReduction(mode, references, part)(candidates) for mode, part in parts]
    together = DoubtReduction(latent.model, references, weight)(candidates)
    np.testing.assert_allclose(together.numpy(), sum(of_modes).numpy(), rtol=1e-12)
    assert together.max() > 0.0


def test_a_margin_deviates_where_its_mode_decides() -> None:
    latent = fit_system(FEATURES(X), M, SYSTEM)
    fresh = SPACE.latin_hypercube(200, np.random.default_rng(4))
    F, true = FEATURES(fresh), margins(fresh)
    decides = SYSTEM.deciding(latent.sides(F))
    changed = np.where(np.arange(3) == decides[:, None], true, true + 100.0)
    np.testing.assert_array_equal(latent.deviations(F, changed), latent.deviations(F, true))
    assert (np.abs(latent.deviations(F, true + 100.0)) > 100.0).all()
