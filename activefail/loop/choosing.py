"""What a campaign simulates next, once the initial design is known: a batch of the criterion, or the stop rule's check.

The loop with batches simulates it; `ask` hands it out.
"""

from typing import NamedTuple

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.loop.in_flight import HandedOut
from activefail.loop.learning import Learned
from activefail.loop.probability_rule import check_designs, needs_check
from activefail.loop.proposing import next_designs
from activefail.record.batch import ACTIVE, CHECK
from activefail.space import Array

_ATTEMPTS = 5
"""Most proposals in place of designs that were handed out or simulated before."""

_LATER = 10**9
"""Keeps the random streams of repeated proposals apart from those of later ones."""


class Chosen(NamedTuple):
    """Designs, (k, d), and their origin: ACTIVE or CHECK."""

    designs: Array
    origin: int


def choose(campaign: Campaign, handed_out: HandedOut, learned: Learned, n: int, room: int | None) -> Chosen:
    """What to simulate next.

    Args:
        campaign: the campaign.
        handed_out: its designs; those in flight are taken into account.
        learned: from all its results.
        n: number of designs. A check has its own.
        room: number of simulations left in the budget; None without a limit.
    """
    history, asked, flight = handed_out.history, handed_out.asked, handed_out.in_flight
    learned_from = history.last_iteration
    of_batch = asked.learned == learned_from
    # The first designs after an iteration are the same for the loop and for `ask`; others need other candidates.
    name, index = ("ask", len(asked)) if of_batch.any() else ("propose", learned_from + 1)
    rng = stream(campaign.settings.seed, name, index)
    if needs_check(campaign, history, learned.looks):
        simulated = np.concatenate([history.designs, flight.designs, asked.dropped_designs])
        return Chosen(check_designs(campaign, simulated, learned.looks, rng)[:room], CHECK)
    if room is not None:
        n = min(n, room)
    known = {design.tobytes() for design in (*history.designs, *asked.designs)} if len(asked) else set()
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
            chosen=_chosen_before(campaign, handed_out) + len(designs),
            pending=np.concatenate(pending) if any(map(len, pending)) else None,
        )
        new = [design.tobytes() not in known for design in proposed]
        designs = np.concatenate([designs, proposed[new]])
        # Without designs that were handed out, what the criterion proposes is what it has always proposed.
        if len(designs) == n or not known:
            break
        known |= {design.tobytes() for design in designs}
    return Chosen(designs, ACTIVE)


def _chosen_before(campaign: Campaign, handed_out: HandedOut) -> int:
    """How many designs the criterion chose before; shares of boundaries and exploration carry over between batches.

    An iteration of the loop counts as a whole batch, also if it was short or a check.
    """
    asked = handed_out.asked[handed_out.asked.origin == ACTIVE]
    last = handed_out.history.last_iteration
    by_loop = last - len(np.unique(asked.learned[asked.learned < last]))
    return campaign.settings.sampling.batch * by_loop + len(asked)
