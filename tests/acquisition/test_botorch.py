import numpy as np
import pytest
import torch
from botorch.optim import optimize_acqf
from cases import some
from scipy.stats import norm

from activefail.acquisition.batch_proposal import REFERENCES, fantasised
from activefail.acquisition.botorch import TorchFeatures, acquisition_function
from activefail.acquisition.criteria import LookAhead, criterion
from activefail.acquisition.differentiable import columns
from activefail.bearing import TABLE_1
from activefail.errors import InputError
from activefail.features import FeatureMap, feature_map, paper_features
from activefail.parameter import Parameter
from activefail.space import DesignSpace
from activefail.surrogate.classifier import Latent, train

NAMES = ["entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"]
BOUNDS = torch.stack([torch.zeros(9), torch.ones(9)]).double()


@pytest.fixture(scope="module", params=["paper", "design"])
def learned(request):
    """A boundary across the nine variables: the pulse's displacement against the capacity, bent by the friction."""
    X = TABLE_1.latin_hypercube(80, np.random.default_rng(0))
    F = paper_features(X)
    outcome = (np.log(F[:, 0]) - 0.5 * F[:, 2] > -0.5).astype(np.int8)
    return train(X, outcome, ("safe", "failed"), feature_map(request.param, TABLE_1), "matern52")


def by_numpy(name, latent, features, X):
    """Values by the functions of `criteria`, with the references that `acquisition_function` draws."""
    value = criterion(name)
    if not isinstance(value, LookAhead):
        return value(*latent.moments(features(X)))
    references, n = TABLE_1.sobol(REFERENCES, np.random.default_rng(1)), len(X)
    mean, covariance = latent.joint(features(np.concatenate([X, references])))
    sd = np.sqrt(covariance.diagonal())
    return value.gain(mean[:n], sd[:n], mean[n:], sd[n:], covariance[:n, n:])


def by_torch(name, learned, pending=None):
    latent = learned.latent("failed")
    return acquisition_function(name, latent, learned.features, TABLE_1, np.random.default_rng(1), pending)


def test_the_features_in_torch_are_the_features(learned):
    U = np.random.default_rng(2).random((50, 9))
    F = TorchFeatures(learned.features, TABLE_1)(torch.from_numpy(U))
    assert F.numpy() == pytest.approx(learned.features(TABLE_1.from_unit(U)), abs=1e-12)


def test_features_that_are_only_a_function_are_refused():
    opaque = FeatureMap(("v",), lambda X: X[:, :1], np.array([False]), TABLE_1)
    with pytest.raises(InputError, match="Gradients require features that are expressions; v come from a Python"):
        TorchFeatures(opaque, TABLE_1)


@pytest.mark.parametrize("name", NAMES)
def test_values_are_those_of_the_functions(learned, name):
    U = np.random.default_rng(3).random((30, 9))
    expected = by_numpy(name, learned.latent("failed"), learned.features, TABLE_1.from_unit(U))
    values = by_torch(name, learned)(torch.from_numpy(U).unsqueeze(1))
    assert values.detach().numpy() == pytest.approx(expected, abs=1e-8)
    assert np.ptp(expected) > 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_gradients_are_finite_differences_of_the_values(learned, name):
    rng = np.random.default_rng(4)
    function = by_torch(name, learned)
    # Near the boundary: far from it, values and slopes are almost zero.
    U = rng.random((400, 9)) * 0.96 + 0.02
    mean, sd = learned.latent("failed").moments(learned.features(TABLE_1.from_unit(U)))
    U = U[np.argsort(norm.cdf(np.abs(mean) / np.sqrt(1.0 + sd**2)))[3:9]]
    X = torch.from_numpy(U).unsqueeze(1).requires_grad_()
    function(X).sum().backward()
    gradient = X.grad.squeeze(1).numpy()
    step = 1e-5
    moved = U[:, None, None, :] + step * np.array([1.0, -1.0])[None, :, None, None] * np.eye(9)[None, None]
    with torch.no_grad():
        values = function(torch.from_numpy(moved.reshape(-1, 1, 9))).numpy().reshape(6, 2, 9)
    difference = (values[:, 0] - values[:, 1]) / (2.0 * step)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    assert np.abs(gradient - difference).max(axis=1) == pytest.approx(0.0, abs=2e-3 * scale.min() + 1e-7)
    assert scale.min() > 0.0


