"""The commands and code of the documentation run here."""

import importlib.util
import inspect
import math
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import commandline
import pytest

import activefail
from activefail.campaign.section import Section
from activefail.campaign.settings import CampaignSettings, checked

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_every_command_of_the_readme_runs_in_its_order(tmp_path, monkeypatch, without_pictures):
    shutil.copytree(ROOT / "campaigns", tmp_path / "campaigns")
    (tmp_path / "runs").mkdir()
    commands = [line for block in blocks(ROOT / "README.md", "sh") for line in block.splitlines() if line.strip()]
    assert len(commands) >= 6
    monkeypatch.chdir(tmp_path)
    for command in commands:
        name, *arguments = shlex.split(command)
        assert name == "activefail"
        done = commandline.activefail(*arguments)
        assert done.code == 0, f"{command}\n{done.out}\n{done.err}"
    assert {"response.png", "bearing.gif", "simulations.csv", "predictions.csv"} <= {p.name for p in tmp_path.iterdir()}


def test_the_python_of_the_readme_runs(tmp_path):
    source = "\n".join(blocks(ROOT / "README.md", "python"))
    done = subprocess.run([sys.executable, "-c", source], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "failure" in done.stdout
    assert (tmp_path / "beam.png").read_bytes().startswith(b"\x89PNG")


GUIDE = ROOT / "docs" / "guide.md"
HAZARD = ROOT / "docs" / "hazard.md"
TUTORIALS = ROOT / "docs" / "tutorials"


def section(page, heading):
    """The text of a page under a heading, to the next one of its rank."""
    return section_of(page.read_text(encoding="utf-8"), heading)


def section_of(text, heading):
    rank = heading.split()[0]
    return text[text.index(f"\n{heading}\n") :].split(f"\n{rank} ")[1]


PLATE = """
sampling = { initial = 8, budget = 16, batch = 4 }
simulator = { python = "guides_plate:run" }
[space]
x = { low = 0.0, high = 1.0 }
y = { low = 0.0, high = 1.0 }
"""


def test_the_guides_simulations_done_elsewhere_can_be_done(tmp_path, monkeypatch):
    (tmp_path / "runs").mkdir()
    monkeypatch.chdir(tmp_path)
    text = section(GUIDE, "## Simulations done elsewhere")
    found = re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    (campaign,) = (body for language, body in found if language == "toml")
    names = ("answers.csv", "old.csv", "fixes.csv")
    tables = zip(names, (body for language, body in found if language == "csv"), strict=True)
    for name, body in (("lab.toml", campaign), ("plate.toml", PLATE), *tables):
        (tmp_path / name).write_text(body)
    (tmp_path / "guides_plate.py").write_text("def run(d):\n    return 'failure' if d['x'] + d['y'] > 1 else 'safe'\n")
    said, todo = {}, []
    commands = [line for language, body in found if language == "sh" for line in body.splitlines()]
    assert {command.split()[1] for command in commands} == {"create", "ask", "tell", "drop", "add", "status", "resume"}
    for command in commands:
        name, *words = shlex.split(command)
        if words[:2] == ["tell", "runs/plate"]:
            rows = [f"{row['id']},{outcome}\n" for row, outcome in zip(todo, ["safe", "failure"] * 2, strict=True)]
            (tmp_path / "answers.csv").write_text("id,outcome\n" + "".join(rows))
        done = commandline.activefail(*words)
        assert (name, done.code) == ("activefail", 0), f"{command}\n{done.err}"
        said[command] = done.out
        if words[0] == "ask":
            todo = commandline.table(tmp_path / "todo.csv")
    assert "3 new results recorded; 1 design in flight" in said["activefail tell runs/lab --csv answers.csv"]
    fixed = said["activefail tell runs/lab --csv fixes.csv --correct"]
    assert fixed.startswith("id 0: safe, reserve 0.42 -> failure, reserve -0.42\n1 result corrected\n")
    assert "1 design dropped; 0 designs in flight" in said["activefail drop runs/lab --ids 3"]
    assert "2 simulations added" in said["activefail add runs/lab --csv old.csv"]
    assert "2 designs" in said["activefail ask runs/plate --n 2 --csv todo.csv"]


def test_the_commands_of_the_sensitivity_run_with_its_files(tmp_path, monkeypatch):
    page = ROOT / "docs" / "sensitivity.md"
    shutil.copytree(ROOT / "tests" / "seismic" / "stored_run" / "paper", tmp_path / "runs" / "bearing")
    (hazard,), bearing = blocks(page, "toml"), blocks(HAZARD, "toml")[1]
    (tmp_path / "hazard.toml").write_text(hazard)
    (tmp_path / "bearing.toml").write_text(bearing)
    monkeypatch.chdir(tmp_path)
    commands = [line for block in blocks(page, "sh") for line in block.splitlines()]
    assert len(commands) == 3
    for command in commands:
        name, *words = shlex.split(command)
        # A small sample: the default takes two minutes.
        done = commandline.activefail(*words, "--samples", "16")
        assert (name, done.code) == ("activefail", 0), f"{command}\n{done.err}"
    assert {"sensitivity.md", "one_at_a_time.svg"} <= {path.name for path in Path("runs/sensitivity").iterdir()}
    assert Path("indices.csv").is_file()


@pytest.mark.slow
def test_the_commands_of_the_page_on_design_run_in_their_order(tmp_path, monkeypatch):
    page = ROOT / "docs" / "design.md"
    shutil.copytree(ROOT / "tests" / "seismic" / "stored_run" / "paper", tmp_path / "runs" / "bearing")
    shutil.copytree(ROOT / "campaigns", tmp_path / "campaigns")
    (text,) = blocks(TUTORIALS / "first_design.md", "toml")
    (tmp_path / "bearing.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    commands = [line for block in blocks(page, "sh") for line in block.splitlines()]
    assert [shlex.split(command)[1] for command in commands] == [
        *("hazard", "design", "fragility"),
        *("run", "design"),
    ]
    for command in commands:
        name, *words = shlex.split(command)
        # Small: the classifier of this folder has learned too little to find a bearing.
        smaller = {"design": ["--simulations", "60", "--no-chart"], "fragility": ["--verify", "20"]}
        smaller |= {"run": ["--budget", "60"]}
        done = commandline.activefail(*words, *smaller.get(words[0], []))
        assert (name, done.code) in (("activefail", 0), ("activefail", 3 if words[0] == "design" else 0)), done.err
    assert {path.name for path in Path("design").iterdir()} == {"design.html", "design.toml", "design.json"}
    assert tomllib.loads(Path("design", "design.toml").read_text()).keys() == {*tomllib.loads(text), "D_tot"}


@pytest.mark.slow
def test_the_commands_of_the_page_on_fragility_run(tmp_path, monkeypatch, without_pictures):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "fragility.md").read_text(encoding="utf-8")
    found = re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    near_fault, bearing, _ = blocks(HAZARD, "toml")
    (tmp_path / "bearing.toml").write_text(bearing)
    (tmp_path / "near_fault.toml").write_text(near_fault)
    small = (
        'sampling = { initial = 40, budget = 40 }\nclassifier = { features = "design" }\nvalidation = { size = 20 }\n'
    )
    (tmp_path / "small.toml").write_text(small)
    assert commandline.activefail("run", "small.toml", "--out", "runs/bearing").code == 0
    commands = [line for language, body in found if language == "sh" for line in body.splitlines()]
    assert len(commands) == 5
    for command in commands:
        name, *words = shlex.split(command)
        done = commandline.activefail(*words)
        assert (name, done.code) == ("activefail", 0), f"{command}\n{done.err}"
    assert 'id="fragility"' in Path("runs/bearing/report.html").read_text()
    assert {"fragility.html", "fragility.png", "pelicun.csv", "openquake.xml"} <= {
        path.name for path in (tmp_path / "fragility").iterdir()
    }


@pytest.fixture
def printed(tmp_path, monkeypatch, capsys):
    """What a source prints that runs in this process, with the test's folder as its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)

    def run(source):
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            exec(compile(source, "<docs>", "exec"), {"__name__": "__main__"})
        return capsys.readouterr().out

    yield run
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) == str(tmp_path / f"{name}.py"):
            del sys.modules[name]


def test_the_python_of_the_guide_runs(printed):
    (source,) = re.findall(r"^```python\n(.*?)^```", section(GUIDE, "## From Python"), re.MULTILINE | re.DOTALL)
    said = printed(source)
    assert "the campaign's budget of 16 simulations allows no more (in flight: 0)\n{'safe'" in said
    assert float(said.split("misclassified")[1]) < 0.1


def test_the_examples_of_the_python_interface_run_and_use_every_public_name(tmp_path, printed, without_pictures):
    simulator, *examples = blocks(ROOT / "docs" / "reference" / "python.md", "python")
    (tmp_path / "beam.py").write_text(simulator)
    source = "\n".join(examples)
    used = set(re.findall(r"\w+", re.sub("#.*", "", source)))
    not_raised = {"SimulationError"}
    assert {*activefail.__all__} - used == not_raised
    assert {name for name in dir(activefail.Run) if not name.startswith("_")} <= used
    assert printed(source).startswith("True 12")


def test_every_method_and_property_of_a_run_has_a_text_for_the_reference():
    for name in dir(activefail.Run):
        assert name.startswith("_") or inspect.getdoc(getattr(activefail.Run, name)), name


def one_worker(words):
    """An option for a command that simulates: every worker imports the package, which takes longer than a beam."""
    return ["--workers", "1"] if words[0] in ("run", "resume") else []


def test_the_commands_of_the_first_tutorial_run_in_their_order(tmp_path, monkeypatch):
    page = TUTORIALS / "first_design.md"
    monkeypatch.chdir(tmp_path)
    (text,) = blocks(page, "toml")
    (tmp_path / "bearing.toml").write_text(text)
    commands = [line for block in blocks(page, "sh") for line in block.splitlines()]
    assert [shlex.split(command)[1] for command in commands] == (
        ["doctor", "simulate", "campaigns", "run", "status", "design"]
    )
    for command in commands:
        name, *words = shlex.split(command)
        if words[0] == "run":
            assert Path(words[1]).exists()
            shutil.copytree(ROOT / "tests" / "seismic" / "stored_run" / "paper", Path(words[-1]))
            continue
        # Small: the classifier of this folder has learned too little to find a bearing.
        small = ["--simulations", "60", "--no-chart"] if words[0] == "design" else []
        done = commandline.activefail(*words, *small)
        assert (name, done.code) == ("activefail", 3 if words[0] == "design" else 0), f"{command}\n{done.err}"
    assert Path("response.png").exists()
    assert Path("design", "design.html").exists()


def test_the_tutorial_on_a_custom_simulator_runs_as_it_says(tmp_path, monkeypatch):
    page = TUTORIALS / "custom_simulator.md"
    monkeypatch.chdir(tmp_path)
    files = {
        "python": ("beam.py", "program.py"),
        "toml": ("beam.toml", "site.toml", "command.toml"),
        "csv": ("designs.csv",),
    }
    for language, names in files.items():
        for name, text in zip(names, blocks(page, language), strict=True):
            (tmp_path / name).write_text(text)
    command, campaign = (Path(name).read_text() for name in ("command.toml", "beam.toml"))
    Path("program.toml").write_text(re.sub("^python = .*", command.strip(), campaign, flags=re.MULTILINE))
    commands = [line for block in blocks(page, "sh") for line in block.splitlines()]
    said = {}
    for command in commands:
        name, *words = shlex.split(command)
        done = commandline.activefail(*words, *one_worker(words))
        assert (name, done.code) == ("activefail", 0), f"{command}\n{done.err}"
        said[words[0]] = done.out
    rows = Path("predictions.csv").read_text().splitlines()
    column = rows[0].split(",").index("p_failure")
    safe, *failing = (float(row.split(",")[column]) for row in rows[1:])
    assert safe < 0.01
    assert min(failing) > 0.99
    low, high = re.search(r"interval   (\S+) to (\S+),", said["probability"]).groups()
    scale = 4 * 6**0.5 / math.pi
    exact = 1 - math.exp(-math.exp(-(91 / 2.5 - (20 - 0.5772157 * scale)) / scale))
    assert f"{exact:.4f}" == "0.0029"
    assert float(low) < exact < float(high)


def test_the_hazard_files_of_the_docs_are_read_and_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    near_fault, bearing, deaggregation = blocks(HAZARD, "toml")
    (pulses,) = blocks(HAZARD, "csv")
    activefail.create_run(tmp_path / "runs" / "bearing", {"sampling": {"initial": 20, "budget": 20}}).close()
    texts = {"near_fault.toml": near_fault, "rows.toml": deaggregation, "b.toml": bearing, "pulses.csv": pulses}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    commands = [line for block in blocks(HAZARD, "sh") for line in block.splitlines()]
    for command in (*commands, "activefail hazard rows.toml runs/bearing --fixed b.toml"):
        name, *words = shlex.split(command)
        done = commandline.activefail(*words)
        assert (name, done.code) == ("activefail", 0), f"{command}\n{done.err}"
    assert (tmp_path / "figures" / "hazard.png").exists()
    shipped = (ROOT / "campaigns" / "hazards" / "near_fault.toml").read_text(encoding="utf-8")
    assert tomllib.loads(shipped) == tomllib.loads(near_fault)


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


def test_the_first_page_leads_to_every_page():
    docs = ROOT / "docs"
    linked = set(re.findall(r"\]\(([^)#:]+)", (docs / "index.md").read_text(encoding="utf-8")))
    pages = {page.relative_to(docs).as_posix() for page in (*docs.glob("**/*.md"), *docs.glob("**/*.ipynb"))}
    assert linked == pages - {"index.md"}


@pytest.mark.parametrize("file", sorted((ROOT / "campaigns").glob("*.toml")), ids=lambda file: file.name)
def test_every_campaign_says_in_a_comment_what_it_should_show(file):
    assert "What it shows" in file.read_text(encoding="utf-8")


# --- the reference pages ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["commands", "settings"])
def test_the_pages_of_commands_and_keys_are_what_their_scripts_write(name):
    reference = script(name)
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(), f"run python docs/{name}.py"


def test_a_key_without_a_meaning_is_not_written():
    class Unexplained(Section):
        """A section of which no key is explained."""

        size: int = 0

    reference = script("settings")
    with pytest.raises(KeyError, match="'size'"):
        reference.rows(Unexplained, Unexplained.model_json_schema())


def test_the_settings_that_a_page_recommends_are_settings():
    (features,) = map(tomllib.loads, blocks(ROOT / "docs" / "which.md", "toml"))
    checked(CampaignSettings, features, "docs/which.md")
    campaign = {"simulator": {"python": "beam:run", "margins": ["g"]}, "space": {"x": {"low": 0, "high": 1}}}
    campaign |= {"stop": {"probability": "failure"}}
    assert checked(CampaignSettings, campaign, "docs/which.md").acquisition.criterion == "eavc"
    defaults = CampaignSettings()
    assert (defaults.acquisition.criterion, defaults.acquisition.exploration) == ("joint_entropy", 0.0)
    shipped = tomllib.loads((ROOT / "campaigns" / "bearing.toml").read_text(encoding="utf-8"))
    assert shipped["classifier"] == {"features": "collision", "kernel": "matern52"}
    assert shipped["acquisition"] == {"criterion": "eavc", "boundary": {"failure": 0.7, "impact": 0.3}}


# --- citations ---------------------------------------------------------------------------------------------------


def script(name):
    """A script in docs/, as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def references():
    """docs/references.py and the entries of docs/references.bib."""
    module = script("references")
    text = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")
    return module, text, module.entries(text)


LIST = {ROOT / "docs" / name for name in ("references.md", "references.bib", "references.py")}
SOURCES = {
    path: path.read_text(encoding="utf-8")
    for folder in ("activefail", "docs", "tests", "studies", "campaigns")
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
        cited = any(f in everything for f in (f"[{key}]", f"[{key},", f"references.md#{key})"))
        assert cited or re.search(in_words(entry), everything), key


def test_pages_and_docstrings_cite_by_key():
    _, _, entries = references()
    for path, text in SOURCES.items():
        where = path.relative_to(ROOT).as_posix()
        if not where.startswith(("activefail/", "docs/")):
            continue
        plain = re.sub(r"\[[^\]]*\]\([^)]*references\.md#\w+\)", "", text)
        for key, entry in entries.items():
            # Most pages lack the year, which is sooner found than the name.
            actual = re.search(in_words(entry), plain) if entry.get("year", "no year") in plain else None
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
    words = [word.lower() for word in re.findall(r"^- \*\*(.+?)\*\*: ", text, re.MULTILINE)]
    assert len(words) > 30
    assert words == sorted(set(words))


def test_the_map_of_the_packages_has_every_layer_in_order():
    text = section_of((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), "## A map of the packages")
    lines = re.findall(r"^    ([a-z_]+(?:\.py)?(?:, [a-z_]+(?:\.py)?)*)(?:  .*)?$", text, re.MULTILINE)
    drawn = [name.removesuffix(".py") for line in lines for name in line.split(", ")]
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    depth = {
        name.strip().removeprefix("activefail."): place
        for place, layer in enumerate(layers)
        for name in layer.split("|")
    }
    assert set(drawn) == {*depth, "seismic"}
    order = [depth[name] for name in drawn if name != "seismic"]
    assert order == sorted(order)
    packages = {path.parent.name for path in (ROOT / "activefail").glob("*/__init__.py")}
    assert packages <= set(drawn)
