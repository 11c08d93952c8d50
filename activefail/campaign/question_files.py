"""Reads the question that a question file or a hazard file asks of a campaign."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from activefail.acquisition.population import integration_points
from activefail.campaign.hazard import hazard_of, hazard_question, is_of_hazard
from activefail.campaign.question import AMPLITUDE, PERIOD, Question, question_with
from activefail.campaign.settings import CampaignSettings, parse_toml, read_text
from activefail.errors import InputError
from activefail.simulators.interface import Simulator
from activefail.space import DesignSpace

_CHECKED = 256
"""Designs of a question on which its values are checked."""


def read_question(path: Path, settings: CampaignSettings, space: DesignSpace, fixed: Mapping[str, float]) -> Question:
    """Read the question of a question file or a hazard file.

    Args:
        path: the file.
        settings, space: of the campaign.
        fixed: further values of variables (see `question.read_fixed`).

    Raises:
        InputError: naming the file, the key, the rule and the value.
    """
    values = parse_toml(read_text(path), str(path))
    if not is_of_hazard(values):
        return question_with(values, path, settings, space, fixed)
    hazard = hazard_of(values, path)
    try:
        return hazard_question(hazard, settings, space, fixed)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def middles(space: DesignSpace, names: Collection[str]) -> dict[str, float]:
    """The middles of the ranges of variables, without those of a pulse and without names that are unknown."""
    return {
        one.name: 0.5 * (one.low + one.high)
        for one in space.parameters
        if one.name in names and one.name not in (PERIOD, AMPLITUDE)
    }


def check_designs_of(question: Question, simulator: Simulator, source: str) -> None:
    """Check that a simulator can take the designs of a question, which may lie outside the campaign's design space.

    Args:
        question: the question.
        simulator: the campaign's; only one with a `check` is asked (see `simulators.interface.Simulator`).
        source: the file that gave the values, for the message; empty if none did.

    Raises:
        InputError: naming the source, the rule and the value.
    """
    check = getattr(simulator, "check", None)
    if check is None or question.is_own:
        return
    X, _ = integration_points(question.space, _CHECKED)
    try:
        # Without the factors of property bounds: the message then has the user's values.
        check(replace(question, factors={}).designs(X))
    except InputError as error:
        raise InputError(f"{source or question.title}: the simulator cannot take these values: {error}") from None
