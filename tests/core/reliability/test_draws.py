"""Draws: each design once, none that cannot be, and no bias."""

import numpy as np
import pytest
from scipy.stats import norm

from activefail.campaign.settings import parse_settings
from activefail.estimates.draws import Rows, expected_draws, merged, systematic
from activefail.estimates.estimate import gamma_quantile, plan_estimate, rows_of
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows


def tied(share: float) -> DesignSpace:
    """Two uniform variables, of which this share is feasible."""
    text = f"""
simulator = {{ python = "mine:gap", margins = ["margin"] }}
constraints = ["a - b >= {1.0 - np.sqrt(2.0 * share)}"]

[space]
a = {{ low = 0.0, high = 1.0 }}
b = {{ low = 0.0, high = 1.0 }}
x = {{ distribution = "normal", mean = 0.0, sd = 1.0 }}
"""
    return parse_settings(text, "f").design_space()


@pytest.mark.parametrize(("n", "m"), [(10, 3), (10, 9), (10, 10), (400, 50), (400, 399)])
def test_rows_are_drawn_once_in_proportion_to_their_shares_as_far_as_that_is_possible(n: int, m: int) -> None:
    rng = np.random.default_rng(0)
    shares = rng.exponential(size=n) ** 3
    expected, counts = expected_draws(shares, m), np.zeros(n)
    assert expected.sum() == pytest.approx(m)
    assert expected.max() <= 1.0
    smallest, open_ones = shares.argmin(), expected < 1.0
    assert expected[open_ones] == pytest.approx(shares[open_ones] * expected[smallest] / shares[smallest])
    for _ in range(2000):
        rows = systematic(expected, rng.permutation(n), rng)
        assert len(np.unique(rows)) == len(rows) == m
        counts[rows] += 1
    # Five standard deviations of a count, and one count.
    assert (np.abs(counts - 2000 * expected) <= 5.0 * np.sqrt(2000 * expected * (1.0 - expected)) + 1.0).all()


def test_rows_are_drawn_again_in_proportion_to_their_shares_after_each_was_drawn_once() -> None:
    shares = np.array([0.7, 0.2, 0.1, 0.01])
    expected = expected_draws(shares, 12, repeats=True)
    assert expected == pytest.approx([7.7, 2.2, 1.1, 1.0])
    counts = [np.bincount(systematic(expected, np.arange(4), np.random.default_rng(seed))) for seed in range(40)]
    assert {tuple(one) for one in counts} <= {(8, 2, 1, 1), (7, 3, 1, 1), (7, 2, 2, 1)}
    assert expected_draws(shares, 4, repeats=True).tolist() == [1.0, 1.0, 1.0, 1.0]
    assert expected_draws(shares, 7).tolist() == [1.0, 1.0, 1.0, 1.0]


