"""A campaign's settings: TOML in, checked and frozen."""

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from activefail.acquisition.criteria import Criterion
from activefail.bearing.design import TABLE_1, Model, Tolerance
from activefail.errors import InputError
from activefail.features import FeatureSet
from activefail.space import DesignSpace, Parameter


class _Section(BaseModel):
    # Strict: "7" is no seed, and 0 no truth value.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Variable(_Section):
    """One variable of the design space, uniform between its bounds."""

    low: float
    high: float
    unit: str = ""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"`low < high` must hold, got {self.low} and {self.high}")
        return self


class BearingSettings(_Section):
    """Settings of the double friction pendulum simulator (`activefail.bearing.Model` and `Tolerance`)."""

    slider_diameter: float = Field(0.30, gt=0.0, lt=5.0)
    restitution_coefficient: float = Field(0.65, gt=0.0, le=1.0)
    restitution: Literal["pairwise", "assembly"] = "pairwise"
    slider_density: float = Field(7850.0, gt=0.0)
    friction_velocity: float = Field(1e-3, gt=0.0, le=0.1)
    loss_of_confinement: bool = True
    tolerance: float = Field(1e-4, ge=1e-10, le=1e-3)

    def model(self) -> Model:
        """The simulator's model."""
        return Model(**self.model_dump(exclude={"tolerance"}))

    def integration(self) -> Tolerance:
        """The simulator's tolerance."""
        return Tolerance(relative=self.tolerance)


class Sampling(_Section):
    """How many simulations, and how they are shared out."""

    initial: int = Field(250, ge=2, le=1_000_000)
    budget: int = Field(500, ge=2, le=1_000_000)
    batch: int = Field(10, ge=1, le=500)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.budget < self.initial:
            raise ValueError(f"`initial <= budget` must hold, got {self.initial} and {self.budget}")
        return self


