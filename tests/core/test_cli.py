"""The command line: every command does what its help says, and every mistake ends in one message, not a traceback."""

import io
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request
import warnings
from pathlib import Path

import pounding
import pytest
import typer
from commandline import (
    CommandResult,
    activefail,
    holding,
    record,
    refused,
    sets,
    started,
    struck_as_by_a_terminal,
    table,
)
from patience import PATIENCE, Clock
from pounding import copied, write_campaign

from activefail import Run, __version__, open_run
from activefail.campaign.assembly import Campaign
from activefail.campaign.known_code import remember_code
from activefail.campaign.on_disk import open_campaign
from activefail.campaign.settings import read_settings
from activefail.cli import app
from activefail.cli.common import shown_warnings
from activefail.errors import InputError, TableWarning
from activefail.execution.local import ThreadExecutor
from activefail.loop.progress import Observer
from activefail.loop.running import run as run_loop
from activefail.record.run_folder import FolderStore
from activefail.session import display
from activefail.session.interrupts import stop_on_signals
from activefail.session.session import estimating
from activefail.space.shares import percent

COMMANDS = tuple(typer.main.get_group(app).commands)


pytestmark = pytest.mark.usefixtures("simulations_in_this_process")

HEADER = ",".join(pounding.NAMES)
ROW = "0.06,2e9,2.0,0.4"

