"""The explorer's answers are those of the classifier and the simulator."""

import json
import shlex
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import disc
from explorer.conftest import answers_of, site_of
from report.test_report import other, settings
from typer.testing import CliRunner

from activefail.bearing import Bearing, Pulse, simulate_one
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.cli.app import app
from activefail.errors import InputError
from activefail.explorer import answers as explorer_answers
from activefail.figures.outcome_planes import marks_in
from activefail.findings.results import predict

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"

FAILING = [4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9, 2.5, 0.5]


def test_a_prediction_is_the_classifier_s(answers, findings):
    reply = answers.predict(FAILING)
    expected = predict(findings.campaign, findings.classifier, np.array([FAILING]))
    assert reply["probabilities"] == pytest.approx(expected.probabilities[0].tolist())
    failure = reply["boundaries"][-1]
    assert (failure["probability"], failure["low"], failure["high"]) == pytest.approx(
        (expected.beyond[0], expected.low[0], expected.high[0])
    )
    assert [boundary["text"] for boundary in reply["boundaries"]] == ["impact or worse", "failure"]


def test_the_interval_of_every_boundary_holds_its_probability(answers, findings):
    for point in findings.pool[:50].tolist():
        for boundary in answers.predict(point)["boundaries"]:
            assert 0.0 <= boundary["low"] <= boundary["probability"] <= boundary["high"] <= 1.0


def test_a_simulation_is_the_simulator_s_and_its_frames_are_the_motion(answers):
    reply = answers.simulate(FAILING)
    response = simulate_one(Bearing.from_row(FAILING, 0.3), Pulse.from_table(*FAILING[7:]), to_the_end=True)
    assert reply["outcome"] == response.outcome_name == "failure"
    q = np.array(reply["frames"]["q"])
    assert q.shape == (240, 5)
    np.testing.assert_allclose(q[-1], response.q[-1], atol=1e-4)
    assert reply["command"].startswith("activefail simulate --t-b 4 --mu 0.06 --d-tot 0.6 --h-sl-ratio 0.6 ")


@pytest.mark.parametrize("narrow", [False, True])
def test_histories_say_where_in_them_an_instant_is(answers, narrow):
    reply = answers.histories(FAILING, narrow)
    frames = answers.simulate(FAILING)["frames"]["t"]
    assert reply["times"][0] == pytest.approx(frames[0], abs=1e-4)
    assert frames[0] < frames[-1] < reply["times"][1]
    place = reply["axes"]
    assert 0.0 < place["left"] < place["right"] <= 1.0
    assert 0.0 < place["top"] < place["bottom"] < 1.0
    assert reply["svg"].startswith("<svg")


def test_the_middle_of_the_space_has_no_digits_of_rounding(answers):
    middle = answers.about()["presets"][-1]["point"]
    assert middle == [4.0, 0.07, 0.65, 0.815, 0.125, 45.0, 2.625e9, 2.625, 0.45]
    assert " --mu 0.07 " in answers.simulate(middle)["command"]


def test_the_command_of_a_bearing_of_a_catalogue_has_the_numbers_of_its_choices(tmp_path):
    text = (CAMPAIGNS / "catalogue.toml").read_text().replace("initial = 60\nbudget = 150", "initial = 30\nbudget = 30")
    answers = answers_of(Campaign.of(parse_settings(text, "catalogue")), tmp_path / "run")
    reply = answers.simulate([0.55, 2.0, 1.0, 3.0, 0.6])
    assert reply["command"] == (
        "activefail simulate --t-b 4 --mu 0.1 --d-tot 0.55 --h-sl-ratio 0.6 --h-rim-ratio 0.1 --p 45 --k 2000000000 "
        "--t-p 3 --a-p 0.6"
    )
    result = CliRunner().invoke(app, shlex.split(reply["command"])[1:])
    assert result.exit_code == 0, result.output
    assert reply["outcome"] in result.output
    assert all(part in result.output for part in reply["terms"].split("; rims: "))


