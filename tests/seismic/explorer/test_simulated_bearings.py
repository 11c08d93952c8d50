"""The explorer shows a simulated bearing as the simulator and the command do."""

import re
import shlex
from pathlib import Path

import numpy as np
from explorer.bearings import form
from explorer.conftest import findings_in, site_of
from explorer.test_answers import place_in
from explorer.test_server import ask
from report.bearings import settings
from typer.testing import CliRunner

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.cli.app import app
from activefail.seismic.bearing import Bearing, Pulse, simulate_one

CAMPAIGNS = Path(__file__).parents[3] / "campaigns"

FAILING = [4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9, 2.5, 0.5]

FORM = form(FAILING, across="T_p", up="A_p", shown="failure", along="A_p")


def command(html: str) -> str:
    """The command that simulates a bearing."""
    return re.findall(r'<code id="command">(.*?)</code>', html)[0].replace("&#39;", "'")


def moved(html: str, place: int = 0) -> np.ndarray:
    """The values of the transformations of a film, (240, columns)."""
    values = re.findall(r'<animateTransform [^>]*values="([^"]*)"', html)[place]
    return np.array([[float(number) for number in row.split(",")] for row in values.split(";")])


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


def test_a_simulation_is_served(server):
    assert 'data-outcome="failure"' in ask(server, "simulate", FORM).text
