"""Campaign files of bearings: what ships, what is left out, and the section of the bearing."""

from pathlib import Path
from typing import Any

import hypothesis
import pytest
import tomli_w
from campaign.test_settings import stay_the_same
from campaign.test_shipped import shipped
from hypothesis import given
from hypothesis import strategies as st

from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import shipped_campaigns
from activefail.campaign.settings import parse_settings, read_settings
from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Model, Tolerance

SHIPPED = sorted((Path(__file__).parents[3] / "campaigns").glob("*.toml"))


def _refusal(text: str) -> str:
    with pytest.raises(InputError) as refused:
        parse_settings(text, "mine.toml")
    return str(refused.value)


@pytest.mark.parametrize("name", shipped())
def test_every_campaign_that_ships_can_be_run_and_says_what_it_should_show(name: str) -> None:
    path = shipped_campaigns()[name]
    settings = read_settings(path)
    campaign = Campaign.of(settings, path.parent)
    assert settings.simulator != "dfp" or campaign.space == TABLE_1 or path.stem == "catalogue"
    assert settings.description
    assert parse_settings(settings.text(), "frozen") == settings
    comment = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert any("What it shows" in line for line in comment)


def test_the_paper_campaign_is_the_papers() -> None:
    settings = read_settings(SHIPPED[0].with_name("paper.toml"))
    assert settings.design_space() == TABLE_1
    assert (settings.sampling.initial, settings.classifier.features, settings.classifier.kernel) == (
        250,
        "paper",
        "rbf",
    )
    assert settings.bearing.model() == Model()
    assert settings.bearing.integration() == Tolerance()


def test_an_empty_file_is_the_papers_study() -> None:
    settings = parse_settings("", "empty")
    assert settings.design_space() == TABLE_1
    assert settings.bearing.model() == Model()
    assert settings.bearing.integration() == Tolerance()
    assert Campaign.of(settings).simulator.outcomes == ("no_impact", "impact", "failure")


def test_what_the_file_says_reaches_the_simulator() -> None:
    settings = parse_settings(
        """
        [bearing]
        slider_diameter = 0.25
        restitution_coefficient = 0.5
        restitution = "assembly"
        slider_density = 7000
        friction_velocity = 2e-3
        loss_of_confinement = false
        rim = "yielding"
        rim_strength = 0.8
        rim_deformation = 0.02
        tolerance = 1e-5
        """,
        "mine.toml",
    )
    assert settings.bearing.model() == Model(0.25, 0.5, "assembly", 7000.0, 2e-3, False, "yielding", 0.8, 0.02)
    assert settings.bearing.integration() == Tolerance(relative=1e-5)


def test_the_order_of_the_variables_is_the_files() -> None:
    text = "\n".join(f"space.{p.name} = {{ low = {p.low}, high = {p.high} }}" for p in reversed(TABLE_1.parameters))
    assert parse_settings(text, "mine.toml").design_space().names == TABLE_1.names[::-1]


BROKEN = [
    ('bearing.rim = "soft"', "bearing.rim: must be 'rigid', 'breaking', 'yielding' or 'none', got 'soft'"),
    ('bearing.rim = "breaking"', 'bearing: rim = "breaking" requires `rim_strength`'),
    ("bearing.rim_strength = 0.8", 'bearing: rim = "rigid" cannot be combined with `rim_strength`, got 0.8'),
    ("bearing.rim_strength = -1", "bearing.rim_strength: must be greater than or equal to 0, got -1"),
]


@pytest.mark.parametrize(("text", "says"), BROKEN, ids=[says[:40] for _, says in BROKEN])
def test_a_broken_rule_of_the_bearing_is_named_with_file_key_path_rule_and_value(text: str, says: str) -> None:
    message = _refusal(text)
    assert message.startswith(f"mine.toml:\n  {says}")
    assert len(message.splitlines()) == 2
    assert len(message) < 400


@pytest.mark.parametrize("features", ['"paper"', '"sliding"', '"collision"'])
def test_the_frozen_copy_says_what_the_classifier_sees_of_a_bearing(features: str) -> None:
    settings = parse_settings(f"classifier.features = {features}", "mine.toml")
    assert parse_settings(settings.text(), "frozen") == settings


def test_variables_of_the_bearing_that_a_file_leaves_out_are_as_in_table_1() -> None:
    space = parse_settings(
        "space.T_p = { low = 0.5, high = 12 }\nspace.mu = { value = 0.05 }", "mine.toml"
    ).design_space()
    assert set(space.quantities(dict.fromkeys(space.names))) == set(TABLE_1.names)
    assert (space.parameters[0].high, space.fixed) == (12.0, {"mu": 0.05})
    assert {one for one in space.parameters if one.name != "T_p"} == set(TABLE_1.parameters) - {
        one for one in TABLE_1.parameters if one.name in ("mu", "T_p")
    }


def test_settings_of_the_bearing_beside_a_simulator_of_ones_own_are_refused_unless_features_use_them() -> None:
    table = {p.name: {"low": p.low, "high": p.high} for p in TABLE_1.parameters}
    own = {"simulator": {"command": "a {out}"}, "space": table, "bearing": {"slider_diameter": 0.25}}
    with pytest.raises(InputError, match=r'bearing\.slider_diameter: requires `simulator = "dfp"`.*, got 0\.25'):
        Campaign.of(parse_settings(tomli_w.dumps(own), "mine.toml"))
    sliding = {"classifier": {"features": "sliding"}}
    assert Campaign.of(parse_settings(tomli_w.dumps(own | sliding), "mine.toml")).space.names == TABLE_1.names
    # A run folder's copy has the section, with the defaults.
    frozen = parse_settings(tomli_w.dumps(own | {"bearing": {}}), "mine.toml").text()
    assert "[bearing]" in frozen
    assert Campaign.of(parse_settings(frozen, "frozen")).settings.text() == frozen


def test_the_bearing_model_refuses_a_variable_that_it_has_not_and_one_that_reaches_zero() -> None:
    table = {p.name: {"low": p.low, "high": p.high} for p in TABLE_1.parameters}
    with pytest.raises(
        InputError, match=r"space\.wind: the dfp simulator has no such variable; its variables are T_b, mu"
    ):
        Campaign.of(parse_settings(tomli_w.dumps({"space": table | {"wind": {"low": 0, "high": 1}}}), "mine.toml"))
    table["mu"] = {"low": 0.0, "high": 0.12}
    with pytest.raises(InputError, match=r"space\.mu\.low: must be positive for the dfp simulator, got 0\.0"):
        Campaign.of(parse_settings(tomli_w.dumps({"space": table}), "mine.toml"))


def test_a_switch_of_the_bearing_is_no_number() -> None:
    assert "bearing.loss_of_confinement: must be" in _refusal("bearing.loss_of_confinement = 0")


@hypothesis.settings(deadline=None)
@given(
    values=st.fixed_dictionaries(
        {"slider_diameter": st.floats(1e-3, 4.9)}, optional={"loss_of_confinement": st.booleans()}
    )
)
def test_settings_of_a_bearing_written_out_and_read_again_are_the_same_to_the_last_bit(values: dict[str, Any]) -> None:
    stay_the_same({"bearing": values})
