"""The core works without the plug-in that ships with it, and finds those of others."""

import ast
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
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


def blocks(language: str) -> list[str]:
    page = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


def test_the_plug_in_of_the_documentation_brings_a_simulator_features_a_question_and_a_command(
    core: Path, tmp_path: Path
) -> None:
    metadata, (entry, campaign, river) = tmp_path / "levee-1.0.dist-info", blocks("toml")
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: levee\nVersion: 1.0\n")
    ((group, points),) = tomllib.loads(entry)["project"]["entry-points"].items()
    lines = [f"[{group}]", *(f"{name} = {module}" for name, module in points.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")
    for name, text in zip(("levee.py", "levee_parts.py"), blocks("python"), strict=True):
        (tmp_path / name).write_text(text)
    (tmp_path / "levee.toml").write_text(campaign)
    (tmp_path / "river.toml").write_text(river)

    def answer(*words: str) -> str:
        return said(tmp_path, *words, "--hazard", "river.toml", beside=core)

    assert said(tmp_path, "flood", "--height", "4", beside=core) == "fails\n"
    assert "Example: activefail flood --height 4" in said(tmp_path, "flood", "--help", beside=core)
    said(tmp_path, "run", "levee.toml", "--out", "levee", "--workers", "1", beside=core)
    text = answer("probability", "levee", "--fixed", "crest=1.25", "--json")
    # With the freeboard, the settled crest is at 0.8 m of water: 0.74 standard deviations below the median.
    assert 0.7 < json.loads(text)["outcomes"]["failure"]["probability"] < 0.8
    text = answer("design", "levee", "--target", "0.1", "--free", "crest", "--simulations", "200", "--json")
    found = json.loads(text)
    assert found["status"] == "verified"
    assert math.exp(1.28 * 0.3) + 0.2 < found["bearing"]["crest"] < 2.5
    curves = answer("fragility", "levee", "--fixed", "crest=1.25")
    assert "fragility against water [m], under the river" in curves
    assert "freeboard = 0.2" in (tmp_path / "levee" / "campaign.toml").read_text()
