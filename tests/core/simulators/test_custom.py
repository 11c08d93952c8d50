"""Custom simulators: their input, their permitted answers, and the treatment of other answers."""

import importlib
import json
import math
import os
import pickle
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from decimal import Decimal
from enum import Enum, IntEnum
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from commandline import activefail, record, refused, sets, started, table, wait_for
from patience import PATIENCE, Clock, until

from activefail.campaign.on_disk import create_folder, read_campaign
from activefail.campaign.sections import PythonSimulatorSettings
from activefail.errors import InputError
from activefail.execution.answering import answer
from activefail.execution.local import ProcessExecutor, local_executor
from activefail.simulators.command import CommandSimulator
from activefail.simulators.function import PythonSimulator
from activefail.simulators.interface import (
    NOT_FINITE,
    RAISED,
    TIME_LIMIT,
    UNUSABLE_ANSWER,
    NotFiniteError,
    UnusableAnswerError,
)
from activefail.simulators.returned import read_answer
from activefail.simulators.user_code import digest_without_running
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SPACE = DesignSpace((Parameter("drift", 0.0, 4.0, "m"), Parameter("T", 1.0, 3.0)), {"storeys": 3.0})
X = np.array([[1.0 / 3.0, 1.5], [2.5, 2.0], [3.7, 2.9]])

MODEL = """
import pathlib

def run(design):
    assert design.keys() == {"drift", "T", "storeys"}
    severity = (design["drift"] > 1.0) + (design["drift"] > design["storeys"])
    return {"outcome": ("safe", "damage", "failure")[severity], "margins": {"gap": design["storeys"] - design["drift"]}}

def plain(design):
    return "damage"

def broken(design):
    return eval(pathlib.Path(__file__).with_name("said").read_text())
"""


def python(folder: Path, function: str = "run", source: str = MODEL) -> PythonSimulator:
    """A function of a module in a folder, over SPACE."""
    (folder / "model.py").write_text(source)
    return PythonSimulator(SPACE, f"model:{function}", folder, ("safe", "damage", "failure"), ("gap", "energy"))


def program(folder: Path, source: str, **other: object) -> CommandSimulator:
    """A Python program in a folder, over SPACE; it receives the drift, with all digits and with two, and its folder."""
    (folder / "model.py").write_text(f"import json, os, sys, time\n{source}")
    options = {
        "command": f"{sys.executable} {{here}}/model.py {{drift}} {{T:.2f}} 'a b' {{out}}",
        "here": folder,
        "work": folder / "work",
        "outcomes": ("safe", "failure"),
        "margins": ("gap",),
    }
    return CommandSimulator(SPACE, **(options | other))


def ended(pid: str) -> bool:
    """Whether a process has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def started_by(pid: int) -> list[str]:
    """Command lines of the processes that a process has started."""
    actual = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            with suppress(OSError):
                actual.append(Path(f"/proc/{child}/cmdline").read_text())
    return actual


ANSWERS = """
drift, T, text, out = sys.argv[1:]
print(text, T)
with open(out, "w") as file:
    json.dump({"outcome": "failure" if float(drift) > 1.0 else "safe", "margins": {"gap": float(drift)}}, file)
"""


@pytest.fixture(autouse=True)
def no_module_stays(tmp_path: Path) -> Iterator[None]:
    """A module of a test's folder that Python itself has imported would be the next test's, too."""
    yield
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(f"{tmp_path}/"):
            del sys.modules[name]


# --- a function --------------------------------------------------------------------------------------------------


def test_a_function_is_told_the_variables_and_what_is_fixed_and_answers_outcome_and_margins(tmp_path: Path) -> None:
    results = answer(python(tmp_path), X)
    assert results.faults == {}
    assert results.outcome.tolist() == [0, 1, 2]
    assert results.margins[:, 0].tolist() == (3.0 - X[:, 0]).tolist()
    assert np.isnan(results.margins[:, 1]).all()
    assert (results.seconds >= 0.0).all()


def test_an_outcome_alone_is_an_answer(tmp_path: Path) -> None:
    assert answer(python(tmp_path, "plain"), X).outcome.tolist() == [1, 1, 1]


def test_an_answer_may_name_one_of_the_causes(tmp_path: Path) -> None:
    source = "def run(design):\n    return {'outcome': 'failure', 'cause': 'shear' if design['drift'] > 2.0 else ''}\n"
    model = replace(python(tmp_path, source=source), causes=("", "bending", "shear"))
    assert answer(model, X).cause.tolist() == np.where(X[:, 0] > 2.0, 2, 0).tolist()
    assert answer(replace(model, causes=("",)), X).cause.tolist() == [0, 0, 0]
    with pytest.raises(UnusableAnswerError, match=r"cause: must be one of simulator\.causes, which names bending, got"):
        replace(model, causes=("", "bending")).run(X[X[:, 0] > 2.0])


UNUSABLE = {
    "None": r"must be the name of an outcome \(safe, damage, failure\), or a dictionary with `outcome`, got None",
    "{}": "outcome: must be one of safe, damage, failure, got None",
    "'collapse'": "outcome: must be one of safe, damage, failure, got 'collapse'",
    "{'outcome': ['safe']}": r"outcome: must be one of safe, damage, failure, got \['safe'\]",
    "{'outcome': 'safe', 'margin': {}}": "may contain only outcome, margins, cause, got 'margin'",
    "{'outcome': 'safe', 'margins': [1.0]}": "margins: must be a dictionary of gap, energy",
    "{'outcome': 'safe', 'margins': {'gab': 1.0}}": "margins: 'gab' is not declared in simulator.margins, .* gap",
    "{'outcome': 'safe', 'margins': {'gap': None}}": "margins.gap: must be one number, .*, got None",
    "{'outcome': 'safe', 'margins': {'gap': True}}": "margins.gap: must be one number, .*, got True",
    "{'outcome': 'safe', 'margins': {'gap': -(10**400)}}": "margins.gap: must fit",
}


@pytest.mark.faults
@pytest.mark.parametrize("result", UNUSABLE)
def test_what_is_no_answer_is_a_numerical_failure_that_says_why(tmp_path: Path, result: str) -> None:
    (tmp_path / "said").write_text(result)
    results = answer(python(tmp_path, "broken"), X[:1])
    fault = results.faults[0]
    assert (results.outcome.tolist(), results.cause.tolist()) == ([-1], [UNUSABLE_ANSWER])
    assert fault.startswith("design drift = 0.333333, T = 1.5: ")
    assert re.search(UNUSABLE[result], fault), fault


NAN = {
    "{'outcome': 'safe', 'margins': {'gap': float('nan')}}": "margins.gap: must be a number beside the outcome safe",
    "{'outcome': 'failure', 'margins': {'gap': -float('nan')}}": "beside the outcome failure, got nan; leave it out",
    "{'outcome': 'safe', 'margins': {'gap': 1.0, 'energy': float('nan')}}": "margins.energy: must be a number",
    "{'outcome': 'damage', 'margins': {'gap': __import__('decimal').Decimal('NaN')}}": "margins.gap: must be",
    "{'outcome': 'safe', 'margins': {'gap': __import__('numpy').array([float('nan')])}}": "margins.gap: must be",
}


@pytest.mark.parametrize("result", NAN)
def test_a_margin_that_is_nan_is_no_result_whatever_the_outcome_beside_it(tmp_path: Path, result: str) -> None:
    (tmp_path / "said").write_text(result)
    results = answer(python(tmp_path, "broken"), X[:1])
    assert (results.outcome.tolist(), results.cause.tolist()) == ([-1], [NOT_FINITE])
    assert NAN[result] in results.faults[0]


def test_a_margin_that_is_left_out_or_that_ends_at_failure_may_be_undefined() -> None:
    rules = ("safe", "failure"), ("gap", "energy"), (), 0.0
    for outcome in ("safe", "failure"):
        read = read_answer({"outcome": outcome, "margins": {"gap": 1.0}}, *rules)
        assert np.isnan(read.margins).tolist() == [[False, True]]
    nan = {"gap": math.nan, "energy": 1.0}
    assert read_answer({"outcome": "failure", "margins": nan}, *rules, truncated=("gap",)).outcome.tolist() == [1]
    for answered, truncated in (("safe", ("gap",)), ("failure", ("energy",))):
        with pytest.raises(NotFiniteError, match=r"margins\.gap: must be a number beside"):
            read_answer({"outcome": answered, "margins": nan}, *rules, truncated=truncated)


def test_a_program_that_writes_nan_has_no_result(tmp_path: Path) -> None:
    for source in (
        "json.dump({'outcome': 'safe', 'margins': {'gap': float('nan')}}, open(sys.argv[-1], 'w'))",
        "json.dump(float('nan'), open(sys.argv[-1], 'w'))",
    ):
        assert answer(program(tmp_path, source, levels=(0.0,)), X[:1]).cause.tolist() == [NOT_FINITE]
    simulator = program(tmp_path, "print('gap = nan')", levels=(0.0,), pattern=r"gap = (\S+)")
    assert answer(simulator, X[:1]).cause.tolist() == [NOT_FINITE]


@pytest.mark.faults
def test_the_place_of_an_error_that_a_library_raises_is_the_last_line_of_the_user_s_code(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("import numpy\n\ndef factor():\n    return numpy.linalg.cholesky([[-1.0]])\n")
    simulator = python(tmp_path, source="import helper\n\ndef run(design):\n    return helper.factor()\n")
    with ProcessExecutor(1) as executor:
        results = executor.run(simulator, X[:1])
    assert results.cause.tolist() == [RAISED]
    assert "LinAlgError: Matrix is not positive definite" in results.faults[0]
    assert f" ({tmp_path / 'helper.py'}:4)" in results.faults[0]


MUTE = """
class Mute(ValueError):
    def __str__(self):
        {how}

