"""The commands of bearings: every one does what its help says, and every mistake ends in one message."""

import ctypes
import json
import os
import re
import shlex
import shutil
import signal
import threading
from pathlib import Path

import pytest
from cases import some
from commandline import activefail, holding, record, refused, struck_as_by_a_terminal, table, wait_for
from patience import PATIENCE

from activefail.seismic.bearing import TABLE_1

DESIGN = {
    "--t-b": "4.0",
    "--mu": "0.06",
    "--d-tot": "0.6",
    "--h-sl-ratio": "0.8",
    "--h-rim-ratio": "0.1",
    "--p": "50",
    "--k": "2e9",
    "--t-p": "2.0",
    "--a-p": "0.4",
}

ROW = "4.0,0.06,0.6,0.8,0.1,50,2e9,2.0,0.4"

STORED = Path(__file__).parent / "stored_run" / "paper"
HEADER = ",".join(TABLE_1.names)


def design(**other: str) -> list[str]:
    """The options of a design, some of them other than usual: `design(t_b="5")`."""
    options = DESIGN | {f"--{name.replace('_', '-')}": value for name, value in other.items()}
    return [word for option in options.items() for word in option]


def test_one_design_as_json_has_the_figures_of_its_table_and_nothing_else_on_standard_output(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text(f"{HEADER}\n{ROW}\n")
    table_of = ("--csv", tmp_path / "one.csv", "--out", tmp_path / "out.csv")
    shown = activefail("simulate", *design(), "--json", "--plot", tmp_path / "one.png")
    figures = json.loads(shown.out)
    assert f"plot       {tmp_path / 'one.png'}" in shown.err
    assert activefail("simulate", *table_of).code == 0
    (row,) = table(tmp_path / "out.csv")
    assert (figures["outcome"], figures["cause"]) == (row["outcome"], row["cause"])
    # The motion of one design is followed to its end.
    for name in ("first_touch_time", "failure_time"):
        assert figures["margins"][name] == float(row[name])
    refused(activefail("simulate", *table_of, "--json"), "--csv cannot be combined with --json")


def test_the_help_of_simulate_gives_the_unit_of_every_variable_that_has_one() -> None:
    lines = activefail("simulate", "--help").out.splitlines()
    for parameter in TABLE_1.parameters:
        option = "--" + parameter.name.lower().replace("_", "-") + " "
        (line,) = [line for line in lines if line.startswith(f"  {option}<")]
        assert f"[{parameter.unit}]" in line or not parameter.unit, line


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["explode"], "No such command 'explode'"),
        (["simulate", "--speed", "3"], "No such option: --speed"),
        (["simulate", "--mu", "rough"], "Invalid value for '--mu': must be a valid number, got 'rough'"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_refused_naming_what_does_not(words: list[str], says: str) -> None:
    result = activefail(*words)
    assert (result.code, result.out) == (2, "")
    assert says in result.err
    assert "Traceback" not in result.err


def test_without_an_impact_no_impact_is_told() -> None:
    result = activefail("simulate", *design(a_p="0.1", t_p="0.5"))
    assert re.search(r"^outcome +no_impact$", result.out, re.MULTILINE)
    assert not re.search(r"^(impact|failure) ", result.out, re.MULTILINE)


def test_a_design_outside_the_papers_ranges_is_simulated_with_a_note_that_names_value_and_range() -> None:
    result = activefail("simulate", *design(mu="0.3"))
    assert result.code == 0
    assert result.err == "note: mu = 0.3 lies outside the paper's range 0.02 to 0.12\n"


def test_a_failure_without_a_rim_touch_is_not_called_an_integration_that_gave_up() -> None:
    result = activefail("simulate", *design(p="45e6", h_sl_ratio="0.6", t_p="2.5", a_p="0.5"))  # Pa in place of MPa
    assert result.code == 1
    assert "numerical_failure (failure_without_rim_touch)\n" in result.out
    assert "failure criterion was met before the slider touched a rim" in result.out
    assert "gave up" not in result.out


def test_a_plot_and_a_film_are_written_and_named(tmp_path: Path) -> None:
    plot, film = tmp_path / "a.svg", tmp_path / "a.gif"
    result = activefail("simulate", *design(), "--plot", plot, "--animate", film)
    assert result.code == 0
    assert result.out.splitlines()[-2:] == [f"plot       {plot}", f"animation  {film}"]
    assert plot.read_text().startswith("<?xml")
    assert film.read_bytes().startswith(b"GIF8")


def test_a_table_is_simulated_and_the_outcomes_are_counted(tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER},site\n{ROW},A\n{ROW.replace('0.4', '0.1')},B\n")
    result = activefail("simulate", "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv")
    assert (result.code, result.err) == (0, "")
    rows = table(tmp_path / "out.csv")
    assert [row["site"] for row in rows] == ["A", "B"]
    counted = {name: int(n) for n, name in re.findall(r"(\d+) (\w+)(?:,|$)", result.out.splitlines()[0])}
    assert counted == {
        name: [row["outcome"] for row in rows].count(name)
        for name in ("no_impact", "impact", "failure", "numerical_failure")
    }
    assert result.out.splitlines()[1] == f"written to {tmp_path / 'out.csv'}"


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([], ["missing: --t-b, --mu, --d-tot, --h-sl-ratio, --h-rim-ratio, --p, --k, --t-p, --a-p", "--csv and --out"]),
        (["--csv", "in.csv"], ["--csv requires --out"]),
        (["--csv", "in.csv", "--out", "o.csv", "--mu", "0.1"], ["--csv cannot be combined with --mu"]),
        (["--csv", "in.csv", "--out", "o.csv", "--plot", "p.png"], ["--csv cannot be combined with --plot"]),
        (["--csv", "none.csv", "--out", "o.csv"], ["none.csv: cannot be read"]),
        ([*design(), "--out", "o.csv"], ["--out requires --csv"]),
        ([*design(), "--plot", "p.jpeg"], ["p.jpeg", ".png, .svg or .pdf"]),
        ([*design(), "--animate", "a.avi"], ["a.avi", "must end in .gif."]),
        ([*design(), "--animate", "none/a.gif"], ["none/a.gif: the folder", "does not exist"]),
        (design(mu="nan"), ["`mu > 0` must hold, got nan"]),
        (design(t_p="-1"), ["T_p", "> 0` must hold, got -1.0"]),
        (design(a_p="inf"), ["A_p", "must be finite, got inf"]),
        (design(d_tot="20"), ["`dish_diameter < 2 radius`", "20.3"]),
        ([*design(), "--restitution", "elastic"], ["`restitution`", "pairwise, assembly", "'elastic'"]),
        ([*design(), "--tolerance", "1"], ["1e-12 <= relative <= 0.01", "got 1.0"]),
        ([*design(), "--slider-diameter", "0"], ["`slider_diameter > 0` must hold, got 0.0"]),
        ([*design(), "--slider-diameter", "5"], ["`slider_diameter < 5` must hold, in m, got 5.0"]),
        ([*design(), "--friction-velocity", "0.2"], ["`friction_velocity <= 0.1` must hold, in m/s, got 0.2"]),
        ([*design(), "--friction-velocity", "-1"], ["`friction_velocity > 0` must hold, got -1.0"]),
        ([*design(), "--rim", "breaking"], ['rim = "breaking" requires `rim_strength`']),
        ([*design(), "--rim-strength", "0.8"], ['rim = "rigid" cannot be combined with `rim_strength`, got 0.8']),
    ],
)
def test_a_design_or_options_that_break_a_rule_are_refused(
    words: list[str], parts: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(activefail("simulate", *words), *parts)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("place", "reason"), [("none/out.csv", "No such file or directory"), ("", "Is a directory")])
