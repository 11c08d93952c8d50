"""The core works without the plug-in that ships with it, and finds those of others."""

import ast
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import activefail

PLATE = """
sampling = { initial = 10, budget = 10, batch = 5 }
simulator = { python = "plate:run", margins = ["g"] }
space = { x = { low = 0, high = 1 }, y = { low = 0, high = 1 } }
"""


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package, from which the plug-in was deleted, and a campaign."""
    folder = tmp_path_factory.mktemp("core")
    ignored = shutil.ignore_patterns("seismic", "__pycache__")
    shutil.copytree(Path(activefail.__file__).parent, folder / "activefail", ignore=ignored)
    (folder / "plate.toml").write_text(PLATE)
    (folder / "plate.py").write_text("def run(design):\n    return 1.3 - design['x'] - design['y']\n")
    return folder


EXPLORED = """
from pathlib import Path

from activefail.analyses.findings.results import findings_of
from activefail.campaign.on_disk import open_campaign
from activefail.loop.learning import current
from activefail.pages.explorer.campaign import OneDesign, Slow

folder = Path("shown")
with open_campaign(folder, write=False) as (campaign, store):
    findings = findings_of(folder, campaign, store, current(campaign, store, write=False).classifier)
one = OneDesign(findings, Slow(lambda: findings.classifier, lambda: None, lambda: None))
print("data-probability" in one.predict({"x": 0.5, "y": 0.5}), one.simulates)
"""


def said(core: Path, *words: str, beside: Path | None = None, program: str = "") -> str:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, filter(None, (core, beside))))}
    command = [sys.executable, *(["-c", program] if program else ["-m", "activefail"]), *words]
    done = subprocess.run(command, cwd=core, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_without_the_plug_in_the_commands_of_the_core_are_there_and_no_others(core: Path) -> None:
    lines = said(core, "--help").partition("Commands:")[2].splitlines()
    listed = {line.split()[0] for line in lines if line.strip()}
    assert {"run", "verify", "probability", "report"} <= listed
    assert not {"simulate", "hazard", "ida", "paper"} & listed


def test_without_the_plug_in_a_campaign_is_run_and_estimated(core: Path) -> None:
    said(core, "run", "plate.toml", "--out", "run", "--workers", "1")
    assert "probability of failure" in said(core, "probability", "run", "--simulations", "10")
    assert "done       10 of 10 simulations" in said(core, "status", "run")


def test_without_the_plug_in_pages_are_written_and_explored(core: Path) -> None:
    said(core, "run", "plate.toml", "--out", "shown", "--workers", "1")
    assert "report     shown/report.html" in said(core, "report", "shown")
    said(core, "fragility", "shown", "--against", "x", "--out", "figures")
    for page in ("shown/report.html", "figures/fragility.html"):
        assert not {"bearing", "pulse"} & {*(core / page).read_text().lower().split()}
    assert said(core, program=EXPLORED) == "True False\n"


@pytest.mark.parametrize(
    ("text", "rules"),
    [
        ("", ["simulator: required, but missing", "space: required, but missing"]),
        ("simulator = 'dfp'", ["simulator: must be a table with `python`", "space: required, but missing"]),
    ],
)
def test_without_the_plug_in_a_campaign_file_must_say_what_is_simulated(
    text: str, rules: list[str], core: Path
) -> None:
    program = f"from activefail.campaign.settings import parse_settings; parse_settings({text!r}, 'mine.toml')"
    done = subprocess.run([sys.executable, "-c", program], cwd=core, capture_output=True, text=True, check=False)
    *_, first, second = done.stderr.strip().splitlines()
    assert [line.strip().startswith(rule) for line, rule in zip((first, second), rules, strict=True)] == [True, True]


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
    stub = ast.parse(Path(activefail.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    names = [name.asname for one in stub.body if isinstance(one, ast.ImportFrom) for name in one.names]
    assert sorted(map(str, names)) == sorted([*activefail.__all__, "__version__"])


def test_an_installed_package_adds_commands_by_an_entry_point(core: Path, tmp_path: Path) -> None:
    metadata = tmp_path / "levee-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: levee\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[activefail.plugins]\nlevee = levee\n")
    (tmp_path / "levee.py").write_text(
        "from activefail.run.analysis import option\n\n\n"
        "def flood(height: float = option(1.0, 'Height of the water [m].', low=0.0)) -> None:\n"
        "    '''Say whether a levee holds.'''\n"
        "    print('holds' if height < 3.0 else 'fails')\n\n\n"
        "COMMANDS = {flood: '--height 4'}\n"
    )
    assert said(core, "flood", "--height", "4", beside=tmp_path) == "fails\n"
    assert "Example: activefail flood --height 4" in said(core, "flood", "--help", beside=tmp_path)


FLOOD = """
from dataclasses import dataclass, replace

