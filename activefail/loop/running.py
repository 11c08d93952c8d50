"""The loop: ask for designs, simulate them, tell their results, until the budget is spent or the stop rule is met.

A campaign in batches waits for all designs in flight before it asks again; an asynchronous one asks as soon as a result
has arrived. What is in flight is in the record before it is simulated, so an interrupted campaign simulates just that.
"""

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.errors import InputError, SimulationError
from activefail.estimates.error import verify_by_rule
from activefail.estimates.probability_estimator import Estimator
from activefail.estimates.scores import CurvePoint, remember_point, score
from activefail.estimates.stored_sets import VALIDATION, first_fault_text, simulated_set
from activefail.execution.executor import AsynchronousExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.asking import ask
from activefail.loop.history import History
from activefail.loop.in_flight import HandedOut
from activefail.loop.initial import initial_size
from activefail.loop.learning import Learned, current
from activefail.loop.progress import ObservedExecutor, Observer, Progress, standing
from activefail.loop.stop_rule import how_met, note_met
from activefail.loop.telling import record
from activefail.record.asked import Asked
from activefail.record.batch import CHECK, INITIAL
from activefail.record.store import Store
from activefail.simulators.command import CommandSimulator
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.simulators.repeats import IF_DIFFERENT, differences
from activefail.space.space import Array

_WAIT = 0.5
"""Seconds between checks for a stop request."""

_REPEATS = ("repeats",)
"""Under which a store keeps what is wrong with a second result of one design; empty if nothing is."""

_SAME = 1e-3
"""Largest difference of two results' margins that is no noise, over the largest margin so far."""

