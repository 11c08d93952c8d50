"""A question: another distribution of a campaign's variables, and its share outside the design space."""

import hashlib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from activefail.campaign.derived import Derived, derived_in
from activefail.campaign.section import shown
from activefail.campaign.sections import QuestionSettings
from activefail.campaign.variables import Choices, FixedVariable, SetVariable, Variable
from activefail.errors import InputError, naming
from activefail.plugins import brought
from activefail.space.parameter import Parameter
from activefail.space.shares import feasible_share, percent, records_in_words
from activefail.space.space import LEAST_FEASIBLE, Array, DesignSpace, radius
from activefail.space.weighted import WeightedRows, weighted_quantiles
from activefail.text.numerals import number_in
from activefail.text.toml import read_toml
from activefail.visible import visible

_SHARE = 2**14
"""Points that estimate which share of a question lies outside the design space."""

_WIDEN_ABOVE, _HELD = 0.1, 0.99
"""Share outside above which a campaign should be widened, and the share that the ranges named then hold."""

_OF_CAMPAIGN = "the campaign's distributions"


@dataclass(frozen=True, eq=False)
class Question:
    """A distribution of a campaign's variables: some are uncertain, the others have values.

    Attributes:
        title: in words.
        variables: names of the campaign's variables.
        space: the uncertain variables: the campaign's own, or a quantity in place of one (see `derived`).
        fixed: values of all other variables.
        factors: factors on variables, applied last, such as a bound on friction.
        draw: number of an independent sample of fresh simulations.
        unguided: how many of them are drawn without regard to the classifier, if it can be; otherwise a share.
        is_own: whether this is the campaign's own design measure.
        stated: what the distribution assumes or leaves out besides constraints, as sentences.
    """

    title: str
    variables: tuple[str, ...]
    space: DesignSpace | WeightedRows
    fixed: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    draw: int = 0
    unguided: int = 0
    is_own: bool = False
    stated: tuple[str, ...] = ()

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the distribution assumes or leaves out, as sentences."""
        return self.stated_of()

    def stated_of(self, of_values: bool = False) -> tuple[str, ...]:
        """The same; `of_values`: for an answer that has an interval of other records, too."""
        notes = [
            f"{one.name}: the probability and its interval are those of these {records_in_words(one)}, not of other "
            "earthquakes."
            for one in self.space.parameters
            if one.groups is not None and not of_values
        ]
        if isinstance(self.space, DesignSpace) and self.space.constraints and self.space.feasible_share < 1.0:
            share = feasible_share(self.space)
            notes.append(f"Only designs that meet the constraints count, {share} of the variables' distribution.")
        return (*self.stated, *notes)

    @property
    def derived(self) -> Derived | None:
        """The quantity that takes the place of a variable; None if there is none."""
        return derived_in((*self.space.names, *self.fixed), self.variables)

    @property
    def is_of_campaign(self) -> bool:
        """Whether the uncertain variables have the campaign's own distributions."""
        return self.is_own or self.title == _OF_CAMPAIGN

    @classmethod
    def of_space(cls, space: DesignSpace) -> "Question":
        """The campaign's own design measure."""
        return cls("the design measure", space.names, space, is_own=True)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the distribution and of how it is drawn from; empty for the campaign's own design measure."""
        if self.is_own:
            return ""
        if isinstance(self.space, WeightedRows):
            rows = hashlib.sha256(np.column_stack([self.space.X, self.space.weight]).tobytes()).hexdigest()
            defined: tuple[object, ...] = (self.space.names, rows)
        else:
            defined = (self.space.parameters, sorted(self.space.correlation))
        values = [float(self.fixed.get(name, 0.0)) for name in self.variables]
        quantities = brought("derived") if self.fixed else {}
        further_parts = [part for name in quantities if name in self.fixed for part in (name, self.fixed[name])]
        # Parts that older questions did not have are left out where they say nothing, so that digests stay.
        further_parts += [sorted(self.factors.items())] if self.factors else []
        further_parts += [self.draw] if self.draw else []
        further_parts += [("unguided", self.unguided)] if self.unguided else []
        further_parts += [one.probabilities for one in self.space.parameters if one.choices]
        return hashlib.sha256(repr((*defined, values, *further_parts)).encode()).hexdigest()

    def designs(self, X: Array) -> Array:
        """Designs of the campaign, (n, d), from values of the uncertain variables, (n, k)."""
        if self.is_own:
            return X
        columns = {name: np.full(len(X), value) for name, value in self.fixed.items()}
        columns |= dict(zip(self.space.names, X.T, strict=True))
        if (derived := self.derived) is not None:
            columns[derived.replaces] = derived.value(columns)
        return np.column_stack([columns[name] * self.factors.get(name, 1.0) for name in self.variables])

    def at(self, values: Mapping[str, float]) -> "Question":
        """The question with these values of variables, which are no longer uncertain.

        Raises:
            InputError: if a value is that of a variable that follows from a quantity.
        """
        if (derived := self.derived) is not None and derived.replaces in values:
            name = derived.replaces
            raise InputError(f"{name}: cannot have a value, because it follows from {derived.quantity.name}.")
        fixed = {name: value for name, value in self.fixed.items() if name not in values} | dict(values)
        space = self.space
        notes = _left_out(space.correlation, values)
        for name, value in values.items():
            if name in space.names:
                space = space.holding(name, value)
        return replace(self, space=space, fixed=fixed, is_own=False, stated=(*self.stated, *notes))

    @property
    def has_designs(self) -> bool:
        """Whether enough designs of the uncertain variables meet the constraints."""
        return self.space.feasible_share >= LEAST_FEASIBLE

    def drawn(self, draw: int, unguided: int = 0) -> "Question":
        """The same question with another independent sample of fresh simulations."""
        return replace(self, draw=draw, unguided=unguided)

    def share_outside(self, space: DesignSpace) -> float:
        """The share of the question outside a campaign's design space (see `outside`)."""
        return self.outside(space).share

    def outside(self, space: DesignSpace) -> "Outside":
        """What of the question lies outside a campaign's design space, where its classifier extrapolates.

        Estimated by 16,384 points of a scrambled Sobol' sequence.
        """
        from activefail.learning.criteria.population import integration_points

        U, weight = integration_points(self.space, _SHARE)
        return Outside(self.designs(U), weight, space)


