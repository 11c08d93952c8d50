"""Settings of a campaign: read from TOML, validated and frozen."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

import numpy as np
import tomli_w
from pydantic import Field, Tag, ValidationError, ValidationInfo, create_model, field_validator, model_validator

from activefail.campaign.broken_rules import broken_rule
from activefail.campaign.named import NamedSettings
from activefail.campaign.section import NAME, WITH, Section, by_key
from activefail.campaign.sections import (
    KINDS,
    AcquisitionSettings,
    ClassifierSettings,
    CommandSimulatorSettings,
    ElsewhereSettings,
    ErrorStop,
    Limits,
    ProbabilityStop,
    PythonFeaturesSettings,
    PythonSettings,
    PythonSimulatorSettings,
    QuestionSettings,
    Sampling,
    StopRule,
    Validation,
    usual_initial,
)
from activefail.campaign.variables import AnyVariable, FixedVariable, ReadSet, SetVariable
from activefail.errors import InputError
from activefail.plugins import brought
from activefail.space.expressions import parse_constraint
from activefail.space.space import Constraint, DesignSpace, radius
from activefail.text.toml import parse_toml, read_toml
from activefail.visible import visible

_STRONG = 0.9
"""Correlation of two variables from which the variables themselves are poor features, in magnitude."""


def _tables(section: object) -> list[dict[str, Any]]:
    """The tables in a section that has not been validated yet."""
    return [one for one in section.values() if isinstance(one, dict)] if isinstance(section, dict) else []


def _is_strong(correlation: object) -> bool:
    """Whether correlations that have not been validated yet include one of `_STRONG` or more."""
    pairs = correlation if isinstance(correlation, list) else []
    return any(
        isinstance(rho, int | float) and abs(rho) >= _STRONG
        for rho in (pair[-1] for pair in pairs if isinstance(pair, list | tuple) and pair)
    )


def _constraint(text: str, space: Mapping[str, AnyVariable]) -> Constraint:
    """A constraint of variables, features of their choices, and fixed quantities.

    Raises:
        ValueError: as `parse_constraint` does.
    """
    carriers = {feature: name for name, one in space.items() for feature in one.quantities}
    return parse_constraint(text, space, carriers, [name for name, one in space.items() if one.has_texts])


IF_CALLED = "requires a simulator that activefail can call, not `elsewhere`"
IF_REPEATABLE = "requires a simulator that repeats: with noise, no design is simply wrong"
"""Rule of what counts wrong designs."""


_Custom = (
    Annotated[PythonSimulatorSettings, Tag(f"{WITH}python")]
    | Annotated[CommandSimulatorSettings, Tag(f"{WITH}command")]
    | Annotated[ElsewhereSettings, Tag(f"{WITH}elsewhere")]
)

NAMED: dict[str, type[NamedSettings]] = {**brought("simulators")}
"""The settings of each simulator, by its name."""

if TYPE_CHECKING:
    _Simulator = str | PythonSimulatorSettings | CommandSimulatorSettings | ElsewhereSettings
elif NAMED:
    _Simulator = Annotated[Annotated[Literal[tuple(NAMED)], Tag(NAME)] | _Custom, by_key(KINDS["simulator"])]
else:
    _Simulator = Annotated[_Custom, by_key(KINDS["simulator"], otherwise="")]


class _Simulated(Section):
    """The first keys of a campaign file, before the sections of plug-ins.

    Attributes:
        description: one line, which `status` shows.
        seed: seed of all random numbers.
        simulator: "dfp", the double friction pendulum bearing, or a table of a custom simulator.
    """

    description: str = ""
    seed: int = Field(0, ge=0, lt=2**63)
    simulator: _Simulator = Field(brought("defaults").get("simulator", ...))


if TYPE_CHECKING:
    _WithSections = _Simulated
else:
    _WithSections = create_model(
        "_WithSections", __base__=_Simulated, **{one.section: (one, one()) for one in NAMED.values()}
    )


class CampaignSettings(_WithSections):
    """The definition of a campaign; with the same versions and threads it gives the same bits.

    Attributes:
        bearing: model of the bearing.
        space: variables and fixed quantities by name. If all are of the bearing, those left out are as in Table 1; a
            custom simulator requires all.
        correlation: pairs of variables with the correlation coefficient of their values.
        constraints: conditions that all designs meet, such as "depth + gap <= 1".
        sampling: numbers of simulations.
        classifier: features, covariance, and what is learned from.
        acquisition: how designs are chosen.
        validation: designs on which the accuracy is measured during the campaign.
        limits: limits of numerical failures.
        stop: the stop rule; none by default.
        question: other distributions, under which `activefail probability` answers.
    """

    space: Annotated[dict[str, AnyVariable], Field(min_length=1)] = Field(default_factory=dict)
    correlation: list[Annotated[tuple[str, str, float], Field(strict=False)]] = Field(default_factory=list)
    constraints: list[str] = Field([], max_length=100)
    sampling: Sampling = Sampling()
    classifier: ClassifierSettings = ClassifierSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
    validation: Validation = Validation()
    limits: Limits = Limits()
    stop: StopRule | None = None
    question: QuestionSettings | None = None

    @model_validator(mode="before")
    @classmethod
    def _with_defaults_of_any_simulator(cls, values: Any) -> Any:
        """Set the defaults of a custom simulator.

        Features are the variables, decorrelated if two are strongly correlated, and the target boundary is that of the
        most severe outcome; `space` has no default.
        """
        if not isinstance(values, dict):
            return values
        values = {"space": None} | values
        if not isinstance(values.get("simulator"), dict):
            return values
        features = "decorrelated" if _is_strong(values.get("correlation")) else "design"
        defaults: dict[str, dict[str, Any]] = {"classifier": {"features": features}}
        if isinstance(values.get("stop"), dict) and "probability" in values["stop"]:
            # A probability needs few designs of the bulk, and every result changes where the next one teaches most.
            variables = sum("value" not in one for one in _tables(values.get("space")))
            sampling = values.get("sampling")
            budget = sampling.get("budget") if isinstance(sampling, dict) else None
            defaults["sampling"] = {"initial": usual_initial(max(12, 2 * variables), budget), "batch": 1}
            # Of outcomes alone this criterion misses least of a rare failure; margins have their own.
            defaults["acquisition"] = {"criterion": "eavc"}
        elif values["simulator"].get("repeatable") is False:
            # Entropy prefers designs whose labels are noise, whatever is known of them.
            defaults["acquisition"] = {"criterion": "bald"}
        outcomes = values["simulator"].get("outcomes")
        if isinstance(outcomes, list) and outcomes:
            defaults["acquisition"] = defaults.get("acquisition", {}) | {"boundary": outcomes[-1]}
        for section, default in defaults.items():
            table = values.get(section, {})
            if isinstance(table, dict):
                values = values | {section: default | table}
        return values

    @field_validator("space", mode="before")
    @classmethod
    def _of_the_simulator(cls, space: Any, info: ValidationInfo) -> Any:
        # An invalid simulator has its own error.
        simulator = info.data.get("simulator", brought("defaults").get("simulator"))
        default = NAMED[simulator].default_space() if isinstance(simulator, str) else {}
        if space is not None:
            # Of variables that are all a plug-in's, what the file leaves out is as it says.
            is_part = isinstance(space, dict) and space and space.keys() <= default.keys()
            return space | {name: one for name, one in default.items() if name not in space} if is_part else space
        if not default:
            is_custom = "simulator" in info.data
            raise ValueError("required with a custom simulator" if is_custom else "required, but missing")
        return default

    @field_validator("space")
    @classmethod
    def _named(cls, space: dict[str, AnyVariable]) -> dict[str, AnyVariable]:
        for name, entry in space.items():
            if not name.isidentifier():
                raise ValueError(f"a variable's name must be an identifier, got {name!r}")
            if isinstance(entry, FixedVariable) and isinstance(entry.value, str):
                raise ValueError(f"{name}.value: must be a number, got {entry.value!r}")
            for level in (entry.scaled_to or {}) if isinstance(entry, SetVariable) else ():
                if level not in space or space[level].has_texts:
                    raise ValueError(f"{name}.scaled_to: must name a variable with numbers of the space, got {level!r}")
        return space

    @field_validator("constraints")
    @classmethod
    def _are_conditions(cls, texts: list[str], info: ValidationInfo) -> list[str]:
        # Without a space, that has its own error; with a file that has not been read, names are unknown.
        is_known = "space" in info.data and not any(one.file for one in info.data["space"].values())
        for text in texts if is_known else ():
            _constraint(text, info.data["space"])
        return texts

    @model_validator(mode="after")
    def _asks_once(self) -> Self:
        # The search weighs designs by `space`, and the rule refers to the same probability.
        if isinstance(self.stop, ProbabilityStop) and self.question is not None:
            raise ValueError(
                "`stop.probability` cannot be combined with `question`; put its distributions into `space`"
            )
        return self

    @model_validator(mode="after")
    def _simulates_what_it_can(self) -> Self:
        verifies = {"stop.error": self.error_rule is not None, "validation.size": self.validation.size > 0}
        fresh = verifies | {"sampling.asynchronous": self.sampling.asynchronous}
        for rules, is_met, rule in (
            (verifies, self.is_repeatable, IF_REPEATABLE),
            (fresh, not self.is_elsewhere, IF_CALLED),
        ):
            for key in [] if is_met else [key for key, is_set in rules.items() if is_set]:
                raise ValueError(f"`{key}` {rule}")
        return self

    @property
    def error_rule(self) -> ErrorStop | None:
        """The stop rule, if it verifies the classifier's error."""
        return self.stop if isinstance(self.stop, ErrorStop) else None

    @property
    def probability_rule(self) -> ProbabilityStop | None:
        """The stop rule, if it asks for a probability."""
        return self.stop if isinstance(self.stop, ProbabilityStop) else None

    @property
    def named(self) -> dict[str, NamedSettings]:
        """The settings of the simulators that plug-ins bring, by their names."""
        return {name: getattr(self, one.section) for name, one in NAMED.items()}

    @property
    def used(self) -> list[NamedSettings]:
        """Those that the campaign uses, for its simulations or its features."""
        features = self.classifier.features
        return [one for name, one in self.named.items() if name == self.simulator or features in one.features]

    @property
    def needs_code(self) -> bool:
        """Whether only a user who trusts the settings may use them: they name functions, a program or a folder."""
        reads = any(isinstance(entry, SetVariable) and os.path.isabs(entry.set) for entry in self.space.values())
        simulates = isinstance(self.simulator, PythonSimulatorSettings | CommandSimulatorSettings)
        has_features = isinstance(self.classifier.features, PythonFeaturesSettings)
        chooses = isinstance(self.acquisition.criterion, PythonSettings)
        return reads or simulates or has_features or self.classifier.is_custom or chooses

    @property
    def is_repeatable(self) -> bool:
        """Whether equal designs have equal results, as far as the settings say."""
        return isinstance(self.simulator, str) or self.simulator.repeatable is not False

    @property
    def is_elsewhere(self) -> bool:
        """Whether simulations are done elsewhere, so that activefail cannot run any."""
        return isinstance(self.simulator, ElsewhereSettings)

    @property
    def refused(self) -> dict[str, str]:
        """Why this campaign refuses commands with fresh simulations, by command."""
        if self.is_elsewhere:
            return dict.fromkeys(("verify", "probability", "design", "compare"), IF_CALLED)
        return {} if self.is_repeatable else {"compare": IF_REPEATABLE}

    @property
    def without_order(self) -> tuple[str, ...]:
        """Names of the variables with choices."""
        return tuple(name for name, one in self.space.items() if getattr(one, "choices", None))

    def design_space(self) -> DesignSpace:
        """The design space, its variables in the order of the file."""
        variables = {name: entry for name, entry in self.space.items() if not isinstance(entry, FixedVariable)}
        fixed = {name: float(entry.value) for name, entry in self.space.items() if isinstance(entry, FixedVariable)}
        bounded = all(variable.is_bounded for variable in variables.values())
        distance = np.inf if bounded else radius(self.sampling.reach, len(variables))
        parameters = tuple(variable.parameter(name, distance) for name, variable in variables.items())
        constraints = tuple(_constraint(text, self.space) for text in self.constraints)
        return DesignSpace(parameters, fixed, tuple(self.correlation), constraints)

    def text(self) -> str:
        """The settings as TOML with all defaults, as frozen in a run folder."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True, by_alias=True))

    def completed(self, folder: Path, read_set: ReadSet | None) -> "CampaignSettings":
        """The settings with what files in the folder of the campaign file say of variables (see `Entry.completed`)."""
        space = {name: entry.completed(name, folder, read_set) for name, entry in self.space.items()}
        changes = {f"space.{name}": one for name, one in space.items() if one is not self.space[name]}
        written = {key: one.model_dump(mode="json") for key, one in changes.items()}
        return self.changed(written, "files of space") if changes else self

    def changed(self, changes: Mapping[str, Any], source: str = "command line") -> "CampaignSettings":
        """The settings with other values for some keys, like "sampling.budget".

        Args:
            changes: the values.
            source: names them in errors.
        """
        values = self.model_dump(mode="json", by_alias=True)
        for key, value in changes.items():
            *sections, name = key.split(".")
            section = values
            for part in sections:
                section = section[part]
            section[name] = value
        return checked(CampaignSettings, values, source)


SectionType = TypeVar("SectionType", bound=Section)

_MOST_RULES = 50
"""Most broken rules listed in one message."""


def checked(section: type[SectionType], values: dict[str, Any], source: str) -> SectionType:
    """The settings with these values.

    Args:
        section: the kind of settings.
        values: their values.
        source: names the settings in errors.
    """
    try:
        return section.model_validate(values)
    except ValidationError as invalid:
        errors = invalid.errors()
        rules = [f"  {visible(broken_rule(section, error))}" for error in errors[:_MOST_RULES]]
        rest = [f"  and {len(errors) - _MOST_RULES} more"] if len(errors) > _MOST_RULES else []
        raise InputError("\n".join([f"{source}:", *rules, *rest])) from None


def parse_settings(text: str, source: str) -> CampaignSettings:
    """Parse settings from TOML.

    Args:
        text: the TOML.
        source: names the text in errors.
    """
    return checked(CampaignSettings, parse_toml(text, source), source)


def read_settings(path: Path, seed: int | None = None, budget: int | None = None) -> CampaignSettings:
    """Read the settings of a campaign file, or those that a run folder has frozen.

    Args:
        path: the file.
        seed, budget: of the command line; they replace those of the file before its rules are checked.

    Raises:
        InputError: if the file cannot be read, is not UTF-8 TOML, or breaks a rule.
    """
    values, source = read_toml(path), str(path)
    if seed is not None:
        values, source = values | {"seed": seed}, f"{source} --seed {seed}"
    if budget is not None and isinstance(sampling := values.get("sampling", {}), dict):
        values, source = values | {"sampling": sampling | {"budget": budget}}, f"{source} --budget {budget}"
    return checked(CampaignSettings, values, source)
