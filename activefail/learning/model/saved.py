"""A trained classifier for predictions alone, without torch, whose import takes longer than they do.

It reads the built-in kernels. Its moments are those of the GPyTorch models up to rounding.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.learning.features import FeatureMap
from activefail.learning.model.censored import CensoredSites
from activefail.learning.model.covariance import JITTER, NUGGET, correlation
from activefail.learning.model.margin_choice import OUTCOMES, Choice, LearnableMargins, defined, learned_with, level_of
from activefail.learning.model.margin_data import KERNEL, NOISE, SLOPE, WARPINGS, MarginData
from activefail.learning.model.moments import Moments, Predicted, in_parts, margin_moments, predicted, system_moments
from activefail.learning.model.readout import Readout, Trend, margin_readout, readout_of
from activefail.space.space import Array
from activefail.space.systems import System

State = Mapping[str, NDArray[Any]]
"""The arrays of `state.classifier_state`."""

SCALING = ("features/center", "features/spread")
"""The scaling of the features, for predictions alone."""


_FORMER = {
    "mean": "mean_module.raw_constant",
    "log_outputscale": "covar_module.raw_outputscale",
    "log_lengthscale": "covar_module.base_kernel.raw_lengthscale",
}
"""The names of a prior's parameters in states of version 0.2, and those since."""


def of_any_version(state: State) -> State:
    """A state with the names of this version.

    Raises:
        ValueError: if it holds a regression of version 0.2 whose support was a part of the points.
    """
    if any(name.endswith("/support") for name in state):
        raise ValueError
    named = {}
    for name, array in state.items():
        outcome, _, key = name.rpartition("/")
        shape = (1, -1) if key == "log_lengthscale" else array.shape
        named[f"{outcome}/{_FORMER[key]}" if key in _FORMER else name] = array.reshape(shape)
    return named


@dataclass(frozen=True)
class SavedPrior:
    """A constant mean, a built-in kernel and, of a margin, a linear trend.

    Attributes:
        kernel: as for `covariance.correlation`.
        mean, variance: of the latent, without the trend.
        length_scales: (m,).
        slope: variance of the trend's slopes.
    """

    kernel: str
    mean: float
    variance: float
    length_scales: Array
    slope: float = 0.0

    @classmethod
    def of(cls, kernel: str, state: State, name: str) -> "SavedPrior":
        """The prior of a boundary in a state."""
        parameters = (
            "mean_module.raw_constant",
            "covar_module.raw_outputscale",
            "covar_module.base_kernel.raw_lengthscale",
        )
        mean, log_variance, log_scales = (state[f"{name}/{parameter}"] for parameter in parameters)
        log_slope = state.get(f"{name}/{SLOPE}", np.array(-np.inf))  # only a margin has one
        with np.errstate(over="raise"):
            np.exp(2.0 * np.append(log_scales[0], [float(log_variance), float(log_slope)]))  # every scale is a number
        return cls(kernel, float(mean), float(np.exp(log_variance)), np.exp(log_scales[0]), float(np.exp(log_slope)))

    def covariance(self, F: Array, G: Array, jitter: float | None = None) -> Array:
        """k(F, G), (n, l), with a jitter on its diagonal."""
        K = self.variance * correlation(self.kernel, F / self.length_scales, G / self.length_scales)[0]
        if self.slope:
            K += self.slope * (F @ G.T)
        if jitter is not None:
            K[np.diag_indices(len(K))] += jitter
        return K

    def variances(self, F: Array) -> Array:
        """k(f, f), (n,)."""
        return np.asarray(self.variance + self.slope * np.square(F).sum(axis=1))


