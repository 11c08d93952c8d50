"""What the classifier sees of a design: features, in standard units over the design space."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from activefail.errors import InputError
from activefail.learning.features import CustomFeatures, feature_map
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.plugins import brought
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace

SQUARE = DesignSpace((Parameter("x", -2.0, 3.0), Parameter("y", 10.0, 50.0)))


@pytest.mark.parametrize("name", ["design", "decorrelated"])
def test_features_have_mean_0_and_standard_deviation_1_over_the_design_measure(name: str) -> None:
    F = feature_map(name, SQUARE)(SQUARE.sobol(2**13, np.random.default_rng(99)))  # type: ignore[arg-type]
    assert_allclose(F.mean(axis=0), 0.0, atol=0.01)
    assert_allclose(F.std(axis=0), 1.0, atol=0.01)


def test_the_features_of_a_design_do_not_depend_on_the_designs_beside_it() -> None:
    features, X = feature_map("design", SQUARE), SQUARE.latin_hypercube(50, np.random.default_rng(3))
    assert features(X)[17:18].tobytes() == features(X[17:18]).tobytes()


def test_the_designs_own_features_are_its_variables_in_standard_units() -> None:
    space = DesignSpace((Parameter("x", -2.0, 3.0), Parameter("y", 10.0, 50.0)))
    features = feature_map("design", space)
    assert features.names == ("x", "y")
    root_12 = np.sqrt(12.0)
    assert_allclose(
        features(np.array([[-2.0, 10.0], [0.5, 30.0], [3.0, 50.0]])),
        root_12 * np.array([[-0.5, -0.5], [0.0, 0.0], [0.5, 0.5]]),
        atol=5e-3,
    )


def test_the_designs_own_features_do_not_depend_on_its_units() -> None:
    metres = DesignSpace((Parameter("x", -2.0, 3.0), Parameter("y", 10.0, 50.0)))
    millimetres = DesignSpace((Parameter("x", -2000.0, 3000.0), Parameter("y", 10.0, 50.0)))
    X = metres.latin_hypercube(20, np.random.default_rng(1))
    assert_allclose(
        feature_map("design", millimetres)(X * [1000.0, 1.0]), feature_map("design", metres)(X), rtol=1e-10, atol=1e-12
    )


CORRELATED = DesignSpace(
    (
        Parameter("a", 20.0, 120.0, distribution="lognormal", mean=50.0, sd=10.0),
        Parameter("b", 0.0, 1.0),
        Parameter("c", -1.0, 1.0),
    ),
    correlation=(("b", "c", 0.9999),),
)


def test_decorrelated_features_are_uncorrelated_and_linear_in_the_variables() -> None:
    features = feature_map("decorrelated", CORRELATED)
    assert features.names == ("a", "b", "c_given_b")
    X = CORRELATED.latin_hypercube(4000, np.random.default_rng(1))
    assert_allclose(np.corrcoef(features(X).T), np.eye(3), atol=0.05)
    T = np.column_stack([np.log(X[:, 0]), X[:, 1:]])
    assert_allclose(features(0.5 * X[:1] + 0.5 * X[1:2])[:, 1:], 0.5 * features(X[:2]).sum(axis=0)[None, 1:], atol=1e-8)
    with_one = np.column_stack([np.ones(len(T)), T])
    weights = np.linalg.lstsq(with_one, features(X), rcond=None)[0]
    assert_allclose(with_one @ weights, features(X), atol=1e-8)


def test_without_correlation_the_decorrelated_features_are_the_variables() -> None:
    X = SQUARE.latin_hypercube(5, np.random.default_rng(1))
    np.testing.assert_array_equal(feature_map("decorrelated", SQUARE)(X), feature_map("design", SQUARE)(X))


def test_the_difference_of_nearly_equal_variables_is_learned_from_decorrelated_features() -> None:
    X = CORRELATED.latin_hypercube(60, np.random.default_rng(2))
    fresh = CORRELATED.latin_hypercube(2000, np.random.default_rng(3))

    def margin(X: np.ndarray) -> np.ndarray:
        return 1.0 - np.square(100.0 * (X[:, 2] - (2.0 * X[:, 1] - 1.0))) + np.log(X[:, 0] / 50.0)

    wrong = {}
    for name in ("design", "decorrelated"):
        features = feature_map(name, CORRELATED)
        mean = MarginLatent(fit_margin(features(X), margin(X))).moments(features(fresh)).mean
        wrong[name] = np.mean((mean > 0.0) != (margin(fresh) <= 0.0))
    assert wrong["decorrelated"] < 0.01
    assert wrong["design"] > 0.1


def test_two_maps_of_one_space_are_the_same_bits() -> None:
    X = SQUARE.latin_hypercube(20, np.random.default_rng(1))
    assert feature_map("design", SQUARE)(X).tobytes() == feature_map("design", SQUARE)(X).tobytes()


def test_an_unknown_feature_set_is_refused_with_rule_and_value() -> None:
    names = ", ".join(["design", "decorrelated", *brought("features")])
    with pytest.raises(InputError, match=f"must be one of {names}, got 'fourier'"):
        feature_map("fourier", SQUARE)  # type: ignore[arg-type]


def _product(X: Array, space: DesignSpace) -> Array:
    return (X[:, :1] * X[:, 1:]) / space.high[1]


def test_a_function_of_ones_own_is_appended_to_the_variables_and_scaled_like_them() -> None:
    features = feature_map(CustomFeatures("product", _product), SQUARE)
    assert features.names == ("x", "y", "product[0]")
    X = SQUARE.sobol(2**14, np.random.default_rng(99))
    assert features.raw(X)[:, 2].tolist() == (X[:, 0] * X[:, 1] / 50.0).tolist()
    assert_allclose(features(X).mean(axis=0), 0.0, atol=0.01)
    assert_allclose(features(X).std(axis=0), 1.0, atol=0.01)


def test_a_function_of_ones_own_can_replace_the_variables() -> None:
    features = feature_map(CustomFeatures("product", _product, variables=False), SQUARE)
    assert features.names == ("product[0]",)


def test_a_function_of_ones_own_cannot_change_the_designs() -> None:
    def greedy(X: Array, space: DesignSpace) -> Array:
        X *= 2.0
        return X

    X = SQUARE.sobol(8, np.random.default_rng(0))
    assert feature_map(CustomFeatures("greedy", greedy), SQUARE).raw(X)[:, :2].tolist() == X.tolist()


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (lambda X, space: X[:, 0], r"one row of features per design, shape \(8, m\); got shape \(8,\)"),
        (lambda X, space: X[:-1], r"one row of features per design, shape \(8, m\); got shape \(7, 2\)"),
        (lambda X, space: X[:, :0], r"got shape \(8, 0\)"),
        (lambda X, space: None, r"got shape \(\)"),
        (lambda X, space: [["a"]] * len(X), r"must return an \(n, m\) array of numbers; NumPy reports: "),
        (lambda X, space: 1 // 0, r"mine raised ZeroDivisionError: .* \(.*test_features\.py:\d+\)"),
        (lambda X, space: X[:, : 1 + (len(X) > 8)], r"always return the same number of features; got 1, then 2"),
        (
            lambda X, space: np.where(X > 2.0, np.nan, X),
            r"mine\[0\] must be finite over the space, got nan for \{'x': 2\.",
        ),
        (lambda X, space: np.zeros((len(X), 1)), r"mine\[0\] must vary over the space, got 0\.0 everywhere"),
        (lambda X, space: X - X.mean(axis=0), r"the same features for a design, regardless of the other designs"),
    ],
)
def test_a_function_that_gives_no_features_is_refused_with_key_rule_and_value(function: object, says: str) -> None:
    with pytest.raises(InputError, match=rf"^classifier\.features: mine.*{says}|^classifier\.features: {says}"):
        feature_map(CustomFeatures("mine", function), SQUARE)  # type: ignore[arg-type]


def test_a_variable_whose_range_is_too_small_to_be_scaled_is_refused() -> None:
    space = DesignSpace((Parameter("x", 0.0, 6e-310), Parameter("y", 0.0, 1.0)))
    with pytest.raises(InputError, match=r"^classifier\.features: x must have a standard deviation over the space"):
        feature_map("design", space)
