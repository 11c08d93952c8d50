"""Predictions of a campaign's classifier: probabilities and their intervals."""

from dataclasses import dataclass

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.moments import Predicted, binary_entropy

CONFIDENCE = 0.95
"""Confidence of the intervals of probabilities in the report and the explorer."""

_Z = 1.959964

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(20)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@dataclass(frozen=True)
class Prediction:
    """Predictions for n designs.

    Attributes:
        probabilities: (n, number of outcomes).
        low, high: (n,) interval of `beyond` from the latent's uncertainty.
        beyond: (n,) probability of lying beyond the target boundary.
        mean, sd: (n,) of that boundary's latent.
    """

    probabilities: Array
    low: Array
    high: Array
    beyond: Array
    mean: Array
    sd: Array


def interval(predicted: Predicted, severity: int) -> tuple[Array, Array]:
    """95 % interval of P(at least as severe) from the uncertainty of its boundary's latent f, (n,) each.

    It is widened to contain the reported probability, the mean over f, which can fall outside near 0 and 1. Where the
    boundary is learned from a margin, the outcome is certain but for the side: the interval is 0, 1 or both.
    """
    low, high = (predicted.beyond(severity, sign * _Z) for sign in (-1.0, 1.0))
    probability = predicted.beyond(severity)
    return np.minimum(low, probability), np.maximum(high, probability)


def information(predicted: Predicted, severity: int) -> Array:
    """What one simulation tells of P(at least as severe), (n,) [bit]: its entropy less that with a known latent."""
    p = np.array([predicted.beyond(severity, float(node)) for node in _NODES])
    return np.asarray(binary_entropy(_WEIGHTS @ p) - _WEIGHTS @ binary_entropy(p))


def predict(campaign: Campaign, classifier: Classifier, X: Array) -> Prediction:
    """Predict the outcomes of designs, (n, d)."""
    predicted = classifier.predicted(X)
    moments = predicted.moments[campaign.severity - 1]
    return Prediction(
        predicted.probabilities,
        *interval(predicted, campaign.severity),
        predicted.beyond(campaign.severity),
        moments.mean,
        moments.sd,
    )
