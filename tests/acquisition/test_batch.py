import numpy as np
import pytest
from scipy.stats import norm

from activefail.acquisition.batch import expected_site_precision, greedy_batch, propose
from activefail.acquisition.criteria import bald, entropy
from activefail.features import feature_map
from activefail.space import DesignSpace, Parameter
from activefail.surrogate.classifier import train

SPACE = DesignSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))


def beyond(X):
    return (np.hypot(X[:, 0] - 0.3, X[:, 1] - 0.4) < 0.35).astype(np.int8)


@pytest.fixture(scope="module")
def learned():
    X = SPACE.latin_hypercube(60, np.random.default_rng(0))
    return train(X, beyond(X), ("out", "in"), feature_map("design", SPACE), "rbf")


def test_the_expected_precision_of_a_label_is_that_of_sampling():
    rng = np.random.default_rng(0)
    for mean, sd in [(0.0, 1.0), (1.5, 0.4), (-2.0, 2.0)]:
        f = mean + sd * rng.standard_normal(400_000)
        y = np.where(rng.uniform(size=f.size) < norm.cdf(mean / np.sqrt(1 + sd**2)), 1.0, -1.0)
        ratio = np.exp(norm.logpdf(f) - norm.logcdf(y * f))
        assert expected_site_precision(mean, sd) == pytest.approx(np.mean(ratio * (ratio + y * f)), rel=0.02)


def test_the_first_of_a_batch_is_the_criterions_best():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((30, 30))
    mean, covariance = rng.standard_normal(30), A @ A.T / 30
    first = greedy_batch(mean, covariance, 1, bald)[0]
    assert first == np.argmax(bald(mean, np.sqrt(covariance.diagonal())))


def test_the_second_of_a_batch_is_best_under_exact_conditioning_on_the_first():
    rng = np.random.default_rng(2)
    A = rng.standard_normal((25, 25))
    mean, covariance = 0.2 * rng.standard_normal(25), A @ A.T / 25
    first, second = greedy_batch(mean, covariance, 2, bald)
    noise = 1.0 / expected_site_precision(mean[first], np.sqrt(covariance[first, first]))
    # Conditioning by the precision matrix instead of the rank-one downdate.
    precision = np.linalg.inv(covariance + 1e-12 * np.eye(25))
    precision[first, first] += 1.0 / noise
    value = bald(mean, np.sqrt(np.linalg.inv(precision).diagonal()))
    value[first] = -np.inf
    assert second == np.argmax(value)


def test_a_batch_holds_no_design_twice_even_where_all_are_alike():
    mean, covariance = np.zeros(8), np.ones((8, 8))
    assert sorted(greedy_batch(mean, covariance, 8, entropy)) == list(range(8))


def nearest(X):
    distance = np.linalg.norm(X[:, None] - X[None], axis=2)
    return np.min(distance + np.diag(np.full(len(X), np.inf)), axis=1)


def test_a_batch_does_not_pile_up(learned):
    latent, features = learned.latent("in"), learned.features
    batch = propose(latent, features, SPACE, bald, 8, np.random.default_rng(3))
    pool = SPACE.sobol(4096, np.random.default_rng(4))
    greediest = pool[np.argsort(-bald(*latent.moments(features(pool))))[:8]]
    assert np.median(nearest(batch)) > 3.0 * np.median(nearest(greediest))


def test_a_batch_by_entropy_is_spread_along_the_boundary(learned):
    batch = propose(learned.latent("in"), learned.features, SPACE, entropy, 8, np.random.default_rng(3))
    # Eight random points of a curve of length L have their nearest neighbour at about L/16; a pile has it at once.
    assert np.mean(nearest(batch)) > 0.3 * (2.0 * np.pi * 0.35 / 16.0)


def test_proposals_lie_in_the_space_and_near_the_learned_boundary(learned):
    batch = propose(learned.latent("in"), learned.features, SPACE, entropy, 10, np.random.default_rng(5))
    assert batch.shape == (10, 2)
    assert SPACE.contains(batch).all()
    moments = learned.latent("in").moments(learned.features(batch))
    fresh = learned.latent("in").moments(learned.features(SPACE.sobol(4096, np.random.default_rng(6))))
    assert np.abs(moments.mean).max() < np.quantile(np.abs(fresh.mean), 0.05)


def test_the_refinement_never_makes_the_best_design_worse(learned):
    latent, features = learned.latent("in"), learned.features
    rng = np.random.default_rng(7)
    pool = SPACE.sobol(4096, np.random.default_rng(7))
    best = propose(latent, features, SPACE, bald, 1, rng)
    assert bald(*latent.moments(features(best)))[0] >= bald(*latent.moments(features(pool))).max() - 1e-9


def test_the_same_generator_gives_the_same_batch(learned):
    first, again = (
        propose(learned.latent("in"), learned.features, SPACE, entropy, 5, np.random.default_rng(8)) for _ in range(2)
    )
    assert np.array_equal(first, again)
