import math
from functools import partial

import numpy as np
import pytest
from cases import some
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import expit, log_ndtr, ndtr
from scipy.stats import multivariate_normal, norm
from sklearn.gaussian_process import GaussianProcessClassifier
from sklearn.gaussian_process.kernels import RBF, ConstantKernel
from surrogate.sampling import elliptical_slice_sampling
from threadpoolctl import threadpool_limits

from activefail.analyses.sensitivity.logistic import logistic_regression
from activefail.errors import InputError
from activefail.seismic.paper import gpml
from activefail.seismic.paper import methods as reference
from activefail.seismic.paper.gpml import SiteParameters, SquaredExponentialPrior
from activefail.seismic.paper.methods import condition, train

METHODS = ("laplace", "ep")


@pytest.fixture(autouse=True)
def one_thread():
    """Matrices this small gain nothing from a second thread, which only takes it from other tests."""
    with threadpool_limits(1):
        yield


def points(n, m=2, seed=0, noise=0.3):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((n, m))
    return F, F[:, 0] + 0.5 * F[:, -1] ** 2 + noise * rng.standard_normal(n) > 0.4


def hyperparameters(m=2, mean=0.3, signal_variance=4.0, length_scale=1.3):
    return SquaredExponentialPrior(mean, signal_variance, length_scale * np.linspace(0.8, 1.4, m))


def prior(F, y, h):
    """Covariance and signs."""
    return gpml.covariance(F, F, h), np.where(y, 1.0, -1.0)


def orthant_log_evidence(K, mean, signs):
    """log ∫ N(f | m, K) ∏ Φ(y f) df: the probability that all y (f + unit noise) are positive."""
    covariance = signs[:, None] * (K + np.eye(len(K))) * signs
    limit = multivariate_normal.cdf(signs * mean, cov=covariance, maxpts=200_000, abseps=1e-9, releps=1e-7, rng=1)
    return math.log(limit)


def grid_posterior(K, mean, signs, nodes):
    """Log evidence, means and standard deviations of f by the trapezoidal rule on a whitened grid."""
    axis = np.linspace(-7.5, 7.5, nodes)
    u = np.stack(np.meshgrid(*[axis] * len(K), indexing="ij"), axis=-1).reshape(-1, len(K))
    f = mean + u @ np.linalg.cholesky(K).T
    weight = np.exp(-0.5 * (u * u).sum(1) + log_ndtr(signs * f).sum(1))
    total = weight.sum()
    first = weight @ f / total
    scale = ((axis[1] - axis[0]) / math.sqrt(2.0 * math.pi)) ** len(K)
    return math.log(total * scale), first, np.sqrt(weight @ (f - first) ** 2 / total)


def dense_posterior(K, mean, sites):
    """Mean and covariance of the Gaussian that prior and sites define, by inverting."""
    S = np.linalg.inv(np.linalg.inv(K) + np.diag(sites.precision))
    return S @ (np.linalg.solve(K, np.full(len(K), mean)) + sites.linear), S


# Likelihoods


@pytest.mark.parametrize("likelihood", [gpml.probit, gpml.logistic])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_term_of_a_likelihood_is_the_derivative_of_the_one_before(likelihood, sign):
    f, step = np.linspace(-9.0, 9.0, 61), 1e-5
    y = np.full_like(f, sign)
    up, down, here = (likelihood(y, f + d) for d in (step, -step, 0.0))
    assert_allclose((up.value - down.value) / (2 * step), here.slope, rtol=1e-7, atol=1e-9)
    assert_allclose((up.slope - down.slope) / (2 * step), -here.curvature, rtol=1e-6, atol=1e-9)
    assert_allclose((up.curvature - down.curvature) / (2 * step), -here.third, rtol=1e-5, atol=1e-9)


def test_the_probit_terms_keep_their_asymptotes_where_the_probability_underflows():
    f = np.array([-50.0, -1e3])
    terms = gpml.probit(np.ones(2), f)
    assert_allclose(terms.slope, -f - 1 / f + 2 / f**3, rtol=1e-9)
    assert_allclose(terms.curvature, 1 - 1 / f**2 + 6 / f**4, rtol=1e-7)
    sure = gpml.probit(np.ones(1), np.array([1e3]))
    assert [float(term[0]) for term in sure] == [0.0] * 4


# Inference at given hyperparameters


