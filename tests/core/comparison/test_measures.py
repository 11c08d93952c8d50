"""The figures by which samplings are judged, against direct counting."""

import numpy as np
import pytest
from campaign.stub import Disc, distance

from activefail.analyses.comparison.measures import (
    DISPLACEMENT,
    NEIGHBOURS,
    FreshSet,
    displaced,
    expected_calibration_error,
    measures,
)


@pytest.fixture(scope="module")
def test_set(ran):
    space = ran.campaign.space
    X = space.from_unit(np.random.default_rng(0).random((1500, 2)))
    around = Disc().run(displaced(X, space, np.random.default_rng(1))).outcome
    return FreshSet(X, Disc().run(X).outcome, around.reshape(len(X), NEIGHBOURS))


def test_displaced_designs_stay_in_the_space_and_near_their_own(ran):
    space = ran.campaign.space
    X = space.from_unit(np.vstack([np.zeros((500, 2)), np.random.default_rng(0).random((2000, 2))]))
    moved = displaced(X, space, np.random.default_rng(1))
    assert space.contains(moved).all()
    steps = (space.to_unit(moved) - np.repeat(space.to_unit(X), NEIGHBOURS, axis=0))[500 * NEIGHBOURS :]
    assert steps.std() == pytest.approx(DISPLACEMENT, rel=0.05)


def test_the_measures_are_what_counting_says(ran, test_set):
    scores = measures(ran.classifier, 1, test_set)
    inside = distance(test_set.X) > 0.0
    p = ran.classifier.probabilities(test_set.X)[:, 1]
    right = (p > 0.5) == inside
    assert scores["accuracy"] == pytest.approx(right.mean())
    assert scores["accuracy_broken"] == scores["accuracy"]
    assert scores["outcome_accuracy"] == pytest.approx(right.mean())
    own = np.where(inside, p, 1.0 - p)
    assert scores["log_score"] == pytest.approx(np.log(own).mean())
    assert scores["outcome_log_score"] == pytest.approx(np.log(own).mean())
    near = [i for i in range(len(right)) if any(test_set.around[i] != inside[i])]
    assert 20 < len(near) < len(right) / 2
    assert scores["accuracy_near"] == pytest.approx(right[near].mean())
    assert np.abs(distance(test_set.X[near])).max() < 5 * DISPLACEMENT
    small = [i for i in near if inside[i] and sum(test_set.around[i] == 0) >= NEIGHBOURS / 2]
    assert scores["recall_small"] == pytest.approx((p > 0.5)[small].mean())
    assert scores["recall_of_broken"] == pytest.approx((p > 0.5)[inside].mean())
    assert scores["recall_of_" + ran.classifier.outcomes[0]] == pytest.approx((p <= 0.5)[~inside].mean())


def test_copies_without_an_answer_say_nothing_of_what_is_near(ran, test_set):
    blind = FreshSet(test_set.X, test_set.outcome, np.full_like(test_set.around, -1))
    scores = measures(ran.classifier, 1, blind)
    assert np.isnan(scores["accuracy_near"])
    assert np.isnan(scores["recall_small"])


def test_the_calibration_error_is_zero_for_shares_that_come_and_the_gap_otherwise():
    p = np.repeat([0.25, 0.75], 40)
    y = np.concatenate([np.arange(40) < 10, np.arange(40) < 30])
    assert expected_calibration_error(p, y) == pytest.approx(0.0)
    assert expected_calibration_error(np.repeat([0.05, 0.95], 40), y) == pytest.approx(0.2)
