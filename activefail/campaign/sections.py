"""Sections of a campaign's settings, such as `[stop]`: their keys, what these mean, and which exclude each other."""

import itertools
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from activefail.campaign.section import NAME, WITH, Section, by_key, name_or
from activefail.campaign.variables import AnyVariable, FixedVariable
from activefail.learning.names import FEATURE_SETS, Criterion, Kernel
from activefail.plugins import brought
from activefail.simulators.interface import EXECUTION_CAUSES, ExecutionCause
from activefail.space.expressions import Expression, outputs_of, parse_expression
from activefail.space.parameter import LARGEST
from activefail.space.systems import System, parse_system

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

LostCause = ExecutionCause | Literal["numerical_failure"]
"""Why a run has no result; `numerical_failure` is what the simulator itself says."""


class OutcomeSettings(Section):
    """What the simulations of a campaign return, whoever makes them.

    Attributes:
        outcomes: two or three names, the least severe first.
        margins: names of the numbers that it returns besides the outcome; or, by name, [expressions of its
            outputs](../guide.md#margins-of-outputs), such as a drift.
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
    margins: Annotated[
        Annotated[list[str], Field(max_length=100), Tag(f"{WITH}names")]
        | Annotated[dict[str, str], Field(max_length=100), Tag(f"{WITH}expressions")],
        Discriminator(lambda value: f"{WITH}expressions" if isinstance(value, dict) else f"{WITH}names"),
    ] = Field([])
    causes: list[str] = Field([], max_length=100)
    levels: dict[str, list[float]] = Field(default_factory=dict)
    truncated: list[str] = Field(default_factory=list)
    system: str | None = None
    lost: Annotated[
        Annotated[Lost, Tag(NAME)] | Annotated[dict[LostCause, Lost], Tag(f"{WITH}meanings")],
        Discriminator(name_or(f"{WITH}meanings")),
    ] = "unknown"
    repeatable: bool | None = None

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
    def _are_names(cls, names: list[str] | dict[str, str], info: ValidationInfo) -> list[str] | dict[str, str]:
        reserved = {"numerical_failure", *(EXECUTION_CAUSES.values() if info.field_name == "causes" else ())}
        for name in names:
            if not name.isidentifier():
                raise ValueError(f"must be identifiers, got {name!r}")
            if list(names).count(name) > 1:
                raise ValueError(f"must differ from each other, got {name!r} twice")
            if name in reserved:
                raise ValueError(f"{name!r} is reserved for simulations without an outcome")
        return names

    @field_validator("margins")
    @classmethod
    def _are_expressions(cls, margins: list[str] | dict[str, str]) -> list[str] | dict[str, str]:
        expressions: dict[str, Expression] = {}
        for name, text in margins.items() if isinstance(margins, dict) else ():
            try:
                expressions[name] = parse_expression(text, None)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
            if not expressions[name].names:
                raise ValueError(f"{name}: must contain an output of the simulator, got {text!r}")
        for name, one in expressions.items():
            if name in outputs_of(expressions) and one.text.strip() != name:
                raise ValueError(f"{name}: must have another name than the output {name!r}, got {one.text!r}")
        return margins

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
            if len(outcomes) == 1 and isinstance(margins := info.data.get("margins"), dict):
                raise ValueError(
                    f"{name}: cannot be combined with its expression {margins[name]!r}, which is at most 0 at "
                    f"{outcomes[0]}; got {values}"
                )
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
            parse_system(text, list(margins))
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
        return None if self.system is None else parse_system(self.system, list(self.margins))

    @property
    def expressions(self) -> dict[str, Expression]:
        """The expressions of the simulator's outputs, by margin; none if it returns the margins."""
        given = self.margins if isinstance(self.margins, dict) else {}
        return {name: parse_expression(text, None) for name, text in given.items()}

    @property
    def columns(self) -> tuple[str, ...]:
        """What is recorded of a simulation: the margins, and the outputs in their expressions that are none."""
        return tuple(dict.fromkeys((*self.margins, *outputs_of(self.expressions))))

    @property
    def levels_of_number(self) -> tuple[float, ...]:
        """The levels of the one margin, if a number can be the whole answer; empty otherwise."""
        if len(self.margins) != 1:
            return ()
        default = [0.0] if len(self.outcomes) == 2 else []
        return tuple(self.levels.get(next(iter(self.margins)), default))


