"""Variables with a step: whole numbers, plates that are made, catalogues."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from ran import ran_in
from scipy.stats import norm

from activefail import open_run
from activefail.campaign.assembly import Campaign
from activefail.campaign.question import values_of
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

PLATE = Parameter("plate", 4.0, 12.0, "mm", step=0.5)
STOREYS = Parameter("storeys", 1.0, 5.0, step=1.0)
LOAD = Parameter("load", 5.0, 60.0, "kN")


@pytest.mark.parametrize(
    ("parameter", "shares"),
    [
        (STOREYS, np.full(5, 0.2)),
        (Parameter("n", 0.1, 0.4, step=0.1), np.full(4, 0.25)),
        (
            Parameter("n", -1.0, 2.0, "", "normal", 0.5, 1.0, 1.0),
            np.diff(norm.cdf(np.arange(-1.5, 3.0), 0.5, 1.0)) / np.ptp(norm.cdf([-1.5, 2.5], 0.5, 1.0)),
        ),
        (Parameter("n", 1.0, 4.0, "", "log_uniform", step=1.0), np.diff(np.log(np.arange(0.5, 5.0))) / np.log(9.0)),
        (Parameter("n", 0.0, 2.0, "", "beta", 1.0, 2.0 / np.sqrt(12.0), 1.0), np.array([0.25, 0.5, 0.25])),
    ],
)
def test_each_value_has_the_probability_of_what_is_rounded_to_it(parameter: Parameter, shares: np.ndarray) -> None:
    u = (np.arange(200_000) + 0.5) / 200_000
    for x in (parameter.quantile(u), parameter.from_normal(norm.ppf(u))):
        values, counts = np.unique(x, return_counts=True)
        assert values.tolist() == parameter.values.tolist()
        assert counts / len(u) == pytest.approx(shares, abs=2e-5)
    # The middle of each value's part leads back to the value.
    assert parameter.quantile(parameter.share(parameter.values)).tolist() == parameter.values.tolist()
    assert parameter.from_normal(parameter.to_normal(parameter.values)).tolist() == parameter.values.tolist()


def test_values_are_those_that_a_person_would_write() -> None:
    assert Parameter("x", 0.1, 0.7, step=0.1).values.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    assert STOREYS.is_whole
    assert not PLATE.is_whole
    assert PLATE.contains(np.array([4.0, 4.25, 4.5, 12.5, 4.5000000001])).tolist() == [True, False, True, False, True]


def test_a_latin_hypercube_repeats_no_design_while_others_are_left() -> None:
    space = DesignSpace((STOREYS, Parameter("bays", 1.0, 4.0, step=1.0)))
    assert space.design_count == 20
    X = space.latin_hypercube(20, np.random.default_rng(1))
    assert len(np.unique(X, axis=0)) == 20
    assert DesignSpace((STOREYS, LOAD)).design_count == np.inf


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ("{ low = 4.0, high = 12.0, step = 0.7 }", "must be a multiple of `step`, got 4 to 12 in steps of 0.7"),
        ("{ low = 4.0, high = 12.0, step = 0 }", "`step > 0` must hold"),
        ("{ low = 4.0, high = 12.0, step = 20 }", "must be a multiple of `step`"),
        ("{ low = 0.0, high = 1e5, step = 1 }", "`step` must leave at most 10000 values, got 100001"),
        ('{ distribution = "normal", mean = 5, sd = 1, step = 1 }', "with a `step` requires `low` and `high`"),
        ('{ distribution = "log_uniform", low = 1, high = 9, step = 2 }', "`low > step / 2` must hold"),
    ],
)
def test_a_step_that_makes_no_sense_is_refused(line: str, rule: str) -> None:
    with pytest.raises(InputError, match=r"space\.plate") as refused:
        parse_settings(
            f'simulator = {{ python = "a:b" }}\n[space]\nplate = {line}\nload = {{ low = 1, high = 2 }}', "f"
        )
    assert rule in str(refused.value)


def test_a_budget_beyond_all_designs_is_refused() -> None:
    text = 'simulator = { python = "a:b" }\n[space]\nplate = { low = 1, high = 9, step = 1 }\n'
    with pytest.raises(InputError, match=r"sampling\.budget: must be at most 9, all designs of the space, got 10"):
        Campaign.of(parse_settings(text + "[sampling]\ninitial = 5\nbudget = 10", "f"))


CAMPAIGN = """
simulator = { python = "mine:beam", margins = ["margin"] }
seed = 4

