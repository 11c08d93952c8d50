"""Propose the active designs of a campaign: those that the criterion ranks highest."""

import numpy as np

from activefail.acquisition.batch_proposal import Search, propose_shared
from activefail.acquisition.criteria import criterion
from activefail.campaign.assembly import Campaign
from activefail.loop.history import History
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.margin import MarginLatent
from activefail.verification.unseen import unseen_outcomes

WIDENING = 2.0
"""Factor that stretches the proposals of a campaign that seeks a probability and learns from outcomes alone.

The design measure alone gives hardly any candidates near a rare failure."""


def next_designs(
    campaign: Campaign,
    classifier: Classifier,
    history: History,
    rng: np.random.Generator,
    *,
    q: int,
    chosen: int,
    pending: Array | None = None,
) -> Array:
    """Propose designs, (q, d).

    Args:
        campaign: the campaign.
        classifier: trained on all of `history`.
        history: all simulations so far; proposals avoid its numerical failures and search for outcomes it lacks.
        rng: generator of the candidates.
        q: number of designs.
        chosen: number of earlier active designs; the shares of boundaries and exploration carry over between batches.
        pending: (k, d) designs in flight, without a result yet.
    """
    settings = campaign.settings
    return propose_shared(
        classifier,
        campaign.space,
        criterion(settings.acquisition.criterion),
        boundaries=settings.acquisition.boundaries,
        exploration=settings.acquisition.exploration,
        first=chosen,
        q=q,
        rng=rng,
        pending=pending,
        failed=history.failed_designs,
        unseen=search_for_unseen(campaign, history, classifier),
        widening=1.0 if settings.probability_rule is None else WIDENING,
    )


def search_for_unseen(campaign: Campaign, history: History, classifier: Classifier) -> Search | None:
    """A search for the outcomes without a simulation; None if every outcome has one.

    An outcome whose boundary is learned from a margin needs no search: the margin shows where it may begin.
    """
    outcomes = campaign.simulator.outcomes
    unseen = tuple(
        name
        for name in unseen_outcomes(outcomes, history.counts(len(outcomes)))
        if name == outcomes[0] or not isinstance(classifier.latent(name), MarginLatent)
    )
    return Search(history.designs, unseen) if unseen else None
