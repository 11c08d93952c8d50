"""A sceptical plan: an interval that covers, also with a classifier that is far too sure."""

import numpy as np
import pytest
from cases import some
from numpy.typing import NDArray
from scipy.stats import norm

from activefail.estimates.estimate import Plan, plan_estimate, plan_estimates
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows

SPACE = DesignSpace(tuple(Parameter(name, -6.4, 6.4, "", "normal", 0.0, 1.0) for name in "uv"))
LIMIT = 1.28


def fails(X: Array) -> NDArray[np.bool_]:
    """Failure beyond a wavy line, of about 10 %."""
    return np.asarray(X[:, 0] + 0.15 * np.sin(6.0 * X[:, 1]) > LIMIT)


def latent(sd: float):
    return lambda X: (X[:, 0] - LIMIT) / sd


def plan_of(sd: float, m: int, seed: int, space: DesignSpace | WeightedRows = SPACE) -> Plan:
    return plan_estimate(latent(sd), space, m, np.random.default_rng(seed), sceptical=True)


def all_answered(plan: Plan) -> NDArray[np.bool_]:
    return np.ones(len(plan.designs), dtype=bool)


TRUE = float(fails(SPACE.from_unit(np.random.default_rng(0).random((400_000, 2)))).mean())

SURE = {"too sure": 0.02, "right": 0.12, "unsure": 0.5}
"""Standard deviations of classifiers."""


@pytest.fixture(scope="module")
def hit() -> float:
    """The probability of a failure that they predict: all have the same boundary."""
    X = SPACE.from_unit(np.random.default_rng(1).random((400_000, 2)))
    return float((fails(X) & (X[:, 0] > LIMIT)).mean())


CASES = [(30, "too sure"), (30, "right"), (30, "unsure"), (250, "too sure"), (250, "right"), (250, "unsure")]


@pytest.mark.parametrize(("m", "sure"), some(CASES, (30, "too sure"), (30, "unsure"), (250, "right")))
def test_intervals_cover_and_the_estimate_has_no_bias(m: int, sure: str, hit: float) -> None:
    covered, middles, recalls = 0, [], 0
    for seed in range(60):
        plan = plan_of(SURE[sure], m, seed)
        estimate = plan.estimate(fails(plan.designs), all_answered(plan), 0.9)
        assert estimate.low <= estimate.probability <= estimate.high
        covered += estimate.low <= TRUE <= estimate.high
        middles.append(estimate.probability)
        recalls += estimate.recall_low <= hit / TRUE
    # Nominal 54 of 60; fewer than 48 have a chance of 0.3 %.
    assert covered >= 48
    assert recalls >= 48
    assert np.mean(middles) == pytest.approx(TRUE, abs=3.5 * np.std(middles) / np.sqrt(60.0) + 1e-3)


def test_hidden_failure_where_the_classifier_is_sure_is_within_the_bound_more_often_than_not() -> None:
    def with_islands(X: Array) -> NDArray[np.bool_]:
        cells = np.floor(20.0 * X).astype(np.int64)
        return fails(X) | ((cells[:, 0] * 7919 + cells[:, 1] * 104729) % 1000 < 10)

    true = float(with_islands(SPACE.from_unit(np.random.default_rng(2).random((400_000, 2)))).mean())
    plans = [plan_of(0.12, 300, seed) for seed in range(120)]
    highs = [plan.estimate(with_islands(plan.designs), all_answered(plan), 0.92).high for plan in plans]
    assert np.mean(np.array(highs) >= true) > 0.8


def test_a_classifier_that_is_wrong_where_it_predicts_failure_does_not_raise_the_lower_end() -> None:
    P, above = float(norm.sf(2.0)), []
    for seed in range(100):
        # It puts half of the distribution beyond the boundary, in doubt nearly everywhere.
        plan = plan_estimate(lambda X: X[:, 0] / 2.0, SPACE, 50, np.random.default_rng(seed), sceptical=True)
        above.append(plan.estimate(plan.designs[:, 0] > 2.0, all_answered(plan), 0.9).low > P)
    assert np.mean(above) <= 0.12


def test_half_of_the_simulations_are_drawn_by_the_distribution_alone() -> None:
    plan = plan_of(0.01, 200, 0)
    sure = plan.standardised < -10.0
    share = float(norm.cdf(LIMIT - 0.1))
    assert sure.sum() == pytest.approx(0.5 * 200 * share, abs=3.0)
    assert plan.surest == (pytest.approx(200, abs=5), pytest.approx(2.0, rel=0.05))
    assert plan.probability == pytest.approx(norm.sf(LIMIT), rel=0.02)


@pytest.mark.parametrize(("simulations", "share"), [(100, 0.7), (200, 0.35), (400, 0.3)])
def test_as_many_as_stated_are_drawn_without_regard_to_the_classifier(simulations: int, share: float) -> None:
    boundaries = [lambda X: latent(0.01)(X)[:, None]]
    plan = plan_estimates(boundaries, SPACE, simulations, np.random.default_rng(0), unguided=70)[0]
    sure = plan.standardised < -10.0
    assert sure.sum() == pytest.approx(share * simulations * float(norm.cdf(LIMIT - 0.1)), abs=4.0)