class Beyond(NamedTuple):
    """The share of a question beyond one bound of a design space, below or above it."""

    name: str
    unit: str
    side: str
    bound: float
    share: float


@dataclass(frozen=True, eq=False)
class Outside:
    """What of a question lies outside a campaign's design space.

    Attributes:
        X, weight: (n, d) designs of the question, and their weights, (n,).
        space: the design space.
    """

    X: Array
    weight: Array
    space: DesignSpace

    @cached_property
    def share(self) -> float:
        """Of the question, in any variable."""
        return float(1.0 - (self.weight * self.space.spans(self.X)).mean())

    @cached_property
    def parts(self) -> tuple[Beyond, ...]:
        """By variable and side, where there is a share."""
        parts = []
        for one, x in zip(self.space.parameters, self.X.T, strict=True):
            for side, bound, beyond in (("below", one.low, x < one.low), ("above", one.high, x > one.high)):
                if share := float((self.weight * beyond).mean()):
                    parts.append(Beyond(one.name, one.unit, side, bound, share))
        return tuple(parts)

    @cached_property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges of the variables that leave the space, by name: the space's, widened to hold 99 % of the question."""
        ranges = {}
        for one, x in zip(self.space.parameters, self.X.T, strict=True):
            low, high = weighted_quantiles(x, self.weight, (0.5 - 0.5 * _HELD, 0.5 + 0.5 * _HELD)).tolist()
            if low < one.low or high > one.high:
                ranges[one.name] = min(one.low, _outwards(low, -1.0)), max(one.high, _outwards(high, 1.0))
        return ranges

    @property
    def advice(self) -> str:
        """By which variables the campaign should be widened, in one sentence; empty if at most a tenth lies outside."""
        if self.share <= _WIDEN_ABOVE:
            return ""
        parts = []
        for parameter in self.space.parameters:
            low, high = self.ranges.get(parameter.name, (parameter.low, parameter.high))
            unit = f" {parameter.unit}" if parameter.unit else ""
            if low < parameter.low and high > parameter.high:
                parts.append(f"{parameter.name} from {low:g} to {high:g}{unit}")
            elif low < parameter.low:
                parts.append(f"{parameter.name} down to {low:g}{unit}")
            elif high > parameter.high:
                parts.append(f"{parameter.name} up to {high:g}{unit}")
        text = (
            f"{percent(self.share)} of the question's distribution lies outside the campaign's design space, where the "
            "classifier extrapolates"
        )
        if not parts:
            return f"{text}. Widen it by a little of many variables."
        ranges = f"{' and '.join(parts)} would hold {100.0 * _HELD:g} %"
        return visible(f"{text}. Widen it: {ranges}" + (" each." if len(parts) > 1 else " of it."))


def _outwards(value: float, side: float) -> float:
    """A value with two digits, rounded up (`side` 1) or down (−1)."""
    if value == 0.0:
        return value
    digit = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return float(f"{side * math.ceil(side * value / digit) * digit:.6g}")


