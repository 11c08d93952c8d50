"""A failure probability and its interval from fresh simulations drawn by importance, with the classifier frozen.

The classifier's own probability is corrected by simulations that it has not seen. They are drawn where it may be wrong
and where a mistake would weigh most (importance sampling of its mistakes), so that the estimate has no bias, whatever
the classifier believes. The interval holds because of four precautions. The standard deviation of the latent is
doubled where designs are drawn: kinks of the limit state make it too small. The variance of the corrections has a floor
from the classifier's own doubt: few or no observed mistakes do not mean that there are none. If the margins of the
fresh simulations lie farther from their predictions than the latent says, this doubt grows in proportion. And the
campaign's mode check comes before.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import t

from activefail.acquisition.by_margin import doubt
from activefail.acquisition.population import finite, population
from activefail.features import FeatureMap
from activefail.reliability.hidden import ModeCheck
from activefail.reliability.integral import Boundaries, Standardised, integrate
from activefail.space import REACH, Array, DesignSpace
from activefail.surrogate.margin import MarginLatent
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

_WIDER = 2.0
"""Factor of the latent's standard deviation."""

_FARTHEST = 1e6
"""Largest deviation of a fresh margin that counts, in standard deviations."""

_PRIOR_WEIGHT = 16.0
"""Weight of the classifier's own doubt in the variance of the corrections, in simulations."""

_ACCURACY = 0.01
"""Relative standard error of the baseline of a plan."""

_IMAGINED = 32
"""Imagined sets of outcomes that predict the width of an interval."""


class Baseline(NamedTuple):
    """The share of a distribution for which a classifier predicts an outcome, which fresh simulations correct.

    It counts predictions. `integral.integrate` gives the classifier's probability, the mean of its probabilities.

    Attributes:
        probability: the share.
        standard_error: of its integration.
    """

    probability: float
    standard_error: float


class Doubt(NamedTuple):
    """How wrong the classifier may be on one side of the boundary, by its own doubt.

    Attributes:
        floor: variance of one correction.
        of_population: variance of the mean correction due to the population from which the designs were drawn.
    """

    floor: float
    of_population: float


@dataclass(frozen=True)
class Plan:
    """Fresh designs that correct a classifier's failure probability.

    Attributes:
        designs: (m, d).
        ratio: (m,) density of the design measure over that of the draws.
        predicted: (m,) bool, whether the classifier puts each design beyond the boundary.
        standardised: (m,) the latent's mean/sd.
        probability: the baseline, the share of predictions beyond.
        standard_error: of its integration.
        missed, false: of the designs that the classifier puts short of the boundary, and beyond it.
        doubts: both if the latent's standard deviations are larger by a factor; None if no doubt is left.
        deviation: of the margins of the fresh simulations from their predictions (see `deviation_of_margins`).
        ends: the same designs as corrections of two other boundaries: where no run that is probably lost is beyond, and
            where all are; None if none is probably lost.
    """

    designs: Array
    ratio: Array
    predicted: NDArray[np.bool_]
    standardised: Array
    probability: float
    standard_error: float
    missed: Doubt
    false: Doubt
    doubts: Callable[[float], tuple[Doubt, Doubt]] | None = None
    deviation: float = 1.0
    ends: "tuple[Plan, Plan] | None" = None

    def deviating(self, deviation: float) -> "Plan":
        """The plan after the fresh margins showed how far they lie from their predictions.

        If they lie farther than the latent's standard deviations say, the classifier's doubt grows in proportion.
        """
        if self.doubts is None or not deviation > 1.0:
            return self
        missed, false = self.doubts(deviation)
        ends = None if self.ends is None else (self.ends[0].deviating(deviation), self.ends[1].deviating(deviation))
        return replace(self, missed=missed, false=false, deviation=deviation, ends=ends)

    @property
    def surest(self) -> tuple[int, float]:
        """Simulations that would meet failure where the classifier is sure, and the share that each may stand for.

        A part of them is drawn without regard to the classifier's doubt.
        """
        return len(self.designs), 1.0 / UNIFORM

    def estimate(
        self, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float
    ) -> "ProbabilityEstimate":
        """The estimate from the outcomes of the simulations.

        Args:
            beyond: (m,) whether each outcome is beyond the boundary.
            answered: (m,) whether each simulation gave an outcome; the interval covers both outcomes of the others.
            confidence: of the interval.
        """
        middle, _, _ = _interval(self, np.where(answered, beyond, self.predicted), confidence)
        if_none, if_all = self.ends or (self, self)
        _, low, _ = _interval(if_none, beyond & answered, confidence)
        _, _, high = _interval(if_all, beyond | ~answered, confidence)
        wrong = answered & (beyond != self.predicted)
        recall, recall_low = _recall(self, beyond, answered, confidence)
        return ProbabilityEstimate(
            probability=min(1.0, max(0.0, middle)),
            low=min(1.0, max(0.0, min(low, middle))),
            # No design is drawn farther out; all of them may fail.
            high=min(1.0, max(0.0, high, middle) + REACH),
            confidence=confidence,
            simulations=len(beyond),
            unanswered=int((~answered).sum()),
            beyond=int((beyond & answered).sum()),
            wrong=int(wrong.sum()),
            surprising=int((wrong & (np.abs(self.standardised) > SURE)).sum()),
            recall=recall,
            recall_low=recall_low,
            deviation=self.deviation,
        )

    def expected_half_width(self, confidence: float, rng: np.random.Generator) -> float:
        """Expected distance from the estimate to its upper bound, if the classifier's own probabilities are right."""
        likely = ndtr(self.standardised)
        widths = []
        for _ in range(_IMAGINED):
            beyond = rng.random(len(likely)) < likely
            middle, _, high = _interval(self, beyond, confidence)
            if self.ends is not None:
                # Where a run is probably lost, it counts as beyond.
                _, _, high = _interval(self.ends[1], beyond | self.ends[1].predicted, confidence)
            widths.append(high - middle)
        return float(np.mean(widths))


