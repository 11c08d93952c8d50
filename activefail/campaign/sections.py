"""Sections of a campaign's settings, such as `[stop]`: their keys, what these mean, and which exclude each other."""

import itertools
import re
import sys
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from activefail.bearing.design import LARGEST, Model, Tolerance
from activefail.distributions import PARAMETERS, Distribution, moments, parameters_fault, quantiles_at
from activefail.errors import InputError
from activefail.names import Criterion, FeatureSet, Kernel
from activefail.parameter import (
    MOST_CHOICES,
    MOST_WITH_FEATURES,
    Choice,
    Parameter,
    choices_fault,
    distribution_fault,
    features_fault,
    step_fault,
)
from activefail.simulators.interface import EXECUTION_CAUSES
from activefail.systems import System, parse_system

_SHOWN = 200
"""Longest value shown in a message, in characters."""


def shown(value: object) -> str:
    """A value as shown in messages."""
    try:
        text = repr(value)
    except ValueError:  # Python does not print integers of more than 4300 digits
        return "a number with thousands of digits"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


NAME, NUMBER, RANGE = "a name", "a number", "a range"
WITH = "a table with "
"""Tags of alternative values, which no message shows."""

_WIDEST = 9.0
"""Largest distance of a bound from the median in standard deviations: the probability beyond is 10⁻¹⁹."""


class Section(BaseModel):
    """A table of the settings; it knows no other keys, takes no infinite numbers and is frozen."""

    # Strict: reject "7" as a seed and 0 as a boolean.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


_Features = Annotated[
    Annotated[str, Tag(NAME)] | Annotated[dict[str, list[float]], Tag(f"{WITH}numbers")],
    Discriminator(lambda value: NAME if isinstance(value, str) else f"{WITH}numbers"),
]


