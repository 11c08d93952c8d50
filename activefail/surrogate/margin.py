"""GP regression of a limit-state margin, negative beyond an outcome's boundary: sites, warping and length scales.

A margin says more than its sign, so its boundary needs far fewer simulations. Where a simulation ends at failure, a
failed design's margin says no more than its sign: it is censored, and expectation propagation takes it as "at most 0"
([RasmussenWilliams2006, section 3.6] with a step in place of the probit).

Margins are first warped by a function that keeps their sign: g/q, asinh(g/q) or asinh(5g/q), q the median of |g|. The
warping with the largest likelihood of the margins themselves is chosen.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.special import erfcx, log_ndtr

from activefail.space import Array
from activefail.surrogate.covariance import Hyperparameters, covariance_array, covariance_gradient
from activefail.surrogate.fitting import unpack
from activefail.surrogate.moments import MarginMoments

if TYPE_CHECKING:
    import torch

    from activefail.surrogate.gpytorch_model import MarginModel
else:
    from activefail.surrogate import lazy_torch as torch

KERNEL = "matern52"
"""The kernel of every regression."""

NUGGET = 1e-6
"""Variance of the margins' noise in units of the output scale, for a margin computed to a finite accuracy."""

WARPINGS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "none": (lambda g: g, np.zeros_like),
    "asinh": (np.arcsinh, lambda g: -0.5 * np.log1p(g * g)),
    "asinh5": (lambda g: np.arcsinh(5.0 * g), lambda g: math.log(5.0) - 0.5 * np.log1p(25.0 * g * g)),
}
"""Each warping of g/q and the logarithm of its derivative."""

_CENSORED_SPREAD = 0.01
"""Largest range of the failed designs' margins, in standard deviations of the others', that is taken as truncation."""

_TIED = 3
"""Fewest different designs with the largest margin that show that it is clipped."""

_SWEEPS, _DAMPING, _TOLERANCE = 300, 0.7, 1e-9
"""Most sweeps of expectation propagation, its share of a step, and the relative change of precisions that ends it."""


_ALWAYS, _GROWTH = 30, 0.05
"""Number of points up to which hyperparameters are always relearned, and the growth that triggers it beyond."""

LEARNED_ON = 1000
"""Most points for learning hyperparameters: a step of the search costs the cube of their number. They are evenly spread
over the sorted margins; a surplus of points near the boundary would make the regression too sure of itself."""

COARSE = 500
"""Most points for choosing a warping; with more, the hyperparameters learned there are the starting point."""

EXACT = 2000
"""Most points in a posterior: a prediction costs the square of their number."""

ROWS_AT_ONCE = 4096
"""Most points per call of a prediction, which limits its memory to n x 4096 numbers."""

LARGEST_FEATURE = 1e3
"""Largest magnitude of a scaled feature in a prediction, in standard deviations over the design space."""

_FARTHEST = 30.0
"""Largest mean of a censored point's cavity in its standard deviations."""


def length_scale_prior(dimension: int) -> tuple[float, float]:
    """Mean and standard deviation of a length scale's logarithm: median 2√d, in units of the features' spread.

    It is narrower than the classifier's (`covariance.length_scale_prior`): with a dozen margins the likelihood alone
    would take some variables for irrelevant.
    """
    return math.log(2.0 * math.sqrt(dimension)), 1.0


def is_truncated(margin: Array) -> bool:
    """Whether margins, (n,), end at failure, so that those at most 0 say no more than their sign.

    They do if the failed designs' margins differ by at most 1 % of the standard deviation of the others. A single
    failed design counts as truncated if its margin is that close to 0.
    """
    failed, others = margin[margin <= 0.0], margin[margin > 0.0]
    if len(failed) == 0 or len(others) < 2:
        return False
    # In units of the largest: squares of huge margins would overflow.
    largest = others.max()
    reach = np.ptp(failed / largest) if len(failed) > 1 else -failed[0] / largest
    return bool(reach <= _CENSORED_SPREAD * (others / largest).std())


