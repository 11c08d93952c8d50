"""The paper's classifier (its section 3.2): GP classification as in GPML."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import OptimizeResult, minimize
from scipy.special import ndtri

from activefail.analyses.sensitivity.logistic import Labels, check_labelled
from activefail.errors import InputError
from activefail.learning.model.moments import Moments
from activefail.seismic.paper import gpml
from activefail.seismic.paper.gpml import GaussianApproximation, SiteParameters, SquaredExponentialPrior
from activefail.space.space import Array

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
    """The approximate posterior of features, (n, m), and labels, (n,), for fixed hyperparameters."""
    check_labelled(F, y)
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
    """Train on scaled features, (n, m), and labels, (n,): the best local maximum of the evidence over `STARTS`."""
    check_labelled(F, y)
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
