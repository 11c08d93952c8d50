"""The designs that a campaign asks for: its initial design, and then what its classifier says least of."""

import numpy as np

from activefail.acquisition.batch import Search, propose_shared
from activefail.acquisition.criteria import criterion
from activefail.campaign.assembly import Campaign
from activefail.campaign.history import History
from activefail.campaign.random_streams import stream
from activefail.campaign.unseen import unseen_outcomes
from activefail.space import Array
from activefail.surrogate.classifier import Classifier


def initial_sets(campaign: Campaign, history: History) -> int:
    """How many initial designs a record calls for: one, and one more for each that found no answer at all.

    There a campaign stops. When it continues, the simulator was mended, and there is still nothing to learn from.
    """
    return 1 + history.leading_failures // campaign.settings.sampling.initial


def initial_designs(campaign: Campaign, sets: int = 1) -> Array:
    """The Latin hypercubes that a campaign starts from, (sets · initial, d)."""
    settings = campaign.settings
    return np.concatenate(
        [
            campaign.space.latin_hypercube(settings.sampling.initial, stream(settings.seed, "initial", number))
            for number in range(sets)
        ]
    )


def next_designs(
    campaign: Campaign,
    classifier: Classifier,
    history: History,
    iteration: int,
    q: int,
    chosen: int,
    pending: Array | None = None,
) -> Array:
    """The designs, (q, d), of an iteration: those that the classifier so far asks for.

    Args:
        campaign: that they are for.
        classifier: of all that is known.
        history: of all that is known; numerical failures would fail again, and outcomes that it lacks are searched for.
        iteration: for which they are chosen, from 1 on.
        q: how many.
        chosen: before them: what weights and exploration share out is carried over from one batch to the next.
        pending: (k, d) designs in flight, whose outcomes the classifier does not know yet.
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
        history.failed_designs,
        search_for_unseen(campaign, history),
    )


def search_for_unseen(campaign: Campaign, history: History) -> Search | None:
    """What a search for the outcomes that no simulation ended in starts from; None where all were seen."""
    outcomes = campaign.simulator.outcomes
    missing = unseen_outcomes(outcomes, history.counts(len(outcomes)))
    return Search(history.designs, missing) if missing else None
