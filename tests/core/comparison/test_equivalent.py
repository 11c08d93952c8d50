"""How many static simulations a campaign is worth."""

import numpy as np
import pytest

from activefail.analyses.comparison.equivalent import equivalent, simulations_to_reach
from activefail.estimates.scores import Score


def scored(sampling: str, simulations: int, accuracy: float, hypercube: int = 0) -> Score:
    return Score(sampling, simulations, accuracy, accuracy, accuracy, accuracy, -0.1, 20_000, hypercube=hypercube)


STATIC = [
    scored("static", size, accuracy, number)
    for size, accuracies in ((500, (0.955, 0.957, 0.950)), (1000, (0.960, 0.958, 0.955)), (4000, (0.966, 0.962, 0.960)))
    for number, accuracy in enumerate(accuracies)
]


def test_simulations_to_reach_a_level_are_interpolated_in_their_logarithm() -> None:
    curve = np.array([250, 1000]), np.array([0.91, 0.94])
    assert simulations_to_reach(*curve, 0.91) == 250
    assert simulations_to_reach(*curve, 0.925) == pytest.approx(500)
    assert simulations_to_reach(*curve, 0.96) is None


def test_the_size_is_interpolated_in_its_logarithm_on_the_medians_and_along_each_series() -> None:
    same = equivalent([scored("active", 250, 0.90), scored("active", 500, 0.960), *STATIC])
    assert same is not None
    # Medians 0.955, 0.958, 0.962: 0.960 is half way from 1000 to 4000 in the logarithm.
    assert same.size == pytest.approx(2000.0)
    # The series reach 0.960 at 1000, half way from 1000 to 4000, and at 4000.
    assert (same.lowest, same.highest) == (pytest.approx(1000.0), pytest.approx(4000.0))
    assert same.in_words("failure") == (
        "After 500 simulations the campaign is right about failure for 96.00 % of 20,000 fresh designs, as often as "
        "static sampling after about 2,000 (1,000 to 4,000 over the 3 series of static designs)."
    )


def test_a_campaign_that_beats_every_static_design_is_said_to_beat_the_largest() -> None:
    same = equivalent([scored("active", 500, 0.964), *STATIC])
    assert same is not None
    assert same.size is None
    assert "more often than static sampling after 4,000 (2,500 to more than 4,000 over" in same.in_words("failure")


def test_a_campaign_that_no_static_design_is_worse_than_is_said_to_be_no_better_than_the_smallest() -> None:
    same = equivalent([scored("active", 500, 0.940), *STATIC])
    assert same is not None
    text = same.in_words("failure")
    assert "not more often than static sampling after 500 (at most 500 over the 3 series" in text


def test_one_static_design_of_each_size_gives_no_range() -> None:
    same = equivalent([scored("active", 500, 0.961), *(row for row in STATIC if row.hypercube == 0)])
    assert same is not None
    assert same.in_words("failure").endswith("(from one static design of each size; another gives another number).")


def test_without_one_of_the_samplings_there_is_nothing_to_compare() -> None:
    assert equivalent(STATIC) is None
    assert equivalent([scored("active", 500, 0.96)]) is None


def test_one_design_of_two_hundred_is_no_difference() -> None:
    def of_200(sampling: str, accuracy: float) -> Score:
        return Score(sampling, 60, accuracy, accuracy, accuracy, accuracy, -0.1, 200)

    same = equivalent([of_200("active", 0.965), of_200("static", 0.97)])
    assert same is not None
    assert not same.differs
    text = same.in_words("failure")
    assert text.endswith("A static design of the same size is right for 97.00 %: 200 test designs show no difference.")
    other = equivalent([of_200("active", 0.965), of_200("static", 0.90)])
    assert other is not None
    assert other.differs
    assert "show no difference" not in other.in_words("failure")
