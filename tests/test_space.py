"""The design space: samples that are what they are called, and bounds that hold to the last bit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from activefail.bearing import TABLE_1
from activefail.errors import InputError
from activefail.space import DesignSpace, Parameter

SPACE = DesignSpace((Parameter("x", -2.0, 3.0, "m"), Parameter("k", 2.5e8, 50e8), Parameter("mu", 0.02, 0.12)))

bounds = (
    st.tuples(st.floats(-1e12, 1e12), st.floats(-1e12, 1e12))
    .map(sorted)
    .filter(lambda pair: pair[1] - pair[0] > 1e-9 * max(map(abs, pair)))
)


@pytest.mark.parametrize("n", [1, 2, 7, 250])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_latin_hypercube_has_one_design_in_each_of_the_n_strata_of_each_variable(n: int, seed: int) -> None:
    X = SPACE.latin_hypercube(n, np.random.default_rng(seed))
    strata = np.floor(SPACE.to_unit(X) * n).astype(int)
    assert X.shape == (n, 3)
    assert (np.sort(strata, axis=0) == np.arange(n)[:, None]).all()


def test_the_variables_of_a_latin_hypercube_are_permuted_independently() -> None:
    ranks = np.argsort(np.argsort(SPACE.latin_hypercube(400, np.random.default_rng(0)), axis=0), axis=0)
    correlation = np.corrcoef(ranks.T)[np.triu_indices(3, 1)]
    # Four standard deviations of a rank correlation of 400 independent pairs.
    assert np.abs(correlation).max() < 4.0 / math.sqrt(400)


@pytest.mark.parametrize("sample", ["latin_hypercube", "sobol"])
def test_a_sample_follows_from_its_generator_and_from_nothing_else(sample: str) -> None:
    first, again, other = (getattr(SPACE, sample)(64, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first.tobytes() == again.tobytes()
    assert not np.isin(first, other).any()


@pytest.mark.parametrize("sample", ["latin_hypercube", "sobol"])
def test_samples_lie_in_the_box_and_fill_it_uniformly(sample: str) -> None:
    U = SPACE.to_unit(getattr(SPACE, sample)(1024, np.random.default_rng(2)))
    assert U.min() >= 0.0
    assert U.max() <= 1.0
    assert np.allclose(U.mean(axis=0), 0.5, atol=0.01)
    assert np.allclose(U.std(axis=0), math.sqrt(1.0 / 12.0), atol=0.01)


@settings(deadline=None)
@given(bounds=bounds, u=st.floats(0.0, 1.0))
def test_no_point_of_the_unit_cube_leaves_the_box_whatever_the_rounding(bounds: list[float], u: float) -> None:
    space = DesignSpace((Parameter("x", *bounds),))
    X = space.from_unit(np.array([[u], [0.0], [1.0]]))
    assert space.contains(X).all()
    assert X[1, 0] == bounds[0]
    assert abs(X[2, 0] - bounds[1]) <= 2.0 * np.spacing(max(map(abs, bounds)))


@settings(deadline=None)
@given(bounds=bounds, u=st.floats(0.0, 1.0))
def test_the_unit_cube_and_the_box_map_to_each_other(bounds: list[float], u: float) -> None:
    space = DesignSpace((Parameter("x", *bounds),))
    # What subtracting a bound can lose: the rounding of the bound in units of the range.
    lost = 1e-15 * (1.0 + max(map(abs, bounds)) / (bounds[1] - bounds[0]))
    assert abs(float(space.to_unit(space.from_unit(np.array([[u]])))[0, 0]) - u) <= 4.0 * lost


def test_a_design_is_contained_up_to_its_bounds_and_not_beyond_in_any_variable() -> None:
    rows = [SPACE.low, SPACE.high]
    for column in range(SPACE.dimension):
        for bound, outward in ((SPACE.low, -np.inf), (SPACE.high, np.inf)):
            row = bound.copy()
            row[column] = np.nextafter(row[column], outward)
            rows.append(row)
    assert SPACE.contains(np.array(rows)).tolist() == [True, True, *[False] * 6]


def test_a_design_with_a_nan_is_not_contained() -> None:
    assert SPACE.contains(np.array([[np.nan, 1e9, 0.05]])).tolist() == [False]


def test_columns_are_selected_in_the_order_asked_for() -> None:
    assert SPACE.select(["mu", "x"]).tolist() == [2, 0]
    assert SPACE.select(SPACE.names).tolist() == [0, 1, 2]


def test_selecting_a_variable_that_is_missing_names_it_and_those_that_there_are() -> None:
    with pytest.raises(InputError, match=r"lacks the variable 'A_p'; it has x, k, mu"):
        SPACE.select(["x", "A_p"])


@pytest.mark.parametrize(
    ("low", "high"), [(1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.nan), (-math.inf, 0.0), (0.0, math.inf)]
)
def test_a_range_that_is_empty_or_not_finite_is_refused_with_rule_name_and_values(low: float, high: float) -> None:
    with pytest.raises(InputError) as refused:
        Parameter("mu", low, high)
    assert str(refused.value) == f"`low < high` must hold for 'mu', got {low} and {high}."


@pytest.mark.parametrize("name", ["", "T b", "1st", "a-b", "x.y", "x/y"])
def test_a_name_that_is_no_identifier_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="must be an identifier, got " + repr(name)):
        Parameter(name, 0.0, 1.0)


def test_a_space_without_variables_or_with_one_twice_is_refused() -> None:
    with pytest.raises(InputError, match="at least one variable"):
        DesignSpace(())
    with pytest.raises(InputError, match="'x' is defined twice"):
        DesignSpace((Parameter("x", 0.0, 1.0), Parameter("y", 0.0, 1.0), Parameter("x", 2.0, 3.0)))


def test_a_label_bears_the_unit_where_there_is_one() -> None:
    assert [parameter.label for parameter in SPACE.parameters] == ["x [m]", "k", "mu"]


def test_table_1_is_the_papers() -> None:
    rows = {
        "T_b": (2.5, 5.5, "s"),
        "mu": (0.02, 0.12, ""),
        "D_tot": (0.450, 0.850, "m"),
        "h_sl_ratio": (0.33, 1.3, ""),
        "h_rim_ratio": (0.05, 0.2, ""),
        "p": (30.0, 60.0, "MPa"),
        "k": (2.5e8, 50e8, "N/m^1.5"),
        "T_p": (0.25, 5.0, "s"),
        "A_p": (0.1, 0.8, "g"),
    }
    assert {p.name: (p.low, p.high, p.unit) for p in TABLE_1.parameters} == rows
