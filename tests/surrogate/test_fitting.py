import math

import gpytorch
import numpy as np
import pytest
import torch
from cases import some
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import norm
from surrogate.sampling import elliptical_slice_sampling

from activefail.surrogate import fitting
from activefail.surrogate.classifier import Latent
from activefail.surrogate.fitting import Hyperparameters, Sites


def points(n, m=2, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, m))
    y = np.where(X[:, 0] + 0.5 * X[:, 1] ** 2 + 0.3 * rng.standard_normal(n) > 0.4, 1.0, -1.0)
    return torch.from_numpy(X), torch.from_numpy(y)


def hyperparameters(m=2, mean=0.3, outputscale=9.0, lengthscale=1.3):
    return Hyperparameters(mean, math.log(outputscale), np.full(m, math.log(lengthscale)))


@pytest.mark.parametrize("label", [1.0, -1.0])
@pytest.mark.parametrize(("mean", "sd"), [(0.0, 1.0), (2.5, 0.3), (-4.0, 2.0), (30.0, 3.0)])
def test_the_probit_expectations_are_those_of_adaptive_quadrature(label, mean, sd):
    def expectation(function):
        return quad(lambda f: function(f) * norm.pdf(f, mean, sd), mean - 12 * sd, mean + 12 * sd, limit=400)[0]

    def ratio(f):
        return np.exp(norm.logpdf(f) - norm.logcdf(label * f))

    expected = (
        expectation(lambda f: norm.logcdf(label * f)),
        expectation(lambda f: label * ratio(f)),
        expectation(lambda f: ratio(f) * (ratio(f) + label * f)),
    )
    tensors = (torch.tensor([value], dtype=torch.float64) for value in (label, mean, sd**2))
    got = [float(value) for value in fitting.probit_expectations(*tensors)]
    # 20 nodes over a latent four times as wide as the likelihood's step.
    assert got == pytest.approx(expected, rel=5e-4, abs=1e-9)


def test_the_posterior_of_given_sites_and_its_bound_are_those_of_dense_algebra():
    F, y = points(12)
    h = hyperparameters()
    rng = np.random.default_rng(1)
    sites = Sites(torch.from_numpy(rng.standard_normal(12)), torch.from_numpy(rng.uniform(0.01, 2.0, 12)))
    K = fitting.prior_covariance(F, "rbf", h)
    state = fitting.posterior(K, h.mean, y, sites)

    S = torch.linalg.inv(torch.linalg.inv(K) + torch.diag(sites.precision))
    prior = torch.full((12,), h.mean, dtype=torch.float64)
    mean = S @ (torch.linalg.solve(K, prior) + sites.linear)
    assert torch.allclose(state.mean, mean, atol=1e-7)
    assert torch.allclose(state.variance, S.diagonal(), atol=1e-7)
    normal = torch.distributions.MultivariateNormal
    divergence = torch.distributions.kl_divergence(normal(mean, S), normal(prior, K))
    bound = fitting.probit_expectations(y, mean, S.diagonal())[0].sum() - divergence
    assert state.elbo == pytest.approx(float(bound), abs=1e-5)


def test_the_sites_find_the_best_of_all_gaussians():
    F, y = points(4, seed=3)
    h = hyperparameters()
    K = fitting.prior_covariance(F, "rbf", h)
    trained = fitting.condition(F, y, "rbf", h, tolerance=1e-10)
    prior = torch.distributions.MultivariateNormal(torch.full((4,), h.mean, dtype=torch.float64), K)
    rows, columns = np.tril_indices(4)

    def negative_bound(packed):
        values = torch.tensor(packed, dtype=torch.float64, requires_grad=True)
        L = torch.zeros(4, 4, dtype=torch.float64).index_put((torch.tensor(rows), torch.tensor(columns)), values[4:])
        q = torch.distributions.MultivariateNormal(values[:4], scale_tril=L, validate_args=False)
        expected = fitting.probit_expectations(y, values[:4], (L * L).sum(1))[0].sum()
        loss = torch.distributions.kl_divergence(q, prior) - expected
        loss.backward()
        return float(loss.detach()), values.grad.numpy()

    start = np.concatenate([np.zeros(4), np.eye(4)[rows, columns]])
    # The diagonal of L stays positive; everything else is free.
    bounds = [(None, None)] * 4 + [(1e-3, None) if i == j else (None, None) for i, j in zip(rows, columns, strict=True)]
    best = minimize(negative_bound, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 2000})
    assert trained.elbo == pytest.approx(-best.fun, abs=1e-5)


