"""Margins that are expressions of what a simulator returns: outputs of functions, programs and tables."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commandline import activefail, record

import activefail as af
from activefail.errors import InputError
from activefail.simulators.interface import NotFiniteError, Results, UnusableAnswerError
from activefail.simulators.returned import read_answer
from activefail.space.expressions import parse_expression
from activefail.space.systems import parse_system

MARGINS = {"stiffness": "1 - drift / 0.02", "strength": "1 - u"}
SPACE = """
[space]
load = { low = 0.2, high = 4.0 }
stiff = { low = 0.5, high = 2.0 }
[sampling]
initial = 8
budget = 12
batch = 2
"""
MODEL = """
def outputs(design):
    load = design["load"]
    return {"drift": 0.01 * load / design["stiff"], "u": load / 3, "period": [0.8, 0.3], "converged": True}

def load(design):
    return design["load"]

def margins(design):
    said = outputs(design)
    return {"stiffness": 1 - said["drift"] / 0.02, "strength": 1 - said["u"]}
"""


def read(answer: object, levels: tuple[float, ...] = (0.0,), system: str = "", **margins: str) -> Results:
    """The result of an answer with outputs."""
    expressions = {name: parse_expression(text, None) for name, text in margins.items()}
    of = parse_system(system, [*margins]) if system else None
    causes = ("", "buckling")
    return read_answer(answer, ("safe", "failure"), (), levels, 0.0, of, causes, (), expressions)


@pytest.mark.parametrize(
    ("text", "answer", "margin", "outcome"),
    [
        ("0.02 - drift", {"drift": 0.03}, -0.01, 1),  # fails above a limit
        ("0.02 - drift", 0.01, 0.01, 0),  # one output may be the whole answer
        ("thickness - 4", {"thickness": np.float64(3.0), "mass": None}, -1.0, 1),  # fails below a limit
        ("minimum(1 - u, 2 - abs(v))", {"u": 0.5, "v": -3}, -1.0, 1),
        ("1 - g", {"g": 0.25}, 0.75, 0),  # g is what the simulator says, not the acceleration of free fall
        ("6 - \N{MICRO SIGN}", {"\N{MICRO SIGN}": 2.0}, 4.0, 0),
    ],
)
def test_a_margin_decides_that_is_an_expression_of_outputs(
    text: str, answer: object, margin: float, outcome: int
) -> None:
    result = read(answer, reserve=text)
    assert result.outcome.tolist() == [outcome]
    assert result.margins[0, 0] == pytest.approx(margin)
    outputs = sorted(answer.items()) if isinstance(answer, dict) else [("drift", answer)]
    assert result.margins[0, 1:].tolist() == [value for name, value in outputs if name != "mass"]


def test_outputs_stand_beside_an_outcome_or_a_cause_and_may_then_be_left_out() -> None:
    assert read({"drift": 0.03, "cause": "buckling"}, g="0.02 - drift").cause.tolist() == [1]
    collapsed = read({"outcome": "failure", "cause": "buckling"}, g="0.02 - drift")
    assert (collapsed.outcome.tolist(), np.isnan(collapsed.margins).all()) == ([1], True)
    assert read("failure", g="0.02 - drift").outcome.tolist() == [1]


UNUSABLE = [
    ({"drfit": 0.1}, "the answer must have the output drift, as simulator.margins says; it has drfit"),
    ({"drift": "0.1"}, "drift: must be one number, left out where it is undefined, got '0.1'"),
    ({"drift": None}, "drift: must be one number"),
    (None, "drift: must be one number"),
    ({"outcome": "fine", "drift": 0.1}, "outcome: must be one of safe, failure, got 'fine'"),
]


@pytest.mark.parametrize(("answer", "message"), UNUSABLE)
def test_outputs_that_do_not_say_the_margin_are_no_answer(answer: object, message: str) -> None:
    with pytest.raises(UnusableAnswerError) as caught:
        read(answer, g="0.02 - drift")
    assert message in str(caught.value)


def test_what_neither_one_margin_nor_a_system_decides_needs_an_outcome() -> None:
    with pytest.raises(UnusableAnswerError, match=r"must have `outcome` \(safe, failure\).*state simulator\.system"):
        read({"drift": 0.01, "u": 0.1}, (), **MARGINS)
    with pytest.raises(UnusableAnswerError, match=r"must be a dictionary with drift, u, got 0\.1"):
        read(0.1, (), "min(stiffness, strength)", **MARGINS)


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ({"drift": math.nan}, "0.02 - drift"),
        ({"drift": -1.0}, "log(drift)"),
        ({"drift": 0.0}, "1 / drift"),
        ({"drift": math.nan, "outcome": "safe"}, "0.02 - drift"),
    ],
)
def test_a_margin_that_is_not_finite_is_no_result(answer: object, text: str) -> None:
    with pytest.raises(NotFiniteError, match="g"):
        read(answer, g=text)


def test_a_system_needs_only_the_outputs_that_decide() -> None:
    result = read({"drift": 0.03}, (), "min(stiffness, strength)", **MARGINS)
    assert result.outcome.tolist() == [1]
    np.testing.assert_array_equal(np.isnan(result.margins), [[False, True, False, True]])
    with pytest.raises(UnusableAnswerError, match="must have the output u"):
        read({"drift": 0.01}, (), "min(stiffness, strength)", **MARGINS)


def written(folder: Path, simulator: str) -> Path:
    """A campaign file beside the functions above."""
    (folder / "model.py").write_text(MODEL)
    (folder / "mine.toml").write_text(f"[simulator]\n{simulator}\n{SPACE}")
    return folder / "mine.toml"


def test_a_campaign_learns_from_expressions_what_it_learns_from_the_same_margins(tmp_path: Path) -> None:
    expressions = ", ".join(f'{name} = "{text}"' for name, text in MARGINS.items())
    system = 'system = "min(stiffness, strength)"'
    runs = []
    for name, simulator in {
        "plain": f'python = "model:margins"\nmargins = {[*MARGINS]}\n{system}',
        "outputs": f'python = "model:outputs"\nmargins = {{ {expressions} }}\n{system}',
    }.items():
        with af.create_run(tmp_path / name, written(tmp_path, simulator)) as run:
            run.take()
            probability = run.probability(simulations=20).as_json()["outcomes"]["failure"]
            runs.append((run.simulations.drop(columns="seconds"), probability, run.learned_from))
            predicted = run.predict({"load": [1.0, 3.5], "stiff": [1.0, 1.0]})["p_failure"].tolist()
        assert (predicted[0] < 0.05, predicted[1] > 0.95) == (True, True)
    (plain, *of_plain), (outputs, *of_outputs) = runs
    assert outputs[plain.columns].equals(plain)
    assert of_outputs == of_plain
    assert outputs.columns[-2:].tolist() == ["drift", "u"]
    np.testing.assert_allclose(outputs["u"], outputs["load"] / 3)
    said = activefail("status", tmp_path / "outputs").out
    assert "regression of the system min(stiffness, strength)" in said


@pytest.mark.parametrize("simulator", ['python = "model:load"', "command = 'echo u = {load}', pattern = 'u = (.*)'"])
def test_the_only_output_may_be_a_number_of_a_function_or_in_a_text(tmp_path: Path, simulator: str) -> None:
    file = written(tmp_path, "\n".join([*simulator.split(", "), 'margins = { g = "2 - u" }']))
    assert activefail("run", file, "--out", tmp_path / "run", "--workers", "1").code == 0
    for row in record(tmp_path / "run"):
        assert row["u"] == row["load"]
        assert float(row["g"]) == pytest.approx(2 - float(row["load"]))
        assert row["outcome"] == ("failure" if float(row["load"]) >= 2 else "safe")


@pytest.mark.parametrize("way", ["json", "patterns"])
def test_a_program_gives_several_outputs_as_json_or_by_a_pattern_for_each(tmp_path: Path, way: str) -> None:
    source = {
        "json": "import json, sys, model\n"
        "said = model.outputs({'load': float(sys.argv[1]), 'stiff': 1.0})\n"
        "json.dump(said, open(sys.argv[2], 'w'))\n",
        "patterns": "import sys, model\n"
        "said = model.outputs({'load': float(sys.argv[1]), 'stiff': 1.0})\n"
        "print('drift = 99\\nu;drift\\n9;9')\nprint('%r;%r' % (said['u'], said['drift']))\n",
    }[way]
    (tmp_path / "solver.py").write_text(source)
    pattern = "\npattern = { u = '^([^;]+);[^;]+$', drift = ';(.+)$' }" * (way == "patterns")
    file = written(
        tmp_path,
        'command = "python3 {here}/solver.py {load} {out}"\n'
        f'margins = {{ reserve = "minimum(1 - drift / 0.02, 1 - u)" }}{pattern}',
    )
    done = activefail("check", file)
    assert done.code == 0, done
    said = dict(line.split(None, 1) for line in done.out.splitlines())
    load = 2.1
    assert said["margin"] == "reserve = minimum(1 - drift / 0.02, 1 - u)"
    assert float(said["drift"]) == pytest.approx(0.01 * load)
    assert float(said["u"]) == pytest.approx(load / 3)
    assert (said["outcome"], float(said["reserve"])) == ("failure", pytest.approx(1 - load / 2))


ELSEWHERE: dict[str, Any] = {
    "simulator": {"elsewhere": True, "margins": {"g": "1 - drift / limit"}},
    "space": {"load": {"low": 0.0, "high": 4.0}},
    "sampling": {"initial": 4, "budget": 6, "batch": 2},
}


def answered(designs: pd.DataFrame) -> pd.DataFrame:
    """Designs with outputs, beside columns of the user's own."""
    return designs.assign(drift=0.01 * designs["load"], limit=0.02, note="by hand")


