"""Build a campaign from its settings: design space, simulator and features."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign import sections
from activefail.campaign.question import Question, question_of
from activefail.campaign.settings import CampaignSettings
from activefail.campaign.variables import SetVariable
from activefail.errors import InputError, description_of, place_of
from activefail.learning.features import CustomFeatures, ExpressionFeatures, FeatureMap, feature_map
from activefail.plugins import brought
from activefail.record.batch import Schema
from activefail.record.layout import SIMULATIONS
from activefail.simulators.code_folder import sha256
from activefail.simulators.command import CommandSimulator
from activefail.simulators.elsewhere import ElsewhereSimulator
from activefail.simulators.function import PythonSimulator
from activefail.simulators.interface import Results, Simulator
from activefail.simulators.user_code import (
    COMMAND_KEY,
    CRITERION_KEY,
    FEATURES_KEY,
    KERNEL_KEY,
    LEARNER_KEYS,
    LIKELIHOOD_KEY,
    MODEL_KEY,
    SIMULATOR_KEY,
    load_function,
)
from activefail.space.space import Array, DesignSpace
from activefail.space.systems import System

_COLUMNS = ("id", "iteration", "origin", "outcome", "cause", "seconds", "folder")
"""Columns of activefail's tables besides variables, fixed quantities and margins."""

_COUNTED = ("numerical_failure", "in_flight")
"""What `Run.counts` counts besides outcomes."""


def predicted_columns(outcomes: Sequence[str]) -> tuple[str, ...]:
    """The columns that a prediction adds to a table of designs."""
    return ("likeliest_outcome", *(f"p_{name}" for name in outcomes), "latent_mean", "latent_sd")


def check_enough_designs(space: DesignSpace, budget: int) -> None:
    """Check that a space has as many designs as a budget.

    Raises:
        InputError: if all variables have steps and there are fewer.
    """
    if budget > space.design_count:
        raise InputError(
            f"sampling.budget: must be at most {space.design_count}, all designs of the space, got {budget}."
        )


