"""The asynchronous loop: it learns from each result as soon as it arrives, then starts another simulation.

Proposals depend on the order in which results arrived, which is the order of the record. The designs in flight
therefore follow from the record, and a resumed campaign simulates the same ones again. The number in flight is a
setting of the campaign; it does not depend on the number of workers.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.errors import DamagedError
from activefail.execution.executor import AsynchronousExecutor
from activefail.loop.history import History
from activefail.loop.initial import initial_designs, initial_sets
from activefail.loop.learning import Learned, current, learn, restore
from activefail.loop.probability_rule import (
    Looks,
    check_designs,
    check_looks,
    contradicted,
    has_clipped_margin,
    look,
    looks_from_state,
    looks_state,
    needs_check,
)
from activefail.loop.progress import standing
from activefail.loop.proposing import next_designs
from activefail.loop.task import Task
from activefail.record.batch import ACTIVE, CHECK, INITIAL, Batch
from activefail.record.store import Store
from activefail.reliability.hidden import designs_of_check, is_whole
from activefail.simulators.interface import Results, Simulator
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.state import classifier_state

_FLIGHT = "flight/designs"
"""Key of the designs in flight in a saved state."""

_WAITING, _ANSWERED, _KNOWN_THROUGH = "check/waiting", "check/answered", "check/known_through"
"""Keys of a check in a saved state."""

_WAIT = 0.5
"""Seconds between checks for a stop request."""


@dataclass(frozen=True)
class Course:
    """The state of an asynchronous campaign after a commit.

    Attributes:
        classifier: trained on the results so far; None until the whole initial design has been proposed.
        iteration: the last commit that the classifier has learned from; -1 before the first.
        flight: (k, d) proposed designs without a result, in the order of proposal. It does not shrink at the end of the
            budget: the last designs are the ones a larger budget would simulate first.
        looks: of a stop rule for a probability.
        check: the running check of that rule; None if none is running.
        known_through: number of simulations up to which a passed check holds: those in flight then were chosen before.
    """

    classifier: Classifier | None
    iteration: int
    flight: Array
    looks: Looks = field(default_factory=Looks)
    check: "_Check | None" = None
    known_through: int = 0

    @property
    def next_iteration(self) -> int:
        """Iteration of the next commit."""
        return 0 if self.classifier is None else self.iteration + 1

    def after(self, campaign: Campaign, batches: tuple[Batch, ...]) -> "Course":
        """The state after one more commit, the last of `batches`."""
        history = History.of(batches)
        pending = _without(self.flight, batches[-1].designs)
        proposed = len(history) + len(pending)
        free = max(0, campaign.settings.sampling.batch - len(pending))
        initial = initial_designs(campaign, initial_sets(campaign, history))
        flight = np.concatenate([pending, initial[proposed : proposed + free]])
        free -= len(flight) - len(pending)
        # Without any result there is nothing to learn from: wait for the designs in flight.
        if free == 0 or not history.answered.any():
            return replace(self, flight=flight)
        iteration = history.last_iteration
        classifier = learn(campaign, history, iteration, self.classifier)
        course = Course(classifier, iteration, flight, self.looks, self.check, self.known_through)
        if campaign.settings.probability_rule is not None:
            course = course._looked(campaign, history, batches[-1], self.classifier)
        flight = course.flight
        if course.check is not None:
            flight = np.concatenate([flight, _without(course.check.waiting, flight)[:free]])
            free -= len(flight) - len(course.flight)
        if free == 0:
            return replace(course, flight=flight)
        chosen = max(0, proposed - len(initial))
        rng = stream(campaign.settings.seed, "propose", iteration + 1)
        designs = next_designs(campaign, classifier, history, rng, q=free, chosen=chosen, pending=flight)
        return replace(course, flight=np.concatenate([flight, designs]))

    def _looked(self, campaign: Campaign, history: History, last: Batch, before: Classifier | None) -> "Course":
        """This course with the looks and the check after its last commit.

        Args:
            campaign: the campaign, with a stop rule for a probability.
            history: all simulations.
            last: the commit.
            before: the classifier before it.
        """
        rule = campaign.settings.probability_rule
        assert self.classifier is not None
        assert rule is not None
        looks, check, known_through = self.looks, self.check, self.known_through
        if check is not None and before is not None:
            of_check = last.origin == CHECK
            checked = History.of((last,))[of_check]
            if len(checked) and contradicted(campaign, before, checked).any():
                looks, check = Looks(), None
            else:
                check = _Check(_without(check.waiting, checked.designs), check.answered + int(checked.answered.sum()))
        row = look(campaign, history, self.iteration, self.classifier)
        if not len(row):
            return replace(self, looks=Looks(), check=None, known_through=0)
        looks = Looks(np.concatenate([looks.table, row]))
        if check is not None and not len(check.waiting):
            # Designs beside the check may have widened the posterior again.
            passed = is_whole(designs_of_check(campaign.space.dimension), check.answered) and looks.is_narrow(rule.cov)
            passed = passed and not has_clipped_margin(campaign, self.classifier)
            known_through = len(history) + len(self.flight) if passed else 0
            looks, check = Looks(row), None
        looks = replace(looks, is_known=len(history) <= known_through)
        if check is None and needs_check(campaign, history, looks):
            simulated = np.concatenate([history.designs, self.flight])
            rng = stream(campaign.settings.seed, "check", self.iteration + 1)
            check = _Check(check_designs(campaign, simulated, looks, rng), 0)
        return replace(self, looks=looks, check=check, known_through=known_through)

    def save(self, store: Store) -> None:
        """Save the classifier, the designs in flight, the looks and the check; the record gives all of them again."""
        if self.classifier is not None:
            state = classifier_state(self.classifier) | {_FLIGHT: self.flight} | looks_state(self.looks)
            if self.known_through:
                state[_KNOWN_THROUGH] = np.array(self.known_through)
            if self.check is not None:
                state |= {_WAITING: self.check.waiting, _ANSWERED: np.array(self.check.answered)}
            store.write_state(self.iteration, state)


@dataclass(frozen=True)
class _Check:
    """A running check of the stop rule for a probability.

    Attributes:
        waiting: (k, d) its designs without a result, in the order of proposal.
        answered: how many of the others gave an outcome.
    """

    waiting: Array
    answered: int


def resumed(campaign: Campaign, store: Store, write: bool = True) -> Course:
    """The state after the last commit, from the last saved state and the commits since.

    Args:
        campaign: the campaign.
        store: its record.
        write: whether to save a state that was computed again.
    """
    batches = store.batches
    course, first = Course(None, -1, initial_designs(campaign)[: campaign.settings.sampling.batch]), 0

    def check(iteration: int, state: Mapping[str, NDArray[Any]]) -> None:
        known = History.of(batches).through(iteration)
        _check_flight(campaign, known, state[_FLIGHT])
        check_looks(campaign, state)
        _check_from_state(campaign, known, state)

    if batches and (saved := restore(campaign, store, batches[-1].iteration, check)) is not None:
        iteration, state, classifier = saved
        known_through = int(state.get(_KNOWN_THROUGH, 0))
        check_running = _check_from_state(campaign, History.of(batches).through(iteration), state)
        course = Course(classifier, iteration, state[_FLIGHT], looks_from_state(state), check_running, known_through)
        first = 1 + max(index for index, batch in enumerate(batches) if batch.iteration == iteration)
    for end in range(first + 1, len(batches) + 1):
        course = course.after(campaign, batches[:end])
    if write and first < len(batches):
        course.save(store)
    return course


def learned_so_far(campaign: Campaign, store: Store, write: bool) -> Learned:
    """What an asynchronous campaign has learned from all recorded simulations, bit for bit as in the running loop.

    Args:
        campaign, store, write: as for `current`.
    """
    if campaign.settings.probability_rule is None:
        return current(campaign, store, write)
    course = resumed(campaign, store, write)
    return current(campaign, store, write) if course.classifier is None else Learned(course.classifier, course.looks)


def _check_flight(campaign: Campaign, known: History, flight: NDArray[np.generic]) -> None:
    """Check that a saved state's designs in flight are valid and have no result yet.

    Raises:
        DamagedError: if they are not.
    """
    shape = (campaign.settings.sampling.batch, campaign.space.dimension)
    if flight.dtype != np.float64 or flight.shape != shape:
        raise DamagedError(f"holds designs in flight of type {flight.dtype} and shape {flight.shape}, expected {shape}")
    designs = flight.astype(np.float64)
    if not campaign.space.contains(designs).all():  # false for NaN too
        raise DamagedError("holds designs in flight outside the design space")
    if len(_without(designs, known.designs)) < len(designs):
        raise DamagedError("holds designs in flight that already have a result")


def _check_from_state(campaign: Campaign, known: History, state: Mapping[str, NDArray[Any]]) -> _Check | None:
    """The check that was running when a state was saved; None if none was.

    Raises:
        DamagedError: if a campaign cannot save it.
    """
    designs_of = designs_of_check(campaign.space.dimension)
    most = {_ANSWERED: designs_of, _KNOWN_THROUGH: len(known) + campaign.settings.sampling.batch}
    for key, largest in most.items():
        if key in state and (
            state[key].dtype != np.int64 or state[key].shape != () or not 0 <= int(state[key]) <= largest
        ):
            raise DamagedError(f"holds {key} that is not a whole number from 0 to {largest}")
    if _WAITING not in state:
        return None
    waiting = state[_WAITING]
    if waiting.dtype != np.float64 or waiting.ndim != 2 or waiting.shape[1] != campaign.space.dimension:
        raise DamagedError(
            f"holds designs of a check that must be float64 of shape (n, {campaign.space.dimension}), got "
            f"{waiting.dtype} of shape {waiting.shape}"
        )
    designs = waiting.astype(np.float64)
    if not len(designs) or not campaign.space.contains(designs).all():  # false for NaN too
        raise DamagedError("holds designs of a check outside the design space, or none")
    if len(_without(designs, known.designs)) < len(designs):
        raise DamagedError("holds designs of a check that already have a result")
    if len(np.unique(designs, axis=0)) < len(designs) or len(designs) + int(state[_ANSWERED]) > designs_of:
        raise DamagedError(f"holds a check of duplicate designs, or of more than {designs_of}")
    return _Check(designs, int(state[_ANSWERED]))


def _without(flight: Array, answered: Array) -> Array:
    """The designs in flight that are not among the answered ones."""
    keys = {row.tobytes() for row in answered}
    return np.asarray(flight[np.array([row.tobytes() not in keys for row in flight], dtype=bool)])


class _Simulations:
    """The running simulations."""

    def __init__(self, executor: AsynchronousExecutor, simulator: Simulator) -> None:
        self._executor, self._simulator = executor, simulator
        self._designs: dict[int, Array] = {}
        self._tickets = 0

    def __len__(self) -> int:
        return len(self._designs)

    def start(self, designs: Array) -> None:
        """Start the simulations of the designs, (k, d), that are not running yet."""
        started = {design.tobytes() for design in self._designs.values()}
        for design in designs:
            if design.tobytes() not in started:
                self._designs[self._tickets] = design
                self._executor.start(self._simulator, self._tickets, design)
                self._tickets += 1

    def arrived(self, seconds: float) -> tuple[Array, Results] | None:
        """Designs, (k, d), and their results in order of arrival; None if none arrived within the time."""
        arrived = self._executor.answered(seconds)
        if not arrived:
            return None
        designs = np.stack([self._designs.pop(ticket) for ticket, _ in arrived])
        return designs, Results.concatenate([results for _, results in arrived])


def run_asynchronously(task: Task) -> bool:
    """Run an asynchronous campaign to its end; False if it was stopped before."""
    campaign, store, observer = task.campaign, task.store, task.observer
    observer.stage("learning")
    course = resumed(campaign, store)
    simulations = _Simulations(task.executor, campaign.simulator)
    initial = {design.tobytes() for design in task.initial}
    looks = _Looks.of(campaign, course, store.batches)
    start, done_at_start = time.monotonic(), standing(campaign, store.batches, task.budget).done
    ended = False
    while True:
        progress = standing(campaign, store.batches, task.budget)
        left = task.budget - progress.done
        if course.classifier is not None:
            progress = task.judged(progress, course.classifier, looks.due(progress.done), course.looks)
        rate = (progress.done - done_at_start) / (time.monotonic() - start)
        observer.progress(replace(progress, seconds_left=left / rate if rate and course.classifier else None))
        task.check(progress)
        ended = ended or left <= 0 or progress.stop_rule_met
        flight = course.flight[: max(0, left)]
        if ended:
            # What was in flight when a check passed belongs to the campaign, also if it was interrupted since.
            flight = flight[: max(0, course.known_through - progress.done) if course.looks.is_known else 0]
        arrived = _next_results(task, simulations, flight)
        if arrived is None:
            return ended
        designs, results = arrived
        checking = set() if course.check is None else {design.tobytes() for design in course.check.waiting}
        origin = np.array([_origin(design.tobytes(), initial, checking) for design in designs], dtype=np.int8)
        store.commit(Batch(course.next_iteration, designs, origin, results))
        observer.stage("learning")
        course = course.after(campaign, store.batches)
        course.save(store)


def _origin(design: bytes, initial: set[bytes], checking: set[bytes]) -> int:
    return INITIAL if design in initial else CHECK if design in checking else ACTIVE


def _next_results(task: Task, simulations: _Simulations, flight: Array) -> tuple[Array, Results] | None:
    """Start the designs in flight, unless a stop is requested, and wait for the next results; None if nothing runs."""
    while True:
        if not task.observer.stop():
            simulations.start(flight)
        if not simulations:
            return None
        task.observer.stage("simulating")
        if (arrived := simulations.arrived(_WAIT)) is not None:
            return arrived


@dataclass
class _Looks:
    """When the stop rule looks: as often as in a campaign with batches.

    Attributes:
        every: simulations between looks; infinite without a rule.
        looked: number of looks so far.
    """

    every: float
    looked: float

    @classmethod
    def of(cls, campaign: Campaign, course: Course, batches: tuple[Batch, ...]) -> "_Looks":
        """The looks of a resumed campaign. Looks before the last commit, or before the first classifier, are over."""
        rule = campaign.settings.error_rule
        every = np.inf if rule is None else campaign.settings.sampling.batch * rule.every
        return cls(every, 0 if course.iteration < 1 else len(History.of(batches[:-1])) // every)

    def due(self, done: int) -> bool:
        """Whether a new look is due after `done` simulations."""
        looks = done // self.every
        due = looks > self.looked
        self.looked = max(self.looked, looks)
        return due
