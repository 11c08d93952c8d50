"""A failure probability from fresh simulations drawn by importance, the classifier frozen; its interval, with a floor.

The classifier's own probability is corrected by simulations that it has not seen. They are drawn where it may be wrong
and where a mistake would weigh most (importance sampling of its mistakes), so that the estimate has no bias, whatever
the classifier believes. The interval holds because of four precautions. The standard deviation of the latent is
doubled where designs are drawn: kinks of the limit state make it too small. The variance of the corrections has a floor
from the classifier's own doubt: few or no observed mistakes do not mean that there are none. If the margins of the
fresh simulations lie farther from their predictions than the latent says, this doubt grows in proportion. And the
campaign's mode check comes before.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtr, ndtri, stdtrit

from activefail.estimates.draws import Rows, expected_draws, merged, systematic
from activefail.estimates.hidden import ModeCheck
from activefail.estimates.integral import Boundaries, Integral, OfBoundary, Standardised, integrate
from activefail.learning.criteria.by_margin import doubt
from activefail.learning.criteria.population import Importance, finite, population
from activefail.learning.features import FeatureMap
from activefail.learning.model.system import ByMargins
from activefail.space.space import REACH, Array, DesignSpace
from activefail.space.weighted import WeightedRows

ROWS = 20_000
"""Designs of the population from which the simulations are drawn."""

UNIFORM, _SCEPTICAL, _UNGUIDED = 0.3, 0.5, 0.7
"""Share of the simulations that are drawn without regard to the classifier's doubt, of a sceptical plan, and the most
that a number of them is."""

_UNSEEN = 0.14
"""Hits of these simulations that a sceptical plan expects where the classifier is sure, unless the outcome is rare: the
first parameter of a gamma distribution."""

SURE = 4.0
"""Standard deviations from the boundary beyond which the classifier is sure."""

WIDER = 2.0
"""Factor of the latent's standard deviation."""

_FARTHEST = 1e6
"""Largest deviation of a fresh margin that counts, in standard deviations."""

_PRIOR_WEIGHT = 16.0
"""Weight of the classifier's own doubt in the variance of the corrections, in simulations."""

_INTEGRAL, _ACCURACIES = 0.2, (0.004, 0.02)
"""Largest standard error of the baseline of a plan over that which the classifier's doubt leaves to the corrections;
and the ends of what it may be over the probability. Half the lower end would take twenty times as long for a
probability of 10 %, and no interval would be narrower by more than a tenth."""

_RARE = 0.01
"""Probability below which an outcome is rare: draws without regard to the classifier go farther out than the
distribution, and fewer hits are expected in proportion, with which its interval would be too wide."""

_IMAGINED = 32
"""Imagined sets of outcomes that predict the width of an interval."""


Interval = tuple[float, float, float]
"""A middle, and the lower and the upper end."""


class ModeShare(NamedTuple):
    """What a mode has to do with the failures of its system.

    Attributes:
        name: of its margin.
        failed: share of the failure probability where the mode has failed, with its interval.
        decisive: share where the system would not fail without this mode.
    """

    name: str
    failed: Interval
    decisive: Interval

    @property
    def numbers(self) -> dict[str, float]:
        """What `--json` shows of it."""
        keys = ("", "_low", "_high")
        pairs = (("failed", self.failed), ("decisive", self.decisive))
        return {f"{name}{key}": one for name, of in pairs for key, one in zip(keys, of, strict=True)}


