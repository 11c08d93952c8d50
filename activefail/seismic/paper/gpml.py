"""Gaussian process classification as in [RasmussenWilliams2006]: Laplace's method and expectation propagation.

Both give a Gaussian posterior of the latent f ~ GP(m, k) with one Gaussian factor for each point, proportional to
N(f | m, K) ∏ exp(νᵢfᵢ − τᵢfᵢ²/2). They share its algebra, predictions and evidence gradient. K is never inverted: only
B = I + T^½ K T^½, T = diag(τ), with eigenvalues of 1 or more, is factorised. "R&W" is that book.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.spatial.distance import cdist
from scipy.special import erfcx, expit, log_expit, log_ndtr

from activefail.space.space import Array

_NEWTON_TOLERANCE, NEWTON_STEPS, _HALVINGS = 1e-12, 100, 40
"""Laplace's method stops once a further step promises less gain than this [nat]; limits of its two loops."""

_EP_TOLERANCE, EP_SWEEPS, _LEAST_SHARE = 1e-6, 400, 0.05
"""Expectation propagation stops once sites change less than this, in marginal standard deviations; limits."""


class SquaredExponentialPrior(NamedTuple):
    """Hyperparameters of a GP prior with a constant mean and a squared-exponential ARD covariance."""

    mean: float
    signal_variance: float
    length_scales: Array  # (m,), in units of the features


class Terms(NamedTuple):
    """log p(y | f) and its derivatives with respect to f at each point, (n,) each."""

    value: Array
    slope: Array
    curvature: Array  # minus the second derivative: not negative, as the likelihoods are log-concave
    third: Array


Likelihood = Callable[[Array, Array], Terms]
"""Maps labels, (n,) of -1 and 1, and latents, (n,), to the terms of the log likelihood."""


class SiteParameters(NamedTuple):
    """Natural parameters of a Gaussian factor for each training point: exp(linear f − precision f²/2)."""

    linear: Array  # (n,) ν
    precision: Array  # (n,) τ, not negative


class GaussianApproximation(NamedTuple):
    """A Gaussian approximation of the posterior at n training points, with terms for predictions and gradients."""

    sites: SiteParameters
    alpha: Array  # (n,) K⁻¹ (posterior mean − m)
    cholesky_b: Array  # (n, n) lower factor of B = I + T^½ K T^½
    log_evidence: float  # log Z, the approximate log marginal likelihood
    implicit: Array  # (n,) (I + T K)⁻¹ ∂log Z/∂f̂ of Laplace's mode f̂; zero where the sites are stationary
    iterations: int
    converged: bool


def covariance(F: Array, G: Array, hyperparameters: SquaredExponentialPrior) -> Array:
    """k(f, g) = s² exp(−½ Σ (f_d − g_d)²/ℓ_d²) of features, (n, m) and (l, m) -> (n, l); R&W eq. 5.1."""
    scales = hyperparameters.length_scales
    return np.asarray(hyperparameters.signal_variance * np.exp(-0.5 * cdist(F / scales, G / scales, "sqeuclidean")))


def normal_ratio(z: Array) -> Array:
    """φ(z)/Φ(z), shape of z, accurate in both tails."""
    return np.asarray(math.sqrt(2.0 / math.pi) / erfcx(-z / math.sqrt(2.0)))


def probit(y: Array, f: Array) -> Terms:
    """Terms of log Φ(yf); R&W eq. 3.16, and its third derivative."""
    z = y * f
    ratio = normal_ratio(z)
    slope = ratio + z  # of -log ratio
    return Terms(log_ndtr(z), y * ratio, ratio * slope, y * ratio * (slope * slope + ratio * slope - 1.0))


def logistic(y: Array, f: Array) -> Terms:
    """Terms of −log(1 + exp(−yf)); R&W eq. 3.15, and its third derivative."""
    p, q = expit(f), expit(-f)
    return Terms(log_expit(y * f), y * expit(-y * f), p * q, p * q * (p - q))


def _factor(K: Array, sites: SiteParameters) -> tuple[Array, Array]:
    """T^½, (n,), and the lower Cholesky factor of B, (n, n)."""
    root = np.sqrt(sites.precision)
    B = root[:, None] * K * root
    B.flat[:: len(root) + 1] += 1.0
    return root, cholesky(B, lower=True, check_finite=False)


def _shrunk(x: Array, K: Array, root: Array, L: Array) -> Array:
    """(I + T K)⁻¹ x, (n,): T^½ B⁻¹ T^-½ x, or x − T^½ B⁻¹ T^½ K x for tiny precisions.

    The book always uses the latter (Algorithm 3.1, line 6), which loses half of all digits if the prior is wide and its
    mean far from the labels.
    """
    significant = root > 1e-6
    rest = np.where(significant, 0.0, x)
    inner = np.divide(x, root, out=np.zeros_like(x), where=significant) - root * (K @ rest)
    return np.asarray(rest + root * cho_solve((L, True), inner, check_finite=False))


