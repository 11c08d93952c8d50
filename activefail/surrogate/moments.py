"""Moments of a latent, and the probabilities that follow from them."""

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, log_softmax, logsumexp, ndtr, ndtri_exp

from activefail.space import Array


class Moments(NamedTuple):
    """Mean and standard deviation of a latent at n points, each shape (n,)."""

    mean: Array
    sd: Array

    @property
    def standardised(self) -> Array:
        """mean/√(1 + sd²), the probit of `probability`, shape (n,)."""
        return np.asarray(self.mean / np.sqrt(1.0 + self.sd**2))

    @property
    def probability(self) -> Array:
        """P(outcome beyond the boundary) under the probit likelihood, shape (n,)."""
        return np.asarray(ndtr(self.standardised))

    def known(self, shift: float) -> Array:
        """The probit if the latent is known to lie `shift` standard deviations above its mean, (n,)."""
        return np.asarray(self.mean + shift * self.sd)

    @property
    def side(self) -> Array:
        """mean/sd, the probit of the probability that the latent is positive, shape (n,): without noise of labels."""
        return np.asarray(self.mean / self.sd)


class MarginMoments(Moments):
    """Moments of a latent whose sign is the outcome, without noise."""

    __slots__ = ()

    @property
    def standardised(self) -> Array:
        """The probit of `probability`, shape (n,)."""
        return self.side

    def known(self, shift: float) -> Array:
        """As for `Moments`: the outcome is certain."""
        return np.copysign(np.inf, self.mean + shift * self.sd)


def _consistent(z: Array) -> Array:
    """Logarithms of the probabilities of outcomes, (n, b + 1), from the probits of b latents, (n, b).

    Latent i gives the probability P_i = Φ(z_i) that the outcome is at least as severe as outcome i. The latents are
    taken as independent, conditional on being consistent: p_j ∝ Π_{i≤j} P_i · Π_{i>j} (1 − P_i).
    """
    beyond = np.pad(np.cumsum(log_ndtr(z), axis=1), ((0, 0), (1, 0)))
    short = np.pad(np.cumsum(log_ndtr(-z)[:, ::-1], axis=1)[:, ::-1], ((0, 0), (0, 1)))
    return np.asarray(log_softmax(beyond + short, axis=1))


def outcome_probabilities(z: Array, is_nested: bool) -> Array:
    """Probabilities of the outcomes of n designs, (n, b + 1), from the probits of b boundaries, (n, b).

    Args:
        z: the probits, of the boundary of the least severe outcome first.
        is_nested: whether the boundaries are levels of one latent, so that the probits never rise with severity.
            Otherwise each has a latent of its own, and the probabilities are conditional on nested boundaries.
    """
    if not is_nested:
        return np.asarray(np.exp(_consistent(z)))
    ends = np.pad(z, ((0, 0), (1, 1)), constant_values=((0.0, 0.0), (np.inf, -np.inf)))
    first, second = ends[:, :-1], ends[:, 1:]
    # Of both differences, that of the smaller numbers keeps its digits.
    return np.asarray(np.where(first < 0.0, ndtr(first) - ndtr(second), ndtr(-second) - ndtr(-first)))


def nested_probits(z: Array, is_nested: bool) -> Array:
    """The probits of P(outcome at least as severe as i) by `outcome_probabilities`, (n, b): they never rise with i."""
    if is_nested or z.shape[1] == 1:
        return z
    p, severities = _consistent(z), range(1, z.shape[1] + 1)
    beyond = np.minimum(np.column_stack([logsumexp(p[:, i:], axis=1) for i in severities]), 0.0)
    short = np.minimum(np.column_stack([logsumexp(p[:, :i], axis=1) for i in severities]), 0.0)
    return np.asarray(np.where(beyond < short, ndtri_exp(beyond), -ndtri_exp(short)))
