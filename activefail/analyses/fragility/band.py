"""Levels of a curve that fresh simulations verify, and what they say about its capacities."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from activefail.analyses.fragility.curve import Curve, first_above
from activefail.analyses.stripes.findings import StripeFindings
from activefail.campaign.question import Question
from activefail.estimates.estimate import ProbabilityEstimate
from activefail.space.space import Array
from activefail.space.weighted import BLOCKS, WeightedRows

_TARGETS = (0.1, 0.025, 0.5, 0.05, 0.2, 0.01, 0.9, 0.35, 0.7)
"""Probabilities at which a curve is verified, the most important ones first; they include the reported capacities."""

_PER_LEVEL = 30
"""Simulations for which one more level is verified."""

LEAST = 20
"""Least number of simulations of a verification."""

_POINTS = {1: 128}
_MORE_POINTS = 256
"""Points of each Sobol' sequence for one, or more, variables, where a distribution is verified."""

_STEPS = 400
"""Steps in which a band is read."""


class VerifiedLevel(NamedTuple):
    """A level with the probability from simulations, whose interval is for this level alone."""

    level: float
    estimate: ProbabilityEstimate | StripeFindings


class Interval(NamedTuple):
    """What a verified band says about a capacity; None where it is unknown, for a reason."""

    verified: float | None = None  # where the corrected curve first exceeds the probability
    low: float | None = None  # where the ends of the band do
    high: float | None = None
    confidence: float | None = None  # of the band at each level
    interval_reason: str | None = None


NOT_VERIFIED = "not verified by simulations"


def levels_to_verify(curve: Curve, simulations: int) -> list[tuple[float, int]]:
    """The levels that are verified, from the curve's safe end, with the number of simulations at each.

    The levels are where the curve reaches 1 to 90 %, so that they include the capacities. A curve that stays below is
    verified at its last level too.
    """
    levels = _levels(curve, max(2, min(len(_TARGETS), simulations // _PER_LEVEL)))
    least, rest = divmod(simulations, len(levels))
    sizes = {level: least + (place < rest) for place, level in enumerate(levels)}
    return [(level, sizes[level]) for level in sorted(levels, reverse=not curve.rises)]


def _levels(curve: Curve, count: int) -> list[float]:
    """At most so many levels to verify, the most important ones first."""
    levels = [level for p in _TARGETS if (level := curve.capacity(p).level) is not None]
    if len(levels) < 2:
        levels.append(float(curve.ladder.levels[-1 if curve.rises else 0]))
    return list(dict.fromkeys(levels))[:count]


def as_rows(question: Question) -> Question:
    """A question whose distribution is that of 8 Sobol' sequences, in their order.

    The integral of the classifier is then a sum, much cheaper than the adaptive integration that rare failure needs.
    """
    distribution = question.space
    if isinstance(distribution, WeightedRows):
        return question
    n = _POINTS.get(distribution.dimension, _MORE_POINTS)
    X = np.concatenate([distribution.sobol(n, np.random.default_rng(number)) for number in range(BLOCKS)])
    return replace(question, space=WeightedRows(distribution.names, X, np.ones(len(X)), is_sample=True), is_own=False)


QuestionAt = Callable[[float], Question]
"""The question at a level."""


def verify(
    curve: Curve,
    simulations: int,
    question_at_level: QuestionAt,
    estimate: Callable[[Question, int], ProbabilityEstimate],
) -> tuple[VerifiedLevel, ...]:
    """Verify a curve at several levels by fresh simulations.

    Args:
        curve: the classifier's.
        simulations: number of fresh simulations at all levels together.
        question_at_level: the question at a level.
        estimate: the estimate of a question from so many fresh simulations.
    """
    levels, sizes = zip(*levels_to_verify(curve, simulations), strict=True)
    questions = _drawn(levels, question_at_level)
    return tuple(VerifiedLevel(level, estimate(one, n)) for (level, one), n in zip(questions, sizes, strict=True))


def stored(
    curve: Curve, question_at_level: QuestionAt, estimate: Callable[[Question], ProbabilityEstimate | None]
) -> tuple[VerifiedLevel, ...]:
    """The levels that `verify` has verified before, from stored simulations; of several, the most levels.

    Args:
        curve, question_at_level: as for `verify`.
        estimate: the estimate of a question from stored simulations; None if there are none.
    """
    for count in range(len(_TARGETS), 1, -1):
        levels = []
        for level, question in _drawn(sorted(_levels(curve, count), reverse=not curve.rises), question_at_level):
            if (verified := estimate(question)) is None:
                break
            levels.append(VerifiedLevel(level, verified))
        else:
            return tuple(levels)
    return ()


def _drawn(levels: Sequence[float], question_at_level: QuestionAt) -> Iterator[tuple[float, Question]]:
    """The levels with the questions that verify them, each of which has pulses of its own."""
    for draw, level in enumerate(levels, start=1):
        yield level, as_rows(question_at_level(level)).drawn(draw)


def capacity_interval(curve: Curve, verified: tuple[VerifiedLevel, ...], p: float) -> Interval:
    """Where the verified band first exceeds a probability.

    Between the verified levels the band follows the classifier's curve, with its corrections interpolated. It is
    pointwise: each level's interval has its confidence by itself.

    Args:
        curve: the classifier's.
        verified: from the curve's safe end.
        p: the probability of the capacity.
    """
    if not verified:
        return Interval(interval_reason=NOT_VERIFIED)
    confidence = verified[0].estimate.confidence
    if len(verified) < 2:
        return Interval(confidence=confidence, interval_reason="only one level was verified")
    coordinates = curve.ladder.coordinate(np.array([one.level for one in verified]))
    between = np.unique(np.concatenate([np.linspace(coordinates[0], coordinates[-1], _STEPS), coordinates]))
    if curve.ladder.in_steps:
        between = curve.ladder.coordinate(curve.ladder.levels)
        between = between[(between >= coordinates.min()) & (between <= coordinates.max())]
    along = between if curve.rises else between[::-1]
    sign = 1.0 if curve.rises else -1.0
    levels = np.exp(along) if curve.ladder.is_log else along
    predicted = curve.at(np.array([one.level for one in verified]))

    def first(values: list[float]) -> float | None:
        corrections = np.interp(sign * along, sign * coordinates, np.array(values) - predicted)
        band: Array = np.clip(curve.at(levels) + corrections, 0.0, 1.0)
        crossing = first_above(along, band, p)
        if crossing is not None and curve.ladder.in_steps:
            crossing = float(along[np.argmax(band > p)])
        return None if crossing is None else curve.ladder.level(crossing)

    middle = first([one.estimate.probability for one in verified])
    ends = [first([getattr(one.estimate, end) for one in verified]) for end in ("high", "low")]
    low, high = ends if curve.rises else ends[::-1]
    reason = None
    if low is None or high is None:
        least, most = sorted((verified[0].level, verified[-1].level))
        reason = f"the verified levels end at {least:.3g} and {most:.3g}, before the band reaches this probability"
    return Interval(middle, low, high, confidence, reason)
