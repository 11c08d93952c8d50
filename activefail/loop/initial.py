"""The initial design of a campaign: Latin hypercubes. It imports no machine-learning library."""

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.loop.history import History
from activefail.space import Array


def initial_sets(campaign: Campaign, history: History) -> int:
    """How many Latin hypercubes the record needs: one, plus one for each in which every simulation failed.

    A campaign stops after such a hypercube; once the simulator is fixed and the campaign resumes, it needs another.
    """
    return 1 + history.leading_failures // campaign.settings.sampling.initial


def initial_designs(campaign: Campaign, sets: int = 1) -> Array:
    """The Latin hypercubes of the initial design, (sets · initial, d)."""
    settings = campaign.settings
    return np.concatenate(
        [
            campaign.space.latin_hypercube(settings.sampling.initial, stream(settings.seed, "initial", number))
            for number in range(sets)
        ]
    )
