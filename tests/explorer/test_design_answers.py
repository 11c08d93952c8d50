"""The page Design shows the classifier's answers, and verifies them as the command `design` does."""

import json
import shutil
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign.stub import Disc, disc
from explorer.conftest import answers_of, served
from explorer.test_server import ask, request
from patience import PATIENCE, until

from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import hazard_question, read_hazard
from activefail.campaign.settings import parse_settings
from activefail.errors import SimulationError
from activefail.explorer.answers import Answers
from activefail.explorer.design import DesignAnswers
from activefail.explorer.pages import page
from activefail.explorer.questions import read
from activefail.explorer.verification import StoppedError, Verification
from activefail.opening import open_run
from activefail.reliability.integral import boundary_of
from activefail.risk.classifier_probability import classifier_probability
from activefail.risk.design.required_chart import least_value
from activefail.shares import percent
from activefail.simulators.interface import Results
from activefail.space import Array

BEARING = {"T_b": 4.0, "mu": 0.06, "h_sl_ratio": 0.6, "h_rim_ratio": 0.1, "p": 45.0, "k": 2e9}
SITE = {"magnitude": 7.0, "period_dispersion": 0.56, "median_pgv": 0.7, "pgv_dispersion": 0.25, "mu_lower": 0.8}
REQUEST = {"site": SITE, "bearing": BEARING, "target": 0.1}
HAZARD = """
magnitude = { M = 7.0, dispersion = 0.56 }
pgv = { median_m_s = 0.7, dispersion = 0.25 }
properties = { mu_lower = 0.8 }
"""


def by_period(median: float) -> dict[str, float]:
    """The site with the median period in place of the magnitude."""
    return {"median_period": median} | {name: value for name, value in SITE.items() if name != "magnitude"}


def asked(design: DesignAnswers, question: dict[str, Any]) -> dict[str, Any]:
    """The arguments of a question."""
    return read(question, design.readers)


def required(design: DesignAnswers, question: dict[str, Any]) -> dict[str, Any]:
    return design.required(**asked(design, question))


@pytest.fixture(scope="module")
def design(answers: Answers) -> DesignAnswers:
    return DesignAnswers(answers)


@pytest.fixture(scope="module")
def hazard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "site.toml"
    path.write_text(HAZARD)
    return path


# --- at once ------------------------------------------------------------------------------------------------------


def test_the_required_value_and_its_curve_are_those_of_the_classifier(design, findings, hazard):
    reply = required(design, REQUEST)
    campaign = findings.campaign
    latent = boundary_of(findings.classifier, campaign.features, "failure")
    question = hazard_question(read_hazard(hazard), campaign.space, BEARING)

    def probability(at: float) -> float:
        return classifier_probability(latent, question.at({"D_tot": at}))

    curve = [probability(at) for at in reply["grid"]]
    assert reply["curve"] == pytest.approx(curve)
    assert (reply["grid"][0], reply["grid"][-1]) == (0.45, 0.85)
    least = least_value(np.array(reply["grid"]), np.array(curve), 0.1)
    assert reply["required"] == pytest.approx(least)
    assert reply["probability"] == pytest.approx(probability(least))
    outside = float(reply["outside_text"].removesuffix(" %"))
    assert outside == pytest.approx(100.0 * question.share_outside(campaign.space), abs=1.0)
    assert reply["median_period"] == pytest.approx(read_hazard(hazard).median_period)
    assert any("no interval" in note for note in reply["notes"])
    assert any("friction × 0.8" in note for note in reply["notes"])
    assert reply["svg"].startswith("<svg")
    json.dumps(reply, allow_nan=False)


def test_the_median_period_is_that_of_the_acceleration_and_takes_the_place_of_the_magnitude(design):
    reply = required(design, REQUEST | {"site": by_period(1.5)})
    assert reply["median_period"] == 1.5
    assert reply["curve"] != required(design, REQUEST)["curve"]


def test_a_target_alone_changes_no_curve(design):
    before = required(design, REQUEST)
    reply = required(design, REQUEST | {"target": 0.03})
    assert reply["curve"] == before["curve"]
    assert reply["text"].startswith("The target 3 % requires D_tot = ")


def test_a_required_value_meets_its_target(design, monkeypatch):
    monkeypatch.setattr(design, "_drawn", lambda *_: "")
    targets = np.linspace(0.05, 0.6, 56).round(6).tolist()
    strong = REQUEST | {"site": SITE | {"median_pgv": 1.0}}
    replies = {target: required(design, strong | {"target": target}) for target in targets}
    found = {target: reply for target, reply in replies.items() if 0.45 < (reply["required"] or 0.0) < 0.85}
    assert len(found) > 10
    assert [target for target, reply in found.items() if reply["probability"] > target] == []


