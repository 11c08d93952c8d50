"""The page Design shows the classifier's answers, and verifies them as the command `design` does."""

import re
import shutil
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign.stub import Disc, disc
from explorer.bearings import form
from explorer.conftest import findings_in, served, site_of
from explorer.test_server import ask, cookie_behind_a_proxy, request
from patience import PATIENCE, until

from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.design.required_chart import least_value
from activefail.analyses.findings.results import Findings
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.estimates.integral import boundary_of
from activefail.pages.explorer.jobs import Job, Jobs, StoppedError
from activefail.run.opening import open_run
from activefail.seismic.explorer.design import DesignPage
from activefail.seismic.hazard.hazard import read_hazard
from activefail.simulators.interface import Results
from activefail.space.shares import percent, significant
from activefail.space.space import Array

BEARING = {"T_b": 4.0, "mu": 0.06, "h_sl_ratio": 0.6, "h_rim_ratio": 0.1, "p": 45.0, "k": 2e9}
SITE = {"magnitude": 7.0, "period_dispersion": 0.56, "median_pgv": 0.7, "pgv_dispersion": 0.25, "mu_lower": 0.8}
REQUEST = {"period": "magnitude", "median_period": "2.7", "target": "10"} | SITE | BEARING
HAZARD = """
magnitude = { M = 7.0, dispersion = 0.56 }
pgv = { median_m_s = 0.7, dispersion = 0.25 }
properties = { mu_lower = 0.8 }
"""


class Shown:
    """What the panel of the required value shows, and the curve that it is read off."""

    def __init__(self, design: DesignPage, values: dict[str, Any]) -> None:
        asked = design.asked(values)
        self.html, self.curve = design.required(values), design._curve(asked.site, asked.bearing)
        of = dict(re.findall(r'data-(required|probability)="(.*?)"', self.html))
        self.required = None if of["required"] == "None" else float(of["required"])
        self.probability = float(of["probability"])
        self.text = (
            re.findall(r'<p class="result"[^>]*>(.*?)</p>', self.html)[0].replace("<sub>", "_").replace("</sub>", "")
        )


@pytest.fixture(scope="module")
def design(findings: Findings) -> DesignPage:
    return site_of(findings).others["design"]


@pytest.fixture(scope="module")
def hazard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "site.toml"
    path.write_text(HAZARD)
    return path


# --- at once ------------------------------------------------------------------------------------------------------


def test_the_required_value_and_its_curve_are_those_of_the_classifier(design, findings, hazard):
    shown = Shown(design, REQUEST)
    campaign, grid = findings.campaign, shown.curve.grid
    latent = boundary_of(findings.classifier, campaign.features, "failure")
    question = read_hazard(hazard).question(campaign.space, BEARING)

    def probability(at: float) -> float:
        return classifier_probability(latent, question.at({"D_tot": at}))

    curve = [probability(at) for at in grid.tolist()]
    assert shown.curve.P.tolist() == pytest.approx(curve)
    assert (grid[0], grid[-1]) == (0.45, 0.85)
    least = least_value(grid, np.array(curve), 0.1)
    assert shown.required == pytest.approx(least)
    assert shown.probability == pytest.approx(probability(least))
    outside = float(re.findall(r"([\d.]+) % of the pulses and bearings lie outside", shown.html)[0])
    assert outside == pytest.approx(100.0 * question.share_outside(campaign.space), abs=1.0)
    assert f"</sub> {significant(read_hazard(hazard).median_period)} s" in shown.html
    assert "no interval" in shown.html
    assert "friction × 0.8" in shown.html
    assert "<svg" in shown.html


def test_the_median_period_is_that_of_the_acceleration_and_takes_the_place_of_the_magnitude(design):
    shown = Shown(design, REQUEST | {"period": "median_period", "median_period": 1.5})
    assert shown.curve.hazard.median_period == 1.5
    assert shown.curve.P.tolist() != Shown(design, REQUEST).curve.P.tolist()


def test_a_target_alone_changes_no_curve(design):
    before = Shown(design, REQUEST)
    shown = Shown(design, REQUEST | {"target": 3})
    assert shown.curve is before.curve
    assert shown.text.startswith("The target 3 % requires D_tot = ")


def test_a_required_value_meets_its_target(design):
    asked = design.asked(REQUEST | {"median_pgv": 1.0})
    curve = design._curve(asked.site, asked.bearing)
    targets = np.linspace(0.05, 0.6, 56).round(6).tolist()
    found = {target: value for target in targets if 0.45 < (value := curve.least(target)) < 0.85}
    assert len(found) > 10
    assert [target for target, value in found.items() if curve.probability(value) > target] == []


