"""What a campaign's classifier predicts for designs: probabilities, and how sure they are."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from activefail.campaign.assembly import Campaign
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Moments

CONFIDENCE = 0.95
"""Of every interval that the report and the explorer show of a probability."""


_Z = 1.959964


@dataclass(frozen=True)
class Prediction:
    """What a classifier says of n designs.

    Attributes:
        probabilities: (n, number of outcomes).
        low, high: (n,) interval of the probability of being beyond the sought boundary, by the latent's uncertainty.
        beyond: (n,) that probability.
        mean, sd: (n,) of its latent.
    """

    probabilities: Array
    low: Array
    high: Array
    beyond: Array
    mean: Array
    sd: Array


def interval(moments: Moments) -> tuple[Array, Array]:
    """95 % interval of the probability Φ(f) by the uncertainty of the latent f, (n,) each.

    Widened to hold the probability that is told, the mean of Φ(f): next to 0 and 1 a long tail can pull that out of it.
    """
    low, high = (np.asarray(ndtr(moments.mean + sign * _Z * moments.sd)) for sign in (-1.0, 1.0))
    return np.minimum(low, moments.probability), np.maximum(high, moments.probability)


def predict(campaign: Campaign, classifier: Classifier, X: Array) -> Prediction:
    """What the classifier says of designs, (n, d)."""
    F = campaign.features(X)
    latents = [latent.moments(F) for latent in classifier.latents]
    moments = latents[campaign.severity - 1]
    return Prediction(
        classifier.weighed(latents),
        *interval(moments),
        moments.probability,
        moments.mean,
        moments.sd,
    )
