"""A posterior in terms of its support points Z, from the sites: the matrices that predictions need, without torch.

With k = k(Z, x), mean(x) = prior mean + kᵀ weights and covariance(x, x′) = k(x, x′) − (root k)ᵀ (root k′).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, eigh, solve_triangular
from scipy.linalg.lapack import dtrtri

from activefail.space.space import Array

EXACT = 1000
"""Most points as support; of more, some are inducing points. A step of the sites costs the cube of their number."""


class Readout(NamedTuple):
    """The matrices of m support points."""

    weights: Array  # (m,)
    root: Array  # (m, m)


class Trend(NamedTuple):
    """What an estimated constant mean adds to a covariance: e(x) e(x′) with e(x) = (1 − kᵀ ones)/√total."""

    ones: Array  # (m,), A⁻¹1 with A = K + W⁻¹
    total: float  # 1ᵀA⁻¹1


def readout_of(K: Array, Kx: Array | None, mean: float, linear: Array, precision: Array) -> Readout:
    """With all n points as support, or m inducing points.

    Args:
        K: prior covariance of the support, with the jitter.
        Kx: (m, n) covariance of inducing points with the training points; None without inducing points.
        mean: of the prior.
        linear, precision: (n,) the sites.
    """
    root, pull = np.sqrt(precision), linear - precision * mean
    if Kx is not None:
        L = cholesky(K, lower=True)
        weights, of_inducing = _of_projection(L, solve_triangular(L, Kx, lower=True), pull[:, None], precision)
        return Readout(weights[:, 0], of_inducing)
    L = cholesky(np.eye(len(K)) + root[:, None] * K * root, lower=True)
    # A site whose precision underflows says nothing.
    scaled = np.divide(pull, root, out=np.zeros_like(root), where=root > 0.0)
    inverse, _ = dtrtri(L, lower=1)  # K − K W^½ B⁻¹ W^½ K with B = LLᵀ
    return Readout(root * cho_solve((L, True), scaled), np.tril(inverse) * root)


def _of_projection(L: Array, V: Array, pulls: Array, precision: Array) -> tuple[Array, Array]:
    """Weights of several sets of sites, (m, k), and the root, (m, m).

    Args:
        L: (m, m) factor of the inducing points' covariance.
        V: (m, n) L⁻¹ k(Z, X).
        pulls: (n, k) linear terms about the prior mean.
        precision: (n,) of all sets.
    """
    # K − k L⁻ᵀ (I − A⁻¹) L⁻¹ k, A = I + V W Vᵀ
    A = np.eye(len(L)) + (V * precision) @ V.T
    eigenvalues, Q = eigh(A)
    shrunk = Q * np.sqrt(1.0 - 1.0 / np.maximum(eigenvalues, 1.0))
    v = cho_solve((cholesky(A, lower=True), True), V @ pulls)
    both = solve_triangular(L, np.hstack([v, shrunk]), lower=True, trans="T")
    return both[:, : pulls.shape[1]], both[:, pulls.shape[1] :].T.copy()


class MarginReadout(NamedTuple):
    """What predictions of a margin need of its support."""

    readout: Readout
    trend: Trend
    rest: Array  # (n,) prior variance that inducing points do not explain; 0 without them


def margin_readout(
    K: Array, Kx: Array | None, variance: Array, mean: float, target: Array, noise: Array, nugget: float
) -> MarginReadout:
    """With an estimated mean, whose support are all n points, or m inducing points.

    With inducing points each observation has the unexplained variance as noise too (FITC,
    [QuinoneroCandelaRasmussen2005]).

    Args:
        K: prior covariance of the support.
        Kx: (m, n) covariance of inducing points with the training points; None without inducing points.
        variance: (n,) prior variances of the training points.
        mean: of the prior.
        target, noise: (n,) observations and their variances.
        nugget: jitter of K, for inducing points.
    """
    if Kx is None:
        readout = readout_of(K, None, mean, target / noise, 1.0 / noise)
        ones = readout.root.T @ readout.root.sum(axis=1)  # rootᵀ root is (K + W⁻¹)⁻¹
        return MarginReadout(readout, Trend(ones, float(ones.sum())), np.zeros(len(target)))
    L = cholesky(K + nugget * np.eye(len(K)), lower=True)
    V = solve_triangular(L, Kx, lower=True)
    rest = np.maximum(variance - np.einsum("ij,ij->j", V, V), 0.0)
    precision = 1.0 / (noise + rest)
    # The trend is the regression of a constant, 1 at all points.
    pulls = np.column_stack([precision * (target - mean), precision])
    weights, root = _of_projection(L, V, pulls, precision)
    ones = weights[:, 1].copy()
    # The least value of the regression's loss. As a sum of squares it has no cancellation: where the points say much,
    # what the constant leaves is tiny.
    total = precision @ (1.0 - ones @ Kx) ** 2 + ((ones @ L) ** 2).sum()
    return MarginReadout(Readout(weights[:, 0].copy(), root), Trend(ones, float(total)), rest)
