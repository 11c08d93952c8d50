"""What both loops are asked for, with and without batches, and how they judge where the campaign stands."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.learning import accuracy
from activefail.campaign.progress import Observer, Progress
from activefail.campaign.verification import verify_by_rule
from activefail.errors import SimulationError
from activefail.execution.executor import AsynchronousExecutor
from activefail.record.store import Store
from activefail.simulators.interface import cause_name
from activefail.space import Array
from activefail.surrogate.classifier import Classifier

_LEAST_FOR_RATE = 20
"""Simulations below which the share of numerical failures is not judged."""


@dataclass(frozen=True)
class Task:
    """What a loop was asked for, and the designs that it starts from."""

    campaign: Campaign
    store: Store
    executor: AsynchronousExecutor
    budget: int
    observer: Observer
    failure_limit: float
    good_enough: bool
    again: str
    validation: tuple[Array, NDArray[np.int8]] | None
    initial: Array
    forgiven: int  # failures that do not count to the limit

    def check(self, progress: Progress) -> None:
        """Stop where too many simulations have failed numerically, or all have and there is nothing to learn from."""
        size = self.campaign.settings.sampling.initial
        if progress.done >= min(len(self.initial), self.budget) and not progress.counts.any():
            first = cause_name(self.campaign.simulator.causes, int(self.store.batches[0].results.cause[0]))
            needed = (progress.done // size + 1) * size
            raise SimulationError(
                f"None of the {progress.done} simulations gave an answer: there is nothing to learn from. They are "
                f"recorded; the campaign stops here. The cause of the first is {first or 'not named'}. Once the "
                f"simulator is mended, `{self.again}{f' --budget {needed}' if self.budget < needed else ''}` "
                f"goes on with other initial designs." + _told(self.executor.first_fault)
            )
        done, failures = progress.done - self.forgiven, progress.numerical_failures - self.forgiven
        _check_numerical_failures(done, failures, self.failure_limit, self.executor.first_fault, self.again)

    def judged(self, progress: Progress, classifier: Classifier, verify_now: bool) -> Progress:
        """The progress with what is known of the classifier's accuracy."""
        error, good_enough = None, False
        # Without every outcome there is nothing that could be good enough, so that verifying would be in vain.
        if self.good_enough and verify_now and not progress.unseen:
            self.observer.stage("verifying")
            error, good_enough = verify_by_rule(
                self.campaign, self.store, self.executor, classifier, progress.iteration, self.observer.stop
            )
        known = None if self.validation is None else accuracy(classifier, self.campaign.severity, *self.validation)
        return replace(progress, accuracy=known, error=error, good_enough=good_enough)


def _check_numerical_failures(done: int, failures: int, limit: float, first_fault: str, again: str) -> None:
    if done >= _LEAST_FOR_RATE and failures > limit * done:
        raise SimulationError(
            f"{failures} of {done} simulations failed numerically, more than the share of "
            f"{limit:g} that limits.numerical_failures allows. They are recorded; the campaign stops here. "
            f"`activefail export` shows their causes; `{again} --numerical-failures SHARE` allows more."
            + _told(first_fault)
        )


def _told(first_fault: str) -> str:
    return f" Why the first abandoned simulation failed: {first_fault}" if first_fault else ""
