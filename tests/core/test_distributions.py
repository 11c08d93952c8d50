import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import tomli_w
from scipy import stats

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.execution.local import ThreadExecutor
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.simulators.interface import Results
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace, nataf_factor, radius

# The same distributions by their own parameters, and as SciPy has them.
OWN: dict[str, tuple[dict[str, float], Any]] = {
    "normal": ({"mean": -3.0, "sd": 2.0}, stats.norm(-3.0, 2.0)),
    "lognormal": ({"median": 20.0, "dispersion": 0.4}, stats.lognorm(0.4, scale=20.0)),
    "gumbel_max": ({"location": 10.0, "scale": 2.0}, stats.gumbel_r(10.0, 2.0)),
    "gumbel_min": ({"location": 10.0, "scale": 2.0}, stats.gumbel_l(10.0, 2.0)),
    "weibull": ({"shape": 1.7, "scale": 30.0}, stats.weibull_min(1.7, scale=30.0)),
    "gamma": ({"shape": 4.0, "scale": 2.5}, stats.gamma(4.0, scale=2.5)),
    "beta": ({"low": -1.0, "high": 4.0, "alpha": 2.0, "beta": 3.5}, stats.beta(2.0, 3.5, -1.0, 5.0)),
    "exponential": ({"rate": 0.25}, stats.expon(scale=4.0)),
}


def variable(distribution: str, reach: float = 1e-8, **numbers: float) -> Parameter:
    text = tomli_w.dumps(
        {
            "simulator": {"python": "model:f", "outcomes": ["safe", "failed"]},
            "sampling": {"reach": reach},
            "space": {"x": {"distribution": distribution, **numbers}},
        }
    )
    return parse_settings(text, "one.toml").design_space().parameters[0]


@pytest.mark.parametrize("distribution", OWN)
def test_a_distribution_by_its_own_parameters_is_scipys(distribution: str) -> None:
    numbers, law = OWN[distribution]
    parameter = variable(distribution, **numbers)
    z = np.linspace(-5.0, 5.0, 41)
    expected = np.where(z < 0.0, law.ppf(stats.norm.cdf(z)), law.isf(stats.norm.sf(z)))
    # Conditional on its bounds, which leave out 10⁻⁸.
    np.testing.assert_allclose(parameter.from_normal(z)[10:-10], expected[10:-10], rtol=3e-5, atol=1e-5)
    np.testing.assert_allclose(parameter.from_normal(z), expected, rtol=0.02, atol=1e-5)
    assert parameter.outside <= 1.001e-8


@pytest.mark.parametrize("distribution", OWN)
def test_mean_and_sd_or_mean_and_cov_define_the_same_distribution(distribution: str) -> None:
    numbers, law = OWN[distribution]
    bounds = {key: numbers[key] for key in ("low", "high") if key in numbers}
    own, mean, sd = variable(distribution, **numbers), float(law.mean()), float(law.std())
    z = np.linspace(-4.0, 4.0, 33)
    spreads = [{}] if distribution == "exponential" else [{"sd": sd}, {"cov": sd / abs(mean)}]
    for spread in spreads:
        other = variable(distribution, mean=mean, **spread, **bounds)
        np.testing.assert_allclose(other.from_normal(z), own.from_normal(z), rtol=1e-7)


@pytest.mark.parametrize("distribution", [*OWN, "uniform", "log_uniform", "truncated_normal"])
def test_standard_normal_values_and_back_agree_in_both_tails(distribution: str) -> None:
    bounded = {"low": 1.0, "high": 4.0}
    numbers = OWN[distribution][0] if distribution in OWN else bounded
    if distribution == "truncated_normal":
        numbers = {"low": -9.0, "high": 30.0, "mean": 3.0, "sd": 4.0}
    parameter = variable(distribution, **numbers)
    z = np.linspace(-5.0, 5.0, 41)
    # A bounded variable's value near its upper bound has few digits left for the distance to it.
    within = np.abs(z) <= 4.0
    np.testing.assert_allclose(parameter.to_normal(parameter.from_normal(z))[within], z[within], atol=1e-6)
    u = stats.norm.cdf(z)
    np.testing.assert_allclose(parameter.share(parameter.from_normal(z)), u, atol=1e-9)
    assert (np.diff(parameter.from_normal(z)) > 0.0).all()


