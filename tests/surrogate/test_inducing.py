"""The posterior with inducing points is that of all points, but for what it says it loses."""

import math
from dataclasses import replace

import gpytorch
import numpy as np
import pytest
import torch

from activefail.surrogate import fitting, inducing
from activefail.surrogate.classifier import Latent
from activefail.surrogate.covariance import Hyperparameters, prior_covariance
from activefail.surrogate.sites import Projection, Sites, posterior, solve_sites


def points(n, m=3, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, m))
    y = np.where(X[:, 0] + 0.5 * X[:, 1] ** 2 + 0.1 * rng.standard_normal(n) > 0.4, 1.0, -1.0)
    return torch.from_numpy(X), torch.from_numpy(y)


def hyperparameters(m=3, mean=0.3, outputscale=25.0, lengthscale=1.5):
    return Hyperparameters(mean, math.log(outputscale), np.full(m, math.log(lengthscale)))


def uniform_sites(y):
    return Sites(0.1 * y, torch.full_like(y, 0.1))


@pytest.fixture(scope="module")
def many():
    """1,500 points, their exact posterior, and the one with inducing points."""
    F, y = points(1500)
    h = hyperparameters()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "EXACT", 1500)
        exact = fitting.condition(F, y, "matern52", h, tolerance=1e-4)
    return exact, fitting.condition(F, y, "matern52", h, exact.sites, tolerance=1e-4)


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_the_chosen_points_explain_what_dense_algebra_says(kernel):
    F, _ = points(200)
    h = hyperparameters()
    precision = torch.from_numpy(np.random.default_rng(1).uniform(0.0, 0.5, 200))
    rows, prior = inducing.choose(F, precision, kernel, h)
    assert len(set(rows.tolist())) == len(rows) < 200
    K = prior_covariance(F, kernel, h)
    K.diagonal().sub_(fitting.JITTER)
    Z = K[rows][:, rows] + fitting.JITTER * torch.eye(len(rows), dtype=torch.float64)
    explained = K[:, rows] @ torch.linalg.solve(Z, K[rows])
    assert torch.allclose(prior.whitened.T @ prior.whitened, explained, atol=1e-5)
    assert torch.allclose(prior.rest, (K - explained).diagonal() + fitting.JITTER, atol=1e-5)
    assert float(precision @ prior.rest) <= inducing.LEFT
    repeated = inducing.project(F, rows, kernel, h)
    assert torch.allclose(repeated.whitened, prior.whitened, atol=1e-6)


def test_points_are_added_beside_those_that_are_kept():
    F, y = points(300)
    h = hyperparameters()
    few, _ = inducing.choose(F, torch.full_like(y, 0.3), "matern52", h, most=40)
    extra, prior = inducing.choose(F, torch.full_like(y, 0.3), "matern52", h, few)
    assert extra[: len(few)].tolist() == few.tolist()
    assert len(extra) > len(few)
    assert torch.allclose(prior.rest, inducing.project(F, extra, "matern52", h).rest, atol=1e-8)


def test_with_every_point_an_inducing_one_nothing_is_lost():
    F, y = points(60)
    h = hyperparameters()
    K = prior_covariance(F, "matern52", h)
    sites = Sites(torch.from_numpy(np.random.default_rng(1).standard_normal(60)), torch.full_like(y, 0.4))
    dense = posterior(K, h.mean, y, sites)
    projected = posterior(inducing.project(F, torch.arange(60), "matern52", h), h.mean, y, sites)
    assert torch.allclose(projected.mean, dense.mean, atol=1e-4)
    assert torch.allclose(projected.variance, dense.variance, atol=1e-4)
    assert projected.elbo == pytest.approx(dense.elbo, abs=1e-3)


def test_the_posterior_with_inducing_points_is_the_exact_one_but_for_a_fraction_of_a_nat(many):
    exact, projected = many
    assert len(projected.inducing) < 500
    assert exact.elbo - 0.5 < projected.elbo < exact.elbo + 1e-3
    fresh, y = points(4000, seed=9)
    one, other = (Latent(trained).moments(fresh.numpy()) for trained in (exact, projected))
    assert np.abs(one.probability - other.probability).max() < 0.02
    assert (np.abs(one.mean - other.mean) < 0.3 * one.sd).all()
    right = [np.mean((moments.mean > 0.0) == (y.numpy() > 0.0)) for moments in (one, other)]
    assert abs(right[0] - right[1]) < 0.002


def test_weights_by_precision_save_more_of_the_bound_than_as_many_points_without(many):
    exact, _ = many
    F, y, h = exact.features, exact.labels, exact.hyperparameters

    def bound(precision):
        _, prior = inducing.choose(F, precision, "matern52", h, most=100)
        return solve_sites(prior, h.mean, y, exact.sites, 1e-2)[1].elbo

    assert exact.elbo - bound(exact.sites.precision) < 0.5 * (exact.elbo - bound(torch.ones_like(y)))


