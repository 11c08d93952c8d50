"""Commands that only read a run folder load no library that they do not use, in a fresh interpreter."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from commandline import activefail

OLD_RUNS = Path(__file__).parent / "old_runs"

PROGRAM = """
import sys
from activefail.cli import main
try:
    main()
finally:
    print(*sorted({name.partition(".")[0] for name in sys.modules}), file=sys.stderr)
"""

MODEL = {"gpytorch", "botorch", "linear_operator"}
LEARNING = {*MODEL, "torch"}
ALL = {*LEARNING, "scipy", "numba", "matplotlib"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run folder with a classifier that this version saved, and a table of designs beside it."""
    run = Path(shutil.copytree(OLD_RUNS / "finished" / "paper", tmp_path_factory.mktemp("paper") / "run"))
    table = run.with_name("all.csv")
    assert activefail("export", run, "--csv", table).code == 0
    rows = [line.split(",")[3:12] for line in table.read_text().splitlines()]
    run.with_name("designs.csv").write_text("".join(f"{','.join(row)}\n" for row in rows))
    return run


@pytest.mark.parametrize(
    ("words", "unloaded"),
    [
        (["--version"], ALL),
        (["--help"], ALL),
        (["status", "run"], ALL),
        (["export", "run", "--csv", "again.csv"], {*LEARNING, "matplotlib"}),
        (["predict", "run", "--csv", "designs.csv", "--out", "predicted.csv"], {*LEARNING, "matplotlib"}),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_command_that_reads_loads_only_what_it_uses(words: list[str], unloaded: set[str], folder: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words], cwd=folder.parent, capture_output=True, text=True, check=True
    )
    loaded = set(result.stderr.splitlines()[-1].split())
    assert "activefail" in loaded
    assert not loaded & unloaded
