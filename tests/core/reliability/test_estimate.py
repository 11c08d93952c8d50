"""The estimate with a frozen classifier: no bias, and an interval that covers, whatever the classifier missed."""

import numpy as np
import pytest
from rare import four_branch
from scipy.special import ndtr
from scipy.stats import norm

from activefail.estimates.estimate import (
    UNIFORM,
    Doubt,
    Plan,
    baseline,
    deviation_of_margins,
    plan_estimate,
)
from activefail.estimates.integral import Standardised, boundary_of
from activefail.learning.features import feature_map
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SPACE = DesignSpace(tuple(Parameter(name, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for name in ("x", "y")))
FEATURES = feature_map("design", SPACE)
PROBABILITY = 2.2225e-3


def trained(limit, n: int, seed: int) -> MarginLatent:
    rng = np.random.default_rng(seed)
    # Twice as wide as the design measure, so that some designs fail.
    X = np.clip(2.0 * SPACE.latin_hypercube(n, rng), -6.4, 6.4)
    return MarginLatent(fit_margin(FEATURES(X), limit(X)))


def boundary(latent: MarginLatent) -> Standardised:
    return boundary_of(Classifier(("safe", "failure"), FEATURES, (latent,)), FEATURES, "failure")


def planned(latent: MarginLatent, m: int, seed: int) -> Plan:
    standardised = boundary(latent)
    return plan_estimate(standardised, SPACE, m, np.random.default_rng(seed))


def plane(X):
    return 3.0 - X[:, 0]


def test_the_predicted_share_is_integrated_as_accurately_as_asked_with_points_of_its_own() -> None:
    standardised = boundary(trained(plane, 15, 0))
    found = [
        baseline(lambda X: standardised(X)[:, None], SPACE, 0.01, np.random.default_rng(seed)).of(0)
        for seed in range(12)
    ]
    probability, error = np.array([(one.probability, one.error) for one in found]).T
    assert (error < 0.01 * probability).all()
    assert probability.mean() == pytest.approx(ndtr(-3.0), rel=0.04)
    # The points differ, as much as the standard errors say.
    assert 0.4 < probability.std(ddof=1) / error.mean() < 1.8


@pytest.mark.exhaustive
def test_intervals_cover_and_the_estimate_has_no_bias_though_the_classifier_is_wrong() -> None:
    # Thirty designs leave a classifier of the four branches wrong by tens of per cent.
    latents = [trained(four_branch, 30, seed) for seed in range(3)]
    errors, covered, models = [], [], []
    for seed in range(24):
        plan = planned(latents[seed % 3], 50, 100 + seed)
        estimate = plan.estimate(four_branch(plan.designs) <= 0.0, np.ones(50, dtype=bool), 0.9)
        assert estimate.low <= estimate.probability <= estimate.high
        errors.append(estimate.probability / PROBABILITY - 1.0)
        covered.append(estimate.low <= PROBABILITY <= estimate.high)
        models.append(abs(plan.probability / PROBABILITY - 1.0))
    assert np.median(models) > 0.05
    assert abs(np.mean(errors)) < 3.0 * np.std(errors) / np.sqrt(len(errors)) + 0.02
    assert np.mean(covered) > 0.8


@pytest.mark.exhaustive
def test_the_interval_of_an_exact_classifier_is_that_of_its_integration() -> None:
    widths, covered = [], 0
    for seed in range(12):
        plan = plan_estimate(lambda X: -1e3 * four_branch(X), SPACE, 50, np.random.default_rng(seed))
        estimate = plan.estimate(plan.predicted, np.ones(50, dtype=bool), 0.9)
        covered += estimate.low <= PROBABILITY <= estimate.high
        widths.append(estimate.high - estimate.low)
    # Nominal 10.8 of 12; fewer than 9 have a chance of 3 %.
    assert covered >= 9
    assert np.median(widths) < 0.03 * PROBABILITY


def test_a_doubt_so_small_that_its_powers_underflow_adds_nothing() -> None:
    plan = plan_estimate(lambda X: np.where(X[:, 0] > 2.0, 70.0, -70.0), SPACE, 50, np.random.default_rng(0))
    estimate = plan.estimate(plan.predicted, np.ones(50, dtype=bool), 0.9)
    assert (estimate.low, estimate.high) == pytest.approx((norm.sf(2.0), norm.sf(2.0)), rel=0.01)


def test_the_interval_is_not_narrow_because_no_mistake_was_seen() -> None:
    plan = planned(trained(four_branch, 30, 1), 20, 1)
    same = plan.estimate(plan.predicted, np.ones(20, dtype=bool), 0.9)
    assert same.contradictions == 0
    assert same.probability == pytest.approx(plan.probability)
    assert same.high - same.low > 3.0 * plan.standard_error


def test_numerical_failures_widen_the_interval_to_both_outcomes_that_they_may_have_had() -> None:
    plan = planned(trained(four_branch, 30, 1), 40, 1)
    beyond, answered = four_branch(plan.designs) <= 0.0, np.ones(40, dtype=bool)
    full = plan.estimate(beyond, answered, 0.9)
    answered[np.flatnonzero(beyond)[:2]] = False
    answered[np.flatnonzero(~beyond)[:2]] = False
    partial = plan.estimate(beyond, answered, 0.9)
    assert partial.unanswered == 4
    assert partial.low <= full.low
    assert partial.high >= full.high
    assert partial.beyond == full.beyond - 2


def test_margins_that_deviate_from_their_predictions_widen_the_interval() -> None:
    latent = trained(four_branch, 30, 1)
    plan = planned(latent, 40, 1)
    moments = latent.moments(FEATURES(plan.designs))

    def shifted(deviations: float) -> np.ndarray:
        warped = -moments.mean - deviations * moments.sd
        unwarped = {"none": warped, "asinh": np.sinh(warped), "asinh5": np.sinh(warped) / 5.0}
        return latent.trained.data.unit * unwarped[latent.trained.data.warping]

    def deviation(margin: np.ndarray) -> float:
        return deviation_of_margins(latent, FEATURES, plan.designs, margin)

    assert deviation(shifted(0.2)) == 1.0
    assert deviation(shifted(3.0)) == pytest.approx(3.0)
    # Undefined margins do not count; without any margin nothing deviates.
    assert deviation(np.where(np.arange(40) < 39, np.nan, shifted(3.0))) == pytest.approx(3.0)
    assert deviation(np.full(40, np.nan)) == 1.0
    answered = np.ones(40, dtype=bool)
    plain, wider = (one.estimate(plan.predicted, answered, 0.9) for one in (plan, plan.deviating(3.0)))
    assert (plain.deviation, wider.deviation) == (1.0, 3.0)
    assert wider.probability == plain.probability
    assert wider.low <= plain.low
    assert wider.high > plain.high
    assert wider.recall_low < plain.recall_low


def test_near_one_nothing_exceeds_one() -> None:
    latent = trained(lambda X: X[:, 0] - 4.0, 20, 2)
    plan = planned(latent, 20, 3)
    estimate = plan.estimate(plan.designs[:, 0] <= 4.0, np.ones(20, dtype=bool), 0.9)
    assert 0.9 < estimate.low <= estimate.probability <= estimate.high <= 1.0


def test_a_contradiction_where_the_classifier_was_sure_is_counted() -> None:
    plan = Plan(
        designs=np.zeros((3, 2)),
        ratio=np.ones(3),
        chance=np.ones(3),
        sampled=np.zeros(3),
        standardised=np.array([1.0, -5.0, -2.0]),
        probability=0.1,
        standard_error=0.0,
        doubts=lambda _: (Doubt(0.003, 0.0), Doubt(0.001, 0.0)),
        widest=1.0,
    )
    estimate = plan.estimate(np.array([True, True, True]), np.ones(3, dtype=bool), 0.9)
    assert (estimate.contradictions, estimate.surprising, estimate.beyond) == (2, 1, 3)
    assert estimate.recall == pytest.approx(0.1 / (0.1 + 2.0 / 3.0))
    assert estimate.recall_low < estimate.recall
    assert estimate.probability == pytest.approx(0.1 + 2.0 / 3.0)


def test_no_design_is_drawn_less_often_than_the_bound_without_a_model_assumes() -> None:
    for limit, n in ((four_branch, 30), (plane, 15)):
        plan = planned(trained(limit, n, 1), 2000, 1)
        assert plan.ratio.max() <= plan.widest < 2.1 / UNIFORM
        assert plan.ratio.max() > 0.5 * plan.widest


@pytest.mark.exhaustive
def test_the_lower_end_of_the_recall_is_seldom_above_the_true_recall() -> None:
    latents = [trained(four_branch, 30, seed) for seed in range(3)]
    drawn = SPACE.from_unit(np.random.default_rng(9).random((2_000_000, 2)))
    failing = drawn[four_branch(drawn) <= 0.0]
    true = [float((boundary(latent)(failing) > 0.0).mean()) for latent in latents]
    too_high = 0
    for seed in range(30):
        plan = planned(latents[seed % 3], 50, 200 + seed)
        estimate = plan.estimate(four_branch(plan.designs) <= 0.0, np.ones(50, dtype=bool), 0.9)
        assert estimate.recall_low <= estimate.recall
        too_high += estimate.recall_low > true[seed % 3]
    assert min(true) < 0.9
    assert too_high <= 6


def test_numerical_failures_lower_the_recalls_bound_and_not_the_recall() -> None:
    plan = planned(trained(four_branch, 30, 1), 40, 1)
    full = plan.estimate(plan.predicted, np.ones(40, dtype=bool), 0.9)
    answered = np.ones(40, dtype=bool)
    answered[:8] = False
    partial = plan.estimate(plan.predicted, answered, 0.9)
    assert partial.recall == full.recall == 1.0
    assert partial.recall_low < full.recall_low < 1.0