def run(design):
    raise Mute
"""


@pytest.mark.faults
@pytest.mark.parametrize("how", ["raise KeyError(1)", "raise KeyboardInterrupt"])
def test_an_error_whose_message_cannot_be_read_is_a_simulation_that_raised(tmp_path: Path, how: str) -> None:
    simulator = python(tmp_path, source=MUTE.format(how=how))
    with ProcessExecutor(1) as executor:
        results = executor.run(simulator, X[:1])
    assert results.cause.tolist() == [RAISED]
    assert "Mute, whose message cannot be read (" in results.faults[0]


def test_a_function_may_not_be_run_where_no_folder_was_named(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text("raise SystemExit")
    simulator = PythonSimulator(SPACE, "model:run", None, ("safe", "failure"), ())
    with pytest.raises(InputError, match=r"model:run is custom code.*name its folder with --code, or code=FOLDER in"):
        answer(simulator, X)


def test_a_worker_that_has_another_source_refuses_and_a_new_source_is_loaded_anew(tmp_path: Path) -> None:
    first = python(tmp_path)
    first = replace(first, source=first.load())
    assert answer(first, X).outcome.tolist() == [0, 1, 2]
    python(tmp_path, source=MODEL.replace("> 1.0", "> 0.1"))
    second = replace(first, source=first.load())
    assert answer(second, X).outcome.tolist() == [1, 1, 2]
    with pytest.raises(
        InputError, match="different code from that at the start of the campaign, in the module of model:run"
    ):
        answer(replace(first, source="0" * 64), X)


def test_a_simulator_of_one_s_own_goes_to_a_worker_process_and_gives_the_same_there(tmp_path: Path) -> None:
    with ProcessExecutor(2) as executor:
        results = executor.run(python(tmp_path), X)
    expected = answer(python(tmp_path), X)
    assert results.outcome.tobytes() == expected.outcome.tobytes()
    assert results.margins.tobytes() == expected.margins.tobytes()


def test_the_import_of_a_function_s_module_does_not_count_to_its_time_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    imports = tmp_path / "imports"
    # Each import takes a minute.
    clock = Clock(lambda: 60.0 * imports.stat().st_size if imports.exists() else 0.0)
    monkeypatch.setattr("activefail.execution.processes.time", clock)
    simulator = python(tmp_path, source=f"with open({str(imports)!r}, 'a') as file:\n    file.write('.')\n{MODEL}")
    with ProcessExecutor(1, time_limit=1.0) as executor:
        assert executor.run(simulator, X).outcome.tolist() == [0, 1, 2]
    assert imports.stat().st_size == 1


WITH_HELPERS = """
import limits
from parts import walls

def run(design):
    import late
    severity = (design["drift"] > limits.DAMAGE) + (design["drift"] > walls.FAILURE) + late.MORE
    return {"outcome": ("safe", "damage", "failure")[severity]}
"""


def with_helpers(folder: Path, damage: float = 1.0, failure: float = 3.0, extra: int = 0) -> PythonSimulator:
    """A function that reads its limits from modules in its folder: a module, one in a package, and one at run time."""
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    (folder / "limits.py").write_text(f"DAMAGE = {damage!r}\n")
    (folder / "parts" / "__init__.py").write_text("")
    (folder / "parts" / "walls.py").write_text("from . import bricks\n\nFAILURE = bricks.FAILURE\n")
    (folder / "parts" / "bricks.py").write_text(f"FAILURE = {failure!r}\n")
    (folder / "late.py").write_text(f"MORE = {extra!r}\n")
    simulator = python(folder, source=WITH_HELPERS)
    return replace(simulator, source=simulator.load())


def test_a_function_may_import_modules_beside_its_own_here_and_in_worker_processes(tmp_path: Path) -> None:
    simulator = with_helpers(tmp_path)
    assert answer(simulator, X).outcome.tolist() == [0, 1, 2]
    with ProcessExecutor(1) as executor:
        results = executor.run(simulator, X)
    assert (results.outcome.tolist(), results.faults) == ([0, 1, 2], {})


def test_modules_beside_a_function_hide_none_of_a_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)  # of Python's own, and perhaps imported already
    (tmp_path / "colorsys.py").write_text("raise AssertionError('this is not the library')\n")
    (tmp_path / "numpy.py").write_text("raise AssertionError('this is not the library')\n")
    simulator = python(tmp_path, source=f"import colorsys, numpy\n{MODEL}\ncolorsys.rgb_to_hsv(0, 0, numpy.pi)\n")
    assert answer(simulator, X).outcome.tolist() == [0, 1, 2]
    with ProcessExecutor(1) as executor:
        assert executor.run(simulator, X).outcome.tolist() == [0, 1, 2]


def test_functions_of_two_folders_each_have_their_own_of_two_modules_of_one_name(tmp_path: Path) -> None:
    one, other = with_helpers(tmp_path / "one"), with_helpers(tmp_path / "other", damage=0.1, failure=9.0, extra=1)
    for simulator, outcome in ((one, [0, 1, 2]), (other, [2, 2, 2]), (one, [0, 1, 2])):
        simulator.prepare()
        assert answer(simulator, X).outcome.tolist() == outcome
    assert [folder for folder in sys.path if Path(folder).is_relative_to(tmp_path)] == [str(tmp_path / "one")]


def test_modules_of_a_folder_that_the_program_itself_has_imported_stay_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = with_helpers(tmp_path / "one"), with_helpers(tmp_path / "other")
    other.prepare()
    (tmp_path / "one" / "imported_before.py").write_text("LEVEL = 1.0\n")
    monkeypatch.syspath_prepend(tmp_path / "one")
    before = importlib.import_module("imported_before")
    monkeypatch.setitem(sys.modules, "imported_before", before)
    for simulator in (one, other):
        simulator.prepare()
        assert answer(simulator, X).outcome.tolist() == [0, 1, 2]
    assert sys.modules["imported_before"] is before
    assert "limits" not in sys.modules or Path(sys.modules["limits"].__file__).parent == tmp_path / "other"


@pytest.mark.parametrize("changed", [{"damage": 0.25}, {"failure": 2.25}, {"extra": True}])
def test_a_module_that_a_function_imports_is_part_of_its_source(tmp_path: Path, changed: dict[str, float]) -> None:
    first = with_helpers(tmp_path)
    assert with_helpers(tmp_path) == first
    first.prepare()
    answer(first, X)
    second = with_helpers(tmp_path, **changed)
    assert second.source != first.source
    expected = {"damage": [1, 1, 2], "failure": [0, 2, 2], "extra": [1, 2]}[next(iter(changed))]
    assert answer(second, X[: len(expected)]).outcome.tolist() == expected
    with pytest.raises(
        InputError, match="different code from that at the start of the campaign, in the module of model:run"
    ):
        answer(replace(first, source="0" * 64), X)


def test_a_module_beside_that_is_changed_within_a_second_is_not_run_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    for damage, expected in ((1.0, [0, 1, 2]), (0.1, [1, 1, 2])):
        (tmp_path / "limits.py").write_text(f"DAMAGE = {damage!r}\n")
        os.utime(tmp_path / "limits.py", (1e9, 1e9))
        source = MODEL.replace("> 1.0", "> limits.DAMAGE")
        simulator = python(tmp_path, source=f"import limits\n{source}")
        now = replace(simulator, source=simulator.load())
        assert answer(now, X).outcome.tolist() == expected


PARALLEL = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import helper

def work(x):
    return x + 1.0

def run(design):
    context = multiprocessing.get_context({method!r})
    with context.Pool(2) as pool:
        assert pool.map(helper.work, [design["drift"]] * 2) == [design["drift"] + 1.0] * 2
    with ProcessPoolExecutor(2, context) as pool:
        assert list(pool.map(helper.work, [design["T"]])) == [design["T"] + 1.0]
        assert pool.submit(helper.inherits).result() == ({method!r} == "fork", False)
    process = context.Process(target=helper.work, args=(design["T"],))
    process.start()
    process.join()
    assert process.exitcode == 0
    if {method!r} == "fork":
        with context.Pool(1) as pool:
            assert pool.map(work, [1.0]) == [2.0]
    return "safe"
"""