@dataclass(frozen=True)
class ProbabilityEstimate:
    """A failure probability with its interval.

    Attributes:
        probability: the estimate, at least 0.
        low, high: two-sided interval, with equal tails; `high` includes the probability `space.REACH` that no design
            reaches.
        confidence: of the interval.
        simulations: fresh simulations, including numerical failures.
        unanswered: numerical failures among them. The interval covers both outcomes that they may have had.
        beyond: how many of the fresh simulations ended beyond the boundary.
        wrong: how many contradict the classifier.
        surprising: how many of these lie where the classifier was sure, by four standard deviations.
        recall: share of the failure probability that the classifier puts beyond the boundary; NaN without failure.
        recall_low: lower end of its one-sided interval, with `confidence`.
        method: how the fresh simulations were drawn.
        deviation: of the margins of the fresh simulations (see `deviation_of_margins`); 1 without margins.
        check: of a question; None if none was made.
    """

    probability: float
    low: float
    high: float
    confidence: float
    simulations: int
    unanswered: int
    beyond: int
    wrong: int
    surprising: int
    recall: float
    recall_low: float
    method: str = "importance sampling of the classifier's mistakes"
    deviation: float = 1.0
    check: ModeCheck | None = None

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


def deviation_of_margins(latent: MarginLatent, features: FeatureMap, designs: Array, margin: Array) -> float:
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


def baseline(standardised: Standardised, space: DesignSpace | WeightedRows) -> Baseline:
    """The share of a distribution for which a boundary is predicted to be crossed."""
    return _baselines(lambda X: standardised(X)[:, None], space)[0]


def _baselines(boundaries: Boundaries, space: DesignSpace | WeightedRows) -> list[Baseline]:
    integral = integrate(lambda X: np.where(boundaries(X) > 0.0, np.inf, -np.inf), space, accuracy=_ACCURACY)
    return [Baseline(*map(float, pair)) for pair in zip(integral.probability, integral.error, strict=True)]


