"""Trains a variational GP classifier on outcomes: sites by fixed-point iteration, hyperparameters and how often.

Hyperparameters are searched for by L-BFGS.

The hyperparameters maximise the bound at the optimal sites, whose derivative by the covariance is closed and needs no
derivative of the sites; autograd leads on through the kernel. Up to `EXACT` points the posterior is that of all points;
beyond, it is projected on inducing points.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import gpytorch
import numpy as np
import torch
from torch import Tensor

from activefail.errors import InputError
from activefail.learning.model.boundary_gp import BoundaryModel, SiteStrategy
from activefail.learning.model.covariance import JITTER
from activefail.learning.model.inducing import LEFT, MOST, choose, jittered, project
from activefail.learning.model.kernels import (
    LEARNED_ON,
    Bounds,
    MakeKernel,
    Prior,
    minimise,
    scaled_kernel,
)
from activefail.learning.model.likelihoods import Probit, expectations, marginals
from activefail.learning.model.readout import EXACT, readout_of
from activefail.learning.model.sites import (
    Posterior,
    Projection,
    Sites,
    Whole,
    column_squares,
    posterior,
    solve_sites,
    whitened,
)

COARSE = 250
"""Points on which hyperparameters are learned first; with more, inducing points are used while they are learned."""

HALFWAY = 4000
"""Points whose posterior predicts the sites of many more, and whose inducing points are used for these."""

_ROUNDS = 3
"""Most rounds of adding inducing points after sites or hyperparameters have changed."""

GROWTH = 0.05
"""A warm start keeps its hyperparameters until the number of points has grown by this share since they were learned."""

_OUTPUTSCALE = (math.log(10.0), 2.0)
"""Mean and standard deviation of the output scale's logarithm. Flat, because a sharp boundary needs a latent many times
as large as the likelihood's unit width."""

MakePrior = Callable[[int], Prior]
"""Number of features -> prior with its default parameters."""


def outcome_prior(kernel: str | MakeKernel, dimension: int, likelihood: Callable[[], Any] = Probit) -> Prior:
    """The prior of a latent that is learned from outcomes.

    Args:
        kernel: "rbf" or "matern52", or the user's function of the number of features.
        dimension: number of features.
        likelihood: makes a one-dimensional GPyTorch likelihood of labels 0 and 1.

    Raises:
        InputError: if custom code makes no kernel, or no likelihood.
    """
    labels = likelihood()
    if not isinstance(labels, Probit):
        raise InputError(
            f"classifier.likelihood: must be a BernoulliLikelihood of GPyTorch, got {type(labels).__name__}."
        )
    if not isinstance(kernel, str):
        covariance = kernel(dimension)
        if not isinstance(covariance, gpytorch.kernels.Kernel):
            raise InputError(f"classifier.kernel: must return a GPyTorch kernel, got {type(covariance).__name__}.")
        return Prior(covariance.double(), labels.double(), {})
    # The length scale grows with the root of the dimension [HvarfnerEtAl2024].
    of_lengthscale = math.sqrt(2.0) + 0.5 * math.log(dimension), math.sqrt(3.0)
    covariance = scaled_kernel(kernel, dimension, of_lengthscale, _OUTPUTSCALE)
    covariance.initialize(outputscale=10.0)
    # A length scale of the features' spread times the root of their number, as in the prior.
    covariance.base_kernel.initialize(lengthscale=math.sqrt(dimension))
    bounds: Bounds = {
        "mean_module.raw_constant": (-50.0, 50.0),
        "covar_module.raw_outputscale": (-5.0, 12.0),
        "covar_module.base_kernel.raw_lengthscale": (-5.0, 8.0),
    }
    return Prior(covariance, labels.double(), bounds)


