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
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from activefail.acquisition.by_margin import doubt
from activefail.acquisition.population import finite, population
from activefail.features import FeatureMap
from activefail.reliability.hidden import ModeCheck
from activefail.reliability.integral import Boundaries, Integral, OfBoundary, Standardised, integrate
from activefail.space import REACH, Array, DesignSpace
from activefail.surrogate.system import ByMargins
from activefail.weighted import WeightedRows

RADIAL = 20_000
"""Designs of the radial population from which the simulations are drawn."""

UNIFORM = 0.3
"""Share of the simulations that are drawn without regard to the classifier's doubt."""

LARGEST_RATIO = 2.0 / UNIFORM
"""Largest density of the design measure over that of a fresh simulation. A radial population has at least half the
density of the measure everywhere."""

SURE = 4.0
"""Standard deviations from the boundary beyond which the classifier is sure."""

WIDER = 2.0
"""Factor of the latent's standard deviation."""

_FARTHEST = 1e6
"""Largest deviation of a fresh margin that counts, in standard deviations."""

_PRIOR_WEIGHT = 16.0
"""Weight of the classifier's own doubt in the variance of the corrections, in simulations."""

_ACCURACY = 0.01
"""Relative standard error of the baseline of a plan."""

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


class Doubt(NamedTuple):
    """How wrong the classifier may be on one side of the boundary, by its own doubt.

    Attributes:
        floor: variance of one correction.
        of_population: variance of the mean correction due to the population from which the designs were drawn.
    """

    floor: float
    of_population: float


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
        wrong: how many contradict the classifier.
        surprising: how many of these lie where the classifier was sure, by four standard deviations.
        method: how the fresh simulations were drawn.
        deviation: of the margins of the fresh simulations (see `deviation_of_margins`); 1 without margins.
        draws: of these simulations, some of them drawn repeatedly; 0 if they are all rows of the distribution, so that
            the interval is that of the numerical failures alone.
        hits: draws that ended beyond the boundary, or may have.
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
    wrong: int
    surprising: int
    method: str
    deviation: float = 1.0
    draws: int = 0
    hits: int = 0
    check: ModeCheck | None = None
    exists: float = 1.0
    lost: tuple[float, float] | None = None
    modes: tuple[ModeShare, ...] = ()

    @property
    def numbers(self) -> dict[str, float]:
        """What `--json` shows of it."""
        return {
            "probability": self.probability,
            "low": self.low,
            "high": self.high,
            "simulations": self.simulations,
            "numerical_failures": self.unanswered,
            "contradictions": self.wrong,
            "contradictions_where_sure": self.surprising,
        }


class Counts(NamedTuple):
    """The numbers of simulations of a `ProbabilityEstimate`."""

    simulations: int
    unanswered: int
    beyond: int
    wrong: int
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
) -> ProbabilityEstimate:
    """The estimate with an interval and a recall, of which no end is below 0 or above 1.

    Args:
        interval: of the probability.
        recall: and its lower bound.
        outcomes: of the draws, the arguments of `counted`.
        confidence: of the interval.
        method: how the simulations were drawn.
    """
    middle, low, high = (min(1.0, max(0.0, end)) for end in interval)
    _, beyond, answered = outcomes
    hits = int((beyond | ~answered).sum())
    # No design is drawn farther out than `REACH`; all of them may fail.
    ends = min(low, middle), min(1.0, max(high, middle) + REACH)
    numbers = counted(*outcomes)
    return ProbabilityEstimate(middle, *ends, confidence, *recall, *numbers, method, draws=len(beyond), hits=hits)


@dataclass(frozen=True, eq=False)
class AllRows:
    """All rows of a distribution, of which only the numerical failures remain unknown.

    Attributes:
        designs: (n, k).
        ratio: (n,) weights, with mean 1.
        standardised: (n,) the latent's mean/sd.
    """

    designs: Array
    ratio: Array
    standardised: Array

    surest: ClassVar[tuple[int, float]] = (0, 0.0)

    def estimate(
        self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float
    ) -> ProbabilityEstimate:
        """The share of the rows (see `Plan.estimate`)."""
        share, predicted = self.ratio / self.ratio.sum(), self.standardised > 0.0
        low, high = float(share @ (beyond & answered)), float(share @ (beyond | ~answered))
        middle = float(share @ np.where(answered, beyond, predicted))
        hit = float(share @ (beyond & answered & predicted))
        missed = float(share @ (~predicted & (beyond | ~answered)))
        recall = hit / low if low else math.nan, hit / (hit + missed) if hit else 0.0
        numbers = counted(self.standardised, beyond, answered)
        return ProbabilityEstimate(middle, low, high, confidence, *recall, *numbers, "all rows of the distribution")


