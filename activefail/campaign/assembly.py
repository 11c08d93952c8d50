"""A campaign put together from its settings: design space, simulator and features."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from activefail.campaign import settings as config
from activefail.campaign.settings import CampaignSettings
from activefail.errors import InputError
from activefail.features import CustomFeatures, ExpressionFeatures, FeatureMap, FeatureSet, feature_map
from activefail.record.batch import Schema
from activefail.record.layout import SIMULATIONS
from activefail.simulators.bearing import DfpSimulator
from activefail.simulators.command import CommandSimulator
from activefail.simulators.function import PythonSimulator
from activefail.simulators.interface import Simulator
from activefail.simulators.user_code import FEATURES_KEY, SIMULATOR_KEY, load_function
from activefail.space import DesignSpace

_COLUMNS = ("id", "iteration", "origin", "outcome", "cause", "seconds")
"""Of an exported table, beside variables and margins."""


def predicted_columns(outcomes: Sequence[str]) -> tuple[str, ...]:
    """The columns that a prediction adds to a table of designs."""
    return (*(f"p_{name}" for name in outcomes), "latent_mean", "latent_sd")


@dataclass(frozen=True)
class Campaign:
    """The pieces that settings name, put together; the loop knows nothing more of them than their seams.

    Attributes:
        sources: digests of the sources of a user's own functions, by the key that names them.
        code: folder of the user's own code; None if none may be run.
    """

    settings: CampaignSettings
    space: DesignSpace
    simulator: Simulator
    features: FeatureMap
    sources: dict[str, str] = field(default_factory=dict)
    code: Path | None = None

    @classmethod
    def of(
        cls,
        settings: CampaignSettings,
        code: Path | None = None,
        run: Path | None = None,
        *,
        simulator: Simulator | None = None,
        custom_features: bool = True,
    ) -> "Campaign":
        """The campaign that settings describe.

        Args:
            settings: of the campaign.
            code: folder of the user's code that the settings name, which is then run. None: none of it is run, and
                features that need it cannot be had, nor simulations.
            run: folder of the run, in which programs that simulate have theirs, and no code is looked for; the current
                one if None.
            simulator: instead of the one that the settings name.
            custom_features: whether features that are a function of the user's are needed; the variables stand in for
                them if not.

        Raises:
            InputError: if simulator, design space, features and boundary do not fit each other.
        """
        # Workers and programs that simulate have other current folders.
        code, run = (None if folder is None else folder.absolute() for folder in (code, run))
        space = settings.design_space()
        sources: dict[str, str] = {}
        if simulator is None:
            _check_bearing(settings)
            simulator, sources = _simulator(settings, space, code, run)
            _check_names(space, simulator)
        for boundary in settings.acquisition.boundaries:
            if boundary not in simulator.outcomes[1:]:
                raise InputError(
                    f"acquisition.boundary: must be one of {', '.join(simulator.outcomes[1:])}, got {boundary!r}."
                )
        features, source = _features(settings, code, run, custom_features)
        mapped = feature_map(features, space, settings.bearing.model())
        return cls(settings, space, simulator, mapped, sources | source, code)

    @property
    def time_limit(self) -> float | None:
        """Seconds that one simulation may take; None where it bounds itself, or may take for ever."""
        named = self.settings.simulator
        return None if isinstance(named, str) else named.time_limit

    @property
    def schema(self) -> Schema:
        """What the columns of this campaign's record mean."""
        return Schema(self.space.names, self.simulator.outcomes, self.simulator.causes, self.simulator.margins)

    @property
    def severity(self) -> int:
        """The outcome at and above which a simulation counts as beyond the boundary that is sought (mainly)."""
        return self.simulator.outcomes.index(self.settings.acquisition.main_boundary)


def _simulator(
    settings: CampaignSettings, space: DesignSpace, code: Path | None, run: Path | None
) -> tuple[Simulator, dict[str, str]]:
    """The simulator that settings name, and the digest of its source where that is the user's."""
    match settings.simulator:
        case config.PythonSimulator() as named:
            function = PythonSimulator(
                space, named.python, code, tuple(named.outcomes), tuple(named.margins), folder=run, renew=named.renew
            )
            if code is None:
                return function, {}
            source = function.load()
            return replace(function, source=source), {SIMULATOR_KEY: source}
        case config.CommandSimulator() as named:
            command = CommandSimulator(
                space,
                named.command,
                code,
                (run or Path.cwd()) / SIMULATIONS,
                tuple(named.outcomes),
                tuple(named.margins),
                named.retries,
                named.keep,
                named.largest_file,
            )
            return command, {}
        case _:
            return DfpSimulator.on(space, settings.bearing.model(), settings.bearing.integration()), {}


def _features(
    settings: CampaignSettings, code: Path | None, run: Path | None, custom: bool
) -> tuple[FeatureSet | CustomFeatures | ExpressionFeatures, dict[str, str]]:
    """The features that settings name, and the digest of their source where that is the user's."""
    match settings.classifier.features:
        case config.PythonFeatures() if not custom:
            return "design", {}
        case config.PythonFeatures() as named:
            function, source = load_function(named.python, code, FEATURES_KEY, run)
            return CustomFeatures(named.python.partition(":")[2], function, named.variables), {FEATURES_KEY: source}
        case config.ExpressionFeatures() as named:
            return ExpressionFeatures(named.expressions, named.variables), {}
        case named:
            return named, {}


def _check_names(space: DesignSpace, simulator: Simulator) -> None:
    """Refuses variables and margins whose columns of a table would have the name of another.

    Raises:
        InputError: naming the key.
    """
    for name in space.names:
        if name in _COLUMNS:
            raise InputError(f"space.{name}: is the name of another column of the exported table; rename it.")
        if name in predicted_columns(simulator.outcomes):
            raise InputError(f"space.{name}: is the name of a column that `activefail predict` adds; rename it.")
    for name in simulator.margins:
        if name in (*space.names, *_COLUMNS):
            raise InputError(f"simulator.margins: {name!r} is the name of another column of the exported table.")


def _check_bearing(settings: CampaignSettings) -> None:
    """Refuses settings of the bearing that nothing would use; a run folder's frozen ones have the defaults written out.

    Raises:
        InputError: naming the key and its value.
    """
    if settings.simulator == "dfp" or settings.classifier.features in ("sliding", "collision"):
        return
    default = config.BearingSettings()
    for key, value in settings.bearing:
        if value != getattr(default, key):
            raise InputError(
                f'bearing.{key}: belongs to `simulator = "dfp"`, and the simulator is one\'s own; got {value!r}.'
            )