@dataclass(frozen=True)
class SavedLatent:
    """The latent of a boundary.

    Attributes:
        prior: of the latent, or of the warped margin.
        support: (s, m) scaled features.
        readout, trend: the matrices of predictions.
        added: to the variance of a point, and its least value: the jitter, or the noise of a margin.
        margin_data: that boundaries of one margin share; None if it is learned from outcomes.
        threshold: the level of the margin in its warped units.
        noise: standard deviation of a margin's noise in these units; 0 if the simulator repeats.
        normality: of this noise (see `margin.MarginFit.normality`).
        gap: in which the boundary is known to lie (see `margin_data.MarginData.gap`).
    """

    prior: SavedPrior
    support: Array
    readout: Readout
    trend: Trend | None = None
    added: float = JITTER
    margin_data: MarginData | None = None
    threshold: float = 0.0
    noise: float = 0.0
    normality: float = math.nan
    gap: tuple[float, float] = (0.0, 0.0)

    def moments(self, F: Array) -> Moments:
        """Marginal mean and standard deviation at scaled features, (n, m)."""
        mean, sd = in_parts(F, self._moments)
        return Moments(mean, sd) if self.margin_data is None else margin_moments(self.threshold - mean, sd, self.noise)

    @property
    def prior_sd(self) -> float:
        """Of `moments` where no simulation is near."""
        return math.sqrt(self.prior.variance) / (self.noise or 1.0)

    def at(self, level: float) -> "SavedLatent":
        """The latent of the boundary at a level of the margin (see `margin.MarginLatent`)."""
        data = self.margin_data
        assert data is not None
        below, above = (0.0, 0.0) if level else self.gap
        if below + above:
            return replace(self, threshold=0.5 * (above - below), added=self.added + (below + above) ** 2 / 12.0)
        return replace(self, threshold=float(data.warped(np.array(level - data.level))))

    def _moments(self, F: Array) -> tuple[Array, Array]:
        k = self.prior.covariance(F, self.support)
        shrunk = k @ self.readout.root.T
        variance = self.prior.variances(F) + self.added - np.einsum("ij,ij->i", shrunk, shrunk)
        if self.trend is not None:
            variance += (1.0 - k @ self.trend.ones) ** 2 / self.trend.total
        return self.prior.mean + k @ self.readout.weights, np.sqrt(np.maximum(variance, self.added))


@dataclass(frozen=True)
class SavedSystem:
    """The latent of a system's boundary.

    Attributes:
        modes: the latents of the modes.
        system: of these.
    """

    modes: tuple[SavedLatent, ...]
    system: System

    margin_data = None

    def moments(self, F: Array) -> Moments:
        """Of the probit at scaled features, (n, m)."""
        return system_moments(self.system, np.column_stack([mode.moments(F).side for mode in self.modes]))


@dataclass(frozen=True)
class SavedClassifier:
    """The latents of a trained classifier of a campaign whose designs all exist.

    Attributes:
        outcomes: names, least severe first.
        features: map from designs to the latents' inputs.
        latents: one for each outcome but the first.
        repeatable: whether equal designs have equal results.
    """

    outcomes: tuple[str, ...]
    features: FeatureMap
    latents: tuple[SavedLatent | SavedSystem, ...]
    repeatable: bool = True

    def predicted(self, X: Array) -> Predicted:
        """As for `Classifier`."""
        return predicted(self, X)

    def existence(self, X: Array) -> Array:
        """As for `Classifier`."""
        return np.ones(len(X))


def saved_classifier(
    state: State,
    X: Array,
    outcomes: Sequence[str],
    features: FeatureMap,
    kernel: str,
    margins: LearnableMargins | None = None,
    repeatable: bool = True,
) -> SavedClassifier:
    """The classifier from its `state.classifier_state`, for predictions alone, with the scaling of the features there.

    Args:
        state: the arrays.
        X: (n, d) training designs.
        outcomes, features, margins, repeatable: as in training.
        kernel: name of a built-in kernel.

    Raises:
        ArithmeticError, LookupError, RuntimeError, TypeError, ValueError: if training cannot produce the arrays, or
            they give no predictions.
    """
    state = of_any_version(state)
    center, spread = (state[name] for name in SCALING)
    features = replace(features, known=(center, spread))
    F = features(X)
    regressions = dict[str, SavedLatent]()
    latents: list[SavedLatent | SavedSystem] = []
    for source in sources(state, outcomes, margins):
        if source.margin is None:
            latents.append(_of_outcomes(state, source.name, kernel, F))
            continue
        if source.system is not None:
            modes = (_of_margin(state, *of_mode) for of_mode in source.modes(F))
            latents.append(SavedSystem(tuple(modes), source.system))
            continue
        if source.name not in regressions:
            regressions[source.name] = _of_margin(state, source.name, F, source.margin)
        shared = regressions[source.name]
        latents.append(shared.at(source.level))
    for latent in latents:
        check(latent, F)
    return SavedClassifier(tuple(outcomes), features, tuple(latents), repeatable)


