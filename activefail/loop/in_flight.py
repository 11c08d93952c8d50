"""Which designs were handed out, which of them have a result, and which are still in flight."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.loop.history import History
from activefail.loop.initial import initial_designs
from activefail.record.asked import Asked, are_among
from activefail.record.batch import INITIAL
from activefail.record.store import Store
from activefail.space.space import Array

_LEAST = 2
"""Designs of the initial design that are asked in any case: bounds without a classifier rest on them."""


@dataclass(frozen=True, eq=False)
class HandedOut:
    """The designs of a campaign, each in one of these states: in flight, with a result, or dropped.

    Every design that entered the campaign has an id: how many entered before it, whether they were handed out or given.

    Attributes:
        history: the n simulations of the record.
        asked: the k designs that were handed out.
        in_flight: those of them that have neither a result nor been dropped.
    """

    history: History
    asked: Asked
    in_flight: Asked

    @classmethod
    def of(cls, store: Store) -> Self:
        """The designs of a record."""
        history, asked = History.of(store.batches), store.asked
        return cls(history, asked, asked.in_flight(history.id))

    def room(self, budget: int) -> int:
        """How many designs the budget leaves to hand out."""
        return max(0, budget - self.history.asked_for - len(self.in_flight))

    @property
    def next_id(self) -> int:
        """The id of the next design that enters the campaign."""
        return 1 + max(int(self.asked.id.max(initial=-1)), int(self.history.id.max(initial=-1)))

    def initial_left(self, campaign: Campaign) -> Array:
        """The designs of the initial design, (k, d), that have neither been simulated nor handed out, in order.

        Each given simulation with an outcome inside the design space takes the place of one, but for `_LEAST` of them:
        which are left does not depend on where the given ones are, so those that are asked stay a sample of the space.
        A Latin hypercube that gave no outcome at all is followed by another.
        """
        handed_out, size = int((self.asked.origin == INITIAL).sum()), campaign.settings.sampling.initial
        sets = max(1, -(-handed_out // size))
        hypercubes = initial_designs(campaign, sets)
        given = self.history[self.history.given & self.history.answered].designs.reshape(-1, hypercubes.shape[1])
        # A given design of the hypercubes is not among those that are left.
        covering = campaign.space.contains(given)
        if campaign.settings.is_repeatable:
            covering &= ~are_among(given, hypercubes)
        left = self._new(campaign, hypercubes)
        left = left[: max(len(left) - int(covering.sum()), min(_LEAST, size) - handed_out, 0)]
        is_needed = not self.history.answered.any() and not len(self.in_flight) and handed_out == sets * size
        return self._new(campaign, initial_designs(campaign, sets + 1)) if is_needed and not len(left) else left

    def can_learn(self, campaign: Campaign) -> bool:
        """Whether the initial design was handed out, and some simulation gave an outcome."""
        return bool(self.history.answered.any()) and not len(self.initial_left(campaign))

    def _new(self, campaign: Campaign, designs: Array) -> Array:
        if not campaign.settings.is_repeatable:  # equal designs are runs of their own, handed out in order
            return designs[(self.asked.origin == INITIAL).sum() :]
        recorded = self.history.designs.reshape(-1, designs.shape[1])
        return designs[~are_among(designs, np.concatenate([self.asked.designs, recorded]))]
