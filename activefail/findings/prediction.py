"""Predictions of a campaign's classifier: probabilities and their intervals."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from activefail.campaign.assembly import Campaign
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Moments
from activefail.surrogate.moments import MarginMoments, outcome_probabilities
from activefail.surrogate.saved import SavedClassifier

CONFIDENCE = 0.95
"""Confidence of the intervals of probabilities in the report and the explorer."""

_Z = 1.959964


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


def interval(moments: Moments) -> tuple[Array, Array]:
    """95 % interval of the probability Φ(f) from the uncertainty of the latent f, (n,) each.

    It is widened to contain the reported probability, the mean of Φ(f), which can fall outside near 0 and 1. Where the
    boundary is learned from a margin, the outcome is certain but for the side: the interval is 0, 1 or both.
    """
    if isinstance(moments, MarginMoments):
        ends = (moments.mean + sign * _Z * moments.sd > 0.0 for sign in (-1.0, 1.0))
        low, high = (end.astype(np.float64) for end in ends)
        return np.minimum(low, moments.probability), np.maximum(high, moments.probability)
    low, high = (np.asarray(ndtr(moments.mean + sign * _Z * moments.sd)) for sign in (-1.0, 1.0))
    return np.minimum(low, moments.probability), np.maximum(high, moments.probability)


def predict(campaign: Campaign, classifier: Classifier, X: Array) -> Prediction:
    """Predict the outcomes of designs, (n, d)."""
    F = campaign.features(X)
    latents = [latent.moments(F) for latent in classifier.latents]
    moments = latents[campaign.severity - 1]
    return Prediction(
        outcome_probabilities(latents),
        *interval(moments),
        moments.probability,
        moments.mean,
        moments.sd,
    )


def predicted_values(campaign: Campaign, classifier: SavedClassifier, X: Array) -> Array:
    """The values of `predicted_columns` for designs, (n, d) -> (n, number of outcomes + 2)."""
    F = classifier.features(X)
    latents = [latent.moments(F) for latent in classifier.latents]
    moments = latents[campaign.severity - 1]
    return np.column_stack([outcome_probabilities(latents), moments.mean, moments.sd])
