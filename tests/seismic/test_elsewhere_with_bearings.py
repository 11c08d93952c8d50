"""Campaigns on bearings that are simulated elsewhere have the bits of those that activefail simulates itself."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from commandline import activefail, record, table
from test_elsewhere import written

import activefail as af

BEARING = """
seed = 5
sampling = { initial = 8, budget = 16, batch = 4 }
"""


@pytest.fixture(scope="module")
def bearing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, str]]]:
    """The campaign file of a small campaign on the bearing, and its record as `activefail run` makes it."""
    file = tmp_path_factory.mktemp("bearing") / "bearing.toml"
    file.write_text(BEARING)
    assert activefail("run", file, "--out", file.with_name("run")).code == 0
    return file, record(file.with_name("run"))


def simulated(designs: pd.DataFrame) -> pd.DataFrame:
    names = list(af.TABLE_1.names)
    answers = af.simulate(designs[names].to_numpy())
    margins = pd.DataFrame(answers.columns, columns=[*_margins()])
    return pd.concat([designs[["id"]], margins], axis=1).assign(outcome=answers.outcome_name, cause=answers.cause_name)


def _margins() -> tuple[str, ...]:
    from activefail.seismic.bearing.outcome import COLUMNS

    return tuple(COLUMNS)


def test_the_bearing_asked_for_and_told_from_a_script_has_the_bits_of_run(
    bearing: tuple[Path, list[dict[str, str]]], tmp_path: Path
) -> None:
    file, whole = bearing
    with af.create_run(str(tmp_path / "run"), str(file)) as run:
        while len(designs := run.ask(4)):
            assert run.tell(simulated(designs)) == len(designs)
        assert run.ask(1).attrs["reason"] == "the campaign's budget of 16 simulations allows no more (in flight: 0)"
    assert record(tmp_path / "run") == whole


@pytest.mark.slow
def test_the_bearing_through_csv_files_from_two_shells_in_turns_has_the_bits_of_run(
    bearing: tuple[Path, list[dict[str, str]]], tmp_path: Path
) -> None:
    file, whole = bearing
    folder, todo, answers = (tmp_path / name for name in ("run", "todo.csv", "answers.csv"))

    def shell(*words: str | Path) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "activefail.cli", *map(str, words)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert activefail("create", file, "--out", folder).out.splitlines()[1:] == [
        f"continue   activefail resume {folder}",
        f"           activefail ask {folder} --n 4 --csv todo.csv, to have designs simulated elsewhere",
    ]
    for batch in range(4):
        # The designs of one shell are simulated by another, which gets all their digits from the table; the last batch
        # is chosen from what yet another has told.
        if batch == 3:
            shell("ask", folder, "--n", "4", "--csv", todo)
        else:
            assert activefail("ask", folder, "--n", "4", "--csv", todo).code == 0
        assert activefail("simulate", "--csv", todo, "--out", answers).code == 0
        rows = table(answers)
        # In any order within a call; over several calls the earlier designs first, as the loop would get them.
        parts = [rows[:1], rows[:0:-1]] if batch % 2 else [rows[::-1]]
        for part in parts:
            if batch == 2:
                shell("tell", folder, "--csv", written(tmp_path / "part.csv", part))
            else:
                assert activefail("tell", folder, "--csv", written(tmp_path / "part.csv", part)).code == 0
    assert record(folder) == whole


@pytest.mark.exhaustive
def test_the_paper_s_campaign_by_hand_has_the_bits_of_run(tmp_path: Path) -> None:
    file, todo, answers = (
        Path(__file__).parents[2] / "campaigns" / "paper.toml",
        tmp_path / "todo",
        tmp_path / "answers",
    )
    whole, script, shells = (tmp_path / name for name in ("whole", "script", "shells"))

    def shell(*words: str | Path) -> None:
        done = subprocess.run(
            [sys.executable, "-m", "activefail.cli", *map(str, words)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr

    shell("run", file, "--out", whole)
    with af.create_run(script, file) as run:
        run.tell(simulated(run.ask(250)))
        while len(designs := run.ask(10)):
            run.tell(simulated(designs))
    assert len(record(whole)) == 500
    assert record(script) == record(whole)

    shell("create", file, "--out", shells)
    for count in (250, *(10 for _ in range(25))):
        shell("ask", shells, "--n", str(count), "--csv", todo)
        shell("simulate", "--csv", todo, "--out", answers)
        shell("tell", shells, "--csv", answers)
    assert record(shells) == record(whole)