HELPER = """
import os, sys

def work(x):
    return x + 1.0

def inherits():
    links = []
    for number in os.listdir("/proc/self/fd"):
        try:
            links.append(os.readlink(f"/proc/self/fd/{number}"))
        except OSError:
            pass
    return any(link.startswith("socket:") for link in links), hasattr(sys.modules["__main__"], "__file__")
"""


@pytest.mark.faults
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_a_function_may_use_multiprocessing_itself(tmp_path: Path, method: str) -> None:
    (tmp_path / "helper.py").write_text(HELPER)
    with ProcessExecutor(1, time_limit=120.0) as executor:
        results = executor.run(python(tmp_path, source=PARALLEL.format(method=method)), X[:2])
    assert (results.outcome.tolist(), results.faults) == ([0, 0], {})


PROCESSES = """
import os
def run(design):
    with open(__file__ + ".pids", "a") as file:
        file.write(f"{os.getpid()} ")
    return "safe"
"""


@pytest.mark.parametrize(("renew", "processes"), [("", 1), ("renew = 5\n", 4)], ids=["never", "five"])
def test_a_campaign_says_how_many_simulations_one_process_may_run(
    mine: Path, tmp_path: Path, renew: str, processes: int
) -> None:
    (mine / "model.py").write_text(PROCESSES)
    (mine / "mine.toml").write_text(TOML.replace('python = "model:run"\n', f'python = "model:run"\n{renew}'))
    # One outcome only: what is learned is not looked at.
    result = activefail("run", mine / "mine.toml", "--out", tmp_path / "run", "--budget", "16", "--workers", "1")
    assert result.code == 0, result.err
    pids = (mine / "model.py.pids").read_text().split()
    assert len(pids) == 17  # one design was simulated twice
    assert len(set(pids)) == processes
    assert renew in (tmp_path / "run" / "campaign.toml").read_text()
    assert ("renew" in (tmp_path / "run" / "campaign.toml").read_text()) == bool(renew)


# --- a program ---------------------------------------------------------------------------------------------------


def test_a_program_is_run_once_a_design_in_a_folder_of_its_own(tmp_path: Path) -> None:
    simulator = program(tmp_path, ANSWERS)
    results = answer(pickle.loads(pickle.dumps(simulator)), X)
    assert results.faults == {}
    assert results.outcome.tolist() == [0, 1, 1]
    assert results.margins[:, 0].tolist() == X[:, 0].tolist()  # every digit was told
    folders = list((tmp_path / "work").iterdir())
    assert len(folders) == 3
    folder_of = {json.loads((folder / "design.json").read_text())["drift"]: folder for folder in folders}
    assert sorted(folder_of) == sorted(X[:, 0].tolist())
    folder = folder_of[2.5]
    assert (folder / "stdout.txt").read_text() == "a b 2.00\n"
    assert json.loads((folder / "design.json").read_text()) == {"drift": 2.5, "T": 2.0, "storeys": 3.0}


def test_no_shell_reads_the_command(tmp_path: Path) -> None:
    simulator = program(
        tmp_path, ANSWERS, command=f"{sys.executable} {{here}}/model.py {{drift}} 1 $(touch-x)>x;ls {{out}}"
    )
    answer(simulator, X[:1])
    assert not list(tmp_path.rglob("x"))


def test_the_folders_of_what_was_answered_go_where_they_are_not_kept(tmp_path: Path) -> None:
    source = ANSWERS.replace("drift, T", "if float(sys.argv[1]) > 3: sys.exit(4)\ndrift, T")
    results = answer(program(tmp_path, source, keep=False), X)
    assert results.outcome.tolist() == [0, 1, -1]
    (left,) = (tmp_path / "work").iterdir()
    assert json.loads((left / "design.json").read_text())["drift"] == 3.7


FAILING = {
    "sys.stderr.write('a line\\n\\nno licence\\n\\n'); sys.exit(3)": (
        RAISED,
        "exit code 3; stderr.txt ends with 'no licence'",
    ),
    "os.kill(os.getpid(), 11)": (RAISED, r"exit code -11 \(SIGSEGV\); stderr.txt is empty"),
    "pass": (UNUSABLE_ANSWER, r"the program did not write answer.json; its path is \{out\}"),
    "open(sys.argv[-1], 'wb').write(bytes(range(256)))": (UNUSABLE_ANSWER, "answer.json is not JSON"),
    "json.dump({'outcome': 'collapse'}, open(sys.argv[-1], 'w'))": (UNUSABLE_ANSWER, "must be one of safe, failure"),
}


@pytest.mark.faults
@pytest.mark.parametrize("source", FAILING)
def test_a_program_that_fails_is_a_numerical_failure_that_says_why(tmp_path: Path, source: str) -> None:
    cause, says = FAILING[source]
    results = answer(program(tmp_path, source), X[:1])
    assert (results.outcome.tolist(), results.cause.tolist()) == ([-1], [cause])
    assert re.search(says, results.faults[0]), results.faults[0]
    assert results.faults[0].startswith(f"design drift = 0.333333, T = 1.5 in {tmp_path / 'work'}/")


@pytest.mark.faults
def test_a_program_that_cannot_be_started_is_a_numerical_failure_that_says_why(tmp_path: Path) -> None:
    results = answer(program(tmp_path, "", command="no_such_program {out}"), X[:1])
    assert results.cause.tolist() == [RAISED]
    assert "No such file or directory: 'no_such_program'" in results.faults[0]


@pytest.mark.faults
@pytest.mark.parametrize(("retries", "outcome"), [(1, -1), (2, 0)])
def test_a_program_that_fails_is_run_again_as_often_as_asked(tmp_path: Path, retries: int, outcome: int) -> None:
    source = f"""
with open({str(tmp_path / "tries")!r}, "a") as file:
    file.write(".")
if os.path.getsize({str(tmp_path / "tries")!r}) < 3:
    json.dump({{"outcome": "failure"}}, open(sys.argv[-1], "w"))  # must not be taken for the next one's answer
    sys.exit(1)
{ANSWERS}"""
    results = answer(program(tmp_path, source, retries=retries), X[:1])
    assert results.outcome.tolist() == [outcome]
    assert len((tmp_path / "tries").read_text()) == 1 + retries


@pytest.mark.faults
def test_a_program_that_fails_is_run_no_more_often_in_a_worker_for_it_has_a_process_of_its_own(tmp_path: Path) -> None:
    source = f"""
if float(sys.argv[1]) > 2:
    with open({str(tmp_path / "tries")!r}, "a") as file:
        file.write(".")
    sys.exit(1)
{ANSWERS}"""
    with ProcessExecutor(1) as executor:
        results = executor.run(program(tmp_path, source, retries=2), X)
    assert results.outcome.tolist() == [0, -1, -1]
    assert sorted(results.faults) == [1, 2]
    assert all("exit code 1" in fault for fault in results.faults.values())
    assert len((tmp_path / "tries").read_text()) == 2 * 3


@pytest.mark.faults
@pytest.mark.parametrize(
    ("write", "says"),
    [
        ("open(sys.argv[-1], 'wb').write(bytes(3_000_000))", "File too large"),
        (
            "signal.signal(signal.SIGXFSZ, signal.SIG_DFL); os.execvp('head', ['head', '-c3000000', '/dev/zero'])",
            "exceeded simulator.largest_file (1000000 bytes)",
        ),
    ],
)
def test_a_program_may_write_no_larger_files_than_it_is_allowed(tmp_path: Path, write: str, says: str) -> None:
    source = f"""
import signal
if float(sys.argv[1]) > 3:
    {write}
{ANSWERS}"""
    with ProcessExecutor(1) as executor:
        results = executor.run(program(tmp_path, source, largest_file=1_000_000), X)
    assert results.outcome.tolist() == [0, 1, -1]
    assert says in results.faults[2]
    assert max(path.stat().st_size for path in (tmp_path / "work").rglob("*")) == 1_000_000


@pytest.mark.faults
@pytest.mark.parametrize("session", [False, True])
def test_a_program_that_hangs_is_ended_with_all_that_it_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, session: bool
) -> None:
    if session and sys.platform != "linux":
        pytest.skip("a process in a session of its own is found on Linux alone")
    notes = tmp_path / "pids"
    # A minute passes whenever it has come to where it hangs.
    clock = Clock(lambda: 60.0 * len(notes.read_text().split()) / 2 if notes.exists() else 0.0)
    monkeypatch.setattr("activefail.execution.processes.time", clock)
    source = f"""
if float(sys.argv[1]) > 3:
    import subprocess
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session={session})
    with open({str(tmp_path / "pids")!r}, "a") as file:
        file.write(f"{{os.getpid()}} {{child.pid}} ")
    time.sleep(600)
{ANSWERS}"""
    with ProcessExecutor(1, time_limit=1.0) as executor:
        results = executor.run(program(tmp_path, source), X)
    assert results.outcome.tolist() == [0, 1, -1]
    assert results.cause[2] == TIME_LIMIT
    assert "it took longer than 1 s, twice" in results.faults[2]
    pids = notes.read_text().split()
    assert len(pids) == 4
    for pid in pids:
        until(lambda pid=pid: ended(pid))


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("  ", "must name a program"),
        ("model {drfit} {out}", "{drfit} is unknown; use one of {drift}, {T}, {storeys}, {out}, {here}"),
        ("model {drift.real} {out}", "{drift.real} is unknown; use one of"),
        ("model {drift:q} {out}", "Unknown format code 'q'"),
        ("model 'a {out}", "No closing quotation"),
    ],
)
def test_a_command_that_cannot_be_filled_in_is_refused(tmp_path: Path, command: str, says: str) -> None:
    with pytest.raises(InputError, match=f"simulator.command: .*({says.replace('{', '.')})"):
        program(tmp_path, "", command=command)