def _of_outcomes(state: State, name: str, kernel: str, F: Array) -> SavedLatent:
    prior, inducing = SavedPrior.of(kernel, state, name), state.get(f"{name}/inducing")
    sites = prior.mean, state[f"{name}/site_linear"], state[f"{name}/site_precision"]
    Z, Kx = (F, None) if inducing is None else (F[inducing], prior.covariance(F[inducing], F))
    return SavedLatent(prior, Z, readout_of(prior.covariance(Z, Z, JITTER), Kx, *sites))


def _of_margin(state: State, name: str, F: Array, margin: Array) -> SavedLatent:
    prior, data = SavedPrior.of(KERNEL, state, name), margin_data_of(state, name, F, margin)
    jitter = NUGGET * float(prior.variances(np.ones((1, F.shape[1])))[0])
    log_noise, support = state.get(f"{name}/{NOISE}"), data.support
    noise = jitter if log_noise is None else float(np.exp(log_noise[0]))
    Kx = None if data.inducing is None else prior.covariance(support, data.points)
    K, observed = prior.covariance(support, support), data.observed(noise)
    readout, trend, _ = margin_readout(K, Kx, prior.variances(data.points), prior.mean, *observed, jitter)
    sd = 0.0 if log_noise is None else float(np.sqrt(noise))
    normality = float(state.get(f"{name}/normality", math.nan))
    below, above = state.get(f"{name}/gap", np.zeros(2)).tolist()
    return SavedLatent(prior, support, readout, trend, noise, data, noise=sd, normality=normality, gap=(below, above))


class Source(NamedTuple):
    """What a boundary was learned from."""

    name: str  # of the outcome whose arrays hold it
    margin: Array | None  # (n,), or (n, k) of a system; None if it was learned from outcomes
    level: float = 0.0  # of the margin
    system: System | None = None

    def modes(self, F: Array) -> Iterator[tuple[str, Array, Array]]:
        """The name, the features and the margins of each mode of the system, from scaled features, (n, m)."""
        assert self.margin is not None
        for number, margin in enumerate(self.margin.T):
            known = ~np.isnan(margin)
            yield mode_name(self.name, number), F[known], margin[known]


def mode_name(outcome: str, number: int) -> str:
    """The name of the arrays of a system's mode."""
    return f"{outcome}/{number}"


def sources(state: State, outcomes: Sequence[str], margins: LearnableMargins | None) -> Iterator[Source]:
    """What the boundary of each outcome but the first was learned from."""
    choices = choices_of(state, outcomes, margins)
    for severity, name in enumerate(outcomes[1:], start=1):
        if margins is None or choices[severity - 1].margin == OUTCOMES:
            yield Source(name, None)
            continue
        shared = learned_with(choices, severity)
        margin = margins.of(shared, choices[severity - 1].margin)
        yield Source(outcomes[shared], margin, level_of(margins, choices, severity), margins.system)


def choices_of(state: State, outcomes: Sequence[str], margins: LearnableMargins | None) -> tuple[Choice, ...]:
    """What each boundary was learned from; nothing without margins."""
    if margins is None:
        return ()
    arrays = (state[f"{name}/choice"].tolist() for name in outcomes[1:])
    return tuple(
        Choice(int(a), int(n), of_margin, of_outcomes, bool(one)) for a, n, of_margin, of_outcomes, one in arrays
    )


def margin_data_of(state: State, name: str, F: Array, margin: Array) -> MarginData:
    """The data of a regression: its margins, (n,), at scaled features, (n, m), and what a state says of them."""
    values, _, margin_level = defined(margin, f"{name}/gap" in state)
    truncated, warping = (int(state[f"{name}/{key}"]) for key in ("truncated", "warping"))
    sites = CensoredSites(state[f"{name}/site_linear"], state[f"{name}/site_precision"])
    unit, inducing = float(state[f"{name}/unit"]), state.get(f"{name}/inducing")
    return MarginData(F, values, bool(truncated), list(WARPINGS)[warping], unit, sites, inducing, margin_level)


def check(latent: Any, F: Array) -> None:
    """Check a latent by a prediction at the first of scaled features, (n, m).

    Raises:
        ArithmeticError: if it is not finite.
    """
    with np.errstate(all="raise", under="ignore"):
        moments = latent.moments(F[:1])
    if not (np.isfinite(moments.mean).all() and np.isfinite(moments.sd).all()):
        raise ArithmeticError