@pytest.mark.parametrize("distribution", [*OWN, "uniform", "log_uniform"])
def test_values_at_the_bounds_have_finite_places(distribution: str) -> None:
    parameter = variable(distribution, **(OWN[distribution][0] if distribution in OWN else {"low": 1.0, "high": 4.0}))
    ends = np.array([parameter.low, parameter.high])
    for place in (parameter.standardised, parameter.to_normal):
        assert np.isfinite(place(ends)).all()
        assert np.diff(place(ends))[0] > 2.0
    np.testing.assert_allclose(parameter.from_normal(parameter.to_normal(ends)), ends, rtol=1e-6, atol=1e-4)
    wider = parameter.widened(parameter.from_normal(np.array([-1.0, 0.0, 1.0])), 1.5)
    assert (parameter.low <= wider).all()
    assert (wider <= parameter.high).all()


@pytest.mark.parametrize("reach", [1e-8, 1e-3])
def test_bounds_that_the_file_leaves_out_enclose_the_ball_of_the_reach(reach: float) -> None:
    text = (
        f'sampling.reach = {reach}\nsimulator = {{ python = "m:f", outcomes = ["safe", "failed"] }}\n'
        'space.a = { distribution = "normal", mean = 1.0, sd = 2.0 }\n'
        'space.b = { distribution = "lognormal", median = 3.0, dispersion = 0.5, high = 30.0 }\n'
    )
    space = parse_settings(text, "two.toml").design_space()
    r = radius(reach, 2)
    assert 1.0 - stats.chi(2).cdf(r) == pytest.approx(reach, rel=1e-6)
    np.testing.assert_allclose(space.low, [1.0 - 2.0 * r, 3.0 * math.exp(-0.5 * r)], rtol=1e-9)
    np.testing.assert_allclose(space.high, [1.0 + 2.0 * r, 30.0], rtol=1e-9)
    inside = 2.0 * stats.norm.sf(r) + stats.norm.cdf(-r) + stats.norm.sf(math.log(10.0) / 0.5)
    assert space.outside == pytest.approx(inside, rel=1e-6)