def test_a_variable_that_a_command_could_not_name_is_refused(tmp_path: Path) -> None:
    for name in ("out", "here", "OUT"):
        space = DesignSpace((Parameter(name, 0.0, 1.0),))
        with pytest.raises(InputError, match=rf"space.{name}: `\{{{name}\}}` is reserved in simulator.command"):
            CommandSimulator(space, "model {out}", tmp_path, tmp_path, ("safe", "failure"), ())


HOSTILE = "case 1 (final) $(touch ran) `touch ran` ; touch ran ; 'q' \"p\" & $HOME"

SCRIPTS = {
    "sh -c 'cat {here}/answer > {out}'": True,
    'sh -c \'cat "{here}/answer" > "{out}"\'': True,
    "bash -euo pipefail -c 'cat {here}/answer > {out}'": True,
    "env A=1 bash -ec 'cd / && cat {here}/answer > {out}'": True,
    "sh -c \"cat '{here}/answer' > '{out}'\"": True,
    "sh -c 'x=$(cat {here}/answer) && printf %s \"$x\" > {out}'": True,
    'sh -c \'cat "$AF_HERE"/answer > "$AF_OUT"\'': True,
    "sh -c 'cp $AF_HERE/answer $AF_OUT'": False,  # unquoted, so it is split at blanks
    "cp {here}/answer {out}": True,
    "sh {here}/copy.sh": True,
    "sh {here}/first.sh -c {here}/answer": True,
    "timeout 9 env -u c cp {here}/answer {out}": True,
    "{here}/solve -c {here}/answer": True,
    "flock {here}/answer -c 'cat {here}/answer > {out}'": True,
    "sh -c '# don\\x27t\ncat {here}/answer > {out}'": True,
    "sh -c \"sh -c 'cat {here}/answer' > {out}\"": False,  # another shell splits the path at blanks
    'sh -c "sh -c \'cat \\"$AF_HERE/answer\\"\' > {out}"': True,
}


@pytest.mark.parametrize("name", ["plain", "case 1 (final)", HOSTILE], ids=["plain", "blanks", "hostile"])
@pytest.mark.parametrize("script", SCRIPTS)
def test_no_path_runs_as_code_and_scripts_work_in_any_folder(tmp_path: Path, script: str, name: str) -> None:
    here, works = tmp_path / name, SCRIPTS[script]
    here.mkdir()
    (here / "answer").write_text('{"outcome": "safe"}')
    (here / "first.sh").write_text('cat "$2" > "$AF_OUT"')
    (here / "solve").write_text('#!/bin/sh\ncat "$2" > "$AF_OUT"')
    (here / "solve").chmod(0o755)
    (here / "copy.sh").write_text('cat "$AF_HERE/answer" > "$AF_OUT"; test "$AF_drift $AF_storeys" = "2.5 3.0"')
    script = script.replace("\\x27", "'\"'\"'")  # an apostrophe in the script
    simulator = CommandSimulator(SPACE, script, here, here / "work", ("safe", "failure"), ())
    is_safe = False
    with suppress(InputError):  # a path that another program may read as code
        is_safe = bool(answer(simulator, X[1:2]).outcome[0] == 0)
    assert is_safe is (works or name == "plain")
    assert not list(tmp_path.rglob("ran"))


def test_a_line_of_a_file_in_a_script_stays_though_it_begins_like_a_comment(tmp_path: Path) -> None:
    here = tmp_path / "it's mine"
    here.mkdir()
    script = "cat > model <<END\n#define DRIFT {drift}\n# read from {here}; don't\nEND\n# {out}\ncat model"
    simulator = made(here, templates=(), command=f"sh -c {shlex.quote(script)}", pattern=r"DRIFT (\S+)")
    results = answer(simulator, X[:1])
    assert results.margins.tolist() == [[X[0, 0]]], results.faults
    assert f"\n# read from {here}; don" in (simulator.folder_of(X[0]) / "model").read_text()


def test_a_path_that_other_code_than_a_shell_s_might_run_is_refused(tmp_path: Path) -> None:
    for name, code in (("case 1 (final)", 0), ("it's", RAISED)):
        here = tmp_path / name
        here.mkdir()
        command = f"{sys.executable} -c \"open('{{out}}', 'w').write('{{{{\\\"outcome\\\": \\\"safe\\\"}}}}')\""
        with suppress(InputError):
            results = answer(CommandSimulator(SPACE, command, here, here / "work", ("safe", "failure"), ()), X[:1])
            assert (code, results.outcome[0]) == (0, 0), results.faults
            continue
        assert code


def made(folder: Path, **other: object) -> CommandSimulator:
    """A program that prints its inputs."""
    options = {"command": "cat model.tcl", "here": folder, "work": folder / "work", "outcomes": ("safe", "failure")}
    options |= {"margins": ("g",), "levels": (0.0,), "pattern": r"g = (\S+)", "templates": ("parts/model.tcl.in",)}
    return CommandSimulator(SPACE, **(options | other))


TEMPLATES = {
    "g = {drift}": [1.0 / 3.0, 2.5, 3.7],
    "g = {drift:.2f}": [0.33, 2.5, 3.7],
    "if {$x} { puts {a b} } {} {{}} {other}\ng = -{T}": [-1.5, -2.0, -2.9],
    "g = 7\ng = {storeys:.1e}\n": [3.0, 3.0, 3.0],
    "g = {T}D+01": [15.0, 20.0, 29.0],
    "g = {drift:.2f} ;# ${drift} ${T}": [0.33, 2.5, 3.7],
    "proc drift {{T}} {{{drfit}}}\ng = {storeys}": [3.0, 3.0, 3.0],
}


@pytest.mark.parametrize("template", TEMPLATES)
def test_an_input_file_is_filled_in_and_a_number_is_read_from_the_output(tmp_path: Path, template: str) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "model.tcl.in").write_bytes(template.encode() + b"\n\xff")
    results = answer(made(tmp_path), X)
    assert results.faults == {}
    assert results.margins[:, 0].tolist() == TEMPLATES[template]
    assert results.outcome.tolist() == [int(margin <= 0.0) for margin in TEMPLATES[template]]
    assert all(file.read_bytes().endswith(b"\xff") for file in (tmp_path / "work").rglob("model.tcl"))


@pytest.mark.parametrize(
    ("template", "says"),
    [
        ("g = {drfit}", r"model.tcl.in: \{drfit\} is unknown; did you mean \{drift\}\? Double .*: \{\{drfit\}\}"),
        ("g = 1", r"parts/model.tcl.in: must ask for a quantity, like \{drift\}"),
        ("g = {drift:q}", "Unknown format code 'q'"),
        ("g = {drift:9999}", "must have a width and a precision of at most 100"),
        (None, "parts/model.tcl.in: cannot be read: No such file or directory"),
    ],
)
def test_a_template_that_cannot_be_filled_in_is_refused(tmp_path: Path, template: str | None, says: str) -> None:
    (tmp_path / "parts").mkdir()
    if template is not None:
        (tmp_path / "parts" / "model.tcl.in").write_text(template)
    with pytest.raises(InputError, match=f"simulator.template: .*{says}"):
        made(tmp_path)


def test_files_and_folders_are_copied_and_a_file_of_the_run_is_read(tmp_path: Path) -> None:
    (tmp_path / "mesh" / "part").mkdir(parents=True)
    (tmp_path / "mesh" / "part" / "a").write_text("g = 4\n")
    (tmp_path / "lone").write_text("g = 5\n")
    options = {"templates": (), "command": "cp mesh/part/a result", "output": "result", "copies": ("mesh", "lone")}
    results = answer(made(tmp_path, **options), X[:1])
    assert results.margins.tolist() == [[4.0]], results.faults
    for copies, says in ((("gone",), "gone does not exist"), (("lone", "mesh/../lone"), "only one 'lone'")):
        with pytest.raises(InputError, match=f"simulator.*copy: .*{says}"):
            made(tmp_path, **(options | {"copies": copies}))