def test_the_sites_converge_where_a_fixed_damping_circles():
    F, y = points(150, seed=5)
    h = hyperparameters(outputscale=5000.0, lengthscale=2.0)
    trained = fitting.condition(F, y, "rbf", h, tolerance=1e-8)
    K = fitting.prior_covariance(F, "rbf", h)
    state = fitting.posterior(K, h.mean, y, trained.sites)
    _, gradient, curvature = fitting.probit_expectations(y, state.mean, state.variance)
    assert torch.allclose(trained.sites.precision, curvature, rtol=1e-2, atol=1e-5)
    assert torch.allclose(trained.sites.linear, gradient + curvature * state.mean, rtol=1e-2, atol=1e-4)


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_the_objective_has_the_gradient_that_it_states(kernel):
    F, y = points(40)
    at = fitting.pack(hyperparameters())
    sites = Sites(0.1 * y, torch.full_like(y, 0.1))

    def value(packed):
        return fitting.evaluate(kernel, fitting.unpack(packed), F, y, sites, 1e-12)

    step = 1e-4
    numerical = [(value(at + step * e).value - value(at - step * e).value) / (2 * step) for e in np.eye(len(at))]
    assert value(at).gradient == pytest.approx(numerical, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_training_ends_where_no_hyperparameter_can_be_bettered(kernel):
    F, y = points(80, seed=2)
    trained = fitting.fit(F, y, kernel, tolerance=1e-4)
    best = fitting.pack(trained.hyperparameters)

    def value(packed):
        return fitting.evaluate(kernel, fitting.unpack(packed), F, y, trained.sites, 1e-8).value

    for direction in np.vstack([np.eye(len(best)), -np.eye(len(best))]):
        assert value(best + 0.2 * direction) < value(best) + 1e-3


@pytest.mark.exhaustive
def test_a_warm_start_reaches_the_optimum_of_a_cold_one_in_fewer_evaluations():
    evaluations = {"warm": 0, "cold": 0}
    for seed in range(4, 10):  # one alone can be lucky
        F, y = points(120, seed=seed)
        before = fitting.fit(F[:110], y[:110], "rbf")
        warm, cold = fitting.fit(F, y, "rbf", warm=before), fitting.fit(F, y, "rbf")
        assert warm.elbo == pytest.approx(cold.elbo, abs=0.05)
        evaluations["warm"] += warm.evaluations
        evaluations["cold"] += cold.evaluations
    assert evaluations["warm"] < 0.75 * evaluations["cold"]


@pytest.mark.parametrize("kernel", ["rbf", "matern52"])
def test_gpytorch_sees_the_same_posterior_and_the_same_bound(kernel):
    F, y = points(60)
    trained = fitting.fit(F, y, kernel)
    state = fitting.posterior(
        fitting.prior_covariance(F, kernel, trained.hyperparameters), trained.hyperparameters.mean, y, trained.sites
    )
    moments = Latent(trained).moments(F.numpy())
    assert moments.mean == pytest.approx(state.mean.numpy(), abs=1e-3)
    assert moments.sd**2 == pytest.approx(state.variance.numpy(), abs=1e-3)
    seen = Latent(trained).model.model(F)
    assert moments.mean == pytest.approx(seen.mean.detach().numpy(), abs=1e-5)
    assert moments.sd**2 == pytest.approx(seen.variance.detach().numpy(), abs=1e-5)

    model = Latent(trained).model.model.train()
    likelihood = gpytorch.likelihoods.BernoulliLikelihood()
    terms = gpytorch.mlls.VariationalELBO(likelihood, model, num_data=60, combine_terms=False)
    expected_log_likelihood, divergence, *_ = terms(model(F), (y > 0).double())
    assert 60 * float(expected_log_likelihood - divergence) == pytest.approx(trained.elbo, abs=0.05)


def test_gpytorch_cannot_better_the_bound_by_training_on():
    F, y = points(60)
    trained = fitting.fit(F, y, "rbf", tolerance=1e-5)
    model = Latent(trained).model.model.train()
    variational = model.variational_strategy._variational_distribution
    bound = gpytorch.mlls.VariationalELBO(gpytorch.likelihoods.BernoulliLikelihood(), model, num_data=60)
    parameters = [variational.variational_mean, variational.chol_variational_covar]
    for parameter in parameters:
        parameter.requires_grad_(True)
    optimizer = torch.optim.LBFGS(parameters, max_iter=100, line_search_fn="strong_wolfe")

    def loss():
        optimizer.zero_grad()
        value = -60 * bound(model(F), (y > 0).double())
        value.backward()
        return value

    before = -float(loss().detach())
    optimizer.step(loss)
    assert -float(loss().detach()) - before < 0.01


def test_one_class_alone_is_learned_as_certain_near_the_points():
    F, _ = points(30)
    trained = fitting.fit(F, torch.ones(30, dtype=torch.float64), "rbf")
    assert (Latent(trained).moments(F.numpy()).probability > 0.9).all()


def test_an_unknown_covariance_is_refused():
    with pytest.raises(ValueError, match="rbf or matern52"):
        fitting.fit(*points(20), "cubic")


@pytest.mark.parametrize(
    ("outputscale", "mean_error", "sd_loss"), some([(1.0, 0.02, 0.02), (4.0, 0.03, 0.07)], (1.0, 0.02, 0.02))
)
def test_the_variational_posterior_lies_near_that_of_a_long_markov_chain(outputscale, mean_error, sd_loss):
    F, y = points(25, seed=4)
    h = hyperparameters(outputscale=outputscale)
    trained = fitting.condition(F, y, "rbf", h, tolerance=1e-8)
    samples = elliptical_slice_sampling(
        fitting.prior_covariance(F, "rbf", h).numpy(), h.mean, y.numpy(), 1000, 350, np.random.default_rng(0)
    )[100:]
    mean, sd = samples.mean((0, 1)), samples.std((0, 1))
    # Of the means of independent chains: the error of the reference itself.
    assert (samples.mean(0).std(0) / math.sqrt(samples.shape[1]) < 0.01 * sd).all()
    state = trained.posterior
    assert (np.abs(state.mean.numpy() - mean) < mean_error * sd).all()
    # The best Gaussian by KL(q‖p) is never wider than the skewed posterior, and little narrower.
    ratio = state.variance.sqrt().numpy() / sd
    assert (ratio < 1.01).all()
    assert (ratio > 1.0 - sd_loss).all()
