"""The core works without the plug-in that ships with it, and finds those of others."""

import json
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from commandline import activefail
from explorer.conftest import site_of

import activefail as package
from activefail import open_run
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.plugins import plugins

# `make test` runs the tests of the core on a copy without the plug-in (tests/wings.py).
alone = pytest.mark.skipif(bool(plugins()), reason="a plug-in is there")

PLATE = """
sampling = { initial = 10, budget = 10, batch = 5 }
simulator = { python = "plate:run", margins = ["g"] }
space = { x = { low = 0, high = 1 }, y = { low = 0, high = 1 } }
"""


@pytest.fixture
def plate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, simulations_in_this_process: None) -> None:
    """The current folder, with a campaign that is run."""
    (tmp_path / "plate.toml").write_text(PLATE)
    (tmp_path / "plate.py").write_text("def run(design):\n    return 1.3 - design['x'] - design['y']\n")
    monkeypatch.chdir(tmp_path)
    assert activefail("run", "plate.toml", "--out", "run").code == 0


@alone
def test_without_the_plug_in_the_commands_of_the_core_are_there_and_no_others() -> None:
    lines = activefail("--help").out.partition("Commands:")[2].splitlines()
    listed = {line.split()[0] for line in lines if line.strip()}
    assert {"run", "verify", "probability", "report"} <= listed
    assert not {"simulate", "hazard", "ida", "paper"} & listed


@pytest.mark.usefixtures("plate")
def test_without_the_plug_in_a_campaign_is_run_and_estimated() -> None:
    assert "probability of failure" in activefail("probability", "run", "--simulations", "10").out
    assert "done       10 of 10 simulations" in activefail("status", "run").out


@pytest.mark.usefixtures("plate")
def test_without_the_plug_in_pages_are_written_and_explored() -> None:
    assert "report     run/report.html" in activefail("report", "run").out
    assert activefail("fragility", "run", "--against", "x", "--out", "figures").code == 0
    for page in ("run/report.html", "figures/fragility.html"):
        assert not {"bearing", "pulse"} & {*Path(page).read_text().lower().split()}
    with open_run(Path("run"), code=Path.cwd()) as run:
        one = site_of(run.findings).one
        assert "data-probability" in one.predict({"x": 0.5, "y": 0.5})
        assert not one.simulates


@alone
@pytest.mark.parametrize(
    ("text", "rules"),
    [
        ("", ["simulator: required, but missing", "space: required, but missing"]),
        ("simulator = 'wall'", ["simulator: must be a table with `python`", "space: required, but missing"]),
    ],
)
def test_without_the_plug_in_a_campaign_file_must_say_what_is_simulated(text: str, rules: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        parse_settings(text, "mine.toml")
    _, *lines = str(refused.value).splitlines()
    assert [line.strip().startswith(rule) for line, rule in zip(lines, rules, strict=True)] == [True, True]


def blocks(language: str) -> list[str]:
    page = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


PROGRAM = """
import contextlib
import io
import json
import sys

from activefail.cli import main

if __name__ == "__main__":
    printed = []
    for words in json.loads(sys.argv[1]):
        sys.argv = ["activefail", *words]
        with contextlib.redirect_stdout(io.StringIO()) as out:
            try:
                main()
            except SystemExit as left:
                assert not left.code, (words, left.code)
        printed.append(out.getvalue())
    print(json.dumps(printed))
"""


def test_the_plug_in_of_the_documentation_brings_a_simulator_features_a_question_and_a_command(tmp_path: Path) -> None:
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
    (tmp_path / "program.py").write_text(PROGRAM)
    asked = ["--hazard", "river.toml"]
    commands = [
        ["flood", "--height", "4"],
        ["flood", "--help"],
        ["run", "levee.toml", "--out", "levee", "--workers", "1"],
        ["probability", "levee", "--fixed", "crest=1.25", *asked, "--json"],
        ["design", "levee", "--target", "0.1", "--free", "crest", "--simulations", "200", *asked, "--json"],
        ["fragility", "levee", "--fixed", "crest=1.25", *asked],
    ]
    path = os.pathsep.join([str(tmp_path), str(Path(package.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, "program.py", json.dumps(commands)],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer, told, _, probable, designed, curves = json.loads(done.stdout)
    assert answer == "fails\n"
    assert "Example: activefail flood --height 4" in told
    # With the freeboard, the settled crest is at 0.8 m of water: 0.74 standard deviations below the median.
    assert 0.7 < json.loads(probable)["outcomes"]["failure"]["probability"] < 0.8
    found = json.loads(designed)
    assert found["status"] == "verified"
    assert math.exp(1.28 * 0.3) + 0.2 < found["bearing"]["crest"] < 2.5
    assert "fragility against water [m], under the river" in curves
    assert "freeboard = 0.2" in (tmp_path / "levee" / "campaign.toml").read_text()
