"""Several limit states in one campaign: any of them, or all, or nested, make the system fail."""

import csv
import json
import math
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, record, table
from rare import four_branch
from scipy.special import ndtr
from scipy.stats import norm

from activefail.simulators.interface import NotFiniteError, UnusableAnswerError
from activefail.simulators.returned import read_answer
from activefail.space.systems import parse_system

NAMES = ["bending", "shear", "drift"]

EXPRESSIONS = [
    "min(bending, shear, drift)",
    "max(bending, shear, drift)",
    "min(bending, max(shear, drift))",
    "max(min(bending, drift), shear)",
    "min(max(bending, shear), max(bending, drift), max(shear, drift))",  # two of three
]


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_the_probability_of_a_system_is_the_sum_over_the_states_of_its_modes(text: str) -> None:
    system, z = parse_system(text, NAMES), 2.0 * np.random.default_rng(0).standard_normal((200, 3))
    total = np.zeros(len(z))
    for state in product([False, True], repeat=3):
        if system(np.where(state, -1.0, 1.0)) <= 0.0:
            total += np.prod(ndtr(np.where(state, z, -z)), axis=1)
    np.testing.assert_allclose(ndtr(system.probit(z)), total, rtol=1e-9)


def test_a_rare_probability_of_a_system_keeps_its_digits() -> None:
    series, parallel = (parse_system(f"{kind}(a, b)", ["a", "b"]) for kind in ("min", "max"))
    z = np.array([[-9.0, -9.0]])
    assert norm.logcdf(series.probit(z))[0] == pytest.approx(norm.logcdf(-9.0) + np.log(2.0), rel=1e-9)
    assert norm.logcdf(parallel.probit(z))[0] == pytest.approx(2.0 * norm.logcdf(-9.0), rel=1e-9)


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_an_undefined_margin_leaves_the_side_open_only_if_it_could_change_it(text: str) -> None:
    system = parse_system(text, NAMES)
    for margins in product([-1.0, 1.0, np.nan], repeat=3):
        ends = [[one] if one == one else [-5.0, 5.0] for one in margins]
        sides = {bool(system(np.array(values)) <= 0.0) for values in product(*ends)}
        value = system(np.array(margins))
        assert np.isnan(value) if len(sides) == 2 else sides == {bool(value <= 0.0)}


def test_the_mode_that_decides_is_the_one_that_most_probably_makes_the_difference() -> None:
    z = np.array([[-3.0, -1.0, -2.0], [2.0, -1.0, 3.0]])
    for text, modes in zip(EXPRESSIONS[:3], ([1, 2], [0, 1], [2, 0]), strict=True):
        assert parse_system(text, NAMES).deciding(z).tolist() == modes


@pytest.mark.parametrize(
    ("answer", "outcome"),
    [
        ({"bending": 0.1, "shear": 0.2, "drift": -0.1}, 0),
        ({"bending": -0.1, "shear": 0.2, "drift": 0.3}, 1),
        ({"margins": {"bending": 1.0, "shear": -0.2, "drift": -0.3}}, 1),
        ({"bending": -0.1}, 1),
        ({"bending": 0.1, "shear": 0.2}, 0),
        ({"outcome": "safe", "margins": {"bending": 0.1}}, 0),
    ],
)
def test_the_margins_of_a_system_are_a_whole_answer(answer: object, outcome: int) -> None:
    system = parse_system("min(bending, max(shear, drift))", NAMES)
    result = read_answer(answer, ("safe", "failure"), tuple(NAMES), (), 0.0, system)
    assert result.outcome.tolist() == [outcome]


@pytest.mark.parametrize("wrapped", [False, True])
def test_the_margins_of_a_system_may_stand_beside_a_cause_and_nothing_else(wrapped: bool) -> None:
    system, margins = parse_system("min(bending, max(shear, drift))", NAMES), {"bending": -0.1}
    answer = {"margins": margins} if wrapped else margins
    rules = ("safe", "failure"), tuple(NAMES), (), 0.0, system, ("", "buckling")
    result = read_answer(answer | {"cause": "buckling"}, *rules)
    assert (result.outcome.tolist(), result.cause.tolist()) == ([1], [1])
    with pytest.raises(UnusableAnswerError, match="'note'"):
        read_answer(answer | {"note": 1.0}, *rules)


def test_a_mode_may_be_nan_only_where_the_others_decide_also_beside_an_outcome() -> None:
    rules = ("safe", "failure"), tuple(NAMES), (), 0.0, parse_system("min(bending, max(shear, drift))", NAMES)
    decided = {"bending": -0.1, "shear": math.nan}
    assert read_answer(decided, *rules).outcome.tolist() == [1]
    assert read_answer({"outcome": "failure", "margins": decided}, *rules).outcome.tolist() == [1]
    for left_open in ({"bending": 0.1, "shear": math.nan}, {"outcome": "safe", "margins": {"bending": math.nan}}):
        with pytest.raises(NotFiniteError):
            read_answer(left_open, *rules)


def test_margins_that_leave_the_outcome_open_are_no_answer() -> None:
    system = parse_system("min(bending, max(shear, drift))", NAMES)
    with pytest.raises(UnusableAnswerError, match="margins: drift must be defined, since the others leave the outcome"):
        read_answer({"bending": 0.1, "shear": -0.2}, ("safe", "failure"), tuple(NAMES), (), 0.0, system)


