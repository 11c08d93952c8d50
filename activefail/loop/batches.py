"""The campaign loop: propose, simulate, record and learn until the budget is spent."""

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.errors import InputError
from activefail.execution.executor import AsynchronousExecutor, Executor
from activefail.loop.asynchronous import run_asynchronously
from activefail.loop.choosing import choose
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.initial import initial_designs, initial_sets
from activefail.loop.learning import Learned, current
from activefail.loop.observed import ObservedExecutor
from activefail.loop.progress import Observer, standing
from activefail.loop.task import Task
from activefail.record.batch import CHECK, INITIAL, Batch
from activefail.record.store import Store
from activefail.space import Array
from activefail.surrogate.threads import one_thread
from activefail.verification.stored_sets import VALIDATION, simulated_set


def run(
    campaign: Campaign,
    store: Store,
    executor: AsynchronousExecutor,
    budget: int,
    observer: Observer | None = None,
    failure_limit: float | None = None,
    use_stop_rule: bool = True,
    resume_command: str = "activefail resume DIR",
) -> bool:
    """Continue a campaign from its record to its budget, or until its stop rule is met.

    Returns False if it was stopped before.

    Args:
        campaign: the campaign.
        store: its record.
        executor: runs the simulations.
        budget: simulations in all.
        observer: receives progress and faults, and requests a stop.
        failure_limit: largest accepted share of numerical failures; replaces the campaign's.
        use_stop_rule: whether the stop rule may end the campaign before its budget.
        resume_command: the command that continues the campaign, for messages.

    Raises:
        SimulationError: if the workers or too many of the simulations fail.
        StoreError: if a batch cannot be recorded.
    """
    observer = observer or Observer()
    observer.faults.clear()
    executor = ObservedExecutor(executor, observer.faults)
    limit = campaign.settings.limits.numerical_failures if failure_limit is None else failure_limit
    run_loop = run_asynchronously if campaign.settings.sampling.asynchronous else _run_in_batches
    with one_thread():
        validation = _validation_set(campaign, store, executor, observer)
        history = History.of(store.batches)
        initial = initial_designs(campaign, initial_sets(campaign, history))
        task = Task(
            campaign=campaign,
            store=store,
            executor=executor,
            budget=budget,
            observer=observer,
            failure_limit=limit,
            use_stop_rule=use_stop_rule,
            resume_command=resume_command,
            validation=validation,
            initial=initial,
            # Failures before the first outcome came from a simulator that has been fixed since.
            ignored_failures=history.leading_failures,
        )
        return run_loop(task)


def _run_in_batches(task: Task) -> bool:
    campaign, store, observer, budget = task.campaign, task.store, task.observer, task.budget
    batch, rule = campaign.settings.sampling.batch, campaign.settings.error_rule
    # Designs in flight are simulated elsewhere, and count towards the budget.
    handed_out = HandedOut.of(store)
    flight, initial = handed_out.in_flight, handed_out.initial_left(campaign)
    if (flight.origin == CHECK).any():
        raise InputError(_CHECK_IN_FLIGHT)
    iteration = handed_out.next_iteration(campaign)
    while len(initial):
        progress = standing(campaign, store.batches, budget)
        observer.progress(progress)
        task.check(progress)
        left = budget - progress.done - len(flight)
        if left <= 0:
            # Do not train on a part of the initial design: a later resume would start from that state.
            return True
        if observer.stop():
            return False
        observer.stage("simulating the initial design")
        designs, initial = np.split(initial, [min(batch, left)])
        _simulate_and_record(task, iteration, INITIAL, designs)

    task.check(progress := standing(campaign, store.batches, budget))
    if not History.of(store.batches).answered.any():
        task.check_simulator(progress)
        raise InputError(_NOTHING_KNOWN)
    observer.stage("learning")
    learned = current(campaign, store, write=True)
    seconds = None
    while True:
        progress = standing(campaign, store.batches, budget)
        left = max(0, budget - progress.done - len(flight))
        # Of an iteration that is not complete, another look would follow.
        verify_now = rule is not None and progress.iteration % rule.every == 0 and not len(flight)
        progress = task.judged(progress, learned.classifier, verify_now, learned.looks)
        observer.progress(replace(progress, seconds_left=None if seconds is None else seconds * -(-left // batch)))
        task.check(progress)
        if left == 0 or progress.stop_rule_met:
            return True
        if observer.stop():
            return False
        start = time.monotonic()
        iteration = progress.iteration + 1
        observer.stage("proposing")
        designs, origin = choose(campaign, HandedOut.of(store), learned, batch, left)
        if not len(designs):
            raise InputError(_NO_OTHERS)
        observer.stage("simulating")
        _simulate_and_record(task, iteration, origin, designs)
        observer.stage("learning")
        learned = Learned.after(campaign, History.of(store.batches), iteration, learned)
        store.write_state(iteration, learned.state)
        seconds = time.monotonic() - start


_CHECK_IN_FLIGHT = (
    "The stop rule's check is in flight. Record its results with `activefail tell`, or drop its designs with "
    "`activefail drop`, then resume."
)

_NO_OTHERS = (
    "All proposals were handed out before. Record results in flight with `activefail tell`, or other simulations with "
    "`activefail add`."
)

_NOTHING_KNOWN = (
    "The whole initial design is in flight or was dropped, so there is nothing to learn from yet. Record results "
    "in flight with `activefail tell`, or other simulations with `activefail add`."
)


def _simulate_and_record(task: Task, iteration: int, origin: int, designs: Array) -> None:
    results = task.executor.run(task.campaign.simulator, designs)
    task.store.commit(Batch(iteration, designs, np.full(len(designs), origin, dtype=np.int8), results))


def _validation_set(
    campaign: Campaign, store: Store, executor: Executor, observer: Observer
) -> tuple[Array, NDArray[np.int8]] | None:
    size = campaign.settings.validation.size
    if size == 0:
        return None
    observer.stage("simulating the validation set")
    X = campaign.space.from_unit(stream(campaign.settings.seed, "validation").random((size, campaign.space.dimension)))
    return simulated_set(campaign, store, executor, VALIDATION, X, observer.stop)
