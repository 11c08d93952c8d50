"""Variables with choices, under a hazard."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from activefail.analyses.sensitivity.calculation import sensitivity
from activefail.campaign.assembly import Campaign
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.seismic.hazard.hazard import Hazard
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SOIL = Parameter.of_choices("soil", ("A", "B", "soft clay"), (0.2, 0.5, 0.3))

PULSE = DesignSpace((Parameter("T_p", 1.0, 6.0, "s"), Parameter("A_p", 0.1, 1.0, "g"), SOIL))

HAZARD = {
    "pulse_period": {"median_s": 3.0, "dispersion": 0.4, "definition": "acceleration"},
    "pgv": {"median_m_s": 0.6, "dispersion": 0.3},
    "properties": {"mu_lower": 0.5},
}


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("T_p", "hazard: requires T_p without choices, but it must be one of 1, 2 in the campaign."),
        ("A_p", "hazard: requires A_p without choices, but it must be one of 1, 2 in the campaign."),
        ("mu", "properties.mu_lower = 0.5: requires mu without choices, but it must be one of 1, 2 in the campaign."),
    ],
)
def test_a_hazard_gives_choices_no_other_values(name: str, rule: str) -> None:
    of_choices = Parameter.of_choices(name, (1, 2))
    space = DesignSpace((*(one for one in PULSE.parameters if one.name != name), of_choices))
    with pytest.raises(InputError) as refused:
        Hazard.of(HAZARD, Path("h.toml")).question(space, {})
    assert str(refused.value) == rule


def test_moves_under_a_hazard_hold_the_most_probable_choice() -> None:
    space = "[space]\nT_p = { low = 1, high = 6 }\nA_p = { low = 0.1, high = 1 }\nx = { low = 0, high = 1 }\n"
    soil = 'soil = { choices = ["B", "A", "C"], probabilities = [0.4, 0.3, 0.3] }'
    campaign = Campaign.of(parse_settings(f"simulator = {{ elsewhere = true }}\n{space}{soil}", "f"))
    hazard = Hazard.of({key: HAZARD[key] for key in ("pulse_period", "pgv")}, Path("h.toml"))

    def on_soil(X: np.ndarray) -> np.ndarray:
        return norm.ppf(np.array([0.4, 0.1, 0.2])[X[:, 3].astype(int)] + 0.1 * X[:, 2])[:, None]

    found = sensitivity(Inquiry.of_hazard(campaign, hazard, {}), on_soil, "failure", 16)
    assert found.probability == pytest.approx(0.45)
    assert any("their medians or most probable choices (soil = B)" in note for note in found.notes)