@dataclass(frozen=True, eq=False)
class Plan:
    """Fresh designs that correct a classifier's failure probability.

    Attributes:
        designs: (m, d).
        ratio: (m,) density of the design measure over that of the draws.
        standardised: (m,) the latent's mean/sd.
        probability: the share of the distribution for which the classifier predicts the outcome.
        standard_error: of its integration.
        doubts: the classifier's doubt of the designs that it puts short of the boundary, and beyond it, if the latent's
            standard deviations are larger by a factor.
        deviation: this factor, of the margins of the fresh simulations (see `deviation_of_margins`).
        ends: the same designs as corrections of two other boundaries: where no run that is probably lost is beyond, and
            where all are; None if none is probably lost.
        of: a plan of the same designs for another boundary and its baseline.
        drawn_from: the designs, (N, d), that might have been drawn, and what each adds to the mean square of `ratio`,
            (N,).
    """

    designs: Array
    ratio: Array
    standardised: Array
    probability: float
    standard_error: float
    doubts: Callable[[float], tuple[Doubt, Doubt]]
    deviation: float = 1.0
    ends: "tuple[Plan, Plan] | None" = None
    of: "Callable[[Standardised, OfBoundary], Plan] | None" = None
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
        """Simulations that would meet failure where the classifier is sure, and the share that each may stand for.

        A part of them is drawn without regard to the classifier's doubt.
        """
        return len(self.designs), 1.0 / UNIFORM

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
        outcomes, method = (self.standardised, beyond, answered), "importance sampling of the classifier's mistakes"
        of = estimated((middle, low, high), recall, outcomes, confidence, method)
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
        corrections = (beyond.astype(np.float64) - self.predicted) * self.ratio
        (missed, false), m = self._doubts, len(corrections)
        middle = self.probability + float(corrections.mean())
        variance = variance_of(corrections, missed.floor + false.floor) / m
        variance += self.standard_error**2 + missed.of_population + false.of_population
        half = float(stdtrit(m - 1, 0.5 + 0.5 * confidence)) * float(np.sqrt(variance))
        return middle, middle - half, middle + half

    def _recall(self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float) -> tuple[float, float]:
        """The share of the failure probability that the classifier puts beyond the boundary, and its lower bound.

        Three bounds enter the lower one: of the probability that is missed, of the one that is wrongly counted, and of
        the integral. Each errs a third as often as the lower bound may. Numerical failures are missed, or wrongly
        counted.
        """
        quantile = float(stdtrit(len(beyond) - 1, 1.0 - (1.0 - confidence) / 3.0))

        def upper(wrong: NDArray[np.bool_], doubt: Doubt) -> float:
            corrections = wrong * self.ratio
            variance = variance_of(corrections, doubt.floor) / len(wrong) + doubt.of_population
            return float(corrections.mean()) + quantile * float(np.sqrt(variance))

        predicted, (of_missed, of_false) = self.predicted, self._doubts
        missed = float((answered & beyond & ~predicted) @ self.ratio) / len(beyond)
        false = float((answered & ~beyond & predicted) @ self.ratio) / len(beyond)
        missed_high = upper(~predicted & (beyond | ~answered), of_missed) + REACH
        false_high = upper(predicted & ~(beyond & answered), of_false)
        hit = max(0.0, self.probability - false)
        hit_low = max(0.0, self.probability - false_high - quantile * self.standard_error)
        if hit + missed <= 0.0:
            return math.nan, 0.0
        return hit / (hit + missed), hit_low / (hit_low + missed_high)


def variance_of(corrections: Array, floor: float) -> float:
    """Variance of one correction, with a floor that counts as `_PRIOR_WEIGHT` observations."""
    m = len(corrections)
    return float(m * corrections.var(ddof=1) + _PRIOR_WEIGHT * floor) / (m + _PRIOR_WEIGHT)


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


def baseline(standardised: Standardised, space: DesignSpace | WeightedRows) -> OfBoundary:
    """The share of a distribution for which a boundary is predicted to be crossed, which fresh simulations correct.

    It counts predictions. `integral.integrate` gives the classifier's probability, the mean of its probabilities.
    """
    return _baselines(lambda X: standardised(X)[:, None], space).of(0)


