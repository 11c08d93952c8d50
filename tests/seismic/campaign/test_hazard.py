"""Hazard files: their distributions against closed forms, what they ask of a campaign, and what is refused."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, refused, sets
from scipy.special import ndtr

import activefail as package
from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.findings.status import read_status
from activefail.campaign.inquiry import read_question
from activefail.campaign.question import Question
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.estimates.estimate import plan_estimate
from activefail.estimates.integral import integral_of
from activefail.estimates.probability_estimator import Sampled
from activefail.learning.criteria.population import integration_points
from activefail.seismic.bearing.design import TABLE_1
from activefail.seismic.bearing.pulse import VELOCITY_PERIOD, amplitude_of, velocity_of
from activefail.seismic.figures.hazard import plot_hazard
from activefail.seismic.hazard.hazard import Hazard, read_hazard
from activefail.seismic.hazard.sections import RELATIONS
from activefail.seismic.hazard.summary import HazardSummary
from activefail.session.session import estimating
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows, weighted_quantiles

BEARING = {"T_b": 4.0, "mu": 0.06, "D_tot": 0.65, "h_sl_ratio": 0.6, "h_rim_ratio": 0.1, "p": 45.0, "k": 2e9}
BEARING_FILE = "".join(f"{name} = {value}\n" for name, value in BEARING.items())
PERIOD = '[pulse_period]\nmedian_s = 3.0\ndispersion = 0.5\ndefinition = "acceleration"\n'
PGV = "[pgv]\nmedian_m_s = 0.8\ndispersion = 0.3\n"
CORRELATED = f"{PERIOD}{PGV}correlation_with_period = 0.6\n"
UNCERTAIN = "[uncertainty]\ndesign_requirements = 0.2\ntest_data = 0.1\n[record_factor]\nbias = 0.1\ndispersion = 0.2\n"


def hazard(folder: Path, text: str) -> Hazard:
    path = folder / "hazard.toml"
    path.write_text(text)
    return read_hazard(path)


def asked(folder: Path, text: str, pgv: float | None = None, fixed: dict[str, float] = BEARING) -> Question:
    return hazard(folder, text).question(TABLE_1, fixed, pgv)


def logarithms(space: DesignSpace | WeightedRows, n: int = 2**14) -> dict[str, Array]:
    X, _ = integration_points(space, n)
    return dict(zip(space.names, np.log(X).T, strict=True))


# --- distributions -----------------------------------------------------------------------------------------------


def test_samples_of_a_hazard_have_the_stated_medians_dispersions_and_correlation(tmp_path: Path) -> None:
    sample = logarithms(asked(tmp_path, CORRELATED).space)
    # A scrambled Sobol' sequence of 16,384 points integrates smooth functions to about 1e-4.
    for name, median, dispersion in (("T_p", 3.0, 0.5), ("PGV", 0.8, 0.3)):
        quantiles = np.quantile(sample[name], ndtr([-1.645, 0.0, 1.645]))
        expected = math.log(median) + dispersion * np.array([-1.645, 0.0, 1.645])
        assert quantiles == pytest.approx(expected, abs=2e-3)
    assert np.corrcoef(sample["T_p"], sample["PGV"])[0, 1] == pytest.approx(0.6, abs=1e-3)


@pytest.mark.parametrize("rho", [-0.99, -0.5, 0.99])
def test_any_correlation_of_any_dispersions_has_a_joint_distribution(tmp_path: Path, rho: float) -> None:
    # The values of such variables are hardly correlated: -0.018 at the least.
    text = CORRELATED.replace("0.5", "2.0").replace("0.3", "2.0").replace("0.6", str(rho))
    sample = logarithms(asked(tmp_path, text).space)
    assert np.corrcoef(sample["T_p"], sample["PGV"])[0, 1] == pytest.approx(rho, abs=2e-3)


def test_the_period_given_a_velocity_has_its_conditional_distribution(tmp_path: Path) -> None:
    given = asked(tmp_path, CORRELATED, pgv=1.6)
    assert given.space.names == ("T_p",)
    assert given.fixed["PGV"] == 1.6
    sample = logarithms(given.space)["T_p"]
    # Of two normal variables: the mean moves by rho sd_1/sd_2 times the other's distance from its mean.
    assert sample.mean() == pytest.approx(math.log(3.0) + 0.6 * 0.5 / 0.3 * math.log(1.6 / 0.8), abs=1e-3)
    assert sample.std() == pytest.approx(0.5 * 0.8, abs=1e-3)


def test_record_factor_and_uncertainty_are_a_convolution_on_the_logarithm_of_the_velocity(tmp_path: Path) -> None:
    added = math.sqrt(0.2**2 + 0.1**2 + 0.2**2)
    read = hazard(tmp_path, CORRELATED + UNCERTAIN)
    assert (read.added_dispersion, read.bias) == (pytest.approx(added), 0.1)
    given = logarithms(asked(tmp_path, CORRELATED + UNCERTAIN, pgv=1.6).space)
    assert given["PGV"].mean() == pytest.approx(math.log(1.6) - 0.1, abs=1e-3)
    assert given["PGV"].std() == pytest.approx(added, abs=1e-3)
    assert np.corrcoef(given["T_p"], given["PGV"])[0, 1] == pytest.approx(0.0, abs=2e-3)
    # A limit in ln PGV and ln T_p: its probability over all velocities, with the uncertainty, in closed form.
    slope, limit = 0.4, math.log(1.1)
    total = logarithms(asked(tmp_path, CORRELATED + UNCERTAIN).space)
    mean = math.log(0.8) - 0.1 + slope * math.log(3.0)
    variance = 0.3**2 + added**2 + (slope * 0.5) ** 2 + 2.0 * slope * 0.6 * 0.3 * 0.5
    share = (total["PGV"] + slope * total["T_p"] > limit).mean()
    assert share == pytest.approx(ndtr((mean - limit) / math.sqrt(variance)), abs=2e-3)
    pulses, certain = read.without_uncertainty().pulses()
    assert logarithms(pulses)["PGV"].std() == pytest.approx(0.3, abs=1e-3)
    assert certain == {}


def test_the_velocity_and_the_period_give_the_amplitude_of_the_design(tmp_path: Path) -> None:
    question = asked(tmp_path, PERIOD + PGV)
    X = question.designs(np.array([[2.0, 1.0]]))
    assert dict(zip(TABLE_1.names, X[0], strict=True)) == BEARING | {
        "T_p": 2.0,
        "A_p": pytest.approx(float(amplitude_of(np.array(1.0), np.array(2.0)))),
    }


@pytest.mark.parametrize(
    ("definition", "divisor"), [("acceleration", 1.0), ("velocity", math.sqrt(1.5))], ids=["acceleration", "velocity"]
)
def test_a_period_of_the_velocity_pulse_is_divided(tmp_path: Path, definition: str, divisor: float) -> None:
    read = hazard(tmp_path, PERIOD.replace("acceleration", definition) + PGV)
    assert read.median_period == pytest.approx(3.0 / divisor)
    assert read.period_dispersion == 0.5


@pytest.mark.parametrize(
    ("relation", "stated", "period", "dispersion"),
    [
        ("shahi-baker-2011", "", math.exp(-5.73 + 0.99 * 7.0), 0.56),
        ("baker-2007", "", math.exp(-5.78 + 1.02 * 7.0), 0.55),
        ("baker-2007", "dispersion = 0.3", math.exp(-5.78 + 1.02 * 7.0), 0.3),
        ("somerville-2003-rock", "dispersion = 0.4", 10.0 ** (-3.17 + 0.5 * 7.0), 0.4),
        ("somerville-2003-soil", "dispersion = 0.4", 10.0 ** (-2.02 + 0.346 * 7.0), 0.4),
    ],
)
def test_a_magnitude_gives_the_period_of_the_published_relation(
    tmp_path: Path, relation: str, stated: str, period: float, dispersion: float
) -> None:
    assert relation in RELATIONS
    read = hazard(tmp_path, f'[magnitude]\nM = 7\nrelation = "{relation}"\n{stated}\n{PGV}')
    assert read.median_period * VELOCITY_PERIOD == pytest.approx(period, rel=1e-12)
    assert read.period_dispersion == dispersion


# --- rows --------------------------------------------------------------------------------------------------------


def rows(folder: Path, table: str, more: str = "") -> Hazard:
    (folder / "pulses.csv").write_text(table)
    return hazard(folder, f'samples = "pulses.csv"\n{more}')


def test_rows_enter_with_their_weights_and_those_without_weight_not_at_all(tmp_path: Path) -> None:
    read = rows(tmp_path, "T_p,PGV,weight\n1.0,0.5,3\n2.0,1.0,1\n9.0,4.0,0\n")
    assert read.rows is not None
    assert read.rows.X.tolist() == [[1.0, 0.5], [2.0, 1.0]]
    assert read.rows.weight.tolist() == [1.5, 0.5]
    assert read.median_velocity == 0.5
    assert read.median_period == pytest.approx(2.0**0.25)
    question = read.question(TABLE_1, BEARING)
    X, weight = integration_points(question.space, 4)
    above = question.designs(X)[:, TABLE_1.names.index("T_p")] > 1.5
    assert (weight * above).mean() == pytest.approx(0.25)


def test_rows_of_amplitudes_are_the_same_pulses_as_rows_of_velocities(tmp_path: Path) -> None:
    amplitude = float(amplitude_of(np.array(1.0), np.array(2.0)))
    one = rows(tmp_path, "T_p,PGV\n2.0,1.0\n").question(TABLE_1, BEARING)
    other = rows(tmp_path, f"A_p,T_p\n{amplitude!r},2.0\n").question(TABLE_1, BEARING)
    (x, _), (y, _) = integration_points(one.space, 1), integration_points(other.space, 1)
    assert one.designs(x) == pytest.approx(other.designs(y))


def test_uncertainty_spreads_each_row_over_strata_of_equal_probability(tmp_path: Path) -> None:
    read = rows(tmp_path, "T_p,PGV\n2.0,1.0\n", UNCERTAIN)
    pulses, _ = read.pulses()
    assert isinstance(pulses, WeightedRows)
    logarithm = np.log(pulses.column("PGV"))
    mean = (pulses.weight * logarithm).mean()
    assert mean == pytest.approx(-0.1, abs=1e-3)
    assert (pulses.weight * (logarithm - mean) ** 2).mean() == pytest.approx(0.2**2 + 0.1**2 + 0.2**2, rel=0.01)
    for level in (0.5, 0.8, 1.0, 1.3):
        share = (pulses.weight * (pulses.column("PGV") > level)).mean()
        assert share == pytest.approx(ndtr(-(math.log(level) + 0.1) / 0.3), abs=1e-3)
    given, certain = read.without_uncertainty().pulses(pgv=0.7)
    assert (given.names, certain) == (("T_p",), {"PGV": 0.7})


@pytest.mark.parametrize("count", [5, 60, 1500, 3000])
def test_uncertainty_of_any_number_of_rows_is_integrated_where_the_outcome_is_a_step(
    tmp_path: Path, count: int
) -> None:
    rng = np.random.default_rng(count)
    table = "".join(f"{T},{V}\n" for T, V in zip(rng.uniform(1, 8, count), rng.uniform(0.2, 2, count), strict=True))
    read = rows(tmp_path, "T_p,PGV\n" + table, UNCERTAIN)
    assert read.rows is not None
    for pgv in (None, 0.9):
        pulses, _ = read.pulses(pgv)
        assert isinstance(pulses, WeightedRows)
        felt = read.rows.column("PGV") if pgv is None else np.full(count, pgv)
        capacity = 0.5 + 0.1 * read.rows.column("T_p")
        true = (read.rows.weight * ndtr((np.log(felt / capacity) - 0.1) / 0.3)).mean()
        fails = pulses.column("PGV") > 0.5 + 0.1 * pulses.column("T_p")
        assert (pulses.weight * fails).mean() == pytest.approx(true, abs=0.01)
        assert 0.0 < float(pulses.standard_error(fails)) < 0.02
        # Each block stands for all pulses.
        assert [part.mean() for part in np.array_split(fails, 8)] == pytest.approx([true] * 8, abs=0.08)
        assert pulses.holding("T_p", 1.0).is_sample


@pytest.mark.parametrize("more", ["", UNCERTAIN])
def test_many_rows_are_thinned_wherever_the_classifier_integrates_them(tmp_path: Path, more: str) -> None:
    rng = np.random.default_rng(0)
    T, V, weight = rng.uniform(1, 5, 12_000), rng.lognormal(-0.3, 0.4, 12_000), rng.random(12_000)
    table = "".join(f"{a},{b},{w}\n" for a, b, w in zip(T, V, weight, strict=True))
    read = rows(tmp_path, "T_p,PGV,weight\n" + table, more)
    asked = read.question(TABLE_1, BEARING)
    counted: list[int] = []

    def fails(X: Array) -> Array:
        counted.append(len(X))
        return np.asarray(1e6 * (velocity_of(X[:, -1], X[:, -2]) - 1.0))

    bias, added = (0.1, 0.3) if more else (0.0, 0.0)
    true = float(ndtr((-0.3 - bias) / math.hypot(0.4, added)))
    for points in (256, 1024):
        assert classifier_probability(fails, asked, points) == pytest.approx(true, abs=0.015)
    found = integral_of(asked, lambda X: fails(X)[:, None], TABLE_1)
    assert found.probability[0] == pytest.approx(true, abs=0.015)
    (deaggregation,) = read.deaggregated(lambda X: fails(X)[:, None], TABLE_1, BEARING, found.probability)
    assert deaggregation.failures is not None
    assert deaggregation.failures.velocity.p50 > deaggregation.pulses.velocity.p50
    assert counted == [512, 2048, 4096, 4096]


def test_thinned_rows_keep_their_weights_and_know_their_error() -> None:
    x = np.arange(1000.0)
    every = WeightedRows(("x",), x[:, None], x)
    assert every.thinned(1000) is every
    thin = every.thinned(128)
    assert (len(thin.X), thin.is_sample) == (128, True)
    assert thin.X.mean() == pytest.approx(float((every.weight * x).mean()), rel=1e-3)
    # Far less than that of a random sample.
    assert 0.0 < float(thin.standard_error(thin.X[:, 0])) < 0.5 * thin.X.std() / math.sqrt(128)
    assert float(every.standard_error(x)) == 0.0


def test_a_regular_table_is_thinned_without_missing_a_part_of_it() -> None:
    # Each size with two periods, one after the other, and twice as many rows as are kept.
    sizes = np.repeat(np.linspace(0.1, 3.0, 8192), 2)
    periods = np.tile([1.0, 2.0], 8192)
    for order in (slice(None), slice(None, None, -1)):
        rows = WeightedRows(("T_p", "PGV"), np.column_stack([periods, sizes])[order], np.ones(16384))
        fails = (rows.column("T_p") == 1.0) & (rows.column("PGV") > 2.0)
        thin = rows.thinned(8192)
        failing = (thin.column("T_p") == 1.0) & (thin.column("PGV") > 2.0)
        assert failing.mean() == pytest.approx(fails.mean(), abs=4.0 * float(thin.standard_error(failing)) + 1e-3)
        assert 0.0 < float(thin.standard_error(failing)) < 0.01


def test_rows_need_values_of_all_other_variables(tmp_path: Path) -> None:
    read = rows(tmp_path, "T_p,PGV\n2.0,1.0\n")
    with pytest.raises(InputError, match=r"^k: requires a value, because the hazard is a table of pulses"):
        read.question(TABLE_1, {name: value for name, value in BEARING.items() if name != "k"})


def test_quantiles_of_weighted_values_are_the_least_that_hold_the_share() -> None:
    values, weight = np.array([3.0, 1.0, 2.0]), np.array([1.0, 2.0, 1.0])
    assert weighted_quantiles(values, weight, [0.0, 0.5, 0.51, 0.75, 0.76, 1.0]).tolist() == [1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize(
    ("X", "weight", "message"),
    [
        ([[1.0]], [-1.0], "row 1, column weight: must be at least 0, got -1.0."),
        ([[1.0]], [0.0], "at least one weight must be positive"),
        ([[1.0, 2.0]], [1.0], "must have the shape"),
    ],
)
def test_weighted_rows_are_checked(X: list[list[float]], weight: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        WeightedRows(("x",), np.array(X), np.array(weight))


# --- the bearing -------------------------------------------------------------------------------------------------


def test_property_bounds_are_factors_on_the_bearing(tmp_path: Path) -> None:
    text = f"{PERIOD}{PGV}[properties]\nmu_lower = 0.8\nmu_upper = 1.3\nD_tot_lower = 0.95\n"
    read = hazard(tmp_path, text)
    values = {"lower": (0.048, 0.6175), "upper": (0.078, 0.65), "nominal": (0.06, 0.65)}
    for bound, (mu, capacity) in values.items():
        question = read.at_bound(bound).question(TABLE_1, BEARING)  # type: ignore[arg-type]
        design = question.designs(np.array([[2.0, 1.0]]))[0]
        assert (design[1], design[2]) == (pytest.approx(mu), pytest.approx(capacity))
    assert "friction × 0.8, displacement capacity × 0.95" in read.assumptions[0]
    assert "upper property bounds: friction × 1.3." in read.at_bound("upper").assumptions[0]
    assert "exactly its nominal properties" in read.at_bound("nominal").assumptions[0]


@pytest.mark.parametrize("campaign", ["mu = { value = 0.06 }", "friction = { low = 0.02, high = 0.1 }"])
@pytest.mark.parametrize("bound", ["mu_lower = 0.8", "mu_upper = 1.3"])
def test_a_bound_on_what_the_campaign_does_not_vary_is_refused(tmp_path: Path, campaign: str, bound: str) -> None:
    made = 'simulator = { python = "a:b" }\n[space]\nT_p = { low = 1, high = 5 }\nA_p = { low = 0.1, high = 1 }\n'
    settings = parse_settings(made + campaign, "made.toml")
    read = hazard(tmp_path, f"{PERIOD}{PGV}[properties]\n{bound}\n")
    key = bound.split()[0]
    with pytest.raises(InputError, match=rf"properties\.{key}: cannot be applied, because the campaign"):
        read.question(settings.design_space(), {})


# --- questions ---------------------------------------------------------------------------------------------------


def test_questions_differ_by_bound_draw_and_values_not_by_their_words(tmp_path: Path) -> None:
    text = f"{PERIOD}{PGV}[properties]\nmu_lower = 0.8\n"
    one = asked(tmp_path, text)
    assert one.digest == asked(tmp_path, f'description = "other words"\n{text}').digest
    digests = {
        one.digest,
        one.drawn(1).digest,
        one.at({"mu": 0.07}).digest,
        asked(tmp_path, text, pgv=1.0).digest,
        asked(tmp_path, text.replace("mu_lower = 0.8", "mu_lower = 0.9")).digest,
        hazard(tmp_path, text).at_bound("nominal").question(TABLE_1, BEARING).digest,
    }
    assert len(digests) == 6


def test_a_file_is_a_hazard_or_a_question_by_its_keys(tmp_path: Path) -> None:
    path = tmp_path / "asked.toml"
    path.write_text(PERIOD + PGV)
    assert isinstance(read_question(path, TABLE_1, BEARING), Hazard)
    path.write_text("[space]\nmu = { value = 0.05 }\n")
    assert "mu" not in read_question(path, TABLE_1, {}).space.names
    path.write_text("[curve]\npgv_m_s = [1, 2]\nannual_rate = [0.1, 0.01]\n")
    with pytest.raises(InputError, match=r"requires `magnitude`, `pulse_period` or `samples`"):
        read_question(path, TABLE_1, {})
    path.write_text("[space]\nT_p = { value = 2.0 }\nPGV = { value = 1.0 }\n")
    question = read_question(path, TABLE_1, {})
    amplitude = float(amplitude_of(np.array(1.0), np.array(2.0)))
    assert question.designs(np.zeros((1, 7)))[0, 7:] == pytest.approx([2.0, amplitude])


def test_a_velocity_so_far_out_that_no_period_belongs_to_it_is_refused(tmp_path: Path) -> None:
    read = hazard(tmp_path, CORRELATED.replace("dispersion = 0.3", "dispersion = 0.01"))
    with pytest.raises(InputError, match=r"pgv: must be closer to its median, 0\.8 m/s"):
        read.pulses(pgv=8.0)
    with pytest.raises(InputError, match=r"pgv: must be positive and finite, got 0.0 m/s\."):
        read.pulses(pgv=0.0)


# --- wrong files -------------------------------------------------------------------------------------------------

UNIT = "; is it in cm/s?"
WRONG = [
    (PGV, "requires `magnitude`, `pulse_period` or `samples` for the pulse period, got none of them"),
    (PERIOD, "`pulse_period` requires `pgv`, which is missing; `samples` may replace both"),
    ("[magnitude]\nM = 7\n" + PERIOD + PGV, "`magnitude` cannot be combined with `pulse_period`"),
    (PERIOD + PGV.replace("0.8", "80"), f"pgv.median_m_s: must be at most 5 m/s, got 80{UNIT}"),
    (
        PERIOD + PGV + "correlation_with_period = 1.0\n",
        "pgv.correlation_with_period: must be less than or equal to 0.99",
    ),
    (
        '[magnitude]\nM = 7\nrelation = "somerville-2003-rock"\n' + PGV,
        "magnitude: the relation 'somerville-2003-rock' comes without a dispersion; set `dispersion`",
    ),
    (PERIOD + PGV + "[properties]\nmu_lower = 1.2\n", "properties.mu_lower: must be less than or equal to 1, got 1.2"),
    (
        PERIOD + PGV + "[curve]\npgv_m_s = [1, 2]\nannual_rate = [0.1]\n",
        "curve.annual_rate: must have at least 2 entries",
    ),
    (
        PERIOD + PGV + "[curve]\npgv_m_s = [1, 2, 3]\nannual_rate = [0.1, 0.01]\n",
        "curve: `pgv_m_s` and `annual_rate` must have equal lengths, got 3 and 2",
    ),
    (
        PERIOD + PGV + "[curve]\npgv_m_s = [20, 200]\nannual_rate = [0.1, 0.01]\n",
        f"curve.pgv_m_s: must be at most 10 m/s, got 200{UNIT}",
    ),
    (PERIOD + PGV + "[curve]\npgv_m_s = [2, 1]\nannual_rate = [0.1, 0.01]\n", "curve.pgv_m_s: must increase"),
    (PERIOD + PGV + "[curve]\npgv_m_s = [1, 2]\nannual_rate = [0.1, 0.1]\n", "curve.annual_rate: must decrease"),
]


@pytest.mark.parametrize(("text", "message"), WRONG, ids=[message[:60] for _, message in WRONG])
def test_a_wrong_hazard_is_refused_with_file_key_rule_and_value(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    refused(activefail("hazard", path), f"{path}:", message)


@pytest.mark.parametrize(
    "entry",
    ['{ distribution = "lognormal", median = 80, dispersion = 0.3 }', "{ value = 80 }", "{ low = 60, high = 100 }"],
)
def test_a_question_with_velocities_in_another_unit_is_refused(tmp_path: Path, entry: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f"[space]\nPGV = {entry}\n")
    with pytest.raises(
        InputError, match=f"{path}: space.PGV: its median must be at most 5 m/s, got 80{re.escape(UNIT)}$"
    ):
        read_question(path, TABLE_1, {})


def test_a_question_cannot_give_choices_to_the_velocity(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text("space.PGV.choices = [0.5, 1.0]\n")
    with pytest.raises(
        InputError, match=r"space\.PGV\.choices: must be left out, as in the campaign, got \[0\.5, 1\.0\]"
    ):
        read_question(path, TABLE_1, {})


TABLES = [
    ("T_p,weight\n1,1\n", "the columns must be T_p, either PGV or A_p, and weight"),
    ("T_p,PGV,A_p\n1,1,0.5\n", "got T_p,PGV,A_p."),
    ("T_p,PGV\n", "must have 1 to 20000 rows, got none."),
    ("T_p,PGV,weight\n1,1,0\n1,1,0\n", "column weight: at least one weight must be positive, got 0 in every row."),
    ("T_p,PGV,weight\n1,1,1\n1,1,-2\n", "row 2 (line 3), column weight: must be between 0 and 1e+75, got -2."),
    ("T_p,PGV\n1,80\n", "row 1 (line 2), column PGV: must be between 0.001 and 10 m/s (not cm/s), got 80."),
]


@pytest.mark.parametrize(("table", "message"), TABLES, ids=[message[:60] for _, message in TABLES])
def test_a_wrong_table_of_pulses_is_refused_with_file_row_column_rule_and_value(
    tmp_path: Path, table: str, message: str
) -> None:
    (tmp_path / "pulses.csv").write_text(table)
    path = tmp_path / "rows.toml"
    path.write_text('samples = "pulses.csv"\n')
    refused(activefail("hazard", path), f"{path}: ", str(tmp_path / "pulses.csv"), message)


@pytest.mark.parametrize(
    "name",
    [
        "none.csv",
        "../pulses.csv",
        "/etc/hostname",
        "link.csv",
    ],
)
def test_a_table_that_is_missing_or_outside_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    home = tmp_path / "home"
    (home / "folder").mkdir(parents=True)
    (tmp_path / "pulses.csv").write_text("T_p,PGV\n1,1\n")
    (home / "link.csv").symlink_to(tmp_path / "pulses.csv")
    path = home / "rows.toml"
    path.write_text(f'samples = "{name}"\n')
    is_outside = name in ("../pulses.csv", "/etc/hostname", "link.csv")
    message = "samples: must be a file in the folder of the hazard file, got " if is_outside else "cannot be read: "
    refused(activefail("hazard", path), f"{path}: ", message)


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder of a bearing campaign without simulations."""
    run = tmp_path_factory.mktemp("hazard") / "run"
    package.create_run(run, {"sampling": {"initial": 20, "budget": 20}}).close()
    return run


