"""Which designs were handed out, which of them have a result, and which are still in flight."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.loop.history import History
from activefail.loop.initial import initial_designs, initial_sets
from activefail.record.asked import NEVER, NO_ROW, Asked, bits_of, rows_with_results
from activefail.record.batch import GIVEN, INITIAL
from activefail.record.store import Store
from activefail.space import Array


@dataclass(frozen=True, eq=False)
class HandedOut:
    """The designs of a campaign, each in one of these states: in flight, with a result, or dropped.

    Every design that entered the campaign has an id: the number of designs that entered before it, whether they were
    handed out, simulated by the loop, or given.

    Attributes:
        history: the n simulations of the record.
        asked: the k designs that were handed out.
    """

    history: History
    asked: Asked

    @classmethod
    def of(cls, store: Store) -> Self:
        """The designs of a record."""
        return cls(History.of(store.batches), store.asked)

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """The row of the record with the result of each design that was handed out, (k,); NO_ROW without a result."""
        return rows_with_results(self.asked, self.history.designs, self.history.origin)

    @property
    def has_result(self) -> NDArray[np.bool_]:
        """Which designs that were handed out have a result, (k,)."""
        return np.asarray(self.rows != NO_ROW)

    @property
    def in_flight(self) -> Asked:
        """The designs that were handed out and have neither a result nor been dropped."""
        return self.asked[~self.has_result & (self.asked.dropped == 0)]

    @cached_property
    def handed_out(self) -> NDArray[np.bool_]:
        """Which simulations of the record, (n,), were handed out."""
        handed_out = np.zeros(len(self.history), dtype=bool)
        handed_out[self.rows[self.has_result]] = True
        return handed_out

    @property
    def next_id(self) -> int:
        """The id of the next design that enters the campaign."""
        # A damaged file that was set aside may have held simulations, whose ids are not given again.
        return max(len(self.asked) + int((~self.handed_out).sum()), int(self.asked.id.max(initial=-1)) + 1)

    @property
    def ids(self) -> NDArray[np.int64]:
        """The ids of the simulations of the record, (n,)."""
        ids = np.empty(len(self.history), dtype=np.int64)
        ids[self.rows[self.has_result]] = self.asked.id[self.has_result]
        # The others entered when they were recorded, so they have the remaining ids in their order.
        free = np.setdiff1d(np.arange(len(ids) + len(self.asked)), self.asked.id)
        ids[~self.handed_out] = free[: int((~self.handed_out).sum())]
        return ids

    def initial_left(self, campaign: Campaign) -> Array:
        """The designs of the initial design, (k, d), that have neither been simulated nor handed out, in order."""
        sets, size = initial_sets(campaign, self.history), campaign.settings.sampling.initial
        if not self.history.answered.any():
            # Nothing can be learned from a dropped hypercube either.
            dropped = int((self.asked.origin[self.asked.dropped == 1] == INITIAL).sum())
            sets = 1 + (self.history.leading_failures + dropped) // size
        given = self.history.origin == GIVEN
        begun = {*bits_of(self.asked.designs), *bits_of(self.history.designs[~given])}
        # A hypercube that was begun is finished.
        while not begun.isdisjoint(bits_of(initial_designs(campaign, sets + 1)[-size:])):
            sets += 1
        known = begun.union(bits_of(self.history.designs[given]))
        initial = initial_designs(campaign, sets)
        return initial[[bits not in known for bits in bits_of(initial)]]

    def next_iteration(self, campaign: Campaign) -> int:
        """The iteration of the next results: one more than the last that a proposal learned from.

        So results that arrive in parts give the same classifiers as the same results at once.
        """
        learned = int(self.asked.learned.max(initial=NEVER))
        by_loop = ~self.handed_out & (self.history.origin != GIVEN)
        if by_loop.any():
            last = int(self.history.iteration[by_loop].max())
            if last or self._loop_completed_initial(campaign, by_loop):
                learned = max(learned, last)
        # A damaged file that was set aside may have held what a proposal learned from.
        return min(learned, self.history.last_iteration if len(self.history) else NEVER) + 1

    def _loop_completed_initial(self, campaign: Campaign, by_loop: NDArray[np.bool_]) -> bool:
        """Whether the loop completed the initial design, and so learned from iteration 0; not if `ask` completed it."""
        last = int(np.flatnonzero(by_loop)[-1])
        if not self.history.answered[: last + 1].any():
            return False  # nothing to learn from
        asked_last = int(self.asked.id[self.asked.origin == INITIAL].max(initial=-1))
        return int(self.ids[by_loop].max()) > asked_last and not len(self.initial_left(campaign))
