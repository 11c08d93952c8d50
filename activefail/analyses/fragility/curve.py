"""A probability against one variable, on a ladder of levels: its capacities and its risk."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from activefail.space.shares import percent
from activefail.space.space import Array

_LEAST, _MOST = 0.1, 0.5
"""A curve that stays above the first or below the second has no median to fit."""

YEARS = 50.0
"""Years of the stated risk."""

_STEPS = 2000
"""Steps of the integral."""


@dataclass(frozen=True, eq=False)
class Ladder:
    """Fixed levels of a variable."""

    name: str  # of the variable
    unit: str  # its unit
    levels: Array  # (n,) increasing
    is_log: bool  # whether the steps are equal in the logarithm, in which curves are then interpolated
    in_steps: bool = False  # whether the variable has no values between the levels

    def coordinate(self, levels: Array) -> Array:
        """Levels, or their logarithms."""
        return np.log(levels) if self.is_log else np.asarray(levels)

    def level(self, coordinate: float) -> float:
        """The level at a coordinate."""
        return float(np.exp(coordinate)) if self.is_log else float(coordinate)


class Capacity(NamedTuple):
    """The level at which a curve first exceeds a probability; if there is none, the reason."""

    level: float | None
    reason: str | None = None


class Fall(NamedTuple):
    """The largest fall of a curve against its direction, in probability, and the levels between which it falls."""

    size: float
    start: float
    end: float


def first_above(coordinates: Array, values: Array, p: float) -> float | None:
    """The coordinate at which values, linear in between, first exceed p; None if never, or at once."""
    above = np.flatnonzero(values > p)
    if not len(above) or above[0] == 0:
        return None
    last, first = above[0] - 1, above[0]
    share = (p - values[last]) / (values[first] - values[last])
    return float(coordinates[last] + share * (coordinates[first] - coordinates[last]))


@dataclass(frozen=True, eq=False)
class Curve:
    """The probability beyond a boundary at each level of a ladder.

    Most curves rise with the level, as with the intensity of an earthquake. Those that fall, as with a displacement
    capacity, are read from their upper end. Either way, a capacity is where the curve first exceeds a probability,
    seen from its safe end: a curve that falls back afterwards does not regain it.
    """

    ladder: Ladder  # its levels
    probability: Array  # (n,)
    resolution: float  # largest error of the integration over the other variables, estimated

    @property
    def rises(self) -> bool:
        """Whether the curve ends higher than it begins."""
        return bool(self.probability[-1] >= self.probability[0])

    @property
    def from_the_safe_end(self) -> tuple[Array, Array]:
        """Coordinates of the levels and probabilities, (n,) each, from the end where the curve is low."""
        step = 1 if self.rises else -1
        return self.ladder.coordinate(self.ladder.levels)[::step], self.probability[::step]

    def at(self, levels: Array | float) -> Array:
        """Probabilities at levels, interpolated; constant beyond the ladder."""
        coordinates = self.ladder.coordinate(np.asarray(levels, dtype=np.float64))
        return np.interp(coordinates, self.ladder.coordinate(self.ladder.levels), self.probability)

    def capacity(self, p: float) -> Capacity:
        """The level at which the curve first exceeds a probability."""
        coordinates, values = self.from_the_safe_end
        crossing = first_above(coordinates, values, p)
        if crossing is not None and self.ladder.in_steps:
            crossing = float(coordinates[np.argmax(values > p)])
        if crossing is not None:
            return Capacity(self.ladder.level(crossing))
        ends = self.ladder.levels[:: 1 if self.rises else -1]
        if values[0] > p:
            return Capacity(None, f"the curve already exceeds {percent(p)} at its first level, {ends[0]:.3g}")
        return Capacity(None, f"the curve stays below {percent(p)} up to its last level, {ends[-1]:.3g}")

    @property
    def fall(self) -> Fall | None:
        """The largest fall against the curve's direction; None if it is not larger than the resolution."""
        coordinates, values = self.from_the_safe_end
        highest = np.maximum.accumulate(values)
        end = int(np.argmax(highest - values))
        size = float(highest[end] - values[end])
        if size <= self.resolution:
            return None
        start = int(np.argmax(values[: end + 1]))
        return Fall(size, self.ladder.level(coordinates[start]), self.ladder.level(coordinates[end]))


