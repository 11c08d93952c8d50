"""The model of a boundary is GPyTorch's, and conditioning it on designs in flight is the textbook's."""

import gc
import weakref

import gpytorch
import numpy as np
import pytest
import torch
from botorch.acquisition.active_learning import qNegIntegratedPosteriorVariance
from botorch.exceptions.errors import UnsupportedError
from surrogate.labelled import MATERN52, RBF, points, prior

from activefail.learning.model.boundary_gp import SiteStrategy, fantasised, joint, marginal, moments
from activefail.learning.model.fitting import condition, fit
from activefail.learning.model.inducing import jittered
from activefail.learning.model.latent import Latent
from activefail.learning.model.likelihoods import expected_precision
from activefail.learning.model.margin import MarginLatent, fit_margin

FRESH = points(30, seed=9)[0]


def exact(monkeypatch):
    F, y = points(60)
    return condition(prior(outputscale=4.0), F, y, tolerance=1e-8)


def projected(monkeypatch):
    monkeypatch.setattr("activefail.learning.model.fitting.EXACT", 100)
    F, y = points(300, noise=0.1)
    return condition(prior("matern52", outputscale=25.0), F, y, tolerance=1e-6)


class Stock(gpytorch.models.ApproximateGP):
    """GPyTorch's own whitened variational GP at the optimum that a model has."""

    def __init__(self, model):
        strategy, of = model.strategy, model.strategy.prior
        Z = strategy.support
        L = torch.linalg.cholesky(jittered(of.covar_module(Z).to_dense()))
        shrunk = strategy.root @ L
        S = torch.eye(len(Z), dtype=Z.dtype) - shrunk.T @ shrunk
        distribution = gpytorch.variational.CholeskyVariationalDistribution(len(Z), mean_init_std=0.0).double()
        distribution.initialize_variational_distribution(
            gpytorch.distributions.MultivariateNormal(L.T @ strategy.weights, S)
        )
        super().__init__(
            gpytorch.variational.VariationalStrategy(
                self, Z, distribution, learn_inducing_locations=False, jitter_val=strategy.added
            )
        )
        self.variational_strategy.variational_params_initialized.fill_(1)
        self.mean_module, self.covar_module = of.mean_module, of.covar_module

    def forward(self, x):
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


@pytest.mark.parametrize("trained", [exact, projected])
def test_gpytorchs_own_strategy_gives_the_same_posterior_and_the_same_bound(trained, monkeypatch):
    fitted = trained(monkeypatch)
    stock, (mean, sd) = Stock(fitted.model).eval(), fitted.model.moments(FRESH)
    posterior = stock(FRESH)
    assert torch.allclose(posterior.mean, mean, rtol=1e-8, atol=1e-8)
    assert torch.allclose(posterior.variance, sd**2, rtol=1e-8, atol=1e-8)
    assert torch.allclose(posterior.covariance_matrix, fitted.model.joint(FRESH)[1], rtol=1e-8, atol=1e-8)
    n, likelihood = len(fitted.labels), gpytorch.likelihoods.BernoulliLikelihood()
    terms = gpytorch.mlls.VariationalELBO(likelihood, stock.train(), num_data=n, combine_terms=False)
    with torch.no_grad():
        expected, divergence, *_ = terms(stock(fitted.features), fitted.labels)
    assert n * float(expected - divergence) == pytest.approx(fitted.elbo, abs=0.05)