@pytest.mark.parametrize("label", [True, False])
@pytest.mark.parametrize("mean", [-6.0, 0.4, 6.0])
@pytest.mark.parametrize("signal_variance", [0.1, 9.0, 1e4])
def test_expectation_propagation_of_one_point_is_exact(label, mean, signal_variance):
    F, h = np.zeros((1, 1)), SquaredExponentialPrior(mean, signal_variance, np.ones(1))
    fit = condition(F, np.array([label]), h, "ep")
    # R&W eq. 3.58
    y, scale = 1.0 if label else -1.0, math.sqrt(1.0 + signal_variance)
    z = y * mean / scale
    ratio = math.exp(norm.logpdf(z) - norm.logcdf(z))
    first = mean + y * signal_variance * ratio / scale
    second = signal_variance - signal_variance**2 * ratio * (z + ratio) / scale**2
    assert fit.posterior.log_evidence == pytest.approx(norm.logcdf(z), rel=1e-9)
    moments = fit.moments(F)
    assert float(moments.mean[0]) == pytest.approx(first, rel=1e-8)
    assert float(moments.sd[0]) == pytest.approx(math.sqrt(second), rel=1e-6)


@pytest.mark.parametrize("signal_variance", [1.0, 9.0, 100.0])
@pytest.mark.parametrize("n", [2, 3])
def test_evidence_and_moments_are_those_of_dense_quadrature(n, signal_variance):
    F = np.array([[0.0, 0.2], [0.7, -0.4], [-1.1, 0.6]])[:n]
    y = np.array([True, False, False])[:n]
    h = hyperparameters(signal_variance=signal_variance)
    K, signs = prior(F, y, h)
    log_z, mean, sd = grid_posterior(K, h.mean, signs, {2: 801, 3: 121}[n])
    assert orthant_log_evidence(K, h.mean, signs) == pytest.approx(log_z, abs=1e-5)

    fit = condition(F, y, h, "ep")
    got = fit.moments(F)
    assert fit.posterior.log_evidence == pytest.approx(log_z, abs=0.01)
    assert_allclose(got.mean, mean, atol=0.01 * sd.max())
    assert_allclose(got.sd, sd, rtol=0.01)

    rough = condition(F, y, h, "laplace")
    moments = rough.moments(F)
    # Known to fall behind as the prior widens past the likelihood's unit step.
    looseness = {1.0: 0.15, 9.0: 0.5, 100.0: 0.95}[signal_variance]
    assert abs(rough.posterior.log_evidence - log_z) < looseness
    assert (np.abs(moments.mean - mean) < looseness * sd).all()
    assert (np.abs(moments.sd / sd - 1.0) < looseness).all()


@pytest.mark.parametrize(
    ("signal_variance", "mean_error", "sd_error"), some([(2.0, 0.02, 0.03), (9.0, 0.04, 0.08)], (9.0, 0.04, 0.08))
)
def test_expectation_propagation_has_the_moments_of_a_long_markov_chain(signal_variance, mean_error, sd_error):
    F, y = points(20, seed=4)
    h = hyperparameters(signal_variance=signal_variance)
    K, signs = prior(F, y, h)
    samples = elliptical_slice_sampling(K, h.mean, signs, 1000, 400, np.random.default_rng(0))[100:]
    mean, sd = samples.mean((0, 1)), samples.std((0, 1))
    # Of the means of independent chains: the error of the reference itself.
    error = samples.mean(0).std(0) / math.sqrt(samples.shape[1])
    assert (error < 0.01 * sd).all()
    exact = condition(F, y, h, "ep").moments(F)
    assert (np.abs(exact.mean - mean) < mean_error * sd).all()
    # The posterior is skewed, the more the wider the prior: what a Gaussian site a point cannot follow.
    assert_allclose(exact.sd, sd, rtol=sd_error)
    rough = condition(F, y, h, "laplace").moments(F)
    assert np.abs((rough.mean - mean) / sd).mean() > 5.0 * np.abs((exact.mean - mean) / sd).mean()