TINY = "seed = 3\nsampling = { initial = 20, budget = 30, batch = 5 }\n"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign file: 20 simulations and 10 more."""
    return write_campaign(tmp_path_factory.mktemp("campaign") / "tiny.toml", TINY)


@pytest.fixture(scope="module")
def ran(tiny: Path) -> tuple[Path, CommandResult]:
    """The run folder of the tiny campaign, not to be changed, and the output of its run."""
    folder = tiny.with_name("ran")
    return folder, activefail("run", tiny, "--out", folder)


@pytest.fixture
def folder(ran: tuple[Path, CommandResult], tmp_path: Path) -> Path:
    """A copy of the run folder of the tiny campaign."""
    return copied(ran[0], tmp_path / "run", ran[0].parent)


def halted(tiny: Path, folder: Path, batches: int) -> Path:
    """The run folder of the tiny campaign, stopped after some batches."""
    campaign = Campaign.of(read_settings(tiny), tiny.parent)
    with (
        FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store,
        ThreadExecutor(2) as executor,
    ):
        run_loop(campaign, store, executor, 30, Observer(stop=lambda: len(store.batches) == batches))
    remember_code(folder, campaign)
    return folder


# --- help --------------------------------------------------------------------------------------------------------


def test_the_help_lists_every_command_and_loads_neither_learning_nor_physics() -> None:
    script = "import sys; from activefail.cli import app, main\ntry: main()\nfinally: print(sorted(sys.modules))"
    result = subprocess.run([sys.executable, "-c", script, "--help"], capture_output=True, text=True, check=True)
    assert {"run", "resume", "status", "predict", "export", "compare"} <= set(COMMANDS)
    assert [command for command in COMMANDS if command not in result.stdout] == []
    loaded = result.stdout[result.stdout.index("['") :]
    assert [name for name in ("torch", "numba", "h5py", "matplotlib") if f"'{name}'" in loaded] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_ends_with_an_example_that_it_takes(command: str) -> None:
    shown = activefail(command, "--help")
    assert (shown.code, shown.err) == (0, "")
    assert activefail(command, "-h") == shown
    example = " ".join(shown.out.rstrip().split("\n\n")[-1].split())
    assert example.startswith(f"Example: activefail {command}")
    words = shlex.split(example.removeprefix(f"Example: activefail {command}"))
    assert typer.main.get_command(app).commands[command].make_context(command, words).params


def test_the_version_is_the_packages() -> None:
    assert activefail("--version") == CommandResult(0, f"activefail {__version__}\n", "")


def test_quiet_commands_show_no_progress_and_verbose_ones_the_times_of_their_stages(tiny: Path, tmp_path: Path) -> None:
    for name, (before, after) in {"q": (["-q"], []), "v": ([], ["--verbose"]), "n": ([], [])}.items():
        folder = tmp_path / name
        ran = activefail(*before, "run", tiny, "--out", folder, "--budget", "20", "--workers", "1", *after)
        assert (ran.code, f"results    {folder}" in ran.out) == (0, True)
        assert ("20/20 simulations" in ran.out) == (name != "q")
        assert bool(re.search(r"^simulating the initial design: \d+\.\d s$", ran.err, re.MULTILINE)) == (name == "v")
    shown = [activefail("compare", tmp_path / "n", "--test", "10", *option) for option in ([], ["-q"])]
    assert [result.code for result in shown] == [0, 0]
    assert shown[0].err != "" == shown[1].err


def test_a_verbose_error_says_where_it_was_raised(tmp_path: Path) -> None:
    shown = activefail("status", tmp_path / "none", "-v")
    assert shown.code == 2
    assert "Traceback" in shown.err
    assert "layout.py" in shown.err
    refused(activefail("status", tmp_path / "none"), "none")


def test_shells_complete_commands_and_options() -> None:
    for words, completed in (("ru", "run"), ("predict --cs", "--csv"), ("--qu", "--quiet"), ("run q", "quick")):
        environment = {
            "_ACTIVEFAIL_COMPLETE": "complete_bash",
            "COMP_WORDS": f"activefail {words}",
            "COMP_CWORD": str(len(words.split())),
        }
        program = Path(sys.executable).with_name("activefail")
        asked = subprocess.run([program], env=os.environ | environment, capture_output=True, text=True, check=False)
        assert completed in asked.stdout.split(), asked


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["explode"], "No such command 'explode'"),
        (["verify", "x", "--speed", "3"], "No such option: --speed"),
        (["verify", "x", "--confidence", "rough"], "'--confidence': must be a valid number, got 'rough'"),
        (["compare", "x", "--test", "9"], "Invalid value for '--test': must be greater than or equal to 10, got '9'"),
        (["run", "c.toml", "--out", "x", "--executor", "pbs"], "'--executor': 'pbs' is not one of 'local', 'dask'"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_refused_naming_what_does_not(words: list[str], says: str) -> None:
    result = activefail(*words)
    assert (result.code, result.out) == (2, "")
    assert says in result.err
    assert "Traceback" not in result.err


def test_without_a_command_the_help_is_shown_and_the_exit_code_says_that_nothing_was_done() -> None:
    result = activefail()
    assert result.code == 2
    assert "verify" in result.out + result.err


# --- run and resume ----------------------------------------------------------------------------------------------


def test_a_campaign_is_run_to_its_budget_and_tells_where_it_is(ran: tuple[Path, CommandResult]) -> None:
    folder, result = ran
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0].startswith("seeking    the boundary of failure (")
    assert lines[1].startswith("0/30 simulations | iteration 0 | 0 no_impact, 0 impact, 0 failure")
    assert lines[-3].startswith("30/30 simulations | iteration 2 | ")
    assert lines[-2] == f"results    {folder}"
    assert lines[-1].startswith(f"next       activefail verify {folder}, ")
    rows = record(folder)
    counts = [[row["outcome"] for row in rows].count(name) for name in ("no_impact", "impact", "failure")]
    assert sum(counts) == 30
    assert "{} no_impact, {} impact, {} failure".format(*counts) in lines[-3]


def test_the_run_folder_keeps_the_settings_with_the_command_lines_seed_and_budget(tiny: Path, tmp_path: Path) -> None:
    result = activefail("run", tiny, "--out", tmp_path / "run", "--seed", "8", "--budget", "22", "--workers", "1")
    assert result.code == 0
    kept = read_settings(tmp_path / "run" / "campaign.toml")
    assert kept == read_settings(tiny, seed=8, budget=22)
    assert len(record(tmp_path / "run")) == 22


@pytest.mark.parametrize("batches", [2, 5])
def test_a_campaign_that_was_stopped_is_resumed_to_the_uninterrupted_one(
    tiny: Path, ran: tuple[Path, CommandResult], tmp_path: Path, batches: int
) -> None:
    folder = halted(tiny, tmp_path / "run", batches)
    result = activefail("resume", folder, "--workers", "2")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines()[1].startswith(f"{5 * batches}/30 simulations")
    assert record(folder) == record(ran[0])


def test_a_finished_campaign_is_resumed_to_itself_and_beyond_its_budget_when_asked(folder: Path) -> None:
    before = record(folder)
    assert activefail("resume", folder).code == 0
    assert record(folder) == before
    result = activefail("resume", folder, "--budget", "33")
    assert (result.code, result.out.splitlines()[-2]) == (0, f"results    {folder}")
    after = record(folder)
    assert (len(after), after[:30]) == (33, before)
    assert {row["origin"] for row in after[30:]} == {"active"}


def test_a_folder_with_other_things_in_it_is_refused_and_left_alone(tiny: Path, folder: Path, tmp_path: Path) -> None:
    refused(activefail("run", tiny, "--out", folder), str(folder), f"`activefail resume {folder}`")
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").touch()
    refused(activefail("run", tiny, "--out", other), "is not empty (it holds thesis.tex)")
    assert os.listdir(other) == ["thesis.tex"]
    place = other / "thesis.tex" / "run"
    refused(activefail("run", tiny, "--out", place), f"{place}: cannot be a run folder: Not a directory")


@pytest.mark.parametrize(
    ("content", "words", "parts"),
    [
        (None, [], ["mine.toml: cannot be read: No such file or directory"]),
        ("seed = ", [], ["mine.toml: not valid TOML"]),
        (f"sead = 1\n{TINY}", [], ["mine.toml:", "sead: unknown key"]),
        (f'acquisition.boundary = "collapse"\n{TINY}', [], ["mine.toml", "boundary: must be one of impact, failure"]),
        (TINY, ["--budget", "10"], ["mine.toml --budget 10:", "must hold, got initial = 20 and budget = 10"]),
        (TINY, ["--seed", "-1"], ["mine.toml --seed -1:", "seed: must be greater than or equal to 0, got -1"]),
    ],
)
def test_a_campaign_with_a_mistake_is_refused_before_a_run_folder_is_made(
    content: str | None, words: list[str], parts: list[str], tmp_path: Path
) -> None:
    if content is not None:
        write_campaign(tmp_path / "mine.toml", content)
    refused(activefail("run", tmp_path / "mine.toml", "--out", tmp_path / "run", *words), *parts)
    assert not (tmp_path / "run").exists()


def test_a_budget_below_what_is_done_is_refused(folder: Path) -> None:
    before = record(folder)
    for budget, least in (("-3", 2), ("29", 30)):
        refused(activefail("resume", folder, "--budget", budget), f"budget: must be at least {least}", f"got {budget}")
    assert activefail("resume", folder, "--budget", "30").code == 0
    assert record(folder) == before


COMMANDS_ON_FOLDERS = {
    "resume": [],
    "status": [],
    "predict": ["--csv", "in.csv", "--out", "out.csv"],
    "export": ["--csv", "out.csv"],
    "compare": [],
    "verify": [],
    "report": [],
    "explore": ["--port", "0"],
}


@pytest.mark.parametrize("command", COMMANDS_ON_FOLDERS)
def test_what_is_no_run_folder_is_refused_by_every_command_and_left_alone(command: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    for name in ("none", "empty", "file"):
        refused(activefail(command, tmp_path / name, *COMMANDS_ON_FOLDERS[command]), f"{name}: is not a run folder")
    assert sorted(os.listdir(tmp_path)) == ["empty", "file"]
    assert os.listdir(tmp_path / "empty") == []


@pytest.mark.faults
@pytest.mark.parametrize("command", COMMANDS_ON_FOLDERS)
def test_settings_that_were_changed_afterwards_are_refused_by_every_command_with_the_change(
    command: str, folder: Path
) -> None:
    path = folder / "campaign.toml"
    path.write_text(path.read_text().replace("seed = 3", "seed = 4"))
    result = activefail(command, folder, *COMMANDS_ON_FOLDERS[command])
    refused(result, "settings were changed", "-seed = 3", "+seed = 4", code=1)


@pytest.mark.faults
def test_a_folder_that_another_process_writes_to_can_be_read_and_not_written_to(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    with open_campaign(folder, write=True):
        for command in ("resume", "compare"):
            refused(activefail(command, folder), "Another process is writing to", str(folder), code=1)
        assert activefail("status", folder).code == 0
        assert activefail("export", folder, "--csv", tmp_path / "all.csv").code == 0
        result = activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv")
        assert result.code == 0


# --- status, predict, export -------------------------------------------------------------------------------------


def test_the_status_names_every_target_boundary_with_its_share(tiny: Path, tmp_path: Path) -> None:
    file = write_campaign(tmp_path / "both.toml", f"{TINY}acquisition.boundary = {{ failure = 3, impact = 1 }}\n")
    result = activefail("status", halted(file, tmp_path / "both", 0))
    assert "entropy at the failure boundary (75 %) and the impact boundary (25 %)" in result.out


@pytest.mark.parametrize("batches", [0, 3])
def test_the_status_of_a_campaign_that_was_stopped_says_how_to_go_on(tiny: Path, tmp_path: Path, batches: int) -> None:
    folder = halted(tiny, tmp_path / "my run", batches)
    result = activefail("status", folder)
    assert f"done       {5 * batches} of 30 simulations, iteration 0" in result.out
    line = result.out.splitlines()[-1]
    assert shlex.split(line.removeprefix("continue")) == ["activefail", "resume", str(folder)]


def test_the_status_of_a_campaign_that_ended_by_its_stop_rule_says_how_to_go_on_all_the_same(tmp_path: Path) -> None:
    # An easy rule: the first look ends the campaign.
    rule = "stop = { error = 0.49, confidence = 0.5, simulations = 10, every = 1 }\n"
    write_campaign(tmp_path / "easy.toml", rule + TINY)
    folder = tmp_path / "run"
    assert "stop rule  met after 20 simulations" in activefail("run", tmp_path / "easy.toml", "--out", folder).out
    assert activefail("status", folder).out.splitlines()[-2:] == [
        "stop rule  met",
        f"continue   activefail resume {folder} --ignore-stop",
    ]
    activefail("resume", folder, "--ignore-stop", "--budget", "25")
    assert activefail("status", folder).out.splitlines()[-1] == f"continue   activefail resume {folder}"


def test_a_stop_rule_is_not_met_because_others_simulate_the_rest_of_the_budget(tmp_path: Path) -> None:
    write_campaign(tmp_path / "hard.toml", f"stop = {{ error = 0.001, simulations = 50 }}\n{TINY}")
    folder = tmp_path / "run"
    activefail("create", tmp_path / "hard.toml", "--out", folder)
    assert activefail("ask", folder, "--n", "5", "--csv", tmp_path / "todo.csv").code == 0
    said = activefail("resume", folder)
    assert said.code == 0
    assert "in flight  5" in said.out
    assert "stop rule" not in said.out + activefail("status", folder).out


def test_predictions_are_written_with_a_warning_where_they_extrapolate(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"site,{HEADER}\nA,{ROW}\nB,{ROW.replace('0.06', '0.5')}\n")
    result = activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv")
    assert result.code == 0
    assert result.err == (
        "warning: 1 design lies outside the design space, where the classifier may extrapolate (the first by mu: "
        "`0.02 <= mu <= 0.12` must hold, got 0.5)\n"
    )
    assert result.out.endswith(f"written to {tmp_path / 'out.csv'}\n")
    for row in table(tmp_path / "out.csv"):
        assert sum(float(row[f"p_{name}"]) for name in ("no_impact", "impact", "failure")) == pytest.approx(1.0)


def test_warnings_about_a_table_are_told_though_it_is_refused_and_those_of_other_code_keep_their_place(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail() -> None:
        warnings.warn("a design lies outside", TableWarning, stacklevel=1)
        warnings.warn("divided by zero", UserWarning, stacklevel=1)
        raise InputError("refused")

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = lambda *one: sys.stderr.write(warnings.formatwarning(*one))
        with pytest.raises(InputError), shown_warnings():
            fail()
    own, other, *_ = capsys.readouterr().err.splitlines()
    assert own == "warning: a design lies outside"
    assert re.fullmatch(rf"{re.escape(__file__)}:\d+: UserWarning: divided by zero", other)


def test_a_ctrl_c_says_that_simulations_are_kept_only_once_there_are_any(tiny: Path, folder: Path) -> None:
    def interrupted(run: Run, simulations: tuple[int, ...]) -> None:
        with estimating(run) as estimator:
            for number in simulations:
                estimator.announce(number)
            raise KeyboardInterrupt

    with open_run(folder, code=tiny.parent) as run:
        for simulations, said in ((), ()), ((5,), ("simulations are kept; the same command continues",)):
            with pytest.raises(KeyboardInterrupt) as stopped:
                interrupted(run, simulations)
            assert stopped.value.args == said


def test_predictions_do_not_need_what_was_saved_of_the_learning(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    written = []
    for name in ("before.csv", "after.csv"):
        assert activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", tmp_path / name).code == 0
        written.append((tmp_path / name).read_bytes())
        (folder / "checkpoint.h5").unlink(missing_ok=True)
    assert written[0] == written[1]


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (f"{HEADER}\n{ROW.replace('0.06', 'rough')}\n", "row 1 (line 2), column mu: must be a number, got 'rough'"),
        (f"{HEADER},p_failure\n{ROW},1\n", "column 'p_failure': would be overwritten by the output"),
    ],
)
def test_a_table_that_cannot_be_predicted_is_refused_and_nothing_is_written(
    folder: Path, tmp_path: Path, content: str, part: str
) -> None:
    (tmp_path / "in.csv").write_text(content)
    result = activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv")
    refused(result, f"{tmp_path / 'in.csv'}", part)
    assert not (tmp_path / "out.csv").exists()


def test_predictions_say_what_is_known_of_the_classifier(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")

    def said(*words: str) -> str:
        predicted = activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv", *words)
        return predicted.out.splitlines()[0]

    with open_run(folder) as run:
        counts = [f"{run.counts[name]} {name}" for name in ("no_impact", "impact", "failure")]
        expected = run.findings.expected
    learned = f"classifier learned from 30 results ({', '.join(counts)})"
    of = "of the design space by its own probabilities, without an interval"
    assert said() == f"{learned}; expected error {percent(expected, 2)} {of}"
    assert said("--after", "20").startswith("classifier learned from 20 results (")
    verified = activefail("verify", folder, "--simulations", "20").out.splitlines()[1]
    assert said().startswith(
        f"{learned}; verified error {verified.split(None, 1)[1].split(' of the')[0]} of the design"
    )
    assert "expected error" in said("--after", "20")


def test_a_campaign_without_simulations_predicts_and_compares_nothing(tiny: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    folder = halted(tiny, tmp_path / "run", 0)
    result = activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv")
    refused(result, f"{folder}: has no simulations to learn from yet")
    refused(activefail("compare", folder), "no simulations to compare yet")
    refused(activefail("report", folder), "no simulations to learn from yet", f"activefail resume {folder}")
    refused(activefail("explore", folder), "no simulations to learn from yet")
    assert record(folder) == []


def test_where_an_output_cannot_be_written_its_name_and_the_reason_are_told(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    for target, reason in ((tmp_path / "none" / "out.csv", "No such file or directory"), (folder, "Is a directory")):
        part = f"{target}: cannot be written: {reason}."
        refused(activefail("export", folder, "--csv", target), part)
        refused(activefail("predict", folder, "--csv", tmp_path / "in.csv", "--out", target), part)
    (folder / "compare").touch()
    result = activefail("compare", folder, "--budgets", "20", "--test", "10")
    assert result.code == 2
    assert f"activefail: {folder / 'compare'}: cannot be written: File exists" in result.err


@pytest.mark.parametrize(
    "own",
    ["campaign.toml", "journal", "checkpoint.h5", "simulations/x/o.csv"],
)
def test_no_command_writes_over_a_run_folder_s_own_files(folder: Path, tiny: Path, own: str) -> None:
    own_files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (folder.parent / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    table_of = ("--csv", folder.parent / "in.csv")
    for option, path, words in (
        ("--csv", folder / own, ("export", folder)),
        ("--out", folder / own, ("predict", folder, *table_of)),
        ("--out", folder / own, ("report", folder)),
        ("--out", folder / own, ("run", tiny)),
    ):
        result = activefail(*words, option, path)
        refused(result, f"{option}: {path} is one of the run folder's own files; choose another.")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == own_files


def test_other_files_in_a_run_folder_and_beside_a_campaign_file_may_be_written(folder: Path, tmp_path: Path) -> None:
    assert activefail("export", folder, "--csv", folder / "all.csv").code == 0
    # No run folder: a campaign file of the user's, and a folder of theirs.
    shutil.copy(folder / "campaign.toml", tmp_path)
    (tmp_path / "simulations").mkdir()
    assert activefail("export", folder, "--csv", tmp_path / "simulations" / "all.csv").code == 0


# --- compare -----------------------------------------------------------------------------------------------------


def test_a_comparison_prints_and_writes_a_row_for_each_sampling_and_budget(folder: Path) -> None:
    result = activefail("compare", folder, "--budgets", "30,20,30", "--test", "60")
    assert result.code == 0
    results = folder / "compare"
    rows = {(row["simulations"], row["sampling"]): row for row in table(results / "scores.csv")}
    lines = result.out.splitlines()
    assert "failure accuracy" in lines[0]
    printed = {(words[0], words[1]): words[2] for words in map(str.split, lines[1:5])}
    assert list(printed) == [("20", "active"), ("20", "static"), ("30", "active"), ("30", "static")]
    assert rows.keys() == printed.keys()
    for key, row in rows.items():
        assert float(printed[key]) == pytest.approx(100.0 * float(row["accuracy"]), abs=0.005)
        assert (row["test_designs"], row["test_unanswered"]) == ("60", "0")
    assert (results / "learning_curves.png").read_bytes().startswith(b"\x89PNG")
    assert (results / "learning_curves.svg").read_text().startswith("<?xml")
    # The campaign is what it was.
    assert len(record(folder)) == 30


@pytest.mark.parametrize(
    ("budgets", "rule"),
    [
        ("many", "--budgets: must be whole numbers separated by commas, got 'many'"),
        ("20,30.5", "--budgets: must be whole numbers separated by commas, got '20,30.5'"),
        ("20,31", "budgets: must be between 2 and the 30 recorded simulations, got 31"),
        ("-5", "budgets: must be between 2 and the 30 recorded simulations, got -5"),
    ],
)
def test_budgets_that_the_campaign_has_not_are_refused_before_anything_is_simulated(
    folder: Path, budgets: str, rule: str
) -> None:
    refused(activefail("compare", folder, f"--budgets={budgets}"), rule)
    assert sets(folder) == {}


def test_work_without_a_terminal_says_now_and_then_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(display, "time", Clock(lambda: now[-1]))
    with display.progress_bar("simulating") as begin:
        advance = begin(6)
        for seconds in (9.0, 11.0, 20.0):
            now.append(seconds)
            advance(2)
    assert capsys.readouterr().err == "simulating: 4 of 6\n"


def test_a_campaign_is_verified_and_says_so_again_without_simulating(folder: Path) -> None:
    result = activefail("verify", folder, "--simulations", "30")
    assert result.code == 0
    assert re.search(r"error +\d+\.\d\d % \(\d+\.\d\d to \d+\.\d\d %\) of the design space", result.out)
    assert re.search(r"^simulating 30 fresh designs, less than 1 s$", result.err, re.M)
    before = sets(folder)
    again = activefail("verify", folder, "--simulations", "30")
    assert again.out == result.out
    assert "simulating" not in again.err
    assert sets(folder) == before


@pytest.mark.slow
@pytest.mark.usefixtures("without_pictures")
def test_a_campaign_is_reported_on_one_page_that_shows_what_was_verified_and_compared(folder: Path) -> None:
    verified = activefail("verify", folder, "--simulations", "30")
    error = re.search(r"error +(\d+\.\d\d % \(.+? %\))", verified.out)
    assert error is not None
    assert activefail("compare", folder, "--budgets", "20,30", "--test", "50").code == 0
    result = activefail("report", folder)
    assert (result.code, result.out) == (0, f"report     {folder / 'report.html'}\n")
    page = (folder / "report.html").read_text()
    assert f"<b>{error[1]}</b> of the design space" in page
    assert "<td>static Latin hypercube</td>" in page
    assert "Missing:" not in page
    before = record(folder)
    elsewhere = folder.with_name("page.html")
    assert activefail("report", folder, "--out", elsewhere).code == 0
    assert elsewhere.read_text() == page
    assert record(folder) == before


def test_a_campaign_is_explored_on_this_machine_until_ctrl_c(folder: Path) -> None:
    with started("explore", folder, "--port", "0") as server:
        assert server.stdout is not None
        line = server.stdout.readline()
        address = re.fullmatch(r"explorer   (http://127\.0\.0\.1:\d+/\?token=\S+)  \(Ctrl-C to quit\)\n", line)
        assert address is not None
        browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        with browser.open(address[1], timeout=PATIENCE) as page:
            assert "This design" in page.read().decode()
        server.send_signal(signal.SIGINT)
        _, err = server.communicate(timeout=PATIENCE)
    assert (server.returncode, err.splitlines()[-1]) == (0, "stopped")
    assert "Traceback" not in err


def test_a_report_that_cannot_be_written_is_refused_by_its_place(folder: Path, tmp_path: Path) -> None:
    for place, rule in (("page.pdf", ".html or .htm"), ("none/page.html", "does not exist")):
        refused(activefail("report", folder, "--out", tmp_path / place), str(tmp_path / place), rule)


# --- signals and pipes -------------------------------------------------------------------------------------------


def test_a_signal_that_arrives_while_the_error_stream_writes_stops_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Writing(io.StringIO):
        def write(self, text: str) -> int:
            raise RuntimeError("reentrant call")

    monkeypatch.setattr("sys.stderr", Writing())
    with stop_on_signals() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop()


@pytest.mark.faults
def test_a_second_signal_in_the_middle_of_one_of_python_s_locks_is_an_interrupt_like_any_other() -> None:
    def struck(times: int) -> None:
        try:
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            pass
        # As `Semaphore.acquire` ends, which a thread pool calls for each of its tasks.
        raise RuntimeError("release unlocked lock")

    for times, expected in ((2, KeyboardInterrupt), (1, RuntimeError), (0, RuntimeError)):
        with pytest.raises(expected), stop_on_signals():
            struck(times)


@pytest.mark.faults
def test_a_ctrl_c_while_the_program_is_ending_has_no_traceback() -> None:
    script = (
        "import atexit, os, signal, sys, time\n"
        "atexit.register(lambda: (os.kill(os.getpid(), signal.SIGINT), time.sleep(600.0)))\n"
        "from activefail.cli import main\n"
        "sys.argv = ['activefail', '--version']\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


@pytest.mark.faults
def test_a_ctrl_c_ends_the_program_though_a_thread_of_its_own_never_ends(tmp_path: Path) -> None:
    # As one does not whose start a Ctrl-C met: Python leaves a lock of it taken.
    (tmp_path / "program.py").write_text(
        "import sys, threading\n"
        "from activefail.cli import app, program\n"
        "@app.command()\n"
        "def hang() -> None:\n"
        "    threading.Thread(target=threading.Event().wait).start()\n"
        "    raise KeyboardInterrupt\n"
        "sys.argv = ['activefail', 'hang']\n"
        "program()\n"
    )
    words = [sys.executable, str(tmp_path / "program.py")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr


@pytest.mark.faults
@pytest.mark.parametrize("command", COMMANDS_ON_FOLDERS)
def test_a_ctrl_c_ends_every_command_without_a_traceback(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def struck(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("activefail.record.run_folder.FolderStore._load", struck)
    result = activefail(command, folder, *COMMANDS_ON_FOLDERS[command])
    assert result.code == 130
    assert result.err == "activefail: stopped; recorded simulations are safe\n"


@pytest.mark.faults
def test_a_ctrl_c_while_a_campaign_starts_says_how_to_continue(tiny: Path, tmp_path: Path) -> None:
    words = ("run", tiny, "--out", tmp_path / "run")
    with holding("activefail.analyses.findings.ending:stop_messages", *words) as running:
        running.wait()
        err = struck_as_by_a_terminal(running.process)
    assert err.splitlines()[-1].endswith(f"Continue with: activefail resume {tmp_path / 'run'}")


@pytest.mark.faults
def test_a_ctrl_c_ends_the_comparison_of_a_run_folder_and_the_same_command_goes_on(folder: Path) -> None:
    words = ("compare", folder, "--test", "10")
    with holding("activefail.loop.learning:learn_from", *words) as running:
        running.wait()
        err = struck_as_by_a_terminal(running.process)
    assert err.splitlines()[-1] == "activefail: stopped; recorded simulations are safe"
    assert not (folder / "compare").exists()
    assert activefail(*words).code == 0


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_what_the_terminal_has_no_letters_for_is_written_by_its_number(
    tmp_path: Path, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_campaign(tmp_path / "mine.toml", f'description = "Brücke 桥"\n{TINY}')
    folder = tmp_path / os.fsdecode(b"run-\xff")
    assert activefail("run", tmp_path / "mine.toml", "--out", folder, "--budget", "20").code == 0
    monkeypatch.setenv("PYTHONIOENCODING", f"{encoding}:strict")
    result = ""
    for words in (["status", folder], ["export", folder, "--csv", folder / "all.csv"]):
        done = subprocess.run([sys.executable, "-m", "activefail.cli", *words], capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        result += done.stdout.decode(encoding)
    assert ("桥" if encoding == "utf-8" else r"\u6865") in result
    assert r"run-\udcff/all.csv" in result


def test_without_an_output_a_fault_is_told_all_the_same(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "activefail.cli", "status", str(tmp_path / ("n" * 300))]
    done = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *words], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.endswith(": File name too long")


def test_a_reader_that_goes_away_is_no_reason_for_a_traceback(ran: tuple[Path, CommandResult]) -> None:
    with started("status", ran[0]) as process:
        process.stdout.close()  # type: ignore[union-attr]
        process.stdout = None
        _, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (1, "")