def question_of(
    section: QuestionSettings | None, space: DesignSpace, fixed: Mapping[str, float] | None = None
) -> Question:
    """The question of a campaign file; its design measure if it asks none."""
    if section is None:
        return asked_of(_OF_CAMPAIGN, space, {}, fixed) if fixed else Question.of_space(space)
    with naming("question."):
        return question_in(section, "the campaign's question", space, fixed or {})


def values_of(given: Any, space: DesignSpace, argument: str = "fixed") -> dict[str, float]:
    """Values of variables: by name, as text such as "load=4,depth=0.3", in a TOML file with such lines, or None.

    Raises:
        InputError: naming the file; if a name is not a variable of the campaign, or a value is not a number.
    """
    if isinstance(given, str | Path) and "=" in str(given) and not Path(given).exists():
        return values_of(_written(str(given), space), space, argument)
    if isinstance(given, str | Path):
        values = read_toml(Path(given))
        with naming(f"{given}: "):
            return values_of(values, space)
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise InputError(f"{argument}: must be values by name, or a path, got {type(given).__name__}.")
    check_names(given, space)
    return {name: _number_in(value, space.by_name[name], name) for name, value in given.items()}


def _written(text: str, space: DesignSpace) -> dict[str, Any]:
    """Values by name in a text such as "load=4.0,soil=A"; those of variables without choices are numbers.

    What follows a choice and is no value belongs to it: "soil=dense, dry".
    """
    values: dict[str, Any] = {}
    with_choices, name = {one.name for one in space.parameters if one.choices}, ""
    for part in text.split(","):
        if "=" not in part and name in with_choices:
            values[name] += f",{part.rstrip()}"
            continue
        name, _, word = (piece.strip() for piece in part.partition("="))
        if name in values:
            raise InputError(f"fixed: {name} has two values.")
        try:
            values[name] = word if name in with_choices else number_in(word)
        except ValueError:
            raise InputError(f"fixed: must be a file, or values such as load=4,depth=0.3, got {shown(part)}.") from None
    return values


def _number_in(value: Any, of: Parameter, key: str) -> float:
    """The number of a variable's value in a file or argument.

    Raises:
        InputError: if the variable cannot have it, naming the key.
    """
    try:
        return of.number_of(value)
    except ValueError as rule:
        raise InputError(f"{key}: {rule}, got {shown(value)}.") from None


def check_names(names: Iterable[str], space: DesignSpace) -> None:
    """Check that names are those of variables of the campaign."""
    for name in names:
        if name in space.fixed:
            raise InputError(f"{name}: has the fixed value {space.fixed[name]:g} in the campaign; leave it out.")
        if name not in space.names:
            raise InputError(f"{name}: is not a variable of the campaign; its variables are {', '.join(space.names)}.")


def asked_of(
    title: str,
    space: DesignSpace,
    changed: Mapping[str, Parameter],
    fixed: Mapping[str, float],
    correlation: Iterable[tuple[str, str, float]] | None = None,
) -> Question:
    """The question with other distributions of variables.

    Args:
        title: in words.
        space: of the campaign.
        changed: distributions by name; a variable that is left out keeps the campaign's.
        fixed: values of certain variables.
        correlation: of the variables; the campaign's if None. Pairs with a certain variable are left out, which is
            among the question's assumptions.

    Raises:
        InputError: if no variable is uncertain.
    """
    names = list(space.names)
    if (derived := derived_in((*changed, *fixed), names)) is not None and derived.replaces in names:
        names = [*(name for name in names if name != derived.replaces), derived.quantity.name]
    uncertain = [name for name in names if name not in fixed]
    if not uncertain:
        raise InputError("space: fixes every variable; for a single design use `activefail predict` or `simulate`.")
    if correlation is None:
        correlation = [pair for pair in space.correlation if {*pair[:2]} <= {*uncertain, *fixed}]
    kept = tuple(pair for pair in correlation if fixed.keys().isdisjoint(pair[:2]))
    parameters = tuple(changed.get(name) or space.by_name[name] for name in uncertain)
    notes = _left_out(correlation, fixed)
    check_constraints(space, fixed, uncertain)
    open_ones = tuple(one for one in space.constraints if not one.names.isdisjoint(uncertain))
    distribution = DesignSpace(parameters, space.quantities(fixed), kept, open_ones)
    return Question(title, space.names, distribution, dict(fixed), stated=notes)


