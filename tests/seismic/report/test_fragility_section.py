"""The report under a hazard: fragility, and what targets require, from the classifier and from stored simulations."""

import json
import shutil
from pathlib import Path

import pytest
from commandline import activefail, refused, sets
from report.browser import browser, console_errors, photograph, screenshots
from report.pictures import slow_pictures_empty
from report.test_report import self_contained

from activefail.analyses.design.design_task import Requirement
from activefail.analyses.design.stored import stored_designs
from activefail.campaign.inquiry import Inquiry
from activefail.errors import InputError
from activefail.pages.report.fragility_section import risk_findings, risk_options
from activefail.run.opening import open_run
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.pulse import VELOCITY_PER_ACCELERATION
from activefail.seismic.hazard.hazard import read_hazard
from activefail.session.session import estimating
from activefail.space.shares import percent, significant

LIMIT = f"""
import math

def reserve(d):
    velocity = {VELOCITY_PER_ACCELERATION * GRAVITY!r} * d["A_p"] * d["T_p"]
    return math.log(2.0 * d["D_tot"] * (d["mu"] / 0.06) ** 0.3 * (d["T_b"] / 4.0) ** 0.5 / velocity)
"""

CAMPAIGN = """
seed = 3
[simulator]
python = "pulses:reserve"
outcomes = ["safe", "damage", "failure"]
margins = ["g"]
levels = { g = [0.3, 0.0] }
[sampling]
initial = 25
budget = 40
[space]
T_p = { distribution = "lognormal", median = 2.0, dispersion = 0.6, unit = "s" }
A_p = { distribution = "lognormal", median = 0.3, dispersion = 0.8, unit = "g" }
D_tot = { low = 0.2, high = 1.2, unit = "m" }
T_b = { low = 2.0, high = 6.0, unit = "s" }
mu = { low = 0.03, high = 0.1 }
"""

HAZARD = """
description = "a <site>"
[pulse_period]
median_s = 2.0
dispersion = 0.4
definition = "acceleration"
[pgv]
median_m_s = 0.8
dispersion = 0.25
[uncertainty]
modelling = 0.2
[curve]
pgv_m_s = [0.5, 2.0]
annual_rate = [1.6e-3, 1e-4]
"""