LIMITS = """
def branches(design):
    x, y = design["x"], design["y"]
    bent = 3.0 + 0.1 * (x - y) ** 2
    right, left = bent - (x + y) / 2**0.5, bent + (x + y) / 2**0.5
    return {"right": right, "left": left, "below": x - y + 7 / 2**0.5, "above": y - x + 7 / 2**0.5}

def smallest(design):
    return min(branches(design).values())
"""
MODES = ("right", "left", "below", "above")
REST = """
stop = { probability = "failure" }
[space]
x = { distribution = "normal", mean = 0, sd = 1 }
y = { distribution = "normal", mean = 0, sd = 1 }
[sampling]
budget = 80
"""
SYSTEM = f'margins = {list(MODES)}\nsystem = "min({", ".join(MODES)})"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Campaigns that learn four modes, and the smallest margin, each to the end."""
    folder = tmp_path_factory.mktemp("systems")
    (folder / "limit.py").write_text(LIMITS)
    (folder / "modes.toml").write_text(f'{REST}[simulator]\npython = "limit:branches"\n{SYSTEM}')
    (folder / "one.toml").write_text(f'{REST}[simulator]\npython = "limit:smallest"\nmargins = ["g"]\n')
    for name in ("modes", "one"):
        assert activefail("run", folder / f"{name}.toml", "--out", folder / name).code == 0
    return folder


def estimated(run: Path, *options: str | Path) -> dict:
    result = activefail("probability", run, "--json", "--code", run.parent, *options)
    assert result.code == 0, result.err
    return json.loads(result.out)["outcomes"]["failure"]


def test_a_system_takes_fewer_simulations_than_its_smallest_margin(folder: Path) -> None:
    modes, one = (len(record(folder / name)) for name in ("modes", "one"))
    assert modes <= 0.7 * one
    for row in record(folder / "modes"):
        assert (row["outcome"] == "failure") == (min(float(row[name]) for name in MODES) <= 0.0)


def test_the_probability_comes_with_the_shares_of_the_modes(folder: Path) -> None:
    of = estimated(folder / "modes")
    assert of["low"] < 2.2225e-3 < of["high"]
    assert of["learned_from"] == f"min({', '.join(MODES)})"
    # The design measure is symmetric, and two modes hardly ever fail together.
    bent = 0.5 * (1.0 - 2.0 * norm.sf(3.5) / 2.2225e-3)
    for mode, share in zip(MODES, (bent, bent, 0.5 - bent, 0.5 - bent), strict=True):
        numbers = of["modes"][mode]
        assert numbers["failed"] == pytest.approx(share, rel=0.1)
        assert numbers["failed_low"] < share < numbers["failed_high"]
        assert numbers["decisive"] == pytest.approx(numbers["failed"], abs=1e-3)


def test_status_report_and_check_show_the_system(folder: Path) -> None:
    run, text = folder / "modes", f"min({', '.join(MODES)})"
    estimated(run)
    status = activefail("status", run).out
    assert f"failure from the system {text}" in status
    assert re.search(r"share of the failures in which a mode has failed: right (3\d|4[0-2])", status)
    assert json.loads(activefail("status", run, "--json").out)["estimates"]["failure"]["modes"].keys() == set(MODES)
    assert activefail("report", run, "--code", run.parent).code == 0
    assert "<dt>mode right</dt><dd>has failed in " in (run / "report.html").read_text(encoding="utf-8")
    assert f"{text} &lt;= 0" in activefail("check", folder / "modes.toml").out.replace("<", "&lt;")


def test_a_question_and_the_classifier_alone_work_on_a_system(folder: Path) -> None:
    run = folder / "modes"
    (folder / "wider.toml").write_text('[space]\nx = { distribution = "normal", mean = 0, sd = 1.2 }\n')
    asked = estimated(run, "--question", folder / "wider.toml")
    X = np.random.default_rng(0).standard_normal((2_000_000, 2)) * [1.2, 1.0]
    true = float(np.mean(four_branch(X) <= 0.0))
    assert asked["low"] < true < asked["high"]
    assert asked["check"]["contradictions"] == 0
    designs = folder / "designs.csv"
    designs.write_text("x,y\n3,3\n0,0\n")
    assert activefail("predict", run, "--csv", designs, "--out", folder / "predicted.csv").code == 0
    assert [round(float(row["p_failure"]), 6) for row in table(folder / "predicted.csv")] == [1.0, 0.0]


@pytest.mark.slow
def test_a_campaign_that_continues_from_its_saved_state_has_the_same_bits(folder: Path) -> None:
    run = folder / "cut"
    (folder / "cut.toml").write_text((folder / "modes.toml").read_text().replace("budget = 80", "budget = 16"))
    assert activefail("run", folder / "cut.toml", "--out", run).code == 0
    assert activefail("resume", run, "--budget", "80", "--code", folder).code == 0
    assert record(run) == record(folder / "modes")


def test_the_margins_alone_are_told(tmp_path: Path) -> None:
    (tmp_path / "asked.toml").write_text(f"{REST}[simulator]\nelsewhere = true\n{SYSTEM}")
    run, todo, told = tmp_path / "run", tmp_path / "todo.csv", tmp_path / "told.csv"
    assert activefail("create", tmp_path / "asked.toml", "--out", run).code == 0
    assert activefail("ask", run, "--n", "3", "--csv", todo).code == 0
    rows = table(todo)
    with told.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["id", *MODES])
        for row, below in zip(rows, (1.0, -1.0, ""), strict=True):
            writer.writerow([row["id"], 1.0, 2.0, below, 3.0])
    refused = activefail("tell", run, "--csv", told)
    assert refused.code == 2
    assert "margins: below must be defined, since the others leave the outcome open" in refused.err
    told.write_text("\n".join(told.read_text().splitlines()[:-1]) + "\n")
    assert activefail("tell", run, "--csv", told).code == 0
    assert [row["outcome"] for row in record(run)] == ["safe", "failure"]
