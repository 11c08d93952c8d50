"""The paper's methods (its sections 3.1 and 3.2): logistic regression, and GP classification as in GPML."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, linprog, minimize
from scipy.special import expit, ndtri
from statsmodels.discrete.discrete_model import Logit

from activefail.errors import InputError
from activefail.paper import gpml
from activefail.paper.gpml import GaussianApproximation, SiteParameters, SquaredExponentialPrior
from activefail.space import Array
from activefail.surrogate.moments import Moments

Labels = NDArray[np.bool_]
Method = Literal["laplace", "ep"]
"""Laplace's method, R&W Algorithms 3.1, 3.2 and 5.1, or expectation propagation, R&W Algorithms 3.5, 3.6 and 5.2."""

_POSTERIOR: dict[Method, Callable[..., GaussianApproximation]] = {
    "laplace": gpml.laplace_posterior,
    "ep": gpml.ep_posterior,
}

SIGNAL_VARIANCE = (1e-4, 1e4)
"""Bounds of the signal variance. For separable classes the evidence tends to a constant as the latent widens, so only a
bound stops the search. At a latent sd of 100 the evidence of expectation propagation is within 0.1 nat of it; that of
Laplace's method keeps rising above the true evidence, towards overconfident predictions.
"""

LENGTH_SCALE = (1e-2, 1e3)
"""Bounds of the length scales, in the features' units: at 1000 a standardised feature changes no covariance by 1e-4."""

PRIOR_PROBIT = (-8.0, 8.0)
"""Bounds of the prior probit m/√(1 + s²): beyond them, a training set with both classes is practically impossible."""

STARTS = ((1.0, 1.0), (10.0, 2.0), (100.0, 1.0))
"""Starting signal variances and length scales, in units of √m; the best optimum is kept."""

ROWS_AT_ONCE = 4096
"""Points predicted in one call, which limits its memory to n x 4096 numbers."""


def _checked(F: Array, y: Labels) -> None:
    if F.ndim != 2 or y.shape != (len(F),):
        raise InputError(f"Features (n, m) and labels (n,) must have matching shapes, got {F.shape} and {y.shape}.")
    if not np.isfinite(F).all():
        raise InputError(f"Features must be finite, got {np.count_nonzero(~np.isfinite(F))} non-finite values.")


@dataclass(frozen=True)
class LogisticFit:
    """A logistic regression with an intercept, by maximum likelihood.

    Attributes:
        intercept: of the log odds.
        coefficients: (m,) of the log odds, per unit of each feature.
        standard_errors: (m,) of the coefficients, from the observed information; NaN without a maximum.
        p_values: (m,) of Wald's two-sided test that a coefficient is zero; NaN without a maximum.
        converged: whether Newton's method found the maximum.
        separation: whether a plane separates the classes, except for points on it (complete or quasi-complete
            separation). The likelihood then has no maximum, and only the direction of the coefficients is meaningful.
    """

    intercept: float
    coefficients: Array
    standard_errors: Array
    p_values: Array
    converged: bool
    separation: bool

    def probability(self, F: Array) -> Array:
        """P(label) at features, (n, m) -> (n,)."""
        return np.asarray(expit(self.intercept + F @ self.coefficients))

    def accuracy(self, F: Array, y: Labels) -> float:
        """Share of labels, (n,), on the right side of probability ½ at features, (n, m)."""
        return float(np.mean((self.probability(F) > 0.5) == y))


def separable(Z: Array, y: Labels) -> bool:
    """Whether some β ≠ 0 has ±Zβ ≥ 0 for all points, with the label's sign: complete or quasi-complete separation.

    This is equivalent to logistic regression having no maximum [AlbertAnderson1984]. Uses the linear program of
    [Konis2007]: without separation, the largest sum of ±Zβ for β in a unit box is zero.

    Args:
        Z: (n, k) of full column rank, with entries of order 1, including a column of ones for an intercept.
        y: (n,) labels.
    """
    signed = np.where(y, 1.0, -1.0)[:, None] * Z
    solution = linprog(-signed.sum(0), A_ub=-signed, b_ub=np.zeros(len(Z)), bounds=(-1.0, 1.0))
    # The solver satisfies each constraint to 1e-7.
    return bool(-solution.fun > 1e-6 * len(Z))


def logistic_regression(F: Array, y: Labels) -> LogisticFit:
    """Regress labels, (n,), on features, (n, m), in any units, with statsmodels' `Logit`.

    Standardises the features internally, which changes neither the fit nor the p-values.

    Raises:
        InputError: if shapes differ, a value is not finite, or features and intercept are linearly dependent.
    """
    _checked(F, y)
    center, spread = F.mean(axis=0), F.std(axis=0)
    # A constant feature has a spread of rounding error; setting its column to zero lowers the rank.
    Z = np.column_stack([np.ones(len(F)), (F - center) / np.where(spread > 1e-12 * np.abs(center), spread, np.inf)])
    if (rank := np.linalg.matrix_rank(Z)) < Z.shape[1]:
        raise InputError(f"Features and intercept must be linearly independent, got rank {rank} of {Z.shape[1]}.")
    separation = separable(Z, y)
    result, converged = _maximum(Logit(y.astype(float), Z), separation)
    nan = np.full(F.shape[1], np.nan)
    errors, p_values = (result.bse[1:] / spread, result.pvalues[1:]) if converged else (nan, nan)
    slopes = result.params[1:] / spread
    return LogisticFit(float(result.params[0] - slopes @ center), slopes, errors, p_values, converged, separation)


