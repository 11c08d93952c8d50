"""How good a classifier is on fresh designs: the figures by which samplings are compared."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier

NEIGHBOURS = 4
"""Displaced copies of each test design that tell what is near a boundary."""

DISPLACEMENT = 0.02
"""Standard deviation of their displacement, in units of the variables' ranges."""


@dataclass(frozen=True)
class FreshSet:
    """Fresh designs with their outcomes.

    Attributes:
        X: (n, d) designs, uniform over the design space.
        outcome: (n,) int8.
        around: (n, NEIGHBOURS) int8, outcomes of designs displaced from each by `DISPLACEMENT`; -1 without an answer.
    """

    X: Array
    outcome: NDArray[np.int8]
    around: NDArray[np.int8]


def displaced(X: Array, space: DesignSpace, rng: np.random.Generator) -> Array:
    """`NEIGHBOURS` designs near each of X, (n, d) -> (n·NEIGHBOURS, d), folded back at the bounds."""
    unit = np.repeat(space.to_unit(X), NEIGHBOURS, axis=0)
    unit = np.abs(unit + DISPLACEMENT * rng.standard_normal(unit.shape))
    return space.from_unit(1.0 - np.abs(1.0 - unit))


def expected_calibration_error(p: Array, y: NDArray[np.bool_], bins: int = 10) -> float:
    """Σ (n_bin/n)·|mean p − share of y| of probabilities, (n,), over bins of equal width."""
    place = np.clip((p * bins).astype(int), 0, bins - 1)
    return float(np.abs(np.bincount(place, weights=p - y, minlength=bins)).sum() / len(p))


def measures(classifier: Classifier, severity: int, test: FreshSet) -> dict[str, float]:
    """All figures of a classifier, by name.

    - accuracy: share of designs on the right side of the sought boundary.
    - accuracy_near: the same of designs whose own side differs from that of a displaced copy.
    - recall_small: share predicted beyond the boundary of those designs beyond it, at least half of whose displaced
      copies are not: thin or small regions. NaN where the test set has none.
    - log_score: mean log probability of the true side [nat]; calibration_error: of the probability of the far side.
    - accuracy_NAME: for the boundary below each outcome.
    - outcome_accuracy, outcome_log_score: for the outcomes themselves.
    """
    F = classifier.features(test.X)
    latent = classifier.latents[severity - 1].moments(F)
    beyond, predicted = test.outcome >= severity, latent.mean > 0.0
    right = predicted == beyond
    answered = test.around != NUMERICAL_FAILURE
    elsewhere = answered & ((test.around >= severity) != beyond[:, None])
    near = elsewhere.any(axis=1)
    small = beyond & (2 * elsewhere.sum(axis=1) >= np.maximum(answered.sum(axis=1), 1))
    p_side = np.where(beyond, latent.probability, 1.0 - latent.probability)
    probabilities = classifier.probabilities(test.X)
    p_outcome = probabilities[np.arange(len(test.X)), test.outcome]

    def share(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
        return float(np.mean(of[among])) if among.any() else float("nan")

    return {
        "accuracy": float(right.mean()),
        "accuracy_near": share(right, near),
        "recall_small": share(predicted, small),
        "log_score": float(np.mean(np.log(np.clip(p_side, 1e-12, None)))),
        "calibration_error": expected_calibration_error(latent.probability, beyond),
        **{
            f"accuracy_{name}": float(np.mean((other.moments(F).mean > 0.0) == (test.outcome >= least)))
            for least, (name, other) in enumerate(zip(classifier.outcomes[1:], classifier.latents, strict=True), 1)
        },
        "outcome_accuracy": float(np.mean(np.argmax(probabilities, axis=1) == test.outcome)),
        "outcome_log_score": float(np.mean(np.log(np.clip(p_outcome, 1e-12, None)))),
    }