def test_the_command_line_of_a_bearing_simulates_that_very_one(tmp_path):
    unusual = (
        "bearing = { slider_density = 5000.0, restitution = 'assembly', loss_of_confinement = false, rim = 'breaking', "
        "rim_strength = 0.8 }"
    )
    answers = answers_of(settings(budget=20, extra=unusual), tmp_path / "run")
    reply = answers.simulate([4.0 / 3.0 + 2.0, *FAILING[1:]])
    assert reply["command"] == (
        "activefail simulate --t-b 3.333333333333333 --mu 0.06 --d-tot 0.6 --h-sl-ratio 0.6 --h-rim-ratio 0.1 --p 45 "
        "--k 2000000000 --t-p 2.5 --a-p 0.5 --restitution assembly --slider-density 5000 --no-loss-of-confinement "
        "--rim breaking --rim-strength 0.8"
    )
    result = CliRunner().invoke(app, shlex.split(reply["command"])[1:])
    assert result.exit_code == 0
    assert "outcome    failure (rim_fracture)" in result.output
    # The last frame shows the broken arcs without a place.
    assert [arcs.count(None) for arcs in reply["frames"]["arcs"]][-2:] == [0, 2]
    json.dumps(reply, allow_nan=False)


def test_every_answer_is_json_that_any_browser_reads(answers):
    for reply in (
        answers.about(),
        answers.predict(FAILING),
        answers.simulate(FAILING),
        answers.fragility(FAILING, 8),
        answers.histories(FAILING, True),
    ):
        json.dumps(reply, allow_nan=False)


def test_a_plane_says_where_its_axes_are_and_names_their_units(answers):
    reply = answers.plane(FAILING, 7, 8, "failure")
    axes = reply["axes"]
    assert 0.0 < axes["left"] < axes["right"] < 1.0
    assert 0.0 < axes["top"] < axes["bottom"] < 1.0
    assert "in the plane of T_p and A_p" in reply["svg"]
    assert "<script" not in reply["svg"]
    assert answers.plane(FAILING, 7, 8, "uncertainty")["svg"] != reply["svg"]


def test_visitors_who_ask_at_once_get_what_each_would_get_alone(answers):
    def asked(number):
        return answers.predict(FAILING) if number % 2 else answers.plane(FAILING, 7, 8, "failure")

    alone = asked(1), asked(2)
    with ThreadPoolExecutor(4) as visitors:
        together = list(visitors.map(asked, range(1, 9)))
    assert together == [*alone] * 4


def test_the_page_names_every_variable_and_shows_a_hostile_name_as_text(answers):
    text = site_of(answers).page("/")
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert text.count('type="range"') == 9 + 1  # and the time of the film
    assert text.count("<script") == 2  # the page's own: what it is about, and its program


def test_the_page_starts_at_a_design_whose_outcome_is_open(answers, findings):
    start, middle = (answers.about()["presets"][place]["point"] for place in (0, -1))
    beyond = predict(findings.campaign, findings.classifier, np.array([start, middle])).beyond
    # 0.1, and what four digits of a variable change.
    assert abs(beyond[0] - 0.5) <= 0.102
    assert all(value == float(f"{value:.4g}") for value in start)
    assert abs(beyond[0] - 0.5) < abs(beyond[1] - 0.5)


def test_a_start_far_from_every_boundary_is_not_called_a_design_at_one(answers, findings, monkeypatch):
    assert answers.about()["presets"][0]["text"] == "a design at the boundary"

    def far(*given):
        prediction = predict(*given)
        return replace(prediction, beyond=0.1 * prediction.beyond)

    monkeypatch.setattr(explorer_answers, "predict", far)
    assert answers.about()["presets"][0]["text"] == "the least certain design"


def test_a_plane_marks_every_simulated_design_and_pales_those_that_differ_in_the_other_variables(findings):
    pale, full = marks_in(findings, np.array(FAILING), [7, 8])
    rows = findings.answered
    assert len(pale.places) + len(full.places) == rows.sum()
    apart = (findings.X[rows] - FAILING) / (findings.campaign.space.high - findings.campaign.space.low)
    near = np.sqrt((apart[:, :7] ** 2).mean(axis=1)) <= 0.25
    assert sorted(full.places.tolist()) == sorted(findings.X[rows][near][:, [7, 8]].tolist())
    assert pale.opacity < full.opacity


@pytest.mark.parametrize("dimension", [1, 2])
def test_another_simulator_is_explored_without_bearings(dimension, tmp_path):
    answers = answers_of(disc() if dimension == 2 else other(1), tmp_path / "run")
    text = site_of(answers).page("/")
    assert "Simulate this bearing" not in text
    assert ("Plane through this design" in text) == (dimension == 2)
    middle = answers.about()["presets"][0]["point"]
    assert len(answers.predict(middle)["probabilities"]) == 2
    assert "<svg" in answers.fragility(middle, 0)["svg"]
    with pytest.raises(InputError, match="no bearing to show"):
        answers.simulate(middle)
