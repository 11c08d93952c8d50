"""The shares that the modes of a system have in its failures, from fresh simulations, the classifier frozen.

A simulation gives the margins of all modes. Where each has a regression, this predicts the shares, and the simulations
correct the prediction, as in `estimate`. Otherwise the simulations are counted by their weights.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from activefail.estimates.estimate import WIDER, Interval, ModeShare, Plan, with_floor
from activefail.learning.criteria.by_margin import LEAST
from activefail.learning.criteria.population import Population, around, first_parents, next_parents, population
from activefail.space.space import Array, DesignSpace
from activefail.space.systems import System
from activefail.space.weighted import WeightedRows, clopper_pearson

Sides = Callable[[Array], Array]
"""Values of a distribution's variables, (n, d) -> the probits that each mode has failed, (n, k)."""


_POPULATION, _PARENTS, _ROUNDS = 16_384, 200, 12
"""Designs of a population that integrates the regressions, their parents, and the populations."""


class Events(NamedTuple):
    """Of n designs: whether, or how probably, the system has failed, (n,), and two events for each mode, (n, k)."""

    system: Array
    failed: Array
    decisive: Array

    @classmethod
    def of(cls, system: System, margins: Array) -> "Events":
        """The events that margins, (n, k), say."""
        fails = system(margins) <= 0.0
        without = np.column_stack([system(one) <= 0.0 for one in _each(margins, np.inf)])
        return cls(*(of.astype(float) for of in (fails, fails[:, None] & (margins <= 0.0), fails[:, None] & ~without)))

    @classmethod
    def expected(cls, system: System, z: Array) -> "Events":
        """The probabilities of the events, of the probits that each mode has failed, (n, k)."""
        fails = ndtr(system.probit(z))
        given, without = (
            np.column_stack([ndtr(system.probit(one)) for one in _each(z, end)]) for end in (np.inf, -np.inf)
        )
        return cls(fails, ndtr(z) * given, np.maximum(fails[:, None] - without, 0.0))


def _each(values: Array, end: float) -> Iterator[Array]:
    """The values of modes, (n, k), with another one of them at an end each time."""
    for mode in range(values.shape[1]):
        yield np.where(np.arange(values.shape[1]) == mode, end, values)


@dataclass(frozen=True, eq=False)
class CorrectedModes:
    """What m fresh simulations say of the modes, beyond what regressions predict.

    Attributes:
        system: of the modes.
        plan: of the draws.
        seen: the events of the draws; as predicted where a draw does not show them.
        predicted: their probabilities by the regressions.
        whole: those of the distribution, by each of some populations, first axis.
        doubted: probabilities of the events, in doubt, at designs that might have been drawn.
        adds: what the square of the value of each of these designs adds to the variance of a mean.
    """

    system: System
    plan: Plan
    seen: Events
    predicted: Events
    whole: Events
    doubted: Events
    adds: Array

    def shares(self, confidence: float) -> tuple[ModeShare, ...]:
        """Of each mode, with intervals of this confidence; none if no failure is known."""
        middle = self._estimated(0)
        if not middle > 0.0:
            return ()
        names = self.system.names
        failed, decisive = (
            [self._share(event, mode, float(middle), confidence) for mode in range(len(names))] for event in (1, 2)
        )
        return tuple(map(ModeShare, names, failed, decisive))

    def _estimated(self, event: int) -> Array:
        """The probability of an event, (), or (k,) of one of each mode."""
        return np.asarray(
            self.whole[event].mean(axis=0)
            + self.plan.ratio @ (self.seen[event] - self.predicted[event]) / len(self.plan.ratio)
        )

    def _share(self, event: int, mode: int, of: float, confidence: float) -> Interval:
        """The share of the probability `of` where an event of a mode occurs, a ratio of two corrected estimates."""
        from scipy.stats import t

        share, m = min(1.0, max(0.0, float(self._estimated(event)[mode]) / of)), len(self.plan.ratio)

        def linear(events: Events) -> Array:
            """Its mean is 0 if the share is right."""
            return np.asarray(events[event][:, mode] - share * events.system)

        corrections = linear(self.seen) - linear(self.predicted)
        # (1 − s) with the event, −s in other failures.
        mean_square = self.doubted[event][:, mode] * (1.0 - 2.0 * share) + share**2 * self.doubted.system
        doubt = float(self.adds @ np.maximum(mean_square - linear(self.doubted) ** 2, 0.0))
        of_draws, _, of_rows = self.plan.moments(corrections)
        variance = with_floor(of_draws, doubt, m) + of_rows
        if len(self.whole.system) > 1:
            variance += float(linear(self.whole).var(ddof=1)) / len(self.whole.system)
        half = float(t.ppf(0.5 + 0.5 * confidence, max(1, m - 1))) * math.sqrt(variance) / of
        return share, max(0.0, share - half), min(1.0, share + half)