def plan_estimate(
    standardised: Standardised,
    space: DesignSpace | WeightedRows,
    of_classifier: Baseline,
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
    drawn = population(space, RADIAL, None, rng)
    z = standardised(drawn.X)[None, None]
    return _planned(drawn.X, drawn.weight, z, [[of_classifier]], m, rng, isinstance(space, WeightedRows))[0]


def plan_estimates(
    boundaries: Sequence[Boundaries], space: DesignSpace | WeightedRows, m: int, rng: np.random.Generator
) -> list[Plan]:
    """Plan m fresh simulations that correct the baselines of all b boundaries.

    Args:
        boundaries: as learned; followed by those if none, and all, of the runs that are probably lost are beyond, if
            any is.
        space: the distribution.
        m: number of simulations.
        rng: draws them.
    """
    drawn = population(space, RADIAL, None, rng)
    z = np.array([of(drawn.X).T for of in boundaries])
    shares = [_baselines(of, space) for of in boundaries]
    return _planned(drawn.X, drawn.weight, z, shares, m, rng, isinstance(space, WeightedRows))


def _planned(
    X: Array,
    weight: Array,
    z: Array,
    baselines: Sequence[Sequence[Baseline]],
    m: int,
    rng: np.random.Generator,
    is_exact: bool,
) -> list[Plan]:
    """A plan for each boundary with the same m designs of a weighted sample, or of an exact distribution.

    Args:
        X: (n, d) the sample.
        weight: (n,) density of the design measure over that of the sample.
        z: (1 or 3, b, n) the boundaries there (see `plan_estimates`).
        baselines: (1 or 3, b).
        m: number of simulations.
        rng: draws them.
        is_exact: whether the rows are the distribution itself, by their weights.
    """
    # Without regard to doubt: a sample is drawn as it comes, weighted rows by their weights.
    shares = weight / weight.sum() if is_exact else np.full(len(X), 1.0 / len(X))
    parts = weight * doubt(z / _WIDER).max(axis=0)
    if len(parts := parts[parts.sum(axis=1) > 0.0]):
        # The same for each boundary, however likely its outcome is.
        of_each = (1.0 - UNIFORM) / len(parts) * parts / parts.sum(axis=1, keepdims=True)
        shares = of_each.sum(axis=0) + UNIFORM * shares
    # A row without weight is never drawn.
    ratio = np.divide(weight, len(X) * shares, out=np.zeros(len(X)), where=shares > 0.0)

    def doubts(z: Array, deviation: float) -> tuple[Doubt, Doubt]:
        side = ndtr(z / (_WIDER * deviation))
        in_doubt = np.minimum(side, 1.0 - side)

        def doubt_of(rows: NDArray[np.bool_]) -> Doubt:
            # The simulations are drawn from a population, which itself is a sample, unless it is the distribution.
            population_variance = 0.0 if is_exact else float(np.sum((weight**2 * in_doubt)[rows])) / len(X) ** 2
            return Doubt(float(np.sum((shares * ratio**2 * in_doubt)[rows])), population_variance)

        return doubt_of(z <= 0.0), doubt_of(z > 0.0)

    rows = rng.choice(len(X), m, p=shares / shares.sum())

    def plan(z: Array, share: Baseline) -> Plan:
        missed, false = doubts(z, 1.0)
        return Plan(
            designs=X[rows],
            ratio=ratio[rows],
            predicted=z[rows] > 0.0,
            standardised=z[rows],
            probability=share.probability,
            standard_error=share.standard_error,
            missed=missed,
            false=false,
            doubts=partial(doubts, z),
        )

    learned, *ends = ([plan(*one) for one in zip(*of, strict=True)] for of in zip(z, baselines, strict=True))
    pairs = zip(*ends, strict=True) if ends else [None] * len(learned)
    return [replace(of, ends=pair) for of, pair in zip(learned, pairs, strict=True)]


def _recall(
    plan: Plan, beyond: NDArray[np.bool_], answered: NDArray[np.bool_], confidence: float
) -> tuple[float, float]:
    """The share of the failure probability that the classifier puts beyond the boundary, and its lower bound.

    Three bounds enter the lower one: of the probability that is missed, of the one that is wrongly counted, and of the
    integral. Each errs a third as often as the lower bound may. Numerical failures are missed, or wrongly counted.
    """
    one_sided = 1.0 - (1.0 - confidence) / 3.0
    missed = float((answered & beyond & ~plan.predicted) @ plan.ratio) / len(beyond)
    false = float((answered & ~beyond & plan.predicted) @ plan.ratio) / len(beyond)
    missed_high = _upper(~plan.predicted & (beyond | ~answered), plan, plan.missed, one_sided) + REACH
    false_high = _upper(plan.predicted & ~(beyond & answered), plan, plan.false, one_sided)
    of_integral = float(t.ppf(one_sided, len(beyond) - 1)) * plan.standard_error
    hit, hit_low = max(0.0, plan.probability - false), max(0.0, plan.probability - false_high - of_integral)
    if hit + missed <= 0.0:
        return float("nan"), 0.0
    return hit / (hit + missed), hit_low / (hit_low + missed_high)


def _upper(wrong: NDArray[np.bool_], plan: Plan, doubt: Doubt, one_sided: float) -> float:
    """One-sided upper bound on the probability of what is wrong, from the rows of the plan that are."""
    corrections = wrong * plan.ratio
    variance = _variance(corrections, doubt.floor) / len(wrong) + doubt.of_population
    return float(corrections.mean()) + float(t.ppf(one_sided, len(wrong) - 1)) * float(np.sqrt(variance))


def _variance(corrections: Array, floor: float) -> float:
    """Variance of one correction, with a floor that counts as `_PRIOR_WEIGHT` observations."""
    m = len(corrections)
    return float(m * corrections.var(ddof=1) + _PRIOR_WEIGHT * floor) / (m + _PRIOR_WEIGHT)


def _interval(plan: Plan, beyond: NDArray[np.bool_], confidence: float) -> tuple[float, float, float]:
    corrections = (beyond.astype(np.float64) - plan.predicted) * plan.ratio
    m = len(corrections)
    middle = plan.probability + float(corrections.mean())
    variance = _variance(corrections, plan.missed.floor + plan.false.floor) / m
    variance += plan.standard_error**2 + plan.missed.of_population + plan.false.of_population
    half = float(t.ppf(0.5 + 0.5 * confidence, m - 1)) * float(np.sqrt(variance))
    return middle, middle - half, middle + half
