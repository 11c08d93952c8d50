"""The design point is the nearest point of the boundary, on whichever side the medians are."""

import numpy as np
import pytest
from scipy.special import ndtr

from activefail.estimates.design_point import design_point
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

NORMAL = tuple(Parameter(name, -6.4, 6.4, distribution="normal", mean=0.0, sd=1.0) for name in ("x", "y", "z"))
SPACE = DesignSpace(NORMAL)


def generator() -> np.random.Generator:
    return np.random.default_rng(4)


def test_of_a_plane_it_is_the_foot_of_the_perpendicular() -> None:
    normal = np.array([0.8, -0.6, 0.0])
    point = design_point(lambda X: 10.0 * (X @ normal - 3.2), SPACE, generator())
    assert point is not None
    assert point.beta == pytest.approx(3.2, abs=1e-3)
    assert pytest.approx(3.2 * normal, abs=1e-3) == point.Z
    assert pytest.approx(point.Z, abs=1e-6) == point.X
    assert point.importance == pytest.approx(normal**2, abs=1e-3)
    assert point.probability == pytest.approx(ndtr(-3.2), rel=1e-2)


def test_of_two_modes_it_is_in_the_nearer_one() -> None:
    point = design_point(lambda X: 10.0 * np.maximum(X[:, 0] - 3.4, -X[:, 1] - 3.0), SPACE, generator())
    assert point is not None
    assert pytest.approx([0.0, -3.0, 0.0], abs=1e-3) == point.Z


def test_on_a_curved_boundary_no_point_beyond_it_is_nearer() -> None:
    def standardised(X):
        return 5.0 * (X[:, 0] - 0.3 * X[:, 1] ** 2 + 0.2 * np.sin(3.0 * X[:, 2]) - 2.5)

    point = design_point(standardised, SPACE, generator())
    assert point is not None
    # No design of a dense grid beyond the boundary is nearer.
    line = np.linspace(-4.0, 4.0, 81)
    grid = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    nearest = np.sqrt((grid[standardised(grid) > 0.0] ** 2).sum(axis=1).min())
    assert point.beta <= nearest
    assert standardised(point.X[None])[0] > -0.05


def test_where_the_medians_fail_the_index_is_negative() -> None:
    point = design_point(lambda X: 10.0 * (X[:, 2] + 1.5), SPACE, generator())
    assert point is not None
    assert point.beta == pytest.approx(-1.5, abs=1e-3)
    assert pytest.approx([0.0, 0.0, -1.5], abs=1e-3) == point.Z
    assert point.probability > 0.9


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_there_is_none_if_all_designs_are_on_one_side(side: float) -> None:
    assert design_point(lambda X: np.full(len(X), side), SPACE, generator()) is None


def test_with_other_distributions_and_a_correlation_it_is_nearest_in_standard_normal_space() -> None:
    space = DesignSpace(
        (
            Parameter("load", 1.0, 90.0, distribution="gumbel_max", mean=20.0, sd=4.0),
            Parameter("share", 0.0, 1.0),
        ),
        correlation=(("load", "share", 0.5),),
    )
    point = design_point(lambda X: X[:, 0] + 5.0 * X[:, 1] - 42.0, space, generator())
    assert point is not None
    assert point.X[0] + 5.0 * point.X[1] == pytest.approx(42.0, abs=0.06)
    assert space.to_normal(point.X[None])[0] == pytest.approx(point.Z, abs=1e-3)
    Z = generator().standard_normal((400_000, 2)) * 1.6
    X = space.from_normal(Z)
    beyond = X[:, 0] + 5.0 * X[:, 1] > 42.0
    assert point.beta <= np.sqrt((Z[beyond] ** 2).sum(axis=1).min())