BROKEN = {
    "a word": (
        {"distribution": "weibull", "mean": 1.0},
        "a Weibull distribution requires `mean` and `sd`, or `mean` and `cov`",
    ),
    "two ways at once": (
        {"distribution": "gamma", "mean": 1.0, "sd": 1.0, "shape": 2.0},
        "got `mean = 1` and `sd = 1` and",
    ),
    "negative mean": ({"distribution": "lognormal", "mean": -1.0, "sd": 1.0}, "`mean > 0` must hold, got -1"),
    "negative low": (
        {"distribution": "lognormal", "mean": 1.0, "sd": 1.0, "low": -1.0},
        "`low >= 0` must hold for a lognorm",
    ),
    "no spread": ({"distribution": "normal", "mean": 1.0, "sd": 0.0}, "`sd > 0` must hold, got 0"),
    "mean of nothing": ({"distribution": "normal", "mean": 0.0, "cov": 0.1}, "requires a mean other than 0"),
    "no beta": (
        {"distribution": "beta", "mean": 1.0, "sd": 9.0, "low": 0.0, "high": 2.0},
        "no beta distribution between 0 and 2",
    ),
    "a beta of two points": (
        {"distribution": "beta", "alpha": 0.01, "beta": 0.01, "low": 0.0, "high": 1.0},
        "`alpha` and `beta`",
    ),
    "a gamma at zero": (
        {"distribution": "gamma", "mean": 1.0, "cov": 30.0},
        "coefficient of variation must lie between",
    ),
    "a gamma of one value": ({"distribution": "gamma", "mean": 1.0, "cov": 1e-6}, "coefficient of variation must lie"),
    "tiny": ({"distribution": "exponential", "mean": 1e-320}, "the sd must be at least"),
    "no bounds": ({"distribution": "beta", "mean": 1.0, "sd": 0.1}, "requires `low` and `high`"),
    "overflow": (
        {"distribution": "lognormal", "median": 1.0, "dispersion": 60.0},
        "mean and sd must be at most 1e\\+100",
    ),
    "too wide": ({"distribution": "weibull", "mean": 1.0, "sd": 1e9}, "coefficient of variation must lie between"),
    "empty": ({"distribution": "gumbel_max", "mean": 1.0, "sd": 0.1, "high": -5.0}, "`low < high` must hold"),
    "in a tail": ({"distribution": "gumbel_max", "mean": 1.0, "sd": 0.1, "low": 3.0}, "must contain at least 1e-06"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_numbers_that_define_no_distribution_are_refused_by_their_rule(name: str) -> None:
    numbers, rule = BROKEN[name]
    with pytest.raises(InputError, match=f"space.x: .*{rule}"):
        variable(**numbers)


UNIFORM = Parameter("a", 0.0, 1.0), Parameter("b", -2.0, 5.0)
LOGNORMAL = (
    Parameter("a", 1e-3, 1e4, distribution="lognormal", mean=2.0, sd=1.0),
    Parameter("b", 1e-3, 1e4, distribution="lognormal", mean=5.0, sd=1.5),
)


@pytest.mark.parametrize("rho", [-0.8, -0.3, 0.5, 0.95])
def test_the_copula_of_uniform_and_of_lognormal_pairs_has_the_known_coefficient(rho: float) -> None:
    actual = nataf_factor(UNIFORM, [("a", "b", rho)])[1, 0]
    assert actual == pytest.approx(2.0 * math.sin(math.pi * rho / 6.0), abs=1e-9)
    if rho > -0.8:  # two positive variables cannot be so opposed
        actual = nataf_factor(LOGNORMAL, [("a", "b", rho)])[1, 0]
        one, other = (math.sqrt(math.log1p(cov**2)) for cov in (0.5, 0.3))
        assert actual == pytest.approx(math.log1p(rho * 0.5 * 0.3) / (one * other), abs=1e-4)


def test_designs_have_the_correlation_that_was_stated_and_their_own_distributions() -> None:
    load = Parameter("load", 0.0, 60.0, distribution="gumbel_max", mean=10.0, sd=2.0)
    strength = Parameter("strength", 1.0, 200.0, distribution="lognormal", mean=20.0, sd=6.0)
    space = DesignSpace((load, Parameter("k", 0.0, 1.0), strength), correlation=(("strength", "load", 0.6),))
    X = space.sobol(2**16, np.random.default_rng(0))
    correlation = np.corrcoef(X.T)
    assert correlation[0, 2] == pytest.approx(0.6, abs=0.005)
    assert abs(correlation[1]).tolist() == pytest.approx([0.0, 1.0, 0.0], abs=0.005)
    np.testing.assert_allclose(X.mean(axis=0), [10.0, 0.5, 20.0], rtol=2e-3)
    np.testing.assert_allclose(X.std(axis=0), [2.0, 12.0**-0.5, 6.0], rtol=5e-3)
    Z = space.to_normal(X)
    np.testing.assert_allclose(np.corrcoef(Z.T), np.eye(3), atol=0.01)
    np.testing.assert_allclose(space.from_normal(Z), X, rtol=1e-9)
    np.testing.assert_allclose(space.from_unit(space.to_unit(X)), X, rtol=1e-7)


@pytest.mark.parametrize(
    ("correlation", "rule"),
    [
        ([("a", "c", 0.5)], r"correlation\[0\]: 'c' is not a variable; the variables are a, b"),
        ([("a", "a", 0.5)], r"correlation\[0\]: names 'a' twice"),
        ([("a", "b", 1.0)], r"correlation\[0\]: the correlation must lie between -1 and 1, got 1.0"),
        ([("a", "b", math.nan)], "must lie between -1 and 1, got nan"),
        ([("a", "b", 0.5), ("b", "a", 0.5)], r"correlation\[1\]: 'b' and 'a' already have a correlation"),
        ([("a", "b", 0.0), ("b", "a", 0.5)], r"correlation\[1\]: 'b' and 'a' already have a correlation"),
    ],
)
def test_entries_that_define_no_correlation_are_refused(correlation: list[Any], rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        DesignSpace(UNIFORM, correlation=tuple(correlation))


def test_a_correlation_that_two_distributions_cannot_have_is_refused_with_the_range_they_can() -> None:
    with pytest.raises(InputError, match=r"allow correlations between -0\.8\d\d and 0\.9\d\d, got -0.99"):
        DesignSpace(LOGNORMAL, correlation=(("a", "b", -0.99),))


def test_correlations_that_contradict_each_other_are_refused() -> None:
    three = tuple(Parameter(name, -9.0, 9.0, distribution="normal", mean=0.0, sd=1.0) for name in "abc")
    with pytest.raises(InputError, match="no joint distribution has all these correlations; the smallest eigenvalue"):
        DesignSpace(three, correlation=(("a", "b", 0.9), ("b", "c", 0.9), ("a", "c", -0.9)))


def test_quadrature_agrees_with_the_integral_of_a_correlated_pair() -> None:
    gumbel = Parameter("a", -20.0, 200.0, distribution="gumbel_max", mean=10.0, sd=8.0)
    beta = Parameter("b", 0.0, 1.0, distribution="beta", mean=0.3, sd=0.2)
    rho_0 = nataf_factor((gumbel, beta), [("a", "b", 0.7)])[1, 0]

    # The trapezoidal rule, whose error vanishes exponentially for smooth functions that decay.
    z, w = np.meshgrid(np.linspace(-7.0, 7.0, 501), np.linspace(-7.0, 7.0, 501), indexing="ij")
    x = gumbel.from_normal(z) - 10.0
    y = beta.from_normal(rho_0 * z + math.sqrt(1.0 - rho_0**2) * w) - 0.3
    density = np.exp(-0.5 * (w * w + z * z)) / (2.0 * math.pi)
    value = float((x * y * density).sum()) * (14.0 / 500) ** 2
    assert value / (8.0 * 0.2) == pytest.approx(0.7, abs=2e-3)


CORRELATED = """
correlation = [["load", "strength", 0.3]]
sampling = { initial = 20, budget = 40, batch = 5 }
simulator = { python = "model:f", outcomes = ["safe", "failed"] }
space.load = { distribution = "gumbel_max", mean = 40.0, cov = 0.25 }
space.strength = { distribution = "lognormal", median = 60.0, dispersion = 0.2 }
"""


@dataclass(frozen=True)
class Beam:
    outcomes = ("safe", "failed")
    causes = ("",)
    margins = ()
    releases_gil = True

    def run(self, X: Array) -> Results:
        assert np.isfinite(X).all()
        failed = (X[:, -1] <= X[:, 0]).astype(np.int8)
        return Results(failed, np.zeros(len(X), dtype=np.int8), np.empty((len(X), 0)), np.zeros(len(X)))


def test_designs_on_a_face_of_the_cube_lie_on_the_bounds_also_with_correlations() -> None:
    space = parse_settings(CORRELATED, "beam.toml").design_space()
    U = np.array([[0.0, 0.5], [0.5, 1.0], [1.0, 0.0], [1.0, 1.0]])
    X = space.from_unit(U)
    assert space.contains(X).all()
    assert np.isfinite(space.to_unit(X)).all()
    assert np.isfinite(space.to_normal(np.array([space.low, space.high]))).all()


@pytest.mark.parametrize("criterion", ["entropy", "bald", "eavc"])
def test_a_campaign_on_correlated_variables_runs_without_a_design_twice(criterion: str) -> None:
    settings = parse_settings(CORRELATED, "beam.toml").changed({"acquisition.criterion": criterion})
    designs = simulated(Campaign.of(settings, simulator=Beam()))
    assert len(np.unique(designs, axis=0)) == 40


@pytest.mark.parametrize("variable", ["", ", low = -3.0, high = 3.0"])
def test_a_search_over_an_unbounded_variable_simulates_no_design_twice(variable: str) -> None:
    text = (
        'simulator = { python = "m:f", outcomes = ["safe", "failed"] }\n'
        "sampling = { initial = 12, budget = 40, batch = 4 }\n"
        f'space.x = {{ distribution = "normal", mean = 0.0, sd = 1.0{variable} }}\n'
        'space.y = { distribution = "gumbel_max", mean = 20.0, sd = 1.0 }\n'
    )
    designs = simulated(Campaign.of(parse_settings(text, "rare.toml"), simulator=Beam()))
    assert len(np.unique(designs, axis=0)) == 40
    # Far designs differ in both variables; they are not all on one face.
    assert len(np.unique(designs[12:, 0])) > 14


def simulated(campaign: Campaign) -> Array:
    """Runs a campaign and returns its designs."""
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, 40)
    return np.concatenate([batch.designs for batch in store.batches])
