"""The loop: propose, simulate, record, learn, until the budget is spent."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from activefail.campaign.assembly import Campaign, initial_designs, next_batch, stream
from activefail.campaign.asynchronous import resumed
from activefail.campaign.learning import (
    accuracy,
    classifier_state,
    current_classifier,
    failed_designs,
    initial_sets,
    leading_failures,
    learn,
    search_for_unseen,
)
from activefail.campaign.stored_sets import simulated_set
from activefail.campaign.unseen import unseen_outcomes
from activefail.campaign.verification import ErrorEstimate, verify_by_rule
from activefail.errors import SimulationError
from activefail.execution.executor import AsynchronousExecutor, Executor
from activefail.record.batch import ACTIVE, SEED, Batch
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space import Array
from activefail.surrogate.classifier import Classifier

_LEAST_FOR_RATE = 20
"""Simulations below which the share of numerical failures is not judged."""


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


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch and BLAS to one thread: sums then have one order on every run, and workers get the cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        torch.set_num_threads(before)


def standing(campaign: Campaign, batches: tuple[Batch, ...], budget: int) -> Progress:
    """Where a record stands, without accuracy and time left."""
    outcome = np.concatenate([np.empty(0, dtype=np.int8), *(batch.results.outcome for batch in batches)])
    answered = outcome[outcome != NUMERICAL_FAILURE]
    counts = np.bincount(answered, minlength=len(campaign.simulator.outcomes))
    return Progress(
        iteration=batches[-1].iteration if batches else 0,
        done=len(outcome),
        budget=budget,
        counts=counts,
        numerical_failures=len(outcome) - len(answered),
        unseen=unseen_outcomes(campaign.simulator.outcomes, counts),
    )


def _simulate_and_record(
    campaign: Campaign, store: Store, executor: Executor, iteration: int, origin: int, designs: Array
) -> None:
    results = executor.run(campaign.simulator, designs)
    store.commit(Batch(iteration, designs, np.full(len(designs), origin, dtype=np.int8), results))


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


def run(
    campaign: Campaign,
    store: Store,
    executor: AsynchronousExecutor,
    budget: int,
    observer: Observer | None = None,
    failure_limit: float | None = None,
    good_enough: bool = True,
    again: str = "activefail resume DIR",
) -> bool:
    """Take a campaign from where its record stands to its budget, or until it is verified to be good enough.

    False when it was asked to stop before.

    Args:
        good_enough: whether the campaign's rule about its error may end it before its budget.
        failure_limit: share of numerical failures to stop above, instead of the campaign's.
        again: the command that goes on, for messages.

    Raises:
        SimulationError: if the workers or too many of the simulations fail.
        StoreError: if a batch cannot be recorded.
    """
    observer = observer or Observer()
    limit = campaign.settings.limits.numerical_failures if failure_limit is None else failure_limit
    take = _without_batches if campaign.settings.sampling.asynchronous else _in_batches
    with one_thread():
        validation = _validation_set(campaign, store, executor, observer)
        initial = initial_designs(campaign, initial_sets(campaign, store.batches))
        # What failed before the first answer was the fault of a simulator that was mended since.
        forgiven = leading_failures(store.batches)
        return take(
            _Task(campaign, store, executor, budget, observer, limit, good_enough, again, validation, initial, forgiven)
        )


@dataclass(frozen=True)
class _Task:
    """What `run` was asked for, and the designs that it starts from."""

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


def _in_batches(task: _Task) -> bool:
    campaign, store, observer, budget = task.campaign, task.store, task.observer, task.budget
    batch, rule = campaign.settings.sampling.batch, campaign.settings.stop
    initial = task.initial
    while (progress := standing(campaign, store.batches, budget)).done < len(initial):
        observer.progress(progress)
        task.check(progress)
        if progress.done >= budget:
            # Nothing is learned from a part of the initial design: a later resume would start from it.
            return True
        if observer.stop():
            return False
        observer.stage("simulating the initial design")
        designs = initial[progress.done : min(progress.done + batch, budget)]
        _simulate_and_record(campaign, store, task.executor, 0, SEED, designs)

    task.check(progress)
    observer.stage("learning")
    classifier = current_classifier(campaign, store, write=True)
    seconds = None
    while True:
        progress = standing(campaign, store.batches, budget)
        left = max(0, budget - progress.done)
        verify_now = rule is not None and progress.iteration % rule.every == 0
        progress = task.judged(progress, classifier, verify_now)
        observer.progress(replace(progress, seconds_left=None if seconds is None else seconds * -(-left // batch)))
        task.check(progress)
        if left == 0 or progress.good_enough:
            return True
        if observer.stop():
            return False
        began = time.monotonic()
        iteration = progress.iteration + 1
        observer.stage("proposing")
        chosen, failed = (iteration - 1) * batch, failed_designs(store.batches)
        unseen = search_for_unseen(campaign, store.batches)
        designs = next_batch(campaign, classifier, iteration, min(batch, left), chosen, failed=failed, unseen=unseen)
        observer.stage("simulating")
        _simulate_and_record(campaign, store, task.executor, iteration, ACTIVE, designs)
        observer.stage("learning")
        classifier = learn(campaign, store.batches, iteration, classifier)
        store.write_state(iteration, classifier_state(classifier))
        seconds = time.monotonic() - began


def _without_batches(task: _Task) -> bool:
    campaign, store, observer, executor = task.campaign, task.store, task.observer, task.executor
    rule, size = campaign.settings.stop, campaign.settings.sampling.batch
    initial = {design.tobytes() for design in task.initial}
    observer.stage("learning")
    course = resumed(campaign, store)
    started: dict[bytes, Array] = {}
    tickets: dict[int, Array] = {}
    every = np.inf if rule is None else size * rule.every
    # What was looked at before the last commit is not due again, nor was anything before there was a classifier.
    looked = 0 if course.iteration < 1 else sum(len(batch) for batch in store.batches[:-1]) // every
    began, before = time.monotonic(), standing(campaign, store.batches, task.budget).done
    ending = False
    while True:
        progress = standing(campaign, store.batches, task.budget)
        left = task.budget - progress.done
        if course.classifier is not None:
            # As often as with batches.
            looks = progress.done // every
            progress = task.judged(progress, course.classifier, looks > looked)
            looked = max(looked, looks)
        rate = (progress.done - before) / (time.monotonic() - began)
        observer.progress(replace(progress, seconds_left=left / rate if rate and course.classifier else None))
        task.check(progress)
        enough = left <= 0 or progress.good_enough
        ending = ending or enough
        stopping = False
        while True:
            stopping = stopping or observer.stop()
            if not (ending or stopping):
                for design in course.flight[: task.budget - progress.done]:
                    if design.tobytes() not in started:
                        tickets[len(tickets)] = started[design.tobytes()] = design
                        executor.start(campaign.simulator, len(tickets) - 1, design)
            if not started:
                return ending
            observer.stage("simulating")
            if answers := executor.answered(0.5):
                break
        designs = np.stack([tickets[ticket] for ticket, _ in answers])
        for design in designs:
            del started[design.tobytes()]
        origin = np.array([SEED if design.tobytes() in initial else ACTIVE for design in designs], dtype=np.int8)
        results = Results.concatenate([answer for _, answer in answers])
        store.commit(Batch(course.next_iteration, designs, origin, results))
        observer.stage("learning")
        course = course.after(campaign, store.batches)
        course.save(store)


def _validation_set(
    campaign: Campaign, store: Store, executor: Executor, observer: Observer
) -> tuple[Array, NDArray[np.int8]] | None:
    size = campaign.settings.validation.size
    if size == 0:
        return None
    observer.stage("simulating the validation set")
    X = campaign.space.from_unit(stream(campaign.settings.seed, "validation").random((size, campaign.space.dimension)))
    return simulated_set(campaign, store, executor, "validation", X, observer.stop)