import numpy as np

from activefail.campaign.question import asked_of
from activefail.space.parameter import Parameter


@dataclass(frozen=True)
class Flood:
    title: str
    water: float

    variables, intensity, is_table, bounds = ("water",), "water", False, ("nominal",)
    assumptions, alone, factors, rates = ("There are no waves.",), None, {}, None

    @classmethod
    def is_of(cls, values):
        return "flood" in values

    @classmethod
    def of(cls, values, path):
        return cls(values["flood"]["name"], values["flood"]["median"])

    @classmethod
    def applies_to(cls, space):
        return "water" in space.names

    def at_bound(self, bound):
        return self

    def question(self, space, fixed, at=None):
        if at is not None:
            question = asked_of(self.title, space, {}, {**fixed, "water": at[1]})
            return replace(question, stated=self.assumptions)
        numbers = {"median": self.water, "dispersion": 0.3}
        water = Parameter.of_distribution("water", "lognormal", numbers, unit="m", distance=4.0)
        return replace(asked_of(self.title, space, {"water": water}, fixed), stated=self.assumptions)

    def levels(self, intensity):
        return "water", "m", np.geomspace(0.5, 4.0, 9)

    def median(self, name):
        return self.water

    def assumptions_at(self, name):
        return []

    def deaggregated(self, boundaries, space, fixed, probability):
        return [None] * len(probability)


QUESTIONS = {"flood": Flood}
"""

LEVEE = """
sampling = { initial = 12, budget = 12, batch = 6 }
simulator = { python = "levee:run", margins = ["freeboard"] }
[space]
crest = { low = 0.5, high = 5.0 }
settlement = { low = 0.0, high = 0.5 }
water = { low = 0.2, high = 4.0, unit = "m" }
"""


def test_a_hazard_of_another_field_serves_the_analyses_of_the_core(core: Path, tmp_path: Path) -> None:
    metadata = tmp_path / "flood-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: flood\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[activefail.plugins]\nflood = flood\n")
    (tmp_path / "flood.py").write_text(FLOOD)
    (tmp_path / "levee.toml").write_text(LEVEE)
    (tmp_path / "levee.py").write_text("def run(d):\n    return d['crest'] - d['settlement'] - d['water']\n")
    (tmp_path / "river.toml").write_text("[flood]\nname = 'the river'\nmedian = 1.0\n")

    def answer(*words: str) -> str:
        return said(tmp_path, *words, "--hazard", "river.toml", beside=core)

    said(tmp_path, "run", "levee.toml", "--out", "levee-run", "--workers", "1", beside=core)
    text = answer("probability", "levee-run", "--fixed", "crest=1.25", "--json")
    # The settled crest is at about the median of the water.
    assert 0.4 < json.loads(text)["outcomes"]["failure"]["probability"] < 0.6
    text = answer("design", "levee-run", "--target", "0.1", "--free", "crest", "--simulations", "200", "--json")
    found = json.loads(text)
    assert found["status"] == "verified"
    assert math.exp(1.28 * 0.3) < found["bearing"]["crest"] < 2.5
    curves = answer("fragility", "levee-run", "--fixed", "crest=1.25")
    assert "fragility against water [m], under the river" in curves
    assert "There are no waves." in curves
