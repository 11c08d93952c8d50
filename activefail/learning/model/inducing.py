"""Inducing points for many training points, chosen from these where the posterior needs them.

To first order, a projection on inducing points loses ½ Σ W_i rest_i of the bound: the unexplained variance, weighted by
the precision of each point's site. So the points are chosen greedily by that product, a pivoted Cholesky factorisation
of W^½ K W^½, until the sum is small. Points deep inside a region have little precision and get few inducing points;
without the weights, four times as many points are needed for the same bound.
"""

import math

import torch
from torch import Tensor

from activefail.learning.model.covariance import JITTER
from activefail.learning.model.kernels import Prior
from activefail.learning.model.sites import Projection, column_squares, whitened

LEFT = 1.0
"""Σ W_i rest_i below which no more inducing points are added; measured, it costs at most a fifth of a nat."""

MOST = 500
"""Most inducing points: a step of the sites costs the square of their number."""

_BLOCK = 64
"""Candidates per block, so that most of the work is matrix products."""

_STALE = 0.25
"""A candidate of a block is chosen while its value is at least this share of the block's first."""


def jittered(K: Tensor) -> Tensor:
    """K, (n, n), with the jitter on its diagonal, in place where it has memory of its own."""
    K = K.contiguous()
    K.diagonal().add_(JITTER)
    return K


@torch.no_grad()
def project(prior: Prior, features: Tensor, rows: Tensor) -> Projection:
    """The prior at features, (n, d), projected on inducing points, rows (m,) of them."""
    Z = features[rows]
    L = torch.linalg.cholesky(jittered(prior.covariance(Z)))
    _, V = whitened(L, prior.covariance(Z, features))
    return _projection(prior, features, V)


def _projection(prior: Prior, features: Tensor, V: Tensor) -> Projection:
    # GPyTorch's strategy also adds the jitter to a point's variance.
    rest = prior.variance(features) + JITTER - column_squares(V)
    return Projection(prior.mean_module(features), V, rest.clamp_min(JITTER))


@torch.no_grad()
def choose(
    prior: Prior, features: Tensor, precision: Tensor, rows: Tensor | None = None, most: int = MOST
) -> tuple[Tensor, Projection]:
    """Inducing points, rows (m,) of the features, and the projection on them.

    Args:
        prior: with its parameters.
        features: (n, d).
        precision: (n,) current precision of the sites.
        rows: inducing points to keep; others are added.
        most: most inducing points.
    """
    n = len(features)
    chosen = [] if rows is None else rows.tolist()
    V = torch.empty((most, n), dtype=features.dtype)
    if rows is not None:
        V[: len(rows)] = project(prior, features, rows).whitened
    rest = (prior.variance(features) - column_squares(V[: len(chosen)])).clamp_min_(0.0)
    rest[chosen] = 0.0
    while len(chosen) < min(most, n):
        worth = precision * rest
        if float(worth.sum()) <= LEFT:
            break
        m = len(chosen)
        block = torch.topk(worth, min(_BLOCK, n)).indices
        # The block's covariances less what the present inducing points explain, (block, n).
        C = prior.covariance(features[block], features).addmm_(V[:m, block].T, V[:m], alpha=-1.0)
        first = float(worth[block[0]])
        for _ in range(min(len(block), most - m)):
            i = int(torch.argmax(precision[block] * rest[block]))
            row = int(block[i])
            if float(precision[row] * rest[row]) <= _STALE * first:
                break
            k = len(chosen)
            v = (C[i] - V[m:k, row] @ V[m:k]) / math.sqrt(float(rest[row]) + JITTER)
            V[k] = v
            chosen.append(row)
            rest -= v * v
            rest[row] = 0.0
            rest.clamp_min_(0.0)
    return torch.tensor(chosen, dtype=torch.int64), _projection(prior, features, V[: len(chosen)])
