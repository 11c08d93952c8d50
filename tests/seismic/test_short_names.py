"""The plug-in's packages and names are those of activefail too."""

import ast
import subprocess
import sys
from pathlib import Path

import activefail as package

ALIAS = """
import pickle
import sys

import activefail

assert not any(name.startswith("activefail.seismic") for name in sys.modules)
from activefail.bearing.design import GRAVITY, Model

assert "numba" not in sys.modules
import activefail.bearing.design as former
import activefail.seismic.bearing.design as design
from activefail.bearing import Bearing, outcome
from activefail.seismic.bearing import outcome as same

assert former is design and design.__spec__.name == "activefail.seismic.bearing.design" and outcome is same
assert Model is design.Model is activefail.Model and Bearing is design.Bearing
assert pickle.loads(pickle.dumps(Model())) == Model()
assert pickle.loads(b"cactivefail.bearing.design\\nModel\\n.") is Model
for missing in ("activefail.bearing.nothing", "activefail.nothing"):
    try:
        __import__(missing)
    except ModuleNotFoundError as error:
        assert error.name == missing
    else:
        raise AssertionError(missing)
"""


def test_a_package_of_a_plug_in_is_the_same_under_its_short_name() -> None:
    done = subprocess.run([sys.executable, "-c", ALIAS], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_type_checkers_know_the_public_names_and_no_others() -> None:
    stub = ast.parse(Path(package.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    names = [name.asname for one in stub.body if isinstance(one, ast.ImportFrom) for name in one.names]
    assert sorted(map(str, names)) == sorted([*package.__all__, "__version__"])