@dataclass(frozen=True)
class Fit:
    """A trained latent, with the data to predict from it or to continue training."""

    prior: Prior
    features: Tensor  # (n, m)
    labels: Tensor  # (n,), 0 or 1
    sites: Sites
    elbo: float
    learned_on: int  # number of points when the hyperparameters were last learned
    inducing: Tensor | None = None  # rows of the features, int64; None if the posterior is that of all points

    @property
    def prior_at_points(self) -> Whole | Projection:
        """The prior at the training points, as an argument of `posterior`."""
        return _prior_at(self.prior, self.features, self.inducing)

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior at the training points."""
        return posterior(self.prior_at_points, self.prior.likelihood, self.labels, self.sites)

    @property
    def objective(self) -> float:
        """The bound of all points plus the log prior of the hyperparameters."""
        return self.elbo + float(self.prior.log_density().detach())

    @cached_property
    def model(self) -> BoundaryModel:
        """The posterior as a BoTorch model over scaled features."""
        prior = self.prior
        Z = self.features if self.inducing is None else self.features[self.inducing]
        with torch.no_grad():
            K = jittered(prior.covariance(Z)).numpy()
            Kx = None if self.inducing is None else prior.covariance(Z, self.features).numpy()
            mean = float(prior.mean_module(Z[:1]))
        linear, precision = (site.numpy() for site in self.sites)
        matrices = readout_of(K, Kx, mean, linear, precision)
        return BoundaryModel.of(SiteStrategy(prior, Z, matrices, None, JITTER))


@torch.no_grad()
def _prior_at(prior: Prior, features: Tensor, rows: Tensor | None) -> Whole | Projection:
    if rows is not None:
        return project(prior, features, rows)
    return Whole(prior.mean_module(features), jittered(prior.covariance(features)))


def leave_one_out(trained: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Latent mean and standard deviation at each training point without its own label, (n,).

    The hyperparameters do not change.
    Divides the point's site out of the posterior: 1/v = 1/S_ii − W_ii, the cavity of
    [RasmussenWilliams2006, eq. 3.56]. With inducing points a site acts on the projected latent; the residual variance
    is added afterwards.
    """
    prior, state = trained.prior_at_points, trained.posterior
    rest = prior.rest if isinstance(prior, Projection) else torch.zeros_like(state.variance)
    explained = (state.variance - rest).clamp_min(1e-12)
    precision = (1.0 / explained - trained.sites.precision).clamp_min(1e-12)
    mean = (state.mean / explained - trained.sites.linear) / precision
    return mean.numpy(), (1.0 / precision + rest).sqrt().numpy()


def condition(
    prior: Prior,
    features: Tensor,
    labels: Tensor,
    sites: Sites | None = None,
    *,
    tolerance: float = 1e-5,
    learned_on: int = 0,
    inducing: Tensor | None = None,
) -> Fit:
    """The variational posterior for fixed hyperparameters, with its sites iterated from `sites`.

    Args:
        prior: with the hyperparameters.
        features, labels: of the training points.
        sites: initial values of the sites.
        tolerance: of the bound [nats].
        learned_on: number of points when the hyperparameters were last learned, for the result.
        inducing: with more than `EXACT` points, rows to keep as inducing points; others are added.
    """
    sites = _first_sites(labels) if sites is None else sites
    if len(labels) <= EXACT:
        at_points = _prior_at(prior, features, None)
        inducing, (sites, state) = None, solve_sites(at_points, prior.likelihood, labels, sites, tolerance)
    else:
        inducing, sites, state = _induced(prior, features, labels, sites, tolerance, inducing)
    return Fit(prior, features, labels, sites, state.elbo, learned_on, inducing)


def _induced(
    prior: Prior, features: Tensor, labels: Tensor, sites: Sites, tolerance: float, inducing: Tensor | None
) -> tuple[Tensor, Sites, Posterior]:
    """Extended inducing points, with their sites and posterior."""
    for _ in range(_ROUNDS):
        rows, at_points = choose(prior, features, sites.precision, inducing)
        inducing = rows
        sites, state = solve_sites(at_points, prior.likelihood, labels, sites, tolerance)
        # The points were chosen by predicted precisions, which are now known.
        if len(rows) >= MOST or float(sites.precision @ at_points.rest) <= 2.0 * LEFT:
            break
    return rows, sites, state


def _first_sites(labels: Tensor) -> Sites:
    return Sites(0.2 * labels - 0.1, torch.full_like(labels, 0.1))


def _extended_sites(trained: Fit, features: Tensor, labels: Tensor) -> Sites:
    """The sites of a fit, with predicted sites for the points after its own."""
    n = len(trained.labels)
    if n == len(labels):
        return trained.sites
    predicted = _predicted_sites(trained, features[n:], labels[n:])
    return Sites(*(torch.cat(pair) for pair in zip(trained.sites, predicted, strict=True)))


def _predicted_sites(trained: Fit, features: Tensor, labels: Tensor) -> Sites:
    """Initial sites of points, from the posterior of others."""
    mean, sd = trained.model.moments(features)
    _, gradient, curvature = expectations(trained.prior.likelihood, labels, mean, sd.square())
    curvature = curvature.clamp_min(1e-8 / float(trained.prior.variance(features[:1]).detach()))
    return Sites(gradient + curvature * mean, curvature)