def _solve(K: Array, mean: float, sites: SiteParameters, root: Array, L: Array) -> Array:
    """α = K⁻¹ (posterior mean − m) of given sites, (n,)."""
    return _shrunk(sites.linear - sites.precision * mean, K, root, L)


def _variances(K: Array, root: Array, L: Array) -> Array:
    """Marginal variances at the training points, (n,): the diagonal of K − K T^½ B⁻¹ T^½ K."""
    V = solve_triangular(L, root[:, None] * K, lower=True, check_finite=False)
    return np.asarray(K.diagonal() - np.einsum("ij,ij->j", V, V))


def laplace_posterior(
    K: Array, mean: float, y: Array, likelihood: Likelihood = probit, start: SiteParameters | None = None
) -> GaussianApproximation:
    """Laplace's approximation: a Gaussian at the posterior mode; R&W Algorithms 3.1 and 5.1.

    Newton's method on the concave ψ(f) = log p(y | f) − ½ (f − m)ᵀ K⁻¹ (f − m), with steps halved until ψ increases.

    Args:
        K: prior covariance at the training points, (n, n).
        mean: of the prior.
        y: labels, (n,) of -1 and 1.
        start: sites of a similar problem; the search starts from their mean if that is better than the prior's.
    """

    def objective(a: Array, f: Array) -> float:
        return float(likelihood(y, f).value.sum() - 0.5 * a @ (f - mean))

    alpha, f = np.zeros(len(y)), np.full(len(y), mean)
    value = objective(alpha, f)
    if start is not None:
        warm = _solve(K, mean, start, *_factor(K, start))
        from_warm = objective(warm, mean + K @ warm)
        if from_warm > value:
            alpha, f, value = warm, mean + K @ warm, from_warm

    converged = False
    for iteration in range(NEWTON_STEPS + 1):
        terms = likelihood(y, f)
        sites = SiteParameters(terms.slope + terms.curvature * f, terms.curvature)
        root, L = _factor(K, sites)
        if converged or iteration == NEWTON_STEPS:
            break
        step = _solve(K, mean, sites, root, L) - alpha
        step_f = K @ step
        # Half the squared Newton decrement. The last step is still taken: log |B| can be steep where ψ is flat.
        converged = bool(0.5 * (terms.slope - alpha) @ step_f < _NEWTON_TOLERANCE)
        share = 1.0
        for _ in range(0 if converged else _HALVINGS):
            if objective(alpha + share * step, f + share * step_f) >= value:
                break
            share *= 0.5
        alpha, f = alpha + share * step, f + share * step_f
        value = objective(alpha, f)

    log_evidence = value - np.log(L.diagonal()).sum()
    implicit = _shrunk(0.5 * _variances(K, root, L) * terms.third, K, root, L)
    return GaussianApproximation(sites, alpha, L, float(log_evidence), implicit, iteration, converged)


class _Tilted(NamedTuple):
    """The tilted distributions of expectation propagation, (n,) each."""

    log_evidence: Array  # log Ẑᵢ
    target: SiteParameters  # sites that match their moments


def _match(mean: Array, precision: Array, y: Array) -> _Tilted:
    """Match the moments of Φ(yf) N(f | mean, 1/precision), for cavities with these moments, (n,) each.

    Uses the derivatives of log Ẑ by the cavity mean, equivalent to the moments of R&W eq. 3.58 but without cancellation
    in the tails.
    """
    variance = 1.0 / precision
    scale = np.sqrt(1.0 + variance)
    z = y * mean / scale
    ratio = normal_ratio(z)
    slope, curvature = y * ratio / scale, ratio * (z + ratio) / scale**2
    shrink = 1.0 - curvature * variance  # tilted over cavity variance
    return _Tilted(log_ndtr(z), SiteParameters((slope + curvature * mean) / shrink, curvature / shrink))