def test_tables_have_outputs_and_the_margins_follow(tmp_path: Path) -> None:
    with af.create_run(tmp_path / "run", ELSEWHERE) as run:
        designs = run.ask(4)
        with pytest.raises(InputError, match="column 'outcome' or 'drift' or 'limit': required, but missing"):
            run.tell(designs.assign(g=1.0))
        with pytest.raises(InputError, match="row 0: the answer must have the output limit"):
            run.tell(answered(designs)[:1].drop(columns="limit"))
        with pytest.raises(InputError, match=r'row 0: .*nan.*; if there is no result, its outcome is "numerical_fail'):
            run.tell(answered(designs)[:1].assign(limit=np.nan))
        assert run.tell(answered(designs)) == 4
        run.tell(answered(run.ask(2)))
        told = run.simulations
        np.testing.assert_allclose(told["g"], 1 - told["load"] / 2)
        assert told["outcome"].tolist() == np.where(told["load"] >= 2, "failure", "safe").tolist()
        assert run.learned_from[0].startswith("failure from the margin g")
        # With another limit the same simulations have other margins.
        with af.create_run(tmp_path / "other", ELSEWHERE) as other:
            assert other.add(told.drop(columns="outcome").assign(limit=0.03)) == 6
            np.testing.assert_allclose(other.simulations["g"], 1 - told["load"] / 3)
            assert other.simulations["note"].tolist() == ["by hand"] * 6
        told.to_csv(tmp_path / "told.csv", index=False)
        with af.create_run(tmp_path / "same", ELSEWHERE) as same:
            assert same.add(str(tmp_path / "told.csv")) == 6
            assert same.simulations[["g", "drift", "limit"]].equals(told[["g", "drift", "limit"]])
        assert run.tell({"id": 0, "drift": 0.5, "limit": 0.02}, correct=True) == 1
        assert run.corrections["g"].tolist() == [-24.0]


def test_a_variable_is_no_output(tmp_path: Path) -> None:
    simulator = {"elsewhere": True, "margins": {"g": "load - demand"}}
    message = "'load' is already the name of the quantity space.load; expressions take outputs: return it under another"
    with pytest.raises(InputError, match=message):
        af.create_run(tmp_path / "run", ELSEWHERE | {"simulator": simulator})
