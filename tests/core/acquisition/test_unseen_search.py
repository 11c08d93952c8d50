"""The search for an outcome that was never seen: far from what is known, and further out than the design space."""

import numpy as np
import pytest
from rare import four_branch
from scipy.spatial.distance import cdist

from activefail.learning.criteria.unseen_search import search
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

NORMAL = DesignSpace(
    tuple(Parameter(name, -6.0, 6.0, distribution="truncated_normal", mean=0.0, sd=1.0) for name in "xy")
)
BOX = DesignSpace((Parameter("x", 0.0, 10.0), Parameter("y", 1.0, 1000.0, distribution="log_uniform")))


@pytest.mark.parametrize("seed", range(10))
def test_a_failure_that_a_hypercube_missed_is_found_within_ten_designs(seed):
    rng = np.random.default_rng(seed)
    known = NORMAL.latin_hypercube(30, rng)
    known = known[four_branch(known) > 0.0]
    designs = search(NORMAL, known, 0, 10, rng)
    assert (four_branch(designs) < 0.0).any()
    assert NORMAL.contains(designs).all()


def test_each_design_is_farther_from_the_known_ones_than_random_designs_are():
    rng = np.random.default_rng(1)
    known = BOX.latin_hypercube(40, rng)
    designs = search(BOX, known, 0, 8, rng)
    nearest = cdist(BOX.standardised(designs), BOX.standardised(known)).min(axis=1)
    usual = cdist(BOX.standardised(BOX.sobol(256, rng)), BOX.standardised(known)).min(axis=1)
    assert nearest.min() > np.quantile(usual, 0.9)
    assert len(np.unique(designs, axis=0)) == 8


def test_designs_take_turns_in_how_far_out_they_look_also_over_several_batches():
    rng = np.random.default_rng(2)
    known = np.zeros((1, 2))
    radius = np.array(
        [
            np.linalg.norm(search(NORMAL, known, first, 1, np.random.default_rng(7)), axis=1)[0]
            for first in (0, 1, 2, 3, 4, 5)
        ]
    )
    assert (np.diff(radius[:5]) > 0.0).all()
    assert radius[5] == radius[0]
    assert len(search(NORMAL, known, 0, 0, rng)) == 0


def test_widening_leaves_bounds_and_bounded_variables_as_they_are():
    X = BOX.sobol(64, np.random.default_rng(0))
    assert np.array_equal(BOX.widened(X, 3.0), X)
    wide = NORMAL.widened(NORMAL.sobol(4096, np.random.default_rng(0)), 3.0)
    assert np.abs(wide).max() == 6.0
    # Cut off at six, so a little below three.
    assert wide.std() == pytest.approx(2.85, abs=0.1)


def test_standardised_values_have_mean_zero_and_standard_deviation_one():
    for space in (NORMAL, BOX):
        places = space.standardised(space.sobol(2**14, np.random.default_rng(0)))
        assert places.mean(axis=0) == pytest.approx(0.0, abs=0.01)
        assert places.std(axis=0) == pytest.approx(1.0, abs=0.01)
