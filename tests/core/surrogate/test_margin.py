import copy
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from rare import four_branch
from scipy import stats
from surrogate.labelled import flattened, numerical_gradient

from activefail.learning.model import margin as m
from activefail.learning.model import margin_data
from activefail.learning.model.censored import CensoredSites, censored_posterior, first_sites
from activefail.learning.model.margin import MarginLatent, fit_margin, margin_prior, penalised_likelihood
from activefail.learning.model.margin_data import informative, is_truncated
from activefail.learning.model.training import fit_defined, outcome_score

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
    prior = margin_prior(3)
    prior.covar_module.initialize(outputscale=1.5)
    value = partial(penalised_likelihood, prior, X, g, censored, first_sites(censored, 1.0))
    assert flattened(value()[1]) == pytest.approx(numerical_gradient(prior, lambda: value()[0]), rel=1e-4, abs=1e-5)


def test_the_evidence_of_censored_margins_is_the_probability_that_all_are_at_most_zero() -> None:
    A = np.random.default_rng(2).standard_normal((4, 4))
    S, mean, start = A @ A.T + 0.3 * np.eye(4), np.array([0.4, -0.3, 0.8, -1.0]), first_sites(np.ones(4, bool), 1.0)
    exact = stats.multivariate_normal(mean, S).cdf(np.zeros(4))
    # Expectation propagation is not exact; its error on such orthants is a few per cent.
    assert math.exp(censored_posterior(mean, S, start)[1]) == pytest.approx(exact, rel=0.05)
    _, alone = censored_posterior(mean[:1], S[:1, :1], CensoredSites(*(site[:1] for site in start)))
    assert alone == pytest.approx(stats.norm.logcdf(-mean[0] / math.sqrt(S[0, 0])), abs=1e-9)


def test_the_posterior_of_censored_margins_is_that_of_sampling() -> None:
    mean, S = np.array([0.4, -0.2, 0.1]), np.array([[1.0, 0.6, 0.2], [0.6, 1.5, 0.5], [0.2, 0.5, 0.8]])
    sites = censored_posterior(mean, S, first_sites(np.ones(3, bool), 1.0))[0]
    V = np.linalg.inv(np.linalg.inv(S) + np.diag(sites.precision))
    actual = V @ (np.linalg.solve(S, mean) + sites.linear)
    f = np.random.default_rng(3).multivariate_normal(mean, S, size=400_000)
    f = f[(f <= 0.0).all(axis=1)]
    np.testing.assert_allclose(actual, f.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.sqrt(V.diagonal()), f.std(axis=0), rtol=0.05)