def test_a_model_can_be_differentiated_again_when_its_first_prediction_had_gradients(learned):
    latent = Latent(learned.latent("failed").trained)
    F = torch.zeros(1, len(learned.features.names), dtype=torch.float64, requires_grad=True)
    for _ in range(2):
        latent.model.posterior(F).mean.sum().backward()


ENGINEERS = DesignSpace(
    (
        Parameter("load", 0.0, 60.0, distribution="gumbel_max", mean=10.0, sd=2.0),
        Parameter("k", 1.0, 30.0, distribution="log_uniform"),
        Parameter("wear", 0.0, 1.0, distribution="beta", mean=0.3, sd=0.2),
        Parameter("strength", 1.0, 200.0, distribution="lognormal", mean=20.0, sd=6.0),
        Parameter("width", -3.0, 2.0),
    ),
    correlation=(("load", "strength", 0.6), ("wear", "width", -0.4)),
)


def test_values_and_slopes_of_designs_of_any_distribution_are_those_of_the_space():
    U = np.random.default_rng(6).random((50, 5)) * 0.998 + 0.001
    tensor = torch.from_numpy(U).requires_grad_()
    X = torch.stack(columns(ENGINEERS, tensor), dim=-1)
    np.testing.assert_allclose(X.detach().numpy(), ENGINEERS.from_unit(U), rtol=1e-12)
    (X / torch.from_numpy(ENGINEERS.high - ENGINEERS.low)).sum().backward()
    step = 1e-7
    moved = U[:, None, None, :] + step * np.array([1.0, -1.0])[None, :, None, None] * np.eye(5)[None, None]
    values = (ENGINEERS.from_unit(moved) / (ENGINEERS.high - ENGINEERS.low)).sum(axis=-1)
    difference = (values[:, 0] - values[:, 1]) / (2.0 * step)
    np.testing.assert_allclose(tensor.grad.numpy(), difference, rtol=1e-4, atol=1e-4)


# Entropy, U and straddle have a crease where the mean is zero, often at their very maximum: no line search ends there.
@pytest.mark.filterwarnings("ignore:Optimization failed in `gen_candidates_scipy`:RuntimeWarning")
@pytest.mark.parametrize("name", some(NAMES, "straddle", "eavc"))
def test_the_optimiser_reaches_at_least_the_best_of_a_pool(learned, name):
    pool = TABLE_1.sobol(512, np.random.default_rng(5))
    values = by_numpy(name, learned.latent("failed"), learned.features, pool)
    starts = torch.from_numpy(TABLE_1.to_unit(pool[np.argsort(-values)[:4]])).unsqueeze(1)
    design, value = optimize_acqf(
        by_torch(name, learned),
        bounds=BOUNDS,
        q=1,
        num_restarts=4,
        batch_initial_conditions=starts,
        options={"maxiter": 25},
    )
    assert float(value) > values.max() - 1e-12
    assert TABLE_1.contains(TABLE_1.from_unit(design.numpy())).all()


@pytest.mark.parametrize("name", ["straddle", "bald", "globalmi", "eavc"])
def test_designs_in_flight_are_in_the_values(learned, name):
    rng = np.random.default_rng(6)
    pending, U = rng.random((3, 9)), rng.random((10, 9))
    latent = fantasised(learned.latent("failed"), learned.features(TABLE_1.from_unit(pending)))
    expected = by_numpy(name, latent, learned.features, TABLE_1.from_unit(U))
    function = by_torch(name, learned)
    before = function(torch.from_numpy(U).unsqueeze(1)).detach().numpy()
    function.set_X_pending(torch.from_numpy(pending))
    during = function(torch.from_numpy(U).unsqueeze(1)).detach().numpy()
    assert during == pytest.approx(expected, abs=1e-8)
    assert np.abs(during - before).max() > 1e-5
    function.set_X_pending(None)
    assert function(torch.from_numpy(U).unsqueeze(1)).detach().numpy() == pytest.approx(before, abs=1e-12)


def test_botorchs_sequential_batch_does_not_pile_up(learned):
    torch.manual_seed(0)
    function = by_torch("globalmi", learned)
    designs, _ = optimize_acqf(
        function, bounds=BOUNDS, q=2, num_restarts=2, raw_samples=64, sequential=True, options={"maxiter": 15}
    )
    first, second = designs.detach()
    function.set_X_pending(first.unsqueeze(0))
    values = function(torch.stack([first, second]).unsqueeze(1))
    assert values[1] > 1.2 * values[0]
