"""Runs the tests of both wings: those of the core on a copy of the repository without the plug-in, the plug-in's here.

`python tests/wings.py WORD...` runs pytest with these words, once for each wing, and fails if either run fails.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COPY = ROOT / "build" / "core"
FOLDERS = ("activefail", "campaigns", "docs", "studies", "tests", ".ci")

COUNTED = "ACTIVEFAIL_TESTS_COUNTED"
"""The variable with the file of what the first run counted; the second run prints it (tests/conftest.py)."""


def copy_the_core() -> None:
    """Copy the repository, but neither the plug-in nor its tests."""
    shutil.rmtree(COPY, ignore_errors=True)
    for name in FOLDERS:
        # With times and compiled modules: else Python would compile them again.
        shutil.copytree(ROOT / name, COPY / name, ignore=shutil.ignore_patterns("seismic"))
    for file in filter(Path.is_file, ROOT.glob("[!.]*")):
        shutil.copy2(file, COPY)


def run_pytest(folder: Path, tests: str, words: list[str]) -> int:
    """The exit status of pytest in a folder, on the package in it; 0 if the words select none of these tests."""
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path, COUNTED: str(COPY / "counted.txt")}
    command = [sys.executable, "-m", "pytest", tests, *words]
    status = subprocess.run(command, cwd=folder, env=environment, check=False).returncode
    return 0 if status == pytest.ExitCode.NO_TESTS_COLLECTED else status


if __name__ == "__main__":
    copy_the_core()
    core = run_pytest(COPY, "tests/core", sys.argv[1:])
    seismic = run_pytest(ROOT, "tests/seismic", sys.argv[1:])
    sys.exit(core or seismic)
