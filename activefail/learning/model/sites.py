"""The optimal Gaussian posterior for a prior: a Gaussian site for each training point, iterated to a fixed point.

It has the form S = (K⁻¹ + W)⁻¹ with a diagonal W [OpperArchambeau2009]: two numbers per point instead of n²/2. Damped
natural-gradient steps find them [KhanLin2017], for any GPyTorch likelihood of one latent.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.linalg.blas import dsyrk, dtrmm
from scipy.linalg.lapack import dtrtri
from torch import Tensor

from activefail.learning.model.likelihoods import expectations

_FIRST_SHARE, _LEAST_SHARE = 0.6, 0.02
"""First and least share of a natural-gradient step; undamped steps oscillate."""

_NEAR = 1e-3
"""Gain of a step [nats per point] below which steps are extrapolated."""

_MEMORY = 6
"""Earlier steps that an extrapolation uses."""

_WEAK_SITE = 1e-6
"""Precision of a site times the prior variance below which a point's variance is the prior's to six digits."""


class Sites(NamedTuple):
    """A Gaussian factor for each training point: exp(linear f − precision f²/2)."""

    linear: Tensor  # (n,)
    precision: Tensor  # (n,), positive


class Whole(NamedTuple):
    """A prior of n points."""

    mean: Tensor  # (n,)
    K: Tensor  # (n, n), with its jitter


class Projection(NamedTuple):
    """A prior of n points projected on m inducing points: f = prior mean + Vᵀv + rest, v ~ N(0, I)."""

    mean: Tensor  # (n,)
    whitened: Tensor  # V (m, n): L⁻¹ k(Z, X) with LLᵀ = k(Z, Z)
    rest: Tensor  # (n,) prior variance that the inducing points do not explain


class Posterior(NamedTuple):
    """The variational posterior at the training points, and its bound."""

    alpha: Tensor  # (n,) K⁻¹ (mean − prior mean); of a projection the mean of v, (m,)
    mean: Tensor  # (n,)
    variance: Tensor  # (n,)
    factor: Tensor  # (n, n) factor of B = I + W^½ K W^½; of a projection that of I + V W Vᵀ, (m, m)
    gradient: Tensor  # (n,) E[∂ log p(y | f)/∂f]
    curvature: Tensor  # (n,) E[−∂² log p(y | f)/∂f²]
    elbo: float


def posterior(prior: Whole | Projection, likelihood: Any, labels: Tensor, sites: Sites) -> Posterior:
    """The Gaussian defined by prior and sites, with its evidence lower bound.

    Args:
        prior: at the training points. With a projection the bound is that of [Titsias2009] (for other likelihoods
            [HensmanEtAl2015]), at most the one of the whole prior.
        likelihood: of GPyTorch.
        labels: (n,) of 0 and 1.
        sites: of the points.
    """
    if isinstance(prior, Projection):
        return _projected_posterior(prior, likelihood, labels, sites)
    return _whole_posterior(prior, likelihood, labels, sites)


def _projected_posterior(prior: Projection, likelihood: Any, labels: Tensor, sites: Sites) -> Posterior:
    V, (linear, precision) = prior.whitened, sites
    X = V * precision.sqrt()
    # BLAS computes one half of the symmetric product; the transposed view is stored by columns.
    A = torch.from_numpy(dsyrk(1.0, X.numpy().T, trans=1, lower=0).T)
    A.diagonal().add_(1.0)
    R = torch.linalg.cholesky(A)
    v = torch.cholesky_solve((V @ (linear - precision * prior.mean)).unsqueeze(1), R).squeeze(1)
    mean = prior.mean + V.T @ v
    inverse, T = whitened(R, V)
    variance = (prior.rest + column_squares(T)).clamp_min(1e-12)
    expected, gradient, curvature = expectations(likelihood, labels, mean, variance)
    trace = float(inverse.square().sum())
    divergence = 0.5 * (trace + float(v @ v) - len(V)) + float(R.diagonal().log().sum())
    return Posterior(v, mean, variance, R, gradient, curvature, float(expected.sum()) - divergence)


def column_squares(V: Tensor) -> Tensor:
    """Σ_i V_ij², (n,) of (m, n); torch takes up to ten times as long."""
    return torch.from_numpy(np.einsum("ij,ij->j", V.numpy(), V.numpy()))


def whitened(L: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    """L⁻¹ and L⁻¹K of a lower triangle, (m, m) and (m, n): a product takes half the time of a triangular solve."""
    # LAPACK and BLAS store by columns: the transposed views are upper triangles and need no copy.
    inverse, _ = dtrtri(L.numpy().T, lower=0)
    product = dtrmm(1.0, inverse, K.numpy().T, side=1, lower=0)
    return torch.from_numpy(inverse.T), torch.from_numpy(product.T)


def _whole_posterior(prior: Whole, likelihood: Any, labels: Tensor, sites: Sites) -> Posterior:
    K, root = prior.K, sites.precision.sqrt()
    B = root.unsqueeze(1) * K * root
    B.diagonal().add_(1.0)
    L = torch.linalg.cholesky(B)
    b = sites.linear - sites.precision * prior.mean
    alpha = b - root * torch.cholesky_solve((root * (K @ b)).unsqueeze(1), L).squeeze(1)
    mean_offset = K @ alpha
    variance = _posterior_variance(K, sites.precision, root, L)
    mean = prior.mean + mean_offset
    expected, gradient, curvature = expectations(likelihood, labels, mean, variance)
    # tr(K⁻¹S) = tr(B⁻¹) = n − Σ W s², since S W = I − (I + K W)⁻¹.
    n = len(labels)
    trace = n - (sites.precision * variance).sum()
    divergence = 0.5 * (trace + alpha @ mean_offset - n) + L.diagonal().log().sum()
    return Posterior(alpha, mean, variance, L, gradient, curvature, float(expected.sum() - divergence))


def _posterior_variance(K: Tensor, precision: Tensor, root: Tensor, L: Tensor) -> Tensor:
    """diag(S), (n,), from the factor L of B: S_ii = (1 − (B⁻¹)_ii)/W_ii, which costs a third of K − VᵀV.

    At a weak site this formula cancels, and the other one is used.
    """
    # LAPACK stores by columns: the transposed view is the upper triangle and needs no copy.
    inverse, _ = dtrtri(L.numpy().T, lower=0)
    shrunk = 1.0 - torch.from_numpy(np.einsum("ij,ij->i", inverse, inverse))
    prior = K.diagonal()
    variance = shrunk / precision
    weak = torch.nonzero(precision * prior < _WEAK_SITE).squeeze(1)
    if len(weak):
        V = torch.linalg.solve_triangular(L, root.unsqueeze(1) * K[:, weak], upper=False)
        variance[weak] = prior[weak] - (V * V).sum(0)
    return variance.clamp_min(1e-12)


def fixed_point(state: Posterior) -> Sites:
    """The target sites of a posterior, equal to its sites at the optimum."""
    return Sites(state.gradient + state.curvature * state.mean, state.curvature)


def solve_sites(
    prior: Whole | Projection, likelihood: Any, labels: Tensor, sites: Sites, tolerance: float, most: int = 200
) -> tuple[Sites, Posterior]:
    """Iterate the sites until the bound changes by less than `tolerance` [nats], for at most `most` steps.

    A step that lowers the bound by more is rejected, and the next one is half as long: with large output scales, fixed
    damping can cycle forever. The iteration ends where the shortest step lowers it, as it may with a likelihood that is
    not log-concave. Near the optimum, where plain steps converge linearly, they are extrapolated [Anderson1965].
    """
    state = posterior(prior, likelihood, labels, sites)
    share, change = _FIRST_SHARE, math.inf
    past: list[tuple[Sites, Sites]] = []
    for _ in range(most):
        target = fixed_point(state)
        past = [*past[-_MEMORY:], (sites, target)]
        extrapolated = change < _NEAR * len(labels) and len(past) > 1
        step = _extrapolated(past, state, share) if extrapolated else _between(sites, target, share)
        following = posterior(prior, likelihood, labels, step)
        change = following.elbo - state.elbo
        # Relative to the share: the gain of a short step says little about the distance to the optimum.
        if change <= -tolerance * share:
            if share <= _LEAST_SHARE and not extrapolated:
                break
            # Earlier steps mislead here: take a plain step next, then a shorter one.
            past = []
            share = share if extrapolated else 0.5 * share
            continue
        sites, state = step, following
        if change < tolerance * share:
            break
        share = min(1.0, 1.15 * share)
    return sites, state


def _between(sites: Sites, target: Sites, share: float) -> Sites:
    return Sites(*(torch.lerp(old, new, share) for old, new in zip(sites, target, strict=True)))


def _extrapolated(past: list[tuple[Sites, Sites]], state: Posterior, share: float) -> Sites:
    """Anderson's step from earlier sites and their targets: the combination of them with the smallest residual."""
    x, r = (
        torch.stack(columns, dim=1)
        for columns in zip(*((torch.cat(at), torch.cat(target) - torch.cat(at)) for at, target in past), strict=True)
    )
    # In units of the posterior, so that residuals of different sites are comparable.
    unit = torch.cat([state.variance.sqrt(), state.variance]).unsqueeze(1)
    by_x, by_r = x.diff(dim=1), r.diff(dim=1)
    weights = torch.linalg.lstsq(unit * by_r, unit * r[:, -1:], rcond=1e-8, driver="gelsd").solution
    following = (x[:, -1:] + share * r[:, -1:] - (by_x + share * by_r) @ weights).squeeze(1)
    linear, precision = following.split(len(state.mean))
    # Half of the last precision where the step would not be positive.
    return Sites(linear, torch.where(precision > 0.0, precision, 0.5 * past[-1][0].precision))