def ep_posterior(K: Array, mean: float, y: Array, start: SiteParameters | None = None) -> GaussianApproximation:
    """Expectation propagation for the probit likelihood; R&W Algorithm 3.5, with the evidence of eq. 3.65.

    Updates all sites in parallel instead of in turn; the fixed point is the same. Full steps can oscillate around it,
    so each step is damped by a share that would be exact if the map were linear.

    Args:
        K: prior covariance at the training points, (n, n).
        mean: of the prior.
        y: labels, (n,) of -1 and 1.
        start: sites of a similar problem, to start from.
    """
    sites = SiteParameters(np.zeros(len(y)), np.zeros(len(y))) if start is None else start
    share, last_change, converged = 1.0, np.zeros(2 * len(y)), False
    for iteration in range(EP_SWEEPS + 1):
        root, L = _factor(K, sites)
        alpha = _solve(K, mean, sites, root, L)
        variance, offset = _variances(K, root, L), K @ alpha
        cavity_precision = 1.0 / variance - sites.precision
        cavity_linear = (mean + offset) / variance - sites.linear
        tilted = _match(cavity_linear / cavity_precision, cavity_precision, y)
        linear, precision = (new - old for new, old in zip(tilted.target, sites, strict=True))
        # The change of the sites around the marginal mean, in marginal standard deviations.
        change = np.concatenate([(linear - precision * (mean + offset)) * np.sqrt(variance), precision * variance])
        converged = bool(np.abs(change).max() < _EP_TOLERANCE)
        if converged or iteration == EP_SWEEPS:
            break
        if iteration > 0:
            # Along the last step, change = (1 − share r) last_change; a share of 1/r would have made it zero.
            r = float(1.0 - (change @ last_change) / (last_change @ last_change)) / share
            share = min(1.0, max(_LEAST_SHARE, 1.0 / r)) if r > 0.0 else 1.0
        last_change = change
        sites = SiteParameters(sites.linear + share * linear, sites.precision + share * precision)

    return GaussianApproximation(
        sites,
        alpha,
        L,
        _ep_log_evidence(mean, sites, L, offset, cavity_linear, cavity_precision, tilted.log_evidence),
        np.zeros(len(y)),
        iteration,
        converged,
    )


def _ep_log_evidence(
    mean: float,
    sites: SiteParameters,
    L: Array,
    offset: Array,
    cavity_linear: Array,
    cavity_precision: Array,
    tilted: Array,
) -> float:
    """log Z of expectation propagation, R&W eq. 3.65, in terms of f − m and without cancellation.

    Each site is scaled such that cavity times site has the same evidence as cavity times likelihood.
    """
    p, t = sites.linear - sites.precision * mean, sites.precision
    q, s = cavity_linear - cavity_precision * mean, cavity_precision
    joint = 0.5 * p @ offset - np.log(L.diagonal()).sum()  # log ∫ N(f | m, K) ∏ exp(p (f−m) − t (f−m)²/2)
    scales = tilted + 0.5 * np.log1p(t / s) + 0.5 * (q * q * t / s - 2.0 * q * p - p * p) / (s + t)
    return float(joint + scales.sum())


def evidence_gradient(
    F: Array, K: Array, hyperparameters: SquaredExponentialPrior, posterior: GaussianApproximation
) -> tuple[float, float, Array]:
    """Gradient of log Z by the mean, log signal variance and log length scales, (m,); R&W Algorithms 5.1 and 5.2.

    d log Z = ½ αᵀdK α − ½ tr(R dK) + uᵀdK α + (α + u)ᵀ1 dm with R = T^½ B⁻¹ T^½ and u the posterior's `implicit`. The
    terms in u come from the shift of Laplace's mode.
    """
    alpha, u = posterior.alpha, posterior.implicit
    half = solve_triangular(
        posterior.cholesky_b, np.diag(np.sqrt(posterior.sites.precision)), lower=True, check_finite=False
    )
    both = np.outer(0.5 * alpha + u, alpha)
    weights: Array = (0.5 * (both + both.T) - 0.5 * half.T @ half) * K  # ∂log Z/∂log K, by element
    X = F / hyperparameters.length_scales
    # ∂log K_ij/∂log ℓ_d = (x_id − x_jd)²
    by_scale = 2.0 * (weights.sum(1) @ (X * X) - np.einsum("id,id->d", X, weights @ X))
    return float((alpha + u).sum()), float(weights.sum()), np.asarray(by_scale)


def predict(
    F: Array, hyperparameters: SquaredExponentialPrior, posterior: GaussianApproximation, at: Array
) -> tuple[Array, Array]:
    """Latent mean and variance at features, (l, m) -> (l,) each; R&W Algorithms 3.2 and 3.6 before averaging."""
    Ks = covariance(F, at, hyperparameters)
    root = np.sqrt(posterior.sites.precision)
    V = solve_triangular(posterior.cholesky_b, root[:, None] * Ks, lower=True, check_finite=False)
    # Rounding can make it negative.
    variance = np.maximum(hyperparameters.signal_variance - np.einsum("ij,ij->j", V, V), 0.0)
    return hyperparameters.mean + posterior.alpha @ Ks, variance