class Variable(Section):
    """One variable of the design space: its distribution and its bounds (`activefail.space.Parameter`).

    Distributions are stated by mean and sd, by mean and coefficient of variation, or by their own parameters
    (`activefail.distributions`). Only uniform, log-uniform, truncated
    normal and beta variables need bounds.

    Attributes:
        low: lower bound, in the unit of the variable. It truncates a distribution that needs no bounds.
        high: upper bound, likewise.
        unit: unit as text, for tables and figures; nothing is converted.
        step: distance of the values low, low + step, ..., high of a variable that is not continuous, such as 1 for a
            whole number. Each has the probability of all values that are rounded to it.
        choices: texts or numbers without order, in place of bounds and distribution.
        probabilities: of the choices; equal if left out.
        features: quantities that follow from the choice, from a CSV file beside the campaign file or as numbers
            ([choices](../distributions.md#choices)). activefail writes the numbers to run folders.
        distribution: name of the distribution.
        mean: mean, before truncation.
        sd: standard deviation, before truncation.
        cov: coefficient of variation, sd / abs(mean), in place of `sd`.
        median: median of a lognormal variable.
        dispersion: standard deviation of the logarithm of a lognormal variable.
        location: mode of a Gumbel variable.
        shape: shape of a Weibull or gamma variable.
        scale: scale of a Gumbel, Weibull or gamma variable.
        alpha: first shape of a beta variable between its bounds.
        beta: second shape of a beta variable.
        rate: rate of an exponential variable, 1 / mean.
    """

    low: float | None = None
    high: float | None = None
    unit: str = ""
    step: float | None = None
    choices: list[Choice] | None = None
    probabilities: list[float] | None = None
    features: _Features | None = None
    distribution: Distribution = "uniform"
    mean: float | None = None
    sd: float | None = None
    cov: float | None = None
    median: float | None = None
    dispersion: float | None = None
    location: float | None = None
    shape: float | None = None
    scale: float | None = None
    alpha: float | None = None
    beta: float | None = None
    rate: float | None = None

    @field_validator("choices", mode="before")
    @classmethod
    def _are_texts_or_numbers(cls, choices: object) -> object:
        for one in choices if isinstance(choices, list) else ():
            is_number = isinstance(one, int | float) and not isinstance(one, bool)
            if not isinstance(one, str) and not (is_number and abs(one) <= LARGEST):  # false for NaN too
                raise ValueError(f"must be texts, or numbers of at most {LARGEST:g} in size, got {shown(one)}")
        return choices

    @model_validator(mode="after")
    def _is_a_distribution(self) -> Self:
        if self.choices is not None:
            for name in self.model_fields_set - {"choices", "probabilities", "features", "unit"}:
                if getattr(self, name) not in (None, "uniform"):
                    raise ValueError(f"`{name}` cannot be combined with `choices`, got {getattr(self, name)!r}")
            most = MOST_CHOICES if self.features is None else MOST_WITH_FEATURES
            fault = choices_fault(self.choices, self.probabilities or (), most)
            if fault := fault or (features_fault(self.quantities, self.choices) if self.has_numbers else ""):
                raise ValueError(fault)
            return self
        for name in ("probabilities", "features"):
            if getattr(self, name) is not None:
                raise ValueError(f"`{name}` requires `choices`, got {shown(getattr(self, name))}")
        if fault := parameters_fault(self.distribution, self.low, self.high, self._parameters):
            raise ValueError(fault)
        # The widest reach that settings allow; bounds in the file do not depend on it.
        low, high, mean, sd = self._numbers(_WIDEST)
        if max(-low, high) > LARGEST:
            raise ValueError(f"the range must lie between {-LARGEST:g} and {LARGEST:g}, got {low:g} to {high:g}")
        if fault := distribution_fault(low, high, self.distribution, mean, sd):
            raise ValueError(fault)
        if self.step is None:
            return self
        if not self.is_bounded:
            raise ValueError("a variable with a `step` requires `low` and `high`")
        if fault := step_fault(low, high, self.step, self.distribution):
            raise ValueError(fault)
        return self

    @property
    def has_texts(self) -> bool:
        """Whether the choices are texts."""
        return any(isinstance(one, str) for one in self.choices or ())

    @property
    def has_numbers(self) -> bool:
        """Whether the choices have features whose numbers are known."""
        return isinstance(self.features, dict)

    @property
    def quantities(self) -> dict[str, list[float]]:
        """The features of the choices whose numbers are known."""
        return self.features if isinstance(self.features, dict) else {}

    @property
    def _parameters(self) -> dict[str, float]:
        numbers = {name: getattr(self, name) for name in PARAMETERS}
        return {name: number for name, number in numbers.items() if number is not None}

    def _numbers(self, distance: float) -> tuple[float, float, float | None, float | None]:
        """Bounds, mean and sd; bounds that the file leaves out lie `distance` standard deviations out."""
        mean, sd = (
            moments(self.distribution, self.low, self.high, self._parameters) if self._parameters else (None, None)
        )
        low, high = self.low, self.high
        if mean is not None and sd is not None and (low is None or high is None):
            least, largest = quantiles_at(self.distribution, mean, sd, distance)
            low, high = least if low is None else low, largest if high is None else high
        assert low is not None
        assert high is not None
        return low, high, mean, None if self.distribution == "exponential" else sd

    @property
    def is_bounded(self) -> bool:
        """Whether the file gives both bounds, or choices."""
        return self.choices is not None or (self.low is not None and self.high is not None)

    def parameter(self, name: str, distance: float) -> Parameter:
        """The variable of the design space, under a name.

        Args:
            name: of the variable.
            distance: where bounds lie that the file leaves out, in standard deviations of a normal variable.
        """
        if self.choices is not None:
            features = tuple((feature, tuple(numbers)) for feature, numbers in self.quantities.items())
            return Parameter.of_choices(name, self.choices, self.probabilities or (), self.unit, features)
        low, high, mean, sd = self._numbers(distance)
        return Parameter(name, low, high, self.unit, self.distribution, mean, sd, self.step)


_MOST_RECORDS = 1000
"""Most records of a variable."""

_MEASURE = re.compile(r"factor|pga|pgv|sa:(\d+(?:\.\d+)?)")
"""An intensity to which records are scaled (`activefail.intensity`)."""


