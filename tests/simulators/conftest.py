"""Tests that need openseespy run it under the interpreter that ACTIVEFAIL_OPENSEES_PYTHON names, or under this one."""

import os
import subprocess
import sys
from functools import cache

import pytest

INTERPRETER = os.environ.get("ACTIVEFAIL_OPENSEES_PYTHON", sys.executable)


@cache
def _missing() -> str:
    """Why OpenSees cannot be run here; nothing if it can."""
    command = [INTERPRETER, "-c", "import numpy, openseespy.opensees"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        return f"{INTERPRETER} has no openseespy: {error.strerror}"
    last = done.stderr.strip().splitlines()
    return f"{INTERPRETER} has no openseespy: {last[-1] if last else done.returncode}" if done.returncode else ""


@pytest.fixture
def opensees() -> str:
    """An interpreter that has openseespy."""
    if _missing():
        pytest.skip(f"{_missing()}; ACTIVEFAIL_OPENSEES_PYTHON may name another")
    return INTERPRETER
