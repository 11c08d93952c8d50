"""Settings of a campaign: read from TOML, validated and frozen."""

import json
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import tomli_w
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from activefail.acquisition.criteria import Criterion
from activefail.bearing.design import LARGEST, TABLE_1, Model, Tolerance
from activefail.campaign.boundaries import boundary_shares
from activefail.errors import InputError
from activefail.features import FeatureSet
from activefail.files import check_dots
from activefail.space import DesignSpace, Distribution, Parameter, distribution_fault
from activefail.visible import visible


class _Section(BaseModel):
    # Strict: reject "7" as a seed and 0 as a boolean.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Variable(_Section):
    """One variable of the design space, between its bounds (`activefail.space.Parameter`)."""

    low: float
    high: float
    unit: str = ""
    distribution: Distribution = "uniform"
    mean: float | None = None
    sd: float | None = None

    @model_validator(mode="after")
    def _is_a_distribution(self) -> Self:
        if max(-self.low, self.high) > LARGEST:
            raise ValueError(
                f"`{-LARGEST:g} <= low` and `high <= {LARGEST:g}` must hold, got {self.low} and {self.high}"
            )
        fault = distribution_fault(self.low, self.high, self.distribution, self.mean, self.sd)
        if fault:
            raise ValueError(fault)
        return self

    def parameter(self, name: str) -> Parameter:
        """The variable of the design space, under a name."""
        return Parameter(name, self.low, self.high, self.unit, self.distribution, self.mean, self.sd)


class FixedVariable(_Section):
    """A quantity of the simulator that is the same for every design."""

    value: float = Field(ge=-LARGEST, le=LARGEST)
    unit: str = ""


class BearingSettings(_Section):
    """Settings of the double friction pendulum (`activefail.bearing.Model` and `Tolerance`)."""

    slider_diameter: float = Field(0.30, gt=0.0, lt=5.0)
    restitution_coefficient: float = Field(0.65, gt=0.0, le=1.0)
    restitution: Literal["pairwise", "assembly"] = "pairwise"
    slider_density: float = Field(7850.0, gt=0.0)
    friction_velocity: float = Field(1e-3, gt=0.0, le=0.1)
    loss_of_confinement: bool = True
    tolerance: float = Field(1e-4, ge=1e-10, le=1e-3)

    def model(self) -> Model:
        """The bearing model."""
        return Model(**self.model_dump(exclude={"tolerance"}))

    def integration(self) -> Tolerance:
        """The tolerance of the integration."""
        return Tolerance(relative=self.tolerance)


