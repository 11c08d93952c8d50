"""Progress of a running campaign, as its observer sees it: progress, and the faults of the executor."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.estimates.confidence_bounds import unseen_outcomes
from activefail.execution.executor import Arrived, AsynchronousExecutor
from activefail.loop.history import History
from activefail.simulators.interface import Results, Simulator, is_impossible
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.estimates.error import ErrorEstimate
    from activefail.loop.probability_rule import Looks


@dataclass(frozen=True)
class Progress:
    """Progress of a campaign.

    Attributes:
        iteration: active batches so far.
        done: recorded simulations that count towards the budget, numerical failures included.
        budget: simulations in all.
        counts: (number of outcomes,) recorded simulations by outcome.
        numerical_failures: recorded simulations without an outcome, of designs that may exist.
        accuracy: share of the validation set on the right side of the target boundary; None without a set.
        recall: for each outcome of the validation set, the share of its designs that are predicted to have it.
        seconds_left: estimated time to the budget; None before the first batch.
        error: verified error of the classifier; None if not verified.
        unseen: outcomes without a simulation.
        stop_rule: how the campaign's stop rule is met; empty if it is not.
        looks: what is known of the stop rule's probability; None without such a rule.
    """

    iteration: int
    done: int
    budget: int
    counts: NDArray[np.int64]
    numerical_failures: int
    accuracy: float | None = None
    recall: dict[str, float] = field(default_factory=dict)
    seconds_left: float | None = None
    error: "ErrorEstimate | None" = None
    unseen: tuple[str, ...] = ()
    stop_rule: str = ""
    looks: "Looks | None" = None


@dataclass(frozen=True)
class Observer:
    """What sees a running campaign.

    Attributes:
        progress: receives the progress after each batch.
        stage: receives the name of each stage as it begins.
        stop: whether to end the campaign after the current batch.
        faults: why simulations gave no result, in order of arrival; the loop empties it first.
    """

    progress: Callable[[Progress], None] = lambda _: None
    stage: Callable[[str], None] = lambda _: None
    stop: Callable[[], bool] = lambda: False
    faults: list[str] = field(default_factory=list)


def standing(campaign: Campaign, history: History, budget: int) -> Progress:
    """Progress from the record alone, without accuracy and time left."""
    outcomes = campaign.simulator.outcomes
    counts = history.counts(len(outcomes))
    impossible = is_impossible(campaign.simulator, history.outcome, history.cause)
    return Progress(
        iteration=history.last_iteration,
        done=history.asked_for,
        budget=budget,
        counts=counts,
        numerical_failures=int((~history.answered & ~impossible & ~history.given).sum()),
        unseen=unseen_outcomes(outcomes, counts),
    )


@dataclass(frozen=True)
class ObservedExecutor:
    """An executor that also collects the faults of all its results. Its context remains the caller's.

    Attributes:
        executor: runs the simulations.
        faults: receives the faults, in order of arrival.
    """

    executor: AsynchronousExecutor
    faults: list[str]

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        """As `Executor.run`."""
        return self._noted(self.executor.run(simulator, X, arrived))

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """As `AsynchronousExecutor.start`."""
        self.executor.start(simulator, ticket, x)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """As `AsynchronousExecutor.answered`."""
        return [(ticket, self._noted(results)) for ticket, results in self.executor.answered(seconds)]

    def _noted(self, results: Results) -> Results:
        self.faults.extend(results.faults.values())
        return results

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...
