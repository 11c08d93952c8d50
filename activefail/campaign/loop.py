"""The loop: propose, simulate, record, learn, until the budget is spent."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from activefail.campaign.campaign import Campaign, initial_designs, next_batch, stream
from activefail.campaign.executor import Executor
from activefail.campaign.learning import accuracy, classifier_state, current_classifier, learn
from activefail.campaign.record import ACTIVE, SEED, Batch, Store
from activefail.campaign.sets import simulated_set
from activefail.campaign.simulator import NUMERICAL_FAILURE
from activefail.campaign.verification import ErrorEstimate, expected_error, verify
from activefail.errors import SimulationError
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
    """

    iteration: int
    done: int
    budget: int
    counts: NDArray[np.int64]
    numerical_failures: int
    accuracy: float | None = None
    seconds_left: float | None = None
    error: ErrorEstimate | None = None


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
    return Progress(
        iteration=batches[-1].iteration if batches else 0,
        done=len(outcome),
        budget=budget,
        counts=np.bincount(answered, minlength=len(campaign.simulator.outcomes)),
        numerical_failures=len(outcome) - len(answered),
    )


def _simulate_and_record(
    campaign: Campaign, store: Store, executor: Executor, iteration: int, origin: int, designs: Array
) -> None:
    results = executor.run(campaign.simulator, designs)
    store.commit(Batch(iteration, designs, np.full(len(designs), origin, dtype=np.int8), results))


def _check_numerical_failures(progress: Progress, limit: float) -> None:
    if progress.done >= _LEAST_FOR_RATE and progress.numerical_failures > limit * progress.done:
        raise SimulationError(
            f"{progress.numerical_failures} of {progress.done} simulations failed numerically, more than the share of "
            f"{limit:g} that limits.numerical_failures allows. They are recorded; the campaign stops here. "
            f"`activefail export` shows their causes; `activefail resume DIR --numerical-failures SHARE` allows more."
        )


def run(
    campaign: Campaign,
    store: Store,
    executor: Executor,
    budget: int,
    observer: Observer | None = None,
    failure_limit: float | None = None,
    good_enough: bool = True,
) -> bool:
    """Take a campaign from where its record stands to its budget, or until it is verified to be good enough.

    False when it was asked to stop before.

    Args:
        good_enough: whether the campaign's rule about its error may end it before its budget.
        failure_limit: share of numerical failures to stop above, instead of the campaign's.

    Raises:
        SimulationError: if the workers or too many of the simulations fail.
        StoreError: if a batch cannot be recorded.
    """
    observer = observer or Observer()
    batch = campaign.settings.sampling.batch
    limit = campaign.settings.limits.numerical_failures if failure_limit is None else failure_limit
    with one_thread():
        validation = _validation_set(campaign, store, executor, observer)
        initial = initial_designs(campaign)
        while (progress := standing(campaign, store.batches, budget)).done < len(initial):
            observer.progress(progress)
            _check_numerical_failures(progress, limit)
            if progress.done >= budget:
                # Nothing is learned from a part of the initial design: a later resume would start from it.
                return True
            if observer.stop():
                return False
            observer.stage("simulating the initial design")
            designs = initial[progress.done : min(progress.done + batch, budget)]
            _simulate_and_record(campaign, store, executor, 0, SEED, designs)

        observer.stage("learning")
        classifier = current_classifier(campaign, store, write=True)
        seconds = None
        while True:
            progress = standing(campaign, store.batches, budget)
            left = max(0, budget - progress.done)
            error = None
            if good_enough:
                error = _verified(campaign, store, executor, classifier, progress.iteration, observer)
            observer.progress(
                replace(
                    progress,
                    accuracy=None if validation is None else accuracy(classifier, campaign.severity, *validation),
                    seconds_left=None if seconds is None else seconds * -(-left // batch),
                    error=error,
                )
            )
            _check_numerical_failures(progress, limit)
            if left == 0 or _is_good_enough(campaign, error):
                return True
            if observer.stop():
                return False
            began = time.monotonic()
            iteration = progress.iteration + 1
            observer.stage("proposing")
            designs = next_batch(campaign, classifier, iteration, min(batch, left))
            observer.stage("simulating")
            _simulate_and_record(campaign, store, executor, iteration, ACTIVE, designs)
            observer.stage("learning")
            classifier = learn(campaign, store.batches, iteration, classifier)
            store.write_state(iteration, classifier_state(classifier))
            seconds = time.monotonic() - began


def _validation_set(
    campaign: Campaign, store: Store, executor: Executor, observer: Observer
) -> tuple[Array, NDArray[np.int8]] | None:
    size = campaign.settings.validation.size
    if size == 0:
        return None
    observer.stage("simulating the validation set")
    X = campaign.space.from_unit(stream(campaign.settings.seed, "validation").random((size, campaign.space.dimension)))
    return simulated_set(campaign, store, executor, "validation", X, observer.stop)


def _verified(
    campaign: Campaign, store: Store, executor: Executor, classifier: Classifier, iteration: int, observer: Observer
) -> ErrorEstimate | None:
    """The verified error, where the campaign's rule asks for it now and the classifier itself believes it may do."""
    rule = campaign.settings.stop
    if rule is None or iteration % rule.every or expected_error(campaign, classifier) > rule.error:
        return None
    observer.stage("verifying")
    return verify(
        campaign, store, executor, classifier, iteration, rule.simulations, rule.confidence, stop=observer.stop
    )


def _is_good_enough(campaign: Campaign, error: ErrorEstimate | None) -> bool:
    rule = campaign.settings.stop
    return rule is not None and error is not None and error.confidence_below(rule.error) >= rule.confidence