def test_no_design_of_a_space_is_drawn_twice_even_if_few_are_in_doubt() -> None:
    plan = plan_of(0.0005, 900, 0)
    assert len(np.unique(plan.designs, axis=0)) == len(plan.designs) == 900


def test_what_gave_no_outcome_widens_the_interval_to_both_sides() -> None:
    plan = plan_of(0.12, 60, 0)
    beyond, answered = fails(plan.designs), all_answered(plan)
    full = plan.estimate(beyond, answered, 0.9)
    answered[::4] = False
    partial = plan.estimate(beyond & answered, answered, 0.9)
    assert partial.low < full.low
    assert full.high < partial.high
    assert (partial.unanswered, partial.simulations) == (15, 60)
    assert partial.recall_low < full.recall_low


def test_without_a_wrong_prediction_the_interval_keeps_a_width_that_falls_with_the_simulations() -> None:
    widths = []
    for m in (30, 120, 480):
        plan = plan_of(0.12, m, 0)
        estimate = plan.estimate(plan.predicted, all_answered(plan), 0.9)
        assert estimate.probability == pytest.approx(plan.probability, abs=1e-3)
        assert estimate.contradictions == 0
        widths.append(estimate.high - estimate.low)
    assert widths[0] > 1.5 * widths[1] > 2.0 * widths[2] > 0.0


def test_weighted_rows_are_drawn_by_their_weights() -> None:
    rng = np.random.default_rng(3)
    X, weight = rng.normal(size=(3000, 2)), rng.exponential(size=3000)
    rows = WeightedRows(("u", "v"), X, weight)
    true = float((rows.weight * fails(X)).mean())
    covered, middles = 0, []
    for seed in range(60):
        plan = plan_of(0.12, 100, seed, rows)
        assert plan.standard_error == 0.0
        assert len(np.unique(plan.designs, axis=0)) == 100
        estimate = plan.estimate(fails(plan.designs), all_answered(plan), 0.9)
        covered += estimate.low <= true <= estimate.high
        middles.append(estimate.probability)
    assert covered >= 48
    assert np.mean(middles) == pytest.approx(true, abs=3.5 * np.std(middles) / np.sqrt(60.0))


def rare_latent(probability: float):
    return lambda X: (X[:, 0] - norm.isf(probability)) / 0.05


@pytest.mark.parametrize("probability", some([0.009, 0.003], 0.003))
def test_hidden_failure_is_within_the_bound_of_a_rare_outcome_where_a_trusting_plan_misses_it(
    probability: float,
) -> None:
    of, limit = rare_latent(probability), norm.isf(probability)

    def with_islands(X: Array) -> NDArray[np.bool_]:
        # A fifth of the probability, scattered where the classifier is sure of survival.
        cells = np.floor(20.0 * X).astype(np.int64)
        return np.asarray((X[:, 0] > limit) | ((cells[:, 0] * 7919 + cells[:, 1] * 104729) % 5000 < 1000 * probability))

    true = float(with_islands(SPACE.from_unit(np.random.default_rng(0).random((1_000_000, 2)))).mean())
    assert 1.1 * probability < true < 1.4 * probability
    held = {True: 0, False: 0}
    for seed in range(25):
        for sceptical in held:
            plan = plan_estimate(of, SPACE, 250, np.random.default_rng(seed), sceptical=sceptical)
            found = plan.estimate(with_islands(plan.designs), all_answered(plan), 0.9)
            held[sceptical] += found.high >= true
    assert held[True] >= 22
    assert held[False] <= 12


def test_the_rarer_an_outcome_the_less_its_interval_allows_for_unseen_failures() -> None:
    over = []
    for probability in (0.011, 0.009, 0.002, 1e-4):
        plan = plan_estimate(rare_latent(probability), SPACE, 300, np.random.default_rng(3), sceptical=True)
        over.append(plan.estimate(plan.predicted, all_answered(plan), 0.9).high / probability)
    assert over[1] == pytest.approx(over[0], rel=0.2)
    assert 1.1 < over[2] < 1.3 * over[0]
    assert 1.0 < over[3] < 1.1


def test_the_expected_width_is_that_of_intervals_if_the_classifier_is_right() -> None:
    plan = plan_of(0.2, 250, 0)
    rng = np.random.default_rng(1)
    widths = []
    for _ in range(40):
        beyond = np.asarray(rng.random(250) < norm.cdf(plan.standardised))
        estimate = plan.estimate(beyond, all_answered(plan), 0.9)
        widths.append(estimate.high - estimate.probability)
    assert plan.expected_half_width(0.9, rng) == pytest.approx(np.mean(widths), rel=0.1)