def test_a_target_out_of_reach_says_so_with_the_least_probability(design):
    shown = Shown(design, REQUEST | {"median_pgv": 3.0, "target": 0.1})
    assert shown.required is None
    assert shown.probability == pytest.approx(shown.curve.P.min())
    assert shown.text.startswith(
        "No D_tot from 0.450 to 0.850 m is large enough that it and every larger one meet the target."
    )


def test_a_target_that_the_smallest_value_meets_says_that_it_is_an_end_of_the_range(design):
    shown = Shown(design, REQUEST | {"median_pgv": 0.1, "pgv_dispersion": 0.05, "target": 90})
    assert shown.required == 0.45
    assert shown.text.startswith("D_tot = 0.450 m, the lower end of the range, meets the target")


# --- verified -----------------------------------------------------------------------------------------------------


def test_a_verification_is_that_of_the_command_and_changes_no_run_folder(design, findings, hazard, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in findings.folder.rglob("*")}
    verification = Job(None)
    reply = design.verified(verification, design.asked(REQUEST))
    assert {path: path.stat().st_mtime_ns for path in findings.folder.rglob("*")} == before
    shutil.copytree(findings.folder, tmp_path / "run")
    with open_run(tmp_path / "run", write=True) as run:
        expected = run.design(0.1, hazard, fixed=BEARING)
    numbers = expected.as_json()
    assert (reply["status"], reply["verdict"]) == (numbers["status"], expected.verdict)
    assert reply["value"] == pytest.approx(numbers["bearing"]["D_tot"])
    between = f"= {percent(numbers['probability'])}, between {percent(numbers['low'])} and {percent(numbers['high'])} ("
    assert between in reply["text"]
    assert reply["text"].endswith(f"from {numbers['simulations']} fresh simulations.")
    assert reply["assumptions"] == expected.assumptions
    assert verification.simulations == numbers["simulations"]
    assert verification.predictions > 1000
    assert 1 < verification.step <= 5


@pytest.mark.parametrize("event", ["stage", "simulated"])
def test_a_verification_stops_between_two_predictions_or_simulations(design, monkeypatch, event):
    verification = Job(None)
    tell = getattr(verification, event)

    def stops(what: Any) -> None:
        verification.must_stop = True
        tell(what)

    monkeypatch.setattr(verification, event, stops)
    with pytest.raises(StoppedError):
        design.verified(verification, design.asked(REQUEST))
    assert verification.simulations == 0
    assert (verification.predictions == 0) == (event == "stage")


