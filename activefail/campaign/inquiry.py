"""What is asked of a campaign: a question, or the hazard of a site, which asks one."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import cast

from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import Hazard, hazard_in, is_hazard, read_hazard
from activefail.campaign.question import Question, check_constraints, question_in, question_of, values_of
from activefail.campaign.sections import QuestionSettings
from activefail.campaign.settings import checked
from activefail.errors import InputError, naming
from activefail.learning.criteria.population import integration_points
from activefail.simulators.interface import Simulator
from activefail.space.space import DesignSpace
from activefail.space.weighted import WeightedRows
from activefail.text.files import path_of
from activefail.text.toml import read_toml

_CHECKED = 256
"""Designs of a question on which its values are checked."""


@dataclass(frozen=True, eq=False)
class Inquiry:
    """What is asked of a campaign.

    Attributes:
        campaign: the campaign.
        question: the distribution of its variables.
        hazard: whose question it is, at one of its property bounds; None for another question.
    """

    campaign: Campaign
    question: Question
    hazard: Hazard | None = None

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        hazard: Hazard | Path | str | None = None,
        question: Question | Path | str | None = None,
        fixed: Mapping[str, float] | Path | str | None = None,
        free: Collection[str] = (),
    ) -> "Inquiry":
        """The inquiry of a hazard, of a question, or of the campaign's own question.

        Args:
            campaign: the campaign.
            hazard, question: either, or its file; a question file may be a hazard file.
            fixed: values of variables, by name or in a TOML file.
            free: variables that get their values later.
        """
        if hazard is not None and question is not None:
            raise InputError("question: cannot be combined with hazard.")
        space, given = campaign.space, question if hazard is None else hazard
        values = values_of(fixed, space)
        file = str(given) if isinstance(given, str | PathLike) else ""
        asking: Question | Hazard
        if is_hazard(given):
            asking = cast(Hazard, given)
        elif hazard is not None:
            asking = read_hazard(path_of("hazard", hazard))
        elif question is None:
            # Without values a campaign's own design measure stays what it is, with its stored simulations.
            asking = question_of(campaign.settings.question, space, values) if values else campaign.question
        elif isinstance(question, Question):
            asking = question.at(values) if values else question
        else:
            asking = read_question(path_of("question", question), space, values)
        if isinstance(asking, Question):
            asked = cls(campaign, asking)
        else:
            with naming(f"{file}: " if file else ""):
                asked = cls.of_hazard(campaign, asking, values, free)
        # Variables that get their values later have some meanwhile.
        known, derived = {*asked.question.space.names, *asked.question.fixed}, asked.question.derived
        known |= set() if derived is None else {derived.replaces}
        waiting = _middles(space, [name for name in free if name not in known])
        checked = asked.question.at(waiting) if waiting else asked.question
        check_designs_of(
            checked, campaign.simulator, str(fixed) if isinstance(fixed, Path | str) else "fixed" if fixed else file
        )
        return asked

    @classmethod
    def of_hazard(
        cls, campaign: Campaign, hazard: Hazard, fixed: Mapping[str, float], free: Collection[str] = ()
    ) -> "Inquiry":
        """The inquiry of a hazard.

        Args:
            campaign: the campaign.
            hazard: the hazard.
            fixed: values of variables.
            free: variables that get their values later. Under a table of loads they have none in the question.
        """
        # The loads of a table have no distribution of other variables beside them.
        waiting = [name for name in free if name not in {*fixed, *hazard.variables}] if hazard.is_table else []
        meanwhile = _middles(campaign.space, waiting)
        question = hazard.question(campaign.space, {**meanwhile, **fixed})
        known = {name: value for name, value in question.fixed.items() if name not in meanwhile}
        check_constraints(campaign.space, known, question.space.names, isinstance(question.space, WeightedRows))
        return cls(campaign, replace(question, fixed=known), hazard)

    @property
    def fixed(self) -> dict[str, float]:
        """The values of the campaign's variables that are certain, by name."""
        return {name: value for name, value in self.question.fixed.items() if name in self.campaign.space.names}

    def at(self, values: Mapping[str, float]) -> "Inquiry":
        """The inquiry with these values of variables."""
        return replace(self, question=self.question.at(values))

    def under(self, hazard: Hazard, at: float | None = None) -> Question:
        """The question of a variant of the hazard, with the same values (see `Hazard.question`)."""
        return hazard.question(self.campaign.space, self.fixed, at)


def _middles(space: DesignSpace, names: Collection[str]) -> dict[str, float]:
    """The middles of the ranges of variables, without names that are unknown."""
    return {one.name: float(one.rounded(0.5 * (one.low + one.high))) for one in space.parameters if one.name in names}


def read_question(path: Path, space: DesignSpace, fixed: Mapping[str, float]) -> Question | Hazard:
    """The question of a question file, with values of variables; or the hazard of a hazard file."""
    values = read_toml(path)
    if (hazard := hazard_in(values, path)) is not None:
        return hazard
    section = checked(QuestionSettings, values, str(path))
    with naming(f"{path}: "):
        return question_in(section, path.stem, space, fixed)


def check_designs_of(question: Question, simulator: Simulator, source: str) -> None:
    """Check that a simulator can take the designs of a question, which may lie outside the campaign's design space.

    Args:
        question: the question.
        simulator: the campaign's; only one with a `check` is asked (see `simulators.interface.Simulator`).
        source: the file that gave the values, for the message; empty if none did.
    """
    check = getattr(simulator, "check", None)
    if check is None or question.is_own:
        return
    X, _ = integration_points(question.space, _CHECKED)
    with naming(f"{source or question.title}: the simulator cannot take these values: "):
        # Without the factors of property bounds: the message then has the user's values.
        check(replace(question, factors={}).designs(X))
