"""The panels of one design are the classifier's and the simulator's."""

import re
import shlex
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import disc
from explorer.conftest import findings_in, form, site_of
from report.test_report import other, settings
from typer.testing import CliRunner

from activefail.analyses.findings.results import predict
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.cli.app import app
from activefail.errors import InputError
from activefail.pages.explorer import campaign as explorer_campaign
from activefail.pages.figures.outcome_planes import marks_in
from activefail.pages.report.environment import probability
from activefail.seismic.bearing import Bearing, Pulse, simulate_one

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"

FAILING = [4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9, 2.5, 0.5]
FORM = form(FAILING, across="T_p", up="A_p", shown="failure", along="A_p")


def command(html: str) -> str:
    """The command that simulates a bearing."""
    return re.findall(r'<code id="command">(.*?)</code>', html)[0].replace("&#39;", "'")


def moved(html: str, place: int = 0) -> np.ndarray:
    """The values of the transformations of a film, (240, columns)."""
    values = re.findall(r'<animateTransform [^>]*values="([^"]*)"', html)[place]
    return np.array([[float(number) for number in row.split(",")] for row in values.split(";")])


def place_in(html: str) -> dict[str, float]:
    """Where axes are in a drawing."""
    return {side: float(share) for side, share in re.findall(r"--(left|right|top|bottom):([\d.]+);", html)}


def test_a_prediction_is_the_classifier_s(one, findings):
    html = one.predict(FORM)
    expected = predict(findings.campaign, findings.classifier, np.array([FAILING]))
    shares = [float(share) for share in re.findall(r'data-probability="(.*?)"', html)]
    assert shares == pytest.approx(expected.probabilities[0].tolist())
    p, low, high = map(probability, (expected.beyond[0], expected.low[0], expected.high[0]))
    assert f"{p} ({low} to {high})" in unescape(html)
    assert re.findall(r'data-boundary="(.*?)"', html) == ["impact or worse", "failure"]


def test_the_interval_of_every_boundary_holds_its_probability(one, findings):
    for point in findings.pool[:50].tolist():
        bars = re.findall(
            r'left:([\d.e-]+)%;right:([\d.e-]+)%"></i><i class="dot" style="left:([\d.e-]+)%', one.predict(form(point))
        )
        assert len(bars) == 2
        for low, from_right, middle in ((*map(float, bar),) for bar in bars):
            assert 0.0 <= low <= middle <= 100.0 - from_right + 1e-9 <= 100.0 + 1e-9


def test_a_simulation_is_the_simulator_s_and_its_film_is_the_motion(one):
    html = one.simulate(FORM)
    response = simulate_one(Bearing.from_row(FAILING, 0.3), Pulse.from_table(*FAILING[7:]), to_the_end=True)
    assert response.outcome_name == "failure"
    assert 'data-outcome="failure"' in html
    top, slider, tilt = (moved(html, place) for place in range(3))
    assert len(top) == 240
    last = [*slider[-1], np.radians(tilt[-1, 0]), *top[-1]]
    np.testing.assert_allclose(last, response.q[-1], atol=1e-4)
    assert command(html).startswith("activefail simulate --t-b 4 --mu 0.06 --d-tot 0.6 --h-sl-ratio 0.6 ")


def test_histories_say_where_in_them_the_ends_of_the_film_are(one):
    place = place_in(one.simulate(FORM))
    assert 0.0 < place["left"] < place["right"] < 1.0
    assert 0.0 < place["top"] < place["bottom"] < 1.0


def test_the_middle_of_the_space_has_no_digits_of_rounding(one):
    middle = one.presets[-1][1]
    assert middle == [4.0, 0.07, 0.65, 0.815, 0.125, 45.0, 2.625e9, 2.625, 0.45]
    assert " --mu 0.07 " in command(one.simulate(form(middle)))


def test_the_command_of_a_bearing_of_a_catalogue_has_the_numbers_of_its_choices(tmp_path):
    text = (CAMPAIGNS / "catalogue.toml").read_text().replace("initial = 60\nbudget = 150", "initial = 30\nbudget = 30")
    one = site_of(findings_in(Campaign.of(parse_settings(text, "catalogue")), tmp_path / "run")).one
    html = one.simulate(dict(zip(one.space.names, [0.55, 2.0, 1.0, 3.0, 0.6], strict=True)))
    assert command(html) == (
        "activefail simulate --t-b 4 --mu 0.1 --d-tot 0.55 --h-sl-ratio 0.6 --h-rim-ratio 0.1 --p 45 --k 2000000000 "
        "--t-p 3 --a-p 0.6"
    )
    result = CliRunner().invoke(app, shlex.split(command(html))[1:])
    assert result.exit_code == 0, result.output
    assert re.findall(r'data-outcome="(.*?)"', html)[0] in result.output
    terms = re.sub(r"<sub>(.*?)</sub>", r"_\1", re.findall(r'<p class="soft">(.*?)</p>', html)[-2])
    assert all(part in result.output for part in terms.split("; rims: "))


