import math
from functools import partial
from unittest import mock

import numpy as np
import pytest
import torch
from cases import some
from scipy.optimize import minimize
from surrogate.labelled import (
    MATERN52,
    RBF,
    Mislabelled,
    first_sites,
    flattened,
    numerical_gradient,
    points,
    prior,
    two_scales,
)
from surrogate.sampling import elliptical_slice_sampling

from activefail.learning.model import fitting
from activefail.learning.model import sites as sites_module
from activefail.learning.model.fitting import condition, fit, objective_gradient, outcome_prior
from activefail.learning.model.inducing import jittered
from activefail.learning.model.latent import Latent
from activefail.learning.model.likelihoods import Probit, expectations
from activefail.learning.model.sites import Sites, Whole, posterior, solve_sites


def whole(of, F):
    return Whole(of.mean_module(F), jittered(of.covariance(F)))


def test_the_posterior_of_given_sites_and_its_bound_are_those_of_dense_algebra():
    F, y = points(12)
    rng = np.random.default_rng(1)
    sites = Sites(torch.from_numpy(rng.standard_normal(12)), torch.from_numpy(rng.uniform(0.01, 2.0, 12)))
    at = whole(prior(), F)
    state = posterior(at, Probit(), y, sites)

    S = torch.linalg.inv(torch.linalg.inv(at.K) + torch.diag(sites.precision))
    mean = S @ (torch.linalg.solve(at.K, at.mean) + sites.linear)
    assert torch.allclose(state.mean, mean, atol=1e-7)
    assert torch.allclose(state.variance, S.diagonal(), atol=1e-7)
    normal = torch.distributions.MultivariateNormal
    divergence = torch.distributions.kl_divergence(normal(mean, S), normal(at.mean, at.K))
    bound = expectations(Probit(), y, mean, S.diagonal())[0].sum() - divergence
    assert state.elbo == pytest.approx(float(bound), abs=1e-5)


def test_the_sites_find_the_best_of_all_gaussians():
    F, y = points(4, seed=3)
    at, trained = whole(prior(), F), condition(prior(), F, y, tolerance=1e-10)
    of = torch.distributions.MultivariateNormal(*at)
    rows, columns = np.tril_indices(4)

    def negative_bound(packed):
        values = torch.tensor(packed, dtype=torch.float64, requires_grad=True)
        L = torch.zeros(4, 4, dtype=torch.float64).index_put((torch.tensor(rows), torch.tensor(columns)), values[4:])
        q = torch.distributions.MultivariateNormal(values[:4], scale_tril=L, validate_args=False)
        # Without the closed form, which has no derivative by torch.
        expected = Probit().expected_log_prob(y, torch.distributions.Normal(values[:4], L.square().sum(1).sqrt())).sum()
        loss = torch.distributions.kl_divergence(q, of) - expected
        loss.backward()
        return float(loss.detach()), values.grad.numpy()

    start = np.concatenate([np.zeros(4), np.eye(4)[rows, columns]])
    # The diagonal of L stays positive; everything else is free.
    bounds = [(None, None)] * 4 + [(1e-3, None) if i == j else (None, None) for i, j in zip(rows, columns, strict=True)]
    best = minimize(negative_bound, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 2000})
    assert trained.elbo == pytest.approx(-best.fun, abs=1e-3)


def test_the_sites_converge_where_a_fixed_damping_circles():
    F, y = points(150, seed=5)
    trained = condition(prior(outputscale=5000.0, lengthscale=2.0), F, y, tolerance=1e-8)
    state = trained.posterior
    _, gradient, curvature = expectations(Probit(), y, state.mean, state.variance)
    assert torch.allclose(trained.sites.precision, curvature, rtol=1e-2, atol=1e-5)
    assert torch.allclose(trained.sites.linear, gradient + curvature * state.mean, rtol=1e-2, atol=1e-4)


def test_the_sites_keep_the_best_bound_where_a_likelihood_is_not_log_concave(monkeypatch):
    F, y = points(40, noise=0.0)
    y[::6] = 1.0 - y[::6]
    at = whole(prior(outputscale=100.0), F)
    states = mock.Mock(wraps=posterior)
    monkeypatch.setattr(sites_module, "posterior", states)
    found = solve_sites(at, Mislabelled().double().requires_grad_(False), y, first_sites(y), 1e-5)[1]
    bounds = [posterior(*call.args).elbo for call in states.call_args_list]
    assert found.elbo > max(bounds) - 1e-5
    assert len(bounds) < 60  # it ends where no step raises the bound


PRIORS = {
    "rbf": prior,
    "matern52": partial(prior, "matern52"),
    "custom": lambda: outcome_prior(two_scales, 2),
    "learned likelihood": lambda: outcome_prior("rbf", 2, Mislabelled),
}