def test_a_program_s_files_are_in_the_digest_of_its_code(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    for name in ("parts/model.tcl.in", "start.py", "part.py", "note", "binary"):
        (tmp_path / name).write_text("import part\nx = 1 # {drift}" if name == "start.py" else "g = 1 # {drift}")
    command = "sh -c 'python3 {here}/start.py && ${{AF_HERE}}/binary'"
    before = made(tmp_path, copies=("parts",), command=command).digest()
    for name, decides in {"note": False, "start.py": True, "part.py": True, "binary": True, "parts/b": True}.items():
        kept = (tmp_path / name).read_text() if (tmp_path / name).exists() else None
        (tmp_path / name).write_text("import part\nx = 2" if name == "start.py" else "g = 2")
        assert (made(tmp_path, copies=("parts",), command=command).digest() != before) is decides, name
        (tmp_path / name).unlink() if kept is None else (tmp_path / name).write_text(kept)


NAMED = {
    "sh -c 'cd {here} && ./solve > {here}/log'": "solve",
    "sh -c 'cd {here};./solve<{here}/my\\ mesh.msh'": "my mesh.msh",
    'python3 "{here}/my model.py" {out}': "my model.py",
    "sh -c 'python3 \"{here}/my model.py\"'": "my model.py",
    "env PYTHONPATH=$AF_HERE python3 -m model": "model.py",
    "python3 -m parts.model {out}": "parts/model.py",
    "python3 -m parts": "parts/__main__.py",
    "python3 -c 'import model as m; m.run()'": "model.py",
    "solver --input={here}/mesh.msh": "mesh.msh",
    "sh -c '# don\"\"t\ncat ${{AF_HERE}}/mesh.msh'": "mesh.msh",
    "solver {here}/data/": "data/mesh.msh",
    "sh -c 'cd ../ && {here}/solve {here}/./ /'": "solve",
}


@pytest.mark.parametrize("command", NAMED)
def test_what_a_command_names_in_any_way_is_in_the_digest_of_its_code(tmp_path: Path, command: str) -> None:
    for folder in ("parts", "data"):
        (tmp_path / folder).mkdir()
    for file in {*NAMED.values(), "parts/__init__.py", "log"}:
        (tmp_path / file).write_text("limit = 1\n")
    before = made(tmp_path, templates=(), command=command).digest()
    (tmp_path / "log").write_text("more\n")
    assert made(tmp_path, templates=(), command=command).digest() == before
    (tmp_path / NAMED[command]).write_text("limit = 2\n")
    assert made(tmp_path, templates=(), command=command).digest() != before


@pytest.mark.parametrize(
    "script", ["python3 part.py", "source $here/lib/a.tcl", "*INCLUDE, INPUT=mesh.inp", "./two.sh"]
)
def test_what_a_script_names_is_in_the_digest(tmp_path: Path, script: str) -> None:
    (tmp_path / "lib").mkdir()
    for name, text in {"part.py": "import other", "lib/a.tcl": "", "mesh.inp": "", "two.sh": "cat mesh.inp"}.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "run.sh").write_text(f"{script} > $AF_HERE/log\n")

    def digest() -> str:
        return made(tmp_path, templates=(), command="sh {here}/run.sh").digest()

    before = digest()
    (tmp_path / "log").write_text("more\n")
    (tmp_path / "plot.py").touch()
    assert digest() == before
    for name in ("other.py", "lib/a.tcl", "mesh.inp"):
        (tmp_path / name).write_text("limit = 2\n")
    assert digest() != before


@pytest.mark.parametrize(
    ("printed", "pattern"),
    [
        ("g = 0.123-105", r"g = ([\d.]+)"),
        ("g = -0.5", r"g = .*?([\d.]+)"),
        ("g = 1.5E-05", r"g = .*-([\d.]+)"),
        ("g = -7.142857e-02", r"g = ([-\d.]+)"),
        ("g = -7.142857e-02", r"([-\d.]+)"),
        ("g = 0,5", r"g = ([-\d.]+)"),
        ("g = 1.#INF", r"g = ([-\d.]+)"),
        ("g = - 0.5", r"g = .*?([\d.]+)"),
        ("g = 0.5-", r"g = ([\d.]+)"),
        ("g = 1.5*10^-3", r"g = ([\d.]+)"),
        ("g = 1.5 x 10^-3", r"g = (\S+)"),
        ("g = 1.5·10**-3", r"g = ([\d.]+)"),
    ],
)
def test_a_pattern_that_matches_a_part_of_a_number_gives_no_answer(tmp_path: Path, printed: str, pattern: str) -> None:
    results = answer(made(tmp_path, templates=(), command=f"echo '{printed}'", pattern=pattern), X[:1])
    assert "simulator.pattern: must match whole numbers" in results.faults[0]


def test_a_line_may_end_as_on_windows_and_a_dash_may_be_no_sign(tmp_path: Path) -> None:
    for printed, pattern in (("g = 4\\r", "^g = (\\d)$"), ("g - 4 mm", "g - (\\S+)"), ("4 - 5", "([\\d.]+) - 5")):
        results = answer(made(tmp_path, templates=(), command=f"printf '{printed}\\n'", pattern=pattern), X[:1])
        assert results.margins.tolist() == [[4.0]], results.faults


def test_a_number_of_fortran_needs_no_e(tmp_path: Path) -> None:
    results = answer(made(tmp_path, templates=(), command="echo 'g = -0.123-105'"), X[:1])
    assert results.margins.tolist() == [[-0.123e-105]], results.faults


def test_what_was_copied_is_no_answer_and_no_output_lies_outside(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "drift.out").write_text("g = 4\n")
    options = {"templates": (), "command": "true", "output": "results/drift.out", "copies": ("results",)}
    assert "did not write drift.out" in answer(made(tmp_path, **options), X[:1]).faults[0]
    for changed, says in (
        ({"output": str(tmp_path / "shared.out")}, "must be a file in the folder of the run"),
        ({"output": "../shared.out"}, "must be a file in the folder of the run"),
        ({"work": tmp_path / "results" / "run"}, "results must not hold the run folder"),
        ({"command": "model {drift} > {out}"}, "runs without a shell, to which > means something; write sh -c"),
        ({"command": "cd {here} && ./model"}, "runs without a shell, to which && means"),
        ({"command": "sh -c 'x=1; echo ${x}'"}, r"write \$\{\{x\}\} for the shell's own variable, or \$AF_x"),
    ):
        with pytest.raises(InputError, match=says):
            made(tmp_path, **(options | changed))


@pytest.mark.parametrize(
    ("printed", "says"),
    [
        ("h = 1", r"stdout.txt has no match of simulator.pattern, 'g = "),
        ("g = much", "must match a number, got 'much'"),
    ],
)
def test_an_output_without_the_number_is_a_numerical_failure(tmp_path: Path, printed: str, says: str) -> None:
    results = answer(made(tmp_path, templates=(), command=f"echo {printed}"), X[:1])
    assert results.cause.tolist() == [UNUSABLE_ANSWER]
    assert re.search(says, results.faults[0]), results.faults[0]


def test_a_program_gets_its_cores_and_fewer_run_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = made(tmp_path, templates=(), command="sh -c 'echo g = $OMP_NUM_THREADS'", cores=3)
    assert answer(simulator, X[:1]).margins.tolist() == [[3.0]]
    for cpus, workers in ((8, 2), (2, 1)):
        monkeypatch.setattr("os.cpu_count", lambda cpus=cpus: cpus)
        with local_executor(simulator) as executor:
            assert executor.workers == workers


# --- campaigns ---------------------------------------------------------------------------------------------------

