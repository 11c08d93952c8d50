"""The loop without batches: as soon as a simulation is answered, its answer is learned and another one is begun.

What the learner asks for hangs on the order in which the answers came, which is the order of the record. So the record
says all: the designs in flight, those that were asked for and have no answer yet, follow from it and are asked for
again where a campaign was interrupted. How many are in flight is a setting of the campaign, not the number of workers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign, initial_designs, next_batch
from activefail.campaign.learning import (
    classifier_state,
    failed_designs,
    initial_sets,
    learn,
    restore,
    search_for_unseen,
)
from activefail.errors import DamagedError
from activefail.record.batch import Batch
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array
from activefail.surrogate.classifier import Classifier

_FLIGHT = "flight/designs"
"""In a saved state, beside what was learned."""


@dataclass(frozen=True)
class Course:
    """Where a campaign without batches stands after a commit.

    Attributes:
        classifier: of the answers so far; None before the initial design has been asked for as a whole.
        iteration: of the last commit that was learned from; -1 before the first.
        flight: (k, d) designs that were asked for and have no answer yet, in the order of asking. It is as long as ever
            when the budget ends: the last ones are those that a larger budget would begin with.
    """

    classifier: Classifier | None
    iteration: int
    flight: Array

    @property
    def next_iteration(self) -> int:
        """Of the commit that follows."""
        return 0 if self.classifier is None else self.iteration + 1

    def after(self, campaign: Campaign, batches: tuple[Batch, ...]) -> "Course":
        """Where it stands after one more commit, the last of `batches`."""
        left = _without(self.flight, batches[-1].designs)
        asked = sum(len(batch) for batch in batches) + len(left)
        lacking = max(0, campaign.settings.sampling.batch - len(left))
        initial = initial_designs(campaign, initial_sets(campaign, batches))
        flight = np.concatenate([left, initial[asked : asked + lacking]])
        lacking -= len(flight) - len(left)
        # As long as there is nothing to learn from, what is in flight is waited for.
        if lacking == 0 or all((batch.results.outcome == NUMERICAL_FAILURE).all() for batch in batches):
            return Course(self.classifier, self.iteration, flight)
        iteration = batches[-1].iteration
        classifier = learn(campaign, batches, iteration, self.classifier)
        chosen = max(0, asked - len(initial))
        failed, unseen = failed_designs(batches), search_for_unseen(campaign, batches)
        more = next_batch(campaign, classifier, iteration + 1, lacking, chosen, flight, failed, unseen)
        return Course(classifier, iteration, np.concatenate([flight, more]))

    def save(self, store: Store) -> None:
        """Keep what was learned and what is in flight; both could be had again from the record."""
        if self.classifier is not None:
            store.write_state(self.iteration, classifier_state(self.classifier) | {_FLIGHT: self.flight})


def resumed(campaign: Campaign, store: Store) -> Course:
    """Where a record stands: from what was saved, and from the commits that came after it."""
    batches = store.batches
    course, begin = Course(None, -1, initial_designs(campaign)[: campaign.settings.sampling.batch]), 0

    def check(iteration: int, state: Mapping[str, NDArray[Any]]) -> None:
        _check_flight(campaign, batches, iteration, state[_FLIGHT])

    if batches and (saved := restore(campaign, store, batches[-1].iteration, check)) is not None:
        iteration, state, classifier = saved
        course = Course(classifier, iteration, state[_FLIGHT])
        begin = 1 + max(place for place, batch in enumerate(batches) if batch.iteration == iteration)
    for end in range(begin + 1, len(batches) + 1):
        course = course.after(campaign, batches[:end])
    if begin < len(batches):
        course.save(store)
    return course


def _check_flight(campaign: Campaign, batches: tuple[Batch, ...], iteration: int, flight: NDArray[np.generic]) -> None:
    """Check that a saved state's designs in flight could have been asked for, and have no answer yet.

    Raises:
        DamagedError: if they could not.
    """
    shape = (campaign.settings.sampling.batch, campaign.space.dimension)
    if flight.dtype != np.float64 or flight.shape != shape:
        raise DamagedError(f"holds designs in flight of type {flight.dtype} and shape {flight.shape}, expected {shape}")
    designs = flight.astype(np.float64)
    if not campaign.space.contains(designs).all():  # NaN lies nowhere
        raise DamagedError("holds designs in flight outside of the design space")
    answered = {row.tobytes() for batch in batches if batch.iteration <= iteration for row in batch.designs}
    if any(row.tobytes() in answered for row in designs):
        raise DamagedError("holds designs in flight that were answered before")


def _without(flight: Array, answered: Array) -> Array:
    """Designs in flight but for those that were answered."""
    gone = {row.tobytes() for row in answered}
    return np.asarray(flight[np.array([row.tobytes() not in gone for row in flight], dtype=bool)])