@pytest.mark.parametrize("inducing", [False, True])
@pytest.mark.parametrize("name", PRIORS)
def test_the_objective_has_the_gradient_that_it_states(name, inducing):
    F, y = points(40)
    of, rows = PRIORS[name]().requires_grad_(True), torch.arange(0, 40, 3) if inducing else None
    value = partial(objective_gradient, of, F, y, first_sites(y), 1e-12, rows)
    gradient = numerical_gradient(of, lambda: value()[0])
    assert flattened(value()[1]) == pytest.approx(gradient, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("make", [RBF.default_prior, MATERN52.default_prior])
def test_training_ends_where_no_hyperparameter_can_be_bettered(make):
    F, y = points(80, seed=2)
    trained = fit(F, y, make, tolerance=1e-4)
    best = condition(trained.prior, F, y, tolerance=1e-8).objective
    for parameter in trained.prior.parameters():
        for i in range(parameter.numel()):
            start = float(parameter.view(-1)[i])
            for step in (0.2, -0.2):
                parameter.view(-1)[i] = start + step
                assert condition(trained.prior, F, y, trained.sites, tolerance=1e-8).objective < best + 1e-3
            parameter.view(-1)[i] = start


def test_a_custom_kernel_and_a_learned_share_of_wrong_labels_are_learned():
    F, y = points(60, noise=0.0)
    custom = fit(F, y, partial(outcome_prior, two_scales))
    assert np.mean((Latent(custom).moments(F.numpy()).mean > 0.0) == (y.numpy() > 0.5)) > 0.95
    y[::6] = 1.0 - y[::6]
    noisy = fit(F, y, partial(outcome_prior, "rbf", likelihood=Mislabelled))
    assert 0.05 < noisy.prior.likelihood.share.item() < 0.3


@pytest.mark.exhaustive
def test_a_warm_start_reaches_the_optimum_of_a_cold_one_in_fewer_evaluations(monkeypatch):
    evaluate, counted = mock.Mock(wraps=objective_gradient), {"warm": 0, "cold": 0}
    monkeypatch.setattr(fitting, "objective_gradient", evaluate)
    for seed in range(4, 10):  # one alone can be lucky
        F, y = points(120, seed=seed)
        before, objectives = fit(F[:110], y[:110], RBF.default_prior), []
        for start, warm in (("warm", before), ("cold", None)):
            evaluate.reset_mock()
            objectives.append(fit(F, y, RBF.default_prior, warm).elbo)
            counted[start] += evaluate.call_count
        assert objectives[0] == pytest.approx(objectives[1], abs=0.05)
    assert counted["warm"] < 0.75 * counted["cold"]


def test_one_class_alone_is_learned_as_certain_near_the_points():
    F, _ = points(30)
    trained = fit(F, torch.ones(30, dtype=torch.float64), RBF.default_prior)
    assert (Latent(trained).moments(F.numpy()).probability > 0.9).all()


def test_a_left_out_point_is_predicted_as_by_a_posterior_of_the_others_sites():
    F, y = points(25)
    trained = fit(F, y, RBF.default_prior)
    left_out = Latent(trained).left_out()
    (prior_mean, K), (b, W) = (tuple(one.numpy() for one in of) for of in (trained.prior_at_points, trained.sites))
    for i in (0, 7, 24):
        others = np.arange(25) != i
        # Regression on the pseudo-observations b/W with noise 1/W.
        noisy = K[np.ix_(others, others)] + np.diag(1.0 / W[others])
        gain = np.linalg.solve(noisy, K[others, i])
        expected = prior_mean[i] + gain @ (b[others] / W[others] - prior_mean[others])
        assert left_out.mean[i] == pytest.approx(expected, rel=1e-5, abs=1e-6)
        assert left_out.sd[i] ** 2 == pytest.approx(K[i, i] - gain @ K[others, i], rel=1e-4)


@pytest.mark.parametrize(
    ("outputscale", "mean_error", "sd_loss"), some([(1.0, 0.02, 0.02), (4.0, 0.03, 0.07)], (1.0, 0.02, 0.02))
)
def test_the_variational_posterior_lies_near_that_of_a_long_markov_chain(outputscale, mean_error, sd_loss):
    F, y = points(25, seed=4)
    trained = condition(prior(outputscale=outputscale), F, y, tolerance=1e-8)
    K = trained.prior_at_points.K.numpy()
    samples = elliptical_slice_sampling(K, 0.3, 2.0 * y.numpy() - 1.0, 1000, 350, np.random.default_rng(0))[100:]
    mean, sd = samples.mean((0, 1)), samples.std((0, 1))
    # Of the means of independent chains: the error of the reference itself.
    assert (samples.mean(0).std(0) / math.sqrt(samples.shape[1]) < 0.01 * sd).all()
    state = trained.posterior
    assert (np.abs(state.mean.numpy() - mean) < mean_error * sd).all()
    # The best Gaussian by KL(q‖p) is never wider than the skewed posterior, and little narrower.
    ratio = state.variance.sqrt().numpy() / sd
    assert (ratio < 1.01).all()
    assert (ratio > 1.0 - sd_loss).all()


def test_the_posterior_of_more_points_than_are_learned_on_is_that_of_all(monkeypatch):
    monkeypatch.setattr(fitting, "LEARNED_ON", 60)
    F, y = points(150, noise=0.0)
    trained = fit(F, y, MATERN52.default_prior)
    assert (len(trained.labels), trained.learned_on, trained.inducing) == (150, 150, None)
    assert trained.elbo == pytest.approx(condition(trained.prior, F, y).elbo, abs=1e-3)
