"""`make` installs from any index; `.ci/run` installs what some tests need, and what it found may not be skipped."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]

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
def test_make_installs_from_any_index_and_announces_the_large_build(tmp_path: Path) -> None:
    for name in ("Makefile", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "backend.py").write_text(BACKEND)
    index = tmp_path / "simple" / "torch"
    # The second time the environment stays that of the first: making one takes longer than all else.
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\n[ "$2" = venv ] && [ -d "$3" ] && exit\nexec {shlex.quote(sys.executable)} "$@"\n')
    python.chmod(0o755)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "MAKE"))}
    environment |= {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": index.parent.as_uri(), "PIP_NO_CACHE_DIR": "1"}
    # The default index, and one with a CPU build.
    for offered, taken, large in (
        (["2.13.0", "2.14.0"], "2.13.0", True),
        (["2.13.0", "2.13.0+cpu", "2.14.0"], "2.13.0+cpu", False),
    ):
        (tmp_path / "pyproject.toml").write_text(PROJECT)
        for path in (index, *(tmp_path / ".venv").rglob("torch-*")):
            shutil.rmtree(path, ignore_errors=True)
        index.mkdir(parents=True)
        wheels = [stub(index, version) for version in offered]
        links = (f'<a href="{name.replace("+", "%2B")}">{name}</a>\n' for name in wheels)
        (index / "index.html").write_text("".join(links))
        command = ["make", f"PYTHON={python}", ".venv/.installed"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert [path.name for path in (tmp_path / ".venv").rglob("torch-*")] == [f"torch-{taken}.dist-info"]
        said = [line for line in done.stdout.splitlines() if "the default build is coming, several GB" in line]
        assert len(said) == large


def test_make_paper_installs_the_package_alone_unless_the_tests_have_installed_more(tmp_path: Path) -> None:
    for name in ("Makefile", "constraints.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)

    def installs(target: str) -> list[str]:
        done = subprocess.run(["make", "-n", target], cwd=tmp_path, capture_output=True, text=True, check=True)
        return re.findall(r"--editable '(.*)'", done.stdout)

    assert (installs("paper"), installs("check")) == (["."], [".[dev]"])
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / ".package").touch()
    assert (installs("paper"), installs("check")) == ([], [".[dev]"])
    (tmp_path / ".venv" / ".package").unlink()
    (tmp_path / ".venv" / ".installed").touch()
    assert (installs("paper"), installs("check")) == ([], [])


SAYS = """\
echo "make $*, home $(basename "$HOME") with $(ls -A "$HOME" | wc -l) files"
echo "browser $(basename "$(command -v chromium)"), required:$ACTIVEFAIL_REQUIRE."
"""
"""Instead of make: what it was called for, and under which circumstances."""


def test_ci_first_tests_as_on_a_bare_machine_and_goes_on_where_nothing_can_be_installed(tmp_path: Path) -> None:
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
    commands = tmp_path / "bin"
    commands.mkdir()
    for name, script in {"make": SAYS, "chromium": "exit 1"}.items():
        (commands / name).write_text(f"#!/bin/sh\n{script}\n")
    for name in ("apt-get", "dpkg-query", "which", "python3"):
        (commands / name).write_text("#!/bin/sh\nexit 1\n")
    for path in commands.iterdir():
        path.chmod(0o755)
    (tmp_path / "mine").mkdir()
    unset = {"PYTHON", "ACTIVEFAIL_REQUIRE", "ACTIVEFAIL_OPENSEES_PYTHON"}
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"PATH": f"{commands}{os.pathsep}{environment['PATH']}", "HOME": str(tmp_path / "mine")}
    done = subprocess.run(
        [tmp_path / ".ci" / "run"], env=environment, capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[:4] == [
        "make clean .venv/.installed, home mine with 0 files",
        "browser chromium, required:.",
        "make test, home home with 0 files",
        "browser , required:.",
    ]
    assert "install" in lines[4]
    assert "chromium" in lines[4]
    assert "ci: pip could not install openseespy" in lines
    assert "ci: pip could not install the records of FEMA P695" in lines
    assert "ci: records is not to be had here: its tests are skipped" in lines
    assert "ci: browser is not to be had here: its tests are skipped" in lines
    assert lines[-6:] == [
        "make test-tools, home mine with 0 files",
        "browser chromium, required:.",
        "make test-slow, home mine with 0 files",
        "browser chromium, required:.",
        "make test-faults, home mine with 0 files",
        "browser chromium, required:.",
    ]
