"""Populations: weighted samples whose means are those of the design measure, wherever they were drawn."""

import numpy as np
import pytest
from scipy.special import ndtr

from activefail.errors import InputError
from activefail.learning.criteria.population import finite, population
from activefail.learning.features import ExpressionFeatures, feature_map
from activefail.space.parameter import Parameter
from activefail.space.space import REACH, DesignSpace, radius


def standard_normal(d: int) -> DesignSpace:
    far = radius(REACH, d)
    return DesignSpace(tuple(Parameter(f"x{i}", -far, far, distribution="normal", mean=0.0, sd=1.0) for i in range(d)))


@pytest.mark.parametrize("d", [1, 2, 5, 10])
@pytest.mark.parametrize("local", [False, True])
def test_weighted_means_are_those_of_the_design_measure(d: int, local: bool) -> None:
    space, rng = standard_normal(d), np.random.default_rng(d)
    # Half-spaces with known probabilities; the local part is drawn around the rarest one.
    importance = (lambda X: (X[:, 0] > 4.0).astype(float)) if local else None
    drawn = population(space, 100_000, importance, rng)
    assert drawn.X.shape == drawn.Z.shape == (100_000, d)
    for beyond in (0.0, 2.0, 3.0):
        parts = drawn.weight * (drawn.X[:, 0] > beyond)
        error = parts.std() / np.sqrt(len(parts))
        assert abs(parts.mean() - ndtr(-beyond)) < 4.5 * error
    if local:
        parts = drawn.weight * (drawn.X[:, 0] > 4.5)
        error = parts.std() / np.sqrt(len(parts))
        assert abs(parts.mean() - ndtr(-4.5)) < 4.5 * error
        assert error < 0.1 * ndtr(-4.5)


def test_the_radial_part_reaches_every_direction_of_the_ball() -> None:
    drawn = population(standard_normal(2), 20_000, None, np.random.default_rng(0))
    distance, angle = np.linalg.norm(drawn.Z, axis=1), np.arctan2(drawn.Z[:, 1], drawn.Z[:, 0])
    far = distance > 0.9 * radius(REACH, 2)
    assert far.sum() > 500
    # Half of the distances are uniform up to the radius of the ball.
    assert np.mean(distance[10_000:]) == pytest.approx(0.5 * radius(REACH, 2), rel=0.03)
    assert (np.histogram(angle[far], bins=12, range=(-np.pi, np.pi))[0] > 0).all()


def test_without_anything_important_the_population_is_radial() -> None:
    space = standard_normal(3)
    one = population(space, 4000, lambda X: np.zeros(len(X)), np.random.default_rng(1))
    assert abs(one.weight.mean() - 1.0) < 0.05


def test_a_feature_that_is_not_finite_far_out_is_named_with_its_design() -> None:
    space = standard_normal(1)
    features = feature_map(ExpressionFeatures({"root": "sqrt(5.0 - x0)"}), space)
    with pytest.raises(InputError, match=r"classifier.features: root must be finite wherever designs may lie, got nan"):
        finite(features, np.array([[5.2]]))


def test_bounded_variables_keep_their_bounds() -> None:
    space = DesignSpace((Parameter("a", 2.0, 3.0), Parameter("b", 1.0, 10.0, distribution="log_uniform")))
    drawn = population(space, 5000, lambda X: X[:, 0] > 2.99, np.random.default_rng(2))
    assert space.contains(drawn.X).all()
    assert np.mean(drawn.weight * (drawn.X[:, 0] < 2.25)) == pytest.approx(0.25, abs=0.03)
