"""Curves whose numbers are known: capacities, the verified band, and the risk."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr, ndtri

from activefail.analyses.fragility.band import (
    NOT_VERIFIED,
    VerifiedLevel,
    as_rows,
    capacity_interval,
    levels_to_verify,
    verify,
)
from activefail.analyses.fragility.curve import Curve, Ladder, Rate, risk_of, why_not_fitted
from activefail.campaign.question import Question
from activefail.estimates.estimate import ProbabilityEstimate, plan_estimate
from activefail.estimates.probability_estimator import Sampled, error_of_rows
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows

MEDIAN, BETA = 1.2, 0.4
LADDER = Ladder("PGV", "m/s", 10.0 ** (np.arange(-24, 17) / 24.0), is_log=True)


def lognormal(levels: Array, median: float = MEDIAN, beta: float = BETA) -> Array:
    return np.asarray(ndtr(np.log(levels / median) / beta))


CURVE = Curve(LADDER, lognormal(LADDER.levels), 0.001)
FALLING = Curve(LADDER, 1.0 - CURVE.probability, 0.001)


def estimated(p: float, half: float, m: int = 30) -> ProbabilityEstimate:
    return ProbabilityEstimate(p, max(0.0, p - half), min(1.0, p + half), 0.95, 1.0, 1.0, m, 0, 3, 0, 0, "")


@pytest.mark.parametrize("p", [0.025, 0.1, 0.5])
def test_a_capacity_is_read_off_the_curve(p: float) -> None:
    assert CURVE.capacity(p).level == pytest.approx(MEDIAN * math.exp(BETA * ndtri(p)), rel=0.01)
    # A curve that falls is read from its upper end.
    assert FALLING.capacity(p).level == pytest.approx(MEDIAN * math.exp(-BETA * ndtri(p)), rel=0.01)


def test_a_curve_that_falls_back_has_the_capacity_of_its_first_rise() -> None:
    bump = CURVE.probability.copy()
    bump[10] = 0.2  # at 0.26 m/s
    curve = Curve(LADDER, bump, 0.001)
    level = curve.capacity(0.1).level
    assert level is not None
    assert LADDER.levels[9] < level < LADDER.levels[10]
    assert curve.fall is not None
    assert (curve.fall.start, curve.fall.size) == (pytest.approx(LADDER.levels[10]), pytest.approx(0.2, abs=0.01))
    assert CURVE.fall is None
    assert FALLING.fall is None
    assert Curve(LADDER, bump, 0.3).fall is None, "a fall within the resolution is none"


def test_a_capacity_that_the_ladder_does_not_reach_has_a_reason() -> None:
    low = Curve(LADDER, 0.04 * CURVE.probability, 0.001)
    assert low.capacity(0.1) == (None, "the curve stays below 10.0 % up to its last level, 4.64")
    high = Curve(LADDER, 0.9 + 0.1 * CURVE.probability, 0.001)
    assert high.capacity(0.1) == (None, "the curve already exceeds 10.0 % at its first level, 0.1")


def test_a_curve_without_a_median_is_not_fitted() -> None:
    low = Curve(LADDER, 0.04 * CURVE.probability, 0.001)
    assert why_not_fitted(low) == "the curve does not cover 10 % to 50 %"
    linear = Curve(Ladder("x", "", np.linspace(-1.0, 1.0, 5), is_log=False), np.linspace(0.0, 1.0, 5), 0.001)
    assert why_not_fitted(linear) == "some levels of the curve are not positive"


def test_the_risk_under_a_power_law_is_its_closed_form() -> None:
    slope, velocities = 2.0, np.array([0.3, 2.5])
    rates = 4e-4 * velocities**-slope
    risk = risk_of(CURVE, Rate(velocities, rates))

    def density(logarithm: float) -> float:
        return slope * 4e-4 * math.exp(-slope * logarithm) * float(ndtr((logarithm - math.log(MEDIAN)) / BETA))

    inside, _ = quad(density, math.log(0.3), math.log(2.5))
    below, _ = quad(density, math.log(0.01), math.log(0.3))
    expected = 4e-4 * MEDIAN**-slope * math.exp(0.5 * (slope * BETA) ** 2) - below
    assert risk.annual_rate == pytest.approx(expected, rel=0.005)
    assert risk.probability == pytest.approx(1.0 - math.exp(-50.0 * expected), rel=0.005)
    assert (risk.least, risk.at_least) == (0.3, pytest.approx(float(CURVE.at(0.3))))
    assert risk.share_outside_hazard_curve == pytest.approx(1.0 - inside / expected, abs=0.005)
    assert risk.share_above_fragility_curve == pytest.approx(4e-4 * LADDER.levels[-1] ** -slope / expected, rel=0.02)


def test_the_verified_levels_include_the_reported_capacities() -> None:
    levels = levels_to_verify(CURVE, 250)
    assert sum(size for _, size in levels) == 250
    assert len(levels) == 8
    assert [level for level, _ in levels] == sorted(level for level, _ in levels)
    for p in (0.025, 0.1, 0.5):
        assert CURVE.capacity(p).level in [level for level, _ in levels]
    assert [size for _, size in levels_to_verify(CURVE, 25)] == [12, 13]
    # A curve that hardly rises is verified at its last level.
    low = Curve(LADDER, 0.005 * CURVE.probability, 0.001)
    assert levels_to_verify(low, 25) == [(pytest.approx(LADDER.levels[-1]), 25)]
    assert [level for level, _ in levels_to_verify(FALLING, 250)] == sorted(
        (level for level, _ in levels_to_verify(FALLING, 250)), reverse=True
    )


@pytest.mark.parametrize("curve", [CURVE, FALLING])
def test_capacities_get_intervals_from_the_verified_band(curve: Curve) -> None:
    verified = tuple(
        VerifiedLevel(level, estimated(float(curve.at(level)) + 0.01, 0.03, size))
        for level, size in levels_to_verify(curve, 250)
    )
    for p in (0.1, 0.5):
        interval = capacity_interval(curve, verified, p)
        assert interval.interval_reason is None
        # The band is the curve moved by −0.02, 0.01 and 0.04.
        ends = sorted(level for move in (-0.02, 0.04) if (level := curve.capacity(p - move).level) is not None)
        assert [interval.low, interval.high] == pytest.approx(ends, rel=0.005)
        assert interval.verified == pytest.approx(curve.capacity(p - 0.01).level, rel=0.005)
    unknown = capacity_interval(curve, verified, 0.025)
    assert unknown.low is None or unknown.high is None
    assert unknown.interval_reason.startswith("the verified levels end at ")
    assert capacity_interval(curve, (), 0.1).interval_reason == NOT_VERIFIED
    assert capacity_interval(curve, verified[:1], 0.1).interval_reason == "only one level was verified"


def test_each_level_is_verified_by_simulations_of_its_own() -> None:
    space = DesignSpace((Parameter("x", 0.0, 1.0), Parameter("y", 0.0, 1.0)))
    asked: list[Question] = []

    def estimate(question: Question, size: int) -> ProbabilityEstimate:
        asked.append(question)
        return estimated(0.1, 0.05, size)

    levels = verify(CURVE, 100, lambda level: Question.of_space(space).at({"x": level}), estimate)
    assert [question.draw for question in asked] == [1, 2, 3]
    assert [question.fixed["x"] for question in asked] == [one.level for one in levels]
    assert len({question.digest for question in asked}) == 3


def test_sequences_stand_for_a_distribution() -> None:
    space = DesignSpace((Parameter("x", 0.1, 8.0, "", "lognormal", 1.0, 0.5), Parameter("y", 0.0, 1.0)))
    question = as_rows(Question.of_space(space))
    assert isinstance(question.space, WeightedRows)
    X = question.designs(question.space.X)
    assert X.shape == (2048, 2)
    assert float((X[:, 1] < 0.25).mean()) == pytest.approx(0.25, abs=0.001)
    assert as_rows(question) is question


def test_an_interval_includes_the_error_of_the_sequences() -> None:
    # A classifier that is always right leaves this error alone; it must cover the true probability, π/4.
    space = DesignSpace(tuple(Parameter(name, 0.0, 1.0) for name in "xyz"))

    def disc(X: Array) -> Array:
        return np.asarray(1e6 * (1.0 - X[:, 1] ** 2 - X[:, 2] ** 2))

    question = as_rows(Question.of_space(space).at({"x": 0.5}))
    assert isinstance(question.space, WeightedRows)
    rng = np.random.default_rng(0)
    plan = plan_estimate(lambda X: disc(question.designs(X)), question.space, 30, rng)
    right = Sampled(plan, plan.predicted, np.ones(30, dtype=bool), error=error_of_rows(disc, question)).estimate(0.95)
    assert right.low < math.pi / 4.0 < right.high
    assert 0.002 < right.high - right.low < 0.02
