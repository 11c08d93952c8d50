"""Trains a variational GP classifier on outcomes: sites by fixed-point iteration, length scales and mean by L-BFGS.

The hyperparameters maximise the bound at the optimal sites, whose gradient needs no derivative of the sites. Up to
`EXACT` points the posterior is that of all points; beyond, it is projected on inducing points. GPyTorch is not used in
training or prediction; `activefail.surrogate.classifier.Latent.model` passes the result to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtri

from activefail.surrogate.covariance import (
    JITTER,
    Hyperparameters,
    covariance,
    covariance_gradient,
    log_prior,
    prior_covariance,
)
from activefail.surrogate.inducing import LEFT, MOST, choose, project
from activefail.surrogate.sites import Posterior, Projection, Sites, column_squares, posterior, solve_sites, whitened
from activefail.surrogate.sites import probit_expectations as probit_expectations

if TYPE_CHECKING:
    import torch
    from torch import Tensor
else:
    from activefail.surrogate import lazy_torch as torch

EXACT = 1000
"""Most points without inducing points: a step of the sites costs the cube of their number."""

LEARNED_ON = 1000
"""Most points for learning hyperparameters."""

COARSE = 250
"""Points on which hyperparameters are learned first; with more, inducing points are used while they are learned."""

HALFWAY = 4000
"""Points whose posterior predicts the sites of many more, and whose inducing points are used for these."""

_ROUNDS = 3
"""Most rounds of adding inducing points after sites or hyperparameters have changed."""

GROWTH = 0.05
"""A warm start keeps its hyperparameters until the number of points has grown by this share since they were learned."""


@dataclass(frozen=True)
class Fit:
    """A trained latent, with the data to predict from it or to continue training."""

    kernel: str
    features: Tensor  # (n, m)
    labels: Tensor  # (n,), -1 or 1
    hyperparameters: Hyperparameters
    sites: Sites
    elbo: float
    evaluations: int
    learned_on: int  # number of points when the hyperparameters were last learned
    inducing: Tensor | None = None  # rows of the features, int64; None if the posterior is that of all points

    @property
    def prior(self) -> Tensor | Projection:
        """The prior at the training points, as an argument of `posterior`."""
        if self.inducing is None:
            return prior_covariance(self.features, self.kernel, self.hyperparameters)
        return project(self.features, self.inducing, self.kernel, self.hyperparameters)

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior at the training points."""
        return posterior(self.prior, self.hyperparameters.mean, self.labels, self.sites)


class Readout(NamedTuple):
    """A posterior in terms of its m support points Z: with k = k(Z, x),

    mean(x) = prior mean + kᵀ weights, covariance(x, x′) = k(x, x′) − (root k)ᵀ (root k′).
    """

    support: Tensor  # (m, d)
    weights: Tensor  # (m,)
    root: Tensor  # (m, m)


def readout(trained: Fit) -> Readout:
    """The matrices for predictions from a trained latent."""
    state, precision = trained.posterior, trained.sites.precision
    if trained.inducing is None:
        # K − K W^½ B⁻¹ W^½ K
        inverse, _ = dtrtri(state.cholesky_b.numpy().T, lower=0)
        return Readout(trained.features, state.alpha, torch.from_numpy(inverse.T) * precision.sqrt())
    Z = trained.features[trained.inducing]
    L = torch.linalg.cholesky(prior_covariance(Z, trained.kernel, trained.hyperparameters))
    # K − k L⁻ᵀ (I − A⁻¹) L⁻¹ k, A = RRᵀ = I + V W Vᵀ
    eigenvalues, Q = torch.linalg.eigh(state.cholesky_b @ state.cholesky_b.mT)
    shrunk = (1.0 - 1.0 / eigenvalues.clamp_min(1.0)).sqrt().unsqueeze(1) * Q.mT
    root = torch.linalg.solve_triangular(L, shrunk, upper=False, left=False)
    weights = torch.linalg.solve_triangular(L.mT, state.alpha.unsqueeze(1), upper=True).squeeze(1)
    return Readout(Z, weights, root)


