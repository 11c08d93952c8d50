"""Expressions: arithmetic is computed, and followed by gradients; anything else is refused before anything is run."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from activefail.errors import InputError
from activefail.learning.features import ExpressionFeatures, feature_map
from activefail.space.expressions import parse_expression
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

VALUES = {"A_p": 0.7, "T_p": 1.3, "D": 0.9}

ARITHMETIC = {
    "A_p * g * T_p / (2 * pi)": 0.7 * 9.81 * 1.3 / (2.0 * np.pi),
    "-A_p + T_p - 2e-3 / D": -0.7 + 1.3 - 2e-3 / 0.9,
    "A_p ** 2 ** T_p": 0.7 ** (2.0**1.3),
    "sqrt(A_p) * exp(-T_p) + log(D)": np.sqrt(0.7) * np.exp(-1.3) + np.log(0.9),
    "sin(A_p) + cos(T_p) + tan(D) + arctan(A_p) + tanh(T_p)": (
        np.sin(0.7) + np.cos(1.3) + np.tan(0.9) + np.arctan(0.7) + np.tanh(1.3)
    ),
    "minimum(A_p, T_p) + maximum(A_p, 0.8) + abs(-D)": 0.7 + 0.8 + 0.9,
    "  T_p ": 1.3,
    "3": 3.0,
}


@pytest.mark.parametrize("text", ARITHMETIC)
def test_arithmetic_is_computed_on_numbers_and_arrays_alike(text: str) -> None:
    expression = parse_expression(text, VALUES)
    assert expression(VALUES) == pytest.approx(ARITHMETIC[text], rel=1e-12)
    arrays = {name: np.full(3, value) for name, value in VALUES.items()}
    np.testing.assert_allclose(expression(arrays), ARITHMETIC[text], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "must be an arithmetic expression"),
        ("A_p +", r"must be an arithmetic expression, got 'A_p \+' \([^()]*\)"),
        ("A_p = 3", "must be an arithmetic expression"),
        ("Ap * 2", "unknown name 'Ap'; known names are A_p, D, T_p, g, pi"),
        ("__import__('os').system('true')", r"got \"__import__\('os'\).system\('true'\)\""),
        ("eval('1')", 'got "eval'),
        ("A_p.real", "got 'A_p.real'"),
        ("[A_p][0]", "got"),
        ("(lambda: 1)()", "got"),
        ("A_p if T_p else D", "got"),
        ("A_p < T_p", "got"),
        ("A_p and T_p", "got"),
        ("A_p // 2", "got"),
        ("A_p % 2", "got"),
        ("~A_p", "got"),
        ("not A_p", "got"),
        ("'text'", "got"),
        ("True", "got"),
        ("1j", "got"),
        ("None", "got"),
        ("f'{A_p}'", "got"),
        ("sqrt(A_p, T_p)", "sqrt takes 1 argument, got 2"),
        ("minimum(A_p)", "minimum takes 2 arguments, got 1"),
        ("sqrt(x=A_p)", "got"),
        ("sqrt(*A_p)", "got"),
        ("gamma(A_p)", r"got 'gamma\(A_p\)'"),
        ("1+" * 600 + "1", "must have at most 1000 characters, got 1201"),
        ("(" * 400 + "1" + ")" * 400, "must be an arithmetic expression"),
        ("-" * 990 + "1", "must have at most 500 levels of nesting, got 99|must be an arithmetic expression"),
        ("-" * 600 + "A_p", "must have at most 500 levels of nesting, got 60"),
        ("9" * 400, r"may contain numbers up to 1.79769e\+308; in '999"),
        ("1e400", "may contain numbers up to"),
    ],
)
def test_what_is_no_arithmetic_is_refused_with_the_part_that_is_not(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_expression(text, VALUES)


@given(text=st.text(max_size=60) | st.from_regex(r"[A_pTD0-9+*/().,\- a-z]{1,40}", fullmatch=True))
def test_any_text_is_an_expression_or_refused(text: str) -> None:
    try:
        expression = parse_expression(text, VALUES)
    except ValueError:
        return
    with np.errstate(all="ignore"):
        value = expression({name: np.array([number]) for name, number in VALUES.items()})
    assert np.size(value) == 1
    assert np.asarray(value).dtype == float


@pytest.mark.parametrize(
    ("text", "value"), [("9 ** 9 ** 9 ** 9", np.inf), ("1 / 0", np.inf), ("(0 - 1) ** 0.5", np.nan)]
)
def test_numbers_alone_end_in_what_is_not_finite_too(text: str, value: float) -> None:
    with np.errstate(all="ignore"):
        assert parse_expression(text, {})({}) == pytest.approx(value, nan_ok=True)


def test_the_names_in_an_expression_are_its_quantities_and_without_known_ones_all_are() -> None:
    assert parse_expression("log(A_p) * pi + g * T_p", VALUES).names == {"A_p", "T_p"}
    every = parse_expression("abs(g) + pi - log", None)
    assert every.names == {"g", "pi", "log"}
    assert every({"g": -2.0, "pi": 1.0, "log": 5.0}) == -2.0


@pytest.mark.parametrize("name", ["\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}"])
@pytest.mark.parametrize("requested", ["\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}"])
def test_a_letter_that_has_two_codes_names_the_quantity_by_either(name: str, requested: str) -> None:
    assert parse_expression(f"2 * {requested}_1", [f"{name}_1"])({f"{name}_1": 0.1}) == 0.2


def test_quantities_whose_names_python_reads_as_one_are_refused() -> None:
    with pytest.raises(ValueError, match=r"cannot distinguish '\\xb5' from '\\u03bc'.*rename one"):
        parse_expression("2 * x", ["x", "\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}"])


SPACE = DesignSpace(
    (Parameter("A_p", 0.1, 2.0), Parameter("T_p", 0.5, 4.0), Parameter("k", 1e6, 1e9, distribution="log_uniform")),
    {"D": 0.9},
)


def test_features_by_expressions_follow_the_variables_and_use_what_is_fixed() -> None:
    given = ExpressionFeatures({"ratio": "A_p * T_p ** 2 / D", "lesser": "minimum(A_p, T_p)"})
    features = feature_map(given, SPACE)
    assert features.names == ("A_p", "T_p", "k", "ratio", "lesser")
    assert features.logarithmic.tolist() == [False, False, True, False, False]
    X = SPACE.latin_hypercube(16, np.random.default_rng(0))
    raw = np.column_stack([X, X[:, 0] * X[:, 1] ** 2 / 0.9, np.minimum(X[:, 0], X[:, 1])])
    np.testing.assert_allclose(features.raw(X), raw, rtol=1e-14)


def test_expressions_may_stand_without_the_variables() -> None:
    features = feature_map(ExpressionFeatures({"product": "A_p * T_p"}, variables=False), SPACE)
    assert features.names == ("product",)
    assert features(SPACE.sobol(8, np.random.default_rng(0))).shape == (8, 1)


@pytest.mark.parametrize(
    ("expressions", "says"),
    [
        ({"T_p": "A_p"}, "expressions.T_p: must not have the name of another quantity"),
        ({"a": "A_q"}, "expressions.a: unknown name 'A_q'; known names are A_p, D, T_p, g, k, pi; in 'A_q'"),
        ({"a": "log(A_p - 1)"}, "a must be finite over the space, got nan for {'A_p'"),
        ({"a": "1 / (D - 0.9)"}, "a must be finite over the space, got inf"),
        ({"a": "2 * D"}, "a must vary over the space, got 1.8 everywhere"),
        ({"a": "A_p * 1e-200"}, "a must have a standard deviation over the space that fits a float64, got values"),
        ({"a": "A_p * 1e-310"}, "a must have a standard deviation over the space that fits a float64, got values"),
        ({"a": "A_p * 1e200"}, "a must have a standard deviation over the space that fits a float64, got values"),
    ],
)
def test_expressions_that_make_no_feature_are_refused(expressions: dict[str, str], says: str) -> None:
    with pytest.raises(InputError, match=says):
        feature_map(ExpressionFeatures(expressions), SPACE)
