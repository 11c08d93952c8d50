"""GP regression of a limit-state margin, negative beyond the boundary: sites, warping, hyperparameters and how often.

A margin says more than its sign, so its boundary needs far fewer simulations. Where a simulation ends at failure, a
failed design's margin says no more than its sign: it is censored, and expectation propagation takes it as "at most 0"
([RasmussenWilliams2006, section 3.6] with a step in place of the probit).

Margins are first warped by a function that keeps their sign: g/q, asinh(g/q) or asinh(5g/q), q the median of |g|. The
warping with the largest likelihood of the margins themselves is chosen.
"""

import copy
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import gpytorch
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri

from activefail.learning.model.boundary_gp import BoundaryModel, SiteStrategy, joint, moments
from activefail.learning.model.censored import CensoredSites, censored_posterior, first_sites
from activefail.learning.model.covariance import NUGGET
from activefail.learning.model.inducing import choose
from activefail.learning.model.kernels import LEARNED_ON, POSITIVE, Bounds, Prior, Sloped, minimise, scaled_kernel
from activefail.learning.model.margin_data import KERNEL, NOISE, SLOPE, WARPINGS, MarginData, is_truncated, spread
from activefail.learning.model.moments import Moments, margin_moments
from activefail.learning.model.readout import EXACT, MarginReadout, Readout, margin_readout
from activefail.space.space import Array

_ALWAYS, _GROWTH = 30, 0.05
"""Number of points up to which hyperparameters are always relearned, and the growth that triggers it beyond."""

_SEARCH = {"ftol": 1e-7, "gtol": 1e-3, "maxiter": 200}
"""Options of L-BFGS: the likelihood is as good as found when a step gains a ten-millionth of it."""

_COARSE_SEARCH = {"ftol": 1e-5, "gtol": 1e-3, "maxiter": 200}
"""The same for many points: it costs a tenth of a nat of thousands, and saves half of the steps."""

_TESTED = 5000
"""Most deviations in a test of their distribution; for more, its p-value is not accurate."""

_FIRST_NOISE = 0.1
"""Variance of a margin's noise from which it is learned, in units of the margins' own."""

WARPED_ON = 500
"""Most points for choosing a warping by all of them; of more, half as many choose it and are the starting point."""

INDUCING = 1000
"""Most inducing points."""