_LEAST_FOR_RATE = 20
"""Fewest simulations for which the share of numerical failures is checked."""


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
        InputError: if all designs that could be simulated next are in flight elsewhere.
        SimulationError: if the workers, all simulations so far or too many of them fail.
        StoreError: if designs or results cannot be recorded.
    """
    observer = observer or Observer()
    observer.faults.clear()
    if different := store.recall(_REPEATS):
        raise SimulationError(different)
    loop = _Loop(
        campaign=campaign,
        store=store,
        executor=ObservedExecutor(executor, observer.faults),
        budget=budget,
        observer=observer,
        failure_limit=campaign.settings.limits.numerical_failures if failure_limit is None else failure_limit,
        use_stop_rule=use_stop_rule,
        resume_command=resume_command,
        before=History.of(store.batches),
    )
    with one_thread():
        return loop.run()


@dataclass(frozen=True, kw_only=True)
class _Loop:
    """One call of `run`.

    Attributes:
        before: the simulations when it began. A simulator that gave no outcome until then has been fixed since.
        running: the designs that are being simulated one by one, by their ids.
    """

    campaign: Campaign
    store: Store
    executor: AsynchronousExecutor
    budget: int
    observer: Observer
    failure_limit: float
    use_stop_rule: bool
    resume_command: str
    before: History
    running: dict[int, Asked] = field(default_factory=dict)

    def run(self) -> bool:
        """Ask, simulate and tell until the budget is spent, or the stop rule or a request ends it."""
        campaign, store, observer, sampling = self.campaign, self.store, self.observer, self.campaign.settings.sampling
        learned: Learned | None = None
        validation, ended, reason = self.validation_set(), "", ""
        start, done_at_start = time.monotonic(), self.before.asked_for
        while True:
            handed = HandedOut.of(store)
            own, room = handed.in_flight[handed.in_flight.loop == 1], handed.room(self.budget)
            progress = standing(campaign, handed.history, self.budget)
            # What others simulate counts towards the budget too.
            flight = own[: max(0, self.budget - progress.done - (len(handed.in_flight) - len(own)))]
            waits_for_all = not sampling.asynchronous or (handed.asked.origin[-1:] == CHECK).any()
            free = 0 if waits_for_all and len(own) else min(room, sampling.batch - len(own))
            if (free > 0 or not len(flight)) and handed.can_learn(campaign):
                observer.stage("learning")
                learned = current(campaign, store, write=True, before=learned)
                looks_now = not ended and len(own) == len(handed.in_flight) and _is_look_due(campaign, handed.history)
                progress = self.judged(progress, handed.history, learned, looks_now, validation)
                rate = (progress.done - done_at_start) / max(time.monotonic() - start, 1e-9)
                progress = replace(progress, seconds_left=(self.budget - progress.done) / rate if rate else None)
            observer.progress(progress)
            self.check(progress, learned)
            ended, stopped = ended or progress.stop_rule, observer.stop()
            while free > 0 and not ended and not stopped:
                if handed.can_learn(campaign):
                    observer.stage("proposing")
                proposed = ask(campaign, store, free, self.budget, ignore_stop=True, before=learned, loop=True)
                flight, reason = Asked.joined([flight, proposed.designs]), proposed.reason
                learned = proposed.learned or learned
                # Beside the last designs of the initial design, others may learn from its first results.
                free = free - len(proposed.designs) if len(proposed.designs) and not waits_for_all else 0
            if not len(flight):
                if ended or not room:
                    note_met(store, ended)
                    return True
                if stopped:
                    return False
                is_simulators_fault = progress.done and not progress.counts.any()
                text = _NOTHING.format(reason) + first_fault_text(observer.faults)
                raise SimulationError(text) if is_simulators_fault else InputError(text)
            answered = self.answered(flight)
            if answered is None:
                return bool(ended)
            record(store, *answered)
            self.check_repeats(*answered)

    def validation_set(self) -> tuple[Array, NDArray[np.int8]] | None:
        """Designs and outcomes of the validation set; None if the campaign has none."""
        settings, space = self.campaign.settings, self.campaign.space
        if settings.validation.size == 0:
            return None
        self.observer.stage("simulating the validation set")
        X = space.random(settings.validation.size, stream(settings.seed, "validation"))
        return simulated_set(self.campaign, self.store, self.executor, VALIDATION, X, self.observer.stop)

    def judged(
        self,
        progress: Progress,
        history: History,
        learned: Learned,
        looks_now: bool,
        validation: tuple[Array, NDArray[np.int8]] | None,
    ) -> Progress:
        """The progress with the classifier's accuracy, its verified error, and what is known of a probability."""
        classifier, looks, error, is_small = learned.classifier, learned.looks, None, False
        # A campaign with an unseen outcome never meets its stop rule, so verifying it would waste simulations.
        if self.use_stop_rule and looks_now and not progress.unseen:
            self.observer.stage("verifying")
            estimator = Estimator(self.campaign, self.store, self.executor, classifier, progress.iteration)
            error, is_small = verify_by_rule(estimator, self.observer.stop)
        scored = None
        if validation is not None:
            scored = score("active", classifier, self.campaign.severity, len(history), *validation)
            found = {name: one.share for name, one in scored.recall.items() if one.total}
            progress = replace(progress, accuracy=scored.accuracy, recall=found)
        if len(looks.table):
            progress = replace(progress, looks=looks)
        of_rule = looks.interval if len(looks.table) else None
        remember_point(self.store, learned.iteration, CurvePoint(len(history), scored, of_rule))
        how = how_met(self.campaign, history, looks, is_small) if self.use_stop_rule else ""
        return replace(progress, error=error, stop_rule=how)

    def check(self, progress: Progress, learned: Learned | None) -> None:
        """Check that not all, and not too many, simulations failed numerically.

        Near failure many solvers give up: up to half of the simulations may fail among others that failed.

        Raises:
            SimulationError: if they did.
        """
        if progress.done >= min(initial_size(self.campaign, self.before), self.budget) and not progress.counts.any():
            first = cause_name(self.campaign.simulator.causes, int(self.store.batches[0].results.cause[0]))
            size = self.campaign.settings.sampling.initial
            needed = (progress.done // size + 1) * size
            raise SimulationError(
                f"None of the {progress.done} simulations gave an outcome, so there is nothing to learn from. They are "
                f"recorded; the campaign stops here. The first failed with cause `{first or 'unnamed'}`. Fix the "
                f"simulator, then `{self.resume_command}{f' --budget {needed}' if self.budget < needed else ''}` "
                f"continues with a new initial design." + first_fault_text(self.observer.faults)
            )
        # Those before the first outcome are forgiven when the campaign resumes.
        forgiven = self.before.leading_failures
        done, failures = progress.done - forgiven, progress.numerical_failures - forgiven
        is_above = done >= _LEAST_FOR_RATE and failures > self.failure_limit * done
        excused = min(learned.classifier.expected_losses, done // 2) if is_above and learned is not None else 0
        if is_above and failures - excused > self.failure_limit * done:
            advice = (
                f". Fix the simulator, then `{self.resume_command}` continues."
                if failures == done
                else f"; `{self.resume_command} --numerical-failures SHARE` allows more."
            )
            raise SimulationError(
                f"{failures} of {done} simulations failed numerically, {excused} of them excused by others near them: "
                f"more than the share of {self.failure_limit:g} that limits.numerical_failures allows. simulator.lost "
                "says what such a run means, near failure often failure itself. They are recorded; the campaign stops "
                f"here. `activefail export` shows their causes{advice}" + first_fault_text(self.observer.faults)
            )

    def check_repeats(self, designs: Asked, results: Results) -> None:
        """Simulate one design again, once in a campaign whose file does not say whether its simulator repeats.

        Raises:
            SimulationError: if the two results differ.
        """
        simulator, store, rows = self.campaign.simulator, self.store, np.flatnonzero(results.outcome >= 0)
        custom = self.campaign.settings.simulator
        is_told = isinstance(custom, str) or custom.repeatable is not None
        if is_told or not len(rows) or store.recall(_REPEATS) is not None or self.observer.stop():
            return
        # The recorded run keeps its folder.
        second = replace(simulator, repeatable=False) if isinstance(simulator, CommandSimulator) else simulator
        again = self.executor.run(second, designs.designs[rows[:1]])
        if again.outcome[0] == NUMERICAL_FAILURE:
            return  # which shows nothing
        margins = np.nan_to_num(History.of(store.batches).margins, nan=0.0, posinf=0.0, neginf=0.0)
        tolerance = _SAME * np.abs(margins).max(axis=0)
        text = differences(simulator, results[rows[:1]], again, tolerance)
        if text:
            text = (
                f"The design with id {designs.id[rows[0]]} has two results: {text}. {IF_DIFFERENT} Begin the campaign "
                "in another folder then; `activefail export` here and `activefail add` there keep the results so far."
            )
        store.remember(_REPEATS, text)
        if text:
            raise SimulationError(text)

    def answered(self, flight: Asked) -> tuple[Asked, Results] | None:
        """Simulate the designs in flight: in batches all of them, otherwise until some have results.

        After a request to stop none is started; None if none is running then.
        """
        simulator, executor, observer = self.campaign.simulator, self.executor, self.observer
        observer.stage("simulating the initial design" if (flight.origin == INITIAL).all() else "simulating")
        if not self.campaign.settings.sampling.asynchronous:
            return None if observer.stop() else (flight, executor.run(simulator, flight.designs))
        while True:
            if not observer.stop():
                for row, number in enumerate(flight.id.tolist()):
                    if number not in self.running:
                        self.running[number] = flight[row : row + 1]
                        executor.start(simulator, number, flight.designs[row])
            if not self.running:
                return None
            if arrived := executor.answered(_WAIT):
                designs = Asked.joined([self.running.pop(number) for number, _ in arrived])
                return designs, Results.concatenate([results for _, results in arrived])


_NOTHING = (
    "Nothing can be simulated: {}. Record results of designs in flight with `activefail tell`, drop them with "
    "`activefail drop`, or record other simulations with `activefail add`. Then resume."
)


def _is_look_due(campaign: Campaign, history: History) -> bool:
    """Whether the last iteration completed as many simulations as lie between two looks at the error."""
    rule, sampling = campaign.settings.error_rule, campaign.settings.sampling
    if rule is None:
        return False
    before = history.through(history.last_iteration - 1)
    looks = [(one.asked_for - sampling.initial) // (sampling.batch * rule.every) for one in (before, history)]
    return looks[0] < looks[1]
