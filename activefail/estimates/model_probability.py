"""The probability beyond a boundary by the classifier alone, and the posterior sd of this probability."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from activefail.estimates.integral import ACCURACY, BoundariesOf, Lost, OfBoundary, both, integrate
from activefail.learning.criteria.by_margin import LEAST, POINTS, doubt, doubtful_population
from activefail.learning.features import FeatureMap
from activefail.learning.model.boundary_gp import joint
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import Latent
from activefail.learning.model.margin import MarginLatent
from activefail.learning.model.system import AnyLatent, ByMargins, SystemLatent
from activefail.space.space import Array, DesignSpace

_PATHS = 200
"""Joint paths of the latent that give the standard deviation of the probability."""

_COARSE = 0.1
"""Relative standard error of the ends of a range."""


class ModelProbability(NamedTuple):
    """The probability beyond a boundary under a latent.

    Attributes:
        mean: under the latent's posterior.
        sd: standard deviation under the posterior.
        error: standard error of the integration.
    """

    mean: float
    sd: float
    error: float


def model_probability(
    classifier: Classifier, features: FeatureMap, space: DesignSpace, outcome: str, n: int, rng: np.random.Generator
) -> ModelProbability:
    """The probability beyond a boundary that is learned from a margin, under the posterior of its latent.

    Args:
        classifier: of the boundary.
        features: map from designs to the latents' inputs.
        space: the design space.
        outcome: of the boundary.
        n: designs of the population where the posterior is sampled.
        rng: generator of the population and the paths.
    """
    latent = classifier.latent(outcome)
    assert isinstance(latent, ByMargins)

    def share(lost: Lost, accuracy: float, by: Classifier = classifier) -> OfBoundary:
        return integrate(BoundariesOf(by, features, lost, outcome), space, accuracy=accuracy).of(0)

    known = share("learned", ACCURACY)
    drawn, F, standardised = doubtful_population(latent.model, features, space, n, rng)
    sd = posterior_sd(latent, F, standardised, drawn.weight, rng, classifier.impossible)
    if classifier.unknown is not None:
        # The posterior does not know what lost runs are; half of the range counts as one standard deviation.
        ends = [share(lost, _COARSE).probability for lost in ("none", "all")]
        sd = math.hypot(sd, 0.5 * max(0.0, ends[1] - ends[0]))
    if isinstance(latent, MarginLatent) and latent.gap:
        # All paths share the boundary's place in the gap.
        low, high = (share("learned", _COARSE, _with(classifier, latent, place)).probability for place in (1.0, 0.0))
        sd = math.hypot(sd, (high - low) / math.sqrt(12.0))
    return ModelProbability(known.probability, sd, known.error)


def _with(classifier: Classifier, latent: MarginLatent, place: float) -> Classifier:
    """A classifier that knows where in the gap of one of its latents the boundary lies."""
    latents = (replace(one, place=place) if one is latent else one for one in classifier.latents)
    return replace(classifier, latents=tuple(latents))


def posterior_sd(
    latent: ByMargins,
    F: Array,
    standardised: Array,
    weight: Array,
    rng: np.random.Generator,
    impossible: Latent | None = None,
) -> float:
    """Standard deviation of the probability, among designs that exist, under the latents' posteriors, from joint paths.

    The paths are drawn at points that are chosen in proportion to weight times doubt.

    Args:
        latent: of the boundary.
        F: (n, m) features of a population.
        standardised: (n,) the latent's mean/sd there.
        weight: (n,) of the population.
        rng: generator of the points and the paths.
        impossible: positive where a design probably does not exist; None if all do.
    """
    share = 1.0
    if impossible is not None:
        lost = impossible.moments(F).standardised
        standardised, share = both(standardised, -lost), float((weight * ndtr(-lost)).mean() / weight.mean())
    uncertain = doubt(standardised)
    part = weight * uncertain + LEAST
    rows = rng.choice(len(F), POINTS, p=part / part.sum())
    if isinstance(latent, SystemLatent):
        # The sides of the modes decide; their units differ.
        modes = np.stack([_paths(mode, F[rows], rng) for mode in latent.modes], axis=-1)
        paths, noise = -latent.system(-modes), 0.0
    else:
        noise = latent.trained.noise
        paths = _paths(latent, F[rows], rng, noise)
    beyond = ndtr(paths / noise) if noise else (paths > 0.0).astype(np.float64)
    if impossible is not None:
        beyond *= ndtr(-_paths(impossible, F[rows], rng))
    deviations = (beyond - ndtr(standardised[rows])) / np.maximum(uncertain[rows], LEAST)
    return float(part.mean()) * float(deviations.mean(axis=1).std()) / share


def _paths(latent: AnyLatent, F: Array, rng: np.random.Generator, noise: float = 0.0) -> Array:
    """Joint paths of a latent, without a noise that its model includes, at scaled features, (n, m) -> (paths, n)."""
    mean, covariance = joint(latent.model, F)
    covariance[np.diag_indices(len(F))] -= noise**2
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean + rng.standard_normal((_PATHS, len(F))) @ root.T)