@dataclass(frozen=True)
class MarginFit:
    """A trained regression of a margin.

    Attributes:
        data: the margins.
        prior: of the warped margin.
        log_likelihood: of the margins, with the warping's derivative and the log prior of the length scales; NaN if the
            hyperparameters are those of other points.
        learned_on: number of points when the hyperparameters were last learned.
    """

    data: MarginData
    prior: Prior
    log_likelihood: float
    learned_on: int

    @property
    def _one(self) -> torch.Tensor:
        return torch.from_numpy(self.data.features[:1])

    @cached_property
    def support(self) -> torch.Tensor:
        """Scaled features of the support points, (s, m)."""
        return torch.from_numpy(self.data.support)

    @cached_property
    def jitter(self) -> float:
        """Variance that stands for the finite accuracy of a warped margin."""
        return NUGGET * float(self.prior.typical_variance(self.data.features.shape[1]).detach())

    @property
    def noise(self) -> float:
        """Standard deviation of the simulator's noise, of a warped margin; 0 if it repeats."""
        return 0.0 if self.prior.likelihood is None else math.sqrt(float(self.prior.likelihood.noise.detach()))

    @cached_property
    def nugget(self) -> float:
        """Variance of a warped margin's noise, whatever its source."""
        return self.noise**2 or self.jitter

    @cached_property
    def mean(self) -> float:
        """Of the warped margin's prior."""
        return float(self.prior.mean_module(self._one).detach())

    @cached_property
    def readout(self) -> MarginReadout:
        """The matrices of predictions of the warped margin."""
        points, data = torch.from_numpy(self.data.points), self.data
        with torch.no_grad():
            K = self.prior.covariance(self.support).numpy()
            Kx = None if data.inducing is None else self.prior.covariance(self.support, points).numpy()
            variance = self.prior.variance(points).numpy()
        return margin_readout(K, Kx, variance, self.mean, *data.observed(self.nugget), self.jitter)

    @cached_property
    def gap(self) -> tuple[float, float]:
        """How far below and above the data's level the boundary may lie, of a warped margin (see `MarginData.gap`)."""
        return self.data.gap(self._moments, lambda F: self._of_exact._moments(F))

    @cached_property
    def _of_exact(self) -> "MarginFit":
        exact = self.data.margin > 0.0
        return _solved_at(self.data.features[exact], self.data.margin[exact], self)

    def model(self, threshold: float) -> BoundaryModel:
        """A threshold minus the warped margin, as a BoTorch model: positive beyond the boundary."""
        likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=gpytorch.constraints.Positive()).double()
        likelihood.noise = self.jitter  # the noise is a part of the posterior's variance
        readout, trend, _ = self.readout
        prior, of_latent = Prior(self.prior.covar_module, likelihood, {}), Readout(-readout.weights, readout.root)
        prior.mean_module.initialize(constant=threshold - self.mean)
        return BoundaryModel.of(SiteStrategy(prior, self.support, of_latent, trend, self.nugget))

    @cached_property
    def _at_zero(self) -> BoundaryModel:
        return self.model(0.0)

    def left_out(self) -> tuple[Array, Array]:
        """Mean and standard deviation of each warped margin from all others, at the same hyperparameters; each (n,).

        A point's own site is left out too. A point outside the posterior is left out as it is.
        """
        data = self.data
        own = self._left_out_of_all() if data.inducing is None else self._left_out_of_inducing()
        if len(data.rows) == len(data.margin):
            return own
        mean, sd = self._moments(data.features)
        mean[data.rows], sd[data.rows] = own
        return mean, sd

    @cached_property
    def normality(self) -> float:
        """How probable noise as unlike a normal distribution is, if it is normal: Shapiro and Wilk's p-value.

        The sample is the margins' deviations from their predictions by all others. NaN for a simulator that repeats.
        """
        from scipy.stats import shapiro

        if not self.noise:
            return math.nan
        mean, sd = self.left_out()
        exact = np.flatnonzero(~(self.data.truncated & (self.data.margin <= 0.0)))
        rows = spread(exact, _TESTED)
        return float(shapiro((self.data.warped(self.data.margin[rows]) - mean[rows]) / sd[rows]).pvalue)

    def _left_out_of_all(self) -> tuple[Array, Array]:
        """In closed form [RasmussenWilliams2006, section 5.4.2]."""
        target, of_sites = self.data.observed(self.nugget)
        (_, root), (ones, total), _ = self.readout
        Q = root.T @ root - np.outer(ones, ones) / total
        diagonal = Q.diagonal()
        # The variance of a left-out observation includes its own site's variance, which is not that of the margin.
        of_sites = of_sites - self.nugget
        variance = 1.0 / diagonal - of_sites
        # A site that says almost nothing has a variance that swallows the difference's digits.
        vague = of_sites > self.jitter / NUGGET
        if vague.any():
            with_site = self._moments(self.data.points[vague])[1] ** 2
            variance[vague] = with_site / (1.0 - with_site / of_sites[vague])
        return target - (Q @ target) / diagonal, np.sqrt(np.maximum(variance, 1e-12))

    def _left_out_of_inducing(self) -> tuple[Array, Array]:
        """By dividing the point's site out of the posterior [RasmussenWilliams2006, eq. 3.56]."""
        target, noise = self.data.observed(self.nugget)
        rest = self.readout.rest
        mean, sd = self._moments(self.data.points)
        explained = np.maximum(sd**2 - rest - self.nugget, 1e-12)
        precision = np.maximum(1.0 / explained - 1.0 / (noise + rest), 1e-12)
        of_others = (mean / explained - target / (noise + rest)) / precision
        return of_others, np.sqrt(1.0 / precision + rest + self.nugget)

    def _moments(self, F: Array) -> tuple[Array, Array]:
        """Mean and standard deviation of the warped margin at scaled features, (n, m); each (n,)."""
        mean, sd = self._at_zero.moments(torch.from_numpy(F))
        return -mean.numpy(), sd.numpy()


