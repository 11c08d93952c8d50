"""A run folder, open: its campaign, its record, and what was learned from it."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Self

from activefail.errors import InputError
from activefail.learning.model.threads import one_thread, one_thread_of_blas
from activefail.loop.history import History
from activefail.record.batch import INITIAL
from activefail.session.arguments import check_whole
from activefail.session.display import shown_executor
from activefail.text.numerals import counted, duration
from activefail.text.progress import Stage, silent

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from activefail.campaign.assembly import Campaign
    from activefail.campaign.settings import CampaignSettings
    from activefail.estimates.probability_estimator import Estimator
    from activefail.execution.executor import AsynchronousExecutor, Executor
    from activefail.learning.features import FeatureMap
    from activefail.learning.model.classifier import Classifier
    from activefail.learning.model.saved import SavedClassifier
    from activefail.loop.asking import Proposed
    from activefail.loop.in_flight import HandedOut
    from activefail.loop.learning import Learned
    from activefail.record.run_folder import FolderStore
    from activefail.space.space import DesignSpace


class Session:
    """What every question to a run folder needs of it; `Run` adds the questions.

    Attributes:
        campaign: the components of the campaign.
        store: the record.
        writes: whether it is open for writing.
    """

    def __init__(self, folder: Path, campaign: "Campaign", store: "FolderStore", write: bool) -> None:
        self._named, self.campaign, self.store, self.writes = folder, campaign, store, write
        # Threads take turns: two that ask at once must not get the same designs.
        self._turn = threading.RLock()
        self._learned: Learned | None = None
        self._predicts: tuple[int | None, Classifier | SavedClassifier] | None = None

    @property
    def folder(self) -> Path:
        """The run folder, as it was named; its absolute path once the working directory has changed."""
        place = self.store.folder
        return self._named if self._named.absolute() == place else place

    @property
    def settings(self) -> "CampaignSettings":
        """The campaign's settings with all defaults."""
        return self.campaign.settings

    @property
    def space(self) -> "DesignSpace":
        """The design space."""
        return self.campaign.space

    @property
    def features(self) -> "FeatureMap":
        """The map from designs, (n, d) in the variables' units, to the scaled features, (n, m), of the classifier."""
        return self.campaign.features

    @property
    def boundary(self) -> str:
        """The outcome of the (main) target boundary."""
        return self.settings.acquisition.main_boundary

    @property
    def history(self) -> History:
        """The simulations so far."""
        return History.of(self.store.batches)

    @property
    def handed_out(self) -> "HandedOut":
        """The designs that were handed out, those in flight among them."""
        from activefail.loop.in_flight import HandedOut

        return HandedOut.of(self.store)

    @property
    def learns_from_margins(self) -> bool:
        """Whether boundaries may be learned from margins."""
        return self.settings.classifier.learns != "outcomes" and bool(self.campaign.simulator.margins)

    @property
    def can_be_asked(self) -> bool:
        """Whether enough is known for estimates: the initial design, or as many given simulations with an outcome.

        Given simulations are no sample of the design space, as they may have been chosen: no bound rests on them.
        """
        has_initial_design = bool(self.history.initial.any()) and is_past_initial_design(self)
        return has_initial_design or int(self.history.answered.sum()) >= self.settings.sampling.initial

    @property
    def classifier(self) -> "Classifier":
        """The classifier of all recorded simulations (see `learn`)."""
        return self.learn().classifier

    def learn(self, stage: Callable[[str], None] = silent) -> "Learned":
        """Learn from all recorded simulations, once; a run open for writing saves the classifier.

        Args:
            stage: called when training begins.

        Raises:
            InputError: if no simulation has an outcome.
        """
        from activefail.campaign.continuing import how_to_continue
        from activefail.loop.learning import current

        with self._turn:
            if not (simulations := len(self.history)):
                how = how_to_continue(self.folder, self.campaign)
                raise InputError(f"{self.folder}: has no simulations to learn from yet; {how}.")
            if self._learned is None or self._learned.simulations < simulations:
                stage("learning")
                with one_thread():
                    self._learned = current(self.campaign, self.store, self.writes, self._learned)
            return self._learned

    def classifier_after(self, simulations: int) -> "Classifier":
        """The classifier of the first simulations, numerical failures included.

        If the last of them ends a batch, the classifier is bit-identical to the campaign's at that time. Learning is
        repeated from the initial design on.

        Raises:
            InputError: if none of them has an outcome, or fewer are recorded.
        """
        from activefail.loop.learning import classifier_after

        first = first_simulations(self.history, simulations)
        if simulations == len(self.history):
            return self.classifier
        with one_thread():
            return classifier_after(self.campaign, first)

    def close(self) -> None:
        """Close the folder, so that another process can write to it."""
        self.store.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def first_simulations(history: History, number: int) -> History:
    """The first simulations of a record.

    Raises:
        InputError: if none of them has an outcome, or fewer are recorded.
    """
    check_whole("after", number, 1)
    if not history.answered.any():
        raise InputError(
            f"after: none of the {len(history)} recorded simulations has an outcome, so there is nothing to learn "
            f"from; got {number}."
        )
    if not history.leading_failures < number <= len(history):
        raise InputError(
            f"after: must be from {history.leading_failures + 1}, the first with an outcome, to {len(history)}, "
            f"the number of recorded simulations, got {number}."
        )
    return history[:number]


