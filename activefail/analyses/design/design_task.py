"""What a design must meet: targets, free variables, a cost; and the looks of its verification, with their simulations
and shares of the probability of a false result."""

import itertools
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from activefail.analyses.classifier_probability import POINTS
from activefail.analyses.fragility.curve import Rate
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.plugins import brought
from activefail.simulators.interface import noun_of
from activefail.space.expressions import check_no_texts, parse_expression
from activefail.space.parameter import Parameter
from activefail.space.space import Array, Constraint, DesignSpace
from activefail.visible import visible

RISK_CATEGORIES = {"II": 0.10, "III": 0.05, "IV": 0.025}
"""Largest probabilities of collapse given MCE_R, by risk category [ASCE2017, table 1.3-2]."""

MOST_COMBINATIONS, MOST_SEARCHED = 5000, 100
"""Most combinations of the values of free variables that are compared, and of choices beside a continuous variable,
each of which is a search."""

SIMULATIONS, LEAST_SIMULATIONS = 1000, 10
"""Maximum number of fresh simulations for each target, by default, and least number of a look."""


LOOKS = 5
"""Most looks of the verification."""

SIZES = (100, 200, 400, 1000)
"""Fresh simulations of a look, for each target. Fewer seldom meet a failure that is hidden from the classifier
(docs/decisions/0019)."""

_SPENT = 0.8
"""Share of what is left of the probability of a false result that each look spends (docs/decisions/0019)."""

_UNGUIDED, _AFFORDED = 70, 0.1
"""Simulations of a look that are drawn without regard to the classifier, and the target from which on. Of a third of
this target that is hidden, 70 miss all in one look of ten. A rarer target takes fewer in proportion: as many would cost
the look its accuracy and still find little (docs/decisions/0019)."""

_POINTS_BEYOND = 25
"""Points of an integral that a probability at its target puts beyond the boundary."""

LEAST_TARGET = 1e-3
"""Least target: a smaller probability takes other points than those of a distribution's bulk."""


_YEARS = re.compile(r"([0-9.eE+-]+ ?%?) in ([0-9.eE+-]+) years?")
"""A risk in a number of years."""

_MOST_YEARS = 1e4
"""Most years of a target."""


class Requirement(NamedTuple):
    """The probability that an outcome, or a more severe one, may have at most."""

    outcome: str
    target: float  # given one draw of the question, or in a number of years
    years: float | None = None