def test_the_command_line_of_a_bearing_simulates_that_very_one(tmp_path):
    unusual = (
        "bearing = { slider_density = 5000.0, restitution = 'assembly', loss_of_confinement = false, rim = 'breaking', "
        "rim_strength = 0.8 }"
    )
    one = site_of(findings_in(settings(budget=20, extra=unusual), tmp_path / "run")).one
    html = one.simulate(form([4.0 / 3.0 + 2.0, *FAILING[1:]]))
    assert command(html) == (
        "activefail simulate --t-b 3.333333333333333 --mu 0.06 --d-tot 0.6 --h-sl-ratio 0.6 --h-rim-ratio 0.1 --p 45 "
        "--k 2000000000 --t-p 2.5 --a-p 0.5 --restitution assembly --slider-density 5000 --no-loss-of-confinement "
        "--rim breaking --rim-strength 0.8"
    )
    result = CliRunner().invoke(app, shlex.split(command(html))[1:])
    assert result.exit_code == 0
    assert "outcome    failure (rim_fracture)" in result.output
    # At the end broken rims are hidden, and their outlines are shown.
    assert html.count('values="visible;hidden"') == html.count('values="hidden;visible"') > 0


def test_a_plane_says_where_its_axes_are_and_names_their_units(one):
    html = one.plane(FORM)
    place = place_in(html)
    assert 0.0 < place["left"] < place["right"] < 1.0
    assert 0.0 < place["top"] < place["bottom"] < 1.0
    assert 'data-axes="T_p A_p"' in html
    assert "in the plane of T_p and A_p" in html
    assert "<script" not in html
    assert one.plane(FORM | {"shown": "uncertainty"}) != html


def test_visitors_who_ask_at_once_get_what_each_would_get_alone(one):
    def asked(number):
        return one.predict(FORM) if number % 2 else one.plane(FORM)

    alone = asked(1), asked(2)
    with ThreadPoolExecutor(4) as visitors:
        together = list(visitors.map(asked, range(1, 9)))
    assert together == [*alone] * 4


def test_the_page_names_every_variable_and_shows_a_hostile_name_as_text(findings):
    text = site_of(findings).page("/")
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert text.count('type="range"') == text.count('type="number"') == 9
    assert text.count("<script") == 1  # the page's own program


def test_the_page_starts_at_a_design_whose_outcome_is_open(one, findings):
    start, middle = (one.presets[place][1] for place in (0, -1))
    beyond = predict(findings.campaign, findings.classifier, np.array([start, middle])).beyond
    # 0.1, and what four digits of a variable change.
    assert abs(beyond[0] - 0.5) <= 0.102
    assert all(value == float(f"{value:.4g}") for value in start)
    assert abs(beyond[0] - 0.5) < abs(beyond[1] - 0.5)


def test_a_start_far_from_every_boundary_is_not_called_a_design_at_one(one, findings, monkeypatch):
    assert one.presets[0][0] == "a design at the boundary"

    def far(*given):
        prediction = predict(*given)
        return replace(prediction, beyond=0.1 * prediction.beyond)

    monkeypatch.setattr(explorer_campaign, "predict", far)
    assert site_of(findings).one.presets[0][0] == "the least certain design"


def test_a_plane_marks_every_simulated_design_and_pales_those_that_differ_in_the_other_variables(findings):
    pale, full = marks_in(findings, np.array(FAILING), [7, 8])
    rows = findings.history.answered
    assert len(pale.places) + len(full.places) == rows.sum()
    apart = (findings.history.designs[rows] - FAILING) / (findings.campaign.space.high - findings.campaign.space.low)
    near = np.sqrt((apart[:, :7] ** 2).mean(axis=1)) <= 0.25
    assert sorted(full.places.tolist()) == sorted(findings.history.designs[rows][near][:, [7, 8]].tolist())
    assert pale.opacity < full.opacity


@pytest.mark.parametrize("dimension", [1, 2])
def test_another_simulator_is_explored_without_bearings(dimension, tmp_path):
    site = site_of(findings_in(disc() if dimension == 2 else other(1), tmp_path / "run"))
    one, text = site.one, site.page("/")
    assert "Simulate this bearing" not in text
    assert ("Plane through this design" in text) == (dimension == 2)
    middle = dict(zip(one.space.names, one.presets[0][1], strict=True))
    assert one.predict(middle).count("data-probability") == 2
    assert "<svg" in one.fragility(middle | {"along": one.space.names[0]})
    with pytest.raises(InputError, match="no design to show"):
        one.simulate(middle)