def test_gpytorch_sees_the_posterior_and_the_bound_of_the_inducing_points(many):
    _, trained = many
    latent, fresh = Latent(trained), points(200, seed=5)[0]
    seen = latent.model.model(fresh)
    moments = latent.moments(fresh.numpy())
    assert moments.mean == pytest.approx(seen.mean.detach().numpy(), abs=1e-4)
    assert moments.sd**2 == pytest.approx(seen.variance.detach().numpy(), abs=1e-4)
    mean, covariance = latent.joint(fresh.numpy())
    assert mean == pytest.approx(seen.mean.detach().numpy(), abs=1e-4)
    assert covariance == pytest.approx(seen.covariance_matrix.detach().numpy(), abs=1e-4)
    model = latent.model.model.train()
    terms = gpytorch.mlls.VariationalELBO(
        gpytorch.likelihoods.BernoulliLikelihood(), model, num_data=1500, combine_terms=False
    )
    expected_log_likelihood, divergence, *_ = terms(model(trained.features), (trained.labels > 0).double())
    assert 1500 * float(expected_log_likelihood - divergence) == pytest.approx(trained.elbo, abs=0.1)


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_the_objective_with_inducing_points_has_the_gradient_that_it_states(kernel):
    F, y = points(60)
    rows = torch.arange(0, 60, 4)
    at = fitting.pack(hyperparameters())

    def value(packed):
        return fitting.evaluate(kernel, fitting.unpack(packed), F, y, uniform_sites(y), 1e-12, rows)

    step = 1e-4
    numerical = [(value(at + step * e).value - value(at - step * e).value) / (2 * step) for e in np.eye(len(at))]
    assert value(at).gradient == pytest.approx(numerical, rel=1e-4, abs=1e-4)


@pytest.mark.exhaustive
def test_hyperparameters_learned_with_inducing_points_are_as_good_as_those_learned_without(monkeypatch):
    F, y = points(400, seed=3)
    learned = fitting.fit(F, y, "matern52")
    monkeypatch.setattr(fitting, "COARSE", 400)
    exact = fitting.fit(F, y, "matern52")
    assert learned.inducing is None
    assert learned.elbo == pytest.approx(exact.elbo, abs=0.5)


def test_points_that_come_later_are_learned_without_choosing_everything_anew(many):
    _, trained = many
    extra, labels = points(10, seed=11)
    F, y = torch.cat([trained.features, extra]), torch.cat([trained.labels, labels])
    warm = fitting.fit(F, y, "matern52", replace(trained, learned_on=1500))
    cold = fitting.condition(F, y, "matern52", trained.hyperparameters, warm.sites)
    assert warm.evaluations == 0
    assert warm.inducing[: len(trained.inducing)].tolist() == trained.inducing.tolist()
    assert warm.elbo == pytest.approx(cold.elbo, abs=0.1)


@pytest.mark.parametrize("part", [None, 600])
def test_scales_that_a_part_of_the_points_calls_for_are_not_taken_where_they_are_worse_for_all(many, monkeypatch, part):
    """Judged by all points, or by a part of many that is larger than what they were learned on."""
    _, trained = many
    if part:
        monkeypatch.setattr(fitting, "EXACT", part - 100)
        monkeypatch.setattr(fitting, "HALFWAY", part)
    before = replace(trained, learned_on=1000)
    poor = replace(trained, hyperparameters=hyperparameters(lengthscale=0.2), learned_on=1500)
    monkeypatch.setattr(fitting, "learn", lambda *_: poor)
    repeated = fitting.fit(trained.features, trained.labels, "matern52", before)
    assert repeated.hyperparameters is trained.hyperparameters
    assert repeated.learned_on == 1500
    monkeypatch.setattr(fitting, "learn", lambda *_: before)
    better = fitting.fit(trained.features, trained.labels, "matern52", replace(poor, learned_on=1000))
    assert better.hyperparameters is trained.hyperparameters
    assert better.elbo == pytest.approx(repeated.elbo, abs=0.5)


def test_a_point_left_out_is_as_if_its_site_were_not_there():
    F, y = points(80)
    h, rows = hyperparameters(), torch.arange(0, 80, 3)
    prior = inducing.project(F, rows, "matern52", h)
    sites, state = solve_sites(prior, h.mean, y, uniform_sites(y), 1e-8)
    trained = fitting.Fit("matern52", F, y, h, sites, state.elbo, 0, 80, rows)
    left_out = Latent(trained).left_out()
    for i in (0, 7, 41):
        others = torch.arange(80) != i
        rest = Projection(prior.whitened[:, others], prior.rest[others])
        without = posterior(rest, h.mean, y[others], Sites(*(site[others] for site in sites)))
        V = prior.whitened[:, i]
        T = torch.linalg.solve_triangular(without.cholesky_b, V.unsqueeze(1), upper=False)
        assert left_out.mean[i] == pytest.approx(float(h.mean + V @ without.alpha), abs=1e-6)
        assert left_out.sd[i] ** 2 == pytest.approx(float(prior.rest[i] + (T * T).sum()), rel=1e-6)