class SetVariable(Section):
    """A variable whose values are the records of a set of ground motions, without order.

    Attributes:
        set: a set of FEMA P695 (farfield, nearfield, nearfield-pulse or nearfield-no-pulse), or a folder of records
            beside the campaign file.
        unit: unit of accelerations in files that state none: g, m/s2, cm/s2 or mm/s2.
        dt: interval of samples in files that state none [s].
        scaled_to: the variable or fixed quantity to which each record is scaled, with the intensity that it is: factor,
            pga [g], pgv [m/s] or sa:T [g], as in { PGV = "pgv" }. If left out, the records are as they are.
        probabilities: of the records; equal if left out.
        digest: SHA-256 of the records' samples and intervals; other records are refused. activefail writes it to run
            folders.
        records: the events of the records, by their names; activefail writes them to run folders.
    """

    set: str = Field(min_length=1)
    unit: str | None = None
    dt: float | None = Field(None, gt=0.0)
    scaled_to: dict[str, str] | None = Field(None, min_length=1, max_length=1)
    probabilities: list[float] | None = None
    digest: str | None = None
    records: dict[str, str] | None = None

    is_bounded: ClassVar = True
    has_texts: ClassVar = True

    @field_validator("scaled_to")
    @classmethod
    def _names_a_measure(cls, scaled_to: dict[str, str] | None) -> dict[str, str] | None:
        for name, measure in (scaled_to or {}).items():
            match = _MEASURE.fullmatch(measure)
            if not match or (match[1] and not 0.01 <= float(match[1]) <= 100.0):
                raise ValueError(
                    f"{name} must be factor, pga, pgv, or sa:T with a period T from 0.01 to 100 s, got {measure!r}"
                )
        return scaled_to

    @model_validator(mode="after")
    def _is_known(self) -> Self:
        if self.records is not None and self.digest is None:
            raise ValueError("`records` requires `digest`; activefail writes both")
        if self.records is not None and (fault := self.fault):
            raise ValueError(fault)
        return self

    @property
    def choices(self) -> list[Choice]:
        """The names of the records, if they are known."""
        return [*(self.records or {})]

    @property
    def fault(self) -> str:
        """Why the records do not define a variable; empty if they do."""
        fault = choices_fault(self.choices, self.probabilities or (), _MOST_RECORDS)
        return fault.replace("`choices`", "the names of records").replace("choices", "records")

    def parameter(self, name: str, _: float) -> Parameter:
        """The variable of the design space, under a name (see `Variable.parameter`).

        Raises:
            InputError: if the records are not known.
        """
        if self.records is None:
            raise InputError(f"space.{name}.set: cannot be read here; state it in a campaign file.")
        n = len(self.records)
        shares = tuple(self.probabilities or (1.0 / n,) * n)
        groups = tuple(self.records.values())
        return Parameter(name, 0.0, n - 1.0, step=1.0, choices=tuple(self.records), probabilities=shares, groups=groups)


class FixedVariable(Section):
    """A quantity of the simulator that is the same for every design.

    Attributes:
        value: the value, in its unit; in a question one of the choices, if the variable has some.
        unit: unit as text.
    """

    value: Annotated[
        Annotated[float, Field(ge=-LARGEST, le=LARGEST), Tag(NUMBER)] | Annotated[str, Tag(NAME)],
        Discriminator(lambda value: NAME if isinstance(value, str) else NUMBER),
    ]
    unit: str = ""


class BearingSettings(Section):
    """Settings of the double friction pendulum (`activefail.bearing.Model` and `Tolerance`).

    Attributes:
        slider_diameter: D_sl [m], which Table 1 does not contain.
        restitution_coefficient: coefficient of restitution of the contacts, for the mass in the damper.
        restitution: mass in the damper: "pairwise", as published, or "assembly", the mass of the plate
            ([contact](../bearing.md#contact)).
        slider_density: density of the slider [kg/m³].
        friction_velocity: velocity over which Coulomb friction is regularised [m/s].
        loss_of_confinement: whether a slider that no rim of a plate holds any longer counts as failure.
        rim: "rigid", as published; "breaking" at `rim_strength`; "yielding" there, and broken at `rim_deformation`;
            or "none", a flat plate ([rims that yield and break](../bearing.md#rims-that-yield-and-break)).
        rim_strength: largest normal force on a rim, divided by the weight on the bearing; required with a rim that
            breaks or yields.
        rim_deformation: plastic deformation at which a yielding rim breaks [m]; required with one.
        tolerance: relative error per step of the integration.
    """

    slider_diameter: float = Field(0.30, gt=0.0, lt=5.0)
    restitution_coefficient: float = Field(0.65, gt=0.0, le=1.0)
    restitution: Literal["pairwise", "assembly"] = "pairwise"
    slider_density: float = Field(7850.0, gt=0.0)
    friction_velocity: float = Field(1e-3, gt=0.0, le=0.1)
    loss_of_confinement: bool = True
    rim: Literal["rigid", "breaking", "yielding", "none"] = "rigid"
    rim_strength: float | None = Field(None, ge=0.0)
    rim_deformation: float | None = Field(None, gt=0.0)
    tolerance: float = Field(1e-4, ge=1e-12, le=1e-2)

    @model_validator(mode="after")
    def _is_a_model(self) -> Self:
        try:
            self.model()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    def model(self) -> Model:
        """The bearing model."""
        return Model(**self.model_dump(exclude={"tolerance"}))

    def integration(self) -> Tolerance:
        """The tolerance of the integration."""
        return Tolerance(relative=self.tolerance)


