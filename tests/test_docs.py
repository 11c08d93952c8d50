"""What the documentation says can be done is done here."""

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from activefail.campaign.settings import CampaignSettings

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_every_command_of_the_readme_runs_in_its_order(tmp_path):
    shutil.copytree(ROOT / "campaigns", tmp_path / "campaigns")
    (tmp_path / "runs").mkdir()
    commands = [line for block in blocks(ROOT / "README.md", "sh") for line in block.splitlines() if line.strip()]
    assert len(commands) >= 6
    program = [sys.executable, "-m", "activefail.cli"]
    for command in commands:
        name, *arguments = shlex.split(command)
        assert name == "activefail"
        done = subprocess.run([*program, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    assert {"response.png", "bearing.gif", "simulations.csv", "predictions.csv"} <= {p.name for p in tmp_path.iterdir()}


def test_the_python_of_the_readme_runs():
    source = "\n".join(blocks(ROOT / "README.md", "python"))
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "failure" in done.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_pages_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_guide_lists_every_setting_with_its_default():
    guide = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8")
    stated = dict(re.findall(r"^\| `([\w.]+)` \| ([^|]*) \|", guide, re.MULTILINE))
    settings = tomllib.loads(CampaignSettings().text())
    defaults = {
        f"{section}.{key}" if isinstance(values, dict) else section: value
        for section, values in settings.items()
        if section != "space"
        for key, value in (values.items() if isinstance(values, dict) else [("", values)])
    }
    for key, value in defaults.items():
        assert key in stated, f"{key} is not in the guide"
        if key != "description":
            text = stated[key].strip().strip("`").strip('"')
            assert (text == value) if isinstance(value, str) else (tomllib.loads(f"v = {text}")["v"] == value), key


@pytest.mark.parametrize("file", sorted((ROOT / "campaigns").glob("*.toml")), ids=lambda file: file.name)
def test_every_campaign_says_in_a_comment_what_it_should_show(file):
    assert "should show" in file.read_text(encoding="utf-8")