def why_not_fitted(curve: Curve) -> str:
    """Why no lognormal curve is fitted to the capacities of values with this curve; empty if one is."""
    if curve.ladder.levels[0] <= 0.0:
        return "some levels of the curve are not positive"
    if curve.probability.max() < _MOST or curve.probability.min() > _LEAST:
        return f"the curve does not cover {100.0 * _LEAST:g} % to {100.0 * _MOST:g} %"
    return ""


@dataclass(frozen=True, eq=False)
class Rate:
    """How often loads occur: those of at least the first level of a hazard's curve. Weaker ones are left out."""

    levels: Array  # (m,) of the curve, increasing
    rates: Array  # (m,) at which they are exceeded, decreasing [1/year]
    years: float = YEARS  # of a risk

    @property
    def annual(self) -> float:
        """Rate of loads of at least the level `least` [1/year]."""
        return float(self.rates[0])

    @property
    def least(self) -> float:
        """The least level of the curve."""
        return float(self.levels[0])

    def exceeding(self, levels: Array) -> Array:
        """Annual rates at which levels, (n,), are exceeded: linear in logarithms, extrapolated by the end's slope."""
        x, y, at = np.log(self.levels), np.log(self.rates), np.log(levels)
        segment = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
        slope = np.diff(y) / np.diff(x)
        return np.asarray(np.exp(y[segment] + slope[segment] * (at - x[segment])))

    def risk(self, probability: float) -> float:
        """The probability of at least one occurrence in these years, given its probability under one load."""
        return -math.expm1(-self.years * self.annual * probability)

    def given_pulse(self, risk: float) -> float:
        """The probability under one load that gives this risk."""
        return -math.log1p(-risk) / (self.years * self.annual)


class Risk(NamedTuple):
    """The rate of failure λ, and its probability in some years (`Rate.risk`)."""

    annual_rate: float  # λ [1/year]
    years: float  # t
    probability: float  # of at least one failure in these years, 1 − exp(−t λ)
    least: float  # level where the hazard's curve begins; weaker loads are left out
    at_least: float  # of the fragility curve at this level
    share_outside_hazard_curve: float  # of λ: from intensities where the end of the hazard's curve is extrapolated
    share_above_fragility_curve: float  # of λ: from intensities where the last value of the fragility curve holds


def risk_of(curve: Curve, rate: Rate) -> Risk:
    """The risk: λ = ∫ P(v) |dν(v)| over loads of at least the first level, with the rate ν(v) of exceedance.

    Args:
        curve: P(v), against the intensity of the hazard's curve.
        rate: of the loads.
    """
    low, high = math.log(rate.least), max(float(np.log(curve.ladder.levels[-1])), math.log(rate.levels[-1]))
    corners = np.log(np.concatenate([rate.levels, curve.ladder.levels]))
    corners = corners[(corners > low) & (corners < high)]
    logarithms = np.unique(np.concatenate([np.linspace(low, high, _STEPS + 1), corners]))
    levels = np.exp(logarithms)
    nu = rate.exceeding(levels)
    middle = np.exp(0.5 * (logarithms[1:] + logarithms[:-1]))
    # Simpson's rule for the probability in each step of the rate.
    average = (curve.at(levels[:-1]) + 4.0 * curve.at(middle) + curve.at(levels[1:])) / 6.0
    parts = average * (nu[:-1] - nu[1:])
    beyond = float(curve.probability[-1] * nu[-1])
    total, at_least = float(parts.sum()) + beyond, float(curve.at(rate.least))
    if total <= 0.0:
        return Risk(0.0, rate.years, 0.0, rate.least, at_least, 0.0, 0.0)
    inside = float(parts[middle <= rate.levels[-1]].sum())
    risk = rate.risk(total / rate.annual)
    return Risk(total, rate.years, risk, rate.least, at_least, 1.0 - inside / total, beyond / total)
