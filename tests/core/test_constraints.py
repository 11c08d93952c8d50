"""Constraints: the design measure is conditional on them, everywhere."""

from pathlib import Path

import numpy as np
import pytest
from explorer.conftest import site_of
from matplotlib.figure import Figure
from ran import ran_in

from activefail import open_run
from activefail.analyses.findings.results import predict
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.learning.criteria.population import population
from activefail.pages.figures.outcome_planes import coordinates

SPACE = """
simulator = { python = "mine:gap", margins = ["margin"] }
constraints = ["depth + gap <= 1", "depth * k > 0.02"]
seed = 2

[space]
depth = { low = 0.0, high = 1.0 }
gap = { low = 0.0, high = 1.0 }
k = { value = 0.2 }

[classifier.features]
expressions = { d = "depth", room = "log(1.000001 - depth - gap)" }

[sampling]
initial = 20
budget = 40
"""
FEASIBLE = 0.5 * (1.0 - 0.1**2) - 0.1 * 0.9  # of the unit square: below the diagonal, right of 0.1

CODE = """
def gap(design):
    assert design["depth"] + design["gap"] <= 1.0 and design["depth"] > 0.1
    return 0.75 - design["depth"] - 0.3 * design["gap"] ** 2
"""


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return Campaign.of(parse_settings(SPACE, "f"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ran_in(tmp_path_factory.mktemp("constraints"), SPACE, CODE)


def truth(depth: float | None = None) -> float:
    """P(margin <= 0) of feasible designs, by the lengths of lines at many gaps y."""
    y = (np.arange(1_000_000) + 0.5) / 1_000_000
    if depth is not None:
        y = y[y <= 1.0 - depth]
        return float((0.75 - depth - 0.3 * y**2 <= 0.0).mean())
    last, fails_from = 1.0 - y, np.maximum(0.1, 0.75 - 0.3 * y**2)
    return float(np.maximum(last - fails_from, 0.0).mean() / FEASIBLE)


def test_every_sample_has_feasible_designs_alone(campaign: Campaign) -> None:
    space, rng = campaign.space, np.random.default_rng(1)
    assert space.feasible_share == pytest.approx(FEASIBLE, abs=0.002)
    for X in (space.sobol(512, rng), space.latin_hypercube(300, rng), space.random(300, rng)):
        assert space.contains(X).all()
        assert X[:, 0].mean() == pytest.approx(0.4, abs=0.02)  # of the triangle
    drawn = population(space, 20_000, None, rng)
    assert space.contains(drawn.X[drawn.weight > 0.0]).all()
    assert drawn.weight.mean() == pytest.approx(1.0, abs=0.03)
    assert (drawn.weight * drawn.X[:, 0]).mean() == pytest.approx(0.4, abs=0.02)


def test_simulations_and_probabilities_are_those_of_feasible_designs(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        assert (run.simulations["outcome"] != "numerical_failure").all()
        findings = run.probability()
        assert any("Only designs that meet the constraints count, 40.5 %" in note for note in findings.assumptions)
        estimate = findings.estimate
        assert estimate.low <= truth() <= estimate.high
        at = run.probability(fixed={"depth": 0.74}).estimate
        assert at.low <= truth(0.74) <= at.high
        # The levels are those at which there are designs.
        levels = run.fragility(against="depth").as_json()["variable"]["levels"]
        assert 0.1 < min(levels) < max(levels) < 1.0
        designed = run.design(0.05, free=["depth"], cost="-depth").designed
        assert truth(designed.values["depth"]) <= 0.05 < truth(designed.values["depth"] + 0.01)
        assert run.verify(100).estimate.misclassified <= 5


def test_designs_that_break_a_constraint_are_refused(folder: Path) -> None:
    with open_run(folder / "run", write=True, code=folder) as run:
        with pytest.raises(InputError, match=r"row 1, column depth: the constraint 'depth \+ gap <= 1' must hold"):
            run.add({"depth": [0.5, 0.9], "gap": [0.4, 0.5], "margin": [0.2, 0.1]})
        with pytest.raises(InputError, match=r"'depth \* k > 0.02' must hold, got depth = 0\.05"):
            run.probability(fixed={"depth": 0.05})
        with pytest.raises(InputError, match="makes the variables dependent"):
            run.sensitivity()


@pytest.mark.parametrize(
    ("constraint", "rule"),
    [
        ("depth + gap", "one of <=, >=, <, > between them"),
        ("0 < depth < 1", "one of <=, >=, <, > between them"),
        ("depth <= width", "unknown name 'width'"),
        ("depth + gap <= 0.0001", "at least 0.1 % of the variables' distribution must meet"),
        ("depth <= -1", "at least 0.1 % of the variables' distribution must meet"),
    ],
)
def test_a_constraint_that_makes_no_sense_is_refused(constraint: str, rule: str) -> None:
    with pytest.raises(InputError, match="constraints") as refused:
        Campaign.of(parse_settings(SPACE.replace("depth + gap <= 1", constraint), "f"))
    assert rule in str(refused.value)


@pytest.mark.parametrize(
    ("constraint", "met"),
    [
        ("depth / (gap - gap) <= 5", [False, False]),
        ("5 >= depth / (gap - 0.5)", [True, False]),
        ("-1 / (gap - 0.5) ** 2 < depth", [True, False]),
        ("depth <= 9 ** 9 ** 9 ** 9", [False, False]),
        ("log(gap - 0.5) <= 1", [False, False]),
        ("exp(2000 * gap) >= depth", [True, False]),
    ],
)
def test_a_constraint_with_an_infinite_or_undefined_side_is_not_met(constraint: str, met: list[bool]) -> None:
    space = parse_settings(SPACE.replace("depth + gap <= 1", constraint), "f").design_space()
    designs = np.array([[0.4, 0.2], [0.4, 0.5]])
    assert space.meets_constraints(designs).tolist() == met
    assert space.contains(designs).tolist() == met
    assert [space.broken_rule(design) is None for design in designs] == met


def test_decimal_numbers_are_compared_as_a_person_would(campaign: Campaign) -> None:
    assert campaign.space.meets_constraints(np.array([[0.7, 0.3], [0.1 + 0.2, 0.7], [0.7, 0.3001]])).tolist() == [
        True,
        True,
        False,
    ]


def test_designs_that_break_a_constraint_are_not_drawn(folder: Path) -> None:
    inside, outside = [0.4, 0.2], [0.9, 0.9]
    with open_run(folder / "run", code=folder) as run:
        prediction = coordinates(run.findings).predict(np.array([inside, outside]))
        assert np.isfinite(prediction.beyond).tolist() == [True, False]
        assert np.isfinite(prediction.probabilities).all(axis=1).tolist() == [True, False]
        assert np.isnan(predict(run.campaign, run.findings.classifier, np.array([outside, outside])).mean).all()
        axes = run.plot_boundary("depth", "gap", axes=Figure().subplots())
        assert [text.get_text() for text in axes.get_legend().get_texts()][-1] == "no design in the space"
        one = site_of(run.findings).one
        here, nowhere = ({"depth": X[0], "gap": X[1]} for X in (inside, outside))
        assert "No such design" not in one.predict(here)
        assert (
            one.predict(nowhere)
            .strip()
            .endswith('<p class="fault">No such design exists: it breaks depth + gap &lt;= 1.</p>')
        )
        assert "<pattern" in one.plane(here | {"across": "depth", "up": "gap", "shown": "failure"})  # the hatching
