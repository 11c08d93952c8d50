"""The sdist gives a wheel that works in an environment of its own, without the repository."""

import os
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

SCRIPT = """
import sys
import numpy as np
import activefail
from activefail.cli import main
assert activefail.__file__.startswith(sys.prefix), activefail.__file__
side = {"low": -2.0, "high": 2.0}
settings = {
    "simulator": {"elsewhere": True, "margins": ["g"]},
    "space": {"x": side, "y": side},
    "sampling": {"initial": 10, "budget": 20},
}
with activefail.create_run("circle", settings) as run:
    while len(designs := run.ask(10)):
        run.tell(designs.assign(g=np.hypot(designs["x"], designs["y"]) - 1.0))
with open("designs.csv", "w") as file:
    file.write("x,y\\n0,0\\n1.9,1.9\\n")
for command in '''activefail campaigns --copy mine
activefail create mine/bearing.toml --out bearing
activefail create quick --out quick
activefail ask quick --n 3 --csv todo.csv
activefail predict circle --csv designs.csv --out predicted.csv'''.splitlines():
    sys.argv = command.split()
    try:
        main()
    except SystemExit as left:
        assert not left.code, (command, left.code)
"""


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked sdist."""
    from hatchling.builders.sdist import SdistBuilder

    folder = tmp_path_factory.mktemp("sdist")
    (built,) = SdistBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    with tarfile.open(built) as archive:
        archive.extractall(folder, filter="data")
    return Path(built.removesuffix(".tar.gz"))


@pytest.fixture(scope="module")
def environment(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel that the sdist gives; only the libraries are those of the tests."""
    from hatchling.builders.wheel import WheelBuilder

    folder = tmp_path_factory.mktemp("wheel")
    (wheel,) = WheelBuilder(str(sdist)).build(directory=str(folder), versions=["standard"])
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel]
    subprocess.run(pip, check=True)
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    # A folder that a .pth file names is searched last, and its own .pth files, such as that of an editable install, are
    # not read.
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "venv" / "bin"


def test_the_sdist_has_what_a_distributor_needs(sdist: Path) -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode:  # the tests of an sdist itself
        expected = {"pyproject.toml", "README.md", "CITATION.cff", "docs/conf.py", "tests/test_package.py"}
    else:
        expected = {name for name in tracked.stdout.splitlines() if not name.startswith(".")}
    assert not [name for name in expected if not (sdist / name).exists()]


@pytest.mark.slow
def test_the_wheel_works_without_the_repository(environment: Path, tmp_path: Path) -> None:
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}

    def run(*words: str | Path) -> str:
        done = subprocess.run(words, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "quick" in run(environment / "activefail", "campaigns")
    # The other commands in one process: most of a command's time is what it imports.
    run(environment / "python", "-c", SCRIPT)
    rows = (tmp_path / "predicted.csv").read_text().splitlines()
    inside, outside = (float(row.split(",")[rows[0].split(",").index("p_failure")]) for row in rows[1:])
    assert outside < 0.5 < inside