def is_past_initial_design(run: Session) -> bool:
    """Whether later designs are those that the criterion chooses."""
    handed_out = run.handed_out
    waiting = (handed_out.in_flight.origin == INITIAL).any()
    return bool(len(handed_out.history) and not waiting and not len(handed_out.initial_left(run.campaign)))


def check_can_be_asked(run: Session) -> None:
    """Check that fresh simulations can be weighed by what was learned.

    Raises:
        InputError: if too few simulations are known (see `Session.can_be_asked`).
    """
    if not run.can_be_asked:
        raise InputError(f"{run.folder}: has not finished its initial design; there is nothing to estimate yet.")


def boundary_named(run: Session, outcome: str | None) -> str:
    """The outcome of a boundary; that of the main target boundary if None.

    Raises:
        InputError: if no boundary has this outcome.
    """
    boundaries = run.campaign.simulator.outcomes[1:]
    if outcome is not None and outcome not in boundaries:
        raise InputError(f"outcome: must be one of {', '.join(boundaries)}, got {outcome!r}.")
    return run.boundary if outcome is None else outcome


def predicting(run: Session, after: int | None = None) -> "Classifier | SavedClassifier":
    """The classifier of all recorded simulations, or of the first ones, for predictions alone.

    It comes from the saved state where this is of all simulations, so that torch is not loaded, unless some designs
    did not exist, which no state has.
    """
    from activefail.loop.saved_learning import predicting, saved_current
    from activefail.simulators.interface import is_impossible

    with run._turn:
        if run._predicts is None or run._predicts[0] != after:
            predicts: Classifier | SavedClassifier | None = None
            history = run.history[:after]
            if is_impossible(run.campaign.simulator, history.outcome, history.cause).any():
                predicts = run.classifier if after is None else run.classifier_after(after)
            elif after is None and len(history):
                with one_thread_of_blas():
                    predicts = saved_current(run.campaign, run.store)
            if predicts is None:
                learned = run.classifier if after is None else run.classifier_after(after)
                predicts = predicting(run.campaign, learned, history)
            run._predicts = after, predicts
        return run._predicts[1]


def propose(run: Session, n: int, budget: int | None, ignore_stop: bool) -> "Proposed":
    """Hand out n designs; without a budget, beyond it too (see `loop.asking.ask`)."""
    from activefail.loop.asking import ask

    with run._turn, one_thread():
        proposed = ask(run.campaign, run.store, n, budget, ignore_stop, run._learned)
        run._learned = proposed.learned or run._learned
    return proposed


@contextmanager
def recording(run: Session, relearns: bool = False) -> Iterator[None]:
    """A block that adds to the record, alone; what predicts is then out of date, and with `relearns` what was learned.

    Only one thread at a time is in such a block.
    """
    with run._turn:
        try:
            yield
        finally:
            run._predicts = None
            if relearns:
                run._learned = None


def local_executor(run: Session, workers: int | None = None) -> "AsynchronousExecutor":
    """Cores of this machine, all of them if None.

    Raises:
        InputError: if simulations are made elsewhere.
    """
    from activefail.execution.local import local_executor

    run.campaign.check_simulates()
    return local_executor(run.campaign.simulator, workers, run.campaign.time_limit)


def executor_of(run: Session, executor: "Executor | None") -> "AbstractContextManager[Executor]":
    """An executor that the user has, as a context; otherwise all cores of this machine, with a progress bar."""
    return nullcontext(executor) if executor else shown_executor(local_executor(run))


@contextmanager
def estimating(
    run: Session, executor: "Executor | None" = None, stage: Stage = silent, simulates: bool = True
) -> Iterator["Estimator"]:
    """What estimates probabilities with the present classifier, and simulates unless nothing is to be simulated.

    Raises:
        InputError: if the initial design is not finished.
    """
    from activefail.estimates.probability_estimator import Estimator

    check_can_be_asked(run)
    with executor_of(run, executor) if simulates else nullcontext(executor) as pool, one_thread():
        learned, kept = run.learn(stage), list[str]()

        def announce(simulations: int) -> None:
            kept[:] = ["simulations are kept; the same command continues"]
            seconds = [one for batch in run.store.batches for one in batch.results.seconds.tolist() if one > 0.0]
            rounds = -(-simulations // getattr(pool, "workers", 1))
            about = f", {duration(sum(seconds) / len(seconds) * rounds)}" if seconds else ""
            stage(f"simulating {counted(simulations, 'fresh design')}{about}")

        try:
            yield Estimator(
                run.campaign, run.store, pool, learned.classifier, run.history.last_iteration, announce=announce
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(*kept) from None