_Reference = Annotated[str, Field(pattern=r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*$")]
"""A Python function, "module:function"."""


class CustomSimulator(_Section):
    """Settings of every custom simulator.

    Attributes:
        outcomes: two or three names, the least severe first.
        margins: names of the numbers that it returns besides the outcome.
        time_limit: of one simulation [s]; no limit if None.
    """

    outcomes: list[str] = Field(["safe", "failure"], min_length=2, max_length=3)
    margins: list[str] = Field([], max_length=100)
    time_limit: float | None = Field(None, gt=0.0, le=1e9)

    @field_validator("outcomes", "margins")
    @classmethod
    def _are_names(cls, names: list[str]) -> list[str]:
        for name in names:
            if not name.isidentifier():
                raise ValueError(f"must be identifiers, got {name!r}")
            if names.count(name) > 1:
                raise ValueError(f"must differ from each other, got {name!r} twice")
        if "numerical_failure" in names:
            raise ValueError("'numerical_failure' is reserved for simulations without an outcome")
        return names


class PythonSimulator(CustomSimulator):
    """A simulator that is a Python function (`activefail.simulators.function`), found like `PythonFeatures`.

    Attributes:
        renew: simulations after which a worker process is replaced; never if None.
    """

    python: _Reference
    renew: int | None = Field(None, ge=1, le=1_000_000)


class CommandSimulator(CustomSimulator):
    """A simulator that is a program (`activefail.simulators.command`).

    Attributes:
        command: command line, with the variables in braces.
        retries: how often a failed simulation is repeated.
        keep: whether the folders of successful simulations are kept.
        largest_file: largest file that the program may write [bytes].
    """

    command: str = Field(min_length=1)
    retries: int = Field(0, ge=0, le=100)
    keep: bool = True
    largest_file: int = Field(10_000_000_000, ge=1_000_000, le=10**15)


class Sampling(_Section):
    """Numbers of simulations.

    Attributes:
        initial: in the initial design, a Latin hypercube.
        budget: in all.
        batch: in a batch; in an asynchronous campaign, in flight at a time.
        asynchronous: whether the campaign learns from each result as soon as it arrives.
    """

    initial: int = Field(250, ge=2, le=1_000_000)
    budget: int = Field(500, ge=2, le=1_000_000)
    batch: int = Field(10, ge=1, le=500)
    asynchronous: bool = False

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.budget < self.initial:
            raise ValueError(f"`initial <= budget` must hold, got {self.initial} and {self.budget}")
        if self.asynchronous and 2 * self.batch > self.initial:
            raise ValueError(
                f"`2 batch <= initial` must hold if asynchronous, got batch {self.batch} and initial {self.initial}"
            )
        return self


class PythonFeatures(_Section):
    """Custom features: a Python function.

    Attributes:
        python: the function; its module is searched for beside the campaign file, then on Python's path.
        variables: whether the variables precede the function's columns.
    """

    python: _Reference
    variables: bool = True


class ExpressionFeatures(_Section):
    """Custom features: arithmetic expressions of the variables.

    Attributes:
        expressions: expressions by feature name (`activefail.expressions`).
        variables: whether the variables precede the expressions' columns.
    """

    expressions: dict[str, str] = Field(min_length=1)
    variables: bool = True


_KINDS: dict[str, dict[str, type[_Section]]] = {
    "simulator": {"python": PythonSimulator, "command": CommandSimulator},
    "features": {"python": PythonFeatures, "expressions": ExpressionFeatures},
}
"""Alternative tables of a setting, by the key that only they have."""

_NAME, _RANGE = "a name", "a range"
_WITH = "a table with "


def _range_or_value(entry: Any) -> str:
    is_fixed = isinstance(entry, FixedVariable) or (isinstance(entry, dict) and "value" in entry)
    return f"{_WITH}value" if is_fixed else _RANGE


def _by_key(sections: Mapping[str, type[_Section]]) -> Discriminator:
    """Discriminate a name from tables, and the tables by the key that only one of them has."""

    def kind(value: Any) -> str:
        for key, section in sections.items():
            if isinstance(value, section) or (isinstance(value, dict) and key in value):
                return f"{_WITH}{key}"
        return "" if isinstance(value, dict) else _NAME

    keys = " or ".join(f"{_WITH}`{key}`" for key in sections)
    return Discriminator(kind, "no_such_table", f"must be a name, {keys}")


class ClassifierSettings(_Section):
    """Features of the classifier, and the smoothness of its boundaries."""

    features: Annotated[
        Annotated[FeatureSet, Tag(_NAME)]
        | Annotated[PythonFeatures, Tag(f"{_WITH}python")]
        | Annotated[ExpressionFeatures, Tag(f"{_WITH}expressions")],
        _by_key(_KINDS["features"]),
    ] = "paper"
    kernel: Literal["rbf", "matern52"] = "rbf"


class AcquisitionSettings(_Section):
    """How active designs are chosen."""

    criterion: Criterion = "entropy"
    boundary: str | dict[str, float] = "failure"
    exploration: float = Field(0.0, ge=0.0, le=1.0)

    @field_validator("boundary", mode="before")
    @classmethod
    def _one_outcome_or_weights(cls, boundary: object) -> object:
        if isinstance(boundary, dict):
            if not boundary:
                raise ValueError("must name at least one outcome, got {}")
            for name, weight in boundary.items():
                is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
                # A TOML integer may be larger than any float.
                if not (is_number and 0.0 < weight <= sys.float_info.max):
                    raise ValueError(f"the weight of {name!r} must be a positive finite number, got {_shown(weight)}")
        elif not isinstance(boundary, str):
            raise ValueError(f"must be an outcome, or a table of outcomes and weights, got {_shown(boundary)}")
        return boundary

    @property
    def boundaries(self) -> dict[str, float]:
        """The share of active designs for each target boundary, by outcome; the shares sum to 1."""
        return boundary_shares(self.boundary)

    @property
    def main_boundary(self) -> str:
        """The outcome with the largest share, the first if equal; a campaign's error refers to its boundary."""
        return max(self.boundaries, key=self.boundaries.__getitem__)


class Validation(_Section):
    """Designs outside the budget on which a campaign measures its accuracy while it runs."""

    size: int = Field(0, ge=0, le=100_000)


class Limits(_Section):
    """Limits above which a campaign stops with an error."""

    numerical_failures: float = Field(0.05, ge=0.0, le=1.0)


class Stop(_Section):
    """The stop rule: a campaign ends once its error is verified to be at most `error`, with `confidence`.

    Verification takes `simulations` fresh designs outside the budget, `every` so many batches, once the classifier
    itself expects no larger error.
    """

    error: float = Field(gt=0.0, lt=0.5)
    confidence: float = Field(0.9, ge=0.5, lt=1.0)
    simulations: int = Field(400, ge=10, le=10_000)
    every: int = Field(5, ge=1, le=1000)


_AnyVariable = Annotated[
    Annotated[Variable, Tag(_RANGE)] | Annotated[FixedVariable, Tag(f"{_WITH}value")], Discriminator(_range_or_value)
]


def _table_1() -> dict[str, Variable | FixedVariable]:
    return {p.name: Variable(low=p.low, high=p.high, unit=p.unit) for p in TABLE_1.parameters}


class CampaignSettings(_Section):
    """The definition of a campaign; with the same versions and threads it gives the same bits."""

    description: str = ""
    seed: int = Field(0, ge=0, lt=2**63)
    simulator: Annotated[
        Annotated[Literal["dfp"], Tag(_NAME)]
        | Annotated[PythonSimulator, Tag(f"{_WITH}python")]
        | Annotated[CommandSimulator, Tag(f"{_WITH}command")],
        _by_key(_KINDS["simulator"]),
    ] = "dfp"
    bearing: BearingSettings = BearingSettings()
    space: Annotated[dict[str, _AnyVariable], Field(min_length=1)] = Field(default_factory=_table_1)
    sampling: Sampling = Sampling()
    classifier: ClassifierSettings = ClassifierSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
    validation: Validation = Validation()
    limits: Limits = Limits()
    stop: Stop | None = None

    @model_validator(mode="before")
    @classmethod
    def _with_defaults_of_any_simulator(cls, values: Any) -> Any:
        """Set the defaults of a custom simulator.

        Features are the variables and the target boundary is that of the most severe outcome; `space` has no default.
        """
        if not (isinstance(values, dict) and isinstance(values.get("simulator"), dict)):
            return values
        defaults: dict[str, dict[str, Any]] = {"classifier": {"features": "design"}}
        outcomes = values["simulator"].get("outcomes")
        if isinstance(outcomes, list) and outcomes:
            defaults["acquisition"] = {"boundary": outcomes[-1]}
        for section, default in defaults.items():
            table = values.get(section, {})
            if isinstance(table, dict):
                values = values | {section: default | table}
        return {"space": None} | values

    @field_validator("space", mode="before")
    @classmethod
    def _of_the_simulator(cls, space: Any, info: ValidationInfo) -> Any:
        if space is not None:
            return space
        if "simulator" in info.data:
            raise ValueError("required with a custom simulator")
        return _table_1()  # `simulator` is invalid and has its own error

    @field_validator("space")
    @classmethod
    def _named(cls, space: dict[str, Variable | FixedVariable]) -> dict[str, Variable | FixedVariable]:
        for name in space:
            if not name.isidentifier():
                raise ValueError(f"a variable's name must be an identifier, got {name!r}")
        return space

    def design_space(self) -> DesignSpace:
        """The design space, its variables in the order of the file."""
        variables = {name: entry for name, entry in self.space.items() if isinstance(entry, Variable)}
        fixed = {name: entry.value for name, entry in self.space.items() if isinstance(entry, FixedVariable)}
        return DesignSpace(tuple(variable.parameter(name) for name, variable in variables.items()), fixed)

    def text(self) -> str:
        """The settings as TOML with all defaults, as frozen in a run folder."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def with_overrides(self, seed: int | None = None, budget: int | None = None) -> "CampaignSettings":
        """The settings with the seed and budget of a command line.

        Raises:
            InputError: if one breaks a rule.
        """
        overrides = {"seed": seed, "sampling.budget": budget}
        return self.changed({key: value for key, value in overrides.items() if value is not None})

    def changed(self, changes: Mapping[str, Any]) -> "CampaignSettings":
        """The settings with other values for some keys, like "sampling.budget".

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


def _key(name: str) -> str:
    """A key as TOML writes it: quoted unless it consists of letters, digits, `_` and `-`."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


_SHOWN = 200
"""Longest value shown in a message, in characters."""


def _shown(value: object) -> str:
    """A value as shown in messages."""
    try:
        text = repr(value)
    except ValueError:  # Python does not print integers of more than 4300 digits
        return "a number with thousands of digits"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _keys(path: Sequence[str]) -> list[str]:
    """The keys of the section at a path; the path is a validation error's `loc`."""
    match path:
        case []:
            section: Any = CampaignSettings
        case ["space", _, kind]:
            section = FixedVariable if kind == f"{_WITH}value" else Variable
        case [*_, "simulator" | "features" as name, kind]:
            section = _KINDS[name][kind.removeprefix(_WITH)]
        case [name, *_]:
            section = CampaignSettings.model_fields[name].annotation
    # An optional section's type includes None.
    return [key for one in get_args(section) or (section,) for key in getattr(one, "model_fields", ())]


def _unknown_key(path: Sequence[str], key: str) -> str:
    """The message for a key that the section at a path does not have."""
    match path:
        case ["space", _, _] if key in (*Variable.model_fields, *FixedVariable.model_fields):
            return "a variable has either `low` and `high` or `value`"
        case [*_, "simulator" | "features" as name, kind]:
            present = kind.removeprefix(_WITH)
            for other, section in _KINDS[name].items():
                if key == other:
                    return f"cannot be combined with `{present}`"
                if key in section.model_fields:
                    return f"belongs to `{other}`; cannot be combined with `{present}`"
    near = get_close_matches(key, _keys(path), 1)
    return f"unknown key; did you mean {near[0]!r}?" if near else "unknown key"


def _rule(error: Any) -> str:
    """One line of a validation error: key path, rule and value."""
    parts = [part for part in error["loc"] if part not in (_NAME, _RANGE) and not str(part).startswith(_WITH)]
    path = ".".join(_key(str(part)) for part in parts) or "the file"
    message = error["msg"].removeprefix("Value error, ")
    match error["type"]:
        case "extra_forbidden":
            *section, key = error["loc"]
            return f"{path}: {_unknown_key(section, key)}"
        case "missing":
            return f"{path}: required, but missing"
        case "value_error":
            return f"{path}: {message}"
        case "string_pattern_mismatch":
            return f'{path}: must be "module:function", got {_shown(error["input"])}'
        case "model_type" | "dict_type":
            return f"{path}: must be a table, got {_shown(error['input'])}"
        case "too_short" | "too_long" if "actual_length" in error["ctx"]:
            least, most = error["ctx"].get("min_length"), error["ctx"].get("max_length")
            rule = f"at least {least}" if most is None else f"at most {most}"
            return f"{path}: must hold {rule}, got {_shown(error['input'])}"
        case _:
            message = message.replace("Input should be", "must be")
            return f"{path}: {message}, got {_shown(error['input'])}"


_MOST_RULES = 50
"""Most broken rules listed in one message."""


def _checked(values: dict[str, Any], source: str) -> "CampaignSettings":
    try:
        return CampaignSettings.model_validate(values)
    except ValidationError as invalid:
        errors = invalid.errors()
        rules = [f"  {visible(_rule(error))}" for error in errors[:_MOST_RULES]]
        rest = [f"  and {len(errors) - _MOST_RULES} more"] if len(errors) > _MOST_RULES else []
        raise InputError("\n".join([f"{source}:", *rules, *rest])) from None


def parse_settings(text: str, source: str) -> CampaignSettings:
    """Parse settings from TOML; `source` names the text in errors.

    Raises:
        InputError: naming the source, and for each error the key path, the rule and the value.
    """
    try:
        check_dots(text)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from None
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{source}: not valid TOML: tables or lists nested hundreds deep.") from None
    except ValueError:
        raise InputError(f"{source}: not valid TOML: an integer with thousands of digits.") from None
    return _checked(values, source)


def read_settings(path: Path) -> CampaignSettings:
    """Read the settings of a campaign file.

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