@dataclass(frozen=True, eq=False)
class DesignTask:
    """What a design must meet, and what may change.

    Attributes:
        asked: what is asked; free variables get a value.
        low, high: range of each free variable. The first is made as small as the requirements allow; the others are
            searched.
        cost: of the values of the free variables; smaller is better.
        cost_text: the cost in words.
        requirements: one for each outcome that has a target.
        confidence: one-sided, that the probabilities meet their targets.
        simulations: most fresh simulations for each requirement.
        rate: how often the question's pulses occur, if the targets were risks in a number of years.
        stepped: by name, the free variables with steps or choices.
        constraints: of the campaign.
    """

    asked: Inquiry
    low: Mapping[str, float]
    high: Mapping[str, float]
    cost: Callable[[Mapping[str, float]], float]
    cost_text: str
    requirements: tuple[Requirement, ...]
    confidence: float
    simulations: int
    rate: Rate | None = None
    stepped: Mapping[str, Parameter] = field(default_factory=dict)
    constraints: tuple[Constraint, ...] = ()

    def allows(self, values: Mapping[str, float]) -> bool:
        """Whether values of the free variables meet the constraints that involve nothing uncertain."""
        if not self.constraints:
            return True
        known = self.asked.campaign.space.quantities({**self.question.fixed, **values})
        return all(bool(one.holds(known)) for one in self.constraints if one.names <= known.keys())

    @property
    def is_line(self) -> bool:
        """Whether a single variable with an order is to be small."""
        return len(self.free) == 1 and not self.choices and self.cost_text == self.free[0]

    @property
    def smaller(self) -> str:
        """What a better design is, in one word."""
        return "smaller" if self.cost_text == self.free[0] else "cheaper"

    @property
    def is_finite(self) -> bool:
        """Whether the free variables have finitely many values."""
        return len(self.stepped) == len(self.low)

    @property
    def ranges(self) -> dict[str, list[Any]]:
        """Both ends of each free variable's range, or its choices."""
        low, high = (self.asked.campaign.space.written(ends) for ends in (self.low, self.high))
        choices = {name: list(self.stepped[name].choices) for name in self.choices}
        return {name: choices.get(name, [low[name], high[name]]) for name in self.free}

    @property
    def choices(self) -> list[str]:
        """Names of the free variables without order."""
        return [name for name, one in self.stepped.items() if one.choices]

    def combinations(self, names: Collection[str]) -> list[dict[str, float]]:
        """All combinations of the values of free variables with steps or choices."""
        values = [self.stepped[name].values.tolist() for name in names]
        return [dict(zip(names, row, strict=True)) for row in itertools.product(*values)]

    def candidates(self, held: Mapping[str, float]) -> list[dict[str, float]]:
        """All values of finitely many that constraints allow, some held; the cheapest first.

        Raises:
            InputError: if there is none.
        """
        names = [name for name in self.free if name not in held]
        allowed = [{**one, **held} for one in self.combinations(names) if self.allows({**one, **held})]
        if not allowed:
            raise InputError(f"constraints: no value of {', '.join(names)} meets them.")
        return sorted(allowed, key=self.rank)

    def rank(self, values: Mapping[str, float]) -> float:
        """The cost without the rounding of its last digits, in which equal costs may differ."""
        return float(f"{self.cost(values):.9g}")

    @property
    def question(self) -> Question:
        """The distribution of the variables."""
        return self.asked.question

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free variables."""
        return tuple(self.low)

    @property
    def targets(self) -> Array:
        """The largest acceptable probabilities, (r,)."""
        return np.array([requirement.target for requirement in self.requirements])

    @property
    def unguided(self) -> int:
        """Simulations of a look that are drawn without regard to the classifier."""
        return round(_UNGUIDED * min(1.0, float(self.targets.max()) / _AFFORDED))

    @property
    def points(self) -> int:
        """Points that integrate a probability: enough for the smallest target, a power of two."""
        least = min(requirement.target for requirement in self.requirements)
        return max(POINTS, 1 << math.ceil(math.log2(_POINTS_BEYOND / least)))

    def sizes(self, made: int, last: int = 0) -> list[int]:
        """What a look may ask for, in fresh simulations of each requirement.

        More than the last one, and at most half the rest; or else all the rest; nothing if that is too small.

        Args:
            made: by all former looks.
            last: by the last one.
        """
        left = self.simulations - made
        sizes = [size for size in SIZES if last < size <= left / 2]
        return sizes or ([left] if left >= LEAST_SIMULATIONS else [])


def confidence_of_bound(confidence: float, look: int) -> float:
    """Confidence of each bound of a look, from 0 on, for a result of this confidence.

    A look spends 0.8 of the error α that the former ones left, 0.8 · 0.2ᵏ α. The sum over any number of looks is below
    α, and so is the probability that any of their bounds fails (Bonferroni), whatever made the search look again.
    """
    return 1.0 - (1.0 - confidence) * _SPENT * (1.0 - _SPENT) ** look


def read_targets(text: str, outcomes: Sequence[str], main: str) -> tuple[Requirement, ...]:
    """The targets of a text: a probability, a risk category, a risk such as `1% in 50 years`, or several by outcomes.

    Several targets are written `failure=0.1,impact=0.3`.

    Args:
        text: the targets.
        outcomes: of the campaign, from least to most severe.
        main: outcome of a target without a name.
    """
    requirements: list[Requirement] = []
    for part in text.split(","):
        name, equals, number = part.rpartition("=")
        outcome = name.strip() if equals else main
        if outcome not in outcomes[1:]:
            raise InputError(f"target: the outcome must be one of {', '.join(outcomes[1:])}, got {outcome!r}.")
        if outcome in {requirement.outcome for requirement in requirements}:
            raise InputError(f"target: {outcome} must have one target, got {text!r}.")
        requirements.append(_requirement(outcome, number.strip()))
    return tuple(requirements)


def _requirement(outcome: str, text: str) -> Requirement:
    """The target of an outcome."""
    share, years = text, None
    if (risk := _YEARS.fullmatch(text)) is not None:
        share, years = risk[1].replace(" ", ""), _number(risk[2])
    target = RISK_CATEGORIES.get(text) or _number(share)
    if years is not None:
        if not (0.0 < target <= 0.9 and 0.0 < years <= _MOST_YEARS):
            raise InputError(
                f"target: a risk must be above 0 and at most 90 %, in at most {_MOST_YEARS:g} years, got {text!r}."
            )
    elif not LEAST_TARGET <= target <= 0.9:
        names = ", ".join(RISK_CATEGORIES)
        raise InputError(
            f"target: must be a probability between {LEAST_TARGET:g} and 0.9, a risk category ({names}) or a risk such "
            f"as '1% in 50 years', got {text}."
        )
    return Requirement(outcome, target, years)


def _number(text: str) -> float:
    """A number or a percentage; NaN if it is neither."""
    try:
        return float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
    except ValueError:
        return math.nan


def default_free(space: DesignSpace) -> tuple[str, ...]:
    """The variable that is made as small as possible if none is named; none if the campaign lacks it."""
    return tuple(name for name in brought("free") if name in space.names)[:1]


def design_task(
    asked: Inquiry,
    requirements: tuple[Requirement, ...],
    free: Sequence[str] = (),
    cost: str = "",
    confidence: float = 0.95,
    simulations: int = SIMULATIONS,
    rate: Rate | None = None,
) -> DesignTask:
    """The task of a campaign, which gives the free variables their ranges.

    Args:
        asked: what is asked of the campaign.
        requirements: the targets.
        free: names of the variables that may change; that of the plug-ins (`default_free`) if there are none.
        cost: expression of the campaign's variables that is made small; the first free variable if empty.
        confidence: that the targets are met.
        simulations: most for each target.
        rate: how often the question's pulses occur, if the targets were risks.
    """
    space, question = asked.campaign.space, asked.question
    names = tuple(free) or default_free(space)
    if not names:
        raise InputError(f"free: name the variables that may change; the campaign has {', '.join(space.names)}.")
    ranges = {one.name: one for one in space.parameters}
    for name in names:
        if name not in space.names:
            raise InputError(f"free: {visible(name)!r} is not a variable; the variables are {', '.join(space.names)}.")
        if names.count(name) > 1:
            raise InputError(f"free: names {name!r} twice.")
        if ranges[name].groups is not None:
            raise InputError(f"free: {name} has the records of a set, which the designer cannot choose.")
        if (derived := question.derived) is not None and name in derived.units:
            raise InputError(
                f"free: {name} belongs to the {derived.of}, which the designer cannot choose. Name variables of the "
                f"{noun_of(asked.campaign.simulator)}."
            )
    if set(question.space.names) <= set(names):
        why = "so nothing is uncertain and no outcome has a probability"
        if not asked.campaign.settings.is_repeatable:
            why = "so only the noise is uncertain; `activefail predict` gives the probability at each design of a table"
        raise InputError(f"question: fixes every variable, {why}.")
    low, high = {name: ranges[name].low for name in names}, {name: ranges[name].high for name in names}
    price, text = _cost(cost, names, question.fixed, space)
    for side in (low, high):
        price(side)
    stepped = {name: ranges[name] for name in names if ranges[name].step is not None}
    limits = stepped, space.constraints
    task = DesignTask(asked, low, high, price, text, requirements, confidence, simulations, rate, *limits)
    several, most = (names, MOST_COMBINATIONS) if task.is_finite else (task.choices, MOST_SEARCHED)
    compared = math.prod(len(stepped[name].values) for name in several)
    if len(names) > 1 and compared > most:
        raise InputError(
            f"free: the values of {', '.join(several)} must make at most {most} combinations, got {compared}. Fix some "
            "variables."
        )
    return task


def _cost(
    text: str, free: Sequence[str], fixed: Mapping[str, float], space: DesignSpace
) -> tuple[Callable[[Mapping[str, float]], float], str]:
    """The cost as a function of the free variables' values, and in words.

    Without an expression it is the first variable, or the place of its choice where these are texts.
    """
    if not text:
        first = free[0]
        place = f"the place of {first} among {', '.join(map(str, space.parameters[space.names.index(first)].choices))}"
        return (lambda values: float(space.quantities(values)[first])), place if first in space.texts else first
    known = {name: value for name, value in fixed.items() if name not in free}
    try:
        expression = parse_expression(text, space.quantities({**known, **dict.fromkeys(free, 0.0)}).keys())
        check_no_texts(expression, space.texts)
    except ValueError as error:
        raise InputError(visible(f"cost: {error}.")) from None

    def cost(values: Mapping[str, float]) -> float:
        quantities: dict[str, Any] = space.quantities({**known, **values})
        with np.errstate(all="ignore"):  # reported below
            value = float(expression(quantities))
        if not math.isfinite(value):
            at = ", ".join(f"{name} = {one}" for name, one in space.written(values).items())
            raise InputError(f"cost: must be finite, got {value} at {at}.")
        return value

    return cost, text
