import numpy as np
import pytest
import torch
from botorch.optim import optimize_acqf
from cases import some
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import norm
from surrogate.labelled import MATERN52, points

from activefail.learning.criteria import criteria
from activefail.learning.criteria.by_margin import DoubtReduction
from activefail.learning.criteria.criteria import criterion
from activefail.learning.model.fitting import fit
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.learning.model.moments import binary_entropy

MEAN, SD = (grid.ravel() for grid in np.meshgrid(np.linspace(-4.0, 4.0, 17), [0.05, 0.3, 1.0, 2.0, 5.0]))


def of_arrays(value):
    """A criterion as a function of arrays."""
    return lambda *arrays: value(*(torch.from_numpy(array) for array in arrays)).numpy()


POINTWISE = [entropy, u, straddle, bald] = [
    of_arrays(value) for value in (criteria.entropy, criteria.u, criteria.straddle, criteria.bald)
]
LOOK_AHEAD = [eavc, globalmi, sur] = [of_arrays(value) for value in (criteria.eavc, criteria.globalmi, criteria.sur)]


def misclassification(p):
    return np.minimum(p, 1.0 - p)


def posterior(n, references, seed):
    """A joint posterior of candidates and references as a look-ahead criterion takes it, and its whole covariance."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n + references, 6))
    covariance = A @ A.T / 6 * 2.0 + 0.1 * np.eye(n + references)
    mean = rng.standard_normal(n + references)
    sd = np.sqrt(covariance.diagonal())
    return (mean[:n], sd[:n], mean[n:], sd[n:], covariance[:n, n:]), covariance


def test_entropy_ranks_as_the_entropy_of_the_next_label():
    h = binary_entropy(norm.cdf(MEAN / np.sqrt(1.0 + SD**2)))
    order = np.argsort(entropy(MEAN, SD))
    assert np.all(np.diff(h[order]) >= -1e-12)


def test_entropy_still_ranks_where_the_probability_has_underflowed():
    assert entropy(np.array([60.0]), np.array([1.0])) > entropy(np.array([80.0]), np.array([1.0]))


def test_u_ranks_as_the_probability_that_the_latents_likelier_sign_is_wrong():
    wrong = misclassification(norm.cdf(MEAN / SD))
    assert np.all(np.diff(wrong[np.argsort(u(MEAN, SD))]) >= -1e-12)


def test_straddle_is_how_far_the_latents_95_percent_interval_reaches_across_the_boundary():
    low, high = norm.interval(0.95, MEAN, SD)
    across = np.minimum(high, -low)
    assert straddle(MEAN, SD) == pytest.approx(across, abs=4e-5 * SD.max())


def test_bald_is_the_mutual_information_of_label_and_latent_within_its_approximation():
    f = MEAN[:, None] + SD[:, None] * norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    exact = binary_entropy(norm.cdf(f).mean(axis=1)) - binary_entropy(norm.cdf(f)).mean(axis=1)
    # Houlsby et al. report the Gaussian approximation of the probit's entropy to be within 0.02 bit or so.
    assert bald(MEAN, SD) == pytest.approx(exact, abs=0.02)


def test_bald_prefers_the_less_certain_of_two_points_on_the_boundary():
    assert bald(np.array([0.0]), np.array([2.0])) > bald(np.array([0.0]), np.array([0.5]))


@pytest.mark.parametrize("value", POINTWISE)
def test_pointwise_criteria_do_not_depend_on_the_sign_of_the_latent(value):
    assert value(MEAN, SD) == pytest.approx(value(-MEAN, SD), abs=1e-12)


@pytest.mark.parametrize("value", [eavc, globalmi, sur])
def test_look_ahead_criteria_do_not_depend_on_the_sign_of_the_latent(value):
    (mean, sd, reference_mean, reference_sd, covariance), _ = posterior(40, 60, seed=1)
    mirrored = value(-mean, sd, -reference_mean, reference_sd, covariance)
    assert value(mean, sd, reference_mean, reference_sd, covariance) == pytest.approx(mirrored, abs=1e-12)


def by_sampling(covariance, arguments, uncertainty, number=400_000):
    """Look-ahead values by conditioning joint samples of the latent on either label, with weights Φ(±f)."""
    mean, _, reference_mean, _, _ = arguments
    rng = np.random.default_rng(7)
    n = len(mean)
    f = rng.multivariate_normal(np.concatenate([mean, reference_mean]), covariance, size=number, method="cholesky")
    safe = f[:, n:] < 0.0
    P = safe.mean(axis=0)
    falls, changes = [], []
    for i in range(n):
        weight = norm.cdf(f[:, i])
        one = weight @ safe / weight.sum()
        zero = (1.0 - weight) @ safe / (1.0 - weight).sum()
        p = weight.mean()
        falls.append(np.mean(uncertainty(P) - p * uncertainty(one) - (1.0 - p) * uncertainty(zero)))
        changes.append(p * abs(np.mean(P - one)) + (1.0 - p) * abs(np.mean(P - zero)))
    return np.array(falls), np.array(changes)


def test_look_ahead_criteria_are_what_conditioning_samples_of_the_posterior_on_each_label_gives():
    arguments, covariance = posterior(5, 8, seed=2)
    information, change = by_sampling(covariance, arguments, binary_entropy)
    fall, _ = by_sampling(covariance, arguments, misclassification)
    # A probability from 400,000 samples has a standard error below 8e-4; the gains are of order 0.1.
    assert globalmi(*arguments) == pytest.approx(information, abs=2e-3)
    assert eavc(*arguments) == pytest.approx(change, abs=2e-3)
    assert sur(*arguments) == pytest.approx(fall, abs=2e-3)
    assert min(information.max(), change.max(), fall.max()) > 0.02


def test_a_label_that_is_independent_of_the_references_is_worth_nothing():
    mean, sd = MEAN, SD
    zero = np.zeros((len(mean), 5))
    for value in LOOK_AHEAD:
        assert value(mean, sd, np.linspace(-2, 2, 5), np.ones(5), zero) == pytest.approx(0.0, abs=1e-14)


def test_information_and_misclassification_never_rise_in_expectation():
    arguments, _ = posterior(300, 200, seed=3)
    assert globalmi(*arguments).min() > 0.0
    assert sur(*arguments).min() > -1e-14


def test_a_label_tells_no_more_than_its_own_entropy_and_no_more_than_there_is_to_know():
    arguments, _ = posterior(300, 1, seed=4)
    mean, sd, reference_mean, reference_sd, _ = arguments
    bits = globalmi(*arguments)
    assert (bits <= binary_entropy(norm.cdf(mean / np.sqrt(1.0 + sd**2))) + 1e-12).all()
    assert (bits <= binary_entropy(norm.cdf(-reference_mean / reference_sd)) + 1e-12).all()


def test_a_sharp_latent_at_the_reference_itself_is_told_all_by_its_label():
    sd = np.array([1e4])
    bits = globalmi(np.zeros(1), sd, np.zeros(1), sd, sd[:, None] ** 2)
    assert bits == pytest.approx(1.0, abs=1e-2)


def test_the_expected_misclassification_does_not_fall_where_no_label_would_change_a_side():
    weak = np.full((1, 1), 0.01)
    arguments = (np.zeros(1), np.ones(1), np.array([2.0]), np.ones(1), weak)
    assert sur(*arguments) == pytest.approx(0.0, abs=1e-15)
    assert globalmi(*arguments) > 1e-7


@pytest.mark.parametrize("value", LOOK_AHEAD)
def test_a_candidates_value_does_not_depend_on_its_company(value):
    (mean, sd, reference_mean, reference_sd, covariance), _ = posterior(70, 900, seed=5)
    alone = [value(mean[[i]], sd[[i]], reference_mean, reference_sd, covariance[[i]])[0] for i in (0, 33, 69)]
    assert value(mean, sd, reference_mean, reference_sd, covariance)[[0, 33, 69]] == pytest.approx(alone, rel=1e-12)


@pytest.mark.parametrize("value", LOOK_AHEAD)
def test_a_reference_that_is_known_already_takes_no_part(value):
    (mean, sd, reference_mean, reference_sd, covariance), _ = posterior(6, 3, seed=6)
    known = np.column_stack([covariance, np.zeros(6)])
    extra_settings = value(mean, sd, np.append(reference_mean, 1.0), np.append(reference_sd, 0.0), known)
    assert extra_settings == pytest.approx(0.75 * value(mean, sd, reference_mean, reference_sd, covariance), rel=1e-9)


@st.composite
def posteriors(draw):
    """Means from one side of the boundary to the other, and a covariance of any rank, of candidates and references."""
    n, references, rank = draw(st.integers(1, 5)), draw(st.integers(1, 6)), draw(st.integers(1, 4))
    mean = draw(arrays(float, n + references, elements=st.floats(-40.0, 40.0)))
    root = draw(arrays(float, (n + references, rank), elements=st.floats(-5.0, 5.0)))
    covariance = root @ root.T
    sd = np.sqrt(covariance.diagonal())
    return mean[:n], sd[:n], mean[n:], sd[n:], covariance[:n, n:]


# The derivative of the entropy of a probability that is exactly 0 or 1, infinity times 0, is not a number.
NAMES = ["entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"]


@pytest.mark.parametrize("name", NAMES)
@given(posterior=posteriors())
def test_a_criterion_and_its_gradient_are_finite_wherever_the_latent_is(name, posterior):
    value = getattr(criteria, name)
    arguments = posterior if criterion(name).references else posterior[:2]
    tensors = [torch.from_numpy(array).requires_grad_() for array in arguments]
    values = value(*tensors)
    assert values.isfinite().all()
    values.sum().backward()
    assert all(tensor.grad is None or tensor.grad.isfinite().all() for tensor in tensors)


# --- as BoTorch acquisition functions over the scaled features ---------------------------------------------------

REFERENCES, POOL = points(64, 3, seed=1)[0], points(200, 3, seed=2)[0]


@pytest.fixture(scope="module")
def model():
    return fit(*points(60, 3), MATERN52.default_prior).model


@pytest.fixture(scope="module")
def of_margin():
    F, _ = points(30, 3)
    return MarginLatent(fit_margin(F.numpy(), 0.4 - F[:, 0].numpy() - 0.5 * F[:, 1].numpy() ** 2)).model


def made(name, model):
    return criterion(name).make(model, REFERENCES)


@pytest.mark.parametrize("name", NAMES)
def test_an_acquisition_function_has_the_values_of_its_criterion(model, name):
    mean, covariance = model.joint(torch.cat([POOL, REFERENCES]))
    sd, n = covariance.diagonal().sqrt(), len(POOL)
    at_references = (mean[n:], sd[n:], covariance[:n, n:]) if criterion(name).references else ()
    expected = getattr(criteria, name)(mean[:n], sd[:n], *at_references)
    assert made(name, model)(POOL.unsqueeze(1)).numpy() == pytest.approx(expected.numpy(), rel=1e-8, abs=1e-8)
    assert np.ptp(expected.numpy()) > 1e-4


@pytest.mark.parametrize("name", [*NAMES, "margin"])
def test_gradients_by_the_features_are_finite_differences(model, of_margin, name):
    function = DoubtReduction(of_margin, REFERENCES, torch.ones(64).double()) if name == "margin" else made(name, model)
    X, step = POOL[:6].unsqueeze(1).clone().requires_grad_(), 1e-5
    (gradient,) = torch.autograd.grad(function(X).sum(), X)
    moved = step * torch.eye(3, dtype=torch.float64)
    with torch.no_grad():
        differences = [(function(X + by) - function(X - by)) / (2.0 * step) for by in moved]
    scale = float(gradient.abs().max())
    assert torch.allclose(gradient.squeeze(1), torch.stack(differences, dim=1), rtol=0.0, atol=1e-3 * scale)
    assert scale > 1e-4


# Entropy, U and straddle have a crease where the mean is zero, often at their very maximum: no line search ends there.
@pytest.mark.filterwarnings("ignore:Optimization failed in `gen_candidates_scipy`:RuntimeWarning")
@pytest.mark.parametrize("name", some(NAMES, "straddle", "eavc"))
def test_botorchs_optimiser_reaches_at_least_the_best_of_a_pool(model, name):
    function = made(name, model)
    values, box = function(POOL.unsqueeze(1)), torch.stack([POOL.amin(0), POOL.amax(0)])
    starts = POOL[values.topk(4).indices].unsqueeze(1)
    _, value = optimize_acqf(
        function, box, q=1, num_restarts=4, batch_initial_conditions=starts, options={"maxiter": 25}
    )
    assert float(value) > float(values.max()) - 1e-12
