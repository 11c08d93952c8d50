"""`activefail check`: what a campaign file means, before hours are spent."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from commandline import activefail, record, refused

SPACE = """
[space]
x = { low = 0.0, high = 1.0, unit = "m" }
y = { low = 1e-6, high = 1.0, distribution = "log_uniform" }
z = { value = 3.0 }
"""

FUNCTIONS = {
    "design['x'] - 0.3": (0, ["outcome    safe", "g          0.2", "agrees     "]),
    "{'outcome': 'failure', 'margins': {'g': 0.2}}": (0, ["warning    the outcome failure contradicts all margins"]),
    "{'outcome': 'failure', 'margins': {'g': -0.2}}": (
        0,
        ["outcome    failure\ng          -0.2\nwarning    the design at the"],
    ),
    "'failure'": (0, ["outcome    failure", "g          undefined", "agrees     "]),
    "random.random()": (1, ["The same design has two results: g 0.", "with a fixed random seed"]),
    "random.choice([print('noise'), 1 / 0])": (
        1,
        ["The simulation failed: design x = 0.5, y = 0.001: ", "ZeroDivision"],
    ),
    "None": (1, ["The simulation failed: ", "or the margin g as one number, got None"]),
    "True": (1, ["The simulation failed: ", "or the margin g as one number, got True"]),
    "[1.0, 2.0]": (1, ["The simulation failed: ", "or the margin g as one number, got [1.0, 2.0]"]),
}


@pytest.mark.parametrize("returned", FUNCTIONS)
def test_a_function_is_simulated_twice_and_its_answer_shown(tmp_path: Path, returned: str) -> None:
    code, says = FUNCTIONS[returned]
    function = f"def run(design):\n    print('noise')\n    return {returned}\n"
    (tmp_path / "model.py").write_text(f"import random\n\n{function}")
    (tmp_path / "mine.toml").write_text(f'simulator = {{ python = "model:run", margins = ["g"] }}\n{SPACE}')
    done = activefail("check", tmp_path / "mine.toml")
    assert done.code == code, done
    understood = ["variable   x [m]: 0 to 1, uniform", "variable   y: 1e-06 to 1, log uniform", "fixed      z = 3"]
    simulator = [f"simulator  the function model:run in {tmp_path}", "margins    g <= 0 at failure"]
    for text in (*understood, *simulator, *says):
        assert text in done.out + done.err
    assert "noise" not in done.out
    assert sorted(path.name for path in tmp_path.glob("*")) == ["mine.toml", "model.py"]


WRONG_WAY_ROUND = {
    # A utilisation of 0.5 in the middle of the space.
    'margins = ["u"], levels = { u = [1.0] }': ("u = 0.5 is at most 1.", 'margins = { u_margin = "1 - u" }'),
    'margins = { g = "u - 1" }': ("g = -0.5 is at most 0.", 'margins.g = "-(u - 1)"'),
    'margins = { g = "u - 1", h = "2 - u" }, system = "min(g, h)"': ("g = -0.5 is at", 'margins.g = "-(u - 1)"'),
    'margins = ["u"], outcomes = ["a", "b", "c"], levels = { u = [2.0, 1.0] }': (
        "u = 0.5 is at most 1.",
        'margins = { u_margin = "-u" }, with the negative levels',
    ),
}


@pytest.mark.parametrize("margins", WRONG_WAY_ROUND)
def test_a_margin_by_which_the_design_at_the_medians_fails_is_warned_of(tmp_path: Path, margins: str) -> None:
    (tmp_path / "model.py").write_text("def run(design):\n    return design['x']\n")
    (tmp_path / "mine.toml").write_text(f'simulator = {{ python = "model:run", {margins} }}\n{SPACE}')
    done = activefail("check", tmp_path / "mine.toml")
    (warning,) = (line for line in done.out.splitlines() if line.startswith("warning"))
    which, turned = WRONG_WAY_ROUND[margins]
    assert f"the design at the medians of the variables fails: {which}" in warning
    assert warning.endswith(f"If it is safe, turn the margin round: {turned}")


RIGHT_WAY_ROUND = (
    'margins = { g = "1 - u" }',
    'margins = ["u"]',
    'margins = { g = "1 - u" }, outcomes = ["a", "b", "c"], levels = { g = [0.6, 0.2] }',
)


@pytest.mark.parametrize("margins", RIGHT_WAY_ROUND)
def test_a_safe_design_at_the_medians_is_not_warned_of(tmp_path: Path, margins: str) -> None:
    (tmp_path / "model.py").write_text("def run(design):\n    return design['x']\n")
    (tmp_path / "mine.toml").write_text(f'simulator = {{ python = "model:run", {margins} }}\n{SPACE}')
    done = activefail("check", tmp_path / "mine.toml")
    assert (done.code, "warning" in done.out) == (0, False), done


def test_a_design_that_fails_by_its_outcome_alone_or_at_no_medians_is_not_warned_of(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text("def run(design):\n    return 'failure' if design['x'] < 0.9 else -1.0\n")
    for constraint in ("", 'constraints = ["x >= 0.95"]\n'):
        (tmp_path / "mine.toml").write_text(
            f'{constraint}simulator = {{ python = "model:run", margins = ["g"] }}\n{SPACE}'
        )
        done = activefail("check", tmp_path / "mine.toml")
        assert (done.code, "outcome    failure" in done.out, "warning" in done.out) == (0, True, False), done


@pytest.mark.parametrize("command", ["echo g = {x} {y}", "sh -c 'echo g = {x} $AF_y'", "sh {here}/model.sh"])
def test_variables_that_a_command_names_or_may_read_are_not_warned_of(tmp_path: Path, command: str) -> None:
    (tmp_path / "model.sh").write_text("echo g = $AF_x\n")
    (tmp_path / "mine.toml").write_text(
        f'simulator = {{ command = "{command}", pattern = "g = (\\\\S*)", margins = ["g"] }}\n{SPACE}'
    )
    done = activefail("check", tmp_path / "mine.toml")
    assert (done.code, "warning" in done.out) == (0, False), done


def test_a_program_is_shown_with_its_template_and_the_folder_of_its_files(tmp_path: Path) -> None:
    (tmp_path / "model.in").write_text("g = {x}\n")
    program = "command = 'cat model', template = 'model.in', pattern = 'g = (.*)', margins = ['g']"
    (tmp_path / "mine.toml").write_text(f"simulator = {{ {program} }}\n{SPACE}")
    done = activefail("check", tmp_path / "mine.toml")
    assert done.code == 0, done.err
    assert "template   model.in is filled in with x\n" in done.out
    # Braces with blanks, <y> and the like are no placeholders.
    assert (
        "warning    neither the command nor a template names y; the program must read design.json or $AF_y" in done.out
    )
    (folder,) = (Path(line[11:]) for line in done.out.splitlines() if line.startswith("folder"))
    assert (folder / "model").read_text() == "g = 0.5\n"


def test_a_table_of_a_program_s_simulations_has_their_folders(tmp_path: Path) -> None:
    (tmp_path / "model.in").write_text("g = {x}\n")
    program = "command = 'cat model', template = 'model.in', pattern = 'g = (.*)', margins = ['g']"
    sampling = "sampling = { initial = 2, budget = 2, batch = 2 }\nclassifier.learns = 'outcomes'"
    (tmp_path / "mine.toml").write_text(f"{sampling}\nsimulator = {{ {program} }}\n{SPACE}")
    assert activefail("run", tmp_path / "mine.toml", "--out", tmp_path / "run", "--workers", "1").code == 0
    for row in record(tmp_path / "run"):
        assert (Path(row["folder"]) / "model").read_text() == f"g = {row['x']}\n"


def test_simulations_done_elsewhere_are_described(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(f"simulator = {{ elsewhere = true }}\n{SPACE}")
    done = activefail("check", tmp_path / "mine.toml")
    assert (done.code, "simulator  elsewhere; nothing is simulated here" in done.out) == (0, True)
    refused(activefail("check", tmp_path / "none.toml"), "none.toml: cannot be read")


def test_a_module_that_writes_to_the_descriptor_of_standard_output_spoils_no_json(tmp_path: Path) -> None:
    noise = "import ctypes, os\nos.write(1, b'noise')\nctypes.CDLL(None).puts(b'more noise')\n"
    (tmp_path / "model.py").write_text(f"{noise}\ndef run(design):\n    return design['x']\n")
    (tmp_path / "mine.toml").write_text(f'simulator = {{ python = "model:run", margins = ["g"] }}\n{SPACE}')
    words = [sys.executable, "-m", "activefail", "check", tmp_path / "mine.toml", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    rows = [(row["title"], row["text"]) for row in json.loads(done.stdout)["understood"]]
    assert ("g", "0.5") in rows
    assert "noise" in done.stderr