def objective_gradient(
    prior: Prior, features: Tensor, labels: Tensor, sites: Sites, tolerance: float, rows: Tensor | None = None
) -> tuple[float, list[Tensor], Sites]:
    """The bound plus the log prior of the hyperparameters, its gradient by what is learned, and the sites.

    Args:
        prior: its parameters require gradients.
        features, labels: of the training points.
        sites: initial values, iterated to `tolerance` [nats].
        tolerance: of the bound.
        rows: of the features to use as inducing points.
    """
    derivatives = _by_whole if rows is None else partial(_by_projection, rows=rows)
    sites, state, parts = derivatives(prior, features, labels, sites, tolerance)
    log_density = prior.log_density()
    parts.append((log_density, torch.ones_like(log_density)))
    if any(True for _ in prior.likelihood.parameters()):
        expected = _expected(prior.likelihood, labels, state)
        parts.append((expected, torch.ones_like(expected)))
    parts = [(of, by) for of, by in parts if of.requires_grad]
    of, by = zip(*parts, strict=True)
    gradient = torch.autograd.grad(of, list(prior.learned.values()), by, allow_unused=True, materialize_grads=True)
    return state.elbo + float(log_density.detach()), list(gradient), sites


def _expected(likelihood: Any, labels: Tensor, state: Posterior) -> Tensor:
    value: Tensor = likelihood.expected_log_prob(labels, marginals(state.mean, state.variance)).sum()
    return value


Parts = list[tuple[Tensor, Tensor]]
"""Quantities that depend on the hyperparameters, each with the derivative of the bound by it."""


def _by_whole(
    prior: Prior, features: Tensor, labels: Tensor, sites: Sites, tolerance: float
) -> tuple[Sites, Posterior, Parts]:
    mean, K = prior.mean_module(features), prior.covariance(features)
    at_points = Whole(mean.detach(), jittered(K.detach().clone()))
    sites, state = solve_sites(at_points, prior.likelihood, labels, sites, tolerance)
    # d ELBO/dK = ½(ααᵀ − W^½ B⁻¹ W^½): the derivative by the sites vanishes at their optimum.
    root = sites.precision.sqrt()
    by_K = -root.unsqueeze(1) * torch.cholesky_inverse(state.factor) * root
    by_K.addr_(state.alpha, state.alpha).mul_(0.5)
    return sites, state, [(mean, state.alpha), (K, by_K)]


def _by_projection(
    prior: Prior, features: Tensor, labels: Tensor, sites: Sites, tolerance: float, rows: Tensor
) -> tuple[Sites, Posterior, Parts]:
    Z = features[rows]
    mean, Kz, Kzx, variance = (
        prior.mean_module(features),
        prior.covariance(Z),
        prior.covariance(Z, features),
        prior.variance(features),
    )
    L = torch.linalg.cholesky(jittered(Kz.detach().clone()))
    _, V = whitened(L, Kzx.detach())
    rest = (variance.detach() + JITTER - column_squares(V)).clamp_min(JITTER)
    sites, state = solve_sites(Projection(mean.detach(), V, rest), prior.likelihood, labels, sites, tolerance)
    # At the optimum the bound changes only through the marginals, N(μ + Vᵀv, rest + Vᵀ A⁻¹ V), where rest decreases by
    # the squares of V.
    by_V = torch.outer(state.alpha, state.gradient) + (V - torch.cholesky_solve(V, state.factor)) * state.curvature
    # V = L⁻¹ k(Z, X), and L is the factor of k(Z, Z) [Murray2016].
    by_Kzx = torch.linalg.solve_triangular(L.mT, by_V, upper=True)
    lower = (-(L.mT @ (by_Kzx @ V.mT).tril())).tril()
    lower.diagonal().mul_(0.5)
    half = torch.linalg.solve_triangular(L.mT, lower, upper=True)
    by_Kz = torch.linalg.solve_triangular(L, half, upper=False, left=False)
    return sites, state, [(mean, state.gradient), (Kz, by_Kz), (Kzx, by_Kzx), (variance, -0.5 * state.curvature)]


def _learn_hyperparameters(
    prior: Prior, features: Tensor, labels: Tensor, sites: Sites, tolerance: float, rows: Tensor | None
) -> Sites:
    """Set the prior's parameters to the best by L-BFGS; their sites."""

    def negative() -> tuple[Tensor, list[Tensor]]:
        nonlocal sites
        value, gradient, sites = objective_gradient(prior, features, labels, sites, 0.1 * tolerance, rows)
        return torch.tensor(-value, dtype=torch.float64), [-of for of in gradient]

    for parameter in prior.learned.values():
        parameter.requires_grad_(True)
    minimise(
        negative,
        prior.learned,
        prior.bounds,
        {"ftol": 1e-2 * tolerance, "gtol": 10.0 * tolerance, "maxiter": 100},
    )
    prior.requires_grad_(False)
    return sites