BEARING = "T_b = 4.0\nmu = 0.06\n"


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("risk")
    (folder / "pulses.py").write_text(LIMIT)
    (folder / "made.toml").write_text(CAMPAIGN)
    (folder / "site.toml").write_text(HAZARD)
    (folder / "bearing.toml").write_text(BEARING + "D_tot = 0.7\n")
    (folder / "fixed.toml").write_text(BEARING)
    result = activefail("run", folder / "made.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    return folder


@pytest.fixture(scope="module")
def plain(ended: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report, before anything was verified."""
    page = tmp_path_factory.mktemp("plain") / "page.html"
    with slow_pictures_empty():
        result = activefail(
            "report", ended / "run", "--hazard", ended / "site.toml", "--bearing", ended / "bearing.toml", "--out", page
        )
    assert result.code == 0, result.err
    assert sets(ended / "run") == {}
    return page.read_text()


@pytest.fixture(scope="module")
def verified(plain: str, ended: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the run folder with a verified curve and a verified design; beside it the files of both."""
    folder = tmp_path_factory.mktemp("verified")
    shutil.copytree(ended, folder, dirs_exist_ok=True)
    at_site = ("--hazard", folder / "site.toml")
    result = activefail(
        "fragility", folder / "run", *at_site, "--fixed", folder / "bearing.toml", "--verify", "90",
        "--out", folder / "curves", "--code", folder,
    )  # fmt: skip
    assert result.code == 0, result.err
    result = activefail(
        "design", folder / "run", *at_site, "--fixed", folder / "fixed.toml", "--target", "0.05",
        "--simulations", "200", "--out", folder / "design",
    )  # fmt: skip
    assert result.code == 0, result.err
    return folder


def reported(folder: Path, **options: object) -> str:
    with open_run(folder / "run", code=folder) as opened:
        page = folder / "page.html"
        opened.report(page, hazard=folder / "site.toml", fixed=folder / "bearing.toml", **options)  # type: ignore[arg-type]
    return page.read_text()


def test_the_report_shows_fragility_and_what_the_risk_categories_require(plain: str) -> None:
    page = self_contained(plain, without=("gallery",))
    ids = {attributes.get("id") for _, attributes in page.elements}
    assert {"fragility"} <= ids
    assert "Fragility against PGV [m/s], under a <site>." in page.text
    assert "Given: T_b = 4 s, mu = 0.06, D_tot = 0.7 m." in page.text
    for words in ("Capacity: the level", "in 50 years", "not added"):
        assert words in page.text, words
    assert "Every number is the classifier's, without an interval." in page.text
    assert "--verify 250 adds them." in page.text
    assert "P(failure) stays below 10 %, 5 %, 2.5 %," in " ".join(page.text.split())
    assert "a verified design. activefail design" in page.text
    assert "--target 0.1 searches and verifies one." in page.text
    assert "--hazard" in page.text.split("Versions of this page")[0].rsplit("activefail report", 1)[1]


@pytest.fixture(scope="module")
def shown(verified: Path) -> Path:
    """The report after the verifications; writing it simulated nothing."""
    before = sets(verified / "run")
    with slow_pictures_empty():
        (verified / "shown.html").write_text(reported(verified))
    assert sets(verified / "run") == before
    return verified / "shown.html"


def test_stored_verifications_are_shown_and_nothing_is_simulated(verified: Path, shown: Path) -> None:
    page = self_contained(shown.read_text(), without=("gallery",))
    findings = json.loads((verified / "curves" / "fragility.json").read_text())
    levels = findings["outcomes"]["failure"]["verified"]
    assert len(levels) == 3
    shown_levels = [(row[0], row[1], row[3]) for row in page.tables["levels-verified-1"][1:]]
    assert shown_levels == [
        (significant(one["level"]), percent(one["probability"]), str(one["simulations"])) for one in levels
    ]
    assert "Every number without one is the classifier's." in page.text
    design = json.loads((verified / "design" / "design.json").read_text())
    row = page.tables["designs-verified"][1]
    assert row == [
        "P(failure) ≤ 5 %",
        f"{design['bearing']['D_tot']:.4g} m",
        f"{design['probability']:.3g}",
        f"{design['low']:.3g} to {design['high']:.3g}",
        "95 %",
        str(design["looks"][-1]["estimates"][0]["simulations"]),
    ]
    assert "a verified design. activefail design" not in page.text


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"target": 0.05', '"target": 0.1'),
        lambda text: text.replace('"D_tot": 0.', '"D_tot": 1.'),
        # As a stranger may write them.
        lambda text: text.replace('"look": ', f'"look": {10**15}'),
        lambda text: text.replace('"look": ', '"look": -'),
        lambda text: text.replace('"D_tot": 0.', '"D_tot": "a", "b": 0.'),
        lambda text: text.replace('"confidence"', '"other"'),
        lambda text: "5",
        lambda text: "[1, [], {}, null]",
    ],
)
def test_a_design_is_shown_only_with_its_simulations(verified: Path, tmp_path: Path, change) -> None:
    folder = tmp_path / "run"
    shutil.copytree(verified / "run", folder)
    wanted = [Requirement("failure", 0.05)]
    with open_run(folder, code=verified) as opened:
        hazard = read_hazard(verified / "site.toml")
        asked_of_site = Inquiry.of(opened.campaign, hazard, None, verified / "bearing.toml")
        with estimating(opened, simulates=False) as estimator:
            question = asked_of_site.question
            assert len(stored_designs(estimator, question, "D_tot", wanted)) == 1
            assert not stored_designs(estimator, question.at({"mu": 0.07}), "D_tot", wanted)
            entries = opened.store.recall(("verified designs",))
            opened.store.recall = lambda identity: json.loads(change(json.dumps(entries)))
            assert not stored_designs(estimator, question, "D_tot", wanted)