def predict(trained: Fit, matrices: Readout, F: Tensor) -> tuple[Tensor, Tensor]:
    """Marginal mean and variance at features F, (n, d), each (n,)."""
    h = trained.hyperparameters
    k = covariance(trained.kernel, h, matrices.support, F)
    shrinkage = matrices.root @ k
    variance = math.exp(h.log_outputscale) + JITTER - column_squares(shrinkage)
    return h.mean + k.T @ matrices.weights, variance.clamp_min(JITTER)


def predict_jointly(trained: Fit, matrices: Readout, F: Tensor) -> tuple[Tensor, Tensor]:
    """Mean, (n,), and covariance, (n, n), at features F, (n, d)."""
    h = trained.hyperparameters
    k = covariance(trained.kernel, h, matrices.support, F)
    shrinkage = matrices.root @ k
    joint = prior_covariance(F, trained.kernel, h).addmm_(shrinkage.T, shrinkage, alpha=-1.0)
    return h.mean + k.T @ matrices.weights, joint


def leave_one_out(trained: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Latent mean and standard deviation at each training point without its own label, (n,).

    The hyperparameters do not change.
    Divides the point's site out of the posterior: 1/v = 1/S_ii − W_ii, the cavity of
    [RasmussenWilliams2006, eq. 3.56]. With inducing points a site acts on the projected latent; the residual variance
    is added afterwards.
    """
    prior, state = trained.prior, trained.posterior
    rest = prior.rest if isinstance(prior, Projection) else torch.zeros_like(state.variance)
    explained = (state.variance - rest).clamp_min(1e-12)
    precision = (1.0 / explained - trained.sites.precision).clamp_min(1e-12)
    mean = (state.mean / explained - trained.sites.linear) / precision
    return mean.numpy(), (1.0 / precision + rest).sqrt().numpy()


def condition(
    features: Tensor,
    labels: Tensor,
    kernel: str,
    hyperparameters: Hyperparameters,
    sites: Sites | None = None,
    *,
    tolerance: float = 1e-5,
    evaluations: int = 0,
    learned_on: int = 0,
    inducing: Tensor | None = None,
) -> Fit:
    """The variational posterior for fixed hyperparameters, with its sites iterated from `sites`.

    Args:
        sites: initial values of the sites.
        tolerance: of the bound [nats].
        evaluations: of the objective so far, for the result.
        learned_on: number of points when the hyperparameters were last learned, for the result.
        inducing: with more than `EXACT` points, rows to keep as inducing points; others are added.
    """
    sites = _default_start(features, labels)[1] if sites is None else sites
    if len(labels) <= EXACT:
        K = prior_covariance(features, kernel, hyperparameters)
        inducing, (sites, state) = None, solve_sites(K, hyperparameters.mean, labels, sites, tolerance)
    else:
        inducing, sites, state = _induced(features, labels, kernel, hyperparameters, sites, tolerance, inducing)
    return Fit(kernel, features, labels, hyperparameters, sites, state.elbo, evaluations, learned_on, inducing)


def _induced(
    features: Tensor,
    labels: Tensor,
    kernel: str,
    hyperparameters: Hyperparameters,
    sites: Sites,
    tolerance: float,
    inducing: Tensor | None,
) -> tuple[Tensor, Sites, Posterior]:
    """Extended inducing points, with their sites and posterior."""
    for _ in range(_ROUNDS):
        rows, prior = choose(features, sites.precision, kernel, hyperparameters, inducing)
        inducing = rows
        sites, state = solve_sites(prior, hyperparameters.mean, labels, sites, tolerance)
        # The points were chosen by predicted precisions, which are now known.
        if len(rows) >= MOST or float(sites.precision @ prior.rest) <= 2.0 * LEFT:
            break
    return rows, sites, state


def _default_start(features: Tensor, labels: Tensor) -> tuple[Hyperparameters, Sites]:
    n, m = features.shape
    share = (labels > 0).double().mean().clamp(1.0 / (n + 1), n / (n + 1.0))
    mean = float(torch.special.ndtri(share))
    # A length scale of the features' spread times the root of their number, as in the prior.
    lengthscale = math.log(math.sqrt(m))
    hyperparameters = Hyperparameters(mean, math.log(10.0), np.full(m, lengthscale))
    return hyperparameters, Sites(0.1 * labels, torch.full((n,), 0.1, dtype=torch.float64))


def _extended_sites(trained: Fit, features: Tensor, labels: Tensor) -> Sites:
    """The sites of a fit, with predicted sites for the points after its own."""
    n = len(trained.labels)
    if n == len(labels):
        return trained.sites
    predicted = _predicted_sites(trained, features[n:], labels[n:])
    return Sites(*(torch.cat(pair) for pair in zip(trained.sites, predicted, strict=True)))


def _predicted_sites(trained: Fit, features: Tensor, labels: Tensor) -> Sites:
    """Initial sites of points, from the posterior of others."""
    mean, variance = predict(trained, readout(trained), features)
    _, gradient, curvature = probit_expectations(labels, mean, variance)
    least = 1e-8 / math.exp(trained.hyperparameters.log_outputscale)
    return Sites(gradient + curvature * mean, curvature.clamp_min(least))


class Evaluation(NamedTuple):
    """The training objective at some hyperparameters, the bound plus their log prior, with its gradient and sites."""

    value: float
    gradient: np.ndarray  # (2 + m,) by mean, log output scale and log length scales
    sites: Sites


def evaluate(
    kernel: str,
    hyperparameters: Hyperparameters,
    features: Tensor,
    labels: Tensor,
    sites: Sites,
    tolerance: float,
    inducing: Tensor | None = None,
) -> Evaluation:
    """The objective, with its sites iterated from `sites` to `tolerance` [nats].

    Args:
        inducing: rows of the features to use as inducing points.
    """
    solve = _evaluate_dense if inducing is None else partial(_evaluate_projected, rows=inducing)
    sites, elbo, by_mean, by_scales = solve(kernel, hyperparameters, features, labels, sites, tolerance)
    prior, prior_by_scales = log_prior(hyperparameters)
    gradient = torch.cat([by_mean.reshape(1), by_scales + prior_by_scales])
    return Evaluation(elbo + prior, gradient.numpy(), sites)


def _evaluate_dense(
    kernel: str, hyperparameters: Hyperparameters, features: Tensor, labels: Tensor, sites: Sites, tolerance: float
) -> tuple[Sites, float, Tensor, Tensor]:
    """Sites, the bound, and its derivatives by the mean and by the scales."""
    K = covariance(kernel, hyperparameters, features, features)
    jittered = K.clone()
    jittered.diagonal().add_(JITTER)
    sites, state = solve_sites(jittered, hyperparameters.mean, labels, sites, tolerance)
    # d ELBO/dK = ½(ααᵀ − W^½ B⁻¹ W^½): the derivative by the sites vanishes at their optimum.
    root = sites.precision.sqrt()
    by_K = -root.unsqueeze(1) * torch.cholesky_inverse(state.cholesky_b) * root
    by_K.addr_(state.alpha, state.alpha).mul_(0.5)
    by_scales = covariance_gradient(kernel, hyperparameters, features, features, K, by_K)
    return sites, state.elbo, state.alpha.sum(), by_scales


def _evaluate_projected(
    kernel: str,
    hyperparameters: Hyperparameters,
    features: Tensor,
    labels: Tensor,
    sites: Sites,
    tolerance: float,
    rows: Tensor,
) -> tuple[Sites, float, Tensor, Tensor]:
    """As `_evaluate_dense`, for the bound with inducing points."""
    Z = features[rows]
    Kz = covariance(kernel, hyperparameters, Z, Z)
    Kzx = covariance(kernel, hyperparameters, Z, features)
    L = torch.linalg.cholesky(Kz + JITTER * torch.eye(len(Z), dtype=Kz.dtype))
    _, V = whitened(L, Kzx)
    s2 = math.exp(hyperparameters.log_outputscale)
    projection = Projection(V, (s2 + JITTER - column_squares(V)).clamp_min(JITTER))
    sites, state = solve_sites(projection, hyperparameters.mean, labels, sites, tolerance)
    # At the optimum the bound changes only through the marginals, N(μ + Vᵀv, rest + Vᵀ A⁻¹ V), where rest decreases by
    # the squares of V.
    by_V = torch.outer(state.alpha, state.gradient) + (V - torch.cholesky_solve(V, state.cholesky_b)) * state.curvature
    # V = L⁻¹ k(Z, X), and L is the factor of k(Z, Z) [Murray2016].
    by_Kzx = torch.linalg.solve_triangular(L.mT, by_V, upper=True)
    lower = (-(L.mT @ (by_Kzx @ V.mT).tril())).tril()
    lower.diagonal().mul_(0.5)
    half = torch.linalg.solve_triangular(L.mT, lower, upper=True)
    by_Kz = torch.linalg.solve_triangular(L, half, upper=False, left=False)
    by_scales = covariance_gradient(kernel, hyperparameters, Z, features, Kzx, by_Kzx)
    by_scales += covariance_gradient(kernel, hyperparameters, Z, Z, Kz, by_Kz)
    by_scales[0] -= 0.5 * s2 * state.curvature.sum()
    return sites, state.elbo, state.gradient.sum(), by_scales


def pack(hyperparameters: Hyperparameters) -> np.ndarray:
    """Hyperparameters as one vector, (2 + m,), in the order of `Evaluation.gradient`."""
    return np.concatenate([[hyperparameters.mean, hyperparameters.log_outputscale], hyperparameters.log_lengthscale])


def unpack(packed: np.ndarray) -> Hyperparameters:
    """The inverse of `pack`."""
    return Hyperparameters(float(packed[0]), float(packed[1]), packed[2:].copy())


def fit(features: Tensor, labels: Tensor, kernel: str, warm: Fit | None = None, tolerance: float = 1e-3) -> Fit:
    """Train a latent by maximising the bound plus the hyperparameters' log prior.

    The hyperparameters are learned on at most `LEARNED_ON` points, evenly spread over the rows. The posterior is that
    of all points, exact for up to `EXACT` of them.

    Args:
        features: (n, m) in standard units, float64.
        labels: (n,) of -1 and 1, float64.
        kernel: as for `covariance`.
        warm: an earlier fit to the first of these points, as the starting point; if few points were added, its
            hyperparameters are kept.
        tolerance: tolerance of the objective [nats] for up to `EXACT` points; the sites of a step are solved to a tenth
            of it.
    """
    n = len(labels)
    # Inducing points lose more of the bound than the tolerance; with them the accuracy per point is constant.
    accuracy = 0.01 * tolerance if n <= EXACT else tolerance * n / EXACT
    if warm is not None and n <= (1.0 + GROWTH) * warm.learned_on:
        return condition(
            features,
            labels,
            kernel,
            warm.hyperparameters,
            _extended_sites(warm, features, labels),
            tolerance=accuracy,
            learned_on=warm.learned_on,
            inducing=warm.inducing,
        )
    learned, evaluations = warm, 0
    for size in sorted({min(n, size) for size in ((COARSE, LEARNED_ON) if warm is None else (LEARNED_ON,))}):
        rows = _spread(n, size)
        # On a subset the objective is uncertain by several nats anyway.
        subset_tolerance = tolerance if size == n else 10.0 * tolerance
        learned = learn(features[rows], labels[rows], kernel, learned, subset_tolerance)
        evaluations += learned.evaluations
    assert learned is not None
    h = learned.hyperparameters
    conditioned = partial(
        condition, features, labels, kernel, tolerance=accuracy, evaluations=evaluations, learned_on=n
    )
    if n <= LEARNED_ON:
        return conditioned(h, learned.sites)
    if n > 2 * HALFWAY:
        return _fit_many(features, labels, kernel, warm, learned, accuracy, evaluations)
    updated = conditioned(h, _predicted_sites(learned, features, labels))
    if warm is None:
        return updated
    previous = conditioned(warm.hyperparameters, _extended_sites(warm, features, labels), inducing=warm.inducing)
    # Hyperparameters learned on a subset may be worse for all points.
    return max(previous, updated, key=objective)


def _fit_many(
    features: Tensor, labels: Tensor, kernel: str, warm: Fit | None, learned: Fit, accuracy: float, evaluations: int
) -> Fit:
    """The posterior of many points, by way of a subset.

    The subset decides whether the learned hyperparameters improve on the previous ones. Its posterior predicts the
    sites and inducing points of all.
    """
    rows = _spread(len(labels), HALFWAY)
    subset = features[rows], labels[rows]

    def on_subset(trained: Fit) -> Fit:
        return condition(*subset, kernel, trained.hyperparameters, _predicted_sites(trained, *subset), tolerance=1.0)

    latest = on_subset(learned)
    if warm is not None and objective(on_subset(warm)) >= objective(latest):
        h, sites, inducing = warm.hyperparameters, _extended_sites(warm, features, labels), warm.inducing
    else:
        assert latest.inducing is not None
        h, sites, inducing = latest.hyperparameters, _predicted_sites(latest, features, labels), rows[latest.inducing]
    return condition(
        features,
        labels,
        kernel,
        h,
        sites,
        tolerance=accuracy,
        evaluations=evaluations,
        learned_on=len(labels),
        inducing=inducing,
    )


def objective(trained: Fit) -> float:
    """The bound of all points plus the log prior of the hyperparameters."""
    return trained.elbo + log_prior(trained.hyperparameters)[0]


def _spread(n: int, size: int) -> Tensor:
    """Indices of `size` of n rows, evenly spread."""
    return torch.arange(n) if n <= size else torch.linspace(0, n - 1, size).round().long()


def learn(features: Tensor, labels: Tensor, kernel: str, warm: Fit | None, tolerance: float) -> Fit:
    """Hyperparameters learned on points, starting from an earlier fit to any points, with their sites."""
    if warm is None:
        start, sites = _default_start(features, labels)
    else:
        start, sites = warm.hyperparameters, _predicted_sites(warm, features, labels)
    evaluations, inducing = 0, None
    for _ in range(_ROUNDS):
        if len(labels) > COARSE:
            inducing, sites, _ = _induced(features, labels, kernel, start, sites, 0.1 * LEFT, inducing)
        start, sites, count = _learn_hyperparameters(features, labels, kernel, start, sites, tolerance, inducing)
        evaluations += count
        if inducing is None:
            break
        if float(sites.precision @ project(features, inducing, kernel, start).rest) <= 2.0 * LEFT:
            break
    return Fit(kernel, features, labels, start, sites, math.nan, evaluations, len(labels), inducing)


def _learn_hyperparameters(
    features: Tensor,
    labels: Tensor,
    kernel: str,
    start: Hyperparameters,
    sites: Sites,
    tolerance: float,
    inducing: Tensor | None,
) -> tuple[Hyperparameters, Sites, int]:
    """The best hyperparameters by L-BFGS, their sites, and the number of evaluations of the objective."""
    from scipy.optimize import minimize

    evaluations = 0

    def negative(packed: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal sites, evaluations
        evaluations += 1
        value, gradient, sites = evaluate(kernel, unpack(packed), features, labels, sites, 0.1 * tolerance, inducing)
        return -value, -gradient

    optimum = minimize(
        negative,
        pack(start),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-50.0, 50.0), (-5.0, 12.0)] + [(-5.0, 8.0)] * features.shape[1],
        options={"ftol": 1e-2 * tolerance, "gtol": 10.0 * tolerance, "maxiter": 100},
    )
    return unpack(optimum.x), sites, evaluations
