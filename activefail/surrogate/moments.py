"""Moments of a latent, and the probabilities that follow from them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr, softmax

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

    @property
    def side(self) -> Array:
        """Φ(mean/sd): the probability that the latent is positive, shape (n,).

        It has no noise of labels, so it is what to integrate for a deterministic simulator.
        """
        return np.asarray(ndtr(self.mean / self.sd))


class MarginMoments(Moments):
    """Moments of a latent whose sign is the outcome, without noise."""

    __slots__ = ()

    @property
    def standardised(self) -> Array:
        """mean/sd, the probit of `probability`, shape (n,)."""
        return np.asarray(self.mean / self.sd)


def outcome_probabilities(moments: Sequence[Moments]) -> Array:
    """Probabilities of the outcomes of n designs from the moments of each boundary's latent, (n, number of outcomes).

    Latent i gives the probability P_i that the outcome is at least as severe as outcome i. The latents are taken as
    independent, conditional on being consistent: p_j ∝ Π_{i≤j} P_i · Π_{i>j} (1 − P_i). So the most severe outcome is
    slightly less probable than its latent alone predicts.
    """
    z = np.stack([latent_moments.standardised for latent_moments in moments], axis=1)
    beyond = np.pad(np.cumsum(log_ndtr(z), axis=1), ((0, 0), (1, 0)))
    short = np.pad(np.cumsum(log_ndtr(-z)[:, ::-1], axis=1)[:, ::-1], ((0, 0), (0, 1)))
    return np.asarray(softmax(beyond + short, axis=1))