TOML = """
seed = 5
sampling = { initial = 16, budget = 24, batch = 4 }
acquisition.boundary = "damage"
[simulator]
python = "model:run"
outcomes = ["safe", "damage", "failure"]
margins = ["gap"]
[space]
drift = { low = 0.0, high = 4.0, unit = "m" }
T = { low = 1.0, high = 3.0, distribution = "log_uniform" }
storeys = { value = 3.0 }
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder with a campaign file and the function that it names."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "model.py").write_text(MODEL)
    (tmp_path / "mine" / "mine.toml").write_text(TOML)
    return tmp_path / "mine"


@pytest.mark.usefixtures("without_pictures")
def test_a_campaign_on_a_function_is_run_resumed_and_read_from_its_folder_alone(
    mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    result = activefail("run", mine / "mine.toml", "--out", run, "--budget", "20")
    assert (result.code, result.err) == (0, "")
    assert "simulator  model:run, 2 variables" in activefail("status", run).out
    # Commands that need no custom code work without it.
    assert activefail("export", run, "--csv", tmp_path / "all.csv").code == 0
    rows = table(tmp_path / "all.csv")
    assert list(rows[0])[3:] == ["drift", "T", "outcome", "cause", "gap", "seconds"]
    for row in rows:
        drift = float(row["drift"])
        assert row["outcome"] == ("safe", "damage", "failure")[(drift > 1.0) + (drift > 3.0)]
        assert float(row["gap"]) == 3.0 - drift
    # Another user has not run this code.
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another user's"))
    repeated = activefail("resume", run, "--budget", "24")
    assert repeated.code == 2
    assert "simulator.python: model:run is custom code" in repeated.err
    assert "name its folder with --code, or code=FOLDER in Python." in repeated.err
    assert "Traceback" not in repeated.err
    result = activefail("resume", run, "--budget", "24", "--code", mine)
    assert result.code == 0, result.err
    whole = activefail("run", mine / "mine.toml", "--out", tmp_path / "whole", "--workers", "1")
    assert whole.code == 0
    assert record(run) == record(tmp_path / "whole")
    report = activefail("report", run)
    assert report.code == 0, report.err
    # The page names no folder of someone else's code.
    page = (run / "report.html").read_text()
    assert page.count("If this user has not run the custom code for this folder before, add --code") == 2
    assert f"activefail report {run}\n" in page


def test_status_needs_no_code_before_anything_is_recorded_either(mine: Path, tmp_path: Path) -> None:
    (mine / "mine.toml").write_text(f'classifier.features = {{ python = "model:physics" }}{TOML}')
    (mine / "model.py").write_text(f"{MODEL}\ndef physics(X, space):\n    return X[:, :1] ** 2\n")
    with create_folder(tmp_path / "run", read_campaign(mine / "mine.toml", code=mine)):
        result = activefail("status", tmp_path / "run")
    assert result.code == 0, result.err
    assert "0 of 24 simulations" in result.out
    last = "continue   with `activefail resume`; name the folder of the custom code with --code"
    assert result.out.splitlines()[-1] == last


OPENING = {
    "predict": ("--csv", "in.csv", "--out", "out.csv"),
    "report": (),
    "resume": ("--budget", "20", "--workers", "1"),
    "compare": ("--test", "10"),
}


@pytest.fixture
def received(mine: Path, tmp_path: Path) -> Path:
    """A run folder with code in it that reports when it is run; the campaign's own code was removed."""
    run = tmp_path / "runs" / "received"
    run.parent.mkdir()
    physics = "def physics(X, space):\n    return X[:, :1] ** 2\n"
    (mine / "mine.toml").write_text(f'classifier.features = {{ python = "model:physics" }}{TOML}')
    (mine / "model.py").write_text(MODEL + physics)
    create_folder(run, read_campaign(mine / "mine.toml", code=mine)).close()
    (run / "model.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\n{MODEL}{physics}")
    (run / "in.csv").write_text("drift,T\n1.0,2.0\n")
    shutil.rmtree(mine)
    (tmp_path / "other").mkdir()
    return run


def names(run: Path, module: str) -> None:
    """Have a run folder's settings name a function of another module, for the simulator and for the features."""
    text = (run / "campaign.toml").read_text().replace('"model:', f'"{module}:')
    (run / "campaign.toml").write_text(text)


@pytest.mark.parametrize("named", [None, "other"])
@pytest.mark.parametrize("python_looks", [False, True])
@pytest.mark.parametrize(
    ("here", "module"),
    [
        ("runs/received", "model"),
        ("runs", "model"),
        ("runs", "received.model"),
        (".", "runs.received.model"),
        (".", "model"),
    ],
)
def test_a_function_in_a_run_folder_is_not_run_whatever_the_current_folder(
    received: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    named: str | None,
    python_looks: bool,
    here: str,
    module: str,
) -> None:
    names(received, module)
    monkeypatch.chdir(tmp_path / here)
    if python_looks:
        # As `python -m` does, and an empty entry of PYTHONPATH.
        monkeypatch.setattr(sys, "path", ["", *sys.path])
    for command, words in OPENING.items():
        code = () if named is None else ("--code", tmp_path / named)
        result = activefail(command, received, *words, *code)
        assert not (tmp_path / "ran").exists()
        refused(result, "classifier.features.python" if named is None else "simulator.python", module)
    activefail("status", received)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(("named", "module"), [(".", "runs.received.model"), ("runs", "received.model")])
def test_a_function_in_a_run_folder_is_not_run_where_a_folder_around_it_is_named(
    received: Path, tmp_path: Path, named: str, module: str
) -> None:
    names(received, module)
    result = activefail("resume", received, "--budget", "20", "--code", tmp_path / named)
    refused(result, f"simulator.python: {module} is {received / 'model.py'}. It lies in the run folder", "with --code")
    assert not (tmp_path / "ran").exists()


def test_a_function_in_a_run_folder_is_run_where_that_very_folder_is_named(received: Path, tmp_path: Path) -> None:
    result = activefail("resume", received, "--budget", "20", "--code", received)
    assert result.code == 0, result.err
    assert (tmp_path / "ran").exists()


STRANGE = ("multiprocessing", "threading", "numpy", "activefail")
"""Modules that a process would take from the current folder if it looked there first."""


def as_installed(here: Path, ran: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """The program in a folder with modules with the names of Python's own, which report when they are run."""
    for name in STRANGE:
        (here / f"{name}.py").write_text(f"open({str(ran)!r}, 'w').close()\n")
    # As the installed command does, which does not look in the current folder itself.
    start = ran.with_name("start.py")
    start.write_text("from activefail.cli import main\n\nif __name__ == '__main__':\n    main()\n")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(Path(__file__).parents[3]), environment.get("PYTHONPATH")])
    )
    done = subprocess.run(
        [sys.executable, start, *words], cwd=here, env=environment, capture_output=True, text=True, check=False
    )
    for name in STRANGE:
        (here / f"{name}.py").unlink()
    return done


UNCHANGED = "def run(design):\n    import os\n    assert 'PYTHONSAFEPATH' not in os.environ"
"""Of a function: what it starts looks for modules as ever."""