# --- requests -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"target": 0.0}, "target: must lie between 0.1 and 90, got 0.0"),
        ({"target": "much"}, "target: must lie between"),
        ({"magnitude": 1e308}, "magnitude: must lie between 5.5 and 8"),
        ({"median_pgv": None}, "median_pgv: must lie between 0.1 and 3"),
        ({"period": "median_period", "median_period": ""}, "median_period: must lie between"),
        ({"period": "none"}, "period: must be one of magnitude, median_period"),
        ({"T_b": 9.0}, "T_b: must lie between 2.5 and 5.5, got 9.0"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_words(server, change, says):
    answer = ask(server, "required", REQUEST | change)
    assert answer.status == 400
    assert says in answer.json["error"]
    assert len(answer.json["error"]) < 1000
    assert "Traceback" not in answer.text


def test_the_page_and_its_panels_are_served_to_this_page_alone(server):
    page = request(server, path="/design")
    assert page.status == 200
    assert "The bearing" in page.text
    assert "Content-Security-Policy" in page.headers
    assert ask(server, "required", REQUEST).status == 200
    for path in ("required", "verify"):
        assert ask(server, path, REQUEST, Origin="http://evil.example").status == 403
        assert ask(server, path, REQUEST, Content_Type="text/plain").status == 415
        assert request(server, path=f"/api/{path}").status == 404


def test_beyond_this_machine_the_page_needs_the_token_too(findings):
    with served(site_of(findings), "0.0.0.0") as abroad:
        assert request(abroad, path="/design").status == 403
        assert request(abroad, path="/page.js").status == 403
        assert ask(abroad, "verify", REQUEST).status == 403
        answer = request(abroad, path=f"/design?token={abroad.token}")
        assert (answer.status, answer.headers["Location"]) == (303, "./design")


def test_behind_a_proxy_that_adds_a_path_all_addresses_of_the_page_are_relative(findings):
    design = form([4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9, 2.5, 0.5])
    with served(site_of(findings), "127.0.0.1", needs_token=True) as server:
        cookie_behind_a_proxy(server, "/design", design)


def test_one_verification_runs_at_a_time_and_ends_when_it_is_stopped_or_the_server_ends(findings, monkeypatch):
    begun, begins = threading.Semaphore(0), []

    def verified(self: DesignPage, job: Job, asked: Any) -> dict[str, Any]:
        job.stage("waiting")
        begins.append(job)
        begun.release()
        until(job.check, "a stop")
        return {}

    monkeypatch.setattr(DesignPage, "verified", verified)
    starts, stops = REQUEST | {"do": "verify"}, REQUEST | {"do": "stop"}
    with Jobs() as jobs, served(site_of(findings, jobs=jobs)) as server:
        assert "data-again" in ask(server, "verify", starts).text
        assert begun.acquire(timeout=PATIENCE)
        second = ask(server, "verify", starts)
        assert (second.status, second.json["error"]) == (
            400,
            "Another verification is running. Wait until it ends.",
        )
        running = ask(server, "verify", REQUEST).text
        assert 'data-state="running"' in running
        assert re.search(r"Step 1 of at most \d+: waiting; 0 predictions", running)
        assert ask(server, "required", REQUEST).status == 200
        assert ask(server, "verify", stops).status == 200
        until(lambda: 'data-state="stopped"' in ask(server, "verify", REQUEST).text, "its end")
        assert "Stopped." in ask(server, "verify", REQUEST).text
        assert ask(server, "verify", starts).status == 200
        assert begun.acquire(timeout=PATIENCE)
    assert [one.state for one in begins] == ["stopped", "stopped"]


# --- other campaigns ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sliding(Disc):
    """Broken where the displacement of the pulse exceeds the capacity; columns D_tot, T_p, A_p."""

    def run(self, X: Array) -> Results:
        """Answer designs, (n, 3)."""
        broken = 0.2 * X[:, 2] * X[:, 1] ** 2 > X[:, 0]
        return Results(broken.astype(np.int8), broken.astype(np.int8), np.zeros((len(X), 1)), np.zeros(len(X)))


SLIDING = """
seed = 1
sampling = { initial = 16, budget = 20, batch = 4 }
classifier.features = "design"
classifier.learns = "outcomes"
acquisition.boundary = "broken"
space.D_tot = { low = 0.2, high = 1.0, unit = "m" }
space.T_p = { low = 0.5, high = 5.0, unit = "s" }
space.A_p = { low = 0.1, high = 0.8, unit = "g" }
space.liner = { choices = ["A", "B"] }
"""
"""With a variable that is none of a bearing, whose others are not added then."""


def sliding(folder: Path, text: str = SLIDING) -> Findings:
    return findings_in(Campaign.of(parse_settings(text, "sliding"), simulator=Sliding()), folder)


def test_a_campaign_without_a_pulse_has_no_such_page_and_no_link_to_it(tmp_path):
    with served(site_of(findings_in(disc(), tmp_path / "run"))) as server:
        assert 'href="design"' not in request(server).text
        assert request(server, path="/design").status == 404
        assert ask(server, "required", REQUEST).status == 404
        assert ask(server, "verify", REQUEST).status == 404


def test_a_capacity_with_choices_has_no_such_page(tmp_path):
    text = SLIDING.replace("D_tot = { low = 0.2, high = 1.0,", "D_tot = { choices = [0.2, 0.6, 1.0],")
    with served(site_of(sliding(tmp_path / "run", text))) as server:
        assert request(server, path="/").status == 200
        assert request(server, path="/design").status == 404


ASKED = {name: value for name, value in REQUEST.items() if name not in ("mu_lower", *BEARING)} | {"liner": "1"}


def test_code_of_a_run_folder_is_not_run_to_verify(tmp_path):
    with served(site_of(sliding(tmp_path / "run"))) as server:
        assert ask(server, "required", ASKED).status == 200
        shown = ask(server, "verify", ASKED).text
        assert "<button" not in shown
        assert "The explorer simulates only activefail&#39;s own bearing model" in shown
        answer = ask(server, "verify", ASKED | {"do": "verify"})
    assert answer.status == 400
    assert "cannot verify this design" in answer.json["error"]


def test_a_required_capacity_is_one_that_is_made_and_choices_are_a_list(tmp_path):
    site = site_of(sliding(tmp_path / "run", SLIDING.replace("high = 1.0,", "high = 1.0, step = 0.1,")))
    assert '<option value="0" selected>A</option>' in site.page("/design")
    P = Shown(site.others["design"], ASKED).curve.P
    target = float(f"{50.0 * (min(P) + max(P)):.6g}")
    shown = Shown(site.others["design"], ASKED | {"target": target})
    assert shown.required in np.round(np.arange(0.2, 1.05, 0.1), 12)
    assert shown.curve.probability(shown.required) <= target / 100.0 < shown.curve.probability(shown.required - 0.1)


def test_the_page_shows_a_hostile_name_as_text_and_labels_every_control(findings):
    text = site_of(findings).page("/design")
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    names = re.findall(r'<input type="number" id="(.*?)"', text)
    assert len(names) == text.count('type="range"') == 2 + 4 + 6 + 1
    for name in names:
        assert f'<label for="{name}">' in text
    assert text.count("<script") == 1