def check_constraints(
    space: DesignSpace, fixed: Mapping[str, float], uncertain: Collection[str], is_table: bool = False
) -> None:
    """Check that a campaign's constraints hold for values of variables, or can be kept for the uncertain ones."""
    values = space.quantities(fixed)
    written = space.written(fixed)
    derived = derived_in((*uncertain, *fixed), space.names)
    for constraint in space.constraints:
        if derived is not None and derived.replaces in constraint.names:
            follows = f"{derived.replaces} follows from {derived.quantity.name}"
            raise InputError(f"constraints: {constraint.text!r} cannot hold where {follows}.")
        if is_table and not constraint.names.isdisjoint(uncertain):
            raise InputError(f"constraints: {constraint.text!r} cannot hold for rows of a table.")
        if constraint.names <= values.keys() and not constraint.holds(values):
            of = ", ".join(f"{name} = {written[name]}" for name in sorted(constraint.names & {*fixed}))
            raise InputError(f"constraints: {constraint.text!r} must hold, got {of}.")


def _left_out(correlation: Iterable[tuple[str, str, float]], fixed: Mapping[str, float]) -> tuple[str, ...]:
    """Sentences on correlations that a distribution loses because one of both variables has a value."""
    sentences = []
    for first, second, rho in correlation:
        if rho and (first in fixed) != (second in fixed):
            held, other = (first, second) if first in fixed else (second, first)
            sentences.append(
                f"{held} has a value, so its correlation of {rho:g} with {other} is left out: {other} keeps its "
                "distribution."
            )
    return tuple(sentences)


def question_in(section: QuestionSettings, title: str, space: DesignSpace, further: Mapping[str, float]) -> Question:
    """The question of a section.

    Args:
        section: what the file says.
        title: in words, if the section has no description.
        space: of the campaign.
        further: values of variables.
    """
    known, derived = space.by_name, derived_in(section.space, space.names)
    quantity = "" if derived is None else derived.quantity.name
    if derived is not None:
        derived.check(space, f"space.{quantity}")
        known = known | {quantity: derived.quantity}
    with naming("space."):
        check_names([name for name in section.space if name not in known], space)
    if derived is not None and derived.replaces in {*section.space, *further}:
        raise InputError(f"space.{quantity}: cannot be combined with {derived.replaces}, which follows from it.")
    unbounded = sum(not one.is_bounded for name, one in section.space.items() if name not in further)
    distance = radius(section.reach, unbounded) if unbounded else np.inf
    stated, changed = dict[str, float](), dict[str, Parameter]()
    for name, entry in section.space.items():
        with naming(f"space.{name}"):
            if isinstance(entry, SetVariable):
                raise InputError(".set: must be left out; `choices` name some of the campaign's records.")
            if entry.unit not in ("", known[name].unit):
                of_campaign = known[name].unit or "left out"
                raise InputError(f".unit: must be {of_campaign}, as in the campaign, got {entry.unit!r}.")
            if isinstance(entry, FixedVariable):
                stated[name] = _number_in(entry.value, known[name], ".value")
            elif name not in further:
                changed[name] = _restated(known[name], entry, distance, in_steps=name != quantity)
    fixed = stated | dict(further)
    if derived is not None:
        derived.check_median(fixed[quantity] if quantity in fixed else float(changed[quantity].quantile(0.5)))
    return asked_of(section.description or title, space, changed, fixed, section.correlation)


def _restated(own: Parameter, entry: Variable | Choices, distance: float, in_steps: bool) -> Parameter:
    """A variable of a campaign with the distribution of a question: of its choices, or in its steps if `in_steps`.

    Bounds that the question leaves out are the next values outwards.
    """
    with naming(": "):
        one = entry.parameter(own.name, distance)
    if isinstance(entry, Choices) and entry.features is not None:
        raise InputError(".features: must be left out; choices have those of the campaign.")
    if own.choices and one.choices:
        shares = np.zeros(len(own.choices))
        for choice, share in zip(one.choices, one.probabilities, strict=True):
            shares[int(_number_in(choice, own, ".choices"))] = share
        return replace(own, probabilities=tuple(shares.tolist()))
    if own.choices or one.choices:
        rule = own.rule.replace("must be one of", "must be among") if own.choices else "must be left out"
        raise InputError(f".choices: {rule}, as in the campaign, got {list(one.choices)}.")
    if not in_steps:
        return one
    if one.step not in (None, own.step):
        stated = "left out" if own.step is None else f"{own.step:g}"
        raise InputError(f".step: must be {stated}, as in the campaign, got {one.step:g}.")
    if own.step is None:
        return one
    if entry.is_bounded and not own.on_grid(np.array([one.low, one.high])).all():
        raise InputError(
            f": `low` and `high` must be whole steps of {own.step:g} from {own.low:g}, as in the campaign, got "
            f"{one.low:g} and {one.high:g}."
        )
    first, step, low, high = (Decimal(repr(number)) for number in (own.low, own.step, one.low, one.high))
    ends = first + math.floor((low - first) / step) * step, first + math.ceil((high - first) / step) * step
    return replace(one, low=float(ends[0]), high=float(ends[1]), step=own.step)
