"""`ask`: designs go in flight, with an id and the iteration that they were learned from, for the loop or elsewhere."""

from dataclasses import dataclass

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.loop.in_flight import HandedOut
from activefail.loop.learning import Learned, current
from activefail.loop.stop_rule import noted
from activefail.record.asked import NEVER, Asked
from activefail.record.batch import CHECK, INITIAL
from activefail.record.store import Store
from activefail.space.space import Array


@dataclass(frozen=True)
class Proposed:
    """What `ask` hands out.

    Attributes:
        designs: with their ids, in flight from now on.
        reason: why there are fewer than were asked for, or more; empty if there are as many.
        learned: from all results; None if it did not matter.
    """

    designs: Asked
    reason: str = ""
    learned: Learned | None = None


def ask(
    campaign: Campaign,
    store: Store,
    n: int,
    budget: int | None,
    ignore_stop: bool = False,
    before: Learned | None = None,
    loop: bool = False,
) -> Proposed:
    """Hand out n designs; they are in flight, and durable, once this returns.

    Args:
        campaign: the campaign.
        store: its record, open for writing.
        n: number of designs.
        budget: simulations in all, those in flight included; None for no limit.
        ignore_stop: whether to propose designs although the stop rule is met.
        before: as for `current`.
        loop: whether the loop simulates them.

    Raises:
        StoreError: if the designs cannot be recorded.
    """
    handed = HandedOut.of(store)
    flight, none, reason = handed.in_flight, Asked.none(campaign.space.dimension), ""

    def hand_out(designs: Array, origin: int, learned: Learned | None, reason: str) -> Proposed:
        ids = np.arange(handed.next_id, handed.next_id + len(designs))
        new = Asked.of(ids, np.array(designs), origin, NEVER if learned is None else learned.iteration, loop)
        if len(new):
            store.hand_out(new)
        return Proposed(new, reason, learned)

    room = None if budget is None else handed.room(budget)
    if room is not None and room < n:
        n = room
        reason = f"the campaign's budget of {budget} simulations allows no more (in flight: {len(flight)})"
        if n == 0:
            return Proposed(none, reason)
    left = handed.initial_left(campaign)
    if len(left):
        return hand_out(left[:n], INITIAL, None, reason if len(left) >= n else "the initial design ends here")
    if not handed.history.answered.any():
        return Proposed(none, "no simulation has given an outcome yet, so there is nothing to learn from")
    if (flight.origin == CHECK).any():
        ids = ", ".join(map(str, flight.id[flight.origin == CHECK].tolist()))
        return Proposed(none, f"the stop rule waits for the results of its check, ids {ids}")
    learned = current(campaign, store, write=True, before=before)
    if noted(store) and not ignore_stop:
        return Proposed(none, "the stop rule is met", learned)
    # Loads torch, which the other commands do without.
    from activefail.loop.proposing import propose

    chosen = propose(campaign, handed, learned, n, room)
    if not reason and len(chosen.designs) > n:
        reason = f"the {len(chosen.designs)} designs of the stop rule's check belong together"
    elif not reason and len(chosen.designs) < n:
        reason = "the stop rule's check has no more" if chosen.origin == CHECK else "the criterion found no others"
    return hand_out(chosen.designs, chosen.origin, learned, reason)
