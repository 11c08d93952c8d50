"""What a campaign simulates after its initial design: what the criterion ranks highest and was never handed out, or the
stop rule's check."""

from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.estimates.confidence_bounds import unseen_outcomes
from activefail.learning.criteria.batch_proposal import Search, best_batch, propose_shared
from activefail.learning.criteria.criteria import Choosing, criterion, custom_criterion
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.system import ByMargins
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.learning import Learned, learner_of
from activefail.loop.probability_rule import check_designs, needs_check
from activefail.record.asked import are_among
from activefail.record.batch import ACTIVE, CHECK
from activefail.simulators.user_code import CRITERION_KEY, LEARNER_KEYS
from activefail.space.space import Array

WIDENING = 2.0
"""Factor that stretches the proposals of a campaign that seeks a probability and learns from outcomes alone.

The design measure alone gives hardly any candidates near a rare failure."""

_ATTEMPTS = 5
"""Most proposals in place of designs that were handed out or simulated before."""

_LEFT = 2**14
"""Points among which the last designs of a space are sought in which all variables have steps."""

_LATER = 10**9
"""Keeps the random streams of repeated proposals apart from those of later ones."""

_TRIED = 16
"""Designs on which custom code is tried; a power of two."""


class Chosen(NamedTuple):
    """Designs, (k, d), and their origin: ACTIVE or CHECK."""

    designs: Array
    origin: int


def propose(campaign: Campaign, handed_out: HandedOut, learned: Learned, n: int, room: int | None) -> Chosen:
    """What to simulate next.

    Args:
        campaign: the campaign.
        handed_out: its designs; those in flight are taken into account.
        learned: from all its results.
        n: number of designs. A check has its own.
        room: number of simulations left in the budget; None without a limit.
    """
    history, asked, flight = handed_out.history, handed_out.asked, handed_out.in_flight
    # The first proposal after an iteration does not depend on how many designs were handed out before.
    is_first = not (asked.learned == history.last_iteration).any()
    name, index = ("propose", history.last_iteration + 1) if is_first else ("ask", int((asked.loop == 0).sum()))
    rng = stream(campaign.settings.seed, name, index)
    if needs_check(campaign, history, learned.looks):
        simulated = np.concatenate([history.designs, flight.designs, asked.dropped_designs])
        return Chosen(check_designs(campaign, simulated, learned.looks, learned.classifier, rng)[:room], CHECK)
    chosen_before = int((asked.origin == ACTIVE).sum())
    designs = np.empty((0, campaign.space.dimension))
    for attempt in range(_ATTEMPTS):
        pending = [flight.designs, designs]
        if attempt:
            # A search may end at the same corner each time, where a design was dropped.
            pending.append(asked.dropped_designs)
            rng = stream(campaign.settings.seed, "ask", _LATER * attempt + len(asked))
        proposed = next_designs(
            campaign,
            learned.classifier,
            history,
            rng,
            q=n - len(designs),
            chosen=chosen_before + len(designs),
            pending=np.concatenate(pending) if any(map(len, pending)) else None,
        )
        if campaign.settings.is_repeatable:
            known = np.concatenate([history.designs, asked.designs, designs])
            proposed = proposed[~are_among(proposed, known)]
        designs = np.concatenate([designs, proposed])
        if len(designs) == n:
            break
    if len(designs) < n and campaign.space.design_count < np.inf and campaign.settings.is_repeatable:
        # Few designs are left, which no search may have met.
        known = np.concatenate([history.designs, asked.designs, designs])
        others = np.unique(campaign.space.sobol(_LEFT, rng), axis=0)
        others = rng.permutation(others[~are_among(others, known)])
        designs = np.concatenate([designs, others[: n - len(designs)]])
    return Chosen(designs, ACTIVE)


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
    propose = partial(
        propose_shared,
        classifier,
        campaign.space,
        criterion_of(campaign),
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
    with campaign.custom_code(CRITERION_KEY, *LEARNER_KEYS):
        return propose()


def criterion_of(campaign: Campaign) -> Choosing:
    """How a campaign chooses designs."""
    name = campaign.settings.acquisition.criterion
    return criterion(name) if isinstance(name, str) else custom_criterion(campaign.learner[CRITERION_KEY])


def try_custom_code(campaign: Campaign) -> None:
    """Learn and choose once with custom code, from made-up outcomes, before any simulation is paid for.

    Raises:
        InputError: if the code fails.
    """
    F = campaign.features(campaign.space.sobol(_TRIED, np.random.default_rng(0)))
    with campaign.custom_code(*LEARNER_KEYS):
        latent = learner_of(campaign).learned(F, F[:, 0] > np.median(F[:, 0]))
        latent.moments(F)
    with campaign.custom_code(CRITERION_KEY, *LEARNER_KEYS):
        designs = torch.from_numpy(F)
        best_batch(lambda model: criterion_of(campaign).make(model, designs), latent.model, designs, 2)


def search_for_unseen(campaign: Campaign, history: History, classifier: Classifier) -> Search | None:
    """A search for the outcomes without a simulation; None if every outcome has one.

    An outcome whose boundary is learned from a margin needs no search: the margin shows where it may begin.
    """
    outcomes = campaign.simulator.outcomes
    unseen = tuple(
        name
        for name in unseen_outcomes(outcomes, history.counts(len(outcomes)))
        if name == outcomes[0] or not isinstance(classifier.latent(name), ByMargins)
    )
    return Search(history.designs, unseen) if unseen else None