class PythonFeatures(_Section):
    """A function of one's own that says what the classifier sees.

    Attributes:
        python: "module:function"; the module is looked for beside the campaign's file, then where Python looks.
        variables: whether the variables themselves come before what the function returns.
    """

    python: str = Field(pattern=r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*$")
    variables: bool = True


_TAGS = ("a name", "a table")


def _kind(features: Any) -> str:
    return _TAGS[isinstance(features, (dict, PythonFeatures))]


class ClassifierSettings(_Section):
    """What the classifier sees and how smooth it takes the boundary to be."""

    features: Annotated[
        Annotated[FeatureSet, Tag(_TAGS[0])] | Annotated[PythonFeatures, Tag(_TAGS[1])], Discriminator(_kind)
    ] = "paper"
    kernel: Literal["rbf", "matern52"] = "rbf"


class AcquisitionSettings(_Section):
    """Where the next simulations go."""

    criterion: Criterion = "entropy"
    boundary: str | dict[str, float] = "failure"
    exploration: float = Field(0.0, ge=0.0, le=1.0)

    @field_validator("boundary", mode="before")
    @classmethod
    def _one_outcome_or_weights(cls, boundary: object) -> object:
        if isinstance(boundary, dict):
            if not boundary:
                raise ValueError("must name at least one outcome")
            for name, weight in boundary.items():
                number = isinstance(weight, int | float) and not isinstance(weight, bool)
                if not (number and 0.0 < weight < math.inf):
                    raise ValueError(f"the weight of {name!r} must be a positive finite number, got {weight!r}")
        elif not isinstance(boundary, str):
            raise ValueError(f"must be an outcome, or a table of outcomes and weights, got {boundary!r}")
        return boundary

    @property
    def boundaries(self) -> dict[str, float]:
        """The outcomes whose boundaries are sought, and each one's share of the chosen designs; their sum is 1."""
        weights = {self.boundary: 1.0} if isinstance(self.boundary, str) else self.boundary
        # By the largest first: the sum of huge weights must not overflow.
        largest = max(weights.values())
        scaled = {name: weight / largest for name, weight in weights.items()}
        return {name: weight / sum(scaled.values()) for name, weight in scaled.items()}

    @property
    def main_boundary(self) -> str:
        """The outcome with the largest share, the first of equals: by its boundary a campaign is judged."""
        return max(self.boundaries, key=self.boundaries.__getitem__)


class Validation(_Section):
    """Extra simulations, outside the budget, on which a campaign measures its accuracy as it goes."""

    size: int = Field(0, ge=0, le=100_000)


class Limits(_Section):
    """When a campaign stops by itself."""

    numerical_failures: float = Field(0.05, ge=0.0, le=1.0)


class Stop(_Section):
    """When a campaign is good enough: its error is verified to be at most a value, with a confidence.

    Verification simulations are extra, outside the budget, and asked for every so many batches, once the classifier
    itself expects no larger error.
    """

    error: float = Field(gt=0.0, lt=0.5)
    confidence: float = Field(0.9, ge=0.5, lt=1.0)
    simulations: int = Field(100, ge=10, le=10_000)
    every: int = Field(5, ge=1, le=1000)


class CampaignSettings(_Section):
    """All that defines a campaign; with the same versions and threads it gives the same bits."""

    description: str = ""
    seed: int = Field(0, ge=0, lt=2**63)
    simulator: Literal["dfp"] = "dfp"
    bearing: BearingSettings = BearingSettings()
    space: Annotated[dict[str, Variable], Field(min_length=1)] = Field(
        default_factory=lambda: {p.name: Variable(low=p.low, high=p.high, unit=p.unit) for p in TABLE_1.parameters}
    )
    sampling: Sampling = Sampling()
    classifier: ClassifierSettings = ClassifierSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
    validation: Validation = Validation()
    limits: Limits = Limits()
    stop: Stop | None = None

    def design_space(self) -> DesignSpace:
        """The design space, its variables in the order of the file."""
        return DesignSpace(tuple(Parameter(name, v.low, v.high, v.unit) for name, v in self.space.items()))

    def text(self) -> str:
        """The settings as TOML, defaults written out: the frozen copy of a run folder."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def with_overrides(self, seed: int | None = None, budget: int | None = None) -> "CampaignSettings":
        """The settings with a command line's seed and budget.

        Raises:
            InputError: if one breaks a rule.
        """
        given = {"seed": seed, "sampling.budget": budget}
        return self.changed({key: value for key, value in given.items() if value is not None})

    def changed(self, changes: Mapping[str, Any]) -> "CampaignSettings":
        """The settings with other values at some keys, like "sampling.budget".

        Raises:
            InputError: if one breaks a rule.
        """
        values = self.model_dump(mode="json")
        for key, value in changes.items():
            *sections, name = key.split(".")
            section = values
            for part in sections:
                section = section[part]
            section[name] = value
        return _checked(values, "command line")


def _rule(error: Any) -> str:
    """One line of a validation error: key path, rule and value."""
    path = ".".join(str(part) for part in error["loc"] if part not in _TAGS) or "the file"
    message = error["msg"].removeprefix("Value error, ")
    match error["type"]:
        case "extra_forbidden":
            return f"{path}: unknown key"
        case "missing":
            return f"{path}: required, but not there"
        case "value_error":
            return f"{path}: {message}"
        case "string_pattern_mismatch":
            return f'{path}: must be "module:function", got {error["input"]!r}'
        case _:
            message = message.replace("Input should be", "must be")
            return f"{path}: {message}, got {error['input']!r}"


def _checked(values: dict[str, Any], source: str) -> "CampaignSettings":
    try:
        return CampaignSettings.model_validate(values)
    except ValidationError as invalid:
        rules = "\n".join(f"  {_rule(error)}" for error in invalid.errors())
        raise InputError(f"{source}:\n{rules}") from None


def parse_settings(text: str, source: str) -> CampaignSettings:
    """Settings from TOML; `source` names the text in errors.

    Raises:
        InputError: naming the source, and for each mistake the key path, the rule and the value.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as malformed:
        raise InputError(f"{source}: not valid TOML: {malformed}") from None
    return _checked(values, source)


def read_settings(path: Path) -> CampaignSettings:
    """Settings of a campaign file.

    Raises:
        InputError: if the file cannot be read, is not UTF-8 TOML, or breaks a rule.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None
    return parse_settings(text, str(path))
