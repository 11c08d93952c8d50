"""How a variational GP classifier is trained: Gaussian sites to their fixed point, hyperparameters by L-BFGS.

The optimal Gaussian posterior of a GP with a factorised likelihood has the form S = (K⁻¹ + W)⁻¹ with a diagonal W
(Opper and Archambeau 2009): two numbers a point instead of n²/2. The sites are found by damped natural-gradient steps
(Khan and Lin 2017), the hyperparameters on the bound they attain, whose gradient needs no derivative of the sites.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import gpytorch
import numpy as np
import torch
from scipy.linalg.lapack import dtrtri
from scipy.optimize import minimize
from torch import Tensor

JITTER = 1e-6
"""Added to the diagonal of K; the GPyTorch model that the result is loaded into adds the same."""

LEARNED_ON = 1000
"""Most points that hyperparameters are learned on: each of a hundred evaluations costs the cube of their number."""

GROWTH = 0.05
"""A warm start keeps its hyperparameters until the points have grown by this share since they were learned."""

_FIRST_SHARE, _LEAST_SHARE = 0.6, 0.02
"""Share of a natural-gradient step that is taken at first, and at least; undamped steps oscillate."""

_WEAK_SITE = 1e-6
"""A site's precision times the prior variance, below which its point's variance is that of the prior to six digits."""

_NODES, _WEIGHTS = (torch.from_numpy(a) for a in np.polynomial.hermite_e.hermegauss(20))
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


class Hyperparameters(NamedTuple):
    """Of a constant mean and an ARD covariance, in the features' standard units."""

    mean: float
    log_outputscale: float
    log_lengthscale: Tensor  # (m,)


class Sites(NamedTuple):
    """A Gaussian factor for each training point: exp(linear f − precision f²/2)."""

    linear: Tensor  # (n,)
    precision: Tensor  # (n,), positive


class Posterior(NamedTuple):
    """The variational posterior at the training points, and its bound."""

    alpha: Tensor  # (n,) K⁻¹ (mean − prior mean)
    mean: Tensor  # (n,)
    variance: Tensor  # (n,)
    cholesky_b: Tensor  # (n, n) factor of I + W^½ K W^½
    elbo: float


@dataclass(frozen=True)
class Fit:
    """A trained latent: what it was trained on, and all that is needed to use it or to train on from it."""

    kernel: str
    features: Tensor  # (n, m)
    labels: Tensor  # (n,), -1 or 1
    hyperparameters: Hyperparameters
    sites: Sites
    elbo: float
    evaluations: int
    learned_on: int  # points when the hyperparameters were last learned


def covariance_module(kernel: str, dimension: int) -> gpytorch.kernels.Kernel:
    """An ARD covariance with a free output scale and the priors that the training uses, in double precision.

    Args:
        kernel: "rbf" (squared exponential, the paper's) or "matern52".
        dimension: number of features.

    Raises:
        ValueError: if the kernel is neither.
    """
    # exp, not softplus: L-BFGS then steps in the logarithm of each scale.
    positive = gpytorch.constraints.Positive(transform=torch.exp, inv_transform=torch.log)
    # Length scales that grow with the root of the dimension (Hvarfner et al. 2024), in units of the features' spread.
    lengthscale_prior = gpytorch.priors.LogNormalPrior(math.sqrt(2.0) + 0.5 * math.log(dimension), math.sqrt(3.0))
    match kernel:
        case "rbf":
            base = gpytorch.kernels.RBFKernel(
                ard_num_dims=dimension, lengthscale_constraint=positive, lengthscale_prior=lengthscale_prior
            )
        case "matern52":
            base = gpytorch.kernels.MaternKernel(
                nu=2.5, ard_num_dims=dimension, lengthscale_constraint=positive, lengthscale_prior=lengthscale_prior
            )
        case _:
            raise ValueError(f"The covariance must be rbf or matern52, got {kernel!r}.")
    # Flat: a sharp boundary needs a latent many times the likelihood's unit width.
    outputscale_prior = gpytorch.priors.LogNormalPrior(math.log(10.0), 2.0)
    return gpytorch.kernels.ScaleKernel(
        base, outputscale_constraint=positive, outputscale_prior=outputscale_prior
    ).double()


