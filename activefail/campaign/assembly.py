"""A campaign put together from its settings: design space, simulator, features, and where randomness comes from."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from activefail.acquisition.batch import Search, propose_shared
from activefail.acquisition.criteria import criterion
from activefail.campaign import settings as config
from activefail.campaign.settings import CampaignSettings
from activefail.errors import InputError
from activefail.features import ExpressionFeatures, FeatureMap, FeatureSet, OwnFeatures, feature_map
from activefail.record.batch import Schema
from activefail.record.layout import SIMULATIONS
from activefail.simulators.bearing import DfpSimulator
from activefail.simulators.command import CommandSimulator
from activefail.simulators.function import PythonSimulator
from activefail.simulators.interface import Simulator
from activefail.simulators.user_code import FEATURES_KEY, SIMULATOR_KEY, load_function
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier

_COLUMNS = ("id", "iteration", "origin", "outcome", "cause", "seconds")
"""Of an exported table, beside variables and margins."""


def predicted_columns(outcomes: Sequence[str]) -> tuple[str, ...]:
    """The columns that a prediction adds to a table of designs."""
    return (*(f"p_{name}" for name in outcomes), "latent_mean", "latent_sd")


STREAMS = {"initial": 1, "propose": 2, "validation": 3, "test": 4, "static": 5, "verification": 6}
"""Independent streams of random numbers; a number never changes its meaning, so that old campaigns replay."""


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """The generator of one use of randomness: a counter-based stream keyed by campaign, use and index.

    No order of work, worker or resume can change what it draws.
    """
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(STREAMS[name], index))))


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
        cls, settings: CampaignSettings, code: Path | None = None, run: Path | None = None, features: bool = True
    ) -> "Campaign":
        """The campaign that settings describe.

        Args:
            settings: of the campaign.
            code: folder of the user's own code that the settings name, which is then run. None: none of it is, and
                features that need it cannot be had, nor simulations.
            run: folder of the run, in which programs that simulate have theirs, and no code is looked for; the current
                one if None.
            features: whether they are needed. The variables stand in for a function of the user's own if not.

        Raises:
            InputError: if simulator, design space, features and boundary do not fit each other.
        """
        # Workers and programs that simulate have other current folders.
        code, run = (None if folder is None else folder.absolute() for folder in (code, run))
        space = settings.design_space()
        _check_bearing(settings)
        simulator: Simulator
        sources = {}
        match settings.simulator:
            case config.PythonSimulator() as named:
                simulator = PythonSimulator(
                    space,
                    named.python,
                    code,
                    tuple(named.outcomes),
                    tuple(named.margins),
                    folder=run,
                    renew=named.renew,
                )
                if code is not None:
                    sources[SIMULATOR_KEY] = simulator.load()
                    simulator = replace(simulator, source=sources[SIMULATOR_KEY])
            case config.CommandSimulator() as named:
                simulator = CommandSimulator(
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
            case _:
                simulator = DfpSimulator.on(space, settings.bearing.model(), settings.bearing.integration())
        for name in space.names:
            if name in _COLUMNS:
                raise InputError(f"space.{name}: is the name of another column of the exported table; rename it.")
            if name in predicted_columns(simulator.outcomes):
                raise InputError(f"space.{name}: is the name of a column that `activefail predict` adds; rename it.")
        for name in simulator.margins:
            if name in (*space.names, *_COLUMNS):
                raise InputError(f"simulator.margins: {name!r} is the name of another column of the exported table.")
        assembled = cls.with_simulator(settings, simulator, code, features, run)
        return replace(assembled, sources=sources | assembled.sources)

    @classmethod
    def with_simulator(
        cls,
        settings: CampaignSettings,
        simulator: Simulator,
        code: Path | None = None,
        own_features: bool = True,
        run: Path | None = None,
    ) -> "Campaign":
        """The campaign that settings describe, on another simulator than they name.

        Raises:
            InputError: as `of` does.
        """
        space = settings.design_space()
        for boundary in settings.acquisition.boundaries:
            if boundary not in simulator.outcomes[1:]:
                raise InputError(
                    f"acquisition.boundary: must be one of {', '.join(simulator.outcomes[1:])}, got {boundary!r}."
                )
        named, sources = settings.classifier.features, {}
        features: FeatureSet | OwnFeatures | ExpressionFeatures
        match named:
            case config.PythonFeatures() if not own_features:
                features = "design"
            case config.PythonFeatures():
                function, sources[FEATURES_KEY] = load_function(named.python, code, FEATURES_KEY, run)
                features = OwnFeatures(named.python.partition(":")[2], function, named.variables)
            case config.ExpressionFeatures():
                features = ExpressionFeatures(named.expressions, named.variables)
            case _:
                features = named
        return cls(settings, space, simulator, feature_map(features, space, settings.bearing.model()), sources, code)

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


def initial_designs(campaign: Campaign, sets: int = 1) -> Array:
    """The Latin hypercubes that a campaign starts from, (sets · initial, d); one, unless the first found no answer."""
    settings = campaign.settings
    return np.concatenate(
        [
            campaign.space.latin_hypercube(settings.sampling.initial, stream(settings.seed, "initial", number))
            for number in range(sets)
        ]
    )


def next_batch(
    campaign: Campaign,
    classifier: Classifier,
    iteration: int,
    q: int,
    chosen: int,
    pending: Array | None = None,
    failed: Array | None = None,
    unseen: Search | None = None,
) -> Array:
    """The designs, (q, d), of an iteration: those that the classifier so far asks for.

    Args:
        campaign: that they are for.
        classifier: of all that is known.
        iteration: for which they are chosen, from 1 on.
        q: how many.
        chosen: before them: what weights and exploration share out is carried over from one batch to the next.
        pending: (k, d) designs in flight, whose outcomes the classifier does not know yet.
        failed: (k, d) numerical failures, which would fail again.
        unseen: outcomes to search for; None where all were seen.
    """
    settings = campaign.settings
    return propose_shared(
        classifier,
        campaign.space,
        criterion(settings.acquisition.criterion),
        settings.acquisition.boundaries,
        settings.acquisition.exploration,
        chosen,
        q,
        stream(settings.seed, "propose", iteration),
        pending,
        failed,
        unseen,
    )
