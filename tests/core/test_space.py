"""The design space: samples that are what they are called, and bounds that hold to the last bit."""

import math
import signal
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import qmc

from activefail.errors import InputError
from activefail.space import space
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

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
    first, repeated, other = (getattr(SPACE, sample)(64, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first.tobytes() == repeated.tobytes()
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
    # What subtracting a bound can lose: the rounding of the bound in units of the range, which near 0 ends at the
    # least number there is.
    rounding = 1e-15 * max(map(abs, bounds)) + np.finfo(float).smallest_subnormal
    lost = 1e-15 + rounding / (bounds[1] - bounds[0])
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


WIND = Parameter("wind", 10.0, 60.0, "m/s", "truncated_normal", mean=20.0, sd=12.0)
SHAPED = DesignSpace((Parameter("x", -2.0, 3.0), Parameter("k", 1e6, 1e9, distribution="log_uniform"), WIND))


def test_the_quantiles_of_a_variable_are_those_of_its_distribution() -> None:
    u = np.linspace(0.0, 1.0, 101)
    X = SHAPED.from_unit(np.column_stack([u, u, u]))
    normal = stats.truncnorm((10.0 - 20.0) / 12.0, (60.0 - 20.0) / 12.0, 20.0, 12.0)
    np.testing.assert_allclose(X[:, 0], stats.uniform(-2.0, 5.0).ppf(u), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(X[:, 1], stats.loguniform(1e6, 1e9).ppf(u), rtol=1e-12)
    np.testing.assert_allclose(X[:, 2], normal.ppf(u), rtol=1e-10)
    np.testing.assert_allclose(SHAPED.to_unit(X), np.column_stack([u, u, u]), atol=1e-12)
    assert SHAPED.contains(X).all()


def test_a_uniform_variable_is_sampled_to_the_bit_as_low_plus_u_times_the_width() -> None:
    U = np.random.default_rng(0).random((64, 3))
    assert SPACE.from_unit(U).tobytes() == (SPACE.low + U * (SPACE.high - SPACE.low)).tobytes()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            {"distribution": "log_uniform", "low": 0.0},
            "`low > 0` must hold for a log-uniform distribution, got 0.0",
        ),
        ({"distribution": "truncated_normal"}, "requires `mean` and `sd`, or `mean` and `cov`; got none"),
        ({"mean": 0.5, "sd": 0.1}, "a uniform distribution takes only `low` and `high`"),
        ({"distribution": "truncated_normal", "mean": 0.5, "sd": 0.0}, "'x': `sd > 0` must hold, got 0.0"),
        (
            {"distribution": "truncated_normal", "mean": 50.0, "sd": 0.5},
            "must contain at least 1e-06 of the truncated normal",
        ),
    ],
)
def test_numbers_that_make_no_distribution_are_refused(given: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Parameter(**{"name": "x", "low": -1.0, "high": 1.0} | given)


@pytest.mark.parametrize(
    ("fixed", "says"),
    [({"x": 1.0}, "'x' is defined twice"), ({"a b": 1.0}, "identifier"), ({"T": math.nan}, "must be finite")],
)
def test_a_fixed_quantity_needs_a_name_of_its_own_and_a_number(fixed: dict[str, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        DesignSpace(SPACE.parameters, fixed)


def test_quantities_are_picked_in_the_order_asked_for_with_those_that_are_fixed() -> None:
    space = DesignSpace(SPACE.parameters, {"storeys": 3.0})
    X = space.latin_hypercube(4, np.random.default_rng(0))
    assert space.table(X, ["mu", "storeys", "x"]).tolist() == [[mu, 3.0, x] for x, _, mu in X.tolist()]
    assert space.table(X, space.names).tolist() == X.tolist()
    assert space.pick(["a", "b", "c"], ["storeys", "k"]) == [3.0, "b"]


def test_picking_a_variable_that_is_missing_names_it_and_those_that_there_are() -> None:
    with pytest.raises(InputError, match=r"lacks the variable 'A_p'; its variables are x, k, mu"):
        SPACE.table(np.zeros((1, 3)), ["x", "A_p"])


@pytest.mark.parametrize(
    ("low", "high"), [(1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.nan), (-math.inf, 0.0), (0.0, math.inf)]
)
def test_a_range_that_is_empty_or_not_finite_is_refused_with_rule_name_and_values(low: float, high: float) -> None:
    with pytest.raises(InputError) as refused:
        Parameter("mu", low, high)
    assert str(refused.value) == f"The variable 'mu': `low < high` must hold, got {low} and {high}."


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0 + 1e-12), (-5.0, -5.0 + 1e-10), (0.49999999999999994, 0.5)])
def test_a_range_that_holds_too_few_numbers_to_choose_from_is_refused(low: float, high: float) -> None:
    with pytest.raises(InputError, match="`high - low` must be at least 1e-09 times the larger of"):
        Parameter("mu", low, high)
    Parameter("mu", 0.0, 1e-12)


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


def test_a_ctrl_c_while_scipy_reads_its_direction_numbers_arrives_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []

    class Struck(qmc.Sobol):  # type: ignore[misc]
        def __init__(self, *given: Any, **options: Any) -> None:
            signal.raise_signal(signal.SIGINT)
            made.append(given)
            super().__init__(*given, **options)

    monkeypatch.setattr(qmc, "Sobol", Struck)
    space._read_direction_numbers.cache_clear()
    with pytest.raises(KeyboardInterrupt):
        SPACE.sobol(8, np.random.default_rng(0))
    assert made == [(1,)]
    monkeypatch.undo()
    assert np.ptp(SPACE.sobol(8, np.random.default_rng(0)), axis=0).all()


def test_pictures_show_where_the_probability_lives_and_whole_ranges_that_have_no_tails() -> None:
    parameters = (
        Parameter.of_distribution("load", "normal", {"mean": 10.0, "sd": 2.0}, distance=5.6),
        Parameter("width", 0.2, 1.0),
        Parameter.of_choices("soil", ["A", "B", "C"], [0.2, 0.7, 0.1]),
    )
    space = DesignSpace(parameters)
    low, high = space.usual
    np.testing.assert_allclose([low[0], high[0]], 10.0 + 2.0 * stats.norm.ppf([0.001, 0.999]), atol=1e-4)
    assert (low[1:].tolist(), high[1:].tolist()) == ([0.2, 0.0], [1.0, 2.0])
    assert space.middle.tolist() == [10.0, 0.6, 1.0]