def test_equal_designs_are_one_row_and_rows_without_weight_are_none() -> None:
    X = np.array([[1.0], [2.0], [3.0], [4.0]])
    rows = merged(Rows(X, np.array([0.1, 0.2, 0.0, 0.7]), np.full(4, 0.25), np.array([1.0, 2.0, 3.0, 4.0])), X // 2)
    assert rows.X.ravel().tolist() == [1.0, 2.0, 4.0]
    rows = merged(rows, np.minimum(rows.X, 2.0))
    assert rows.X.ravel().tolist() == [1.0, 2.0]
    assert rows.share == pytest.approx([0.1, 0.9])
    assert rows.variance == pytest.approx([1.0, 6.0])


@pytest.mark.parametrize("share", [0.19, 0.005])
def test_rows_are_feasible_and_many_where_little_is_feasible(share: float) -> None:
    space = tied(share)
    assert space.feasible_share == pytest.approx(share, rel=0.05)
    rows = rows_of(space, lambda X: np.exp(-(X[:, 2] ** 2)), lambda X: X, np.random.default_rng(0))
    assert space.contains(rows.X).all()
    assert (rows.share > 0.0).all()
    assert len(rows.X) > 4000
    # The idle variables do not matter to the others.
    error = float(np.sqrt(rows.share**2 @ (rows.X[:, 2] > 1.0)))
    assert rows.share @ (rows.X[:, 2] > 1.0) == pytest.approx(norm.sf(1.0), abs=4.0 * error)


@pytest.mark.parametrize("share", [1.0, 0.19, 0.005])
def test_hidden_failures_are_found_as_often_whatever_share_of_the_designs_is_feasible(share: float) -> None:
    space, hidden = (tied(share) if share < 1.0 else tied(0.4999)), norm.cdf(-1.9)

    def fails(X: Array) -> Array:
        return (X[:, 2] > 1.4) | (X[:, 2] < -1.9)

    true, bounds, covers, middles = norm.sf(1.4) + hidden, 0, 0, []
    for seed in range(20):
        plan = plan_estimate(lambda X: (X[:, 2] - 1.4) / 0.05, space, 400, np.random.default_rng(seed))
        assert len(np.unique(plan.designs, axis=0)) == 400
        found = plan.estimate(fails(plan.designs), np.ones(400, dtype=bool), 0.9)
        covers += found.low <= true <= found.high
        middles.append(found.probability)
        draws, widest = plan.surest
        bounds += widest * (fails(plan.designs).sum() + 1.0) / draws >= true
    # Nominal 18 of 20; fewer than 15 have a chance of 4 %.
    assert covers >= 15
    assert bounds == 20
    assert np.mean(middles) == pytest.approx(true, abs=4.0 * np.std(middles) / np.sqrt(20.0))


def test_a_table_with_one_heavy_row_is_simulated_there_for_certain() -> None:
    rows = WeightedRows(("u",), np.arange(1000.0)[:, None], np.where(np.arange(1000) == 500, 999.0, 1.0))
    for seed in range(20):
        plan = plan_estimate(lambda X: (X[:, 0] - 300.5) / 10.0, rows, 50, np.random.default_rng(seed))
        assert 500.0 in plan.designs[:, 0]
        found = plan.estimate(plan.designs[:, 0] > 300.0, np.ones(50, dtype=bool), 0.9)
        true = float(rows.weight @ (rows.X[:, 0] > 300.0)) / 1000.0
        assert found.low <= true <= found.high
        assert found.high - found.low < 0.2


def test_designs_of_a_variable_in_steps_are_drawn_once() -> None:
    space = DesignSpace((Parameter("n", 0.0, 9.0, step=1.0), Parameter("k", 0.0, 3.0, step=1.0)))
    plan = plan_estimate(lambda X: X[:, 0] - 7.5, space, 30, np.random.default_rng(0))
    assert len(np.unique(plan.designs, axis=0)) == 30
    everything = plan_estimate(lambda X: X[:, 0] - 7.5, space, 100, np.random.default_rng(0))
    assert len(everything.designs) == 40
    found = everything.estimate(everything.designs[:, 0] > 8.0, np.ones(40, dtype=bool), 0.9)
    assert found.low <= 0.1 <= found.high
    noisy = plan_estimate(lambda X: X[:, 0] - 7.5, space, 100, np.random.default_rng(0), repeatable=False)
    counts = np.unique(noisy.designs, axis=0, return_counts=True)[1]
    assert (len(counts), counts.sum()) == (40, 100)
    assert (noisy.chance == 1.0).all()


@pytest.mark.parametrize("skewness", [-2.0, -0.3, 0.0, 0.5, 3.0])
def test_the_quantiles_are_those_of_a_gamma_distribution(skewness: float) -> None:
    from scipy.stats import pearson3

    for share in (0.02, 0.5, 0.95):
        assert gamma_quantile(share, skewness) == pytest.approx(pearson3.ppf(share, skewness), abs=2e-6)
