"""The run folder as a Python object: what the commands do, it does."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, record
from matplotlib.figure import Figure

import activefail as af
from activefail.errors import BusyError, InputError
from activefail.space.shares import percent

PLATE = """
def run(design):
    return "failure" if design["x"] + design["y"] > 1.3 else "safe"
"""

SETTINGS = """
seed = 3
sampling = { initial = 20, budget = 30, batch = 5 }
simulator = { python = "plate:run", outcomes = ["safe", "failure"] }
[space]
x = { low = 0, high = 1 }
y = { low = 0, high = 1 }
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plate")
    (folder / "plate.py").write_text(PLATE)
    (folder / "plate.toml").write_text(SETTINGS)
    return folder / "plate.toml"


@pytest.fixture(scope="module")
def taken(file: Path) -> Path:
    """A run folder, taken to its budget in Python."""
    folder = file.with_name("run")
    with af.create_run(folder, file) as run:
        assert run.summary.done == 0
        taken = run.take()
    assert (taken.finished, taken.progress.done, taken.first_fault) == (True, 30, "")
    return folder


def test_a_run_in_python_is_the_run_of_the_command_line(file: Path, taken: Path, tmp_path: Path) -> None:
    assert activefail("run", file, "--out", tmp_path / "run").code == 0
    assert record(tmp_path / "run") == record(taken)
    assert (tmp_path / "run" / "campaign.toml").read_bytes() == (taken / "campaign.toml").read_bytes()


def test_a_run_that_is_taken_in_parts_is_the_same(file: Path, taken: Path, tmp_path: Path) -> None:
    with af.create_run(tmp_path / "run", file) as run:
        assert run.take(budget=7).progress.done == 7
    with af.open_run(tmp_path / "run", write=True, code=file.parent) as run:
        assert run.take(budget=25).progress.done == 25
        assert run.take().finished
    assert record(tmp_path / "run") == record(taken)


def test_an_open_run_says_what_it_holds(taken: Path, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with af.open_run(taken) as run:
        assert (len(run.history), run.summary.done, run.space.names) == (30, 30, ("x", "y"))
        assert (run.boundary, run.settings.seed) == ("failure", 3)
        assert run.resume_command() == f"activefail resume {taken}"
        p = run.classifier.probabilities(np.array([[0.1, 0.1], [0.95, 0.95]]))
        assert p[0, 1] < 0.1 < 0.9 < p[1, 1]
        assert run.classifier is run.classifier
        assert run.findings.boundary == "failure"
    with af.open_run(taken, code=file.parent) as run:
        options = "--ignore-stop --budget 40 --numerical-failures 0.5"
        assert run.resume_command(40, 0.5, True) == f"activefail resume {taken} {options}"
        # Where nothing can be remembered the command names the folder of the code.
        monkeypatch.setenv("XDG_STATE_HOME", str(file))
        assert run.resume_command(40, 0.5, True) == f"activefail resume {taken} --code {file.parent} {options}"


def test_the_classifier_follows_the_record(file: Path, tmp_path: Path) -> None:
    with af.create_run(tmp_path / "run", file) as run:
        with pytest.raises(InputError, match="has no simulations to learn from yet; `activefail resume"):
            run.learn()
        run.take(budget=20)
        first = run.classifier
        run.take(budget=25)
        assert run.classifier is not first
        assert len(run.classifier.latents[0].trained.labels) == 25


@pytest.mark.usefixtures("without_pictures")
def test_a_run_verifies_compares_predicts_and_reports(taken: Path, file: Path, tmp_path: Path) -> None:
    with af.open_run(taken, write=True, code=file.parent) as run:
        error = run.verify(60).estimate
        assert 0.0 <= error.low <= error.error <= error.high <= 1.0
        (shown,) = re.findall("<th>error</th><td>(.*?)</td>", run._repr_html_())
        assert shown.startswith(f"{percent(error.error, 2)} (")
        assert shown.endswith("of the design space with 90 % confidence, 60 fresh simulations")
        with pytest.raises(InputError, match="plot_history: requires a comparison with static designs, or a valid"):
            run.plot_history()
        scores = run.compare([20, 30], 100).scores
        assert {score.sampling for score in scores} == {"active", "static"}
        axes = Figure().add_subplot()
        assert run.plot_history(axes) is axes
        shown = {line.get_label(): line.get_xydata().tolist() for line in axes.lines}
        active = [[score.simulations, 100.0 * score.accuracy] for score in scores if score.sampling == "active"]
        assert shown["active sampling"] == active
        assert (taken / "compare" / "scores.csv").is_file()
        assert run.export_table(tmp_path / "designs.csv") == 30
        assert run.predict_table(tmp_path / "designs.csv", tmp_path / "predicted.csv") == 0
        judged = run.report(tmp_path / "report.html").evidence.error
        assert judged == error.as_json()
        assert "failure" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("budget", "rule"),
    [(1, "budget: must be at least 2, got 1"), (29, "at least 30, the number of recorded simulations")],
)
def test_a_budget_that_cannot_be_is_refused(taken: Path, file: Path, budget: int, rule: str) -> None:
    with af.open_run(taken, write=True, code=file.parent) as run, pytest.raises(InputError, match=rule):
        run.take(budget=budget)