def margins_in(simulator: str | OutcomeSettings, columns: tuple[str, ...]) -> tuple[str, ...]:
    """The margins among the columns of a record, without the outputs in their expressions."""
    if isinstance(simulator, str) or isinstance(simulator.margins, list):
        return columns
    return tuple(simulator.margins)


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
        pattern: regular expression with one group. Its last match in `output` is the answer, the only margin or output;
            or, by output, one for each.
        output: file in the run's folder that the pattern is searched in.
        cores: cores of one simulation; the program's OMP_NUM_THREADS, and as many fewer simulations at a time.
        retries: how often a failed simulation is repeated.
        keep: whether the folders of successful simulations are kept.
        largest_file: largest file that the program may write [bytes].
    """

    command: str = Field(min_length=1)
    template: _Paths = Field([])
    copied: _Paths = Field([], alias="copy")
    pattern: (
        Annotated[
            Annotated[str, Tag(NAME)] | Annotated[dict[str, str], Tag(f"{WITH}patterns")],
            Discriminator(name_or(f"{WITH}patterns")),
        ]
        | None
    ) = None
    output: str = "stdout.txt"
    cores: int = Field(1, ge=1, le=10_000)
    retries: int = Field(0, ge=0, le=100)
    keep: bool = True
    largest_file: int = Field(10_000_000_000, ge=1_000_000, le=10**15)

    @field_validator("pattern")
    @classmethod
    def _has_one_group(cls, pattern: str | dict[str, str] | None) -> str | dict[str, str] | None:
        for one in pattern.values() if isinstance(pattern, dict) else [pattern] if pattern is not None else []:
            try:
                groups = re.compile(one).groups
            except re.error as error:
                raise ValueError(f"must be a regular expression, but {error}, got {one!r}") from None
            if groups != 1:
                raise ValueError(f"must have one group in brackets, for the number, got {one!r}")
        return pattern

    @model_validator(mode="after")
    def _answers_by_number(self) -> Self:
        outputs = outputs_of(self.expressions)
        if self.pattern is not None and not (self.levels_of_number or (outputs and self.system)):
            raise ValueError(
                "pattern: requires one margin, and two outcomes or stated levels; or expressions and a system"
            )
        if isinstance(self.pattern, dict) and {*self.pattern} != {*outputs}:
            known = ", ".join(outputs) or "none"
            raise ValueError(
                f"pattern: must name the outputs in simulator.margins ({known}), got {', '.join(self.pattern)}"
            )
        if isinstance(self.pattern, str) and len(outputs) > 1:
            raise ValueError(f"pattern: must be a table with a pattern for each of {', '.join(outputs)}")
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
        expressions: expressions by feature name (`activefail.space.expressions`).
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


StopRule = Annotated[
    Annotated[ErrorStop, Tag(f"{WITH}error")] | Annotated[ProbabilityStop, Tag(f"{WITH}probability")],
    by_key(KINDS["stop"], otherwise=""),
]
"""A stop rule; `activefail.loop.stop_rule` says whether it is met."""


_FEATURES = brought("defaults").get("features", "design")

if TYPE_CHECKING:
    _FeatureSet = str
else:
    # The default, the core's, those of plug-ins.
    _FeatureSet = Literal[tuple(dict.fromkeys([_FEATURES, *FEATURE_SETS, *brought("features")]))]


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
        Annotated[_FeatureSet, Tag(NAME)]
        | Annotated[PythonFeaturesSettings, Tag(f"{WITH}python")]
        | Annotated[ExpressionFeaturesSettings, Tag(f"{WITH}expressions")],
        by_key(KINDS["features"]),
    ] = _FEATURES
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
    boundary: Annotated[
        Annotated[str, Tag(NAME)]
        | Annotated[dict[str, Annotated[float, Field(gt=0.0)]], Field(min_length=1), Tag(f"{WITH}weights")],
        Discriminator(name_or(f"{WITH}weights")),
    ] = "failure"
    exploration: float = Field(0.0, ge=0.0, le=1.0)

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
        numerical_failures: share of numerical failures among the simulations, from 20 simulations on. Those among
            others that failed do not count, up to half of all.
    """

    numerical_failures: float = Field(0.05, ge=0.0, le=1.0)


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
