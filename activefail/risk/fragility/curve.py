"""A probability against one variable, on a ladder of levels: its capacities, and where it falls."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from activefail.shares import percent
from activefail.space import Array


@dataclass(frozen=True, eq=False)
class Ladder:
    """Fixed levels of a variable."""

    name: str  # of the variable
    unit: str  # its unit
    levels: Array  # (n,) increasing
    is_log: bool  # whether the steps are equal in the logarithm, in which curves are then interpolated

    @classmethod
    def between(cls, name: str, unit: str, low: float, high: float, steps: int, is_log: bool) -> "Ladder":
        """Equal steps between two levels, both included."""
        spaced = np.geomspace if is_log else np.linspace
        return cls(name, unit, spaced(low, high, steps + 1), is_log)

    def coordinate(self, levels: Array) -> Array:
        """Levels, or their logarithms."""
        return np.log(levels) if self.is_log else np.asarray(levels)

    def level(self, coordinate: float) -> float:
        """The level at a coordinate."""
        return float(np.exp(coordinate)) if self.is_log else float(coordinate)


class Capacity(NamedTuple):
    """The level at which a curve first exceeds a probability; if there is none, the reason."""

    level: float | None
    reason: str = ""


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