@pytest.mark.exhaustive
def test_worker_processes_take_none_of_python_s_own_modules_from_the_current_folder(mine: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert activefail("run", mine / "mine.toml", "--out", run, "--budget", "16").code == 0
    (mine / "model.py").write_text(MODEL.replace("def run(design):", UNCHANGED))
    words = ("resume", ".", "--budget", "20", "--workers", "1", "--code", mine)
    done = as_installed(run, tmp_path / "ran", *words)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists()
    assert "numerical_failure" not in {row["outcome"] for row in record(run)}


def test_a_function_that_was_changed_is_told_on_resume(mine: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert activefail("run", mine / "mine.toml", "--out", run, "--budget", "16").code == 0
    before = digest_without_running("model:run", mine)
    (mine / "model.py").write_text(MODEL + "other = 1\n")
    result = activefail("resume", run, "--budget", "20", "--code", mine)
    assert result.code == 0
    digests = [digest[:8] for digest in (before, digest_without_running("model:run", mine))]
    assert result.err == (
        "warning: Your code has changed since the last batch: model:run (simulator.python) or a file "
        f"that it uses, {digests[0]} -> {digests[1]}. New simulations use the current code.\n"
    )


@pytest.mark.faults
def test_sets_that_an_earlier_version_of_the_code_simulated_are_simulated_again(mine: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    (mine / "mine.toml").write_text(f"validation.size = 20\n{TOML}")
    assert activefail("run", mine / "mine.toml", "--out", run).code == 0
    compare = ["compare", run, "--code", mine, "--test", "30", "--budgets", "12,24"]
    verify = ["verify", run, "--code", mine, "--simulations", "20"]
    for words in (compare, verify):
        said = activefail(*words)
        assert said.code == 0, said
        assert "warning" not in said.err
    before = sets(run)
    assert {name.split("-")[0] for name in before} >= {"validation", "test", "static", "verification"}
    # No design is beyond this limit, so that none is a failure.
    former = digest_without_running("model:run", mine)
    (mine / "model.py").write_text(MODEL.replace('design["drift"] > 1.0', 'design["drift"] > 9.0'))
    digests = [digest[:8] for digest in (former, digest_without_running("model:run", mine))]
    changed = f"was simulated with different code (simulator.python {digests[0]} -> {digests[1]}); it is not used."
    # Without the code, the program cannot know that it has changed; with it, a reader does not use the sets.
    unverified = "a verification of the classifier;"
    assert unverified not in activefail("report", run, "--out", tmp_path / "1.html").out
    assert unverified in activefail("report", run, "--code", mine, "--out", tmp_path / "2.html").out
    assert sets(run) == before
    for words, names in (
        (["resume", run, "--code", mine, "--budget", "28"], ["validation-0"]),
        (compare, [name for name in before if name.startswith(("test", "static"))]),
        (verify, []),
    ):
        said = activefail(*words)
        assert said.code == 0, said.err
        if words[0] == "resume":
            assert f"The set validation-0 {changed} Its designs are simulated again" in said.err, said.err
        after = sets(run)
        assert all(before[name] != after[name] and 2 not in after[name] for name in names)


@pytest.mark.faults
def test_a_verification_by_an_earlier_version_of_the_code_is_simulated_again(mine: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert activefail("run", mine / "mine.toml", "--out", run).code == 0
    verify = ["verify", run, "--code", mine, "--simulations", "20"]
    assert activefail(*verify).code == 0
    before = sets(run)
    (mine / "model.py").write_text(MODEL.replace('design["drift"] > 1.0', 'design["drift"] > 9.0'))
    said = activefail(*verify)
    assert said.code == 0, said.err
    (name,) = before
    assert f"The set {name} was simulated with different code (simulator.python " in said.err
    assert sets(run) != before
    assert activefail(*verify).err.count("other code") == 0


def test_a_campaign_s_function_has_modules_beside_it_and_their_change_is_told_on_resume(
    mine: Path, tmp_path: Path
) -> None:
    with_helpers(mine)
    file, run = mine / "mine.toml", tmp_path / "run"
    file.write_text(f'classifier.features = {{ python = "seen:by" }}{TOML}')
    (mine / "seen.py").write_text("import limits\n\ndef by(X, space):\n    return X[:, :1] > limits.DAMAGE\n")
    result = activefail("run", file, "--out", run, "--budget", "16")
    assert result.code == 0, result.err
    assert " 0 numerical failures" in result.out
    result = activefail("resume", run, "--budget", "20", "--code", mine)
    assert (result.code, result.err) == (0, "")
    with_helpers(mine, damage=1.125)
    result = activefail("resume", run, "--budget", "24", "--code", mine)
    assert result.code == 0, result.err
    assert "model:run (simulator.python)" in result.err
    assert "seen:by (classifier.features.python)" in result.err
    assert "machine" not in result.err


MISTAKES = {
    'python = "model:run"': ('python = "modle:run"', "simulator.python: there is no module 'modle'"),
    "model:run": ("model:ruin", "model.py has no function 'ruin'"),
    'margins = ["gap"]': ('margins = ["T"]', "simulator.margins: 'T' is already the name of the quantity space.T"),
    "T = {": ("seconds = {", "space.seconds: 'seconds' is already the name of a column of tables"),
    'boundary = "damage"': ('boundary = "collapse"', "acquisition.boundary: must be one of damage, failure"),
    'drift = { low = 0.0, high = 4.0, unit = "m" }\nT = { low = 1.0, high = 3.0, distribution = "log_uniform" }': (
        "T = { value = 3.0 }",
        "needs at least one variable that is not fixed",
    ),
}


@pytest.mark.parametrize("right", MISTAKES)
def test_a_mistake_in_a_campaign_of_one_s_own_is_named_before_anything_is_made(
    mine: Path, tmp_path: Path, right: str
) -> None:
    wrong, says = MISTAKES[right]
    assert right in TOML
    (mine / "mine.toml").write_text(TOML.replace(right, wrong))
    refused(activefail("run", mine / "mine.toml", "--out", tmp_path / "run"), "mine.toml: ", says)
    assert not (tmp_path / "run").exists()


def test_a_function_that_does_not_take_one_design_is_refused_before_anything_is_made(
    mine: Path, tmp_path: Path
) -> None:
    (mine / "model.py").write_text("def run(T, drift):\n    return 'safe'\n")
    result = activefail("run", mine / "mine.toml", "--out", tmp_path / "run")
    refused(result, "mine.toml: simulator.python: model:run must take one argument", "got the arguments (T, drift).")
    assert not (tmp_path / "run").exists()


@pytest.mark.faults
def test_a_module_that_ends_the_process_is_told_and_does_not(mine: Path, tmp_path: Path) -> None:
    (mine / "model.py").write_text(f"import sys\n{MODEL}\nsys.exit(0)\n")
    result = activefail("run", mine / "mine.toml", "--out", tmp_path / "run")
    refused(result, "simulator.python: model cannot be imported: SystemExit: 0")
    assert not (tmp_path / "run").exists()


@pytest.mark.faults
def test_a_function_that_always_raises_stops_the_campaign_with_what_it_raised(mine: Path, tmp_path: Path) -> None:
    (mine / "model.py").write_text("def run(design):\n    return design['drifd']\n")
    (mine / "mine.toml").write_text(TOML.replace("initial = 16", "initial = 22"))
    result = activefail("run", mine / "mine.toml", "--out", tmp_path / "run")
    assert result.code == 1
    assert f"Fix the simulator, then `activefail resume {tmp_path / 'run'} --code {mine}` continues." in result.err
    assert "--numerical-failures" not in result.err
    assert "KeyError: 'drifd'" in result.err
    assert "model.py:2" in result.err


@pytest.mark.faults
@pytest.mark.parametrize("error", ["ValueError('diverged')", "__import__('activefail').InputError('diverged')"])
def test_what_a_simulation_raised_costs_it_alone_and_is_told_of_a_campaign_that_went_on(
    mine: Path, tmp_path: Path, error: str
) -> None:
    source = MODEL.replace("    severity", f"    if design['drift'] > 3.8:\n        raise {error}\n    severity")
    (mine / "model.py").write_text(source)
    (mine / "mine.toml").write_text(f"limits.numerical_failures = 1.0\n{TOML}")
    result = activefail("run", mine / "mine.toml", "--out", tmp_path / "run")
    assert result.code == 0
    rows = record(tmp_path / "run")
    assert all(row["cause"] == ("raised" if float(row["drift"]) > 3.8 else "") for row in rows)
    assert "raised" in {row["cause"] for row in rows}
    assert "warning: simulations failed and gave no result; the first one: design" in result.err
    assert "Error: diverged" in result.err


@pytest.mark.faults
def test_a_campaign_without_any_answer_is_told_kept_and_goes_on_when_its_function_is_mended(
    mine: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run, designs = tmp_path / "run", tmp_path / "in.csv"
    (mine / "model.py").write_text("def run(design):\n    return design['drifd']\n")
    result = activefail("run", mine / "mine.toml", "--out", run, "--budget", "40")
    assert result.code == 1
    assert "None of the 16 simulations gave an outcome" in result.err
    assert f"`activefail resume {run} --code {mine}` continues" in result.err
    assert "The first failed with cause `raised`." in result.err
    assert {row["cause"] for row in record(run)} == {"raised"}
    designs.write_text("drift,T\n1.0,2.0\n")
    predict = ("predict", run, "--csv", designs, "--out", tmp_path / "out.csv")
    refused(activefail(*predict), "None of the simulations gave an outcome, so there is nothing to learn from.")
    refused(activefail("verify", run, "--code", mine), "has not finished its initial design")
    # What LAPACK prints goes past Python's streams.
    assert capfd.readouterr() == ("", "")

    (mine / "model.py").write_text(MODEL)
    assert activefail("resume", run, "--code", mine, "--budget", "20").code == 0
    refused(activefail("verify", run, "--code", mine), "has not finished its initial design")
    result = activefail("resume", run, "--code", mine, "--budget", "40")
    assert result.code == 0, result.err
    assert [row["origin"] for row in record(run)] == ["seed"] * 32 + ["active"] * 8
    for command in (predict, ("compare", run, "--code", mine, "--test", "40"), ("report", run)):
        result = activefail(*command)
        assert result.code == 0, result.err
    assert {row["simulations"] for row in table(run / "compare" / "scores.csv")} == {"32", "34", "35", "37", "38", "40"}


def campaign_on_a_program(folder: Path, source: str) -> Path:
    """The file of a campaign of twelve simulations on a program that `program` writes."""
    program(folder, source)
    (folder / "mine.toml").write_text(
        TOML.replace(
            'python = "model:run"\noutcomes = ["safe", "damage", "failure"]',
            f'command = "{sys.executable} {{here}}/model.py {{drift}} {{T}} a {{out}}"\noutcomes = ["safe", "damage"]',
        )
        .replace("damage", "failure")
        .replace("initial = 16, budget = 24", "initial = 8, budget = 12")
    )
    return folder / "mine.toml"


def test_the_folder_of_a_program_may_be_named_relative_to_the_current_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").mkdir()
    campaign_on_a_program(tmp_path / "mine", ANSWERS)
    monkeypatch.chdir(tmp_path)
    assert activefail("run", "mine/mine.toml", "--out", "run", "--budget", "8").code == 0
    result = activefail("resume", "run", "--budget", "12", "--code", "mine")
    assert result.code == 0, result.err
    assert len(record(tmp_path / "run")) == 12
    assert "numerical_failure" not in {row["outcome"] for row in record(tmp_path / "run")}


def test_verifications_of_a_simulator_that_never_answers_are_told_and_not_kept(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert activefail("run", campaign_on_a_program(tmp_path, ANSWERS), "--out", run).code == 0
    verify = ("verify", run, "--simulations", "10", "--code", tmp_path)
    program(tmp_path, "sys.exit('no licence')")
    result = activefail(*verify)
    assert (result.code, result.out) == (1, "")
    assert "activefail: None of the 10 simulations for verification" in result.err
    assert "no licence" in result.err
    program(tmp_path, ANSWERS)
    result = activefail(*verify)
    assert result.code == 0, result.err
    assert "10 fresh simulations" in result.out


@pytest.mark.faults
def test_programs_end_with_the_campaign_that_is_killed(tmp_path: Path) -> None:
    pids = tmp_path / "pids"
    source = f"""
import subprocess
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
with open({str(pids)!r}, "w") as file:
    file.write(f"{{os.getpid()}} {{child.pid}} ")
time.sleep(600)
"""
    with started(
        "run", campaign_on_a_program(tmp_path, source), "--out", tmp_path / "run", "--workers", "1"
    ) as process:
        until(lambda: pids.exists() and len(pids.read_text().split()) == 2)
        process.kill()
        process.communicate(timeout=PATIENCE)
    for pid in pids.read_text().split():
        until(lambda pid=pid: ended(pid))


@pytest.mark.faults
def test_a_ctrl_c_on_the_terminal_while_worker_processes_start_costs_nothing(mine: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    # Until the signal has come no simulation ends, and the campaign neither.
    waits = "def run(design):\n    import time\n    while not pathlib.Path(__file__).with_name('open').exists():\n"
    (mine / "model.py").write_text(MODEL.replace("def run(design):\n", f"{waits}        time.sleep(0.02)\n"))
    with started("run", mine / "mine.toml", "--out", run, "--workers", "2") as process:
        until(lambda: any("supervisor" in command for command in started_by(process.pid)))
        os.killpg(process.pid, signal.SIGINT)
        wait_for(process.stderr, "stopping after this batch")
        (mine / "open").touch()
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 130, err
    assert "Traceback" not in err
    assert f"Continue with: activefail resume {run}\n" in err
    assert "numerical_failure" not in {row["outcome"] for row in record(run)}


def test_a_campaign_on_a_program_ends_it_on_the_second_ctrl_c_and_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = tmp_path / "slow"
    slow.touch()
    source = f"""
if os.path.exists({str(slow)!r}):
    with open({str(tmp_path / "pids")!r}, "a") as file:
        file.write(f"{{os.getpid()}} ")
    time.sleep(600)
{ANSWERS}"""
    file = campaign_on_a_program(tmp_path, source)
    run = tmp_path / "run"
    with started("run", file, "--out", run, "--workers", "2") as process:
        until(lambda: (tmp_path / "pids").exists() and len((tmp_path / "pids").read_text().split()) == 2)
        process.send_signal(signal.SIGINT)
        wait_for(process.stderr, "stopping after this batch")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 130
    assert f"Continue with: activefail resume {run}\n" in err
    for pid in (tmp_path / "pids").read_text().split():
        until(lambda pid=pid: ended(pid))
    slow.unlink()
    with monkeypatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path / "another user's"))
        stopped = activefail("resume", run)
    assert stopped.code == 2
    assert "simulator.command" in stopped.err
    result = activefail("resume", run, "--code", tmp_path)
    assert result.code == 0, result.err
    # The second run of one design has a folder of its own.
    assert len(list((run / "simulations").iterdir())) == 13


@pytest.mark.faults
def test_a_module_that_changes_the_current_folder_does_not_move_the_run_folder(
    mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (mine / "model.py").write_text(f"import os\nos.chdir(os.path.dirname(os.path.abspath(__file__)))\n{MODEL}")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert activefail("run", mine / "mine.toml", "--out", "run").code == 0
    assert (tmp_path / "here" / "run" / "campaign.toml").is_file()
    assert not (mine / "run").exists()


@pytest.mark.faults
def test_a_simulation_that_prints_to_a_reader_that_has_gone_is_not_recorded_as_failed(
    mine: Path, tmp_path: Path
) -> None:
    (mine / "model.py").write_text(MODEL.replace("    severity", "    print('at work', flush=True)\n    severity"))
    words = [sys.executable, "-m", "activefail.cli", "run", mine / "mine.toml", "--workers", "1", "--out"]
    with subprocess.Popen([*words, tmp_path / "cut"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert b"Traceback" not in err
    assert activefail("run", mine / "mine.toml", "--out", tmp_path / "whole", "--workers", "1").code == 0
    assert activefail("resume", tmp_path / "cut", "--code", mine, "--workers", "1").code == 0
    cut, whole = ([{**row, "seconds": ""} for row in record(tmp_path / name)] for name in ("cut", "whole"))
    assert cut == whole


@pytest.mark.parametrize(
    ("value", "outcomes", "levels", "outcome"),
    [
        (0.5, ("safe", "failure"), (0.0,), 0),
        (-0.0, ("safe", "failure"), (0.0,), 1),
        (np.float64(-2.0), ("safe", "failure"), (0.0,), 1),
        (0.5, ("safe", "damage", "collapse"), (0.2, -1.0), 0),
        (0.2, ("safe", "damage", "collapse"), (0.2, -1.0), 1),
        (-1.0, ("safe", "damage", "collapse"), (0.2, -1.0), 2),
    ],
)
def test_a_limit_state_returns_its_margin_alone_which_its_levels_give_an_outcome(
    value: float, outcomes: tuple[str, ...], levels: tuple[float, ...], outcome: int
) -> None:
    results = read_answer(value, outcomes, ("g",), levels, 0.0)
    assert (results.outcome.tolist(), results.margins.tolist()) == ([outcome], [[float(value)]])


ONE_NUMBER = (
    *(kind(0.5) for kind in (float, np.float64, np.float32, np.float16, np.longdouble, Fraction, Decimal, np.array)),
    *(np.array(0.5, dtype=kind).reshape(shape) for kind in (float, object) for shape in ((1,), (1, 1))),
    *(torch.tensor([0.5], requires_grad=gradient) for gradient in (False, True)),
    *(pd.Series([0.5]), [0.5], (0.5,), np.ma.array([0.5])),
)


class Side(Enum):
    SAFE, FAILURE = "safe", "failure"


class Code(IntEnum):
    FAILURE = 1


class Force(float):
    units = "kN"


NO_NUMBER = (
    Force(0.5),
    *(True, np.bool_(True), np.array([True]), None, [0.5, 0.6], np.array([0.5, 0.6]), np.empty(0), [], b"0.5", 1j),
    *(np.timedelta64(1), np.datetime64("2020"), np.ma.masked, np.ma.array([0.5], mask=[True]), {0.5}, [[1], [2, 3]]),
)


@pytest.mark.parametrize("value", ONE_NUMBER, ids=repr)
def test_one_number_is_a_number_whatever_holds_it(value: object) -> None:
    for given in (value, {"outcome": "safe", "margins": {"g": value}}):
        assert read_answer(given, ("safe", "failure"), ("g",), (0.0,), 0.0).margins.tolist() == [[0.5]]


@pytest.mark.parametrize("value", NO_NUMBER, ids=repr)
def test_what_is_not_one_number_is_refused_with_what_to_return(value: object) -> None:
    with pytest.raises(UnusableAnswerError, match=r"\(safe, failure\), or .*, or the margin g as one number, got"):
        read_answer(value, ("safe", "failure"), ("g",), (0.0,), 0.0)
    with pytest.raises(UnusableAnswerError, match=r"margins\.g: must be one number, left out where it is undefined"):
        read_answer({"outcome": "safe", "margins": {"g": value}}, ("safe", "failure"), ("g",), (0.0,), 0.0)


def test_a_member_of_an_enumeration_is_the_outcome_that_is_its_value() -> None:
    for given in (Side.FAILURE, {"outcome": Side.FAILURE}):
        assert read_answer(given, ("safe", "failure"), ("g",), (0.0,), 0.0).outcome.tolist() == [1]
    for given in (Code.FAILURE, {"outcome": "safe", "margins": {"g": Code.FAILURE}}):
        with pytest.raises(UnusableAnswerError, match="must be one"):  # a number without its word
            read_answer(given, ("safe", "failure"), ("g",), (0.0,), 0.0)


def test_a_margin_alone_must_tell_the_side_and_be_the_only_one() -> None:
    with pytest.raises(UnusableAnswerError, match="the margin g is inf; without an outcome it must be a finite number"):
        read_answer(math.inf, ("safe", "failure"), ("g",), (0.0,), 0.0)
    with pytest.raises(UnusableAnswerError, match="the margin g is nan"):
        read_answer(float("nan"), ("safe", "failure"), ("g",), (0.0,), 0.0)
    for value, margins, levels in ((0.5, (), ()), (True, ("g",), (0.0,))):
        with pytest.raises(UnusableAnswerError, match=r"must be the name of an outcome \(safe, failure\), or"):
            read_answer(value, ("safe", "failure"), margins, levels, 0.0)


@pytest.mark.parametrize(
    ("outcomes", "margins", "levels", "expected"),
    [
        (["safe", "failure"], ["g"], {}, (0.0,)),
        (["safe", "damage", "collapse"], ["g"], {}, ()),
        (["safe", "damage", "collapse"], ["g"], {"g": [0.3, 0.1]}, (0.3, 0.1)),
        (["safe", "failure"], ["g", "h"], {"g": [0.3]}, ()),
    ],
)
def test_a_number_is_an_answer_if_it_is_the_only_margin_and_each_outcome_has_a_level(
    outcomes: list[str], margins: list[str], levels: dict[str, list[float]], expected: tuple[float, ...]
) -> None:
    settings = PythonSimulatorSettings(python="model:run", outcomes=outcomes, margins=margins, levels=levels)
    assert settings.levels_of_number == expected