CURVE = "[curve]\npgv_m_s = [0.4, 1.6]\nannual_rate = [1e-2, 1e-4]\n"


def test_the_summary_has_the_quantiles_of_the_closed_forms(tmp_path: Path) -> None:
    summary = HazardSummary.of(hazard(tmp_path, CORRELATED + CURVE))
    period, velocity_pulse, pgv, amplitude = summary.spreads
    assert (period.median, period.dispersion, pgv.median, summary.correlation) == (3.0, 0.5, 0.8, 0.6)
    assert period.high == pytest.approx(3.0 * math.exp(1.6448536 * 0.5))
    assert velocity_pulse.median == pytest.approx(3.0 * math.sqrt(1.5))
    # 0.1997 A_p T_p, with A_p in g.
    assert amplitude.median == pytest.approx(0.8 / (0.1997 * 3.0 * 9.81), rel=1e-3)
    sample = logarithms(hazard(tmp_path, CORRELATED).pulses()[0])
    assert amplitude.dispersion == pytest.approx((sample["PGV"] - sample["T_p"]).std(), abs=1e-3)
    # Half way between the points of the curve, in logarithms.
    assert summary.rate_at_median == pytest.approx(1e-3)
    # Nothing is extrapolated beyond the ends of the curve.
    for pgvs in ("[0.1, 0.2]", "[0.9, 1.8]"):
        beyond = f"[curve]\npgv_m_s = {pgvs}\nannual_rate = [1e-2, 1e-3]\n"
        assert HazardSummary.of(hazard(tmp_path, CORRELATED + beyond)).rate_at_median is None


