"""Moments of a latent, and the probabilities that follow from them."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

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