@dataclass(frozen=True)
class Campaign:
    """The components of a campaign. The loop uses them only through their interfaces.

    Attributes:
        question: the distribution under which probabilities are asked for.
        sources: digests of the source files of custom functions, or of a program's files, by settings key.
        code: folder of the user's code; None if it must not be run.
        learner: custom code of the classifier and the acquisition, by settings key.
    """

    settings: CampaignSettings
    space: DesignSpace
    simulator: Simulator
    features: FeatureMap
    question: Question
    sources: dict[str, str] = field(default_factory=dict)
    code: Path | None = None
    learner: dict[str, Callable[..., Any]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        settings: CampaignSettings,
        code: Path | None = None,
        run: Path | None = None,
        *,
        simulator: Simulator | None = None,
        custom_features: bool = True,
        check_features: bool = True,
    ) -> "Campaign":
        """Build the campaign that the settings describe.

        Args:
            settings: settings of the campaign.
            code: folder of the user's code, which is executed. If None, no user code runs: custom simulations and
                features that are a Python function are unavailable.
            run: run folder; simulation programs work in it, and code in it is never executed. The current folder if
                None.
            simulator: replaces the simulator in the settings.
            custom_features: whether features that are a Python function are needed; if not, the variables replace them.
            check_features: whether to check now that features can be scaled; at their first use otherwise.

        Raises:
            InputError: if simulator, design space, features and boundary are inconsistent.
        """
        # Workers and simulation programs have other current folders.
        code, run = (None if folder is None else folder.absolute() for folder in (code, run))
        may_read = run is None or code is not None
        settings = settings.completed(code or Path.cwd(), _read_set if may_read else None)
        space = _with_sets(settings.design_space(), settings, may_read)
        sources: dict[str, str] = {}
        if simulator is None:
            for name, one in settings.named.items():
                if one not in settings.used:
                    one.check_unused(name)
            simulator, sources = _simulator(settings, space, code, run)
            _check_names(space, simulator, sections.margins_in(settings.simulator, simulator.margins))
        for boundary in settings.acquisition.boundaries:
            if boundary not in simulator.outcomes[1:]:
                raise InputError(
                    f"acquisition.boundary: must be one of {', '.join(simulator.outcomes[1:])}, got {boundary!r}."
                )
        if settings.is_repeatable:
            check_enough_designs(space, settings.sampling.budget)
        _check_learning(settings, simulator)
        features, source = _features(settings, code, run, custom_features)
        model = next((one.model() for one in settings.used if features in one.features), None)
        mapped = feature_map(features, space, model, check_features)
        learner = {}
        for key, reference in _learner_references(settings).items() if custom_features else ():
            learner[key], sources[key] = load_function(reference, code, key, run)
        mapped = replace(mapped, harmless=getattr(simulator, "harmless", None))
        asked = question_of(settings.question, space)
        return cls(settings, space, simulator, mapped, asked, sources | source, code, learner)

    @property
    def time_limit(self) -> float | None:
        """Time limit of one simulation [s]; None for one that a plug-in brings, and if no limit is set."""
        simulator = self.settings.simulator
        return simulator.time_limit if isinstance(simulator, sections.CustomSimulatorSettings) else None

    @property
    def functions(self) -> dict[str, str]:
        """The custom functions in the settings, as "module:function", by settings key."""
        simulator, features = self.settings.simulator, self.settings.classifier.features
        functions = {}
        if isinstance(simulator, sections.PythonSimulatorSettings):
            functions[SIMULATOR_KEY] = simulator.python
        if isinstance(features, sections.PythonFeaturesSettings):
            functions[FEATURES_KEY] = features.python
        return functions | _learner_references(self.settings)

    @property
    def learner_code(self) -> str:
        """SHA-256 of the digests of the custom code that decides what is learned; "" without such code."""
        used = [f"{key} {self.sources[key]}\n" for key in (FEATURES_KEY, *LEARNER_KEYS) if key in self.sources]
        return sha256("".join(used).encode()) if used else ""

    @contextmanager
    def custom_code(self, *keys: str) -> Iterator[None]:
        """The context in which custom code of the classifier, or of the acquisition, runs.

        Args:
            keys: of the settings that may name this code.

        Raises:
            InputError: if any of them does, in place of an error: its keys, and the line of the user's code.
        """
        try:
            with redirect_stdout(sys.stderr) if self.learner else nullcontext():
                yield
        except Exception as error:
            custom = [key for key in keys if key in self.learner]
            if not custom or isinstance(error, InputError):
                raise
            raise InputError(f"{', '.join(custom)}: raised {description_of(error)}{place_of(error)}.") from error

    @property
    def decisive(self) -> tuple[str, ...]:
        """The entries of the provenance that decide the result of a simulation; none for one elsewhere.

        Features and libraries do not: they change proposals, or the last bits of a result.
        """
        match self.settings.simulator:
            case sections.PythonSimulatorSettings():
                return (SIMULATOR_KEY,)
            case sections.CommandSimulatorSettings():
                return (COMMAND_KEY,)
            case sections.ElsewhereSettings():
                return ()
            case name:
                return tuple(self.settings.named[name].sources())

    @property
    def is_elsewhere(self) -> bool:
        """Whether simulations are done elsewhere, so that activefail cannot run any."""
        return self.settings.is_elsewhere

    def check_simulates(self) -> None:
        """Check that activefail can run the campaign's simulations.

        Raises:
            InputError: if they are done elsewhere, or are custom code that may not be run.
        """
        if isinstance(self.simulator, PythonSimulator | CommandSimulator):
            self.simulator.check_permitted()
        if self.is_elsewhere:
            refused = ", ".join(self.settings.refused)
            raise InputError(
                "simulator.elsewhere: activefail cannot run these simulations. `activefail create` creates the run "
                "folder, `activefail ask` hands designs out, and `activefail tell` records their results. Commands "
                f"with fresh simulations ({refused}) require a simulator that activefail can call."
            )

    @property
    def schema(self) -> Schema:
        """The meaning of the record's columns."""
        return Schema(self.space.names, self.simulator.outcomes, self.simulator.causes, self.simulator.margins)

    def margins_at(self, severity: int, outcome: NDArray[np.int8], margins: Array) -> Array:
        """The margins of simulations, (n, k), in relation to a boundary: at most 0 beyond it.

        A margin whose simulations end at the most severe outcome, as the settings say, is undefined (NaN) there.

        Args:
            severity: number of the least severe outcome beyond the boundary.
            outcome: (n,) of the simulations.
            margins: (n, k) of the simulations, as recorded.
        """
        custom = self.settings.simulator
        if isinstance(custom, str):
            return margins
        names = self.margins
        related = np.asarray(margins[:, : len(names)] - self.levels[severity - 1])
        ended = outcome == len(self.simulator.outcomes) - 1
        for name in custom.truncated:
            related[ended, names.index(name)] = np.nan
        return related

    @cached_property
    def system(self) -> System | None:
        """The system that the margins make; None if each stands for itself."""
        custom = self.settings.simulator
        return None if isinstance(custom, str) else custom.modes

    @property
    def margins(self) -> tuple[str, ...]:
        """The margins: the first columns of `simulator.margins`, before the outputs in their expressions."""
        return sections.margins_in(self.settings.simulator, self.simulator.margins)

    @property
    def learnable(self) -> tuple[str, ...]:
        """What a boundary can be learned from, as `margin_choice.Choice` counts: each margin, or the system."""
        return self.margins if self.system is None else (self.system.text,)

    @property
    def levels(self) -> Array:
        """The value at or below which each margin is beyond each boundary, (boundaries, k)."""
        boundaries, names = range(len(self.simulator.outcomes) - 1), self.margins
        custom = self.settings.simulator
        known = {} if isinstance(custom, str) else custom.levels
        return np.array([[known[name][i] if name in known else 0.0 for name in names] for i in boundaries])

    def contradicts(self, results: Results) -> NDArray[np.bool_]:
        """Which simulations, (n,), have an outcome on the side of a boundary on which none of their margins is."""
        simulator, custom = self.simulator, self.settings.simulator
        found: NDArray[np.bool_] = np.zeros(len(results), dtype=np.bool_)
        if isinstance(custom, str):
            return found
        for severity in range(1, len(simulator.outcomes)):
            # With more than two outcomes, only stated levels tell a side.
            stated = [name in custom.levels or len(simulator.outcomes) == 2 for name in self.margins]
            margins = self.margins_at(severity, results.outcome, results.margins)[:, stated]
            margins = margins if self.system is None else self.system(margins)[:, None]
            is_beyond = results.outcome[:, None] >= severity
            found |= any(stated) & ((margins <= 0.0) != is_beyond).all(axis=1) & ~np.isnan(margins).any(axis=1)
        found &= results.outcome >= 0
        return found

    @property
    def severity(self) -> int:
        """The least severe outcome beyond the (main) target boundary."""
        return self.simulator.outcomes.index(self.settings.acquisition.main_boundary)