def test_a_target_out_of_reach_says_so_with_the_least_probability(design):
    strong = SITE | {"median_pgv": 3.0}
    reply = required(design, REQUEST | {"site": strong, "target": 0.001})
    assert reply["required"] is None
    assert reply["probability"] == pytest.approx(min(reply["curve"]))
    assert reply["text"].startswith(
        "No D_tot from 0.450 to 0.850 m is large enough that it and every larger one meet the target."
    )


def test_a_target_that_the_smallest_value_meets_says_that_it_is_an_end_of_the_range(design):
    weak = SITE | {"median_pgv": 0.1, "pgv_dispersion": 0.05}
    reply = required(design, REQUEST | {"site": weak, "target": 0.9})
    assert reply["required"] == 0.45
    assert reply["text"].startswith("D_tot = 0.450 m, the lower end of the range, meets the target")


# --- verified -----------------------------------------------------------------------------------------------------


def test_a_verification_is_that_of_the_command_and_changes_no_run_folder(design, findings, hazard, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in findings.folder.rglob("*")}
    verification = Verification()
    reply = design.verified(verification, **asked(design, REQUEST))
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
    json.dumps(reply, allow_nan=False)


@pytest.mark.parametrize("event", ["stage", "simulated"])
def test_a_verification_stops_between_two_predictions_or_simulations(design, monkeypatch, event):
    verification = Verification()
    tell = getattr(verification, event)

    def stops(what: Any) -> None:
        verification.stop()
        tell(what)

    monkeypatch.setattr(verification, event, stops)
    with pytest.raises(StoppedError):
        design.verified(verification, **asked(design, REQUEST))
    assert verification.simulations == 0
    assert (verification.predictions == 0) == (event == "stage")


def test_a_verification_tells_why_it_has_no_result(capfd):
    first, second = Verification(), Verification()

    def broken(verification: Verification) -> dict[str, Any]:
        raise (SimulationError("None gave an outcome.") if verification is first else RuntimeError("a secret"))

    first.run(broken)
    second.run(broken)
    assert (first.state, first.error) == ("failed", "None gave an outcome.")
    assert (second.state, second.error) == ("failed", "The explorer failed; its terminal shows the error.")
    assert "a secret" in capfd.readouterr().err


