"""A trained classifier for predictions alone, without torch, whose import takes longer than they do.

Its moments are those of `activefail.surrogate.classifier` up to rounding: the same formulas by SciPy's LAPACK and BLAS.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, eigh, solve_triangular

from activefail.features import FeatureMap
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Latent, Predicted, predicted
from activefail.surrogate.covariance import JITTER, SavedHyperparameters, covariance_array
from activefail.surrogate.margin import LARGEST_FEATURE, ROWS_AT_ONCE, MarginFit, MarginLatent
from activefail.surrogate.moments import Moments


@dataclass(frozen=True)
class SavedLatent:
    """The latent of a boundary that was learned from outcomes.

    Attributes:
        kernel: as for `covariance_array`.
        features: (n, m) scaled features of the training points.
        hyperparameters: of the prior.
        linear, precision: (n,) Gaussian sites (`activefail.surrogate.sites`).
        inducing: rows of the inducing points; None if the posterior is that of all points.
    """

    kernel: str
    features: Array
    hyperparameters: SavedHyperparameters
    linear: Array
    precision: Array
    inducing: NDArray[np.int64] | None

    @classmethod
    def of(cls, latent: Latent) -> "SavedLatent":
        """The same latent, for predictions alone."""
        fit = latent.trained
        return cls(
            fit.kernel,
            latent.features,
            SavedHyperparameters(*fit.hyperparameters),
            fit.sites.linear.numpy(),
            fit.sites.precision.numpy(),
            None if fit.inducing is None else fit.inducing.numpy(),
        )

    def _prior(self, F: Array) -> Array:
        K = covariance_array(self.kernel, self.hyperparameters, F, F)
        K[np.diag_indices(len(K))] += JITTER
        return K

    @cached_property
    def _readout(self) -> tuple[Array, Array, Array]:
        """Support points, (k, m), their weights, (k,), and root, (k, k), as in `fitting.Readout`."""
        F, precision = self.features, self.precision
        pull = self.linear - precision * self.hyperparameters.mean
        if self.inducing is None:
            root = np.sqrt(precision)
            K = self._prior(F)
            L = cholesky(np.eye(len(F)) + root[:, None] * K * root, lower=True)
            weights = pull - root * cho_solve((L, True), root * (K @ pull))
            return F, weights, solve_triangular(L, np.diag(root), lower=True)
        Z = F[self.inducing]
        L = cholesky(self._prior(Z), lower=True)
        V = solve_triangular(L, covariance_array(self.kernel, self.hyperparameters, Z, F), lower=True)
        A = np.eye(len(Z)) + (V * precision) @ V.T
        eigenvalues, Q = eigh(A)
        shrunk = Q * np.sqrt(1.0 - 1.0 / np.maximum(eigenvalues, 1.0))
        v = cho_solve((cholesky(A, lower=True), True), V @ pull)
        return (
            Z,
            solve_triangular(L, v, lower=True, trans="T"),
            solve_triangular(L, shrunk, lower=True, trans="T").T,
        )

    def moments(self, F: Array) -> Moments:
        """Marginal mean and standard deviation at scaled features, (n, m)."""
        F = np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE)
        rows = range(0, max(1, len(F)), ROWS_AT_ONCE)
        mean, sd = zip(*(self._moments(F[first : first + ROWS_AT_ONCE]) for first in rows), strict=True)
        return Moments(np.concatenate(mean), np.concatenate(sd))

    def _moments(self, F: Array) -> tuple[Array, Array]:
        support, weights, root = self._readout
        k = covariance_array(self.kernel, self.hyperparameters, support, F)
        shrinkage = root @ k
        explained = np.einsum("ij,ij->j", shrinkage, shrinkage)
        variance = math.exp(self.hyperparameters.log_outputscale) + JITTER - explained
        return self.hyperparameters.mean + k.T @ weights, np.sqrt(np.maximum(variance, JITTER))


@dataclass(frozen=True)
class SavedClassifier:
    """The latents of a trained classifier.

    Attributes:
        outcomes: names, least severe first.
        features: map from designs to the latents' inputs.
        latents: one for each outcome but the first.
    """

    outcomes: tuple[str, ...]
    features: FeatureMap
    latents: tuple[SavedLatent | MarginLatent, ...]

    @classmethod
    def of(cls, classifier: Classifier) -> "SavedClassifier":
        """The same classifier, for predictions alone."""
        regressions = {id(of.trained): _regression(of) for of in classifier.latents if isinstance(of, MarginLatent)}
        latents = (
            SavedLatent.of(of) if isinstance(of, Latent) else replace(of, trained=regressions[id(of.trained)])
            for of in classifier.latents
        )
        return cls(classifier.outcomes, classifier.features, tuple(latents))

    def predicted(self, X: Array) -> Predicted:
        """As for `Classifier`."""
        return predicted(self.latents, self.features, X)


def _regression(latent: MarginLatent) -> MarginFit:
    trained = latent.trained
    return replace(trained, hyperparameters=SavedHyperparameters(*trained.hyperparameters))
