"""What a test needs and is not there: the test is skipped, unless it is required."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def without_tools(tmp_path: Path, *words: str, require: str = "") -> list[str]:
    """What pytest prints where there is neither a browser nor openseespy."""
    missing = {"ACTIVEFAIL_OPENSEES_PYTHON": str(tmp_path / "none"), "PATH": str(tmp_path)}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
    environment = os.environ | missing | {"ACTIVEFAIL_REQUIRE": require}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    return (done.stdout + done.stderr).splitlines()


def test_what_needs_a_missing_tool_is_skipped_and_no_test_runs_without_a_required_one(tmp_path: Path) -> None:
    places = ("tests/seismic/simulators/test_opensees.py", "tests/core/report/test_report_in_a_browser.py")
    said = without_tools(tmp_path, "-m", "needs", *places)
    assert re.search(r"^\d+ skipped, \d+ deselected in ", said[-1]), said
    assert any(re.match(r"SKIPPED .*: a browser needs chromium ", line) for line in said), said
    why = f"{tmp_path / 'none'} has no openseespy: No such file or directory"
    assert any(re.match(rf"SKIPPED .*test_opensees.*: {re.escape(why)}", line) for line in said), said
    said = without_tools(tmp_path, *places, require="openseespy")
    assert said[0].startswith(f"ERROR: ACTIVEFAIL_REQUIRE names openseespy, but {why}")
    assert said[1:] == [""]