def warped(fitted: m.MarginFit, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the warped margin."""
    moments = MarginLatent(fitted).moments(F)
    return fitted.data.warped(np.zeros(len(F))) - moments.mean, moments.sd


@pytest.mark.parametrize("truncated", [False, True])
def test_a_margin_left_out_is_predicted_by_a_fit_without_its_design_also_where_it_is_censored(truncated: bool) -> None:
    X, g = drawn(4, 30)
    failed = g <= 0.0
    fitted = fit_margin(X, np.where(truncated & failed, 0.0, g), truncated=truncated)
    mean, sd = fitted.left_out()
    for row in [*np.flatnonzero(~failed)[:3], *np.flatnonzero(failed)[:3]]:
        kept = np.arange(len(g)) != row
        sites = fitted.data.sites
        if truncated and failed[row]:
            sites = CensoredSites(*(np.delete(site, int(failed[:row].sum())) for site in sites))
        data = replace(fitted.data, features=X[kept], margin=fitted.data.margin[kept], sites=sites)
        # The closed form estimates the constant mean anew from what is left.
        target, noise = data.observed(fitted.nugget)
        own = copy.deepcopy(fitted.prior)
        weights = np.linalg.solve(own.covariance(torch.from_numpy(X[kept])).numpy() + np.diag(noise), np.ones(29))
        own.mean_module.initialize(constant=torch.tensor(weights @ target / weights.sum(), dtype=torch.float64))
        expected_mean, expected_sd = warped(replace(fitted, data=data, prior=own), X[row : row + 1])
        assert mean[row] == pytest.approx(expected_mean[0], rel=1e-5, abs=1e-6)
        assert sd[row] == pytest.approx(expected_sd[0], rel=1e-2)


def test_a_regression_passes_through_its_margins() -> None:
    fitted = fit_margin(Z, G)
    mean, sd = warped(fitted, Z)
    np.testing.assert_allclose(mean, fitted.data.warped(G), atol=0.02)
    assert sd.max() < 0.02 * math.sqrt(float(fitted.prior.covar_module.outputscale))


def test_the_boundary_of_four_branches_is_learned_from_few_margins_and_from_truncated_ones() -> None:
    X = np.random.default_rng(7).standard_normal((60, 2)) * 2.0
    g, truth = four_branch(X), four_branch(FRESH * 1.25) <= 0.0
    for margin in (g, np.maximum(g, 0.0)):
        fitted = fit_margin(X, margin)
        assert fitted.data.truncated == (margin.min() == 0.0)
        mean, _ = warped(fitted, FRESH * 1.25)
        assert ((mean <= 0.0) != truth).mean() < 0.04


def test_intervals_of_a_smooth_margin_hold_at_least_as_often_as_they_say_and_are_short() -> None:
    held, widths = [], []
    for seed in range(20):
        X, g = drawn(seed, 20)
        fitted = fit_margin(X, g)
        fresh, true = drawn(100 + seed, 200)
        mean, sd = warped(fitted, fresh)
        error = fitted.data.warped(true) - mean
        held.append((np.abs(error) <= 1.645 * sd).mean())
        widths.append(np.median(sd) / np.std(mean + error))
    # Nominal 0.9; the mean of twenty shares has a standard error of some 0.02. Priors make the intervals conservative.
    assert np.mean(held) > 0.86
    assert np.median(widths) < 0.1


def test_a_solver_that_gives_up_before_failure_shows_the_level_where_it_does() -> None:
    X, fresh = (np.random.default_rng(seed).standard_normal((n, 2)) for seed, n in ((3, 30), (4, 4000)))

    def reserve(F: np.ndarray) -> np.ndarray:
        return 1.0 - F[:, 0] - 0.2 * F[:, 1] ** 2

    g, gives_up = reserve(X), 0.3
    latent = MarginLatent(fit_defined(X, np.where(g < gives_up, np.nan, g)))
    predicted = {place: replace(latent, place=place).moments(fresh).mean > 0.0 for place in (None, 0.0, 1.0)}
    lost = reserve(fresh) < gives_up
    # The least margin and the nearest lost run enclose the level, but for a few designs far from all others.
    assert latent.gap > 0.0
    assert (lost & ~predicted[0.0]).mean() < 0.005
    assert (predicted[1.0] & ~lost).mean() < 0.005
    between = predicted[0.0] & ~predicted[1.0]
    assert 0 < between.sum() < 0.1 * len(fresh)
    assert (predicted[None] == lost)[~between].mean() > 0.995
    side = latent.moments(fresh).side[between]
    assert (np.abs(side) < 1.8).all()  # of a uniform distribution no place is more than √3 standard deviations away


def test_a_margin_that_reaches_0_has_its_boundary_there_though_runs_are_lost() -> None:
    X, _ = drawn(3, 30)
    g = 1.0 - X[:, 0] - 0.2 * X[:, 1] ** 2
    assert ((g <= 0.0) & (g > -1.0)).any()
    latent = MarginLatent(fit_defined(X, np.where(g < -1.0, np.nan, g)))
    assert (latent.gap, latent.threshold, latent.trained.data.level) == (0.0, 0.0, 0.0)


def test_far_beyond_the_margins_their_trend_goes_on() -> None:
    X = np.random.default_rng(11).standard_normal((40, 4))
    far = 6.0 * np.random.default_rng(12).standard_normal((500, 4))

    def margin(F: np.ndarray) -> np.ndarray:
        return 3.0 - F @ np.array([1.0, -0.5, 0.3, 0.2]) + 0.3 * np.sin(2.0 * F[:, 0]) * np.cos(2.0 * F[:, 1])

    mean, _ = warped(fit_margin(X, margin(X)), far)
    failed = margin(far) <= 0.0
    assert 0.2 < failed.mean() < 0.5
    # Without a trend nine of ten failures there are predicted to be safe.
    assert ((mean <= 0.0) != failed).mean() < 0.05


def test_the_warping_follows_the_margins() -> None:
    X = np.random.default_rng(8).standard_normal((40, 2))
    smooth = X[:, 0] + 0.5 * X[:, 1] + 0.3 * X[:, 0] * X[:, 1]
    assert fit_margin(X, smooth).data.warping == "none"
    assert fit_margin(X, np.sinh(3.0 * smooth)).data.warping != "none"


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_the_unit_of_the_margin_does_not_matter(factor: float) -> None:
    one, other = fit_margin(Z, G), fit_margin(Z, factor * G)
    assert one.data.warping == other.data.warping
    np.testing.assert_allclose(warped(one, FRESH)[0], warped(other, FRESH)[0], atol=1e-3)


def test_hyperparameters_are_kept_until_many_margins_are_new() -> None:
    rng = np.random.default_rng(5)
    X = rng.standard_normal((130, 2))
    g = 2.0 - X[:, 0] + 0.2 * X[:, 1] ** 2
    first = fit_margin(X[:110], g[:110])
    few = fit_margin(X[:113], g[:113], warm=first)
    assert few.prior is first.prior
    assert (few.learned_on, len(few.data.margin)) == (110, 113)
    np.testing.assert_allclose(warped(few, X[110:113])[0], few.data.warped(g[110:113]), atol=1e-2)
    assert fit_margin(X, g, warm=first).learned_on == 130


@pytest.mark.parametrize("truncated", [False, True])
def test_with_inducing_points_a_regression_is_that_of_all_points(
    truncated: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, size in (("EXACT", 100), ("LEARNED_ON", 60), ("WARPED_ON", 40), ("INDUCING", 200)):
        monkeypatch.setattr(m, name, size)
    X = np.random.default_rng(9).standard_normal((400, 2)) * 1.6
    g = np.maximum(four_branch(X), 0.0) if truncated else four_branch(X)
    fitted = fit_margin(X, g)
    assert (fitted.data.truncated, fitted.learned_on) == (truncated, 400)
    assert 20 < fitted.data.size_of_support <= 200
    whole = replace(fitted, data=replace(fitted.data, inducing=None))
    (mean, _), (of_all, _) = warped(fitted, FRESH), warped(whole, FRESH)
    assert np.std(mean - of_all) < 0.05 * np.std(of_all)
    of_points = (outcome_score(MarginLatent(one), g <= 0.0) for one in (fitted, whole))
    assert next(of_points) == pytest.approx(next(of_points), abs=0.03)
    assert np.mean((mean <= 0.0) != (four_branch(FRESH) <= 0.0)) < 0.02
    more = fit_margin(np.concatenate([X, FRESH[:5]]), np.concatenate([g, four_branch(FRESH[:5])]), truncated, fitted)
    assert more.prior is fitted.prior


def test_of_too_many_margins_the_nearest_ones_stand_for_all_and_others_evenly_spread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, size in (("EXACT", 40), ("MOST", 100), ("MOST_CENSORED", 15)):
        monkeypatch.setattr(margin_data, name, size)
    g = np.random.default_rng(9).standard_normal(400) + 0.5
    assert informative(g[:40], True).tolist() == list(range(40))
    rows = informative(g, False)
    assert len(rows) == len(np.unique(rows)) == 100
    assert np.isin(np.argsort(np.abs(g))[:50], rows).all()
    censored = g <= 0.0
    rows = informative(g, True)
    assert (censored[rows].sum(), (~censored[rows]).sum()) == (15, 100)
    assert np.isin(np.flatnonzero(~censored)[np.argsort(g[~censored])[:50]], rows).all()


def test_ten_thousand_margins_in_thirty_variables_are_learned_from() -> None:
    X = np.random.default_rng(10).standard_normal((12_000, 30))
    g = 2.0 - X.sum(axis=1) / math.sqrt(30.0) + 0.3 * np.sin(2.0 * X[:, 0])
    fitted = fit_margin(X[:10_000], g[:10_000])
    assert fitted.data.size_of_support == m.INDUCING
    mean, _ = warped(fitted, X[10_000:])
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
    assert not fit_margin(X, g).data.is_clipped
    assert not fit_margin(X, np.minimum(g, top[-2])).data.is_clipped
    assert fit_margin(X, np.minimum(g, top[-3])).data.is_clipped
    # Ties elsewhere, at failure above all, say nothing about the largest margin.
    assert not fit_margin(X, np.maximum(g, top[4])).data.is_clipped
    clipped = np.minimum(g, top[-3])
    assert fit_defined(X, np.where(clipped <= 0.0, np.nan, clipped)).data.is_clipped


def test_a_design_simulated_again_does_not_make_its_margin_a_clipped_one() -> None:
    X, g = drawn(4)
    best = np.full(3, g.argmax())
    assert not fit_margin(np.concatenate([X, X[best]]), np.concatenate([g, g[best]])).data.is_clipped