@dataclass(frozen=True)
class ProbabilityEstimate:
    """A failure probability with its interval.

    Attributes:
        probability: the estimate, at least 0.
        low, high: two-sided interval, with equal tails; `high` includes the probability `space.REACH` that no design
            reaches.
        confidence: of the interval.
        recall: share of the failure probability that the classifier puts beyond the boundary; NaN without failure.
        recall_low: lower end of its one-sided interval, with `confidence`.
        simulations: different fresh simulations, including numerical failures.
        unanswered: numerical failures among them. The interval covers both outcomes that they may have had.
        beyond: how many of the fresh simulations ended beyond the boundary.
        contradictions: how many contradict the classifier; with noise only those where it was sure.
        surprising: how many contradict it where it was sure, by four standard deviations.
        method: how the fresh simulations were drawn.
        deviation: of the margins of the fresh simulations (see `deviation_of_margins`); 1 without margins.
        bound: upper bound on the probability among all designs that needs no classifier, with 90 % confidence.
        check: of a question; None if none was made.
        exists: lower end of the share of designs that exist.
        lost: the classifier's probability if none, and if all, of the runs that are probably lost end beyond the
            boundary; None if none was lost.
        modes: what the modes of a system have to do with its failures; empty without a system.
    """

    probability: float
    low: float
    high: float
    confidence: float
    recall: float
    recall_low: float
    simulations: int
    unanswered: int
    beyond: int
    contradictions: int
    surprising: int
    method: str
    deviation: float = 1.0
    bound: float = 1.0
    check: ModeCheck | None = None
    exists: float = 1.0
    lost: tuple[float, float] | None = None
    modes: tuple[ModeShare, ...] = ()

    @property
    def basis(self) -> str:
        """What the probability rests on, beside other probabilities."""
        return f"{self.simulations} fresh simulations, contradictions: {self.contradictions}"

    @property
    def numbers(self) -> dict[str, float]:
        """What `--json` shows of it."""
        return {
            "probability": self.probability,
            "low": self.low,
            "high": self.high,
            "simulations": self.simulations,
            "numerical_failures": self.unanswered,
            "contradictions": self.contradictions,
            "contradictions_where_sure": self.surprising,
        }


class Counts(NamedTuple):
    """The numbers of simulations of a `ProbabilityEstimate`."""

    simulations: int
    unanswered: int
    beyond: int
    contradictions: int
    surprising: int


def counted(standardised: Array, beyond: NDArray[np.bool_], answered: NDArray[np.bool_]) -> Counts:
    """The numbers of n simulations at which the latent's mean/sd was so large, (n,)."""
    wrong = answered & (beyond != (standardised > 0.0))
    numbers = (~answered, beyond & answered, wrong, wrong & (np.abs(standardised) > SURE))
    return Counts(len(beyond), *(int(of.sum()) for of in numbers))


def estimated(
    interval: Interval,
    recall: tuple[float, float],
    outcomes: tuple[Array, NDArray[np.bool_], NDArray[np.bool_]],
    confidence: float,
    method: str,
    unreached: float,
) -> ProbabilityEstimate:
    """The estimate with an interval and a recall, of which no end is below 0 or above 1.

    Args:
        interval: of the probability.
        recall: and its lower bound.
        outcomes: of the draws, the arguments of `counted`.
        confidence: of the interval.
        method: how the simulations were drawn.
        unreached: probability of designs that are never drawn; all of them may fail.
    """
    middle, low, high = (min(1.0, max(0.0, end)) for end in interval)
    ends = min(low, middle), min(1.0, max(high, middle) + unreached)
    numbers = counted(*outcomes)
    return ProbabilityEstimate(middle, *ends, confidence, *recall, *numbers, method)