def test_the_summary_of_rows_is_that_of_the_distribution_that_they_sample(tmp_path: Path) -> None:
    X, _ = integration_points(hazard(tmp_path, CORRELATED).pulses()[0], 2**12)
    one = HazardSummary.of(hazard(tmp_path, CORRELATED))
    table = "T_p,PGV\n" + "".join(f"{x},{y}\n" for x, y in X)
    other = HazardSummary.of(rows(tmp_path, table))
    assert other.correlation == pytest.approx(one.correlation, abs=5e-3)
    for a, b in zip(one.spreads, other.spreads, strict=True):
        assert b[2:] == pytest.approx(a[2:], rel=1e-2)


def test_the_share_outside_is_counted_by_variable_and_side(tmp_path: Path) -> None:
    read = hazard(tmp_path, f"{PERIOD}{PGV}[properties]\nmu_lower = 0.8\n")
    outside = HazardSummary.of(read, TABLE_1).outside
    assert outside is not None
    parts = {(part.name, part.side): part.share for part in outside.parts}
    assert parts["T_p", "above"] == pytest.approx(ndtr(-math.log(5.0 / 3.0) / 0.5), abs=1e-3)
    spread = math.hypot(0.5, 0.3)
    low = math.log(float(amplitude_of(np.array(0.8), np.array(3.0))) / 0.1) / spread
    assert parts["A_p", "below"] == pytest.approx(ndtr(-low), abs=1e-3)
    assert max(parts.values()) < outside.share < sum(parts.values())
    question = read.question(TABLE_1, BEARING)
    assert question.share_outside(TABLE_1) == pytest.approx(outside.share, abs=1e-12)
    # The factor of the lower bound takes the friction below the campaign's range.
    low_friction = HazardSummary.of(read, TABLE_1, {"mu": 0.024}).outside
    assert low_friction is not None
    assert ("mu", "below", 1.0) in [(part.name, part.side, part.share) for part in low_friction.parts]
    assert low_friction.share == 1.0


