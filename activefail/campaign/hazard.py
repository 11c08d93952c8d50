"""Hazards: a kind of question file that a plug-in brings, with levels of an intensity, property bounds and rates."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, Self

from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.plugins import brought
from activefail.space.space import Array, DesignSpace
from activefail.text.toml import read_toml

Bound = Literal["lower", "upper", "nominal"]
"""A bound of the properties of a design."""


class Deaggregation(Protocol):
    """Which loads of a hazard contribute the failures beyond a boundary."""

    header: ClassVar[tuple[str, ...]]
    """Names of the columns of `table`."""

    figure: ClassVar[str]
    """Name of the plug-in's function in `figures` that draws the failures beyond a boundary; it gives None if they are
    too rare."""

    @property
    def probability(self) -> float:
        """Of failure under the whole hazard, by the classifier."""

    @property
    def numbers(self) -> dict[str, Any]:
        """What `--json` shows of it."""

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts; a continued title is empty."""

    @property
    def table(self) -> list[list[Any]]:
        """Its parts, a row each."""


class Hazard(Protocol):
    """The loads of a site, read from a file, and the question that they ask of a campaign.

    A plug-in names classes of hazards in its dictionary QUESTIONS.
    """

    variables: ClassVar[tuple[str, ...]]
    """The variables of a campaign that belong to the loads."""

    loads: ClassVar[str]
    """What they are, such as "pulses"."""

    intensity: ClassVar[str]
    """Name of their intensity."""

    unit: ClassVar[str]
    """Its unit."""

    @classmethod
    def is_of(cls, values: Mapping[str, Any]) -> bool:
        """Whether the values of a file are those of such a hazard, by their keys."""

    @classmethod
    def of(cls, values: dict[str, Any], path: Path) -> Self:
        """The hazard with the values of a file.

        Raises:
            InputError: naming the file, the key, the rule and the value.
        """

    @classmethod
    def applies_to(cls, space: DesignSpace) -> bool:
        """Whether a campaign's variables have such loads."""

    @property
    def title(self) -> str:
        """In words."""

    @property
    def is_table(self) -> bool:
        """Whether the loads are rows of a table, beside which all other variables need values."""

    @property
    def assumptions(self) -> Sequence[str]:
        """What it leaves out and assumes, as sentences."""

    @property
    def alone(self) -> Self | None:
        """The loads without added uncertainty; None if nothing is added."""

    @property
    def bounds(self) -> tuple[Bound, ...]:
        """The property bounds that it has; "nominal" is always one."""

    @property
    def factors(self) -> Mapping[str, float]:
        """Factors on variables of a design at its property bound."""

    def at_bound(self, bound: Bound) -> Self:
        """The hazard at another property bound."""

    def question(self, space: DesignSpace, fixed: Mapping[str, float], at: float | None = None) -> Question:
        """The question that it asks of a campaign.

        Args:
            space: of the campaign.
            fixed: values of variables that are certain; others keep the campaign's distributions.
            at: the level of the intensity, if it is given.

        Raises:
            InputError: if the hazard says nothing about these variables, or one of them needs a value.
        """

    def levels(self) -> Array:
        """Levels of the intensity, (n,), in equal steps of the logarithm."""

    @property
    def median(self) -> float:
        """The median of the intensity."""

    @property
    def assumptions_at_levels(self) -> Sequence[str]:
        """What the question at each level assumes, as sentences."""

    @property
    def rates(self) -> tuple[Array, Array] | None:
        """Intensities, (m,), increasing, and the annual rates at which they are exceeded, (m,); None if unknown."""

    def of_rates(self) -> Self:
        """The hazard of the loads that occur as the rates say."""

    def deaggregated(
        self,
        boundaries: Callable[[Array], Array],
        space: DesignSpace,
        fixed: Mapping[str, float],
        probability: Array,
    ) -> Sequence[Deaggregation | None]:
        """Which loads contribute the failures beyond each boundary; None where it is not known.

        Args:
            boundaries: of the campaign's designs, (n, d) -> (n, b).
            space, fixed: as for `question`.
            probability: (b,) under the whole hazard.
        """


class SimpleHazard:
    """What a hazard has that knows neither property bounds, nor rates, nor added uncertainty, nor its contributions."""

    variables: ClassVar[tuple[str, ...]]
    loads: ClassVar[str] = "loads"
    is_table, bounds, alone, rates = False, ("nominal",), None, None
    factors: ClassVar[Mapping[str, float]] = {}
    assumptions: ClassVar[Sequence[str]] = ()
    assumptions_at_levels: ClassVar[Sequence[str]] = ()

    @classmethod
    def applies_to(cls, space: DesignSpace) -> bool:
        """Whether a campaign has the variables."""
        return {*cls.variables} <= {*space.names}

    def at_bound(self, bound: Bound) -> Self:
        """The same."""
        return self

    def deaggregated(
        self, boundaries: Callable[[Array], Array], space: DesignSpace, fixed: Mapping[str, float], probability: Array
    ) -> Sequence[None]:
        """None of any boundary."""
        return [None] * len(probability)


def is_hazard(given: object) -> bool:
    """Whether this is a hazard, and not a path or a question."""
    return isinstance(given, tuple(_kinds()))


def has_hazards(space: DesignSpace) -> bool:
    """Whether there can be a hazard of a campaign with these variables."""
    return any(kind.applies_to(space) for kind in _kinds())


def hazard_in(values: dict[str, Any], path: Path) -> Hazard | None:
    """The hazard with the values of a file; None if they are of no hazard."""
    return next((kind.of(values, path) for kind in _kinds() if kind.is_of(values)), None)


def read_hazard(path: Path) -> Hazard:
    """Read a hazard file.

    Raises:
        InputError: if it is none; if no plug-in brings hazards.
    """
    kinds, values = _kinds(), read_toml(path)
    if not kinds:
        raise InputError("hazard: requires a plug-in that brings hazards; none is installed.")
    return hazard_in(values, path) or kinds[0].of(values, path)


def _kinds() -> list[type[Hazard]]:
    return list(brought("questions").values())
