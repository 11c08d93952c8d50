"""What the documentation says can be done is done here."""

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import activefail
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


def test_the_python_of_the_theory_runs():
    source = "\n".join(blocks(ROOT / "docs" / "theory.md", "python"))
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "'T_b'" in done.stdout


def anchors(page):
    """What a link may name in a page: its headings, as GitHub turns them into names, and its own marks."""
    text = page.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    names = [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]
    return {*names, *re.findall(r'<a id="([^"]+)">', text)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_pages_lead_somewhere(page):
    for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
        there = page.parent / target if target else page
        assert there.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(there), f"{page.name}: {target}#{anchor}"


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
    assert "What it shows" in file.read_text(encoding="utf-8")


# --- citations ---------------------------------------------------------------------------------------------------


def references():
    """docs/references.py and the entries of docs/references.bib."""
    spec = importlib.util.spec_from_file_location("references", ROOT / "docs" / "references.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")
    return module, text, module.entries(text)


LIST = {ROOT / "docs" / name for name in ("references.md", "references.bib", "references.py")}
SOURCES = {
    path: path.read_text(encoding="utf-8")
    for folder in ("activefail", "docs", "tests", "benchmarks", "experiments", "campaigns")
    for pattern in ("*.py", "*.md", "*.toml")
    for path in ROOT.glob(f"{folder}/**/{pattern}")
    if path not in LIST
} | {page: page.read_text(encoding="utf-8") for page in ROOT.glob("*.md")}
KEY = r"[A-Z][A-Za-z]+\d{4}"


def surname(entry):
    return entry.get("author", "?").split(" and ")[0].split()[-1]


def in_words(entry):
    """A citation by name and year on one line."""
    name = re.escape(surname(entry)).replace("ø", "[øo]").replace("á", "[áa]").replace("ó", "[óo]").replace("Á", "[ÁA]")
    return rf"\b{name}\b[^\n\[]{{0,90}}\b{entry.get('year', 'no year')}\b"


def test_every_key_that_is_cited_is_in_the_references():
    _, _, entries = references()
    for path, text in SOURCES.items():
        for key in re.findall(rf"\[({KEY})(?:, [^\]]*)?\](?!\()", text):
            assert key in entries, f"{path}: {key}"


def test_every_reference_is_cited_somewhere():
    _, _, entries = references()
    everything = "\n".join(SOURCES.values())
    for key, entry in entries.items():
        cited = re.search(rf"\[{key}[\],]|references\.md#{key}\)", everything)
        assert cited or re.search(in_words(entry), everything), key


def test_pages_and_docstrings_cite_by_key():
    _, _, entries = references()
    for path, text in SOURCES.items():
        where = path.relative_to(ROOT).as_posix()
        if not where.startswith(("activefail/", "docs/")):
            continue
        plain = re.sub(r"\[[^\]]*\]\([^)]*references\.md#\w+\)", "", text)
        for key, entry in entries.items():
            actual = re.search(in_words(entry), plain)
            assert actual is None, f"{where}: {actual[0]!r} is cited in words, not as {key}"


def test_the_page_of_references_is_what_its_program_writes():
    module, text, entries = references()
    assert len(entries) == len(re.findall(r"^@", text, re.MULTILINE))
    assert module.page(text) == (ROOT / "docs" / "references.md").read_text(encoding="utf-8")
    for key, entry in entries.items():
        assert "title" in entry, key
        if "year" in entry:
            assert key.endswith(entry["year"]), key


def test_the_citation_file_names_this_version_and_licence():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {activefail.__version__}\n" in citation
    licence = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["license"]
    assert f"\nlicense: {licence}\n" in citation


# --- words and map -----------------------------------------------------------------------------------------------


def test_the_glossary_is_in_order_and_names_no_word_twice():
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    words = [word.lower() for word in re.findall(r"^\| (.+?) \| .+ \|$", text, re.MULTILINE)][1:]
    assert len(words) > 40
    assert words == sorted(set(words))


def test_the_map_of_the_packages_has_every_package_in_the_order_that_the_layers_have():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    lines = re.findall(r"^    (\w+(?:\.py)?)  ", text, re.MULTILINE)
    drawn = [name.removesuffix(".py") for name in lines]
    packages = {path.parent.name for path in (ROOT / "activefail").glob("*/__init__.py")}
    assert packages <= set(drawn)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = [contract["layers"] for contract in contracts if contract["type"] == "layers"]
    depth = {
        name.strip().removeprefix("activefail."): place
        for place, layer in enumerate(layers)
        for name in layer.split("|")
    }
    order = [depth[name] for name in drawn if name in depth]
    assert order == sorted(order)
