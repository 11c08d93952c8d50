"""Shares that were counted in parts: how often their bounds hold, above all where few hits or none were seen."""

import numpy as np
import pytest
from scipy.stats import beta, binom

from activefail.estimates.confidence_bounds import StratifiedCount, upper_bound
from activefail.estimates.error import confidence_of_look

ALL_SAFE = ([1.0, 0.0, 0.0, 0.0, 0.0], [1, 0, 0, 0, 0])
RARE = ([0.97, 0.01, 0.01, 0.005, 0.005], [0.75, 0.03, 0.05, 0.07, 0.1])
GOOD = ([0.9, 0.04, 0.03, 0.02, 0.01], [0.5, 0.1, 0.15, 0.15, 0.1])
POOR = ([0.3, 0.2, 0.2, 0.15, 0.15], [0.1, 0.15, 0.2, 0.25, 0.3])


def count(volumes, counted, hits):
    return StratifiedCount(*(np.array(numbers, dtype=np.float64) for numbers in (volumes, counted, hits)))


@pytest.mark.parametrize(("n", "x"), [(10, 0), (90, 0), (90, 1), (200, 7), (5, 5), (1000, 200)])
def test_in_one_part_both_bounds_are_the_exact_ones_of_clopper_and_pearson(n, x):
    one = count([1.0], [n], [x])
    assert one.lower(0.95) == pytest.approx(beta.ppf(0.05, x, n - x + 1) if x else 0.0)
    assert one.upper(0.95) == pytest.approx(beta.ppf(0.95, x + 1, n - x) if x < n else 1.0)


def test_where_none_of_ninety_was_wrong_the_bound_is_the_exact_one():
    parts = count(ALL_SAFE[0], [90, 0, 0, 0, 0], [0] * 5)
    assert (parts.lower(0.95), parts.upper(0.95)) == (0.0, pytest.approx(1.0 - 0.05 ** (1 / 90)))
    assert parts.upper(0.9) == pytest.approx(upper_bound(0, 90, 0.9)) == pytest.approx(0.02526, abs=1e-5)
    # No narrower than that where the other parts are small and known, too.
    assert count(RARE[0], [90, 5, 5, 5, 5], [0] * 5).upper(0.95) > 0.97 * (1.0 - 0.05 ** (1 / 90))


def test_a_part_in_which_nothing_was_counted_may_be_wrong_throughout():
    parts = count([0.9, 0.1], [50, 0], [0, 0])
    assert parts.upper(0.95) == pytest.approx(0.1 + 0.9 * (1.0 - 0.05 ** (1 / 50)))
    assert parts.estimate(np.array([0.5, 0.2])) == pytest.approx(0.02)
    assert count([0.6, 0.4], [0, 0], [0, 0]).upper(0.9) == 1.0


@pytest.mark.parametrize("p", [0.0005, 0.0081, 0.05, 0.2])
@pytest.mark.parametrize("n", [10, 30, 100, 300, 1000])
def test_in_one_part_the_interval_holds_at_every_share_as_often_as_it_says(n, p):
    x = np.arange(n + 1)
    interval = [count([1.0], [n], [k]) for k in x]
    held = np.array([one.lower(0.95) <= p <= one.upper(0.95) for one in interval])
    assert binom.pmf(x, n, p) @ held >= 0.9 - 1e-9


@pytest.mark.parametrize("error", [0.0005, 0.005, 0.05, 0.2])
@pytest.mark.parametrize("where", ["everywhere", "in the surest part", "in the least sure parts"])
@pytest.mark.parametrize(("volumes", "shares"), [RARE, GOOD, POOR])
def test_in_several_parts_the_interval_holds_at_least_as_often_as_it_says(volumes, shares, where, error):
    rng = np.random.default_rng(3)
    volumes = np.array(volumes)
    match where:
        case "everywhere":
            p = np.full(5, error)
        case "in the surest part":
            p = np.array([error / volumes[0], 0.0, 0.0, 0.0, 0.0])
        case _:
            # The least sure part first, of each at most six in ten.
            filled = np.minimum.accumulate(error - np.concatenate([[0.0], 0.6 * np.cumsum(volumes[::-1])[:-1]]))
            p = np.clip(np.divide(filled, volumes[::-1], out=np.zeros(5), where=volumes[::-1] > 0), 0.0, 0.6)[::-1]
    if p.max() > 0.9:
        return  # no such error fits into that part
    true = float(volumes @ p)
    seen: dict[tuple[float, ...], tuple[float, float]] = {}
    for n in (12, 100, 400):
        counted = np.maximum(np.round(n * np.array(shares)), volumes > 0)
        held = 0
        for _ in range(300):
            hits = rng.binomial(counted.astype(int), p)
            if (key := (n, *hits)) not in seen:
                parts = count(volumes, counted, hits)
                seen[key] = parts.lower(0.95), parts.upper(0.95)
            low, high = seen[key]
            held += low <= true <= high
        # 90 % of 300 is 270; by chance 264 would not be reached once in ten cases of just 90 %.
        assert held >= 264, (n, counted)


@pytest.mark.parametrize("confidence", [0.75, 0.9, 0.95, 0.99])
@pytest.mark.parametrize("p", [(0.07, 0.999), (0.1, 0.95), (0.14, 0.9), (0.02, 0.5)])
def test_the_upper_bound_holds_where_nearly_all_of_a_small_part_is_wrong(confidence, p):
    volumes, counted = np.array([0.9419, 0.0581]), (36, 3)
    held = 0.0
    for x in range(counted[0] + 1):
        for y in range(counted[1] + 1):
            chance = binom.pmf(x, counted[0], p[0]) * binom.pmf(y, counted[1], p[1])
            held += chance * (count(volumes, counted, (x, y)).upper(confidence) >= volumes @ p)
    assert held >= confidence - 0.005


def test_volumes_that_were_measured_by_a_pool_widen_both_ends():
    volumes, counted, hits = [0.7, 0.1, 0.1, 0.06, 0.04], [5000, 1000, 1500, 1200, 1300], [0, 5, 60, 200, 780]
    exact = count(volumes, counted, hits)
    measured = StratifiedCount(exact.volumes, exact.counted, exact.hits, 2**14)
    assert measured.lower(0.95) < exact.lower(0.95)
    assert measured.upper(0.95) > exact.upper(0.95)
    # A single part has no volume to be measured.
    assert StratifiedCount(*(np.array([float(n)]) for n in (1, 90, 3)), 2**14).upper(0.9) == count(
        [1], [90], [3]
    ).upper(0.9)


def test_all_looks_together_may_be_wrong_no_more_often_than_one_alone():
    wrong = [1.0 - confidence_of_look(0.9, look) for look in range(1, 10_000)]
    assert wrong[0] == pytest.approx(0.05)
    assert 0.0999 < sum(wrong) < 0.1


def test_what_was_never_seen_in_n_draws_may_have_the_probability_that_leaves_one_chance_in_ten():
    for n in (1, 30, 250):
        assert (1.0 - upper_bound(0, n, 0.9)) ** n == pytest.approx(0.1)
    assert upper_bound(0, 0, 0.9) == 1.0
    # Where some gave no answer each of them may have been it.
    assert upper_bound(2, 60, 0.9) == pytest.approx(beta.ppf(0.9, 3, 58))
    assert upper_bound(2, 60, 0.9) > 0.08