def _inverse(L: Array) -> Array:
    """(LLᵀ)⁻¹ of a lower factor, (n, n)."""
    inverse, _ = dpotri(L, lower=1)  # its lower triangle, over that of L
    return np.asarray(inverse + np.tril(inverse, -1).T)


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
    sites, log_evidence = censored_posterior(mean + cross.T @ alpha, S, sites)
    precision = np.maximum(sites.precision, 1e-12)
    A, target = K.copy(), y - mean
    A[censored, censored] += 1.0 / precision
    target[censored] = sites.linear / precision - mean
    L = cholesky(A, lower=True)
    return _Conditioned(value + log_evidence, sites, L, cho_solve((L, True), target))


def margin_prior(dimension: int, repeatable: bool = True) -> Prior:
    """The prior of a warped margin, without a prior of the output scale, whose unit is the margin's.

    The median of a length scale is 2√d, in units of the features' spread. Its prior is narrower than the classifier's:
    with a dozen margins the likelihood alone would take some variables for irrelevant.

    Args:
        dimension: d, the number of features.
        repeatable: whether the margin has no noise. That of a simulator that does not repeat is learned.
    """
    center = math.log(2.0 * math.sqrt(dimension))
    noise = None
    if not repeatable:
        noise = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=gpytorch.constraints.Positive(**POSITIVE))
    kernel = Sloped(scaled_kernel(KERNEL, dimension, (center, 1.0), None))
    prior = Prior(kernel, None if noise is None else noise.double(), {})
    prior.covar_module.base_kernel.initialize(lengthscale=math.exp(center))
    return prior


def penalised_likelihood(
    prior: Prior, features: Array, y: Array, censored: NDArray[np.bool_], sites: CensoredSites
) -> tuple[float, list[torch.Tensor], CensoredSites]:
    """Log likelihood of warped margins plus the prior's log density, its gradient by the parameters, and the sites.

    Args:
        prior: its parameters require gradients.
        features: (n, m).
        y: (n,) warped margins.
        censored: (n,) which margins say no more than their sign.
        sites: of the censored points, iterated from these.
    """
    F = torch.from_numpy(features)
    mean, K = prior.mean_module(F[:1]), prior.covariance(F)
    with_nugget = K.detach().numpy().copy()
    n = len(y)
    nugget = NUGGET * prior.typical_variance(F.shape[1]) if prior.likelihood is None else prior.likelihood.noise
    with_nugget[np.diag_indices(n)] += float(nugget.detach())
    value, sites, L, b = _conditioned(with_nugget, y, censored, float(mean.detach()), sites)
    # At the sites' fixed point the likelihood changes with K as that of Gaussian observations does.
    by_K = 0.5 * (np.outer(b, b) - _inverse(L))
    log_density = prior.log_density()
    gradient = torch.autograd.grad(
        (mean, K, log_density, nugget),
        list(prior.parameters()),
        (
            torch.full_like(mean, float(b.sum())),
            torch.from_numpy(by_K),
            torch.ones_like(log_density),
            torch.full_like(nugget, float(np.trace(by_K))),
        ),
    )
    return value + float(log_density.detach()), list(gradient), sites