[space]
load = { low = 5.0, high = 60.0, unit = "kN" }
plate = { low = 4.0, high = 12.0, step = 0.5, unit = "mm" }
storeys = { low = 1, high = 5, step = 1 }

[sampling]
initial = 20
budget = 40
"""

CODE = """
def beam(design):
    assert isinstance(design["storeys"], int) and design["plate"] * 2 % 1 == 0
    return design["plate"] * 6.0 - design["load"] * 0.8 - 2.0 * len(range(design["storeys"]))
"""


def probability(space: DesignSpace, fixed: Mapping[str, float]) -> float:
    """P(margin <= 0) by all values and the load's distribution."""
    plates = [fixed["plate"]] if "plate" in fixed else PLATE.values
    shares = [LOAD.share(np.array((6.0 * p - 2.0 * s) / 0.8)) for p in plates for s in STOREYS.values]
    return 1.0 - float(np.clip(shares, 0.0, 1.0).mean())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ran_in(tmp_path_factory.mktemp("steps"), CAMPAIGN, CODE)


def test_a_campaign_with_steps_simulates_its_values_once_and_knows_the_probability(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        table = run.simulations
        assert str(table["storeys"].dtype) == "int64"
        assert set(table["plate"]) <= set(PLATE.values)
        assert not table.duplicated(["load", "plate", "storeys"]).any()
        estimate = run.probability().estimate
        assert estimate.low <= probability(run.space, {}) <= estimate.high
        # A catalogue: the next smaller plate misses the target.
        designed = run.design(0.2, free=["plate"]).designed
        assert designed.values == {"plate": 8.0}
        assert probability(run.space, {"plate": 8.0}) <= 0.2 < probability(run.space, {"plate": 7.5})
        against = run.fragility(against="storeys").as_json()["variable"]
        assert against["levels"] == [1.0, 2.0, 3.0, 4.0, 5.0]
        verified = run.fragility(against="plate", verify=60, fixed={"storeys": 5})
        corrected = re.findall(r"([\d.]+) after correction.* interval ([\d.]+) to ([\d.]+)", "\n".join(verified.lines))
        assert corrected
        assert {float(number) for numbers in corrected for number in numbers} <= set(PLATE.values)


def test_values_between_the_steps_are_refused_by_questions_and_tables(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        with pytest.raises(InputError, match=r"plate: `4 <= plate <= 12` in steps of 0\.5 must hold, got 7\.3"):
            run.probability(fixed={"plate": 7.3})
        assert values_of("plate=14", run.space) == {"plate": 14.0}  # beyond the range, as of a continuous variable
        with pytest.raises(InputError, match=r"storeys: `1 <= storeys <= 5` in steps of 1 must hold"):
            run.add({"load": [20.0], "plate": [8.0], "storeys": [2.5], "margin": [1.0]})
        with pytest.warns(
            UserWarning, match=r"1 design .*\(the first by storeys: .* in steps of 1 must hold, got 2\.5\)"
        ):
            run.predict({"load": [20.0], "plate": [8.0], "storeys": [2.5]})


def test_a_question_of_a_stepped_variable_keeps_its_own_range_on_the_campaign_s_grid(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        (folder / "q.toml").write_text(
            'space.plate = { distribution = "normal", mean = 12.2, sd = 1.0, low = 9.5, high = 14.5 }'
        )
        asked = run.asked(folder / "q.toml")
        (plate,) = [one for one in asked.space.parameters if one.name == "plate"]
        assert (plate.low, plate.high, plate.step) == (9.5, 14.5, 0.5)
        assert asked.share_outside(run.space) > 0.4


def test_values_are_snapped_to_the_steps_and_shown_as_whole_numbers() -> None:
    space = DesignSpace((Parameter("y", 0.1, 0.7, step=0.1), STOREYS))
    noisy = np.array([[0.1 + 0.2, 0.3 / 0.1]])
    assert space.rounded(noisy).tolist() == [[0.3, 3.0]]
    assert space.columns(noisy)["storeys"].tolist() == [3]
    assert space.columns(np.array([[0.3, 2.5]]))["storeys"].tolist() == [2.5]  # kept from outside the space


def test_a_catalogue_under_constraints_has_as_many_designs_as_are_feasible() -> None:
    text = (
        'simulator = { python = "a:b" }\nconstraints = ["a + b <= 1"]\n[space]\n'
        "a = { low = 0, high = 9, step = 1 }\nb = { low = 0, high = 9, step = 1 }\n[sampling]\ninitial = 3\nbudget = 4"
    )
    with pytest.raises(InputError, match="must be at most 3, all designs of the space, got 4"):
        Campaign.of(parse_settings(text, "f"))
