"""`make` installs from any index; `.ci/run` installs what some tests need, and what it found may not be skipped."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[1]

WHEEL = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
METADATA = "Metadata-Version: 2.1\nName: activefail\nVersion: 0\nRequires-Dist: torch\nProvides-Extra: dev\n"

# A build backend inside the project, so that nothing is fetched but what the index of the test has.
BACKEND = f"""
from zipfile import ZipFile

def build_editable(folder, config_settings=None, metadata_directory=None):
    with ZipFile(folder + "/activefail-0-py3-none-any.whl", "w") as wheel:
        wheel.writestr("activefail-0.dist-info/METADATA", {METADATA!r})
        wheel.writestr("activefail-0.dist-info/WHEEL", {WHEEL!r})
        wheel.writestr("activefail-0.dist-info/RECORD", "")
    return "activefail-0-py3-none-any.whl"
"""
PROJECT = """
[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]
"""


def stub(folder: Path, version: str) -> str:
    """An empty wheel of torch; its file name."""
    name, info = f"torch-{version}-py3-none-any.whl", f"torch-{version}.dist-info"
    with ZipFile(folder / name, "w") as wheel:
        wheel.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: torch\nVersion: {version}\n")
        wheel.writestr(f"{info}/WHEEL", WHEEL)
        wheel.writestr(f"{info}/RECORD", "")
    return name


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a CPU build of its own")
@pytest.mark.parametrize(
    ("offered", "taken", "large"),
    [(["2.13.0", "2.14.0"], "2.13.0", True), (["2.13.0", "2.13.0+cpu", "2.14.0"], "2.13.0+cpu", False)],
    ids=["default index", "index with a CPU build"],
)
def test_make_installs_from_any_index_and_announces_the_large_build(
    offered: list[str], taken: str, large: bool, tmp_path: Path
) -> None:
    for name in ("Makefile", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "pyproject.toml").write_text(PROJECT)
    (tmp_path / "backend.py").write_text(BACKEND)
    index = tmp_path / "simple" / "torch"
    index.mkdir(parents=True)
    wheels = [stub(index, version) for version in offered]
    (index / "index.html").write_text("".join(f'<a href="{name.replace("+", "%2B")}">{name}</a>\n' for name in wheels))
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "MAKE"))}
    environment |= {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": index.parent.as_uri(), "PIP_NO_CACHE_DIR": "1"}
    command = ["make", f"PYTHON={sys.executable}", ".venv/.installed"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [path.name for path in (tmp_path / ".venv").rglob("torch-*")] == [f"torch-{taken}.dist-info"]
    said = [line for line in done.stdout.splitlines() if "the default build is coming, several GB" in line]
    assert len(said) == large


def test_ci_goes_on_to_the_tests_where_nothing_can_be_installed(tmp_path: Path) -> None:
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
    commands = tmp_path / "bin"
    commands.mkdir()
    for name, script in {"make": 'echo "make $*, required:$ACTIVEFAIL_REQUIRE."', "python3": "exit 1"}.items():
        (commands / name).write_text(f"#!/bin/sh\n{script}\n")
    for name in ("apt-get", "dpkg-query", "which"):
        (commands / name).write_text("#!/bin/sh\nexit 1\n")
    for path in commands.iterdir():
        path.chmod(0o755)
    unset = {"PYTHON", "ACTIVEFAIL_REQUIRE", "ACTIVEFAIL_OPENSEES_PYTHON"}
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment["PATH"] = f"{commands}{os.pathsep}{environment['PATH']}"
    done = subprocess.run(
        [tmp_path / ".ci" / "run"], env=environment, capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert "install" in lines[0]
    assert "chromium" in lines[0]
    assert "ci: pip could not install openseespy" in lines
    assert "ci: pip could not install the records of FEMA P695" in lines
    assert "ci: records is not to be had here: its tests are skipped" in lines
    assert "ci: browser is not to be had here: its tests are skipped" in lines
    assert lines[-2:] == ["make test, required:.", "make test-faults, required:."]


@pytest.mark.parametrize(("required", "counts"), [("browser openseespy", "1 error"), ("browser", "1 skipped")])
def test_a_test_that_is_skipped_for_want_of_a_required_tool_fails(required: str, counts: str, tmp_path: Path) -> None:
    claim = "test_opensees.py::test_the_answer_is_written_to_the_file_and_nothing_else_to_stdout"
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"tests/simulators/{claim}"]
    environment = os.environ | {"ACTIVEFAIL_REQUIRE": required, "ACTIVEFAIL_OPENSEES_PYTHON": str(tmp_path / "none")}
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert counts in done.stdout.splitlines()[-1], done.stdout
    assert "has no openseespy: No such file or directory" in done.stdout