def test_the_command_draws_and_writes_json(tmp_path: Path, folder: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'description = "a <site>"\n{CORRELATED}{UNCERTAIN}{CURVE}')
    result = activefail("hazard", path, folder, "--out", tmp_path / "figure")
    assert result.code == 0, result.err
    assert (tmp_path / "figure" / "hazard.png").read_bytes().startswith(b"\x89PNG")
    assert b"the campaign's design space" in (tmp_path / "figure" / "hazard.svg").read_bytes()
    (tmp_path / "bearing.toml").write_text(BEARING_FILE)
    told = activefail("hazard", path, folder, "--fixed", tmp_path / "bearing.toml", "--json")
    numbers = json.loads(told.out)
    assert numbers["pulses"]["T_p"]["median"] == pytest.approx(3.0)
    assert numbers["outside"]["bearing"] == list(BEARING)
    assert numbers["outside"]["interval"] is None
    assert "16,384 points" in numbers["outside"]["interval_reason"]
    assert json.loads(activefail("hazard", path, "--json").out)["outside"] is None


def test_a_range_of_a_curve_that_the_simulator_cannot_take_is_refused(folder: Path) -> None:
    for name, ends in (("T_p", "-1,2"), ("D_tot", "0,1"), ("D_tot", "0.5,1e9")):
        result = activefail("fragility", folder, "--against", name, f"--range={ends}")
        refused(result, "bounds (--range): the simulator cannot take these values: ")