def informative(margin: Array, truncated: bool, most: int) -> NDArray[np.intp]:
    """Rows of at most `most` points that stand for all, in order: half are nearest the boundary, half evenly spread.

    A censored margin, (n,), does not say how near it is, so such points are among the spread ones.
    """
    if len(margin) <= most:
        return np.arange(len(margin))
    order = np.argsort(np.where(truncated & (margin <= 0.0), np.inf, np.abs(margin)), kind="stable")
    nearest, others = order[: most // 2], np.sort(order[most // 2 :])
    spread = others[np.linspace(0, len(others) - 1, most - len(nearest)).astype(int)]
    return np.sort(np.concatenate([nearest, spread]))


class CensoredSites(NamedTuple):
    """Gaussian sites of the k censored points: exp(linear f − precision f²/2)."""

    linear: Array  # (k,)
    precision: Array  # (k,)


class CensoredPosterior(NamedTuple):
    """Expectation propagation's result for the censored points, given the others."""

    sites: CensoredSites
    log_evidence: float


def censored_posterior(mean: Array, S: Array, sites: CensoredSites) -> CensoredPosterior:
    """Expectation propagation for f ~ N(mean, S), (k,) and (k, k), with f ≤ 0 in every entry, from initial sites.

    All sites take a damped step at once: a site after the other needs k times the algebra.
    """
    linear, precision = sites
    for _ in range(_SWEEPS):
        _, m, variance, _ = _with_sites(mean, S, linear, precision)
        cavity_precision, cavity_mean, z = _cavities(m, variance, linear, precision)
        sd = cavity_precision**-0.5
        ratio = math.sqrt(2.0 / math.pi) / erfcx(-z / math.sqrt(2.0))  # φ(z)/Φ(z)
        # Far above 0 the tilted variance is about sd²/z², which the difference loses to rounding.
        shrunk = np.maximum(1.0 - ratio * (z + ratio), 0.3 / (1.0 + z * z))
        tilted_precision = cavity_precision / shrunk
        new_precision = np.maximum(tilted_precision - cavity_precision, 0.0)
        new_linear = tilted_precision * (cavity_mean - sd * ratio) - cavity_precision * cavity_mean
        moved = np.abs(new_precision - precision) / (1.0 / variance + precision)
        linear = linear + _DAMPING * (new_linear - linear)
        precision = precision + _DAMPING * (new_precision - precision)
        if moved.max() <= _TOLERANCE:
            break
    log_determinant, m, variance, quadratic = _with_sites(mean, S, linear, precision)
    cavity_precision, cavity_mean, z = _cavities(m, variance, linear, precision)
    # log ∫ N(f; mean, S) Π t_i(f_i), each site scaled so that it has the step's integral against its cavity.
    scale = log_ndtr(z) + 0.5 * np.log1p(precision / cavity_precision)
    tilted = (cavity_precision * cavity_mean + linear) ** 2 / (cavity_precision + precision)
    scale += 0.5 * (cavity_precision * cavity_mean**2 - tilted)
    return CensoredPosterior(CensoredSites(linear, precision), float(scale.sum()) + quadratic - 0.5 * log_determinant)


def _with_sites(mean: Array, S: Array, linear: Array, precision: Array) -> tuple[float, Array, Array, float]:
    """Of N(mean, S) times Gaussian sites: log |I + P S|, its mean and variances, and the exponent of its integral."""
    root = np.sqrt(precision)
    L = cholesky(np.eye(len(mean)) + root[:, None] * S * root, lower=True)
    whitened = solve_triangular(L, root[:, None] * S, lower=True)
    pull = linear - precision * mean
    step = S @ pull - whitened.T @ (whitened @ pull)
    quadratic = float(linear @ mean - 0.5 * mean @ (precision * mean) + 0.5 * pull @ step)
    variance = np.maximum(S.diagonal() - np.einsum("ij,ij->j", whitened, whitened), 1e-12 * S.diagonal())
    return 2.0 * float(np.log(L.diagonal()).sum()), mean + step, variance, quadratic


def _cavities(m: Array, variance: Array, linear: Array, precision: Array) -> tuple[Array, Array, Array]:
    """Precisions and means of the marginals without their own sites, and z with P(f ≤ 0) = Φ(z)."""
    cavity_precision = np.maximum(1.0 / variance - precision, 1e-6 / variance)
    cavity_mean = (m / variance - linear) / cavity_precision
    # Only a line search meets cavities this far above 0; sites that follow them would diverge.
    cavity_mean = np.minimum(cavity_mean, _FARTHEST / np.sqrt(cavity_precision))
    return cavity_precision, cavity_mean, -cavity_mean * np.sqrt(cavity_precision)


class Solved(NamedTuple):
    """What predictions of a regression need of A = K + site variances at its s support points."""

    L: Array  # (s, s), lower; A = LLᵀ
    weights: Array  # (s,), A⁻¹(target − mean)
    ones: Array  # (s,), A⁻¹1
    total: float  # 1ᵀA⁻¹1


@dataclass(frozen=True)
class MarginFit:
    """A trained regression of a margin.

    Attributes:
        features: (n, m) scaled features.
        margin: (n,) margins as the simulator gives them.
        truncated: whether margins at most 0 are censored.
        warping: name of the warping.
        unit: q, the unit of the margins before warping.
        hyperparameters: of the warped margin's prior.
        sites: of the censored points; 0 outside the support.
        log_likelihood: of the margins, with the warping's derivative and the log prior of the length scales; NaN if the
            hyperparameters are those of other points.
        learned_on: number of points when the hyperparameters were last learned.
    """

    features: Array
    margin: Array
    truncated: bool
    warping: str
    unit: float
    hyperparameters: Hyperparameters
    sites: CensoredSites
    log_likelihood: float
    learned_on: int

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Rows of the support points, (s,): the posterior is that of at most `EXACT` points (`informative`)."""
        return informative(self.margin, self.truncated, EXACT)

    @cached_property
    def support(self) -> Array:
        """Scaled features of the support points, (s, m)."""
        return self.features[self.rows]

    @property
    def size_of_support(self) -> int:
        """Number of support points; 0 if all points are."""
        return len(self.rows) if len(self.rows) < len(self.margin) else 0

    @cached_property
    def solved(self) -> "Solved":
        """The solution of the linear system of the predictions."""
        A, target = linear_system(self)
        L = cholesky(A, lower=True)
        ones = cho_solve((L, True), np.ones(len(A)))
        return Solved(L, cho_solve((L, True), target - self.hyperparameters.mean), ones, float(ones.sum()))

    @cached_property
    def is_clipped(self) -> bool:
        """Whether the margin is clipped: three or more different designs have the largest one, which is positive.

        A repeated design has the same margin again, which shows nothing.
        """
        top = self.margin.max()
        return bool(top > 0.0 and len(np.unique(self.features[self.margin == top], axis=0)) >= _TIED)

    def _covariance(self, F: Array) -> Array:
        return covariance_array(KERNEL, self.hyperparameters, self.support, F)

    def moments(self, F: Array) -> tuple[Array, Array]:
        """Mean and standard deviation of the warped margin at scaled features, (l, m); each (l,).

        The variance includes that of the estimated constant mean.
        """
        L, weights, ones, total = self.solved
        k = self._covariance(F)
        explained = solve_triangular(L, k, lower=True)
        s2 = math.exp(self.hyperparameters.log_outputscale)
        variance = s2 * (1.0 + NUGGET) - np.einsum("ij,ij->j", explained, explained) + (1.0 - ones @ k) ** 2 / total
        return self.hyperparameters.mean + k.T @ weights, np.sqrt(np.maximum(variance, NUGGET * s2))

    def between(self, F: Array, G: Array) -> Array:
        """Covariance of the warped margins at scaled features, (l, m) and (k, m) -> (l, k), without the nugget."""
        L, _, ones, total = self.solved
        k, j = self._covariance(F), self._covariance(G)
        prior = covariance_array(KERNEL, self.hyperparameters, F, G)
        explained = solve_triangular(L, k, lower=True).T @ solve_triangular(L, j, lower=True)
        return np.asarray(prior - explained + np.outer(1.0 - ones @ k, 1.0 - ones @ j) / total)

    def joint(self, F: Array) -> tuple[Array, Array]:
        """Mean, (l,), and covariance, (l, l), of the warped margin at scaled features, (l, m)."""
        _, weights, _, _ = self.solved
        K = self.between(F, F)
        K[np.diag_indices(len(K))] += NUGGET * math.exp(self.hyperparameters.log_outputscale)
        return self.hyperparameters.mean + self._covariance(F).T @ weights, K

    def left_out(self) -> tuple[Array, Array]:
        """Mean and standard deviation of each warped margin from all others, at the same hyperparameters; each (n,).

        In closed form [RasmussenWilliams2006, section 5.4.2]. A censored point's own site is left out too. A point
        outside the support is left out as it is.
        """
        A, target = linear_system(self)
        L, _, ones, total = self.solved
        Q = _inverse(L) - np.outer(ones, ones) / total
        diagonal = Q.diagonal()
        # The variance of a left-out observation includes its own site's variance, which is not that of the margin.
        s2 = math.exp(self.hyperparameters.log_outputscale)
        of_sites = A.diagonal() - s2 * (1.0 + NUGGET)
        variance = 1.0 / diagonal - of_sites
        # A site that says almost nothing has a variance that swallows the difference's digits.
        vague = of_sites > s2
        if vague.any():
            with_site = self.moments(self.support[vague])[1] ** 2
            variance[vague] = with_site / (1.0 - with_site / of_sites[vague])
        own = target - (Q @ target) / diagonal, np.sqrt(np.maximum(variance, 1e-12))
        if len(self.rows) == len(self.margin):
            return own
        mean, sd = self.moments(self.features)
        mean[self.rows], sd[self.rows] = own
        return mean, sd

    def warped(self, margin: Array) -> Array:
        """Margins, (l,), in the units of `moments`."""
        return WARPINGS[self.warping][0](margin / self.unit)

    def sign_score(self) -> float:
        """Mean log probability of the left-out designs' sides of the boundary [nat]."""
        mean, sd = self.left_out()
        side = np.where(self.margin <= 0.0, -1.0, 1.0)
        return float(log_ndtr(side * mean / sd).mean())


def linear_system(trained: MarginFit) -> tuple[Array, Array]:
    """A = K + site variances, (s, s), and the sites' means, (s,): the warped margins where they are not censored."""
    A = covariance_array(KERNEL, trained.hyperparameters, trained.support, trained.support)
    margin = trained.margin[trained.rows]
    target = trained.warped(margin)
    noise = np.full(len(A), NUGGET * math.exp(trained.hyperparameters.log_outputscale))
    if trained.truncated:
        failed = margin <= 0.0
        taken = np.isin(np.flatnonzero(trained.margin <= 0.0), trained.rows)
        precision = np.maximum(trained.sites.precision[taken], 1e-12)
        noise[failed] += 1.0 / precision
        target[failed] = trained.sites.linear[taken] / precision
    A[np.diag_indices(len(A))] += noise
    return A, target


def _inverse(L: Array) -> Array:
    """(LLᵀ)⁻¹ of a lower factor, (n, n)."""
    inverse, _ = dpotri(L, lower=1)  # its lower triangle, over that of L
    return np.asarray(inverse + np.tril(inverse, -1).T)


class PenalisedLikelihood(NamedTuple):
    """The objective of the hyperparameters' search."""

    value: float
    gradient: Array  # by `packed`
    sites: CensoredSites


class _Conditioned(NamedTuple):
    """Log likelihood of warped margins, the censored points' sites, and A = K + site variances."""

    value: float
    sites: CensoredSites
    L: Array  # (n, n), lower; A = LLᵀ
    b: Array  # (n,), A⁻¹(target − mean)


def _conditioned(K: Array, y: Array, censored: NDArray[np.bool_], mean: float, sites: CensoredSites) -> _Conditioned:
    """Of warped margins y, (n,), under N(mean, K), with the censored ones' sites iterated from `sites`."""
    exact = ~censored
    L = cholesky(K[np.ix_(exact, exact)], lower=True)
    away = y[exact] - mean
    alpha = cho_solve((L, True), away)
    value = -0.5 * float(away @ alpha) - float(np.log(L.diagonal()).sum()) - 0.5 * len(away) * math.log(2.0 * math.pi)
    if exact.all():
        return _Conditioned(value, sites, L, alpha)
    cross = K[np.ix_(exact, censored)]
    whitened = solve_triangular(L, cross, lower=True)
    S = K[np.ix_(censored, censored)] - whitened.T @ whitened
    result = censored_posterior(mean + cross.T @ alpha, S, sites)
    precision = np.maximum(result.sites.precision, 1e-12)
    A, target = K.copy(), y - mean
    A[censored, censored] += 1.0 / precision
    target[censored] = result.sites.linear / precision - mean
    L = cholesky(A, lower=True)
    return _Conditioned(value + result.log_evidence, result.sites, L, cho_solve((L, True), target))


def _prior(features: Array, h: Hyperparameters) -> tuple[Array, Array]:
    """Covariance of warped margins without and with the nugget, each (n, n)."""
    plain = covariance_array(KERNEL, h, features, features)
    K = plain.copy()
    K[np.diag_indices(len(K))] += NUGGET * math.exp(h.log_outputscale)
    return plain, K


def penalised_likelihood(
    features: Array, y: Array, censored: NDArray[np.bool_], packed: Array, sites: CensoredSites
) -> PenalisedLikelihood:
    """Log likelihood of warped margins plus the log prior of the length scales, and its gradient."""
    h = unpack(packed)
    plain, K = _prior(features, h)
    value, sites, L, b = _conditioned(K, y, censored, h.mean, sites)
    # At the sites' fixed point the likelihood changes with K as that of Gaussian observations does.
    by_K = 0.5 * (np.outer(b, b) - _inverse(L))
    X, plain_tensor, by_K_tensor = (torch.from_numpy(array) for array in (features, plain, by_K))
    by_scales = covariance_gradient(KERNEL, h, X, X, plain_tensor, by_K_tensor).numpy()
    by_scales[0] += NUGGET * math.exp(h.log_outputscale) * float(np.trace(by_K))
    center, sd = length_scale_prior(features.shape[1])
    offset = (packed[2:] - center) / sd
    value -= 0.5 * float(offset @ offset) + len(offset) * (math.log(sd) + 0.5 * math.log(2.0 * math.pi))
    by_scales[1:] -= offset / sd
    return PenalisedLikelihood(value, np.concatenate([[b.sum()], by_scales]), sites)


def fit_margin(
    features: Array, margin: Array, truncated: bool | None = None, warm: MarginFit | None = None
) -> MarginFit:
    """Fit a GP to margins.

    The hyperparameters are learned on at most `LEARNED_ON` points, and the posterior is that of at most `EXACT`.

    Args:
        features: (n, m) scaled features.
        margin: (n,) margins; failure is at most 0.
        truncated: whether margins at most 0 are censored; decided by `is_truncated` if None.
        warm: an earlier fit to the first of these points, whose length scales are the starting point. With more than
            `_ALWAYS` points its hyperparameters are kept until the number of points has grown by `_GROWTH`.

    Raises:
        ValueError: if there are fewer than two margins, one is not finite, or all are equal; or, truncated, if fewer
            than two are positive.
    """
    if len(margin) < 2 or not np.isfinite(margin).all() or np.ptp(margin) == 0.0:
        raise ValueError("regression needs two margins or more that are finite and not all equal")
    truncated = is_truncated(margin) if truncated is None else truncated
    if truncated and (margin > 0.0).sum() < 2:
        raise ValueError("regression on truncated margins needs two that are positive")
    if warm is not None and truncated == warm.truncated and _ALWAYS < len(margin) < (1.0 + _GROWTH) * warm.learned_on:
        return _solved_at(features, margin, warm)
    n = len(margin)
    best = warm
    if best is None or truncated != best.truncated or min(n, best.learned_on) <= COARSE:
        rows = _spread(margin, COARSE)
        fits = [_fit_warped(features[rows], margin[rows], truncated, name, warm) for name in WARPINGS]
        best = max(fits, key=lambda fitted: fitted.log_likelihood)
    if n > COARSE:
        rows = _spread(margin, LEARNED_ON)
        best = _fit_warped(features[rows], margin[rows], truncated, best.warping, best)
    return best if len(best.margin) == n else _solved_at(features, margin, replace(best, learned_on=n))


def _spread(margin: Array, most: int) -> NDArray[np.intp]:
    """Rows of at most `most` points, in order, evenly spread over the sorted margins, (n,)."""
    if len(margin) <= most:
        return np.arange(len(margin))
    return np.sort(np.argsort(margin, kind="stable")[np.linspace(0, len(margin) - 1, most).astype(int)])


def _solved_at(features: Array, margin: Array, warm: MarginFit) -> MarginFit:
    """The fit to other points with the warping and the hyperparameters of an earlier one."""
    failed = np.flatnonzero((margin <= 0.0) & warm.truncated)
    sites = CensoredSites(np.zeros(len(failed)), np.zeros(len(failed)))
    fitted = replace(warm, features=features, margin=margin, sites=sites, log_likelihood=math.nan)
    taken = np.isin(failed, fitted.rows)
    if taken.any():
        y, censored = fitted.warped(margin[fitted.rows]), np.isin(fitted.rows, failed)
        start = _first_sites(censored, max(float(y[~censored].std()), 1e-3))
        _, K = _prior(fitted.support, warm.hyperparameters)
        found = _conditioned(K, y, censored, warm.hyperparameters.mean, start).sites
        sites.linear[taken], sites.precision[taken] = found
    return fitted


def _first_sites(censored: NDArray[np.bool_], scale: float) -> CensoredSites:
    k = int(censored.sum())
    return CensoredSites(np.full(k, -0.1 / scale), np.full(k, 0.1 / scale**2))


def _fit_warped(features: Array, margin: Array, truncated: bool, warping: str, warm: MarginFit | None) -> MarginFit:
    from scipy.optimize import minimize

    censored = (margin <= 0.0) & truncated
    exact = margin[~censored]
    unit = float(np.median(np.abs(exact))) or float(np.abs(exact).max())
    warp, log_slope = WARPINGS[warping]
    y = warp(margin / unit)
    center, _ = length_scale_prior(features.shape[1])
    scale = max(float(y[~censored].std()), 1e-3)
    lengths = np.full(features.shape[1], center) if warm is None else warm.hyperparameters.log_lengthscale
    start = np.concatenate([[float(y[~censored].mean()), 2.0 * math.log(2.0 * scale)], lengths])
    sites = _first_sites(censored, scale)

    def negative(packed: Array) -> tuple[float, Array]:
        nonlocal sites
        evaluation = penalised_likelihood(features, y, censored, packed, sites)
        sites = evaluation.sites
        return -evaluation.value, -evaluation.gradient

    spread = 2.0 * math.log(scale)
    exact_y = y[~censored]
    mean_bounds = (float(exact_y.min()) - 20.0 * scale, float(exact_y.max()) + 3.0 * scale)
    bounds = [mean_bounds, (spread - 4.0, spread + 14.0)] + [(-4.0, 8.0)] * features.shape[1]
    optimum = minimize(negative, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 200})
    final = penalised_likelihood(features, y, censored, optimum.x, sites)
    jacobian = float((log_slope(exact / unit) - math.log(unit)).sum())
    return MarginFit(
        features=features,
        margin=margin,
        truncated=truncated,
        warping=warping,
        unit=unit,
        hyperparameters=unpack(optimum.x),
        sites=final.sites,
        log_likelihood=final.value + jacobian,
        learned_on=len(margin),
    )


