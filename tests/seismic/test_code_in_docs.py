"""Code and commands of the documentation that `test_docs.py` does not run: every block is run, read, or named here."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml
from commandline import activefail, record

import activefail as package
from activefail.campaign.settings import CampaignSettings, checked
from activefail.cli import app
from activefail.errors import InputError

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PATTERNS = "*.md", "docs/**/*.md", ".github/**/*.md"
PAGES = {page.relative_to(ROOT).as_posix(): page for pattern in PATTERNS for page in ROOT.glob(pattern)}
BLOCK = re.compile(r"^```(\S*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
INDENTED = re.compile(r"(?:\A|\n\n)((?: {4,}.*\n)+)")


def blocks(page: str, language: str) -> list[str]:
    return [body for found, body in BLOCK.findall((ROOT / page).read_text(encoding="utf-8")) if found == language]


# --- every command can be parsed ----------------------------------------------------------------------------------


def command_lines(text: str) -> Iterator[str]:
    """The commands `activefail …` in blocks, indented lines and inline code, but no patterns such as `[--seed S]`."""
    fenced = [body for language, body in BLOCK.findall(text) if language in ("", "sh")]
    plain = BLOCK.sub("", text)
    inline = [" ".join(code.split()) for code in re.findall(r"`(activefail[^`]+)`", INDENTED.sub("\n\n", plain))]
    # The first line of every file of the record (docs/reference/run-folder.md).
    others = ("activefail record",)
    for part in (*fenced, *INDENTED.findall(plain), *inline):
        for line in part.replace("\\\n", " ").splitlines():
            command = line.strip().partition(" | ")[0].partition(" < ")[0]
            if command in others:
                continue
            if re.match(r"activefail [a-z-]", command) and not re.search(r"[\[\]{}…]| \.\.\.|, if ", command):
                yield command


def unknown(command: str) -> str:
    """What of a command line the program does not know; nothing if it can be parsed."""
    _, *words = shlex.split(command)
    if words[0].startswith("-"):
        return "" if words in (["--install-completion"], ["--show-completion"], ["--version"]) else words[0]
    if words[0] not in COMMANDS:
        return words[0]
    context = COMMANDS[words[0]].make_context(words[0], [], resilient_parsing=True)
    context.resilient_parsing = False  # else the parser passes over what it does not know
    try:
        COMMANDS[words[0]].make_parser(context).parse_args(args=words[1:])
    except Exception as fault:
        # A sentence may name an option without its value.
        return "" if getattr(fault, "option_name", None) == words[-1] else repr(fault)
    return ""


@pytest.mark.parametrize("name", PAGES)
def test_every_command_of_the_documentation_has_a_name_and_options_that_exist(name: str) -> None:
    commands = list(command_lines(PAGES[name].read_text(encoding="utf-8")))
    wrong = {command: fault for command in commands if (fault := unknown(command))}
    assert not wrong
    if name in ("README.md", "docs/guide.md", "docs/reference/commands.md"):
        assert len(commands) > 20


@pytest.mark.parametrize("command", ["activefail runs x", "activefail run x --ouch y"])
def test_a_command_that_does_not_exist_is_noticed(command: str) -> None:
    assert unknown(command)


def test_github_and_git_run_what_the_documentation_names_on_every_python_that_the_project_names() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [text.split()[-1] for text in project["classifiers"] if re.search(r"Python :: 3\.\d", text)]
    job = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text())["jobs"]["tests"]
    assert job["strategy"]["matrix"]["python"] == named
    assert job["steps"][-1] == {"run": ".ci/run"}
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    assert hook["entry"] == "make check"
    assert "activefail doctor" in command_lines((ROOT / ".github" / "ISSUE_TEMPLATE" / "problem.md").read_text())


# --- every block is run somewhere -----------------------------------------------------------------------------------


RUN = {
    "docs/classifier.md": "core/test_custom_learner.py",
    "README.md": "seismic/test_docs.py",
    "docs/building.md": "seismic/test_building.py",
    "docs/design.md": "seismic/test_docs.py",
    "docs/fragility.md": "seismic/test_docs.py",
    "docs/hazard.md": "seismic/test_docs.py",
    "docs/reference/python.md": "seismic/test_docs.py",
    "docs/sensitivity.md": "seismic/test_docs.py",
    "docs/tutorials/custom_simulator.md": "seismic/test_docs.py",
    "docs/tutorials/first_design.md": "seismic/test_docs.py",
    "docs/which.md": "seismic/test_docs.py",
    "docs/guide.md": "seismic/test_docs.py",
    "docs/cluster.md": "seismic/test_code_in_docs.py",
    "docs/distributions.md": "seismic/test_code_in_docs.py",
    "docs/probability.md": "seismic/test_code_in_docs.py",
    "docs/plugins.md": "core/test_plugins.py",
    "docs/records.md": "seismic/test_code_in_docs.py",
}
"""The test file that runs or reads the blocks of a page. Of other blocks:

- Blocks without a language are output, or commands; the commands are parsed above.
- Indented commands are parsed above. `make paper`, `make test` and `make docs` are what `.ci/run` and
  `tests/seismic/test_site.py` run; `pip install` and environments of other programs need a network.
- The Python of docs/cluster.md starts jobs of a queue: it is compiled, not run.
"""


def test_every_page_with_code_has_a_test_that_names_it() -> None:
    with_code = {
        name
        for name, page in PAGES.items()
        if {language for language, _ in BLOCK.findall(page.read_text(encoding="utf-8"))} & {"python", "sh", "toml"}
    }
    assert with_code == RUN.keys()
    for name, file in RUN.items():
        text = (ROOT / "tests" / file).read_text(encoding="utf-8")
        assert Path(name).name in text, f"{name} in {file}"


def test_the_function_of_the_readme_is_called_by_a_script_beside_it(tmp_path: Path) -> None:
    script, function, _ = blocks("README.md", "python")
    (simulator,) = re.findall(r'`(simulator = \{"python".*?\})`', (ROOT / "README.md").read_text(encoding="utf-8"))
    before, loop, _ = script.partition("while len(designs")
    assert loop
    before = re.sub("^simulator = .*", simulator, before, flags=re.MULTILINE)
    (tmp_path / "beam.py").write_text(function, encoding="utf-8")
    after = "print(run.take().finished)\nestimate = run.probability().estimate\nprint(estimate.low, estimate.high)\n"
    (tmp_path / "script.py").write_text(before + after, encoding="utf-8")
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Exception ignored" not in done.stderr
    *_, finished, interval = done.stdout.splitlines()
    assert finished == "True"
    g: dict[str, Any] = {}
    exec(function, g)
    middles = (np.arange(500) + 0.5) / 500
    fails = [g["g"]({"load": load, "length": length}) <= 0 for load in 5 + 55 * middles for length in 1 + 4 * middles]
    low, high = map(float, interval.split())
    assert low < np.mean(fails) < high


def test_the_outputs_of_the_guide_have_the_margins_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (campaign,) = (text for text in blocks("docs/guide.md", "toml") if '"frame:outputs"' in text)
    (source,) = (text for text in blocks("docs/guide.md", "python") if "def outputs(design)" in text)
    (patterns,) = (text for text in blocks("docs/guide.md", "toml") if "pattern = {" in text)
    (tmp_path / "frame.py").write_text(source, encoding="utf-8")
    prints = "command = \"printf 'step,drift\\\\n1,0.5\\\\n2,0.03\\\\nutilisation = 9\\\\nutilisation = 0.7'\"\n"
    space = "[space]\nx = { low = 0, high = 1 }\n"
    for simulator, margins in {
        campaign: {"stiffness": 1 - 0.013 / 0.02, "strength": 1 - 0.84, "thickness": 5.2 - 4.0, "beam": 0.7},
        f"[simulator]\n{prints}{patterns}": {"reserve": 1 - 0.03 / 0.02, "beam": 0.7, "drift": 0.03},
    }.items():
        (tmp_path / "guide.toml").write_text(f"{simulator}\n{space}", encoding="utf-8")
        done = activefail("check", "guide.toml")
        assert done.code == 0, done
        said = dict(line.split(None, 1) for line in done.out.splitlines())
        assert {name: float(said[name]) for name in margins} == pytest.approx(margins)


@pytest.mark.parametrize("page", ["README.md", "docs/guide.md"])
def test_the_loops_of_the_pages_end_also_where_a_margin_is_nan(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (source,) = (block for block in blocks(page, "python") if "run.ask(" in block)
    nan = re.sub("^    return ", "    return np.nan * ", source, flags=re.MULTILINE)
    assert nan != source
    with pytest.raises(InputError, match="row 0: must have a result"):
        exec(nan, {})


def test_the_limit_state_in_three_lines_and_its_questions_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    limit, _ = blocks("docs/probability.md", "python")
    beam, _, heavy = blocks("docs/probability.md", "toml")
    for name, text in (("limit.py", limit), ("beam.toml", beam), ("heavy.toml", heavy)):
        Path(name).write_text(text, encoding="utf-8")
    (commands,) = blocks("docs/probability.md", "")
    asked = "activefail probability runs/beam --question heavy.toml"
    assert asked in (DOCS / "probability.md").read_text(encoding="utf-8").replace("\n", " ")
    said = []
    for command in (*commands.splitlines(), asked):
        _, *words = shlex.split(command)
        # Every worker imports the package, which takes longer than a beam.
        done = activefail(*words, *(["--workers", "1"] if words[0] == "run" else []))
        assert done.code == 0, f"{command}\n{done.err}"
        said.append(done.out)
    assert "stop rule  met" in said[0]
    digits = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    shown = [out.partition("\n")[0].rpartition(": ")[2].translate(digits).replace("·10", "e") for out in said[1:]]
    # Heavier loads on a longer span.
    assert 0.0 < float(shown[0]) < float(shown[1]) < 1.0


@pytest.mark.slow
def test_the_system_of_the_page_on_probabilities_gives_the_shares_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _, limits = blocks("docs/probability.md", "python")
    _, system, _ = blocks("docs/probability.md", "toml")
    Path("frame.py").write_text(limits, encoding="utf-8")
    Path("frame.toml").write_text(system, encoding="utf-8")
    assert "stop rule  met after 24" in activefail("run", "frame.toml", "--out", "run", "--workers", "1").out
    said = [
        line for line in activefail("probability", "run", "--code", ".").out.splitlines() if line.startswith("mode ")
    ]
    page = (DOCS / "probability.md").read_text(encoding="utf-8")
    assert len(said) == 3
    for line in said:
        assert f"    {line}\n" in page


def test_the_campaign_of_the_page_on_distributions_is_one() -> None:
    campaign, in_steps, with_choices, _ = blocks("docs/distributions.md", "toml")
    settings = checked(CampaignSettings, tomllib.loads(campaign), "docs/distributions.md")
    assert settings.sampling.batch == 1
    assert settings.space["load"].distribution == "gumbel_max"
    stepped = settings.model_dump() | tomllib.loads(in_steps)
    assert checked(CampaignSettings, stepped, "docs/distributions.md").space["storeys"].step == 1
    chosen = settings.model_dump() | tomllib.loads(with_choices) | {"correlation": []}
    assert checked(CampaignSettings, chosen, "docs/distributions.md").space["plate"].choices == [8, 10, 12, 15]


def test_the_settings_for_a_cluster_are_settings_and_its_python_compiles() -> None:
    (sampling,) = blocks("docs/cluster.md", "toml")
    assert checked(CampaignSettings, tomllib.loads(sampling), "docs/cluster.md").sampling.asynchronous
    (source,) = blocks("docs/cluster.md", "python")
    compile(source, "docs/cluster.md", "exec")


def test_the_features_of_the_guide_are_those_of_a_campaign(tmp_path: Path) -> None:
    expressions, *_ = blocks("docs/guide.md", "toml")
    (physics,) = (source for source in blocks("docs/guide.md", "python") if "def physics" in source)
    (tmp_path / "mine.py").write_text(physics, encoding="utf-8")
    X = package.TABLE_1.latin_hypercube(5, np.random.default_rng(0))
    T_b, mu, D_tot, T_p, A_p = X[:, [0, 1, 2, 7, 8]].T
    expected = {
        "expressions": [A_p * 9.81 * T_p**2 / D_tot, np.log(mu / A_p)],
        "function": [T_b / T_p],
    }
    python = {"classifier": {"features": {"python": "mine:physics"}}}
    for name, settings in (("expressions", tomllib.loads(expressions)), ("function", python)):
        with package.create_run(tmp_path / name, settings, code=tmp_path) as run:
            scaled = run.features(X)
        assert scaled.shape == (5, 9 + len(expected[name]))
        # Columns are scaled: straight lines remain.
        for column, values in zip(scaled[:, 9:].T, expected[name], strict=True):
            assert abs(np.corrcoef(column, values)[0, 1]) == pytest.approx(1.0)


def test_the_custom_simulator_of_the_guide_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (campaign,) = (text for text in blocks("docs/guide.md", "toml") if '"building:run"' in text)
    (source,) = (text for text in blocks("docs/guide.md", "python") if "def run(design)" in text)
    source = source.replace("...", '0.3 * design["mu"] * design["storeys"] / 3.0')
    (tmp_path / "building.py").write_text(source, encoding="utf-8")
    small = "\n[sampling]\ninitial = 8\nbudget = 8\nbatch = 4\n"
    (tmp_path / "guide.toml").write_text(campaign + small, encoding="utf-8")
    done = activefail("run", "guide.toml", "--out", "run", "--workers", "1")
    assert done.code == 0, done.err
    assert "8/8 simulations" in done.out
    for row in record(tmp_path / "run"):
        reserve = float(row["reserve"])
        assert reserve == pytest.approx(0.03 - 0.3 * float(row["mu"]))
        assert row["outcome"] == ("failure" if reserve <= 0.0 else "damage" if reserve <= 0.025 else "safe")


def test_the_commands_and_python_on_records_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    t = np.arange(0.0, 8.0, 0.01)
    numbers = " ".join(f"{a:.6e}" for a in 0.3 * np.sin(3.0 * t) * np.exp(-0.2 * t))
    header = f"PEER NGA STRONG MOTION DATABASE RECORD\nmade up\nACCELERATION\nNPTS= {len(t)}, DT= .0100 SEC\n"
    Path("RSN953.AT2").write_text(header + numbers + "\n", encoding="utf-8")
    (command,) = blocks("docs/records.md", "sh")
    done = activefail(*shlex.split(command.replace("\\\n", " "))[1:])
    assert done.code == 0, done.err
    assert Path("motion.svg").exists()
    (source,) = blocks("docs/records.md", "python")
    names = {"bearings": package.TABLE_1.latin_hypercube(2, np.random.default_rng(0))[:, :7], "scales": [0.5, 1.0]}
    exec(source, names)
    assert len(names["responses"].outcome_name) == 2  # type: ignore[attr-defined]
