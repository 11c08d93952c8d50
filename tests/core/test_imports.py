"""Commands that only read a run folder load no library that they do not use, in a fresh interpreter."""

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from commandline import activefail
from patience import PATIENCE, until
from pounding import write_campaign

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
def folder(tmp_path_factory: pytest.TempPathFactory, simulations_in_this_process: None) -> Path:
    """A finished run folder with a classifier that this version saved, and a table of designs beside it."""
    home = tmp_path_factory.mktemp("home")
    run = home / "run"
    file = write_campaign(home / "made.toml", "sampling = { initial = 20, budget = 20 }\n")
    assert activefail("run", file, "--out", run).code == 0
    table = run.with_name("all.csv")
    assert activefail("export", run, "--csv", table).code == 0
    rows = [line.split(",")[3:7] for line in table.read_text().splitlines()]
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


def test_a_campaign_with_a_custom_simulator_and_without_the_bearing_loads_no_numba(tmp_path: Path) -> None:
    (tmp_path / "plate.py").write_text("def run(design):\n    return 1.3 - design['x'] - design['y']\n")
    (tmp_path / "plate.toml").write_text(
        "sampling = { initial = 10, budget = 10 }\nsimulator = { python = 'plate:run', margins = ['g'] }\n"
        "space = { x = { low = 0, high = 1 }, y = { low = 0, high = 1 } }\n"
    )
    words = ["run", "plate.toml", "--out", "run", "--workers", "1"]
    command = [sys.executable, "-c", PROGRAM, *words]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = set(result.stderr.splitlines()[-1].split())
    assert "torch" in loaded
    assert "numba" not in loaded


SLOW_TO_IMPORT = """
import os
import threading
open(os.environ["IMPORTING"], "w").close()
threading.Event().wait(600)
"""


def entry_point() -> str:
    """What the installed program `activefail` runs."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    module, function = project["project"]["scripts"]["activefail"].split(":")
    return f"from {module} import {function}; {function}()"


@pytest.mark.parametrize("words", [["-m", "activefail"], ["-c", entry_point()]], ids=["module", "program"])
def test_a_ctrl_c_while_the_program_is_loaded_ends_it_without_a_traceback(words: list[str], tmp_path: Path) -> None:
    # The first library that the command line imports.
    (tmp_path / "typer.py").write_text(SLOW_TO_IMPORT)
    importing = tmp_path / "importing"
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    process = subprocess.Popen(
        [sys.executable, *words, "--version"],
        env=os.environ | {"PYTHONPATH": path, "IMPORTING": str(importing)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell has its background jobs ignore Ctrl-C, and what they start would too.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        until(importing.exists, "the import of typer")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (130, "", "activefail: stopped\n")
