import math
from dataclasses import replace

import numpy as np
import pytest
from rare import four_branch
from scipy import stats

from activefail.surrogate import margin as m
from activefail.surrogate.margin import MarginLatent, fit_margin, is_truncated
from activefail.surrogate.margin_choice import fit_defined

RNG = np.random.default_rng(5)
Z = RNG.standard_normal((24, 2)) * 1.6
G = four_branch(Z)
FRESH = np.random.default_rng(6).standard_normal((2000, 2)) * 1.6


def drawn(seed: int, n: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """Features and margins of a smooth function of two of three features, about a third of them at most 0."""
    X = np.random.default_rng(seed).standard_normal((n, 3))
    return X, 0.5 + np.sin(X[:, 0]) + 0.7 * X[:, 1] + 0.1 * X[:, 0] * X[:, 1]


@pytest.mark.parametrize("truncated", [False, True])
def test_the_gradient_is_that_of_the_likelihood(truncated: bool) -> None:
    X, g = drawn(1)
    censored = (g <= 0.0) & truncated
    assert 2 < (g <= 0.0).sum() < 9
    packed = np.array([0.3, 0.4, 0.9, 0.2, 1.4])
    sites = m.CensoredSites(np.full(censored.sum(), -0.1), np.full(censored.sum(), 0.1))
    evaluation = m.penalised_likelihood(X, g, censored, packed, sites)
    step = 1e-5
    for index in range(len(packed)):
        moved = np.array([1.0, -1.0])[:, None] * step * np.eye(len(packed))[index] + packed
        above, below = (m.penalised_likelihood(X, g, censored, row, evaluation.sites).value for row in moved)
        assert evaluation.gradient[index] == pytest.approx((above - below) / (2.0 * step), rel=1e-4, abs=1e-5)


def test_the_evidence_of_censored_margins_is_the_probability_that_all_are_at_most_zero() -> None:
    A = np.random.default_rng(2).standard_normal((4, 4))
    S, mean = A @ A.T + 0.3 * np.eye(4), np.array([0.4, -0.3, 0.8, -1.0])
    start = m.CensoredSites(np.full(4, -0.1), np.full(4, 0.1))
    result = m.censored_posterior(mean, S, start)
    exact = stats.multivariate_normal(mean, S).cdf(np.zeros(4))
    # Expectation propagation is not exact; its error on such orthants is a few per cent.
    assert math.exp(result.log_evidence) == pytest.approx(exact, rel=0.05)
    alone = m.censored_posterior(mean[:1], S[:1, :1], m.CensoredSites(*(site[:1] for site in start)))
    assert alone.log_evidence == pytest.approx(stats.norm.logcdf(-mean[0] / math.sqrt(S[0, 0])), abs=1e-9)


def test_the_posterior_of_censored_margins_is_that_of_sampling() -> None:
    mean, S = np.array([0.4, -0.2, 0.1]), np.array([[1.0, 0.6, 0.2], [0.6, 1.5, 0.5], [0.2, 0.5, 0.8]])
    sites = m.censored_posterior(mean, S, m.CensoredSites(np.full(3, -0.1), np.full(3, 0.1))).sites
    V = np.linalg.inv(np.linalg.inv(S) + np.diag(sites.precision))
    actual = V @ (np.linalg.solve(S, mean) + sites.linear)
    f = np.random.default_rng(3).multivariate_normal(mean, S, size=400_000)
    f = f[(f <= 0.0).all(axis=1)]
    np.testing.assert_allclose(actual, f.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.sqrt(V.diagonal()), f.std(axis=0), rtol=0.05)


@pytest.mark.parametrize("truncated", [False, True])
def test_margins_left_out_are_those_of_a_fit_without_the_design(truncated: bool) -> None:
    X, g = drawn(4)
    fitted = fit_margin(X, np.where(truncated & (g <= 0.0), 0.0, g), truncated=truncated)
    mean, sd = fitted.left_out()
    for row in np.flatnonzero(g > 0.0)[:3]:
        kept = np.arange(len(g)) != row
        without = replace(fitted, features=X[kept], margin=fitted.margin[kept])
        # The closed form estimates the constant mean anew, the fit without the design keeps that of all.
        A, target = m.linear_system(without)
        weights = np.linalg.solve(A, np.ones(len(A)))
        own_mean = weights @ target / weights.sum()
        renewed = replace(without, hyperparameters=fitted.hyperparameters._replace(mean=float(own_mean)))
        expected_mean, expected_sd = renewed.moments(X[row : row + 1])
        assert mean[row] == pytest.approx(expected_mean[0], rel=1e-6, abs=1e-8)
        assert sd[row] == pytest.approx(expected_sd[0], rel=1e-3)


def test_a_regression_passes_through_its_margins_and_joint_moments_agree_with_marginal_ones() -> None:
    fitted = fit_margin(Z, G)
    warp = m.WARPINGS[fitted.warping][0]
    mean, sd = fitted.moments(Z)
    np.testing.assert_allclose(mean, warp(G / fitted.unit), atol=0.02)
    assert sd.max() < 0.02 * math.exp(0.5 * fitted.hyperparameters.log_outputscale)
    mean, sd = fitted.moments(FRESH[:50])
    joint_mean, K = fitted.joint(FRESH[:50])
    np.testing.assert_allclose(joint_mean, mean)
    np.testing.assert_allclose(np.sqrt(K.diagonal()), sd, rtol=1e-4)
    assert np.linalg.eigvalsh(K)[0] > 0.0


def test_the_boundary_of_four_branches_is_learned_from_few_margins_and_from_truncated_ones() -> None:
    X = np.random.default_rng(7).standard_normal((60, 2)) * 2.0
    g, truth = four_branch(X), four_branch(FRESH * 1.25) <= 0.0
    for margin in (g, np.maximum(g, 0.0)):
        fitted = fit_margin(X, margin)
        assert fitted.truncated == (margin.min() == 0.0)
        mean, _ = fitted.moments(FRESH * 1.25)
        assert ((mean <= 0.0) != truth).mean() < 0.04


def test_intervals_of_a_smooth_margin_hold_at_least_as_often_as_they_say_and_are_short() -> None:
    held, widths = [], []
    for seed in range(20):
        X, g = drawn(seed, 20)
        fitted = fit_margin(X, g)
        fresh, true = drawn(100 + seed, 200)
        mean, sd = fitted.moments(fresh)
        error = m.WARPINGS[fitted.warping][0](true / fitted.unit) - mean
        held.append((np.abs(error) <= 1.645 * sd).mean())
        widths.append(np.median(sd) / np.std(mean + error))
    # Nominal 0.9; the mean of twenty shares has a standard error of some 0.02. Priors make the intervals conservative.
    assert np.mean(held) > 0.86
    assert np.median(widths) < 0.1


def test_the_warping_follows_the_margins() -> None:
    X = np.random.default_rng(8).standard_normal((40, 2))
    smooth = X[:, 0] + 0.5 * X[:, 1] + 0.3 * X[:, 0] * X[:, 1]
    assert fit_margin(X, smooth).warping == "none"
    assert fit_margin(X, np.sinh(3.0 * smooth)).warping != "none"


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_the_unit_of_the_margin_does_not_matter(factor: float) -> None:
    one, other = fit_margin(Z, G), fit_margin(Z, factor * G)
    assert one.warping == other.warping
    np.testing.assert_allclose(one.moments(FRESH)[0], other.moments(FRESH)[0], atol=1e-3)


def test_an_outcome_left_out_is_predicted_from_the_others_also_where_it_is_censored() -> None:
    X, g = drawn(4, 30)
    truncated = fit_margin(X, np.maximum(g, 0.0))
    failed = g <= 0.0
    mean, sd = truncated.left_out()
    rows = np.flatnonzero(failed)
    for row in rows[:3]:
        kept = np.arange(len(g)) != row
        position = int(failed[:row].sum())
        sites = m.CensoredSites(*(np.delete(site, position) for site in truncated.sites))
        without = replace(truncated, features=X[kept], margin=truncated.margin[kept], sites=sites)
        A, target = m.linear_system(without)
        weights = np.linalg.solve(A, np.ones(len(A)))
        own_mean = float(weights @ target / weights.sum())
        renewed = replace(without, hyperparameters=truncated.hyperparameters._replace(mean=own_mean))
        expected_mean, expected_sd = renewed.moments(X[row : row + 1])
        assert mean[row] == pytest.approx(expected_mean[0], rel=1e-5, abs=1e-6)
        assert sd[row] == pytest.approx(expected_sd[0], rel=1e-2)


def test_pending_designs_leave_the_means_and_shrink_the_variances_as_their_margins_would() -> None:
    fitted = fit_margin(Z[:20], G[:20])
    latent = MarginLatent(fitted)
    mean, sd = latent.moments(Z)
    # Conditioning a Gaussian on values at its means, with the scales unchanged.
    _, covariance = latent.joint(Z)
    pending = slice(20, 24)
    gain = np.linalg.solve(covariance[pending, pending], covariance[pending])
    expected = np.sqrt(np.maximum((covariance - covariance[:, pending] @ gain).diagonal(), 1e-6))
    waiting = latent.with_pending(Z[20:22]).with_pending(Z[22:24])
    np.testing.assert_array_equal(waiting.moments(Z).mean, mean)
    np.testing.assert_allclose(waiting.moments(Z).sd, expected, rtol=1e-3, atol=2e-2)
    np.testing.assert_allclose(np.sqrt(waiting.joint(Z[24:])[1].diagonal()), expected[24:], rtol=1e-3, atol=1e-3)
    assert (waiting.moments(Z).sd <= sd + 1e-12).all()
    assert len(waiting.features) == 24


def test_hyperparameters_are_kept_until_many_margins_are_new() -> None:
    rng = np.random.default_rng(5)
    X = rng.standard_normal((130, 2))
    g = 2.0 - X[:, 0] + 0.2 * X[:, 1] ** 2
    first = fit_margin(X[:110], g[:110])
    few = fit_margin(X[:113], g[:113], warm=first)
    assert few.hyperparameters == first.hyperparameters
    assert (few.learned_on, len(few.margin)) == (110, 113)
    np.testing.assert_allclose(few.moments(X[110:113])[0], m.WARPINGS[few.warping][0](g[110:113] / few.unit), atol=1e-2)
    assert fit_margin(X, g, warm=first).learned_on == 130


@pytest.mark.parametrize("truncated", [False, True])
def test_of_many_margins_a_support_is_kept_that_is_half_nearest_the_boundary(
    truncated: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(m, "LEARNED_ON", 60)
    monkeypatch.setattr(m, "COARSE", 40)
    monkeypatch.setattr(m, "EXACT", 100)
    X = np.random.default_rng(9).standard_normal((400, 2)) * 1.6
    g = np.maximum(four_branch(X), 0.0) if truncated else four_branch(X)
    fitted = fit_margin(X, g)
    assert (fitted.truncated, fitted.learned_on, fitted.size_of_support) == (truncated, 400, 100)
    known = np.where(g > 0.0, g, np.inf) if truncated else np.abs(g)
    assert np.isin(np.argsort(known)[:50], fitted.rows).all()
    mean, _ = fitted.moments(FRESH)
    assert np.mean((mean <= 0.0) != (four_branch(FRESH) <= 0.0)) < 0.02
    # What is outside the support is predicted from the support as it is.
    outside = np.setdiff1d(np.arange(400), fitted.rows)
    left_out, deviation = fitted.left_out()
    np.testing.assert_array_equal([left_out[outside], deviation[outside]], fitted.moments(X[outside]))
    more = fit_margin(np.concatenate([X, FRESH[:5]]), np.concatenate([g, four_branch(FRESH[:5])]), truncated, fitted)
    assert more.hyperparameters == fitted.hyperparameters
    assert len(MarginLatent(more).model.X) == 100


def test_ten_thousand_margins_in_thirty_variables_are_learned_from() -> None:
    X = np.random.default_rng(10).standard_normal((12_000, 30))
    g = 2.0 - X.sum(axis=1) / math.sqrt(30.0) + 0.3 * np.sin(2.0 * X[:, 0])
    fitted = fit_margin(X[:10_000], g[:10_000])
    assert fitted.solved.L.shape == (m.EXACT, m.EXACT)
    mean, _ = fitted.moments(X[10_000:])
    assert np.mean((mean <= 0.0) != (g[10_000:] <= 0.0)) < 0.005


@pytest.mark.parametrize(
    ("margin", "truncated"),
    [
        ([3.0, 1.0, 2.0, 0.0, 0.0], True),
        ([3.0, 1.0, 2.0, -0.5, -0.5], True),
        ([3.0, 1.0, 2.0, -0.5, -1.5], False),
        ([3.0, 1.0, 2.0, -0.001], True),
        ([3.0, 1.0, 2.0, -0.8], False),
        ([3.0, 1.0, 2.0], False),
        ([-3.0, -1.0], False),
    ],
)
def test_truncation_is_seen_in_the_failed_designs_margins(margin: list[float], truncated: bool) -> None:
    assert is_truncated(np.array(margin)) == truncated


@pytest.mark.parametrize("margin", [[1.0], [1.0, 1.0, 1.0], [1.0, math.nan], [1.0, math.inf]])
def test_margins_that_nothing_can_be_learned_from_are_refused(margin: list[float]) -> None:
    with pytest.raises(ValueError, match="two margins or more that are finite and not all equal"):
        fit_margin(np.zeros((len(margin), 2)), np.array(margin))


def test_truncated_margins_need_two_positive_ones() -> None:
    with pytest.raises(ValueError, match="needs two that are positive"):
        fit_margin(Z[:4], np.array([0.0, -1.0, -2.0, 1.0]), truncated=True)


def test_a_margin_is_clipped_if_three_different_designs_have_the_largest_one() -> None:
    X, g = drawn(4)
    top = np.sort(g)
    assert not fit_margin(X, g).is_clipped
    assert not fit_margin(X, np.minimum(g, top[-2])).is_clipped
    assert fit_margin(X, np.minimum(g, top[-3])).is_clipped
    # Ties elsewhere, at failure above all, say nothing about the largest margin.
    assert not fit_margin(X, np.maximum(g, top[4])).is_clipped
    clipped = np.minimum(g, top[-3])
    assert fit_defined(X, np.where(clipped <= 0.0, np.nan, clipped)).is_clipped


def test_a_design_simulated_again_does_not_make_its_margin_a_clipped_one() -> None:
    X, g = drawn(4)
    best = np.full(3, g.argmax())
    assert not fit_margin(np.concatenate([X, X[best]]), np.concatenate([g, g[best]])).is_clipped
