"""The panels of one design are the classifier's and the simulator's."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from campaign.stub import disc
from explorer.conftest import findings_in, form, site_of
from report.test_report import other

from activefail.analyses.findings.results import predict
from activefail.errors import InputError
from activefail.pages.explorer import campaign as explorer_campaign
from activefail.pages.figures.outcome_planes import marks_in
from activefail.pages.report.environment import probability

FAILING = [0.06, 2e9, 4.0, 0.5]
FORM = form(FAILING, across="T_g", up="A_g", shown="failure", along="A_g")


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


def test_a_plane_says_where_its_axes_are_and_names_their_units(one):
    html = one.plane(FORM)
    place = place_in(html)
    assert 0.0 < place["left"] < place["right"] < 1.0
    assert 0.0 < place["top"] < place["bottom"] < 1.0
    assert 'data-axes="T_g A_g"' in html
    assert "in the plane of T_g and A_g" in html
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
    assert text.count('type="range"') == text.count('type="number"') == 4
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
    pale, full = marks_in(findings, np.array(FAILING), [2, 3])
    rows = findings.history.answered
    assert len(pale.places) + len(full.places) == rows.sum()
    apart = (findings.history.designs[rows] - FAILING) / (findings.campaign.space.high - findings.campaign.space.low)
    near = np.sqrt((apart[:, :2] ** 2).mean(axis=1)) <= 0.25
    assert sorted(full.places.tolist()) == sorted(findings.history.designs[rows][near][:, [2, 3]].tolist())
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