def test_a_target_has_a_chart_of_its_own(verified: Path) -> None:
    with open_run(verified / "run", code=verified) as opened:
        asked = risk_options(Path("a site.toml"), None, 0.2, ("safe", "damage", "failure"), "failure")
        hazard = read_hazard(verified / "site.toml")
        with estimating(opened, simulates=False) as estimator:
            asked_of_site = Inquiry.of(opened.campaign, hazard, None, verified / "bearing.toml")
            found = risk_findings(estimator, asked_of_site, asked)
            assert found.chart is not None
            assert found.chart.targets.tolist() == [0.2]
            assert found.request.options == "--hazard 'a site.toml' --target 0.2"
            assert not found.designs
            asked_of_site = Inquiry.of(opened.campaign, hazard, None, {"mu": 0.06})
            found = risk_findings(estimator, asked_of_site, asked)
            assert found.chart is None
            assert "two variables besides D_tot" in found.why_no_chart


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--fixed", "bearing.toml"], "--fixed: requires --hazard."),
        (["--hazard", "site.toml", "--target", "2"], "target: must be a probability between 0.001 and 0.9"),
        (["--hazard", "site.toml", "--target", "failure=0.1,damage=0.2"], "target: must be one target"),
    ],
)
def test_a_wrong_request_is_refused(ended: Path, monkeypatch, options: list[str], message: str) -> None:
    monkeypatch.chdir(ended)
    refused(activefail("report", "run", *options), message)


@pytest.mark.usefixtures("without_pictures")
def test_a_hazard_says_nothing_of_a_campaign_without_a_pulse(ended: Path, tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text("def run(d):\n    return 'failure' if d['x'] > 0.5 else 'safe'\n")
    (tmp_path / "plain.toml").write_text(
        'simulator = { python = "plain:run", outcomes = ["safe", "failure"] }\n'
        "sampling = { initial = 10, budget = 10 }\nspace = { x = { low = 0, high = 1 } }\n"
    )
    assert activefail("run", tmp_path / "plain.toml", "--out", tmp_path / "run").code == 0
    refused(
        activefail("report", tmp_path / "run", "--hazard", ended / "site.toml"),
        "hazard: requires the variable 'T_p' of a pulse; the campaign has x.",
    )
    with open_run(tmp_path / "run", code=tmp_path) as opened:
        with pytest.raises(InputError, match=r"^target: requires hazard\."):
            opened.report(target="II")
        opened.report(tmp_path / "page.html")
    assert "Fragility" not in (tmp_path / "page.html").read_text()


def test_fragility_and_design_write_pages_that_need_nothing_else(verified: Path) -> None:
    for name, files in (
        ("curves", {"fragility.html", "fragility.json", "fragility.csv", "fragility.png", "fragility.svg"}),
        ("design", {"design.html", "design.json", "design.toml", "required_5.png", "required_5.svg"}),
    ):
        assert files <= {path.name for path in (verified / name).iterdir()}
        text = (verified / name / sorted(files)[[".html" in one for one in sorted(files)].index(True)]).read_text()
        assert text.startswith("<!DOCTYPE html>")
        assert "https://" not in text
        assert text.rstrip().endswith("</html>")
    curves = (verified / "curves" / "fragility.html").read_text()
    failure = json.loads((verified / "curves" / "fragility.json").read_text())["outcomes"]["failure"]
    median = failure["capacities"][2]
    assert f"<b>{significant(median['verified'] or median['level'])} m/s</b>" in curves
    assert '<th scope="rowgroup" rowspan="3">failure</th>' in curves


@pytest.mark.needs("browser")
def test_the_section_and_the_pages_open_without_a_complaint(verified: Path, shown: Path, tmp_path: Path) -> None:
    with browser(1280, 2400) as driver:
        for page in (shown, verified / "curves" / "fragility.html", verified / "design" / "design.html"):
            driver.get(page.as_uri() + "#fragility")
            assert console_errors(driver) == []
            assert driver.execute_script("return document.documentElement.scrollWidth") <= 1280
            photograph(driver, screenshots(f"risk-{page.stem}.png", tmp_path))
