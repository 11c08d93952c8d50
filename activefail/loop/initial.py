"""The initial design of a campaign: Latin hypercubes. It imports no machine-learning library."""

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.loop.history import History
from activefail.space.space import Array


def initial_size(campaign: Campaign, history: History) -> int:
    """Number of designs of the initial design: a Latin hypercube, and one more for each that failed completely.

    A campaign stops after such a hypercube; once the simulator is fixed and the campaign resumes, it needs another.
    """
    size = campaign.settings.sampling.initial
    return size * (1 + history.leading_failures // size)


def initial_designs(campaign: Campaign, sets: int = 1) -> Array:
    """The Latin hypercubes of the initial design, (sets · initial, d)."""
    settings = campaign.settings
    return np.concatenate(
        [
            campaign.space.latin_hypercube(settings.sampling.initial, stream(settings.seed, "initial", number))
            for number in range(sets)
        ]
    )