@pytest.mark.parametrize("signal_variance", [1.0, 100.0])
def test_each_site_matches_the_moments_of_its_cavity_times_the_likelihood(signal_variance):
    F, y = points(8, seed=2)
    h = hyperparameters(signal_variance=signal_variance)
    K, signs = prior(F, y, h)
    posterior = gpml.ep_posterior(K, h.mean, signs)
    mean, S = dense_posterior(K, h.mean, posterior.sites)
    for i, sign in enumerate(signs):
        precision = 1.0 / S[i, i] - posterior.sites.precision[i]
        center, sd = (mean[i] / S[i, i] - posterior.sites.linear[i]) / precision, precision**-0.5

        def tilted(f, power, sign=sign, center=center, sd=sd):
            return f**power * ndtr(sign * f) * norm.pdf(f, center, sd)

        z, first, second = (
            quad(tilted, center - 10 * sd, center + 10 * sd, args=(power,), points=[0.0], limit=200)[0]
            for power in range(3)
        )
        assert first / z == pytest.approx(mean[i], rel=1e-4, abs=1e-5)
        assert second / z - (first / z) ** 2 == pytest.approx(S[i, i], rel=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_predictions_are_those_of_dense_algebra_on_the_sites(method):
    F, y = points(12)
    at = np.random.default_rng(1).standard_normal((7, 2))
    h = hyperparameters()
    K, _ = prior(F, y, h)
    fit = condition(F, y, h, method)
    mean, S = dense_posterior(K, h.mean, fit.posterior.sites)
    weights = np.linalg.solve(K, gpml.covariance(F, at, h))
    variance = h.signal_variance - np.einsum("ij,ij->j", weights, (K - S) @ weights)
    got = fit.moments(at)
    assert_allclose(got.mean, h.mean + weights.T @ (mean - h.mean), atol=1e-6)
    assert_allclose(got.sd, np.sqrt(variance), atol=1e-6)
    assert_allclose(fit.probability(at), ndtr(got.mean / np.sqrt(1.0 + got.sd**2)), atol=1e-12)


def test_predicted_probabilities_are_ratios_of_exact_evidences():
    F, y = points(4, seed=3)
    at = np.array([[0.3, -0.2], [2.0, 1.0], [-1.0, 0.4]])
    h = hyperparameters(signal_variance=25.0)
    K, signs = prior(F, y, h)
    alone = orthant_log_evidence(K, h.mean, signs)
    exact = []
    for x in at:
        joint, _ = prior(np.vstack([F, x]), np.append(y, True), h)
        exact.append(math.exp(orthant_log_evidence(joint, h.mean, np.append(signs, 1.0)) - alone))
    assert_allclose(condition(F, y, h, "ep").probability(at), exact, atol=0.01)


def test_laplaces_method_under_the_logistic_link_is_that_of_scikit_learn():
    F, y = points(40)
    variance, scales = 6.0, np.array([0.9, 1.7])
    kernel = ConstantKernel(variance) * RBF(scales)
    theirs = GaussianProcessClassifier(kernel, optimizer=None).fit(F, y)
    log_z, gradient = theirs.log_marginal_likelihood(np.log([variance, *scales]), eval_gradient=True)

    h = SquaredExponentialPrior(0.0, variance, scales)
    K, signs = prior(F, y, h)
    ours = gpml.laplace_posterior(K, 0.0, signs, gpml.logistic)
    assert ours.converged
    assert ours.log_evidence == pytest.approx(log_z, abs=1e-6)
    assert_allclose(expit(K @ ours.alpha), theirs.base_estimator_.pi_, atol=1e-6)
    _, by_signal, by_scales = gpml.evidence_gradient(F, K, h, ours)
    assert_allclose([by_signal, *by_scales], gradient, atol=1e-4)

    at = np.random.default_rng(1).standard_normal((9, 2))
    mean, latent_variance = theirs.latent_mean_and_variance(at)
    got_mean, got_variance = gpml.predict(F, h, ours, at)
    assert_allclose(got_mean, mean, atol=1e-6)
    assert_allclose(got_variance, latent_variance, atol=1e-6)


@pytest.mark.parametrize("likelihood", [gpml.probit, gpml.logistic])
@pytest.mark.parametrize("signal_variance", [1.0, 1e4])
def test_laplaces_mode_has_no_slope(likelihood, signal_variance):
    F, y = points(30)
    h = hyperparameters(signal_variance=signal_variance, mean=3.0)
    K, signs = prior(F, y, h)
    posterior = gpml.laplace_posterior(K, h.mean, signs, likelihood)
    assert posterior.converged
    assert_allclose(posterior.alpha, likelihood(signs, h.mean + K @ posterior.alpha).slope, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("mean", "signal_variance", "scale"), [(0.3, 0.5, 1.0), (-2.0, 30.0, 2.0), (20.0, 9e3, 0.7)])
def test_the_evidence_has_the_gradient_that_is_stated(method, mean, signal_variance, scale):
    F, y = points(30, m=3, seed=5)
    signs = np.where(y, 1.0, -1.0)
    at = reference.pack(hyperparameters(3, mean, signal_variance, scale))
    step = 1e-4

    def value(packed):
        return reference.evaluate(packed, F, signs, method)[0].log_evidence

    numerical = [(value(at + step * e) - value(at - step * e)) / (2 * step) for e in np.eye(len(at))]
    assert_allclose(reference.evaluate(at, F, signs, method)[1], numerical, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_start_from_other_sites_ends_at_the_same_posterior(method):
    F, y = points(40)
    K, signs = prior(F, y, hyperparameters())
    infer = {"laplace": gpml.laplace_posterior, "ep": gpml.ep_posterior}[method]
    cold = infer(K, 0.3, signs)
    other = infer(prior(F, y, hyperparameters(signal_variance=900.0, length_scale=0.5))[0], -3.0, -signs).sites
    for start in (other, SiteParameters(-5.0 * signs, np.full(40, 0.7))):
        warm = infer(K, 0.3, signs, start=start)
        assert warm.converged
        assert warm.log_evidence == pytest.approx(cold.log_evidence, abs=1e-8)
        assert_allclose(warm.alpha, cold.alpha, atol=1e-5)


def test_laplaces_evidence_does_not_depend_on_the_start_where_the_prior_is_wide():
    F, _ = points(60, m=1)
    h = SquaredExponentialPrior(-4e3, 1e6, np.array([2.0]))
    K, signs = prior(F, F[:, 0] > 0.0, h)
    cold = gpml.laplace_posterior(K, h.mean, signs)
    for linear, precision in ((1.0, 0.5), (0.1, 0.01), (-3.0, 2.0)):
        warm = gpml.laplace_posterior(K, h.mean, signs, start=SiteParameters(linear * signs, np.full(60, precision)))
        assert warm.log_evidence == pytest.approx(cold.log_evidence, abs=1e-7)


@pytest.mark.parametrize(("method", "limit"), [("laplace", "NEWTON_STEPS"), ("ep", "EP_SWEEPS")])
def test_inference_that_ran_out_of_steps_is_not_called_converged(method, limit, monkeypatch):
    F, y = points(30)
    monkeypatch.setattr(gpml, limit, 2)
    assert not condition(F, y, hyperparameters(), method).converged
    assert not train(F, y, method).converged


@pytest.mark.parametrize("seed", range(6))
def test_inference_converges_over_all_searched_hyperparameters(seed):
    rng = np.random.default_rng(seed)
    F, y = points(60, m=4, seed=seed)
    y = rng.random(60) < 0.5 if seed % 2 else y
    for _ in range(12):
        s = math.exp(rng.uniform(math.log(1e-4), math.log(1e4)))
        h = SquaredExponentialPrior(rng.uniform(-4, 4) * math.sqrt(1.0 + s), s, np.exp(rng.uniform(-1.0, 6.9, 4)))
        for method in METHODS:
            fit = condition(F, y, h, method)
            assert fit.converged
            assert np.isfinite(fit.posterior.log_evidence)


def test_expectation_propagation_converges_where_whole_steps_circle():
    F, y = points(60, m=1, seed=0, noise=0.0)
    h = SquaredExponentialPrior(0.0, 1e4, np.array([0.6]))
    K, signs = prior(F, y, h)
    posterior = gpml.ep_posterior(K, h.mean, signs)
    assert posterior.converged
    assert posterior.iterations < 60


# What is published of the two (Kuss and Rasmussen 2005; Nickisch and Rasmussen 2008)


@pytest.mark.parametrize("signal_variance", [4.0, 25.0, 100.0])
def test_on_a_line_laplaces_method_shrinks_the_latent_and_falls_short_of_the_evidence(signal_variance):
    F = np.array([-2.0, -1.2, -0.5, 0.6, 1.1, 2.1])[:, None]
    y = F[:, 0] > 0.0
    h = SquaredExponentialPrior(0.0, signal_variance, np.ones(1))
    K, signs = prior(F, y, h)
    exact = orthant_log_evidence(K, 0.0, signs)
    rough, fine = (condition(F, y, h, method) for method in METHODS)
    assert rough.posterior.log_evidence < fine.posterior.log_evidence
    assert abs(fine.posterior.log_evidence - exact) < 0.05
    assert abs(fine.posterior.log_evidence - exact) < 0.1 * abs(rough.posterior.log_evidence - exact)

    assert (np.abs(rough.moments(F).mean) < np.abs(fine.moments(F).mean)).all()
    assert (np.sign(rough.moments(F).mean) == signs).all()
    # Underconfident on the training points, on the right side.
    assert (signs * (fine.probability(F) - 0.5) > signs * (rough.probability(F) - 0.5)).all()
    assert (signs * (rough.probability(F) - 0.5) > 0.0).all()


# Training


@pytest.mark.parametrize("method", METHODS)
def test_no_step_along_a_hyperparameter_betters_the_trained_evidence(method):
    F, y = points(80, m=3, seed=2)
    fit = train(F, y, method)
    assert fit.converged
    best = reference.pack(fit.hyperparameters)
    signs = np.where(y, 1.0, -1.0)
    bounds = np.array(
        [reference.PRIOR_PROBIT, np.log(reference.SIGNAL_VARIANCE)] + [np.log(reference.LENGTH_SCALE)] * 3
    )
    moved = 0
    for step in (1e-2, 0.3):
        for direction in np.vstack([np.eye(len(best)), -np.eye(len(best))]):
            at = best + step * direction
            if (at >= bounds[:, 0]).all() and (at <= bounds[:, 1]).all():
                moved += 1
                posterior, _ = reference.evaluate(at, F, signs, method)
                assert posterior.log_evidence < fit.posterior.log_evidence + 1e-7
    assert moved > 2 * len(best)


@pytest.mark.parametrize("method", METHODS)
def test_of_several_local_maxima_the_highest_is_kept(method, monkeypatch):
    F, y = points(30, seed=2)
    best = train(F, y, method).posterior.log_evidence
    ends = []
    for start in reference.STARTS:
        monkeypatch.setattr(reference, "STARTS", (start,))
        ends.append(train(F, y, method).posterior.log_evidence)
    assert max(ends) - min(ends) > 0.05
    assert best == pytest.approx(max(ends), abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_feature_that_says_nothing_gets_a_length_scale_ten_times_as_long(method):
    rng = np.random.default_rng(6)
    F = rng.standard_normal((120, 3))
    y = np.sin(1.5 * F[:, 0]) + F[:, 1] > 0.1
    scales = train(F, y, method).hyperparameters.length_scales
    assert scales[2] > 10.0 * scales[:2].max()


@pytest.mark.parametrize("method", METHODS)
def test_classes_that_a_line_separates_train_to_the_bound_of_the_signal_variance(method):
    rng = np.random.default_rng(7)
    F = rng.standard_normal((60, 2))
    F[:, 0] += np.sign(F[:, 0])
    y = F[:, 0] > 0.0
    fit = train(F, y, method)
    assert fit.converged
    assert ((fit.probability(F) > 0.5) == y).all()
    assert fit.hyperparameters.signal_variance <= 1e4 * (1 + 1e-9)
    assert np.isfinite(fit.moments(1e3 * F).mean).all()


@pytest.mark.parametrize("method", METHODS)
def test_swapped_classes_mirror_the_latent(method):
    F, y = points(50)
    at = np.random.default_rng(1).standard_normal((20, 2))
    fit, mirrored = train(F, y, method), train(F, ~y, method)
    assert mirrored.posterior.log_evidence == pytest.approx(fit.posterior.log_evidence, abs=1e-6)
    assert mirrored.hyperparameters.mean == pytest.approx(-fit.hyperparameters.mean, abs=2e-3)
    assert_allclose(mirrored.probability(at), 1.0 - fit.probability(at), atol=1e-3)
    h = fit.hyperparameters
    exact = condition(F, ~y, h._replace(mean=-h.mean), method)
    assert exact.posterior.log_evidence == pytest.approx(fit.posterior.log_evidence, abs=1e-9)
    assert_allclose(exact.moments(at).mean, -fit.moments(at).mean, atol=1e-6)
    assert_allclose(exact.moments(at).sd, fit.moments(at).sd, atol=1e-6)


@pytest.mark.parametrize("method", [partial(train, method="ep"), logistic_regression])
def test_what_is_no_training_set_is_refused(method):
    F, y = points(10)
    with pytest.raises(InputError, match=r"must have matching shapes, got \(10, 2\) and \(9,\)"):
        method(F, y[:9])
    F[3, 1] = np.nan
    with pytest.raises(InputError, match="must be finite, got 1 non-finite"):
        method(F, y)


# Logistic regression


def overlapping(n=120, seed=0):
    """Features of very different units, and labels that no plane separates."""
    rng = np.random.default_rng(seed)
    F = np.column_stack([0.3 * rng.random(n), 1e6 * rng.lognormal(size=n), 5.0 + 1e-3 * rng.standard_normal(n)])
    odds = 15.0 * (F[:, 0] - 0.15) + 5e-7 * (F[:, 1] - 1e6)
    return F, rng.random(n) < expit(odds)


def newton(A, y, steps=60):
    """Iteratively reweighted least squares with whole steps: coefficients and their covariance."""
    beta = np.zeros(A.shape[1])
    for _ in range(steps):
        p = expit(A @ beta)
        information = (A * (p * (1.0 - p))[:, None]).T @ A
        beta = beta + np.linalg.solve(information, A.T @ (y - p))
    return beta, np.linalg.inv(information)


def test_logistic_regression_is_iteratively_reweighted_least_squares():
    F, y = overlapping()
    fit = logistic_regression(F, y)
    assert fit.converged
    assert not fit.separation
    units = F.std(0)
    beta, covariance = newton(np.column_stack([np.ones(len(F)), (F - F.mean(0)) / units]), y)
    slopes = beta[1:] / units
    errors = np.sqrt(np.diag(covariance))[1:] / units
    assert_allclose(fit.coefficients, slopes, rtol=1e-8)
    assert_allclose(fit.intercept, beta[0] - slopes @ F.mean(0), rtol=1e-8)
    assert_allclose(fit.standard_errors, errors, rtol=1e-7)
    assert_allclose(fit.p_values, 2.0 * norm.sf(np.abs(slopes / errors)), rtol=1e-6)
    assert_allclose(fit.probability(F), expit(fit.intercept + F @ slopes), rtol=1e-6)
    # The maximum's condition: residuals are orthogonal to the features and sum to zero.
    residual = y - fit.probability(F)
    assert abs(residual.sum()) < 1e-8
    assert_allclose(residual @ ((F - F.mean(0)) / units), 0.0, atol=1e-8)
    assert fit.accuracy(F, y) == np.mean((fit.probability(F) > 0.5) == y)


def complete(F, rng):
    return F @ [1.0, -0.5] > 0.2


def quasi_complete(F, rng):
    """The second feature is 0 or 1; at 1 all labels are true, at 0 there are both."""
    F[:, 1] = F[:, 1] > 0.5
    return (rng.random(len(F)) < 0.5) | (F[:, 1] > 0.0)


def quasi_complete_at_a_point(F, rng):
    """A line separates all but two points on it, one of each class."""
    y = complete(F, rng)
    F[:2] = [[0.4, 0.4], [0.6, 0.8]]
    y[:2] = [True, False]
    return y


def one_class(F, rng):
    return np.ones(len(F), dtype=bool)


@pytest.mark.parametrize("label", [complete, quasi_complete, quasi_complete_at_a_point, one_class])
@pytest.mark.parametrize("seed", range(3))
def test_separation_is_a_flag_not_a_warning(label, seed):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((60, 2))
    y = label(F, rng)
    fit = logistic_regression(F, y)
    assert fit.separation
    assert not fit.converged
    assert np.isnan(fit.p_values).all()
    assert np.isnan(fit.standard_errors).all()
    assert np.isfinite([fit.intercept, *fit.coefficients]).all()
    assert fit.accuracy(F, y) >= (0.96 if label is not quasi_complete else 0.5)


def test_a_maximum_that_whole_steps_run_away_from_is_found():
    rng = np.random.default_rng(912)
    F = rng.standard_t(1, (15, 2)).round(1)
    y = rng.random(15) < expit(2.0 * F[:, 0])
    A = np.column_stack([np.ones(15), (F - F.mean(0)) / F.std(0)])
    with pytest.raises(np.linalg.LinAlgError), np.errstate(all="ignore"):
        newton(A, y)
    fit = logistic_regression(F, y)
    assert fit.converged
    assert np.isfinite(fit.p_values).all()
    assert_allclose(A.T @ (y - fit.probability(F)), 0.0, atol=1e-6)


def test_dependent_features_are_refused():
    F, y = overlapping()
    with pytest.raises(InputError, match="linearly independent, got rank 4 of 5"):
        logistic_regression(np.column_stack([F, 2.0 * F[:, 0] - 1.0]), y)
    with pytest.raises(InputError, match="linearly independent, got rank 4 of 5"):
        # A constant but for rounding: 0.3 and 0.1 * 3 differ.
        logistic_regression(np.column_stack([F, np.where(y, 0.3, 0.1 * 3)]), y)
