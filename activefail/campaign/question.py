"""A question: another distribution of a campaign's variables, under which a probability is asked for."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.campaign.sections import FixedVariable, QuestionSettings, Variable
from activefail.campaign.settings import CampaignSettings, checked, parse_toml, read_text
from activefail.errors import InputError
from activefail.space import Array, DesignSpace, radius
from activefail.visible import visible

_SHARE = 2**14
"""Designs that estimate which share of a question lies outside the design space."""


@dataclass(frozen=True, eq=False)
class Question:
    """A distribution of a campaign's variables.

    Attributes:
        title: in words.
        space: of the k uncertain variables.
        columns: (k,) their columns among the campaign's variables.
        values: (d,) values of the campaign's variables; those of uncertain ones mean nothing.
        digest: SHA-256 of what the question defines; empty for the campaign's own design measure.
    """

    title: str
    space: DesignSpace
    columns: tuple[int, ...]
    values: Array
    digest: str = ""

    @classmethod
    def of_space(cls, space: DesignSpace) -> "Question":
        """The campaign's own design measure."""
        return cls("the design measure", space, tuple(range(space.dimension)), np.zeros(space.dimension))

    def designs(self, X: Array) -> Array:
        """Designs of the campaign, (n, d), from values of the uncertain variables, (n, k)."""
        if len(self.columns) == len(self.values):
            return X
        designs = np.tile(self.values, (len(X), 1))
        designs[:, list(self.columns)] = X
        return designs

    def share_outside(self, space: DesignSpace) -> float:
        """The share of the question outside a campaign's design space, where its classifier extrapolates.

        Estimated by 16,384 designs of a scrambled Sobol' sequence.
        """
        X = self.space.sobol(_SHARE, np.random.default_rng(0))
        return float(1.0 - space.contains(self.designs(X)).mean())


def read_question(path: Path, settings: CampaignSettings, space: DesignSpace) -> Question:
    """Read the question of a file.

    Args:
        path: the file.
        settings, space: of the campaign.

    Raises:
        InputError: naming the file, the key, the rule and the value.
    """
    asked = checked(QuestionSettings, parse_toml(read_text(path), str(path)), str(path))
    try:
        return _question(asked, path.stem, settings, space)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def question_of(settings: CampaignSettings, space: DesignSpace) -> Question:
    """The question of a campaign file; its design measure if it asks none.

    Raises:
        InputError: naming the key, the rule and the value.
    """
    if settings.question is None:
        return Question.of_space(space)
    try:
        return _question(settings.question, "the campaign's question", settings, space)
    except InputError as error:
        raise InputError(f"question.{error}") from None


def _question(asked: QuestionSettings, title: str, settings: CampaignSettings, space: DesignSpace) -> Question:
    for name, entry in asked.space.items():
        _check_variable(name, entry, settings, space)
    fixed = {name: entry.value for name, entry in asked.space.items() if isinstance(entry, FixedVariable)}
    changed = {name: entry for name, entry in asked.space.items() if isinstance(entry, Variable)}
    uncertain = [name for name in space.names if name not in fixed]
    if not uncertain:
        raise InputError("space: fixes every variable; for a single design use `activefail predict` or `simulate`.")
    unbounded = sum(not variable.is_bounded for variable in changed.values())
    distance = radius(asked.reach, unbounded) if unbounded else np.inf
    own = dict(zip(space.names, space.parameters, strict=True))
    parameters = tuple(changed[name].parameter(name, distance) if name in changed else own[name] for name in uncertain)
    correlation = asked.correlation
    if correlation is None:
        correlation = [pair for pair in settings.correlation if pair[0] in uncertain and pair[1] in uncertain]
    values = np.array([fixed.get(name, 0.0) for name in space.names])
    digest = hashlib.sha256(repr((parameters, sorted(correlation), values.tolist())).encode()).hexdigest()
    return Question(
        asked.description or title,
        DesignSpace(parameters, correlation=tuple(correlation)),
        tuple(space.names.index(name) for name in uncertain),
        values,
        digest,
    )


def _check_variable(name: str, entry: Variable | FixedVariable, settings: CampaignSettings, space: DesignSpace) -> None:
    """Check one variable of a question.

    Raises:
        InputError: naming the key, the rule and the value.
    """
    if name in space.fixed:
        raise InputError(f"space.{name}: has the fixed value {space.fixed[name]:g} in the campaign; leave it out.")
    if name not in space.names:
        raise InputError(
            f"space.{name}: is not a variable of the campaign; its variables are {', '.join(space.names)}."
        )
    unit = settings.space[name].unit
    if entry.unit and entry.unit != unit:
        stated = visible(unit) or "left out"
        raise InputError(f"space.{name}.unit: must be {stated}, as in the campaign, got {entry.unit!r}.")
