"""What both loops share: parameters, the checks that end a campaign with an error, and whether a stop rule is met."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import SimulationError
from activefail.execution.executor import AsynchronousExecutor
from activefail.loop.learning import accuracy, recall
from activefail.loop.probability_rule import Looks
from activefail.loop.progress import Observer, Progress
from activefail.record.store import Store
from activefail.simulators.interface import cause_name
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.verification.error import verify_by_rule
from activefail.verification.stored_sets import first_fault_text

_LEAST_FOR_RATE = 20
"""Fewest simulations for which the share of numerical failures is checked."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Parameters of a loop and its fixed designs.

    Attributes:
        use_stop_rule: whether the stop rule may end the campaign.
        resume_command: the command that continues the campaign, for messages.
        validation: designs and outcomes of the validation set, if any.
        initial: the initial design.
        ignored_failures: numerical failures that do not count towards the limit.
    """

    campaign: Campaign
    store: Store
    executor: AsynchronousExecutor
    budget: int
    observer: Observer
    failure_limit: float
    use_stop_rule: bool
    resume_command: str
    validation: tuple[Array, NDArray[np.int8]] | None
    initial: Array
    ignored_failures: int

    def check(self, progress: Progress) -> None:
        """Check that not all, and not too many, simulations failed numerically.

        Raises:
            SimulationError: if they did.
        """
        size = self.campaign.settings.sampling.initial
        if progress.done >= min(len(self.initial), self.budget) and not progress.counts.any():
            first = cause_name(self.campaign.simulator.causes, int(self.store.batches[0].results.cause[0]))
            needed = (progress.done // size + 1) * size
            raise SimulationError(
                f"None of the {progress.done} simulations gave an outcome, so there is nothing to learn from. They are "
                f"recorded; the campaign stops here. The first failed with cause `{first or 'unnamed'}`. Fix the "
                f"simulator, then `{self.resume_command}{f' --budget {needed}' if self.budget < needed else ''}` "
                f"continues with a new initial design." + first_fault_text(self.observer.faults)
            )
        done, failures = progress.done - self.ignored_failures, progress.numerical_failures - self.ignored_failures
        _check_numerical_failures(done, failures, self.failure_limit, self.observer.faults, self.resume_command)

    def check_simulator(self, progress: Progress) -> None:
        """Check that a simulation gave an outcome, if any of an initial design was made that is partly in flight.

        Raises:
            SimulationError: if none did.
        """
        if progress.done and not progress.counts.any():
            raise SimulationError(
                f"None of the {progress.done} simulations, which are recorded, gave an outcome, and the rest of the "
                "initial design is in flight or was dropped. Fix the simulator. Then record the results in flight with "
                f"`activefail tell`, or drop their designs with `activefail drop` and resume "
                f"with `{self.resume_command}`." + first_fault_text(self.observer.faults)
            )

    def judged(
        self, progress: Progress, classifier: Classifier, verify_now: bool, looks: Looks | None = None
    ) -> Progress:
        """The progress with the classifier's accuracy, its verified error, and what is known of a probability."""
        error, stop_rule_met = None, False
        # A campaign with an unseen outcome never meets its stop rule, so verifying it would waste simulations.
        if self.use_stop_rule and verify_now and not progress.unseen:
            self.observer.stage("verifying")
            error, stop_rule_met = verify_by_rule(
                self.campaign, self.store, self.executor, classifier, progress.iteration, self.observer.stop
            )
        if self.validation is not None:
            share = accuracy(classifier, self.campaign.severity, *self.validation)
            progress = replace(progress, accuracy=share, recall=recall(classifier, *self.validation))
        if looks is not None and len(looks.table):
            progress = replace(progress, looks=looks)
            stop_rule_met = self.use_stop_rule and looks.is_known
        return replace(progress, error=error, stop_rule_met=stop_rule_met)


def _check_numerical_failures(done: int, failures: int, limit: float, faults: list[str], resume_command: str) -> None:
    if done >= _LEAST_FOR_RATE and failures > limit * done:
        # Failures before the first outcome are forgiven when the campaign resumes.
        advice = (
            f". Fix the simulator, then `{resume_command}` continues."
            if failures == done
            else f"; `{resume_command} --numerical-failures SHARE` allows more."
        )
        raise SimulationError(
            f"{failures} of {done} simulations failed numerically, more than the share of "
            f"{limit:g} that limits.numerical_failures allows. They are recorded; the campaign stops here. "
            f"`activefail export` shows their causes{advice}" + first_fault_text(faults)
        )