def _baselines(boundaries: Boundaries, space: DesignSpace | WeightedRows) -> Integral:
    return integrate(lambda X: boundaries(X), space, accuracy=_ACCURACY, share=_is_beyond)


def _is_beyond(z: Array) -> Array:
    return (z > 0.0).astype(np.float64)


def plan_estimate(
    standardised: Standardised,
    space: DesignSpace | WeightedRows,
    of_classifier: OfBoundary,
    m: int,
    rng: np.random.Generator,
) -> Plan:
    """Plan m fresh simulations that correct the baseline of a classifier.

    Args:
        standardised: the boundary.
        space: the distribution.
        of_classifier: the baseline.
        m: number of simulations.
        rng: draws them.
    """
    return _planned([lambda X: standardised(X)[:, None]], space, [[of_classifier]], m, rng)[0]


def plan_estimates(
    boundaries: Sequence[Boundaries],
    space: DesignSpace | WeightedRows,
    m: int,
    rng: np.random.Generator,
    beside: Callable[[Array], Array] | None = None,
) -> list[Plan]:
    """Plan m fresh simulations that correct the baselines of all b boundaries.

    Args:
        boundaries: as learned; followed by those if none, and all, of the runs that are probably lost are beyond, if
            any is.
        space: the distribution.
        m: number of simulations.
        rng: draws them.
        beside: a doubt that they are drawn for as much as for that of a boundary, (n, d) -> (n,).
    """
    integrals = [_baselines(of, space) for of in boundaries]
    shares = [[integral.of(column) for column in range(len(integral.probability))] for integral in integrals]
    return _planned(boundaries, space, shares, m, rng, beside)


def _planned(
    boundaries: Sequence[Boundaries],
    space: DesignSpace | WeightedRows,
    baselines: Sequence[Sequence[OfBoundary]],
    m: int,
    rng: np.random.Generator,
    beside: Callable[[Array], Array] | None = None,
) -> list[Plan]:
    """A plan for each of b boundaries, with the same m designs; `baselines` are (1 or 3, b)."""
    X, weight = population(space, RADIAL, None, rng)[1:]
    z = np.array([of(X).T for of in boundaries])
    # Rows are the distribution itself, and are drawn by their weights; a sample is drawn as it comes.
    is_exact = isinstance(space, WeightedRows)
    shares = weight / weight.sum() if is_exact else np.full(len(X), 1.0 / len(X))
    parts = weight * doubt(z / WIDER).max(axis=0)
    parts = parts if beside is None else np.concatenate([parts, (weight * beside(X))[None]])
    if len(parts := parts[parts.sum(axis=1) > 0.0]):
        # The same for each boundary, however likely its outcome is.
        of_each = (1.0 - UNIFORM) / len(parts) * parts / parts.sum(axis=1, keepdims=True)
        shares = of_each.sum(axis=0) + UNIFORM * shares
    # A row without weight is never drawn.
    ratio = np.divide(weight, len(X) * shares, out=np.zeros(len(X)), where=shares > 0.0)

    def doubts(z: Array, deviation: float) -> tuple[Doubt, Doubt]:
        side = ndtr(z / (WIDER * deviation))
        in_doubt = np.minimum(side, 1.0 - side)

        def doubt_of(rows: NDArray[np.bool_]) -> Doubt:
            # The simulations are drawn from a population, which itself is a sample, unless it is the distribution.
            population_variance = 0.0 if is_exact else float(np.sum((weight**2 * in_doubt)[rows])) / len(X) ** 2
            return Doubt(float(np.sum((shares * ratio**2 * in_doubt)[rows])), population_variance)

        return doubt_of(z <= 0.0), doubt_of(z > 0.0)

    rows = rng.choice(len(X), m, p=shares / shares.sum())

    def plan(z: Array, share: OfBoundary) -> Plan:
        doubts_of = partial(doubts, z)
        numbers = share.probability, share.error
        return Plan(X[rows], ratio[rows], z[rows], *numbers, doubts_of, of=plan_of, drawn_from=(X, shares * ratio**2))

    def plan_of(boundary: Standardised, share: OfBoundary) -> Plan:
        return plan(boundary(X), share)

    learned, *ends = ([plan(*one) for one in zip(*of, strict=True)] for of in zip(z, baselines, strict=True))
    pairs = zip(*ends, strict=True) if ends else [None] * len(learned)
    return [replace(of, ends=pair) for of, pair in zip(learned, pairs, strict=True)]