def doubt_of_modes(system: System, z: Array) -> Array:
    """The largest standard deviation of an event of a mode where the system fails, (n,), of probits, (n, k)."""
    fails, *events = Events.expected(system, z / WIDER)
    q = np.concatenate(events, axis=1) / np.maximum(fails, LEAST)[:, None]
    return np.asarray(np.sqrt(fails * np.maximum(q * (1.0 - q), 0.0).max(axis=1)))


@dataclass(frozen=True, eq=False)
class CountedModes:
    """What m fresh simulations say of the modes by their weights alone.

    Attributes:
        system: of the modes.
        plan: of the draws.
        seen: the events of the draws; not, where a draw does not show them.
    """

    system: System
    plan: Plan
    seen: Events

    def shares(self, confidence: float) -> tuple[ModeShare, ...]:
        """Of each mode, with intervals of this confidence; none if no failure is known."""
        if not self.seen.system.any():
            return ()
        failed, decisive = ([self._share(one, confidence) for one in event.T] for event in self.seen[1:])
        return tuple(map(ModeShare, self.system.names, failed, decisive))

    def _share(self, event: Array, confidence: float) -> Interval:
        """The share of the failures where an event, (m,), occurs.

        The interval is that of Clopper and Pearson, with as many failures as would vary as much if all were independent
        and had equal weights [KornGraubard1998].
        """
        plan, fails = self.plan, self.seen.system
        weight = plan.ratio / len(fails)
        of = float(weight @ fails)
        share = min(1.0, float(weight @ event) / of)
        alone = float((plan.chance * weight**2 + plan.sampled) @ fails)
        if not alone > 0.0:
            return share, share, share
        values, tail = of**2 / alone, 0.5 + 0.5 * confidence
        # A variance by unequal weights is known as if by fewer failures.
        fewer = min(1.0, _students(float(fails.sum()), tail) / _students(values, tail)) ** 2
        variance, _, of_rows = plan.moments((event - share * fails) / of)
        if variance + of_rows > 0.0:
            values = min(values, share * (1.0 - share) / (variance + of_rows))
        return share, *clopper_pearson(share * values * fewer, values * fewer, tail)


def _students(values: float, tail: float) -> float:
    """The quantile of Student's t with as many values."""
    from scipy.stats import t

    return float(t.ppf(tail, max(1.0, values - 1.0)))


def counted_modes(system: System, plan: Plan, margins: Array) -> CountedModes:
    """What fresh simulations say of the modes, without regressions.

    Args:
        system: of the modes.
        plan: of the draws.
        margins: (m, k) of the draws; NaN where one is not known.
    """
    return CountedModes(system, plan, Events.of(system, np.where(np.isnan(margins), np.inf, margins)))


def corrected_modes(
    system: System,
    plan: Plan,
    margins: Array,
    sides: Sides,
    space: DesignSpace | WeightedRows,
    rng: np.random.Generator,
) -> CorrectedModes:
    """What fresh simulations say of the modes, beyond what their regressions predict.

    Args:
        system: of the modes.
        plan: of the draws, after the fresh margins.
        margins: (m, k) of the draws; NaN where one is not known.
        sides: by the regressions.
        space: the distribution.
        rng: draws a sample of it.
    """
    z = sides(plan.designs)
    seen = Events.of(system, np.where(np.isnan(margins), -z, margins))
    assert plan.drawn_from is not None
    X, adds = plan.drawn_from
    doubted = Events.expected(system, sides(X) / (WIDER * plan.deviation))
    predicted, whole = Events.expected(system, z), _integrated(system, sides, space, rng)
    return CorrectedModes(system, plan, seen, predicted, whole, doubted, adds)


def _integrated(system: System, sides: Sides, space: DesignSpace | WeightedRows, rng: np.random.Generator) -> Events:
    """The probabilities of the events by regressions, by each of some populations: (p,), and (p, k) twice."""

    if isinstance(space, WeightedRows):
        drawn = population(space, _POPULATION, None, rng)
        return Events(*(_mean(drawn, of)[None] for of in Events.expected(system, sides(drawn.X))))
    parents = first_parents(space, _POPULATION, _PARENTS, lambda X: ndtr(system.probit(sides(X))), rng)
    rounds = []
    for _ in range(_ROUNDS):
        drawn = around(space, _POPULATION, parents, rng)
        events = Events.expected(system, sides(drawn.X))
        rounds.append([_mean(drawn, of) for of in events])
        parents = next_parents(drawn, _PARENTS, events.system, rng)
    return Events(*map(np.array, zip(*rounds, strict=True)))


def _mean(drawn: Population, values: Array) -> Array:
    """The mean over the distribution of values at a population, (n, ...)."""
    return np.asarray(drawn.weight @ values / len(drawn.weight))