def _maximum(model: Logit, separation: bool) -> tuple[Any, bool]:
    """statsmodels' results at the maximum likelihood or where the search ended, and whether it converged."""
    # This callback replaces the one that warns of separation.
    quiet = {"disp": False, "callback": lambda _: None, "warn_convergence": False}
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # odds of infinity are a probability of 0 or 1
        # statsmodels' Newton method takes full steps, which can diverge from a poor start: BFGS finds a good one.
        start = model.fit(method="bfgs", maxiter=500, skip_hessian=True, **quiet)
        if separation:
            return start, False
        try:
            tolerance = 1e-8 * max(1.0, float(np.abs(start.params).max()))
            result = model.fit(method="newton", start_params=start.params, tol=tolerance, **quiet)
        except np.linalg.LinAlgError:  # near separation the information matrix is singular
            return start, False
    return (result, True) if result.mle_retvals["converged"] else (start, False)


@dataclass(frozen=True)
class GaussianProcessFit:
    """A GP classifier with the probit likelihood, whose hyperparameters maximise the approximate evidence.

    Attributes:
        hyperparameters: mean, signal variance and length scales.
        converged: whether both L-BFGS and the inference converged.
        features: (n, m) training features.
        posterior: at the training features, with the approximate log evidence [nat].
    """

    hyperparameters: SquaredExponentialPrior
    converged: bool
    features: Array
    posterior: GaussianApproximation

    def moments(self, F: Array) -> Moments:
        """Mean and standard deviation of the latent at features, (n, m) -> (n,) each."""
        blocks = [
            gpml.predict(self.features, self.hyperparameters, self.posterior, F[i : i + ROWS_AT_ONCE])
            for i in range(0, len(F), ROWS_AT_ONCE)
        ]
        mean, variance = (np.concatenate([np.empty(0), *parts]) for parts in zip(*blocks, strict=True))
        return Moments(mean, np.sqrt(variance))

    def probability(self, F: Array) -> Array:
        """P(label) = Φ(mean/√(1 + sd²)) at features, (n, m) -> (n,); R&W eq. 3.82."""
        return self.moments(F).probability


def condition(F: Array, y: Labels, hyperparameters: SquaredExponentialPrior, method: Method) -> GaussianProcessFit:
    """The approximate posterior of features, (n, m), and labels, (n,), for fixed hyperparameters.

    Raises:
        InputError: if shapes differ or a value is not finite.
    """
    _checked(F, y)
    K = gpml.covariance(F, F, hyperparameters)
    posterior = _POSTERIOR[method](K, hyperparameters.mean, _signs(y))
    return GaussianProcessFit(hyperparameters, posterior.converged, F.copy(), posterior)


def _signs(y: Labels) -> Array:
    return np.where(y, 1.0, -1.0)


def pack(hyperparameters: SquaredExponentialPrior) -> Array:
    """Hyperparameters in the coordinates of the search, (2 + m,): m/√(1 + s²), log s², log ℓ.

    For large s² the evidence is flat along log s² in these coordinates; with the mean itself it would be a ridge.
    """
    mean, s, scales = hyperparameters
    return np.array([mean / math.sqrt(1.0 + s), math.log(s), *np.log(scales)])


def unpack(packed: Array) -> SquaredExponentialPrior:
    """The inverse of `pack`."""
    s = math.exp(packed[1])
    return SquaredExponentialPrior(float(packed[0]) * math.sqrt(1.0 + s), s, np.exp(packed[2:]))


def evaluate(
    packed: Array, F: Array, signs: Array, method: Method, start: SiteParameters | None = None
) -> tuple[GaussianApproximation, Array]:
    """The posterior at packed hyperparameters and the gradient of its log evidence, (2 + m,).

    Args:
        signs: labels, (n,) of -1 and 1.
        start: sites at other hyperparameters, to start the inference from.
    """
    hyperparameters = unpack(packed)
    mean, s, _ = hyperparameters
    K = gpml.covariance(F, F, hyperparameters)
    posterior = _POSTERIOR[method](K, mean, signs, start=start)
    by_mean, by_signal, by_scales = gpml.evidence_gradient(F, K, hyperparameters, posterior)
    by_signal += by_mean * 0.5 * mean * s / (1.0 + s)
    return posterior, np.array([by_mean * math.sqrt(1.0 + s), by_signal, *by_scales])


def train(F: Array, y: Labels, method: Method) -> GaussianProcessFit:
    """Train on scaled features, (n, m), and labels, (n,): the best local maximum of the evidence over `STARTS`.

    Raises:
        InputError: if shapes differ, a value is not finite, or a class is missing.
    """
    _checked(F, y)
    if y.all() or not y.any():
        raise InputError(f"The training set must contain both classes, got {len(y)} labels of one.")
    signs, m = _signs(y), F.shape[1]
    bounds = [PRIOR_PROBIT] + [tuple(np.log(limits)) for limits in [SIGNAL_VARIANCE] + [LENGTH_SCALE] * m]

    def climb(signal_variance: float, scale: float) -> OptimizeResult:
        sites: SiteParameters | None = None

        def objective(packed: Array) -> tuple[float, Array]:
            nonlocal sites
            posterior, gradient = evaluate(packed, F, signs, method, sites)
            sites = posterior.sites
            return -posterior.log_evidence, -gradient

        probit = ndtri(y.mean())
        start = np.array([probit, math.log(signal_variance), *np.full(m, math.log(scale * math.sqrt(m)))])
        options = {"ftol": 1e-10, "gtol": 1e-4, "maxiter": 500, "maxcor": 20}
        return minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)

    optimum = min((climb(*start) for start in STARTS), key=lambda end: float(end.fun))
    trained = condition(F, y, unpack(optimum.x), method)
    return replace(trained, converged=trained.converged and bool(optimum.success))