# --- requests -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"target": 0.0}, "target: must lie between 0.001 and 0.9, got 0.0"),
        ({"target": "0.1"}, "target: must lie between"),
        ({"site": [1.0]}, "site: must be a JSON object"),
        ({"site": SITE | {"magnitude": 1e308}}, "site.magnitude: must lie between 5.5 and 8"),
        ({"site": SITE | {"median_pgv": None}}, "site.median_pgv: must lie between 0.1 and 3"),
        ({"site": SITE | {"median_period": 2.0}}, "site: must be a JSON object with the keys"),
        ({"site": {"magnitude": 7.0}}, "site: must be a JSON object with the keys"),
        ({"bearing": BEARING | {"T_b": 9.0}}, "bearing.T_b: must lie between 2.5 and 5.5, got 9.0"),
        ({"bearing": BEARING | {"D_tot": 0.6}}, "bearing: must be a JSON object with the keys"),
        ({"simulations": 10**9}, "question: must be a JSON object with the keys"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_words(server, change, says):
    answer = ask(server, "design", REQUEST | change)
    assert answer.status == 400
    assert says in answer.json["error"]
    assert len(answer.json["error"]) < 1000
    assert "Traceback" not in answer.text


def test_the_page_and_its_answers_are_served_to_this_page_alone(server):
    page = request(server, path="/design")
    assert page.status == 200
    assert "The bearing" in page.text
    assert "Content-Security-Policy" in page.headers
    assert ask(server, "design", REQUEST).status == 200
    for path in ("design", "verify", "progress", "stop"):
        assert ask(server, path, REQUEST, Origin="http://evil.example").status == 403
        assert ask(server, path, REQUEST, Content_Type="text/plain").status == 415
        assert request(server, path=f"/api/{path}").status == 404


@pytest.mark.parametrize("name", [None, 1, "", "x", "é", ["x"]])
@pytest.mark.parametrize("path", ["progress", "stop"])
def test_only_the_last_verification_is_known_by_its_id(server, path, name):
    answer = ask(server, path, {"id": name})
    assert answer.status == 400
    assert "id: must be that of the last verification" in answer.json["error"]


def test_beyond_this_machine_the_page_needs_the_token_too(answers):
    with served(answers, "0.0.0.0") as abroad:
        assert request(abroad, path="/design").status == 403
        assert request(abroad, path="/common.js").status == 403
        assert ask(abroad, "verify", REQUEST).status == 403
        answer = request(abroad, path=f"/design?token={abroad.token}")
        assert (answer.status, answer.headers["Location"]) == (303, "./design")


def test_one_verification_runs_at_a_time_and_ends_when_it_is_stopped_or_the_server_ends(answers, monkeypatch):
    begun, begins = threading.Semaphore(0), []

    def verified(self: DesignAnswers, verification: Verification, **asked: Any) -> dict[str, Any]:
        verification.stage("waiting")
        begins.append(verification)
        begun.release()
        until(verification.check, "a stop")
        return {}

    monkeypatch.setattr(DesignAnswers, "verified", verified)
    with served(answers) as server:
        first = ask(server, "verify", REQUEST)
        assert first.status == 200
        assert begun.acquire(timeout=PATIENCE)
        second = ask(server, "verify", REQUEST)
        assert (second.status, second.json["error"]) == (
            400,
            "Another verification is running. Wait until it ends.",
        )
        name = {"id": first.json["id"]}
        running = ask(server, "progress", name).json
        assert (running["state"], running["text"], running["step"], running["result"]) == (
            "running",
            "waiting",
            1,
            None,
        )
        assert ask(server, "predict", {"point": [4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9, 2.5, 0.5]}).status == 200
        assert ask(server, "stop", name).status == 200
        until(lambda: ask(server, "progress", name).json["state"] == "stopped", "its end")
        third = ask(server, "verify", REQUEST)
        assert third.status == 200
        assert begun.acquire(timeout=PATIENCE)
        assert ask(server, "progress", name).status == 400
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


def test_a_campaign_without_a_pulse_has_no_such_page_and_no_link_to_it(tmp_path):
    with served(answers_of(disc(), tmp_path / "run")) as server:
        assert 'href="design"' not in request(server).text
        assert request(server, path="/design").status == 404
        assert ask(server, "design", REQUEST).status == 404
        assert ask(server, "verify", REQUEST).status == 404


def test_a_capacity_with_choices_has_no_such_page(tmp_path):
    text = SLIDING.replace("D_tot = { low = 0.2, high = 1.0,", "D_tot = { choices = [0.2, 0.6, 1.0],")
    with served(
        answers_of(Campaign.of(parse_settings(text, "sliding"), simulator=Sliding()), tmp_path / "run")
    ) as server:
        assert request(server, path="/").status == 200
        assert request(server, path="/design").status == 404


def test_code_of_a_run_folder_is_not_run_to_verify(tmp_path):
    answers = answers_of(Campaign.of(parse_settings(SLIDING, "sliding"), simulator=Sliding()), tmp_path / "run")
    design = DesignAnswers(answers)
    text = page("design", about=design.about(), home="", has_design=True)
    assert 'id="verify"' not in text
    assert "The explorer simulates only activefail&#39;s own bearing model" in text
    site = {name: value for name, value in SITE.items() if name != "mu_lower"}
    question = {"site": site, "bearing": {"liner": 1.0}, "target": 0.1}
    with served(answers) as server:
        assert ask(server, "design", question).status == 200
        answer = ask(server, "verify", question)
    assert answer.status == 400
    assert "cannot verify this design" in answer.json["error"]


def test_a_required_capacity_is_one_that_is_made_and_choices_are_a_list(tmp_path):
    made = SLIDING.replace("high = 1.0,", "high = 1.0, step = 0.1,")
    answers = answers_of(Campaign.of(parse_settings(made, "sliding"), simulator=Sliding()), tmp_path / "run")
    design = DesignAnswers(answers)
    assert '<option value="1">B</option>' in page("design", about=design.about(), home="", has_design=True)
    site = {name: value for name, value in SITE.items() if name != "mu_lower"}
    P = required(design, {"site": site, "bearing": {"liner": 1.0}, "target": 0.5})["curve"]
    target = 0.5 * (min(P) + max(P))
    answer = required(design, {"site": site, "bearing": {"liner": 1.0}, "target": target})
    curve = design._curve(tuple(site.items()), (("liner", 1.0),))
    assert answer["required"] in np.round(np.arange(0.2, 1.05, 0.1), 12)
    assert curve.probability(answer["required"]) <= target < curve.probability(answer["required"] - 0.1)


def test_the_page_shows_a_hostile_name_as_text_and_labels_every_control(design):
    text = page("design", about=design.about(), home="", has_design=True)
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    sliders = text.count('type="range"')
    assert sliders == 2 + 4 + 6
    for number in range(sliders):
        assert f'<label for="v{number}">' in text
    assert text.count("<script") == 2