@dataclass(frozen=True)
class Doubt:
    """How wrong the classifier may be on one side of the boundary, by its own doubt.

    Attributes:
        floor: variance of the sum of the corrections, due to the draws.
        of_rows: the same due to the rows from which the designs were drawn, which are a sample themselves.
    """

    floor: float
    of_rows: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Fresh designs that correct a classifier's failure probability.

    Attributes:
        designs: (m, d), in the order in which they were drawn.
        ratio: (m,) density of the design measure over that of the draws: m times the part of the distribution that the
            design has, over its expected number of draws. The mean of `ratio` times values estimates their mean.
        chance: (m,) the part of the variance that is due to the draw: 0 of designs that are drawn for certain, and
            have no noise.
        sampled: (m,) what the square of each one's value adds to the variance of the mean because the rows from which
            it was drawn are a sample themselves.
        standardised: (m,) the latent's mean/sd.
        probability: the share of the distribution for which the classifier predicts the outcome.
        standard_error: of its integration.
        doubts: the classifier's doubt of the designs that it puts short of the boundary, and beyond it, if the latent's
            standard deviations are larger by a factor.
        widest: largest ratio among all designs that might have been drawn or not; 0 if there are none.
        unseen: hits that are expected where the classifier is sure.
        deviation: this factor, of the margins of the fresh simulations (see `deviation_of_margins`).
        ends: the same designs as corrections of two other boundaries: where no run that is probably lost is beyond, and
            where all are; None if none is probably lost.
        of: a plan of the same designs for another boundary.
        drawn_from: the designs, (N, d), that might have been drawn, and what the square of each one's value adds to the
            variance of the mean, (N,).
    """

    designs: Array
    ratio: Array
    chance: Array
    sampled: Array
    standardised: Array
    probability: float
    standard_error: float
    doubts: Callable[[float], tuple[Doubt, Doubt]]
    widest: float
    unseen: float = 0.0
    deviation: float = 1.0
    ends: "tuple[Plan, Plan] | None" = None
    of: "Callable[[Standardised], Plan] | None" = None
    drawn_from: tuple[Array, Array] | None = None

    def deviating(self, deviation: float) -> "Plan":
        """The plan after the fresh margins showed how far they lie from their predictions.

        If they lie farther than the latent's standard deviations say, the classifier's doubt grows in proportion.
        """
        ends = None if self.ends is None else (self.ends[0].deviating(deviation), self.ends[1].deviating(deviation))
        return replace(self, deviation=deviation, ends=ends)

    @property
    def predicted(self) -> NDArray[np.bool_]:
        """Whether the classifier puts each design beyond the boundary, (m,)."""
        return self.standardised > 0.0

    @property
    def surest(self) -> tuple[int, float]:
        """Draws that would meet failure anywhere, and the largest share of the distribution that each stands for."""
        draws = int((self.chance > 0.0).sum())
        return draws, self.widest * draws / len(self.designs)

    def moments(self, values: Array) -> tuple[float, float, float]:
        """Of the mean of `ratio` times values, (m,): variance and third central moment due to the draws.

        And the variance due to the rows. A draw is compared with the two beside it in the order, which resemble it.
        """
        of_chance = self.chance > 0.0
        parts = (values * self.ratio)[of_chance] * np.sqrt(self.chance[of_chance]) / len(values)
        of_rows = float(self.sampled @ values**2)
        if len(parts) < 3:
            return float(parts @ parts), 0.0, of_rows
        apart = (2.0 * parts - np.roll(parts, 1) - np.roll(parts, -1)) / 6.0**0.5
        return float(apart @ apart), float((apart**3).sum()) * 6.0**0.5, of_rows

    def estimate(
        self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float
    ) -> ProbabilityEstimate:
        """The estimate from the outcomes of the simulations.

        Args:
            beyond: (m,) whether each outcome is beyond the boundary.
            answered: (m,) whether each simulation gave an outcome; the interval covers both outcomes of the others.
            confidence: of the interval.
        """
        middle, _, _ = self._interval(np.where(answered, beyond, self.predicted), confidence)
        if_none, if_all = self.ends or (self, self)
        _, low, _ = if_none._interval(beyond & answered, confidence)
        _, _, high = if_all._interval(beyond | ~answered, confidence)
        recall = self._recall(beyond, answered, confidence)
        outcomes = self.standardised, beyond, answered
        is_exact = not (self.chance.any() or self.sampled.any() or self.standard_error)
        method = "all rows of the distribution" if is_exact else "importance sampling of the classifier's mistakes"
        reach = 0.0 if is_exact else REACH
        of = estimated((middle, low, high), recall, outcomes, confidence, method, reach)
        return replace(of, deviation=self.deviation)

    def expected_half_width(self, confidence: float, rng: np.random.Generator) -> float:
        """Expected distance from the estimate to its upper bound, if the classifier's own probabilities are right."""
        likely = ndtr(self.standardised)
        widths = []
        for _ in range(_IMAGINED):
            beyond = rng.random(len(likely)) < likely
            middle, _, high = self._interval(beyond, confidence)
            if self.ends is not None:
                # Where a run is probably lost, it counts as beyond.
                _, _, high = self.ends[1]._interval(beyond | self.ends[1].predicted, confidence)
            widths.append(high - middle)
        return float(np.mean(widths))

    @cached_property
    def _doubts(self) -> tuple[Doubt, Doubt]:
        """The classifier's doubt of what it misses, and of what it wrongly counts."""
        return self.doubts(self.deviation)

    def _interval(self, beyond: NDArray[np.bool_], confidence: float) -> Interval:
        corrections = beyond.astype(np.float64) - self.predicted
        middle = self.probability + float(corrections @ self.ratio) / len(corrections)
        low, high = (
            middle + self._distance(corrections, self._doubts, self.standard_error, side)
            for side in (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
        )
        if self.unseen:
            # What the simulations could have missed.
            missable = self.widest / len(corrections) * float(gammaincinv(self.unseen, 0.5 + 0.5 * confidence))
            high = middle + math.hypot(high - middle, missable)
        return middle, low, high

    def _distance(self, corrections: Array, doubts: Sequence[Doubt], error: float, share: float) -> float:
        """Distance from the sum of corrections, (m,), and an integral, to the quantile of this share of what it may be.

        A gamma distribution with three moments. Towards the side where rare corrections lie, half of one more counts:
        for equal ratios these are the ends of a rate by few events, exact below, and by Jeffreys' prior above.
        """
        variance, third, of_rows = self.moments(corrections)
        floor, of_rows = sum(one.floor for one in doubts), max(of_rows, sum(one.of_rows for one in doubts))
        m, towards = len(corrections), third * (share - 0.5) > 0.0
        step = third / variance if towards else 0.0
        second = with_floor(variance, floor, m) + 0.5 * step**2 + error**2 + of_rows
        if second < REACH**4:
            # Of such a variance, the power below may be 0.
            return 0.0
        skewness = 2.0 * (third + 0.5 * step**3) / second**1.5
        students = float(stdtrit(max(1, m - 1), share)) / float(ndtri(share))
        return 0.5 * step + students * math.sqrt(second) * gamma_quantile(share, skewness)

    def _recall(self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float) -> tuple[float, float]:
        """The share of the failure probability that the classifier puts beyond the boundary, and its lower bound.

        Three bounds enter the lower one: of the probability that is missed, of the one that is wrongly counted, and of
        the integral. Each errs a third as often as the lower bound may. Numerical failures are missed, or wrongly
        counted.
        """
        share = 1.0 - (1.0 - confidence) / 3.0

        def mean(wrong: NDArray[np.bool_]) -> float:
            return float(wrong @ self.ratio) / len(wrong)

        def upper(wrong: NDArray[np.bool_], doubt: Doubt) -> float:
            return mean(wrong) + self._distance(wrong.astype(np.float64), [doubt], 0.0, share)

        predicted, (of_missed, of_false) = self.predicted, self._doubts
        missed, false = mean(answered & beyond & ~predicted), mean(answered & ~beyond & predicted)
        missed_high = upper(~predicted & (beyond | ~answered), of_missed) + REACH
        false_high = upper(predicted & ~(beyond & answered), of_false)
        of_integral = float(stdtrit(len(beyond) - 1, share)) * self.standard_error
        hit = max(0.0, self.probability - false)
        hit_low = max(0.0, self.probability - false_high - of_integral)
        if hit + missed <= 0.0:
            return math.nan, 0.0
        return hit / (hit + missed), hit_low / (hit_low + missed_high)


def with_floor(variance: float, floor: float, m: int) -> float:
    """A variance from m draws, nearer to a floor the fewer they are; the floor counts as `_PRIOR_WEIGHT` draws."""
    return variance + _PRIOR_WEIGHT / (m + _PRIOR_WEIGHT) * max(0.0, floor - variance)


def gamma_quantile(share: float, skewness: float) -> float:
    """The quantile of the gamma distribution with the mean 0, the variance 1 and a skewness, which may be negative."""
    if abs(skewness) < 1e-3:
        return float(ndtri(share))
    if skewness < 0.0:
        return -gamma_quantile(1.0 - share, -skewness)
    shape = 4.0 / skewness**2
    return (float(gammaincinv(shape, share)) - shape) / math.sqrt(shape)


def deviation_of_margins(latent: ByMargins, features: FeatureMap, designs: Array, margin: Array) -> float:
    """Root mean square of fresh margins' deviations from their predictions, in the latent's standard deviations.

    It is at least 1. Margins that are undefined, or censored, do not count.

    Args:
        latent: that has not seen the margins.
        features: map from designs to its inputs.
        designs: (n, d).
        margin: (n,) in relation to the boundary.
    """
    deviations = latent.deviations(finite(features, designs), margin)
    known = np.minimum(np.abs(deviations[np.isfinite(deviations)]), _FARTHEST)
    return max(1.0, float(np.sqrt(np.mean(known**2)))) if len(known) else 1.0


def plan_estimate(
    standardised: Standardised,
    space: DesignSpace | WeightedRows,
    m: int,
    rng: np.random.Generator,
    repeatable: bool = True,
    sceptical: bool = False,
) -> Plan:
    """Plan m fresh simulations that correct the baseline of one boundary (see `plan_estimates`)."""
    only = [lambda X: standardised(X)[:, None]]
    return plan_estimates(only, space, m, rng, repeatable=repeatable, sceptical=sceptical)[0]


def plan_estimates(
    boundaries: Sequence[Boundaries],
    space: DesignSpace | WeightedRows,
    m: int,
    rng: np.random.Generator,
    beside: Callable[[Array], Array] | None = None,
    designs: Callable[[Array], Array] = lambda X: X,
    first: int = 0,
    repeatable: bool = True,
    sceptical: bool = False,
    unguided: int = 0,
) -> list[Plan]:
    """Plan m fresh simulations that correct the baselines of all b boundaries.

    Args:
        boundaries: as learned; followed by those if none, and all, of the runs that are probably lost are beyond, if
            any is. Of values of the distribution's variables.
        space: the distribution.
        m: number of simulations; if there are no more different designs, all of them are simulated.
        rng: draws them.
        beside: a doubt that they are drawn for as much as for that of a boundary, (n, d) -> (n,).
        designs: the designs of values of the distribution's variables. No design is simulated twice.
        first: the boundary along which the draws are spread.
        repeatable: whether equal designs have equal results. If not, designs are simulated again where there are fewer
            than m, and none is known for certain.
        sceptical: whether the classifier may be wrong where it is sure, with failures that are scattered, such as one
            of outcomes that is asked about a distribution that it was not learned for.
        unguided: least number of draws without regard to the classifier, up to a share of 0.7.
    """

    def in_doubt(X: Array) -> Array:
        """Doubts, (k, n), one for each boundary and kind of boundaries."""
        parts = np.concatenate([doubt(of(X).T / WIDER) for of in boundaries])
        return parts if beside is None else np.concatenate([parts, beside(X)[None]])

    rows = rows_of(space, lambda X: _alike(in_doubt(X)), designs, rng)
    z = np.array([of(rows.X).T for of in boundaries])
    parts = rows.share * in_doubt(rows.X)
    rarity = 0.5 * float(np.mean([1.0 - _commonness(float(rows.share @ (one > 0.0)) / 10.0) for one in z[0]]))
    chances = (1.0 - rarity) * rows.share / rows.share.sum() + rarity * rows.wide / rows.wide.sum()
    if len(parts := parts[parts.sum(axis=1) > 0.0]):
        # The same for each boundary, however likely its outcome is.
        uniform = max(_SCEPTICAL if sceptical else UNIFORM, min(unguided / m, _UNGUIDED))
        chances = uniform * chances + (1.0 - uniform) * _alike(parts)
    expected = expected_draws(chances, m, repeats=not repeatable)
    drawn = systematic(expected, np.lexsort((rng.random(len(expected)), z[0, first])), rng)
    m = len(drawn)
    ratio = m * rows.share / expected
    # Of what noise adds, nothing is certain.
    chance = 1.0 - expected if repeatable else np.ones(len(expected))
    widest = float(ratio[chance > 0.0].max(initial=0.0))
    adds = chance * rows.share**2 / expected
    seed = int(rng.integers(2**63))

    def doubts(z: Array, deviation: float) -> tuple[Doubt, Doubt]:
        side = ndtr(z / (WIDER * deviation))
        wrong = np.minimum(side, 1.0 - side)

        def doubt_of(part: NDArray[np.bool_]) -> Doubt:
            return Doubt(float((adds * wrong)[part].sum()), float((rows.variance * wrong)[part].sum()))

        return doubt_of(z <= 0.0), doubt_of(z > 0.0)

    def planned(z: Array, share: OfBoundary) -> Plan:
        return Plan(
            designs=rows.X[drawn],
            ratio=ratio[drawn],
            chance=chance[drawn],
            sampled=(rows.variance / expected)[drawn],
            standardised=z[drawn],
            probability=share.probability,
            standard_error=share.error,
            doubts=partial(doubts, z),
            widest=widest,
            unseen=_UNSEEN * _commonness(share.probability) if sceptical else 0.0,
            of=plan_of,
            drawn_from=(rows.X, adds),
        )

    def baselines(boundaries: Boundaries, z: Array) -> list[OfBoundary]:
        """Of all columns of boundaries with z, (b, n), at the rows."""
        counted = (z > 0.0) @ rows.share
        if isinstance(space, WeightedRows):
            return [OfBoundary(float(one), 0.0, 0.0) for one in counted]
        known = [
            sum(one.floor * _PRIOR_WEIGHT / (m + _PRIOR_WEIGHT) + one.of_rows for one in doubts(of, 1.0)) for of in z
        ]
        accuracy = _INTEGRAL * np.sqrt(known) / np.maximum(counted, REACH)
        points = np.random.default_rng(seed)
        integral = baseline(boundaries, space, np.clip(accuracy, *_ACCURACIES), points)
        return [integral.of(column) for column in range(len(z))]

    def plan_of(boundary: Standardised) -> Plan:
        of = boundary(rows.X)[None]
        return planned(of[0], baselines(lambda X: boundary(X)[:, None], of)[0])

    learned, *ends = (
        [planned(*one) for one in zip(of, baselines(by, of), strict=True)] for by, of in zip(boundaries, z, strict=True)
    )
    pairs = zip(*ends, strict=True) if ends else [None] * len(learned)
    return [replace(of, ends=pair) for of, pair in zip(learned, pairs, strict=True)]


def rows_of(
    space: DesignSpace | WeightedRows,
    importance: Importance,
    designs: Callable[[Array], Array],
    rng: np.random.Generator,
) -> Rows:
    """The different designs of a distribution from which fresh simulations are drawn: weighted rows, or a population.

    Args:
        space: the distribution.
        importance: of values of its variables, for a population.
        designs: of values of its variables.
        rng: draws the population.
    """
    drawn = population(space, ROWS, importance, rng)
    share, wide = drawn.weight / len(drawn.weight), drawn.wide / len(drawn.weight)
    is_exact = isinstance(space, WeightedRows)
    return merged(Rows(drawn.X, share, wide, 0.0 * share if is_exact else share**2), designs(drawn.X))


def baseline(boundaries: Boundaries, space: DesignSpace, accuracy: float | Array, rng: np.random.Generator) -> Integral:
    """The shares of a distribution for which each of b boundaries is predicted to be crossed.

    Fresh simulations correct them. They count predictions: `integral.integrate` gives the classifier's probabilities,
    the means of its probabilities.

    Args:
        boundaries: of values of the distribution's variables.
        space: the distribution.
        accuracy: relative standard error that is small enough, () or (b,).
        rng: draws the points.
    """
    return integrate(lambda X: boundaries(X), space, accuracy=accuracy, share=_is_beyond, rng=rng)


def _is_beyond(z: Array) -> Array:
    return (z > 0.0).astype(np.float64)


def _commonness(probability: float) -> float:
    """1, or less in proportion if an outcome of this probability is rare."""
    return min(1.0, probability / _RARE)


def _alike(parts: Array) -> Array:
    """The sum of parts, (k, n), each of which sums to the same, 1 in all, (n,)."""
    totals = parts.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(parts, totals * len(parts), out=np.zeros_like(parts), where=totals > 0.0).sum(axis=0))
