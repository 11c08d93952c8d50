"""Where a campaign stands, as it is told while it runs."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.history import History
from activefail.campaign.unseen import unseen_outcomes
from activefail.campaign.verification import ErrorEstimate
from activefail.record.batch import Batch


@dataclass(frozen=True)
class Progress:
    """Where a campaign stands.

    Attributes:
        iteration: batches chosen by the learner so far.
        done: simulations recorded; seed and numerical failures included.
        budget: simulations to do.
        counts: (number of outcomes,) recorded simulations by outcome.
        numerical_failures: recorded simulations without an answer.
        accuracy: share of the validation set on the right side of the sought boundary; None without a set.
        seconds_left: estimate for the rest; None before there is a batch to judge by.
        error: verified misclassified volume; None where it was not verified.
        unseen: outcomes that no simulation ended in.
        good_enough: whether the campaign's stop rule is met.
    """

    iteration: int
    done: int
    budget: int
    counts: NDArray[np.int64]
    numerical_failures: int
    accuracy: float | None = None
    seconds_left: float | None = None
    error: ErrorEstimate | None = None
    unseen: tuple[str, ...] = ()
    good_enough: bool = False


@dataclass(frozen=True)
class Observer:
    """What a caller may hear of a running campaign, and how it asks for an end after the batch under way."""

    progress: Callable[[Progress], None] = lambda _: None
    stage: Callable[[str], None] = lambda _: None
    stop: Callable[[], bool] = lambda: False


def standing(campaign: Campaign, batches: tuple[Batch, ...], budget: int) -> Progress:
    """Where a record stands, without accuracy and time left."""
    history = History.of(batches)
    outcomes = campaign.simulator.outcomes
    counts = history.counts(len(outcomes))
    return Progress(
        iteration=history.last_iteration,
        done=len(history),
        budget=budget,
        counts=counts,
        numerical_failures=len(history) - int(counts.sum()),
        unseen=unseen_outcomes(outcomes, counts),
    )