def test_gpytorch_cannot_better_the_bound_by_training_on(monkeypatch):
    fitted = exact(monkeypatch)
    stock = Stock(fitted.model).train()
    bound = gpytorch.mlls.VariationalELBO(gpytorch.likelihoods.BernoulliLikelihood(), stock, num_data=60)
    optimizer = torch.optim.LBFGS(stock.variational_parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def loss():
        optimizer.zero_grad()
        value = -60 * bound(stock(fitted.features), fitted.labels)
        value.backward()
        return value

    before = float(loss().detach())
    optimizer.step(loss)
    assert before - float(loss().detach()) < 0.01


@pytest.fixture(params=["rbf", "matern52", "margin"])
def model(request):
    F, y = points(60)
    if request.param == "margin":
        return MarginLatent(fit_margin(F.numpy(), 0.4 - F[:, 0].numpy() - 0.5 * F[:, 1].numpy() ** 2)).model
    return fit(F, y, {"rbf": RBF, "matern52": MATERN52}[request.param].default_prior).model


def test_marginal_and_joint_moments_are_those_of_the_botorch_posterior(model):
    (mean, sd), (joint_mean, K) = moments(model, FRESH.numpy()), joint(model, FRESH.numpy())
    assert joint_mean == pytest.approx(mean, abs=1e-9)
    assert np.sqrt(K.diagonal()) == pytest.approx(sd, rel=1e-6)
    assert np.linalg.eigvalsh(K)[0] > 0.0
    single, together = model.posterior(FRESH.unsqueeze(1)), model.posterior(FRESH)
    assert single.mean.shape == (30, 1, 1)
    assert single.mean.ravel().numpy() == pytest.approx(mean, abs=1e-9)
    assert single.variance.sqrt().ravel().numpy() == pytest.approx(sd, rel=1e-9)
    assert together.distribution.covariance_matrix.numpy() == pytest.approx(K, abs=1e-9)
    assert model.covariance(FRESH[:20], FRESH[20:]).numpy() == pytest.approx(K[:20, 20:], abs=1e-9)
    with torch.no_grad():
        several = model.posterior(FRESH.reshape(10, 3, 2)).distribution.covariance_matrix
    assert several[0].numpy() == pytest.approx(K[:3, :3], abs=1e-9)


def test_far_outside_the_space_the_uncertainty_is_the_priors():
    latent = Latent(fit(*points(60), RBF.default_prior))
    sd = latent.moments(np.array([[1e300, 0.0], [-1e300, 1e5]])).sd
    assert sd == pytest.approx(float(latent.trained.prior.covar_module.outputscale) ** 0.5, rel=1e-3)
    assert np.median(latent.moments(latent.features).sd) < 0.6 * sd.min()


def test_posterior_gradients_by_the_features_are_finite_differences(model):
    X, step = FRESH[:4].unsqueeze(1).clone().requires_grad_(), 1e-5
    posterior = model.posterior(X)
    for value, read in ((posterior.mean, 0), (posterior.variance.sqrt(), 1)):
        gradient = torch.autograd.grad(value.sum(), X, retain_graph=True)[0].squeeze(1)
        for column in range(2):
            moved = step * torch.eye(2, dtype=torch.float64)[column]
            above, below = (marginal(model, FRESH[:4] + sign * moved)[read] for sign in (1.0, -1.0))
            assert torch.allclose(gradient[:, column], (above - below) / (2.0 * step), rtol=1e-4, atol=1e-5)


def test_points_that_were_changed_in_place_are_read_again(model):
    x = FRESH.clone()
    before = model.strategy.seen(x).mean.clone()
    assert model.strategy.seen(x.unsqueeze(1)).mean.squeeze(1).tolist() == before.tolist()
    x += 0.5
    assert torch.equal(model.strategy.seen(x).mean, model.strategy.seen(x.clone()).mean)
    assert not torch.equal(model.strategy.seen(x).mean, before)
    assert torch.allclose(model.strategy.seen(x[:7]).mean, model.strategy.seen(x).mean[:7], rtol=1e-9, atol=1e-9)


# Both come from `SiteStrategy._at`, which takes the address of points, and torch's count of changes, for their content.
def test_points_that_numpy_changed_in_place_are_read_again(model):
    x = FRESH.numpy().copy()
    before = model.strategy.seen(torch.from_numpy(x)).mean
    x += 0.5
    assert not torch.equal(model.strategy.seen(torch.from_numpy(x)).mean, before)


def test_points_read_before_have_a_gradient(model):
    X = FRESH.unsqueeze(1).clone()
    model.posterior(X)
    model.posterior(X.requires_grad_()).mean.sum().backward()
    assert X.grad.abs().max() > 0.0


def test_a_fantasy_keeps_the_mean_and_conditions_the_covariance_on_noisy_observations(model):
    (mean, covariance), jitter = model.joint(FRESH), model.strategy.added * torch.eye(30, dtype=torch.float64)
    after_mean, after = fantasised(model, FRESH[:6]).joint(FRESH)
    assert torch.allclose(after_mean, mean, atol=1e-9)
    # Textbook conditioning, with the noise of each site: the precision that its label adds after those before it.
    noise, left, K = [], covariance, covariance - jitter
    for i in range(6):
        noise.append(float(1.0 / expected_precision(model.likelihood, mean[i], left[i, i])))
        S = covariance[: i + 1, : i + 1] + torch.diag(torch.tensor(noise, dtype=torch.float64))
        left = covariance - K[:, : i + 1] @ torch.linalg.solve(S, K[: i + 1])
    assert torch.allclose(after, left, rtol=1e-4, atol=1e-6 * float(covariance.diagonal().max()))
    assert (after.diagonal()[:6] < 0.9 * covariance.diagonal()[:6]).any()


def test_fantasies_one_after_the_other_are_the_fantasies_at_once(model):
    at_once, in_turn = fantasised(model, FRESH[:5]), model
    for row in range(5):
        in_turn = fantasised(in_turn, FRESH[row : row + 1])
    for one, other in zip(at_once.joint(FRESH), in_turn.joint(FRESH), strict=True):
        assert torch.allclose(one, other, rtol=1e-6, atol=1e-8)
    assert isinstance(in_turn.strategy.before, SiteStrategy)
    assert in_turn.strategy.before is model.strategy  # one level, however many observations


def test_a_model_is_freed_without_the_garbage_collector():
    model = fit(*points(20), RBF.default_prior).model
    gone = weakref.ref(model.strategy)
    gc.disable()
    try:
        del model
        assert gone() is None
    finally:
        gc.enable()


def test_a_criterion_that_fantasises_observations_is_refused_with_the_way_out(model):
    with pytest.raises(UnsupportedError, match=r"use a criterion .* or a classifier\.model that can"):
        qNegIntegratedPosteriorVariance(model, mc_points=FRESH)(FRESH[:2].unsqueeze(1))