_Reference = Annotated[str, Field(pattern=r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*$")]
"""A Python function, "module:function"."""


_SAFE = (
    "safe|safety|safely|ok|okay|pass|passed|passes|passing|survive|survived|survives|survival|surviving|intact|stable|"
    "none|nothing|fine|good|success|successful|sound|healthy|holds|acceptable"
)
_HARM = (
    "fail|fails|failed|failing|failure|failures|collapse|collapses|collapsed|damage|damages|damaged|impact|impacts|"
    "impacted|crack|cracks|cracked|cracking|rupture|ruptured|break|breakage|broken|yield|yielded|yielding|buckling|"
    "buckled|uplift|overturning|overturned|pounding|exceedance|exceeded|harm|harmed|loss|hazard|event"
)
_MEANS_SAFETY = re.compile(f"(?:{_SAFE})|(?:no|not|non|un|without)_?(?:{_HARM})", re.IGNORECASE)


def means_safety(name: str) -> bool:
    """Whether an outcome's name is a word for safety, such as `Safe`, `undamaged` or `no_collapse`."""
    return _MEANS_SAFETY.fullmatch(name.strip("_")) is not None


Lost = Literal["unknown", "failure", "impossible"]
"""What a run without a result means."""

CAUSES = Literal[
    "worker_died", "time_limit", "out_of_memory", "raised", "unusable_answer", "not_finite", "numerical_failure"
]
"""Why a run has no result; `numerical_failure` is what the simulator itself says."""


class OutcomeSettings(Section):
    """What the simulations of a campaign return, whoever makes them.

    Attributes:
        outcomes: two or three names, the least severe first.
        margins: names of the numbers that it returns besides the outcome.
        causes: names of what may decide an outcome, such as a mechanism; an answer or a result may name one. Without
            names, causes of answers are ignored.
        levels: by margin, the value at or below which each outcome but the least severe one occurs; 0 if left out.
        truncated: margins that say no more than their sign at the most severe outcome, because the simulation ends.
        system: failure where `min(...)` or `max(...)` of the margins is at most 0
            ([several limit states](../probability.md#several-limit-states)).
        lost: what a [run without a result](../probability.md#runs-without-a-result) means: either outcome, the most
            severe one, or a design that does not exist. For all causes, or by cause.
        repeatable: whether equal designs have equal results
            ([if not](../probability.md#a-simulator-that-does-not-repeat)). If this is left out, one design is simulated
            twice, and different results end the campaign.
    """

    outcomes: list[str] = Field(["safe", "failure"], min_length=2, max_length=3)
    margins: list[str] = Field([], max_length=100)
    causes: list[str] = Field([], max_length=100)
    levels: dict[str, list[float]] = Field(default_factory=dict)
    truncated: list[str] = Field(default_factory=list)
    system: str | None = None
    lost: Lost | dict[CAUSES, Lost] = "unknown"
    repeatable: bool | None = None

    @field_validator("lost", mode="before")
    @classmethod
    def _is_a_meaning(cls, lost: object) -> object:
        meanings, causes = get_args(Lost), get_args(CAUSES)
        for cause, meaning in (lost if isinstance(lost, dict) else {causes[0]: lost}).items():
            if cause not in causes:
                raise ValueError(f"must name causes among {', '.join(causes)}, got {cause!r}")
            if meaning not in meanings:
                raise ValueError(f"must be one of {', '.join(meanings)}, or a table of these by cause, got {meaning!r}")
        return lost

    def causes_that_mean(self, meaning: Lost) -> tuple[int, ...]:
        """Codes of the causes of lost runs that mean this; those from 0 on are the simulator's own."""
        # A run without a result may name one of the simulator's causes.
        names = dict.fromkeys(range(1 + len(self.causes)), "numerical_failure") | EXECUTION_CAUSES
        if isinstance(self.lost, str):
            return tuple(names) if self.lost == meaning else ()
        by_cause = {str(cause): means for cause, means in self.lost.items()}
        return tuple(code for code, name in names.items() if by_cause.get(name, "unknown") == meaning)

    @field_validator("outcomes", "margins", "causes")
    @classmethod
    def _are_names(cls, names: list[str], info: ValidationInfo) -> list[str]:
        reserved = {"numerical_failure", *(EXECUTION_CAUSES.values() if info.field_name == "causes" else ())}
        for name in names:
            if not name.isidentifier():
                raise ValueError(f"must be identifiers, got {name!r}")
            if names.count(name) > 1:
                raise ValueError(f"must differ from each other, got {name!r} twice")
            if name in reserved:
                raise ValueError(f"{name!r} is reserved for simulations without an outcome")
        return names

    @field_validator("outcomes")
    @classmethod
    def _end_with_the_most_severe(cls, names: list[str]) -> list[str]:
        if not means_safety(names[-1]):
            return names
        raise ValueError(f"the least severe outcome must come first, but {names[-1]!r} is the last of {names}")

    @field_validator("levels")
    @classmethod
    def _descend(cls, levels: dict[str, list[float]], info: ValidationInfo) -> dict[str, list[float]]:
        outcomes = info.data.get("outcomes", [])[1:]
        for name, values in levels.items():
            _check_margin(name, info)
            if outcomes and len(values) != len(outcomes):
                raise ValueError(f"{name}: must have a level for each of {', '.join(outcomes)}, got {values}")
            if not all(abs(value) <= LARGEST for value in values):  # false for NaN too
                raise ValueError(f"{name}: must be numbers of at most {LARGEST:g} in size, got {values}")
            if any(later >= earlier for earlier, later in itertools.pairwise(values)):
                raise ValueError(f"{name}: must decrease from outcome to outcome, got {values}")
        return levels

    @field_validator("truncated")
    @classmethod
    def _are_margins(cls, names: list[str], info: ValidationInfo) -> list[str]:
        for name in names:
            _check_margin(name, info)
        return names

    @field_validator("system")
    @classmethod
    def _is_a_system(cls, text: str | None, info: ValidationInfo) -> str | None:
        if text is not None and (margins := info.data.get("margins")) is not None:
            parse_system(text, margins)
            if len(info.data.get("outcomes", "ab")) > 2:
                raise ValueError("requires two outcomes: a system fails or does not")
            for other in ("levels", "truncated"):
                if info.data.get(other):
                    raise ValueError(f"cannot be combined with {other}: a mode fails where its margin is at most 0")
        return text

    @field_validator("repeatable")
    @classmethod
    def _repeats_as_a_system(cls, repeatable: bool | None, info: ValidationInfo) -> bool | None:
        if repeatable is False and info.data.get("system"):
            raise ValueError(
                "must be true with simulator.system: the noise of several margins is not learned. Leave system out; "
                "name one margin, such as the least of them, or learn from outcomes"
            )
        return repeatable

    @property
    def modes(self) -> System | None:
        """The system of the margins; None if each stands for itself."""
        return None if self.system is None else parse_system(self.system, self.margins)

    @property
    def levels_of_number(self) -> tuple[float, ...]:
        """The levels of the one margin, if a number can be the whole answer; empty otherwise."""
        if len(self.margins) != 1:
            return ()
        default = [0.0] if len(self.outcomes) == 2 else []
        return tuple(self.levels.get(self.margins[0], default))


def _check_margin(name: str, info: ValidationInfo) -> None:
    margins = info.data.get("margins")
    if margins is not None and name not in margins:
        raise ValueError(f"must name one of simulator.margins ({', '.join(margins) or 'none'}), got {name!r}")


class CustomSimulatorSettings(OutcomeSettings):
    """Settings of a custom simulator that activefail calls.

    Attributes:
        time_limit: limit of the time of one simulation [s]; none if it is left out.
    """

    time_limit: float | None = Field(None, gt=0.0, le=1e9)


class ElsewhereSettings(OutcomeSettings):
    """Simulations that are made elsewhere: `ask` hands their designs out, `tell` records their results.

    Attributes:
        elsewhere: always true.
    """

    elsewhere: Literal[True]


class PythonSimulatorSettings(CustomSimulatorSettings):
    """A simulator that is a Python function, found like that of custom features (`activefail.simulators.function`).

    Attributes:
        python: the function, "module:function".
        renew: simulations after which a worker process is replaced; never if it is left out.
    """

    python: _Reference
    renew: int | None = Field(None, ge=1, le=1_000_000)


_Paths = Annotated[list[str], BeforeValidator(lambda value: [value] if isinstance(value, str) else value)]
"""One path or a list of them."""


class CommandSimulatorSettings(CustomSimulatorSettings):
    """A simulator that is a program (`activefail.simulators.command`).

    Attributes:
        command: command line, with the variables in braces.
        template: input files with variables in braces, in the folder of the campaign file. Each is written to the run's
            folder with the values, under its name without `.in`.
        copy: files and folders, in the folder of the campaign file, that are copied to the run's folder.
        pattern: regular expression with one group. Its last match in `output` is the answer, the only margin.
        output: file in the run's folder that the pattern is searched in.
        cores: cores of one simulation; the program's OMP_NUM_THREADS, and as many fewer simulations at a time.
        retries: how often a failed simulation is repeated.
        keep: whether the folders of successful simulations are kept.
        largest_file: largest file that the program may write [bytes].
    """

    command: str = Field(min_length=1)
    template: _Paths = Field([])
    copied: _Paths = Field([], alias="copy")
    pattern: str | None = None
    output: str = "stdout.txt"
    cores: int = Field(1, ge=1, le=10_000)
    retries: int = Field(0, ge=0, le=100)
    keep: bool = True
    largest_file: int = Field(10_000_000_000, ge=1_000_000, le=10**15)

    @field_validator("pattern")
    @classmethod
    def _has_one_group(cls, pattern: str | None) -> str | None:
        try:
            groups = 1 if pattern is None else re.compile(pattern).groups
        except re.error as error:
            raise ValueError(f"must be a regular expression, but {error}, got {pattern!r}") from None
        if groups != 1:
            raise ValueError(f"must have one group in brackets, for the number, got {pattern!r}")
        return pattern

    @model_validator(mode="after")
    def _answers_by_number(self) -> Self:
        if self.pattern is not None and not self.levels_of_number:
            raise ValueError("pattern: requires one margin, and two outcomes or stated levels")
        return self


def usual_initial(usual: int, budget: object) -> int:
    """Size of an initial design that the file leaves out: the usual one, but half of a budget below it."""
    return max(2, budget // 2) if isinstance(budget, int) and 2 <= budget < usual else usual


class Sampling(Section):
    """Numbers of simulations.

    Attributes:
        initial: size of the initial design, a Latin hypercube. With `stop.probability` and a custom simulator the
            default is twice the number of variables, at least 12. Of a budget below the default it is half.
        budget: all simulations.
        batch: designs in a batch, which use as many cores; in an asynchronous campaign, in flight at a time. With
            `stop.probability` and a custom simulator 1 by default.
        asynchronous: whether the campaign learns from each result as soon as it arrives.
        reach: probability outside the bounds of variables whose bounds the file leaves out. No design is proposed
            there.
    """

    initial: int = Field(250, ge=2, le=1_000_000)
    budget: int = Field(500, ge=2, le=1_000_000)
    batch: int = Field(10, ge=1, le=500)
    asynchronous: bool = False
    reach: float = Field(1e-8, ge=1e-12, le=0.1)

    @model_validator(mode="before")
    @classmethod
    def _with_half_of_a_small_budget(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        return {"initial": usual_initial(cls.model_fields["initial"].default, values.get("budget"))} | values

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.budget < self.initial:
            raise ValueError(
                f"`initial <= budget` must hold, got initial = {self.initial} and budget = {self.budget}; change "
                "`initial` in the file, or leave it out"
            )
        if self.asynchronous and 2 * self.batch > self.initial:
            raise ValueError(
                f"`initial` must be at least twice `batch` if asynchronous, got {self.initial} and {self.batch}; set "
                "`initial` or `batch`"
            )
        return self


class PythonFeaturesSettings(Section):
    """Custom features: a Python function.

    Attributes:
        python: the function; activefail looks for its module in the folder of the campaign file, then on Python's path.
        variables: whether the variables precede the function's columns.
    """

    python: _Reference
    variables: bool = True


class PythonSettings(Section):
    """Custom code of the classifier or the acquisition: a function or class.

    Attributes:
        python: the function or class, found like custom features.
    """

    python: _Reference

    def __str__(self) -> str:
        return self.python


class ExpressionFeaturesSettings(Section):
    """Custom features: arithmetic expressions of the variables.

    Attributes:
        expressions: expressions by feature name (`activefail.expressions`).
        variables: whether the variables precede the expressions' columns.
    """

    expressions: dict[str, str] = Field(min_length=1)
    variables: bool = True


class ErrorStop(Section):
    """The stop rule: a campaign ends once its error is verified to be at most `error`, with `confidence`.

    Every `every` batches, verification takes `simulations` fresh designs outside the budget, once the classifier itself
    expects no larger error.

    Attributes:
        error: share of the design space that the classifier may get wrong.
        confidence: confidence that the error is at most `error`, over all looks together.
        simulations: fresh simulations for each look, outside the budget.
        every: batches between two looks.
    """

    error: float = Field(gt=0.0, lt=0.5)
    confidence: float = Field(0.9, ge=0.5, lt=1.0)
    simulations: int = Field(400, ge=10, le=10_000)
    every: int = Field(5, ge=1, le=1000)


class ProbabilityStop(Section):
    """The stop rule: a campaign ends once it knows the probability of an outcome (`activefail.loop.probability_rule`).

    Attributes:
        probability: the outcome; the probability is that of it or a more severe one.
        cov: the coefficient of variation that the probability may have.
    """

    probability: str
    cov: float = Field(0.1, ge=0.01, le=1.0)


KINDS: dict[str, dict[str, type[Section]]] = {
    "simulator": {
        "python": PythonSimulatorSettings,
        "command": CommandSimulatorSettings,
        "elsewhere": ElsewhereSettings,
    },
    "features": {"python": PythonFeaturesSettings, "expressions": ExpressionFeaturesSettings},
    "stop": {"error": ErrorStop, "probability": ProbabilityStop},
    "kernel": {"python": PythonSettings},
    "criterion": {"python": PythonSettings},
}
"""Alternative tables of a setting, by the key that only they have."""


def _kind_of_variable(entry: Any) -> str:
    for key, section in VARIABLES.items():
        if isinstance(entry, section) or (isinstance(entry, dict) and key in entry):
            return f"{WITH}{key}"
    return RANGE


def by_key(sections: Mapping[str, type[Section]], has_names: bool = True) -> Discriminator:
    """Discriminate a name, if there are names, from tables, and the tables by the key that only one of them has."""

    def kind(value: Any) -> str:
        for key, section in sections.items():
            if isinstance(value, section) or (isinstance(value, dict) and key in value):
                return f"{WITH}{key}"
        return "" if isinstance(value, dict) or not has_names else NAME

    keys = " or ".join(f"{WITH}`{key}`" for key in sections)
    return Discriminator(kind, "no_such_table", f"must be {'a name, ' if has_names else ''}{keys}")


StopRule = Annotated[
    Annotated[ErrorStop, Tag(f"{WITH}error")] | Annotated[ProbabilityStop, Tag(f"{WITH}probability")],
    by_key(KINDS["stop"], has_names=False),
]
"""A stop rule; `activefail.loop.stop_rule` says whether it is met."""


class ClassifierSettings(Section):
    """Features of the classifier, the smoothness of its boundaries, and what these are learned from.

    Attributes:
        features: what the classifier sees of a design; "design" by default with a custom simulator, "decorrelated" if
            variables are strongly correlated.
        kernel: covariance of the latents: squared exponential or Matérn-5/2, or a function of the number of features
            that returns a GPyTorch kernel.
        likelihood: a GPyTorch likelihood of labels 0 and 1; the probit likelihood by default.
        model: a function of features and labels that returns a BoTorch model, in place of the variational classifier.
        learns: "outcomes", the name of a margin, "system" for that of all margins, or "auto": evidence decides for each
            boundary. With a custom kernel, likelihood or model, boundaries are learned from outcomes.
    """

    features: Annotated[
        Annotated[FeatureSet, Tag(NAME)]
        | Annotated[PythonFeaturesSettings, Tag(f"{WITH}python")]
        | Annotated[ExpressionFeaturesSettings, Tag(f"{WITH}expressions")],
        by_key(KINDS["features"]),
    ] = "paper"
    kernel: Annotated[
        Annotated[Kernel, Tag(NAME)] | Annotated[PythonSettings, Tag(f"{WITH}python")], by_key(KINDS["kernel"])
    ] = "rbf"
    likelihood: PythonSettings | None = None
    model: PythonSettings | None = None
    learns: str = "auto"

    @model_validator(mode="after")
    def _combine(self) -> Self:
        if self.model is not None and (self.likelihood is not None or not isinstance(self.kernel, str)):
            raise ValueError("model: cannot be combined with a custom `kernel` or `likelihood`")
        if self.is_custom and self.learns not in ("auto", "outcomes"):
            raise ValueError(
                f"learns: must be 'auto' or 'outcomes' with a custom kernel, likelihood or model, got {self.learns!r}"
            )
        return self

    @property
    def name(self) -> str:
        """The kernel, or the custom model."""
        return str(self.model or self.kernel)

    @property
    def is_custom(self) -> bool:
        """Whether the latents are custom code."""
        return not isinstance(self.kernel, str) or self.likelihood is not None or self.model is not None


class AcquisitionSettings(Section):
    """How active designs are chosen.

    Attributes:
        criterion: what ranks the candidates: a name, or a function of a BoTorch model that returns an acquisition
            function over scaled features. With a custom simulator the default is "eavc" with `stop.probability`, and
            "bald" with noise.
        boundary: outcome of the target boundary, which is that of this outcome or a worse one, or weights by outcome.
            With a custom simulator the most severe outcome by default.
        exploration: share of the proposed designs that are drawn from the whole space instead.
    """

    criterion: Annotated[
        Annotated[Criterion, Tag(NAME)] | Annotated[PythonSettings, Tag(f"{WITH}python")], by_key(KINDS["criterion"])
    ] = "joint_entropy"
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
                    raise ValueError(f"the weight of {name!r} must be a positive finite number, got {shown(weight)}")
        elif not isinstance(boundary, str):
            raise ValueError(f"must be an outcome, or a table of outcomes and weights, got {shown(boundary)}")
        return boundary

    @property
    def boundaries(self) -> dict[str, float]:
        """The share of active designs for each target boundary, by outcome; the shares sum to 1."""
        weights = {self.boundary: 1.0} if isinstance(self.boundary, str) else self.boundary
        # Divide by the largest first: the sum of huge weights would overflow.
        largest = max(weights.values())
        scaled = {name: weight / largest for name, weight in weights.items()}
        return {name: weight / sum(scaled.values()) for name, weight in scaled.items()}

    @property
    def main_boundary(self) -> str:
        """The outcome with the largest share, the first if equal; a campaign's error refers to its boundary."""
        return max(self.boundaries, key=self.boundaries.__getitem__)


class Validation(Section):
    """Designs outside the budget on which a campaign measures its accuracy while it runs.

    Attributes:
        size: number of designs.
    """

    size: int = Field(0, ge=0, le=100_000)


class Limits(Section):
    """Limits above which a campaign stops with an error.

    Attributes:
        numerical_failures: share of numerical failures among the simulations, from 20 simulations on.
    """

    numerical_failures: float = Field(0.05, ge=0.0, le=1.0)


VARIABLES: dict[str, type[Section]] = {"value": FixedVariable, "set": SetVariable}
"""Tables of `space` that are no distributions, by the key that only they have."""

AnyVariable = Annotated[
    Annotated[Variable, Tag(RANGE)]
    | Annotated[SetVariable, Tag(f"{WITH}set")]
    | Annotated[FixedVariable, Tag(f"{WITH}value")],
    Discriminator(_kind_of_variable),
]


class QuestionSettings(Section):
    """A question: other distributions of the variables, in a campaign file or a file of its own.

    Attributes:
        description: what is asked, in words.
        reach: as `sampling.reach`, for variables whose bounds the file leaves out.
        space: distributions and fixed values of variables; a variable that is left out keeps the campaign's.
        correlation: as in a campaign; the campaign's among the uncertain variables if it is left out.
    """

    description: str = Field("", max_length=200)
    reach: float = Field(1e-8, ge=1e-12, le=0.1)
    space: dict[str, AnyVariable] = Field(min_length=1)
    correlation: list[Annotated[tuple[str, str, float], Field(strict=False)]] | None = None

    @model_validator(mode="after")
    def _has_known_pairs(self) -> Self:
        for first, second, _ in self.correlation or ():
            for name in (first, second):
                if isinstance(self.space.get(name), FixedVariable):
                    raise ValueError(f"correlation: {name!r} has a fixed value, so it cannot be correlated")
        return self