def test_where_a_table_of_bearings_cannot_be_written_its_name_and_the_reason_are_told(
    tmp_path: Path, place: str, reason: str
) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    target = tmp_path / place
    result = activefail("simulate", "--csv", tmp_path / "in.csv", "--out", target)
    refused(result, f"{target}: cannot be written: {reason}.")


def test_where_a_plot_cannot_be_written_its_name_and_the_reason_are_told(tmp_path: Path) -> None:
    target = tmp_path / "p.png"
    target.mkdir()
    result = activefail("simulate", *design(), "--plot", target)
    assert result.code == 2
    assert f"activefail: {target}: cannot be written: Is a directory" in result.err


def test_the_bearing_is_described_and_checked(tmp_path: Path) -> None:
    (tmp_path / "bearing.toml").write_text("seed = 1\n")
    done = activefail("check", tmp_path / "bearing.toml")
    assert (done.code, "agrees" in done.out, "T_b [s]: 2.5 to 5.5" in done.out) == (0, True, True), done


@pytest.mark.parametrize("own", ["campaign.toml", "journal", "checkpoint.h5", "simulations/x/o.csv"])
def test_no_command_of_bearings_writes_over_a_run_folder_s_own_files(tmp_path: Path, own: str) -> None:
    folder = Path(shutil.copytree(STORED, tmp_path / "run"))
    own_files = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (tmp_path / "in.csv").write_text(f"{HEADER}\n{ROW}\n")
    (tmp_path / "link.svg").symlink_to(folder / own)
    for option, path, words in (
        ("--out", folder / own, ("simulate", "--csv", tmp_path / "in.csv")),
        ("--plot", tmp_path / "link.svg", ("simulate", *design())),
        ("--animate", folder / ".." / folder.name / own, ("simulate", *design())),
        ("--out", folder / own, ("paper",)),
    ):
        result = activefail(*words, option, path)
        refused(result, f"{option}: {path} is one of the run folder's own files; choose another.")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == own_files


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, str]]]:
    """A campaign file of twelve batches beyond the seed, and what it records when nothing interrupts it."""
    path = tmp_path_factory.mktemp("long") / "long.toml"
    path.write_text("seed = 5\nsampling = { initial = 20, budget = 80, batch = 5 }\n")
    assert activefail("run", path, "--out", path.with_name("straight")).code == 0
    return path, record(path.with_name("straight"))


