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
    for folder in filter(Path.is_dir, map(ROOT.joinpath, FOLDERS)):
        # With times and compiled modules: else Python would compile them again.
        shutil.copytree(folder, COPY / folder.name, ignore=shutil.ignore_patterns("seismic"))
    for file in filter(Path.is_file, ROOT.glob("[!.]*")):
        shutil.copy2(file, COPY)


def run_pytest(folder: Path, tests: str, words: list[str]) -> int:
    """The exit status of pytest in a folder, on the package in it."""
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path, COUNTED: str(COPY / "counted.txt")}
    return subprocess.run([sys.executable, "-m", "pytest", tests, *words], cwd=folder, env=environment).returncode


def run_both(words: list[str]) -> int:
    """Run the tests of both wings; the exit status of the first run that fails. A wing may have none of the tests."""
    copy_the_core()
    statuses = [run_pytest(COPY, "tests/core", words), run_pytest(ROOT, "tests/seismic", words)]
    ran = [status for status in statuses if status != pytest.ExitCode.NO_TESTS_COLLECTED]
    return next(filter(None, ran), 0) if ran else int(pytest.ExitCode.NO_TESTS_COLLECTED)


if __name__ == "__main__":
    sys.exit(run_both(sys.argv[1:]))
