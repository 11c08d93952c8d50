"""Measures of a classifier on fresh designs, by which samplings are compared."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.estimates.scores import log_score, probability_of_truth
from activefail.learning.model.classifier import Classifier
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space.space import Array, DesignSpace

NEIGHBOURS = 4
"""Displaced copies of each test design, which show whether it is near a boundary."""

DISPLACEMENT = 0.02
"""Standard deviation of their displacement, in units of the variables' ranges."""


@dataclass(frozen=True)
class FreshSet:
    """Fresh designs with their outcomes.

    Attributes:
        X: (n, d) designs, drawn from the design measure.
        outcome: (n,) int8.
        around: (n, NEIGHBOURS) int8, outcomes of its displaced copies; -1 for a numerical failure.
    """

    X: Array
    outcome: NDArray[np.int8]
    around: NDArray[np.int8]


def displaced(X: Array, space: DesignSpace, rng: np.random.Generator) -> Array:
    """`NEIGHBOURS` displaced copies of each design, (n, d) -> (n·NEIGHBOURS, d), reflected at the bounds."""
    unit = np.repeat(space.to_unit(X), NEIGHBOURS, axis=0)
    unit = np.abs(unit + DISPLACEMENT * rng.standard_normal(unit.shape))
    return space.from_unit(1.0 - np.abs(1.0 - unit))


def expected_calibration_error(p: Array, y: NDArray[np.bool_], bins: int = 10) -> float:
    """Σ (n_bin/n)·|mean p − share of y| of probabilities p, (n,), over bins of equal width."""
    bin_index = np.clip((p * bins).astype(int), 0, bins - 1)
    return float(np.abs(np.bincount(bin_index, weights=p - y, minlength=bins)).sum() / len(p))


def measures(classifier: Classifier, severity: int, test: FreshSet) -> dict[str, float]:
    """All measures of a classifier, by name.

    - accuracy: share of designs on the right side of the target boundary.
    - accuracy_near: the same for designs with a displaced copy on the other side.
    - recall_small: the same for designs beyond the boundary with at least half of their displaced copies on the other
      side, that is, in thin or small regions. NaN if the test set has none.
    - log_score: mean log probability of the true side [nat].
    - calibration_error: expected calibration error of the probability of lying beyond the boundary.
    - accuracy_NAME: accuracy for the boundary below each outcome.
    - outcome_accuracy, outcome_log_score: the same for the outcomes themselves.
    - recall_of_NAME: share of the designs with an outcome that are predicted to have it. NaN if the test set has none.
    """
    F = classifier.features(test.X)
    latent = classifier.latents[severity - 1].moments(F)
    beyond, predicted = test.outcome >= severity, latent.mean > 0.0
    right = predicted == beyond
    answered = test.around != NUMERICAL_FAILURE
    opposite = answered & ((test.around >= severity) != beyond[:, None])
    near = opposite.any(axis=1)
    small = beyond & (2 * opposite.sum(axis=1) >= np.maximum(answered.sum(axis=1), 1))
    probabilities = classifier.probabilities(test.X)
    p_outcome = probabilities[np.arange(len(test.X)), test.outcome]

    def share(hits: NDArray[np.bool_], subset: NDArray[np.bool_]) -> float:
        return float(np.mean(hits[subset])) if subset.any() else float("nan")

    return {
        "accuracy": float(right.mean()),
        "accuracy_near": share(right, near),
        "recall_small": share(predicted, small),
        "log_score": log_score(probability_of_truth(latent.probability, beyond)),
        "calibration_error": expected_calibration_error(latent.probability, beyond),
        **{
            f"accuracy_{name}": float(np.mean((other.moments(F).mean > 0.0) == (test.outcome >= least)))
            for least, (name, other) in enumerate(zip(classifier.outcomes[1:], classifier.latents, strict=True), 1)
        },
        "outcome_accuracy": float(np.mean(np.argmax(probabilities, axis=1) == test.outcome)),
        "outcome_log_score": log_score(p_outcome),
        **{
            f"recall_of_{name}": share(np.argmax(probabilities, axis=1) == code, test.outcome == code)
            for code, name in enumerate(classifier.outcomes)
        },
    }