def fit(
    features: Tensor, labels: Tensor, make_prior: MakePrior, warm: Fit | None = None, tolerance: float = 1e-3
) -> Fit:
    """Train a latent by maximising the bound plus the hyperparameters' log prior.

    The hyperparameters are learned on at most `LEARNED_ON` points, evenly spread over the rows. The posterior is that
    of all points, exact for up to `EXACT` of them.

    Args:
        features: (n, m) in standard units, float64.
        labels: (n,) of 0 and 1, float64.
        make_prior: makes the prior with its default parameters.
        warm: an earlier fit to the first of these points, as the starting point; if few points were added, its
            hyperparameters are kept.
        tolerance: tolerance of the objective [nats] for up to `EXACT` points; the sites of a step are solved to a tenth
            of it.
    """
    n = len(labels)
    # Inducing points lose more of the bound than the tolerance; with them the accuracy per point is constant.
    accuracy = 0.01 * tolerance if n <= EXACT else tolerance * n / EXACT
    if warm is not None and n <= (1.0 + GROWTH) * warm.learned_on:
        sites = _extended_sites(warm, features, labels)
        return condition(
            warm.prior,
            features,
            labels,
            sites,
            tolerance=accuracy,
            learned_on=warm.learned_on,
            inducing=warm.inducing,
        )
    learned = warm
    for size in sorted({min(n, size) for size in ((COARSE, LEARNED_ON) if warm is None else (LEARNED_ON,))}):
        rows = _spread(n, size)
        # On a subset the objective is uncertain by several nats anyway.
        subset_tolerance = tolerance if size == n else 10.0 * tolerance
        learned = learn(features[rows], labels[rows], make_prior, learned, subset_tolerance)
    assert learned is not None
    conditioned = partial(condition, features=features, labels=labels, tolerance=accuracy, learned_on=n)
    if n <= LEARNED_ON:
        return conditioned(learned.prior, sites=learned.sites)
    if n > 2 * HALFWAY:
        return _fit_many(conditioned, features, labels, warm, learned)
    updated = conditioned(learned.prior, sites=_predicted_sites(learned, features, labels))
    if warm is None:
        return updated
    previous = conditioned(warm.prior, sites=_extended_sites(warm, features, labels), inducing=warm.inducing)
    # Hyperparameters learned on a subset may be worse for all points.
    return max(previous, updated, key=lambda trained: trained.objective)


def _fit_many(conditioned: Callable[..., Fit], features: Tensor, labels: Tensor, warm: Fit | None, learned: Fit) -> Fit:
    """The posterior of many points, by way of a subset.

    The subset decides whether the learned hyperparameters improve on the previous ones. Its posterior predicts the
    sites and inducing points of all.
    """
    rows = _spread(len(labels), HALFWAY)
    subset = features[rows], labels[rows]

    def on_subset(trained: Fit) -> Fit:
        return condition(trained.prior, *subset, _predicted_sites(trained, *subset), tolerance=1.0)

    latest = on_subset(learned)
    if warm is not None and on_subset(warm).objective >= latest.objective:
        return conditioned(warm.prior, sites=_extended_sites(warm, features, labels), inducing=warm.inducing)
    assert latest.inducing is not None
    return conditioned(latest.prior, sites=_predicted_sites(latest, features, labels), inducing=rows[latest.inducing])


def _spread(n: int, size: int) -> Tensor:
    """Indices of `size` of n rows, evenly spread."""
    return torch.arange(n) if n <= size else torch.linspace(0, n - 1, size).round().long()


def learn(features: Tensor, labels: Tensor, make_prior: MakePrior, warm: Fit | None, tolerance: float) -> Fit:
    """Hyperparameters learned on points, starting from an earlier fit to any points, with their sites."""
    if warm is None:
        n, start, sites = len(labels), make_prior(features.shape[1]), _first_sites(labels)
        share = labels.mean().clamp(1.0 / (n + 1), n / (n + 1.0))
        start.mean_module.initialize(constant=torch.special.ndtri(share))
    else:
        start, sites = copy.deepcopy(warm.prior), _predicted_sites(warm, features, labels)
    inducing = None
    for _ in range(_ROUNDS):
        if len(labels) > COARSE:
            inducing, sites, _ = _induced(start, features, labels, sites, 0.1 * LEFT, inducing)
        sites = _learn_hyperparameters(start, features, labels, sites, tolerance, inducing)
        if inducing is None:
            break
        if float(sites.precision @ project(start, features, inducing).rest) <= 2.0 * LEFT:
            break
    return Fit(start, features, labels, sites, math.nan, len(labels), inducing)