def _read_set(variable: str, place: str, unit: str | None, dt: float | None) -> Any:
    """What a plug-in reads for a variable with a set (`variables.ReadSet`).

    Raises:
        InputError: if none does, or the set cannot be read.
    """
    return _motions(variable).read(variable, place, unit, dt)


def _motions(variable: str) -> Any:
    """The plug-in's class of the records behind a variable (`Payload`), with a method `read`."""
    sets = brought("sets")
    if "motions" not in sets:
        raise InputError(f"space.{variable}.set: requires a plug-in that reads sets of ground motions.")
    return sets["motions"]


def _with_sets(space: DesignSpace, settings: CampaignSettings, may_read: bool) -> DesignSpace:
    """The design space with the motions of its sets; these are read when they are needed."""
    parameters = []
    for one in space.parameters:
        if isinstance(entry := settings.space[one.name], SetVariable):
            level, measure = next(iter((entry.scaled_to or {"": "factor"}).items()))
            of_set = one.name, entry.set, entry.unit, entry.dt, entry.digest or "", level, measure, may_read
            one = replace(one, payload=_motions(one.name)(*of_set))
        parameters.append(one)
    return replace(space, parameters=tuple(parameters))


def _simulator(
    settings: CampaignSettings, space: DesignSpace, code: Path | None, run: Path | None
) -> tuple[Simulator, dict[str, str]]:
    """The simulator in the settings, and the digest of its source, or of its program's files."""
    spec = settings.simulator
    if isinstance(spec, str):
        return settings.named[spec].simulator(space), {}
    returns = tuple(spec.outcomes), spec.columns
    lost: dict[str, Any] = {
        "failing": spec.causes_that_mean("failure"),
        "impossible": spec.causes_that_mean("impossible"),
    }
    lost["causes"] = ("", *spec.causes)
    decides = lost | {"levels": spec.levels_of_number, "system": spec.modes, "truncated": tuple(spec.truncated)}
    decides["expressions"] = spec.expressions
    match spec:
        case sections.PythonSimulatorSettings():
            function = PythonSimulator(space, spec.python, code, *returns, folder=run, renew=spec.renew, **decides)
            if code is None:
                return function, {}
            source = function.load()
            return replace(function, source=source), {SIMULATOR_KEY: source}
        case sections.CommandSimulatorSettings():
            folder = (run or Path.cwd()) / SIMULATIONS
            decides |= {"retries": spec.retries, "keep": spec.keep, "largest_file": spec.largest_file}
            decides |= {"templates": tuple(spec.template), "copies": tuple(spec.copied)}
            decides |= {"pattern": spec.pattern, "output": spec.output, "cores": spec.cores}
            decides |= {"repeatable": settings.is_repeatable}
            program = CommandSimulator(space, spec.command, code, folder, *returns, **decides)
            return program, {} if code is None else {COMMAND_KEY: program.digest()}
        case _:
            return ElsewhereSimulator(*returns, **lost), {}


