"""The loop without batches: as soon as a simulation is answered, its answer is learned and another one is begun.

Proposals depend on the order in which results arrive, which is the order of the record. So the record says all: the
designs in flight, those that were asked for and have no answer yet, follow from it and are asked for again where a
campaign was interrupted. How many are in flight is a setting of the campaign, not the number of workers.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.history import History
from activefail.campaign.learning import learn, restore
from activefail.campaign.progress import standing
from activefail.campaign.proposing import initial_designs, initial_sets, next_designs
from activefail.campaign.task import Task
from activefail.errors import DamagedError
from activefail.execution.executor import AsynchronousExecutor
from activefail.record.batch import ACTIVE, SEED, Batch
from activefail.record.store import Store
from activefail.simulators.interface import Results, Simulator
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.state import classifier_state

_FLIGHT = "flight/designs"
"""In a saved state, beside what was learned."""

_WAIT = 0.5
"""Seconds between two looks at whether the user asks for a stop."""


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
        history = History.of(batches)
        left = _without(self.flight, batches[-1].designs)
        asked = len(history) + len(left)
        lacking = max(0, campaign.settings.sampling.batch - len(left))
        initial = initial_designs(campaign, initial_sets(campaign, history))
        flight = np.concatenate([left, initial[asked : asked + lacking]])
        lacking -= len(flight) - len(left)
        # As long as there is nothing to learn from, what is in flight is waited for.
        if lacking == 0 or not history.answered.any():
            return Course(self.classifier, self.iteration, flight)
        iteration = history.last_iteration
        classifier = learn(campaign, history, iteration, self.classifier)
        chosen = max(0, asked - len(initial))
        more = next_designs(campaign, classifier, history, iteration + 1, lacking, chosen, flight)
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
        _check_flight(campaign, History.of(batches).through(iteration), state[_FLIGHT])

    if batches and (saved := restore(campaign, store, batches[-1].iteration, check)) is not None:
        iteration, state, classifier = saved
        course = Course(classifier, iteration, state[_FLIGHT])
        begin = 1 + max(place for place, batch in enumerate(batches) if batch.iteration == iteration)
    for end in range(begin + 1, len(batches) + 1):
        course = course.after(campaign, batches[:end])
    if begin < len(batches):
        course.save(store)
    return course


def _check_flight(campaign: Campaign, known: History, flight: NDArray[np.generic]) -> None:
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
    if len(_without(designs, known.designs)) < len(designs):
        raise DamagedError("holds designs in flight that were answered before")


def _without(flight: Array, answered: Array) -> Array:
    """Designs in flight but for those that were answered."""
    gone = {row.tobytes() for row in answered}
    return np.asarray(flight[np.array([row.tobytes() not in gone for row in flight], dtype=bool)])


class _Simulations:
    """The simulations that were started and have no answer yet.

    Args:
        executor, simulator: by which they run.
    """

    def __init__(self, executor: AsynchronousExecutor, simulator: Simulator) -> None:
        self._executor, self._simulator = executor, simulator
        self._designs: dict[int, Array] = {}
        self._tickets = 0

    def __len__(self) -> int:
        return len(self._designs)

    def start(self, designs: Array) -> None:
        """Start those of some designs, (k, d), that were not started yet."""
        started = {design.tobytes() for design in self._designs.values()}
        for design in designs:
            if design.tobytes() not in started:
                self._designs[self._tickets] = design
                self._executor.start(self._simulator, self._tickets, design)
                self._tickets += 1

    def answered(self, seconds: float) -> tuple[Array, Results] | None:
        """Designs, (k, d), and their answers in the order of their coming; None where none came within so long."""
        answers = self._executor.answered(seconds)
        if not answers:
            return None
        designs = np.stack([self._designs.pop(ticket) for ticket, _ in answers])
        return designs, Results.concatenate([results for _, results in answers])


def run_asynchronously(task: Task) -> bool:
    """Take a campaign without batches to its end; False when it was asked to stop before."""
    campaign, store, observer = task.campaign, task.store, task.observer
    observer.stage("learning")
    course = resumed(campaign, store)
    simulations = _Simulations(task.executor, campaign.simulator)
    initial = {design.tobytes() for design in task.initial}
    looks = _Looks.of(campaign, course, store.batches)
    began, before = time.monotonic(), standing(campaign, store.batches, task.budget).done
    ended = False
    while True:
        progress = standing(campaign, store.batches, task.budget)
        left = task.budget - progress.done
        if course.classifier is not None:
            progress = task.judged(progress, course.classifier, looks.due(progress.done))
        rate = (progress.done - before) / (time.monotonic() - began)
        observer.progress(replace(progress, seconds_left=left / rate if rate and course.classifier else None))
        task.check(progress)
        ended = ended or left <= 0 or progress.good_enough
        answered = _next_answers(task, simulations, course.flight[: max(0, left)], ended)
        if answered is None:
            return ended
        designs, results = answered
        origin = np.array([SEED if design.tobytes() in initial else ACTIVE for design in designs], dtype=np.int8)
        store.commit(Batch(course.next_iteration, designs, origin, results))
        observer.stage("learning")
        course = course.after(campaign, store.batches)
        course.save(store)


def _next_answers(task: Task, simulations: _Simulations, flight: Array, ended: bool) -> tuple[Array, Results] | None:
    """The answers that come next, once what is in flight was started; None where nothing is in flight any more.

    Args:
        flight: designs to start.
        ended: whether no more are started, and those that were are waited for; so it is where the user asks for a stop.
    """
    while True:
        ended = ended or task.observer.stop()
        if not ended:
            simulations.start(flight)
        if not simulations:
            return None
        task.observer.stage("simulating")
        if (answered := simulations.answered(_WAIT)) is not None:
            return answered


@dataclass
class _Looks:
    """When a stop rule looks: as often as with batches.

    Attributes:
        every: simulations from one look to the next; infinitely many without a rule.
        looked: how many looks were due so far.
    """

    every: float
    looked: float

    @classmethod
    def of(cls, campaign: Campaign, course: Course, batches: tuple[Batch, ...]) -> "_Looks":
        """The looks of a campaign that is resumed.

        What was due before the last commit is not due again, nor was anything before there was a classifier.
        """
        rule = campaign.settings.stop
        every = np.inf if rule is None else campaign.settings.sampling.batch * rule.every
        return cls(every, 0 if course.iteration < 1 else len(History.of(batches[:-1])) // every)

    def due(self, done: int) -> bool:
        """Whether one is due after so many simulations, that was not due before."""
        looks = done // self.every
        due = looks > self.looked
        self.looked = max(self.looked, looks)
        return due
