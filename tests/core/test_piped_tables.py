"""Tables through pipes, predictions as of earlier simulations, and exports: `-`, `--after` and `--parquet`."""

import importlib
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import some
from commandline import CommandResult, activefail, refused, table
from pounding import write_campaign

import activefail as af
from activefail.errors import InputError
from activefail.session.display import campaign_display

MODEL = """
import numpy as np

def run(design):
    if design["x"] < 0.05:
        raise ValueError("fog")
    margin = 1.3 - design["x"] - design["y"]
    margins = {"m": margin, "half": None if margin > 1 else 1.0}
    return {"outcome": "failure" if margin <= 0 else "safe", "margins": margins}

def features(X, space):
    print("loud code")
    return X[:, :1] * X[:, 1:]
"""

SETTINGS = """
seed = 3
sampling = {{ initial = 12, budget = 24, batch = 4{asynchronous} }}
limits.numerical_failures = 0.5
simulator = {{ python = "model:run", margins = ["m", "half"] }}
classifier = {{ features = {{ python = "model:features" }}, learns = "{learns}" }}
[space]
x = {{ low = 0, high = 1, unit = "m" }}
y = {{ low = 0, high = 1 }}
"""

DESIGNS = "site,x,y\nA,0.2,0.3\nB,0.9,0.8\nC,0.6,0.7\n"


def folder_of(home: Path, learns: str = "outcomes", asynchronous: bool = False) -> Path:
    """A folder with the code and its campaign file."""
    (home / "model.py").write_text(MODEL)
    extra = ", asynchronous = true" if asynchronous else ""
    (home / "model.toml").write_text(SETTINGS.format(learns=learns, asynchronous=extra))
    return home


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Code, campaign file, and the campaign in `run`, taken to its budget; not to be changed."""
    home = folder_of(tmp_path_factory.mktemp("home"))
    (home / "designs.csv").write_text(DESIGNS)
    assert activefail("run", home / "model.toml", "--out", home / "run", "--workers", "1").code == 0
    return home


@pytest.fixture
def piped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Runs a command in an empty folder with a text as standard input."""
    monkeypatch.chdir(tmp_path)

    def run(text: str | bytes, *words: str | Path) -> CommandResult:
        data = text.encode() if isinstance(text, str) else text
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        result = activefail(*words)
        assert not os.path.lexists("-")
        return result

    return run


def predict(home: Path, *words: str | Path) -> tuple[str | Path, ...]:
    return ("predict", home / "run", "--code", home, *words)


# --- pipes -------------------------------------------------------------------------------------------------------


def test_a_prediction_through_pipes_is_the_table_in_files_and_all_else_goes_to_standard_error(
    home: Path, tmp_path: Path, piped
) -> None:
    assert activefail(*predict(home, "--csv", home / "designs.csv", "--out", tmp_path / "out.csv")).code == 0
    expected = (tmp_path / "out.csv").read_text()
    result = piped(DESIGNS, *predict(home, "--csv", "-", "--out", "-"))
    assert (result.code, result.out) == (0, expected)
    assert "loud code\n" in result.err
    assert result.err.endswith("written to standard output\n")
    result = piped("\ufeff" + DESIGNS.replace("\n", "\r\n"), *predict(home, "--csv", "-", "--out", "again.csv"))
    assert (result.code, (tmp_path / "again.csv").read_text()) == (0, expected)
    assert piped("", *predict(home, "--csv", home / "designs.csv", "--out", "-")).out == expected


@pytest.mark.parametrize("output", ["-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"])
def test_an_export_to_standard_output_is_the_exported_file(home: Path, tmp_path: Path, piped, output: str) -> None:
    assert activefail("export", home / "run", "--code", home, "--csv", tmp_path / "all.csv").code == 0
    result = piped("", "export", home / "run", "--code", home, "--csv", output)
    assert (result.code, result.out) == (0, (tmp_path / "all.csv").read_text())
    assert result.err.endswith("24 simulations written to standard output\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{DESIGNS}D,0.5,wide\n", "row 4 (line 5), column y: must be a number, got 'wide'."),
        ("", "is empty"),
    ],
)
def test_a_bad_table_on_standard_input_is_refused_and_no_row_is_written(
    home: Path, piped, text: str | bytes, says: str
) -> None:
    result = piped(text, *predict(home, "--csv", "-", "--out", "-"))
    assert (result.code, result.out) == (2, "")
    assert f"\nactivefail: standard input: {says}" in f"\n{result.err}"


def test_a_quoted_line_break_and_letters_of_other_scripts_reach_the_pipe_unchanged(home: Path, piped) -> None:
    result = piped('note,x,y\n"2 of 3\r\nBrücke\x1b[1m",0.1,0.2\n', *predict(home, "--csv", "-", "--out", "-"))
    assert result.code == 0
    assert '"2 of 3\r\nBrücke\x1b[1m",' in result.out