@pytest.mark.faults
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_one_signal_ends_a_campaign_after_a_whole_batch_and_the_command_it_names_completes_it(
    long: tuple[Path, list[dict[str, str]]], tmp_path: Path, number: signal.Signals
) -> None:
    folder = tmp_path / "run"
    words = ("run", long[0], "--out", folder, "--workers", "2")
    # Five batches are done, of the sixth two simulations are.
    with holding("activefail.seismic.simulator:DfpSimulator.run", *words, passing=27) as running:
        process = running.process
        running.wait(2)
        process.send_signal(number)
        wait_for(process.stderr, "stopping after this batch; Ctrl-C again to stop now")
        running.release()
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "results" not in out
    assert len(record(folder)) == 30
    command = shlex.split(err.strip().splitlines()[-1].partition("Continue with: ")[2])
    assert command == ["activefail", "resume", str(folder)]

    assert activefail(*command[1:]).code == 0
    assert record(folder) == long[1]


@pytest.mark.faults
@pytest.mark.parametrize(
    ("first", "second"),
    [(signal.SIGINT, signal.SIGINT), (signal.SIGINT, signal.SIGTERM)],
)
def test_a_second_signal_ends_a_campaign_at_once_and_no_part_of_a_batch_is_kept(
    tmp_path: Path, first: signal.Signals, second: signal.Signals
) -> None:
    (tmp_path / "long.toml").write_text(
        "sampling = { initial = 500, budget = 500, batch = 500 }\nbearing.tolerance = 1e-9\n"
    )
    words = ("run", tmp_path / "long.toml", "--out", tmp_path / "run", "--workers", "2")
    with holding("activefail.seismic.simulator:DfpSimulator.run", *words) as running:
        process = running.process
        running.wait(2)
        process.send_signal(first)
        wait_for(process.stderr, "stopping after this batch")
        process.send_signal(second)
        # The calls in flight are waited for, the others would take many times as long.
        running.release()
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert err.splitlines()[-1] == (
        f"stopped; recorded batches are safe. Continue with: activefail resume {tmp_path / 'run'}"
    )
    assert record(tmp_path / "run") == []


def test_a_ctrl_c_that_meets_a_call_from_compiled_code_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def struck() -> None:
        raise KeyboardInterrupt

    def compiling(*arguments: object) -> None:
        ctypes.CFUNCTYPE(None)(struck)()
        threading.Event().wait(PATIENCE)
        pytest.fail("nothing came")

    monkeypatch.setattr("activefail.seismic.paper.study.run_study", compiling)
    result = activefail("paper", "--out", tmp_path / "paper")
    assert (result.code, result.err) == (130, "stopped; nothing was saved. Run the same command to start over.\n")


@pytest.mark.faults
@pytest.mark.parametrize("place", some(["simulated", "study_draw"], "simulated"))
def test_a_ctrl_c_ends_the_reproduction_with_all_its_processes(tmp_path: Path, place: str) -> None:
    words = ("paper", "--draws", "4", "--fresh", "100", "--out", tmp_path / "paper")
    with holding(f"activefail.seismic.paper.study:{place}", *words) as running:
        running.wait()
        err = struck_as_by_a_terminal(running.process)
    assert err.splitlines()[-1] == "stopped; nothing was saved. Run the same command to start over."
    assert list((tmp_path / "paper").iterdir()) == []


def test_a_table_that_is_interrupted_leaves_nothing_behind_and_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text(f"{HEADER}\n" + f"{ROW}\n" * 100)
    words = ("simulate", "--csv", tmp_path / "in.csv", "--out", tmp_path / "out.csv")
    with holding("activefail.seismic.tables:simulate", *words) as running:
        process = running.process
        running.wait()
        assert len(os.listdir(tmp_path)) == 2
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert os.listdir(tmp_path) == ["in.csv"]
