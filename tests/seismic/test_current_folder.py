"""The current folder may come from someone else: no library reads its settings there."""

import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from commandline import activefail

from activefail.seismic.bearing.kernels import folder_of_kernels

STORED = Path(__file__).parent / "stored_run" / "paper"
DESIGN = ["--t-b", "4", "--mu", "0.06", "--d-tot", "0.6", "--h-sl-ratio", "0.8", "--h-rim-ratio", "0.1"]
DESIGN += ["--p", "45", "--k", "2e9", "--t-p", "2", "--a-p", "0.3"]

WATCHED = """
import os, sys
here = os.getcwd()
read = []

def watch(event, arguments):
    if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str):
        path = os.path.abspath(arguments[0])
        if path.startswith(here + "/") and not path.startswith(here + "/run/"):
            read.append(path)

sys.addaudithook(watch)
from activefail.__main__ import program
try:
    program()
finally:
    print(*read, file=sys.stderr)
"""
"""The program; the last line on standard error names the files of the current folder that it opens."""

SETTINGS = {
    ".numba_config.yaml": "cache_dir: stolen\nopt: '0'\n",
    "matplotlibrc": "text.usetex: True\n",
    **dict.fromkeys(("dask.yaml", ".config/dask/dask.yaml", "distributed.yaml"), "distributed: [\n"),
    **dict.fromkeys((".env", "setup.cfg", "pyproject.toml", "pytest.ini", "mplstyle"), "[\n"),
    **dict.fromkeys(("_ops.py", "_classes.py", "numpy.py", "sitecustomize.py", "conftest.py", "yaml.py"), "1 / 0\n"),
    "evil-1.dist-info/entry_points.txt": "[numba_extensions]\ninit = yaml:init\n[pydantic]\nevil = yaml:init\n",
}
"""Files that a library might read in the current folder, none of them what it expects."""


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder from someone else, with a run folder in it."""
    folder = tmp_path / "foreign"
    shutil.copytree(STORED, folder / "run")
    for name, text in SETTINGS.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def run_in(folder: Path, code: str, *words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Python code in a process of its own, in a folder."""
    unset = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    command = [sys.executable, "-P", "-c", code, *map(str, words)]
    return subprocess.run(
        command, cwd=folder, env=unset | environment, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(["simulate", *DESIGN, "--plot", "../plot.png"], id="simulate"),
        pytest.param(["report", "run", "--out", "../report.html"], id="report", marks=pytest.mark.exhaustive),
        pytest.param(["export", "run", "--parquet", "../all.parquet"], id="export"),
        pytest.param(["sensitivity", "run", "--samples", "16"], id="sensitivity", marks=pytest.mark.exhaustive),
    ],
)
def test_a_command_opens_no_file_of_the_current_folder_that_it_is_not_given(words: list[str], foreign: Path) -> None:
    done = run_in(foreign, WATCHED, *words)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == ""


class _Stolen:
    """When it is unpickled, it creates the file `ran`."""

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return open, ("ran", "w")


@pytest.mark.parametrize("environment", [{}, {"NUMBA_CACHE_DIR": "stolen"}], ids=["file", "environment"])
def test_kernels_in_a_folder_that_is_named_relative_to_the_current_folder_do_not_run(
    foreign: Path, environment: dict[str, str]
) -> None:
    assert activefail("simulate", *DESIGN).code == 0
    own = folder_of_kernels()
    (foreign / ".numba_config.yaml").write_text("cache_dir: stolen\n")
    for kernel in own.rglob("*.nbi"):
        copy = foreign / "stolen" / kernel.relative_to(own.parents[1])
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(pickle.dumps(_Stolen()))
    assert list(foreign.rglob("*.nbi"))
    done = run_in(foreign, WATCHED, "simulate", *DESIGN, "--json", **environment)
    assert json.loads(done.stdout)["outcome"]
    assert not (foreign / "ran").exists()


def test_a_relative_cache_in_the_environment_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "cache")
    assert folder_of_kernels(tmp_path).is_relative_to(tmp_path / "__pycache__")
    assert folder_of_kernels(tmp_path / "not writable").is_relative_to("/dev/null")


@pytest.mark.parametrize("imports", ["import activefail", "import numba, activefail", "import activefail, numba"])
def test_numba_compiles_with_the_options_of_the_environment_alone(imports: str, foreign: Path) -> None:
    code = f"{imports}\nfrom activefail.seismic.bearing.kernels import compiler_options\nimport numba\n"
    code += "numba.njit(lambda x: x + 1.0)(2.0)\nprint(compiler_options())"
    assert run_in(foreign, code).stdout == "defaults\n"
    assert run_in(foreign, code, NUMBA_OPT="1").stdout == "NUMBA_OPT=1\n"