def test_a_folder_has_one_writer_and_holds_one_campaign(taken: Path, file: Path) -> None:
    with af.open_run(taken, write=True, code=file.parent):
        with pytest.raises(BusyError):
            af.open_run(taken, write=True, code=file.parent)
        with af.open_run(taken) as reader:
            assert len(reader.history) == 30
    with pytest.raises(InputError, match="already holds a campaign; `activefail resume"):
        af.create_run(taken, file)


def test_to_import_the_package_loads_none_of_what_is_heavy() -> None:
    heavy = ["torch", "scipy", "numba", "h5py", "matplotlib", "pydantic"]
    program = f"import sys, activefail; activefail.__all__; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "[]\n"


def test_a_script_that_runs_again_continues_its_campaign_and_no_other(tmp_path: Path) -> None:
    settings = {"simulator": {"elsewhere": True, "margins": ["g"]}, "space": {"x": {"low": 0, "high": 1}}}
    for asked in (6, 4):
        sampling = {"initial": 6, "budget": 10}
        with af.create_run(tmp_path / "run", settings | {"sampling": sampling}, exist_ok=True) as run:
            designs = run.ask(asked)
            run.tell(designs.assign(g=designs["x"] - 0.5))
    with af.open_run(tmp_path / "run") as run:
        assert len(run.simulations) == 10
    with pytest.raises(InputError, match="holds another campaign: sampling differ"):
        af.create_run(tmp_path / "run", settings | {"sampling": {"initial": 6, "budget": 12}}, exist_ok=True)
    with pytest.raises(InputError, match="already holds a campaign"):
        af.create_run(tmp_path / "run", settings | {"sampling": sampling})


def test_a_script_that_ends_without_closing_its_run_ends_quietly(tmp_path: Path) -> None:
    settings = {"simulator": {"elsewhere": True, "margins": ["g"]}, "space": {"x": {"low": 0, "high": 1}}}
    # What another module keeps is deleted when the interpreter has already emptied the modules.
    program = f"""
import json, activefail
class Kept:
    def __del__(self):
        self.run.store._journal.__del__()
json.kept = Kept()
json.kept.run = activefail.create_run("run", {settings!r})
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    af.open_run(tmp_path / "run", write=True).close()


def test_a_boundary_is_drawn_on_axes_as_predicted(tmp_path: Path) -> None:
    space = {"x": {"low": 0, "high": 1}, "soil": {"choices": ["A", "B"]}, "y": {"low": 0, "high": 2}}
    settings = {"simulator": {"elsewhere": True, "margins": ["g"]}, "space": space}
    with af.create_run(tmp_path / "run", settings | {"sampling": {"initial": 20, "budget": 20}}) as run:
        designs = run.ask(20)
        run.tell(designs.assign(g=designs["x"] + designs["y"] - 1.5 + 0.2 * (designs["soil"] == "B")))
        axes = Figure().add_subplot()
        assert run.plot_boundary("x", "y", at={"soil": "B"}, axes=axes) is axes
        assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 1.0), (0.0, 2.0))
        lines = [path for drawn in axes.collections if len(drawn.get_paths()) == 5 for path in drawn.get_paths()[2:3]]
        points = lines[0].vertices
        assert abs(points.sum(axis=1) - 1.3).max() < 0.02  # by points 0.007 and 0.013 apart
        with pytest.warns(UserWarning, match="1 design lies outside the design space"):
            run.predict({"x": [0.5, 1.5], "y": [0.5, 0.5], "soil": ["A", "B"]})
        marks = axes.collections[-4:]
        assert sum(len(drawn.get_offsets()) for drawn in marks) == 20
        full = [drawn for drawn in marks if drawn.get_alpha() == 1.0]
        assert sum(len(drawn.get_offsets()) for drawn in full) == (designs["soil"] == "B").sum()
        known, axes = run.failure(), Figure().add_subplot()
        assert run.plot_history(axes) is axes
        assert axes.lines[0].get_xydata()[-1].tolist() == [20.0, known.probability[-1]]
        for wrong in ({"x": "x", "y": "soil"}, {"x": "x", "y": "y", "at": {"z": 1}}):
            with pytest.raises(InputError, match="must"):
                run.plot_boundary(**wrong)