def test_rows_are_drawn_too(tmp_path: Path) -> None:
    figure = plot_hazard(HazardSummary.of(rows(tmp_path, "T_p,PGV,weight\n1,1,1\n2,1.5,3\n")), TABLE_1)
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == [
        "pulses; the area shows the weight",
        "the campaign's design space",
    ]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            BEARING_FILE.replace("0.06", "-0.06"),
            "the simulator cannot take these values: `mu > 0` must hold, got -0.06.",
        ),
        (BEARING_FILE.replace("T_b = 4.0", "T_b = 0.5"), "A dish must be less than a hemisphere"),
        (BEARING_FILE.replace("0.06", "1e90"), "mu: must be a number between -1e+75 and 1e+75, got 1e+90."),
        (BEARING_FILE + "T_p = 2.0\n", "T_p: is uncertain under a hazard, so `fixed` cannot give it a value, got 2."),
        (BEARING_FILE + "friction = 0.1\n", "friction: is not a variable of the campaign"),
    ],
)
def test_values_that_cannot_be_asked_for_end_in_one_message(
    tmp_path: Path, folder: Path, values: str, message: str
) -> None:
    path, fixed = tmp_path / "site.toml", tmp_path / "values.toml"
    path.write_text(PERIOD + PGV)
    fixed.write_text(values)
    result = activefail("probability", folder, "--question", path, "--fixed", fixed)
    refused(result, str(path if "T_p" in message else fixed), message)