def run_to(stdout: int, *words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "activefail.cli", *map(str, words)]
    return subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
    )


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("export", "run", "--code", ".", "--csv", "-"), {"loud code"}),
        (("status", "run"), set()),
        (("status", "run", "--json"), set()),
        (("campaigns",), set()),
        (("run", "--help"), set()),
        (("--version",), set()),
    ],
)
def test_a_closed_pipe_ends_a_command_quietly(
    home: Path, words: tuple[str, ...], said: set[str], unbuffered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(home)
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "wb", closefd=True) as pipe:
        done = run_to(pipe.fileno(), *words, PYTHONUNBUFFERED=unbuffered)
    assert done.returncode == 1
    assert set(done.stderr.splitlines()) == said


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no full device")
@pytest.mark.parametrize("words", [("export", "run", "--code", ".", "--csv", "-"), ("status", "run", "--json")])
def test_an_output_that_is_full_ends_a_command_with_the_reason(
    home: Path, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(home)
    with open("/dev/full", "wb") as full:
        done = run_to(full.fileno(), *words, PYTHONUNBUFFERED="")
    assert done.returncode == 1
    assert done.stderr.endswith("activefail: output: No space left on device\n")


def test_a_pipe_gets_utf_8_whatever_the_terminal_s_encoding(home: Path, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("note,x,y\nBrücke,0.1,0.2\n", encoding="utf-8")
    with open(tmp_path / "out.csv", "wb") as out:
        words = predict(home, "--csv", tmp_path / "in.csv", "--out", "-")
        done = run_to(out.fileno(), *words, PYTHONIOENCODING="latin-1", PYTHONUTF8="0")
    assert done.returncode == 0, done.stderr
    assert "Brücke," in (tmp_path / "out.csv").read_text(encoding="utf-8")


# --- predictions as of earlier simulations -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `home`, with a classifier that learns from what the parameter says."""
    if request.param == "outcomes":
        return Path(request.getfixturevalue("home"))
    home = folder_of(tmp_path_factory.mktemp("whole"), request.param)
    (home / "designs.csv").write_text(DESIGNS)
    assert activefail("run", home / "model.toml", "--out", home / "run", "--workers", "1").code == 0
    return home


# After the initial design, after some batches, and after all.
@pytest.mark.parametrize("number", some([12, 16, 20, 24], 12, 20, 24))
@pytest.mark.parametrize("whole", ["outcomes", "m"], indirect=True)
def test_a_prediction_after_whole_batches_has_the_bits_of_the_shorter_campaign(
    whole: Path, tmp_path: Path, number: int
) -> None:
    short = whole / "run"
    if number < 24:
        short = tmp_path / "run"
        words = ("--out", short, "--budget", str(number), "--workers", "1")
        assert activefail("run", whole / "model.toml", *words).code == 0
    tables = ("--csv", whole / "designs.csv", "--out")
    assert activefail("predict", short, "--code", whole, *tables, tmp_path / "short.csv").code == 0
    result = activefail(*predict(whole, *tables, tmp_path / "after.csv", "--after", str(number)))
    assert result.code == 0
    assert (tmp_path / "after.csv").read_bytes() == (tmp_path / "short.csv").read_bytes()


def test_an_asynchronous_campaign_predicts_as_of_earlier_simulations_with_the_same_bits(tmp_path: Path) -> None:
    home = folder_of(tmp_path, asynchronous=True)
    X = np.array([[0.2, 0.3], [0.9, 0.8]])
    with af.create_run(home / "run", home / "model.toml") as run:
        run.take(budget=18)
        number, earlier = len(run.history), run.classifier.probabilities(X)
        run.take()
        assert len(run.history) > number
        assert run.classifier_after(number).probabilities(X).tobytes() == earlier.tobytes()


def test_a_prediction_may_begin_with_the_first_outcome_and_end_within_a_batch(home: Path, tmp_path: Path) -> None:
    with af.open_run(home / "run", code=home) as run:
        first = run.history.leading_failures + 1
        for number in (first, first + 1, 12, 14, 23):
            latent = run.classifier_after(number).latents[0]
            assert len(latent.features) == run.history[:number].answered.sum()
        assert run.classifier_after(24) is run.classifier
        out = tmp_path / "out.csv"
        assert run.predict_table(home / "designs.csv", out, after=14) == 0
        assert len(table(out)) == 3


@pytest.mark.parametrize("number", [0, 25, -1])
def test_a_number_of_simulations_that_is_not_recorded_is_refused(home: Path, tmp_path: Path, number: int) -> None:
    words = ("--csv", home / "designs.csv", "--out", tmp_path / "out.csv", f"--after={number}")
    rule = "must be at least 1" if number < 1 else "must be from 1, the first with an outcome, to 24, the number of"
    result = activefail(*predict(home, *words))
    assert result.code == 2
    assert f"activefail: after: {rule}" in result.err
    assert result.err.endswith(f"got {number}.\n")
    assert not (tmp_path / "out.csv").exists()


def test_a_warning_about_unseen_outcomes_is_that_of_the_first_simulations(home: Path, tmp_path: Path) -> None:
    words = predict(home, "--csv", home / "designs.csv", "--out", tmp_path / "out.csv")
    with af.open_run(home / "run", code=home) as run:
        first = run.history.leading_failures
        other = ("failure", "safe")[run.history.outcome[first]]
    assert "warning" not in activefail(*words).err
    warning = f"None of the campaign's 1 simulations ended in {other}"
    assert warning in activefail(*words, "--after", str(first + 1)).err


# --- Parquet -----------------------------------------------------------------------------------------------------


def test_a_parquet_file_has_the_columns_of_the_csv_table_with_types_nulls_and_units(home: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is an optional extra (activefail[parquet])")
    result = activefail("export", home / "run", "--code", home, "--parquet", tmp_path / "all.parquet")
    assert (result.code, result.out.splitlines()[-1]) == (0, f"24 simulations written to {tmp_path / 'all.parquet'}")
    assert activefail("export", home / "run", "--code", home, "--csv", tmp_path / "all.csv").code == 0
    assert sorted(os.listdir(tmp_path)) == ["all.csv", "all.parquet"]
    read = parquet.read_table(tmp_path / "all.parquet")
    kinds = {name: str(kind) for name, kind in zip(read.column_names, read.schema.types, strict=True)}
    assert kinds == {
        **dict.fromkeys(("id", "iteration"), "int64"),
        **dict.fromkeys(("origin", "outcome", "cause"), "string"),
        **dict.fromkeys(("x", "y", "m", "half", "seconds"), "double"),
    }
    rows = table(tmp_path / "all.csv")
    assert read.column_names == list(rows[0])
    for name, column in read.to_pydict().items():
        cells = [row[name] for row in rows]
        assert ["" if value is None else str(value) for value in column] == cells
    assert read["half"].null_count == sum(row["half"] == "" for row in rows) > 0
    assert read.schema.field("x").metadata == {b"unit": b"m"}
    assert read.schema.field("seconds").metadata == {b"unit": b"s"}
    assert read.schema.field("y").metadata is None


def test_a_campaign_without_simulations_is_exported_as_columns_without_rows(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is an optional extra (activefail[parquet])")
    home = folder_of(tmp_path)
    with af.create_run(home / "run", home / "model.toml") as run:
        assert run.export_parquet(home / "none.parquet") == 0
    assert parquet.read_table(home / "none.parquet").num_rows == 0


def test_without_pyarrow_the_command_that_installs_it_is_named(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with (
        af.open_run(home / "run", code=home) as run,
        pytest.raises(
            InputError, match=r"requires the package pyarrow; install it with `pip install 'activefail\[parq"
        ),
    ):
        run.export_parquet(tmp_path / "all.parquet")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "export: requires --csv or --parquet, got neither."),
        (("--csv", "a.csv", "--parquet", "a.parquet"), "export: requires --csv or --parquet, got both."),
        (("--parquet", "-"), "--parquet: must be a file, got '-'; only a CSV table can go to standard output."),
    ],
)
def test_an_export_has_one_target(home: Path, piped, words: tuple[str, ...], says: str) -> None:
    refused(piped("", "export", home / "run", *words), says)
    assert os.listdir() == []


# --- what a campaign seeks ---------------------------------------------------------------------------------------


def test_a_display_on_a_terminal_says_it_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = folder_of(tmp_path)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stdout", screen)
    with af.create_run(home / "run", home / "model.toml") as run, campaign_display(run.campaign, lambda: False):
        pass
    assert "seeking    the boundary of failure (outcomes from least" in screen.getvalue()


def test_with_several_target_boundaries_each_is_named_with_its_share(tmp_path: Path) -> None:
    text = "sampling = { initial = 2, budget = 2 }\nacquisition.boundary = { failure = 3, impact = 1 }\n"
    write_campaign(tmp_path / "both.toml", text)
    result = activefail("run", tmp_path / "both.toml", "--out", tmp_path / "run")
    assert result.out.splitlines()[0] == (
        "seeking    the boundary of failure (75 %) and the boundary of impact (25 %) "
        "(outcomes from least to most severe: no_impact, impact, failure)"
    )
