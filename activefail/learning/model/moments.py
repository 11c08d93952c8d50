"""The probabilities of outcomes from the moments of latents: that of an outcome or worse never rises with severity."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, log_softmax, logsumexp, ndtr, ndtri, ndtri_exp, xlogy

from activefail.space.space import Array
from activefail.space.systems import CERTAIN, System

LARGEST_FEATURE = 1e3
"""Largest magnitude of a scaled feature in a prediction, in standard deviations over the design space. Far outside the
space nothing is known, and one huge number would dominate the sums of squares in the covariance of the other rows."""

_UNSURE, _FAR = float(ndtri(0.8)), 0.1
"""A design is undecided if the probit of its failure is smaller, and the latent's standard deviation is more than this
share of its prior's. A trend extrapolates, so that few designs reach larger shares; near a boundary that simulations
have found it is some hundredths (studies/beyond.py)."""

ROWS_AT_ONCE = 4096
"""Most rows per call of a prediction, which limits its memory to n x 4096 numbers."""


def in_parts(F: Array, predict: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array]:
    """Mean and standard deviation at scaled features, (n, m), each (n,), by a prediction of some rows."""
    F = np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE)
    parts = [predict(F[first : first + ROWS_AT_ONCE]) for first in range(0, max(1, len(F)), ROWS_AT_ONCE)]
    mean, sd = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return mean, sd


def binary_entropy(p: Array) -> Array:
    """h(p) = −p log₂ p − (1−p) log₂(1−p) [bit]."""
    return np.asarray(-(xlogy(p, p) + xlogy(1.0 - p, 1.0 - p)) / np.log(2.0))


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


def margin_moments(mean: Array, sd: Array, noise: float) -> Moments:
    """Moments of minus a margin, whose mean and standard deviation at n points are those of the next observation.

    In units of its noise, a noisy margin has the probit likelihood: P = Φ(mean/√(1 + sd²)).

    Args:
        mean, sd: (n,).
        noise: standard deviation of the simulator's noise; 0 if it repeats.
    """
    if not noise:
        return MarginMoments(mean, sd)
    return Moments(mean / noise, np.sqrt(np.maximum((sd / noise) ** 2 - 1.0, 1e-12)))


def system_moments(system: System, z: Array) -> Moments:
    """Moments of a system's latent, (n,), from the probits that each mode has failed, (n, k)."""
    probit = system.probit(z)
    return MarginMoments(probit, np.ones_like(probit))


class LinkedMoments(Moments):
    """Moments of a latent with another likelihood than the probit.

    Attributes:
        link: latent means and standard deviations, each (n,) -> P(beyond the boundary), (n,).
    """

    link: Callable[[Array, Array], Array]

    @classmethod
    def of(cls, mean: Array, sd: Array, link: Callable[[Array, Array], Array]) -> "LinkedMoments":
        """Moments with a link."""
        moments = cls(mean, sd)
        moments.link = link
        return moments

    @property
    def standardised(self) -> Array:
        """The probit of `probability`, shape (n,)."""
        return np.asarray(ndtri(self.link(self.mean, self.sd)))

    def known(self, shift: float) -> Array:
        """As for `Moments`."""
        return np.asarray(ndtri(self.link(self.mean + shift * self.sd, np.full_like(self.sd, 1e-4))))


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


def doubt(latent: Any, F: Array) -> Array:
    """The standard deviation of a latent over its prior's without a trend, (n,) at scaled features, (n, m).

    It is about 1 where no simulation is near. For a system it is that of the mode that decides.
    """
    if not hasattr(latent, "modes"):
        return np.asarray(latent.moments(F).sd / latent.prior_sd)
    of_modes = [mode.moments(F) for mode in latent.modes]
    deciding = latent.system.deciding(np.column_stack([one.side for one in of_modes]))
    each = [one.sd / mode.prior_sd for one, mode in zip(of_modes, latent.modes, strict=True)]
    return np.asarray(np.column_stack(each)[np.arange(len(F)), deciding])


def undecided(classifier: Any, X: Array) -> NDArray[np.bool_]:
    """Of which designs, (n, d), a classifier does not know the outcome, (n,).

    No simulation is near, and the probability beyond some boundary is neither small nor large.
    """
    F = classifier.features(X)
    unsure = [
        (np.abs(latent.moments(F).standardised) < _UNSURE) & (doubt(latent, F) > _FAR) for latent in classifier.latents
    ]
    return np.asarray(np.any(unsure, axis=0) & ~classifier.features.certain(X))


def is_nested(latents: Sequence[Any]) -> bool:
    """Whether all boundaries are levels of one margin."""
    shared = [latent.margin_data for latent in latents]
    return shared[0] is not None and all(one is shared[0] for one in shared)


@dataclass(frozen=True)
class Predicted:
    """What a classifier says of n designs: the one source of every probability of an outcome.

    Attributes:
        moments: of each boundary's latent.
        is_nested: whether the boundaries are levels of one latent (see `outcome_probabilities`).
        harmless: (n,) which designs have the least severe outcome for certain, whatever the latents say.
        repeatable: whether equal designs have equal results.
    """

    moments: tuple[Moments, ...]
    is_nested: bool
    harmless: NDArray[np.bool_]
    repeatable: bool = True

    @property
    def probabilities(self) -> Array:
        """Of each outcome of one simulation, (n, outcomes); rows sum to 1.

        The outcomes that a boundary is learned from count as noisy, which allows for structure too fine to learn: the
        probit is mean/√(1 + sd²). That of a margin's boundary is mean/sd.
        """
        return outcome_probabilities(self._probits([one.standardised for one in self.moments]), self.is_nested)

    def _probits(self, of_boundaries: Sequence[Array]) -> Array:
        z = np.column_stack(of_boundaries)
        z[self.harmless] = -CERTAIN
        return z

    @property
    def boundaries(self) -> Array:
        """The probits of P(at least as severe), (n, b): what is integrated over many designs.

        They are without noise where the simulator is deterministic: the noise of labels would put a floor under a small
        probability.
        """
        z = [one.side if self.repeatable else one.standardised for one in self.moments]
        return nested_probits(self._probits(z), self.is_nested)

    def beyond(self, severity: int, shift: float | None = None) -> Array:
        """P(at least as severe as outcome `severity`) of one simulation, (n,).

        Args:
            severity: number of the outcome.
            shift: of the boundary's latent from its mean, in standard deviations, if it were known.
        """
        one = self.moments[severity - 1]
        of_boundaries = [of.standardised for of in self.moments]
        if shift is not None:
            of_boundaries[severity - 1] = one.known(shift)
        z = self._probits(of_boundaries)
        return np.asarray(np.minimum(outcome_probabilities(z, self.is_nested)[:, severity:].sum(axis=1), 1.0))


def predicted(classifier: Any, X: Array, F: Array | None = None) -> Predicted:
    """What a classifier says of designs, (n, d), whose scaled features, (n, m), are F if they are known already."""
    features, latents = classifier.features, classifier.latents
    F = features(X) if F is None else F
    moments = tuple(latent.moments(F) for latent in latents)
    return Predicted(moments, is_nested(latents), features.certain(X), classifier.repeatable)
