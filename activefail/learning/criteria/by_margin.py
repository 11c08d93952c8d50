"""Designs whose margins would teach most about a boundary (stepwise uncertainty reduction).

Where a boundary is learned from a margin, a simulation yields a number, not a label. The chosen design is the one whose
number would, on average, leave the least doubt Σ w √(p(1 − p)) over the design measure, which bounds the standard
deviation of the probability beyond the boundary [BectEtAl2012].
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.models.model import Model
from scipy.special import ndtr
from torch import Tensor

from activefail.learning.criteria.population import Population, finite, population
from activefail.learning.features import FeatureMap
from activefail.learning.model.boundary_gp import marginal, moments, parts_of, posterior_covariance
from activefail.learning.model.moments import LARGEST_FEATURE
from activefail.space.space import Array, DesignSpace

POINTS = 300
"""Designs of a population that represent it."""

_CANDIDATES = 50
"""Designs of the population from which the first of a batch is chosen; each further one adds `_MORE`."""

_MORE = 4

SIZE = 12_000
"""Designs of a population."""

_HEIGHTS = (0.236799, 0.109751, 0.085693, 0.067768)
_PRECISIONS = (0.503909, 0.567564, 0.733511, 1.091334)
"""Of Gaussian functions whose sum Σ h exp(−q z²/2) is √(p(1 − p)) of p = Φ(z): the largest relative error over |z| ≤ 8
is 3·10⁻⁵. They minimise it, as a fit of four terms found."""

LEAST = 1e-300
"""Lower bound for divisors."""


def doubt(standardised: Array) -> Array:
    """√(p(1 − p)) of p = Φ(z): the standard deviation of the side of the boundary, (n,)."""
    return np.asarray(np.sqrt(ndtr(standardised) * ndtr(-standardised)))


def expected_doubt(mean: Tensor, sd: Tensor, variance: Tensor, covariance: Tensor) -> Tensor:
    """Expected √(p(1 − p)) at R references after the margin of each of n candidates becomes known, (n, R).

    A candidate's margin, with the correlation ρ to a reference, moves the reference's mean by ρ sd times a standard
    normal number, and reduces its variance to (1 − ρ²) sd². The doubt is a sum of Gaussian functions, so its
    expectation is Σ h √((1 − ρ²)/D) exp(−q mean²/(2 D sd²)) with D = 1 + (q − 1) ρ². Its relative error is at most that
    of the sum, whatever the correlation.

    Args:
        mean, sd: (R,) of the latent at references.
        variance: (n,) of the latent at candidates.
        covariance: (n, R) between both.
    """
    explained = (covariance**2 / (variance[:, None] * sd**2)).clamp_max(1.0 - 1e-12)
    half, total = 0.5 * (mean / sd) ** 2, torch.zeros_like(explained)
    for height, precision in zip(_HEIGHTS, _PRECISIONS, strict=True):
        D = 1.0 + (precision - 1.0) * explained
        total += height * torch.exp(-precision * half / D) / D.sqrt()
    return total * (1.0 - explained).sqrt()


class DoubtReduction(AcquisitionFunction):
    """Expected fall of the doubt at references by a margin at single points of scaled features, (n, 1, m) -> (n,).

    At a reference of a system, the doubt is that of the mode that decides there, as in AK-SYS [FauriatGayton2014].

    Args:
        model: of the latent.
        references: (R, m) scaled features.
        weight: (R,) of the references.
    """

    def __init__(self, model: Model, references: Tensor, weight: Tensor) -> None:
        super().__init__(model)
        self._references = references
        with torch.no_grad():
            self._parts = [(of, *marginal(of, references), weight * part) for of, part in parts_of(model, references)]

    def forward(self, X: Tensor) -> Tensor:
        """The criterion."""
        F, fall = X.squeeze(-2), torch.zeros(len(X), dtype=torch.float64)
        for model, mean, sd, weight in self._parts:
            variance = marginal(model, F)[1].square().clamp_min(1e-12)
            after = expected_doubt(mean, sd, variance, posterior_covariance(model, F, self._references))
            fall += (_doubt(mean / sd) - after) @ weight
        return fall


def _doubt(standardised: Tensor) -> Tensor:
    return torch.as_tensor((torch.special.ndtr(standardised) * torch.special.ndtr(-standardised)).sqrt())


def doubtful_population(
    model: Model, features: FeatureMap, space: DesignSpace, n: int, rng: np.random.Generator
) -> tuple[Population, Array, Array]:
    """A population with many designs where a latent is in doubt, its features, (n, m), and mean/sd there, (n,)."""

    def standardised(F: Array) -> Array:
        mean, sd = moments(model, F)
        return mean / sd

    drawn = population(space, n, lambda X: doubt(standardised(finite(features, X))), rng)
    F = finite(features, drawn.X)
    return drawn, F, standardised(F)


class Candidates(NamedTuple):
    """Designs to choose from, and the criterion."""

    designs: Array  # (n, d)
    references: Tensor  # (R, m), scaled features
    make: Callable[[Model, Tensor], AcquisitionFunction]


def candidates_by_margin(
    model: Model, features: FeatureMap, space: DesignSpace, q: int, rng: np.random.Generator
) -> Candidates:
    """Candidates for q designs whose margins reduce the doubt about a boundary most.

    References and candidates are drawn from a population in proportion to their parts of the doubt.

    Args:
        model: of the boundary's latent, with the designs in flight.
        features: map from designs to the latent's inputs.
        space: the design space.
        q: number of designs.
        rng: generator of the draws.
    """
    drawn, F, standardised = doubtful_population(model, features, space, SIZE, rng)
    F, uncertain = np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE), doubt(standardised)
    share = (drawn.weight * uncertain + LEAST) / (drawn.weight * uncertain + LEAST).sum()
    references = rng.choice(len(F), POINTS, p=share)
    candidates = np.unique(rng.choice(len(F), _CANDIDATES + _MORE * q, p=share))
    if len(candidates) < q:
        others = np.setdiff1d(np.arange(len(F)), candidates)
        candidates = np.concatenate([candidates, rng.choice(others, q - len(candidates), replace=False)])
    # The references were drawn in proportion to the doubt before the batch.
    at, weight = torch.from_numpy(F[references]), torch.from_numpy(1.0 / np.maximum(uncertain[references], LEAST))
    return Candidates(drawn.X[candidates], at, lambda model, at: DoubtReduction(model, at, weight / POINTS))