def test_values_need_a_run_folder(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(PERIOD + PGV)
    refused(activefail("hazard", path, "--fixed", path), "fixed: requires a run folder, whose variables it fixes.")
    refused(activefail("hazard", tmp_path / "none.toml"), "none.toml: cannot be read: No such file or directory")


# --- probabilities -----------------------------------------------------------------------------------------------

LIMIT = """
def pulse(design):
    return 1.0 - 0.19974 * 9.81 * design["A_p"] * design["T_p"] / design["strength"]
"""

MADE = """
simulator = { python = "limit:pulse", margins = ["g"] }
[space]
T_p = { low = 0.5, high = 8.0, unit = "s", distribution = "log_uniform" }
A_p = { low = 0.02, high = 1.5, unit = "g", distribution = "log_uniform" }
strength = { low = 0.5, high = 2.0 }
[sampling]
initial = 20
budget = 30
"""


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign on a limit of PGV alone, and files with hazards."""
    home = tmp_path_factory.mktemp("learned")
    (home / "limit.py").write_text(LIMIT)
    (home / "made.toml").write_text(MADE)
    assert activefail("run", home / "made.toml", "--out", home / "run").code == 0
    (home / "fixed.toml").write_text("strength = 1.5\n")
    (home / "site.toml").write_text(CORRELATED + UNCERTAIN)
    (home / "rows.toml").write_text('samples = "pulses.csv"\n')
    (home / "pulses.csv").write_text("T_p,PGV,weight\n1,1,3\n2,1.4,4\n3,1.7,2\n6,1.1,0.5\n4,3,0.5\n")
    return home


@pytest.mark.parametrize(
    ("file", "true"),
    [
        ("site.toml", float(ndtr((math.log(0.8 / 1.5) - 0.1) / math.sqrt(0.3**2 + 0.09)))),
        ("rows.toml", 0.25),
    ],
)
def test_the_probability_under_a_hazard_is_the_closed_form_and_says_what_is_left_out(
    learned: Path, file: str, true: float
) -> None:
    options = ("--code", learned, "--question", learned / file, "--fixed", learned / "fixed.toml", "--json")
    result = activefail("probability", learned / "run", *options)
    assert result.code == 0, result.err
    numbers = json.loads(result.out)["outcomes"]["failure"]
    assert numbers["low"] <= true <= numbers["high"]
    assert numbers["probability"] == pytest.approx(true, abs=0.03)
    said = " ".join(numbers["assumptions"])
    assert "no property bounds" in said
    assert ("Only the pulses are uncertain" in said) == (file == "rows.toml")
    stored = sets(learned / "run")
    by_hazard = [word if word != "--question" else "--hazard" for word in options]
    for words in (options, by_hazard):
        assert activefail("probability", learned / "run", *words).out == result.out
        assert sets(learned / "run") == stored
    assert read_status(learned / "run").estimates == {}
    both = activefail("probability", learned / "run", *options, "--hazard", learned / file)
    assert (both.code, both.out) == (2, "")
    assert "question: cannot be combined with hazard." in both.err
    if file == "rows.toml":
        # The five rows are simulated once each, and then there is nothing left to estimate.
        assert numbers["simulations"] == 5
        assert numbers["low"] == numbers["probability"] == numbers["high"] == pytest.approx(0.25)
        assert numbers["bound_without_model"]["high"] == pytest.approx(0.25)
        again = activefail("probability", learned / "run", *options, "--simulations", "200")
        assert json.loads(again.out)["outcomes"]["failure"]["simulations"] == 5
        assert sets(learned / "run") == stored


def test_the_fresh_simulations_of_a_table_are_of_different_rows(learned: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    table = "".join(f"{T},{V}\n" for T, V in zip(rng.uniform(1, 6, 100), rng.uniform(0.3, 3, 100), strict=True))
    (tmp_path / "pulses.csv").write_text("T_p,PGV\n" + table)
    path = tmp_path / "rows.toml"
    path.write_text('samples = "pulses.csv"\n')
    with package.open_run(learned / "run", code=learned, write=True) as run:
        found = run.probability(60, 0.99, question=path, fixed={"strength": 1.5})
        question = run.asked(path, {"strength": 1.5})
        name = f"asked-{question.digest[:16]}-1-{run.history.last_iteration}-60-0"
        X, results = run.store.read_set(name)  # type: ignore[misc]
    assert len(np.unique(X, axis=0)) == len(X) == found.estimate.simulations == 60
    assert found.estimate.beyond == int((results.outcome == 1).sum())
    assert isinstance(question.space, WeightedRows)
    true = float((question.space.column("PGV") > 1.5).mean())
    assert found.estimate.low <= true <= found.estimate.high


def test_a_plan_for_many_rows_predicts_a_sample_of_them_and_reads_its_simulations_again(
    learned: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(2)
    table = "".join(f"{T},{V}\n" for T, V in zip(rng.uniform(1, 6, 9000), rng.lognormal(0.1, 0.4, 9000), strict=True))
    (tmp_path / "pulses.csv").write_text("T_p,PGV\n" + table)
    path = tmp_path / "rows.toml"
    path.write_text('samples = "pulses.csv"\n')
    with package.open_run(learned / "run", code=learned, write=True) as run:
        found = run.probability(60, 0.95, question=path, fixed={"strength": 1.5})
        question = run.asked(path, {"strength": 1.5})
        with estimating(run) as estimator:
            plan = estimator.plan("failure", 60, question)
            assert estimator.stored("failure", question, 0.95) == found.estimate
    assert isinstance(question.space, WeightedRows)
    sampled = set(question.space.thinned(8192).X[:, 0])
    assert {float(x) for x in plan.designs[:, 0]} <= sampled < set(question.space.X[:, 0])
    true = float((question.space.column("PGV") > 1.5).mean())
    assert found.estimate.low <= true <= found.estimate.high
    assert found.estimate.high < 0.4


def test_the_interval_of_all_rows_is_that_of_the_numerical_failures() -> None:
    # The fifth row has no weight, so it is none.
    z = np.array([1.0, -1.0, -1.0, 5.0, 3.0])
    rows = WeightedRows(("row",), np.arange(5.0)[:, None], np.array([2.0, 1.0, 0.5, 0.5, 0.0]))
    plan = plan_estimate(lambda X: z[X[:, 0].astype(int)], rows, 9, np.random.default_rng(0))
    row = plan.designs[:, 0].astype(int)
    beyond, answered = np.array([True, True, False, False])[row], np.array([True, True, False, True])[row]
    found = Sampled(plan, beyond, answered).estimate(0.9)
    assert (found.low, found.probability, found.high) == pytest.approx((0.75, 0.75, 0.875))
    assert found.bound == pytest.approx(0.875)
    assert (found.simulations, found.unanswered, found.beyond, found.contradictions, found.surprising) == (
        4,
        1,
        2,
        2,
        1,
    )
    assert (found.recall, found.recall_low) == pytest.approx((2 / 3, 0.5 / 0.875))