def _features(
    settings: CampaignSettings, code: Path | None, run: Path | None, custom: bool
) -> tuple[str | CustomFeatures | ExpressionFeatures, dict[str, str]]:
    """The features in the settings, and the digest of their source if they are a Python function."""
    match settings.classifier.features:
        case sections.PythonFeaturesSettings() if not custom:
            return "design", {}
        case sections.PythonFeaturesSettings() as spec:
            function, source = load_function(spec.python, code, FEATURES_KEY, run)
            return CustomFeatures(spec.python.partition(":")[2], function, spec.variables), {FEATURES_KEY: source}
        case sections.ExpressionFeaturesSettings() as spec:
            return ExpressionFeatures(spec.expressions, spec.variables), {}
        case feature_set:
            return feature_set, {}


def _learner_references(settings: CampaignSettings) -> dict[str, str]:
    """The custom code of the classifier and of the acquisition, as "module:function", by settings key."""
    classifier = settings.classifier
    custom = {
        KERNEL_KEY: classifier.kernel,
        LIKELIHOOD_KEY: classifier.likelihood,
        MODEL_KEY: classifier.model,
        CRITERION_KEY: settings.acquisition.criterion,
    }
    return {key: one.python for key, one in custom.items() if isinstance(one, sections.PythonSettings)}


def _check_names(space: DesignSpace, simulator: Simulator, margins: tuple[str, ...]) -> None:
    """Check that every name of a campaign has one meaning: tables have one column of a name."""
    predicted, former = predicted_columns(simulator.outcomes), [f"former_{name}" for name in simulator.margins]
    columns = (*_COLUMNS, "former_outcome", "former_cause", *former)
    meanings = dict.fromkeys(columns, "a column of tables of simulations")
    meanings |= dict.fromkeys(predicted, "a column that `activefail predict` adds")
    named = [(name, f"space.{name}") for name in (*space.names, *space.fixed)]
    named += [(name, f"space.{one.name}.features.{name}") for one in space.parameters for name, _ in one.features]
    for name, key in (*named, *((name, "simulator.margins") for name in simulator.margins)):
        if name in meanings:
            is_output = name in simulator.margins and name not in margins
            way = "expressions take outputs: return it under another name" if is_output else "rename it"
            raise InputError(f"{key}: {name!r} is already the name of {meanings[name]}; {way}.")
        meanings[name] = f"the quantity {key}"
    for name in simulator.outcomes:
        if name in _COUNTED:
            raise InputError(f"simulator.outcomes: {name!r} is already the name of a count of simulations; rename it.")


def _check_learning(settings: CampaignSettings, simulator: Simulator) -> None:
    """Check that what boundaries are learned from exists, and that the stop rule's boundary is a target."""
    learns, custom = settings.classifier.learns, settings.simulator
    margins = sections.margins_in(custom, simulator.margins)
    margins = margins if isinstance(custom, str) or custom.system is None else ("system",)
    if learns not in ("auto", "outcomes", *margins):
        known = ", ".join(("auto", "outcomes", *margins))
        raise InputError(f"classifier.learns: must be one of {known}, got {learns!r}.")
    rule = settings.probability_rule
    if rule is not None and rule.probability not in settings.acquisition.boundaries:
        known = ", ".join(settings.acquisition.boundaries)
        raise InputError(
            f"stop.probability: must be the outcome of a target boundary ({known}), got {rule.probability!r}."
        )
