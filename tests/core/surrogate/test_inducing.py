"""The posterior with inducing points is that of all points, but for what it says it loses."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from surrogate.labelled import MATERN52, first_sites, points, prior

from activefail.learning.model import fitting, inducing
from activefail.learning.model.fitting import Fit, condition, fit
from activefail.learning.model.latent import Latent
from activefail.learning.model.likelihoods import Probit
from activefail.learning.model.sites import Projection, Sites, Whole, posterior, solve_sites

points = partial(points, m=3, noise=0.1)
PRIOR = prior("matern52", 3, outputscale=25.0, lengthscale=1.5)


@pytest.fixture(scope="module")
def many():
    """1,500 points, their exact posterior, and the one with inducing points."""
    F, y = points(1500)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "EXACT", 1500)
        exact = condition(PRIOR, F, y, tolerance=1e-4)
    return exact, condition(PRIOR, F, y, exact.sites, tolerance=1e-4)


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_the_chosen_points_explain_what_dense_algebra_says(kernel):
    (F, _), of = points(200), prior(kernel, 3, outputscale=25.0, lengthscale=1.5)
    precision = torch.from_numpy(np.random.default_rng(1).uniform(0.0, 0.5, 200))
    rows, projection = inducing.choose(of, F, precision)
    assert len(set(rows.tolist())) == len(rows) < 200
    K = of.covariance(F)
    explained = K[:, rows] @ torch.linalg.solve(inducing.jittered(K[rows][:, rows]), K[rows])
    assert torch.allclose(projection.whitened.T @ projection.whitened, explained, atol=1e-5)
    assert torch.allclose(projection.rest, (K - explained).diagonal() + fitting.JITTER, atol=1e-5)
    assert float(precision @ projection.rest) <= inducing.LEFT
    assert torch.allclose(inducing.project(of, F, rows).whitened, projection.whitened, atol=1e-6)


def test_points_are_added_beside_those_that_are_kept():
    F, y = points(300)
    few, _ = inducing.choose(PRIOR, F, torch.full_like(y, 0.3), most=40)
    extra, projection = inducing.choose(PRIOR, F, torch.full_like(y, 0.3), few)
    assert extra[: len(few)].tolist() == few.tolist()
    assert len(extra) > len(few)
    assert torch.allclose(projection.rest, inducing.project(PRIOR, F, extra).rest, atol=1e-8)


def test_with_every_point_an_inducing_one_nothing_is_lost():
    F, y = points(60)
    sites = Sites(torch.from_numpy(np.random.default_rng(1).standard_normal(60)), torch.full_like(y, 0.4))
    whole = Whole(PRIOR.mean_module(F), inducing.jittered(PRIOR.covariance(F)))
    projected = inducing.project(PRIOR, F, torch.arange(60))
    one, other = (posterior(at, Probit(), y, sites) for at in (whole, projected))
    assert torch.allclose(other.mean, one.mean, atol=1e-4)
    assert torch.allclose(other.variance, one.variance, atol=1e-4)
    assert other.elbo == pytest.approx(one.elbo, abs=1e-3)


def test_the_posterior_with_inducing_points_is_the_exact_one_but_for_a_fraction_of_a_nat(many):
    exact, projected = many
    assert len(projected.inducing) < 500
    assert exact.elbo - 0.5 < projected.elbo < exact.elbo + 1e-3
    fresh, y = points(4000, seed=9)
    one, other = (Latent(trained).moments(fresh.numpy()) for trained in (exact, projected))
    assert np.abs(one.probability - other.probability).max() < 0.02
    assert (np.abs(one.mean - other.mean) < 0.3 * one.sd).all()
    right = [np.mean((moments.mean > 0.0) == (y.numpy() > 0.5)) for moments in (one, other)]
    assert abs(right[0] - right[1]) < 0.002


def test_weights_by_precision_save_more_of_the_bound_than_as_many_points_without(many):
    exact, _ = many

    def bound(precision):
        _, projection = inducing.choose(PRIOR, exact.features, precision, most=100)
        return solve_sites(projection, Probit(), exact.labels, exact.sites, 1e-2)[1].elbo

    without = torch.ones_like(exact.labels)
    assert exact.elbo - bound(exact.sites.precision) < 0.5 * (exact.elbo - bound(without))


@pytest.mark.exhaustive
def test_hyperparameters_learned_with_inducing_points_are_as_good_as_those_learned_without(monkeypatch):
    F, y = points(400, seed=3)
    learned = fit(F, y, MATERN52.default_prior)
    monkeypatch.setattr(fitting, "COARSE", 400)
    assert learned.inducing is None
    assert learned.elbo == pytest.approx(fit(F, y, MATERN52.default_prior).elbo, abs=0.5)


def test_points_that_come_later_are_learned_without_choosing_everything_anew(many):
    _, trained = many
    extra, labels = points(10, seed=11)
    F, y = torch.cat([trained.features, extra]), torch.cat([trained.labels, labels])
    warm = fit(F, y, MATERN52.default_prior, replace(trained, learned_on=1500))
    assert warm.prior is PRIOR
    assert warm.inducing[: len(trained.inducing)].tolist() == trained.inducing.tolist()
    assert warm.elbo == pytest.approx(condition(PRIOR, F, y, warm.sites).elbo, abs=0.1)


@pytest.mark.parametrize("part", [None, 600])
def test_scales_that_a_part_of_the_points_calls_for_are_not_taken_where_they_are_worse_for_all(many, monkeypatch, part):
    """Judged by all points, or by a part of many that is larger than what they were learned on."""
    _, trained = many
    if part:
        monkeypatch.setattr(fitting, "EXACT", part - 100)
        monkeypatch.setattr(fitting, "HALFWAY", part)
    data = trained.features, trained.labels, MATERN52.default_prior
    before = replace(trained, learned_on=1000)
    poor = replace(trained, prior=prior("matern52", 3, outputscale=25.0, lengthscale=0.2), learned_on=1500)
    monkeypatch.setattr(fitting, "learn", lambda *_: poor)
    repeated = fit(*data, before)
    assert repeated.prior is PRIOR
    assert repeated.learned_on == 1500
    monkeypatch.setattr(fitting, "learn", lambda *_: before)
    better = fit(*data, replace(poor, learned_on=1000))
    assert better.prior is PRIOR
    assert better.elbo == pytest.approx(repeated.elbo, abs=0.5)


def test_a_point_left_out_is_as_if_its_site_were_not_there():
    F, y = points(80)
    rows = torch.arange(0, 80, 3)
    projection = inducing.project(PRIOR, F, rows)
    sites, state = solve_sites(projection, Probit(), y, first_sites(y), 1e-8)
    left_out = Latent(Fit(PRIOR, F, y, sites, state.elbo, 80, rows)).left_out()
    for i in (0, 7, 41):
        others = torch.arange(80) != i
        rest = Projection(projection.mean[others], projection.whitened[:, others], projection.rest[others])
        without = posterior(rest, Probit(), y[others], Sites(*(site[others] for site in sites)))
        V = projection.whitened[:, i]
        T = torch.linalg.solve_triangular(without.factor, V.unsqueeze(1), upper=False)
        assert left_out.mean[i] == pytest.approx(float(projection.mean[i] + V @ without.alpha), abs=1e-6)
        assert left_out.sd[i] ** 2 == pytest.approx(float(projection.rest[i] + (T * T).sum()), rel=1e-6)