def set_hyperparameters(covariance: gpytorch.kernels.Kernel, hyperparameters: Hyperparameters) -> None:
    """Write the scales into a covariance made by `covariance_module`."""
    with torch.no_grad():
        covariance.raw_outputscale.fill_(hyperparameters.log_outputscale)
        covariance.base_kernel.raw_lengthscale.copy_(hyperparameters.log_lengthscale.reshape(1, -1))


def probit_expectations(labels: Tensor, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """E[log Φ(yf)], E[∂ log Φ(yf)/∂f] and E[−∂² log Φ(yf)/∂f²] under f ~ N(mean, variance), each shape (n,).

    The last by Stein's lemma, E[−∂²l] = −E[l′·(f − mean)]/variance: so the three are value and exact derivatives of one
    quadrature, and the sites climb the very bound that is reported. The second derivative itself is a step in f, which
    few nodes miss where the latent is wide.
    """
    sd = variance.sqrt()
    f = mean.unsqueeze(-1) + sd.unsqueeze(-1) * _NODES  # n -> n x 20
    y = labels.unsqueeze(-1)
    log_cdf = torch.special.log_ndtr(y * f)
    slope = y * torch.exp(-0.5 * f * f - 0.5 * math.log(2.0 * math.pi) - log_cdf)  # yφ/Φ
    # Not negative but for rounding: the slope falls with f.
    curvature = (-(slope @ (_WEIGHTS * _NODES)) / sd).clamp_min(0.0)
    return log_cdf @ _WEIGHTS, slope @ _WEIGHTS, curvature


def posterior(K: Tensor, prior_mean: float, labels: Tensor, sites: Sites) -> Posterior:
    """The Gaussian that prior and sites define, and its evidence lower bound."""
    root = sites.precision.sqrt()
    B = root.unsqueeze(1) * K * root
    B.diagonal().add_(1.0)
    L = torch.linalg.cholesky(B)
    b = sites.linear - sites.precision * prior_mean
    alpha = b - root * torch.cholesky_solve((root * (K @ b)).unsqueeze(1), L).squeeze(1)
    mean_offset = K @ alpha
    variance = _posterior_variance(K, sites.precision, root, L)
    mean = prior_mean + mean_offset
    expected_log_likelihood, _, _ = probit_expectations(labels, mean, variance)
    # tr(K⁻¹S) = tr(B⁻¹) = n − Σ W s², since S W = I − (I + K W)⁻¹.
    n = len(labels)
    trace = n - (sites.precision * variance).sum()
    divergence = 0.5 * (trace + alpha @ mean_offset - n) + L.diagonal().log().sum()
    return Posterior(alpha, mean, variance, L, float(expected_log_likelihood.sum() - divergence))


def _posterior_variance(K: Tensor, precision: Tensor, root: Tensor, L: Tensor) -> Tensor:
    """diag(S), (n,), from the factor L of B: S_ii = (1 − (B⁻¹)_ii)/W_ii, which costs a third of K − VᵀV.

    Where a site hardly informs, that is a difference of equal numbers, and the other formula is taken.
    """
    # LAPACK, by columns: the transposed view is its upper triangle, and nothing is copied.
    inverse, _ = dtrtri(L.numpy().T, lower=0)
    shrunk = 1.0 - torch.from_numpy(np.einsum("ij,ij->i", inverse, inverse))
    prior = K.diagonal()
    variance = shrunk / precision
    weak = torch.nonzero(precision * prior < _WEAK_SITE).squeeze(1)
    if len(weak):
        V = torch.linalg.solve_triangular(L, root.unsqueeze(1) * K[:, weak], upper=False)
        variance[weak] = prior[weak] - (V * V).sum(0)
    return variance.clamp_min(1e-12)


def solve_sites(
    K: Tensor, prior_mean: float, labels: Tensor, sites: Sites, tolerance: float, most: int = 200
) -> tuple[Sites, Posterior]:
    """Iterate the sites to where the bound moves by less than `tolerance` [nats]; at most `most` steps.

    A step that lowers the bound is halved: with large output scales a fixed damping can circle for ever.
    """
    state = posterior(K, prior_mean, labels, sites)
    share = _FIRST_SHARE
    for _ in range(most):
        _, gradient, curvature = probit_expectations(labels, state.mean, state.variance)
        target = Sites(gradient + curvature * state.mean, curvature)
        step = Sites(*(torch.lerp(old, new, share) for old, new in zip(sites, target, strict=True)))
        following = posterior(K, prior_mean, labels, step)
        change = following.elbo - state.elbo
        if change < -tolerance and share > _LEAST_SHARE:
            share *= 0.5
            continue
        sites, state = step, following
        # By the change that a whole step promises: a short one says little about how far the optimum is.
        if abs(change) < tolerance * share:
            break
        share = min(1.0, 1.15 * share)
    return sites, state


def prior_covariance(features: Tensor, kernel: str, hyperparameters: Hyperparameters) -> Tensor:
    """K at the training points with its jitter, shape (n, n)."""
    covariance = covariance_module(kernel, features.shape[1])
    set_hyperparameters(covariance, hyperparameters)
    with torch.no_grad():
        K: Tensor = covariance(features).to_dense().clone()
        K.diagonal().add_(JITTER)
    return K


def condition(
    features: Tensor,
    labels: Tensor,
    kernel: str,
    hyperparameters: Hyperparameters,
    sites: Sites | None = None,
    tolerance: float = 1e-5,
    evaluations: int = 0,
    learned_on: int = 0,
) -> Fit:
    """The variational posterior for given hyperparameters, its sites solved from the given ones on."""
    sites = _default_start(features, labels)[1] if sites is None else _extend_sites(sites, labels)
    K = prior_covariance(features, kernel, hyperparameters)
    sites, state = solve_sites(K, hyperparameters.mean, labels, sites, tolerance)
    return Fit(kernel, features, labels, hyperparameters, sites, state.elbo, evaluations, learned_on)


def _default_start(features: Tensor, labels: Tensor) -> tuple[Hyperparameters, Sites]:
    n, m = features.shape
    share = (labels > 0).double().mean().clamp(1.0 / (n + 1), n / (n + 1.0))
    mean = float(torch.special.ndtri(share))
    # One length scale of the features' spread times the root of their number, as for the prior.
    lengthscale = math.log(math.sqrt(m))
    hyperparameters = Hyperparameters(mean, math.log(10.0), torch.full((m,), lengthscale, dtype=torch.float64))
    return hyperparameters, Sites(0.1 * labels, torch.full((n,), 0.1, dtype=torch.float64))


def _extend_sites(sites: Sites, labels: Tensor) -> Sites:
    """Sites of earlier points, and the first guess for those that came since."""
    more = labels[len(sites.linear) :]
    return Sites(torch.cat([sites.linear, 0.1 * more]), torch.cat([sites.precision, torch.full_like(more, 0.1)]))


class Evaluation(NamedTuple):
    """The training objective at some hyperparameters: the bound plus their log prior, and what it was found with."""

    value: float
    gradient: np.ndarray  # (2 + m,) by mean, log output scale and log length scales
    sites: Sites


def evaluate(
    covariance: gpytorch.kernels.Kernel,
    hyperparameters: Hyperparameters,
    features: Tensor,
    labels: Tensor,
    sites: Sites,
    tolerance: float,
) -> Evaluation:
    """The objective with its sites solved to `tolerance` [nats], starting from the given ones."""
    set_hyperparameters(covariance, hyperparameters)
    covariance.zero_grad()
    K = covariance(features).to_dense()
    with torch.no_grad():
        jittered = K.detach().clone()
        jittered.diagonal().add_(JITTER)
        sites, state = solve_sites(jittered, hyperparameters.mean, labels, sites, tolerance)
        # d ELBO/dK = ½(ααᵀ − W^½ B⁻¹ W^½): the sites' own derivative vanishes at their optimum.
        root = sites.precision.sqrt()
        by_covariance = -root.unsqueeze(1) * torch.cholesky_inverse(state.cholesky_b) * root
        by_covariance.addr_(state.alpha, state.alpha).mul_(0.5)
    K.backward(by_covariance)
    prior = torch.zeros((), dtype=torch.float64)
    for _, module, density, closure, _ in covariance.named_priors():
        # As densities of the logarithms: the mode then does not depend on the scales' units.
        scale = closure(module)
        prior = prior + (density.log_prob(scale) + scale.log()).sum()
    prior.backward()
    by_outputscale = covariance.raw_outputscale.grad.reshape(1)
    by_lengthscale = covariance.base_kernel.raw_lengthscale.grad.reshape(-1)
    gradient = torch.cat([state.alpha.sum().reshape(1), by_outputscale, by_lengthscale])
    return Evaluation(state.elbo + float(prior.detach()), gradient.numpy(), sites)


def pack(hyperparameters: Hyperparameters) -> np.ndarray:
    """Hyperparameters as one vector, (2 + m,), in the order of `Evaluation.gradient`."""
    return np.concatenate(
        [[hyperparameters.mean, hyperparameters.log_outputscale], hyperparameters.log_lengthscale.numpy()]
    )


def unpack(packed: np.ndarray) -> Hyperparameters:
    """The inverse of `pack`."""
    return Hyperparameters(float(packed[0]), float(packed[1]), torch.from_numpy(packed[2:].copy()))


def fit(features: Tensor, labels: Tensor, kernel: str, warm: Fit | None = None, tolerance: float = 1e-3) -> Fit:
    """Train a latent by maximising the bound plus the hyperparameters' log prior.

    The hyperparameters are learned on at most `LEARNED_ON` points, evenly spread over the rows; the posterior is that
    of all points, solved without inducing points.

    Args:
        features: (n, m) in standard units, float64.
        labels: (n,) of -1 and 1, float64.
        kernel: as for `covariance_module`.
        warm: an earlier fit, whose points are the first of these, to start from; a few points more do not move its
            hyperparameters.
        tolerance: of the objective [nats]; sites are solved ten times finer.
    """
    if warm is None:
        start, sites = _default_start(features, labels)
    else:
        start, sites = warm.hyperparameters, _extend_sites(warm.sites, labels)
    n = len(labels)
    if warm is not None and n <= (1.0 + GROWTH) * warm.learned_on:
        return condition(features, labels, kernel, start, sites, 0.01 * tolerance, 0, warm.learned_on)
    rows = torch.arange(n) if n <= LEARNED_ON else torch.linspace(0, n - 1, LEARNED_ON).round().long()
    learned, found, evaluations = _learn_hyperparameters(
        features[rows], labels[rows], kernel, start, Sites(*(site[rows] for site in sites)), tolerance
    )
    if n > LEARNED_ON:
        found = _foreseen_sites(features[rows], labels[rows], found, kernel, learned, features, labels)
    return condition(features, labels, kernel, learned, found, 0.01 * tolerance, evaluations, n)


def _foreseen_sites(
    known: Tensor,
    known_labels: Tensor,
    sites: Sites,
    kernel: str,
    hyperparameters: Hyperparameters,
    features: Tensor,
    labels: Tensor,
) -> Sites:
    """First sites of many points, from what the posterior of some of them says of each."""
    K = prior_covariance(known, kernel, hyperparameters)
    state = posterior(K, hyperparameters.mean, known_labels, sites)
    covariance = covariance_module(kernel, known.shape[1])
    set_hyperparameters(covariance, hyperparameters)
    with torch.no_grad():
        cross = covariance(known, features).to_dense()
        V = torch.linalg.solve_triangular(state.cholesky_b, sites.precision.sqrt().unsqueeze(1) * cross, upper=False)
        mean = hyperparameters.mean + cross.T @ state.alpha
        prior_variance = math.exp(hyperparameters.log_outputscale)
        variance = (prior_variance - (V * V).sum(0)).clamp_min(1e-6 * prior_variance)
        _, gradient, curvature = probit_expectations(labels, mean, variance)
    return Sites(gradient + curvature * mean, curvature.clamp_min(1e-8 / prior_variance))


def _learn_hyperparameters(
    features: Tensor, labels: Tensor, kernel: str, start: Hyperparameters, sites: Sites, tolerance: float
) -> tuple[Hyperparameters, Sites, int]:
    """The best hyperparameters by L-BFGS, the sites that belong to them, and how often the objective was evaluated."""
    covariance = covariance_module(kernel, features.shape[1])
    evaluations = 0

    def objective(packed: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal sites, evaluations
        evaluations += 1
        value, gradient, sites = evaluate(covariance, unpack(packed), features, labels, sites, 0.1 * tolerance)
        return -value, -gradient

    found = minimize(
        objective,
        pack(start),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-50.0, 50.0), (-5.0, 12.0)] + [(-5.0, 8.0)] * features.shape[1],
        options={"ftol": 1e-2 * tolerance, "gtol": 10.0 * tolerance, "maxiter": 100},
    )
    return unpack(found.x), sites, evaluations
