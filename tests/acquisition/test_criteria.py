import numpy as np
import pytest
from scipy.stats import norm

from activefail.acquisition.criteria import bald, binary_entropy, criterion, entropy

MEAN, SD = (grid.ravel() for grid in np.meshgrid(np.linspace(-4.0, 4.0, 17), [0.05, 0.3, 1.0, 2.0, 5.0]))


def test_entropy_ranks_as_the_entropy_of_the_next_label():
    h = binary_entropy(norm.cdf(MEAN / np.sqrt(1.0 + SD**2)))
    order = np.argsort(entropy(MEAN, SD))
    assert np.all(np.diff(h[order]) >= -1e-12)


def test_entropy_still_ranks_where_the_probability_has_underflowed():
    assert entropy(np.array([60.0]), np.array([1.0])) > entropy(np.array([80.0]), np.array([1.0]))


def test_bald_is_the_mutual_information_of_label_and_latent_within_its_approximation():
    f = MEAN[:, None] + SD[:, None] * norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    exact = binary_entropy(norm.cdf(f).mean(axis=1)) - binary_entropy(norm.cdf(f)).mean(axis=1)
    # Houlsby et al. report the Gaussian approximation of the probit's entropy to be within 0.02 bit or so.
    assert bald(MEAN, SD) == pytest.approx(exact, abs=0.02)


def test_bald_prefers_the_less_certain_of_two_points_on_the_boundary():
    assert bald(np.array([0.0]), np.array([2.0])) > bald(np.array([0.0]), np.array([0.5]))


def test_criteria_do_not_depend_on_the_sign_of_the_latent():
    for name in ("entropy", "bald"):
        assert criterion(name)(MEAN, SD) == pytest.approx(criterion(name)(-MEAN, SD), abs=1e-12)


def test_an_unknown_criterion_is_refused():
    with pytest.raises(ValueError, match="entropy or bald"):
        criterion("hunch")