def fit_margin(
    features: Array,
    margin: Array,
    truncated: bool | None = None,
    warm: MarginFit | None = None,
    repeatable: bool = True,
) -> MarginFit:
    """Fit a GP to margins.

    The hyperparameters are learned on at most `LEARNED_ON` points, and the posterior is that of at most `EXACT`.

    Args:
        features: (n, m) scaled features.
        margin: (n,) margins; failure is at most 0.
        truncated: whether margins at most 0 are censored; decided by `is_truncated` if None.
        warm: an earlier fit to the first of these points, whose length scales are the starting point. With more than
            `_ALWAYS` points its hyperparameters are kept until the number of points has grown by `_GROWTH`.
        repeatable: as for `margin_prior`.

    Raises:
        ValueError: if there are fewer than two margins, one is not finite, or all are equal; or, truncated, if fewer
            than two are positive.
    """
    if len(margin) < 2 or not np.isfinite(margin).all() or np.ptp(margin) == 0.0:
        raise ValueError("regression needs two margins or more that are finite and not all equal")
    truncated = is_truncated(margin) if truncated is None else truncated
    if truncated and (margin > 0.0).sum() < 2:
        raise ValueError("regression on truncated margins needs two that are positive")
    if (
        warm is not None
        and truncated == warm.data.truncated
        and _ALWAYS < len(margin) < (1.0 + _GROWTH) * warm.learned_on
    ):
        return _solved_at(features, margin, warm)
    n = len(margin)
    best = warm
    if best is None or truncated != best.data.truncated or min(n, best.learned_on) <= WARPED_ON:
        rows = _over_margins(margin, WARPED_ON if n <= WARPED_ON else WARPED_ON // 2)
        fits = [_fit_warped(features[rows], margin[rows], truncated, name, warm, repeatable) for name in WARPINGS]
        best = max(fits, key=lambda fitted: fitted.log_likelihood)
    if n > WARPED_ON:
        rows = _over_margins(margin, LEARNED_ON)
        best = _fit_warped(features[rows], margin[rows], truncated, best.data.warping, best, repeatable, _COARSE_SEARCH)
    return best if len(best.data.margin) == n else _solved_at(features, margin, replace(best, learned_on=n))


def _over_margins(margin: Array, most: int) -> NDArray[np.intp]:
    """Rows of at most `most` points, in order, evenly spread over the sorted margins, (n,).

    A surplus of points near the boundary would make the regression too sure of itself.
    """
    return np.sort(spread(np.argsort(margin, kind="stable"), most))


def _solved_at(features: Array, margin: Array, warm: MarginFit) -> MarginFit:
    """The fit to other points with the warping and the hyperparameters of an earlier one."""
    failed = np.flatnonzero((margin <= 0.0) & warm.data.truncated)
    sites = CensoredSites(np.zeros(len(failed)), np.zeros(len(failed)))
    data = replace(warm.data, features=features, margin=margin, sites=sites, inducing=None)
    if len(margin) > EXACT:
        points = torch.from_numpy(data.points)
        rows, _ = choose(warm.prior, points, torch.full((len(points),), 1.0 / warm.nugget), most=INDUCING)
        data = replace(data, inducing=rows.numpy())
    fitted = replace(warm, data=data, log_likelihood=math.nan)
    taken, censored = np.isin(failed, data.rows), np.isin(data.rows, failed)
    if taken.any():
        sites.linear[taken], sites.precision[taken] = _sites_of(fitted, censored)
        fitted = replace(fitted)  # without what was computed before the sites were known
    return fitted


def _sites_of(fitted: MarginFit, censored: NDArray[np.bool_]) -> CensoredSites:
    """The sites of the censored points, given the others."""
    data = fitted.data
    y = data.warped(data.margin[data.rows])
    mean, S = joint(fitted.model(0.0), data.points[censored])
    start = first_sites(censored, max(float(y[~censored].std()), 1e-3))
    return censored_posterior(-mean, S, start)[0]


def _fit_warped(
    features: Array,
    margin: Array,
    truncated: bool,
    warping: str,
    warm: MarginFit | None,
    repeatable: bool,
    search: dict[str, float] = _SEARCH,
) -> MarginFit:
    censored = (margin <= 0.0) & truncated
    exact = margin[~censored]
    unit = float(np.median(np.abs(exact))) or float(np.abs(exact).max())
    warp, log_slope = WARPINGS[warping]
    y = warp(margin / unit)
    exact_y = y[~censored]
    scale = max(float(exact_y.std()), 1e-3)
    prior = margin_prior(features.shape[1], repeatable) if warm is None else copy.deepcopy(warm.prior)
    prior.mean_module.initialize(constant=float(exact_y.mean()))
    prior.covar_module.initialize(outputscale=(2.0 * scale) ** 2, slope=scale**2 / features.shape[1])
    if not repeatable:
        prior.likelihood.initialize(noise=_FIRST_NOISE * scale**2)
    sites, value = first_sites(censored, scale), math.nan

    def negative() -> tuple[torch.Tensor, list[torch.Tensor]]:
        nonlocal sites, value
        value, gradient, sites = penalised_likelihood(prior, features, y, censored, sites)
        return torch.tensor(-value, dtype=torch.float64), [-of for of in gradient]

    log_variance = 2.0 * math.log(scale)
    bounds: Bounds = {
        "mean_module.raw_constant": (float(exact_y.min()) - 20.0 * scale, float(exact_y.max()) + 3.0 * scale),
        "covar_module.raw_outputscale": (log_variance - 4.0, log_variance + 14.0),
        "covar_module.base_kernel.raw_lengthscale": (-4.0, 8.0),
        SLOPE: (log_variance - 14.0, log_variance + 14.0),
        NOISE: (log_variance - 14.0, log_variance + 2.0),
    }
    prior.requires_grad_(True)
    minimise(negative, prior.learned, bounds, search)
    negative()
    prior.requires_grad_(False)
    jacobian = float((log_slope(exact / unit) - math.log(unit)).sum())
    data = MarginData(features, margin, truncated, warping, unit, sites)
    return MarginFit(data, prior, value + jacobian, len(margin))


@dataclass(frozen=True)
class MarginLatent:
    """The latent of a boundary that is learned from a margin: minus the warped margin, so positive beyond the boundary.

    It has the methods of `latent.Latent`.

    Attributes:
        trained: the regression.
        level: of the margin at or below which a design is beyond the boundary: several boundaries of one margin share a
            regression.
        place: where in the gap at the data's level the boundary lies, from its upper end, 0 to 1; None if it is as
            likely everywhere.
    """

    trained: MarginFit
    level: float = 0.0
    place: float | None = None

    @property
    def margin_data(self) -> MarginData:
        """The margins, which boundaries of one margin share."""
        return self.trained.data

    @property
    def gap(self) -> float:
        """Length of the interval that is known to contain the boundary, of a warped margin; 0 where it is stated."""
        return 0.0 if self.level else sum(self.trained.gap)

    @property
    def threshold(self) -> float:
        """The level in the units of the warped margin; in the middle of the gap if its place is not known."""
        if self.gap:
            return self.trained.gap[1] - self.gap * (0.5 if self.place is None else self.place)
        return float(self.trained.data.warped(np.array(self.level - self.trained.data.level)))

    @property
    def _variance(self) -> float:
        """Of the threshold: uniform over the gap."""
        return self.gap**2 / 12.0 if self.place is None else 0.0

    @property
    def features(self) -> Array:
        """Scaled features of the training points, (n, m)."""
        return self.trained.data.features

    @property
    def length_scales(self) -> Array | None:
        """Length scales of the kernel, (m,)."""
        return self.trained.prior.length_scales

    @property
    def prior_sd(self) -> float:
        """Of `moments` where no simulation is near."""
        return self.trained.prior.sd / (self.trained.noise or 1.0)

    @property
    def is_one_sided(self) -> bool:
        """Whether nothing can be learned yet; a margin always teaches something."""
        return False

    @property
    def is_clipped(self) -> bool:
        """Whether the margin is clipped (see `MarginData`)."""
        return self.trained.data.is_clipped

    @property
    def size_of_support(self) -> int:
        """Number of support points; 0 if all points are."""
        return self.trained.data.size_of_support

    @property
    def normality(self) -> float:
        """Of the margin's noise (see `MarginFit.normality`)."""
        return self.trained.normality

    @cached_property
    def model(self) -> BoundaryModel:
        """The posterior as a BoTorch model over the scaled features, (..., q, m).

        A boundary of which only a gap is known lies in its middle there: simulations beside it halve the gap.
        """
        return self.trained.model(self.threshold)

    def moments(self, F: Array) -> Moments:
        """Marginal mean and standard deviation at scaled features, (n, m); in units of the noise, if there is any."""
        mean, sd = moments(self.model, F)
        return margin_moments(mean, np.sqrt(sd**2 + self._variance), self.trained.noise)

    def deviations(self, F: Array, margin: Array) -> Array:
        """How far margins, (n,), lie beyond their means at scaled features, (n, m), in standard deviations.

        NaN where a margin is not finite, or censored.

        Args:
            F: the features.
            margin: in relation to the boundary, at most 0 beyond it.
        """
        own = margin + self.level - self.trained.data.level
        exact = np.isfinite(own) & ~(self.trained.data.truncated & (own <= 0.0))
        mean, sd = moments(self.model, F)
        warped = self.trained.data.warped(np.where(exact, own, 0.0))
        return np.where(exact, (self.threshold - warped - mean) / sd, np.nan)

    def left_out(self) -> Moments:
        """Moments at each training point without its own margin, with hyperparameters unchanged, (n,)."""
        mean, sd = self.trained.left_out()
        return margin_moments(self.threshold - mean, np.sqrt(sd**2 + self._variance), self.trained.noise)
