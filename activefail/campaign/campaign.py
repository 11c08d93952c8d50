"""A campaign put together from its settings: design space, simulator, features, and where randomness comes from."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from activefail.acquisition.batch import propose_shared
from activefail.acquisition.criteria import criterion
from activefail.campaign.config import CampaignSettings
from activefail.campaign.dfp import DfpSimulator
from activefail.campaign.plugin import load_function
from activefail.campaign.record import Schema
from activefail.campaign.simulator import Simulator
from activefail.errors import InputError
from activefail.features import FeatureMap, FeatureSet, OwnFeatures, feature_map
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier

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
    """

    settings: CampaignSettings
    space: DesignSpace
    simulator: Simulator
    features: FeatureMap
    sources: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, settings: CampaignSettings, folders: Sequence[Path] = ()) -> "Campaign":
        """The campaign that settings describe.

        Args:
            settings: of the campaign.
            folders: where a user's own functions are looked for, before the current folder.

        Raises:
            InputError: if simulator, design space, features and boundary do not fit each other.
        """
        space = settings.design_space()
        simulator = DfpSimulator.on(space, settings.bearing.model(), settings.bearing.integration())
        return cls.with_simulator(settings, simulator, folders)

    @classmethod
    def with_simulator(
        cls, settings: CampaignSettings, simulator: Simulator, folders: Sequence[Path] = ()
    ) -> "Campaign":
        """The campaign that settings describe, on a simulator of one's own.

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
        features: FeatureSet | OwnFeatures
        if isinstance(named, str):
            features = named
        else:
            key = "classifier.features.python"
            function, sources[key] = load_function(named.python, [*folders, Path.cwd()], key)
            features = OwnFeatures(named.python.partition(":")[2], function, named.variables)
        return cls(settings, space, simulator, feature_map(features, space, settings.bearing.model()), sources)

    @property
    def schema(self) -> Schema:
        """What the columns of this campaign's record mean."""
        return Schema(self.space.names, self.simulator.outcomes, self.simulator.causes, self.simulator.margins)

    @property
    def severity(self) -> int:
        """The label at and above which an outcome counts as beyond the boundary that is sought (mainly)."""
        return self.simulator.outcomes.index(self.settings.acquisition.main_boundary)


def initial_designs(campaign: Campaign) -> Array:
    """The Latin hypercube that a campaign starts from, (initial, d)."""
    settings = campaign.settings
    return campaign.space.latin_hypercube(settings.sampling.initial, stream(settings.seed, "initial"))


def next_batch(
    campaign: Campaign, classifier: Classifier, iteration: int, q: int, pending: Array | None = None
) -> Array:
    """The designs, (q, d), of an iteration: those that the classifier so far asks for.

    Args:
        pending: (k, d) designs in flight, whose outcomes the classifier does not know yet.
    """
    settings = campaign.settings
    return propose_shared(
        classifier,
        campaign.space,
        criterion(settings.acquisition.criterion),
        settings.acquisition.boundaries,
        settings.acquisition.exploration,
        (iteration - 1) * settings.sampling.batch,
        q,
        stream(settings.seed, "propose", iteration),
        pending,
    )