@dataclass(frozen=True)
class MarginLatent:
    """The latent of a boundary that is learned from a margin: minus the warped margin, so positive beyond the boundary.

    It has the methods of `classifier.Latent`.

    Attributes:
        trained: the regression.
        level: of the margin at or below which a design is beyond the boundary: several boundaries of one margin share a
            regression.
        pending: (k, m) scaled features of designs whose margins are being computed. They do not change the means, and
            shrink the variances as if their margins were known.
    """

    trained: MarginFit
    level: float = 0.0
    pending: Array | None = None

    @property
    def threshold(self) -> float:
        """The level in the units of the warped margin."""
        return float(self.trained.warped(np.array(self.level)))

    @property
    def features(self) -> Array:
        """Scaled features of the training points and of the pending designs, (n + k, m)."""
        known = self.trained.features
        return known if self.pending is None else np.concatenate([known, self.pending])

    @property
    def is_one_sided(self) -> bool:
        """Whether nothing can be learned yet; a margin always teaches something."""
        return False

    @cached_property
    def model(self) -> "MarginModel":
        """The posterior, without pending designs, as a BoTorch model over the scaled features, (..., q, m)."""
        from activefail.surrogate.gpytorch_model import MarginModel

        return MarginModel(self.trained, self.threshold)

    @cached_property
    def _pending_factor(self) -> Array:
        assert self.pending is not None
        return np.asarray(cholesky(self.trained.joint(self.pending)[1], lower=True))

    def _explained(self, F: Array) -> Array:
        """(k, l): its columns' products are the covariances that the pending designs explain."""
        assert self.pending is not None
        return np.asarray(solve_triangular(self._pending_factor, self.trained.between(self.pending, F), lower=True))

    def moments(self, F: Array) -> MarginMoments:
        """Marginal mean and standard deviation at scaled features, (n, m)."""
        F = np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE)
        rows = range(0, max(1, len(F)), ROWS_AT_ONCE)
        parts = [self._moments(F[first : first + ROWS_AT_ONCE]) for first in rows]
        mean, sd = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return MarginMoments(self.threshold - mean, sd)

    def _moments(self, F: Array) -> tuple[Array, Array]:
        mean, sd = self.trained.moments(F)
        if self.pending is None:
            return mean, sd
        least = NUGGET * math.exp(self.trained.hyperparameters.log_outputscale)
        return mean, np.sqrt(np.maximum(sd**2 - (self._explained(F) ** 2).sum(axis=0), least))

    def joint(self, F: Array) -> tuple[Array, Array]:
        """Joint mean, (n,), and covariance, (n, n), at scaled features, (n, m)."""
        F = np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE)
        mean, covariance = self.trained.joint(F)
        if self.pending is not None:
            explained = self._explained(F)
            covariance = covariance - explained.T @ explained
        return self.threshold - mean, covariance

    def deviations(self, F: Array, margin: Array) -> Array:
        """How far margins, (n,), lie beyond their means at scaled features, (n, m), in standard deviations.

        NaN where a margin is not finite, or censored.

        Args:
            F: the features.
            margin: in relation to the boundary, at most 0 beyond it.
        """
        own = margin + self.level
        exact = np.isfinite(own) & ~(self.trained.truncated & (own <= 0.0))
        moments = self.moments(F)
        warped = self.trained.warped(np.where(exact, own, 0.0))
        return np.where(exact, (self.threshold - warped - moments.mean) / moments.sd, np.nan)

    def left_out(self) -> MarginMoments:
        """Moments at each training point without its own margin, with hyperparameters unchanged, (n,)."""
        mean, sd = self.trained.left_out()
        return MarginMoments(self.threshold - mean, sd)

    def with_pending(self, F: Array) -> "MarginLatent":
        """The latent while the margins at scaled features F, (k, m), are being computed."""
        return replace(self, pending=F if self.pending is None else np.concatenate([self.pending, F]))
