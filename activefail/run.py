"""A run folder, open: the one object behind every command."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

from activefail.campaign.assembly import Campaign
from activefail.campaign.history import History
from activefail.campaign.loop import run as run_loop
from activefail.campaign.opening import create_folder, opened, read_campaign
from activefail.campaign.progress import Observer, Progress, standing
from activefail.campaign.summary import Summary
from activefail.errors import InputError
from activefail.record.layout import COMPARISON, REPORT, SETTINGS
from activefail.shares import percent
from activefail.surrogate.threads import one_thread
from activefail.visible import quoted

if TYPE_CHECKING:
    from activefail.campaign.findings import Findings
    from activefail.campaign.settings import CampaignSettings
    from activefail.campaign.verification import ErrorEstimate
    from activefail.comparison.static import Score
    from activefail.execution.executor import AsynchronousExecutor, Executor
    from activefail.record.run_folder import FolderStore
    from activefail.report.evidence import Evidence
    from activefail.space import DesignSpace
    from activefail.surrogate.classifier import Classifier


class Taken(NamedTuple):
    """How far a campaign was taken.

    Attributes:
        finished: whether it reached its budget or its stop rule; False where it was asked to stop before.
        progress: where it stands.
        first_fault: why the first simulation that was abandoned failed, with its design; empty if none was.
    """

    finished: bool
    progress: Progress
    first_fault: str


class Run:
    """A run folder, open: a campaign, its record, and what it has learned.

    `create_run` and `open_run` make one; it is a context manager that closes itself. One process at a time may have a
    folder open for writing; reading is safe meanwhile, and sees what was recorded when the folder was opened.

    Attributes:
        folder: of the run.
        campaign: the pieces that its settings name.
        store: its record.
    """

    def __init__(self, folder: Path, campaign: Campaign, store: "FolderStore", write: bool) -> None:
        self.folder, self.campaign, self.store = folder, campaign, store
        self._write = write
        self._classifier: Classifier | None = None

    # ------------------------------------------------------------------------------------------- what it is

    @property
    def settings(self) -> "CampaignSettings":
        """The campaign's settings, defaults written out."""
        return self.campaign.settings

    @property
    def space(self) -> "DesignSpace":
        """The design space."""
        return self.campaign.space

    @property
    def boundary(self) -> str:
        """The outcome whose boundary is (mainly) sought."""
        return self.settings.acquisition.main_boundary

    @property
    def history(self) -> History:
        """What was simulated so far."""
        return History.of(self.store.batches)

    @property
    def summary(self) -> Summary:
        """Where the campaign stands, in counts."""
        # The settings' text, not the file's: an older program may have left out what has a default now.
        return Summary.of(self.settings.text(), self.campaign.simulator.outcomes, self.store.batches)

    def resume_command(
        self,
        budget: int | None = None,
        failure_limit: float | None = None,
        ignore_stop: bool = False,
        executor: str = "",
    ) -> str:
        """The command that continues the campaign, ready to be pasted.

        Args:
            budget, failure_limit, ignore_stop: as for `take`.
            executor: options that name where simulations run.
        """
        command = resume_command(self.folder, self.campaign) + executor
        if ignore_stop:
            command += " --ignore-stop"
        if budget is not None:
            command += f" --budget {budget}"
        if failure_limit is not None:
            command += f" --numerical-failures {failure_limit:g}"
        return command

    @property
    def stop_rule_warning(self) -> str:
        """Why the stop rule cannot be met at its first look, where it has too few simulations; empty otherwise."""
        from activefail.campaign.stratified import largest_unseen_share
        from activefail.campaign.verification import confidence_of_look, least_simulations

        rule = self.settings.stop
        if rule is None or (least := least_simulations(rule.error, rule.confidence)) <= rule.simulations:
            return ""
        shown = largest_unseen_share(rule.simulations, confidence_of_look(rule.confidence, 1))
        return (
            f"stop.simulations: {rule.simulations} can show an error of at most {percent(shown)} at the first look, if "
            f"none of them is wrong; {100 * rule.error:g} % needs at least {least}"
        )

    def check_budget(self, budget: int | None) -> None:
        """Check that the campaign can be taken to a budget; its own if None.

        Raises:
            InputError: if it is below 2 or below what is done.
        """
        if budget is None:
            return
        if budget < 2:
            raise InputError(f"budget: must be at least 2, got {budget}.")
        if budget < (done := len(self.history)):
            raise InputError(f"budget: must be at least the {done} simulations that are done, got {budget}.")

    # ------------------------------------------------------------------------------------------- what it does

    def take(
        self,
        budget: int | None = None,
        failure_limit: float | None = None,
        ignore_stop: bool = False,
        executor: "AsynchronousExecutor | None" = None,
        observer: Observer | None = None,
        executor_options: str = "",
    ) -> Taken:
        """Take the campaign to its budget, or until its stop rule is met.

        Args:
            budget: simulations in all, instead of the campaign's.
            failure_limit: share of numerical failures to stop above, instead of the campaign's.
            ignore_stop: continue even if the stop rule is met.
            executor: where simulations run; this machine, all cores, if None.
            observer: is told of progress, and asks for a stop.
            executor_options: how a command line names the executor, for messages.

        Raises:
            InputError: if the budget is below 2 or below what is done.
            SimulationError: if the workers or too many of the simulations fail.
            StoreError: if a batch cannot be recorded.
        """
        self.check_budget(budget)
        if executor is None:
            with self._local_executor() as local:
                return self.take(budget, failure_limit, ignore_stop, local, observer, executor_options)
        target = self.settings.sampling.budget if budget is None else budget
        again = self.resume_command(ignore_stop=ignore_stop, executor=executor_options)
        finished = run_loop(
            self.campaign, self.store, executor, target, observer, failure_limit, not ignore_stop, again
        )
        self._classifier = None
        return Taken(finished, standing(self.campaign, self.store.batches, target), executor.first_fault)

    @property
    def classifier(self) -> "Classifier":
        """The classifier of all recorded simulations (see `learn`)."""
        return self.learn()

    def learn(self, stage: Callable[[str], None] = lambda _: None) -> "Classifier":
        """Learn from all recorded simulations, once; a run that is open for writing saves what it had to learn.

        Args:
            stage: is told when learning begins.

        Raises:
            InputError: if there is no simulation, or none with an answer, to learn from.
        """
        from activefail.campaign.learning import current_classifier

        if self._classifier is not None:
            return self._classifier
        if not len(self.history):
            raise InputError(
                f"{self.folder}: has no simulations to learn from yet; `{self.resume_command()}` continues it."
            )
        stage("learning")
        with one_thread():
            self._classifier = current_classifier(self.campaign, self.store, self._write)
        return self._classifier

    @property
    def findings(self) -> "Findings":
        """What the campaign has found so far."""
        from activefail.campaign.findings import findings_of

        with one_thread():
            return findings_of(self.folder, self.campaign, self.store, self.classifier)

    def predict_table(
        self, source: Path, target: Path, begin: Callable[[int], Callable[[int], None]] = lambda _: lambda _: None
    ) -> int:
        """Write the designs of a CSV file back with what the classifier predicts (see `campaign.tables`).

        Returns:
            How many designs lie outside the design space, where the classifier extrapolates.
        """
        from activefail.campaign.tables import predict_table

        classifier = self.classifier
        with one_thread():
            return predict_table(self.campaign, classifier, source, target, begin)

    def export_table(self, target: Path) -> int:
        """Write every simulation as a row of a CSV file; how many there were."""
        from activefail.campaign.tables import export_table

        return export_table(self.campaign, self.store, target)

    def verify(
        self, simulations: int = 200, confidence: float = 0.9, executor: "Executor | None" = None
    ) -> "ErrorEstimate":
        """The share of the design space that the classifier gets wrong, from fresh simulations outside the budget.

        Raises:
            InputError: if the initial design is not finished.
        """
        from activefail.campaign.proposing import initial_sets
        from activefail.campaign.verification import verify

        history = self.history
        if len(history) < self.settings.sampling.initial * initial_sets(self.campaign, history):
            raise InputError(f"{self.folder}: has not finished its initial design; there is nothing to verify yet.")
        classifier, iteration = self.classifier, history.last_iteration
        with nullcontext(executor) if executor else self._local_executor() as working, one_thread():
            return verify(self.campaign, self.store, working, classifier, iteration, simulations, confidence)

    def compare(
        self,
        budgets: list[int] | None = None,
        test_designs: int = 2000,
        stage: Callable[[str], None] = lambda _: None,
        executor: "Executor | None" = None,
    ) -> "list[Score]":
        """The campaign against static Latin hypercubes, judged on the same fresh designs; kept in the run folder.

        A table and a figure are written to the folder `compare` of the run.

        Args:
            budgets: numbers of simulations; six by default.
            test_designs: fresh ones to judge by.
            stage: is told what is done.
            executor: as for `take`.
        """
        from activefail.comparison.static import compare, write_scores
        from activefail.figures.curves import plot_learning_curves
        from activefail.figures.style import save_figure

        with nullcontext(executor) if executor else self._local_executor() as working:
            scores = compare(self.campaign, self.store, working, budgets, test_designs, stage)
        results = self.folder / COMPARISON
        results.mkdir(exist_ok=True)
        write_scores(scores, self.campaign.simulator.outcomes, test_designs, results / "scores.csv")
        figure = plot_learning_curves(scores, self.boundary, scores[0].test_designs)
        for suffix in ("png", "svg"):
            save_figure(figure, results / f"learning_curves.{suffix}")
        return scores

    def report(self, target: Path | None = None, stage: Callable[[str], None] = lambda _: None) -> "Evidence":
        """Write what the campaign has found as one HTML file; what the folder holds that judges it.

        Args:
            target: file to write; `report.html` in the run folder by default.
            stage: is told what is done.
        """
        from activefail.report.evidence import evidence_of
        from activefail.report.page import render, write_report

        classifier = self.classifier
        with one_thread():
            evidence = evidence_of(self.folder, self.campaign, self.store, classifier, stage)
            page = render(self.findings, evidence, self.store, stage)
        write_report(page, self.folder / REPORT if target is None else target)
        return evidence

    def _local_executor(self) -> "AsynchronousExecutor":
        from activefail.execution.local import local_executor

        return local_executor(self.campaign.simulator, time_limit=self.campaign.time_limit)

    # ------------------------------------------------------------------------------------------- opening, closing

    def close(self) -> None:
        """Let another process write to the folder."""
        self.store.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def create_run(folder: Path, campaign: Campaign | Path) -> Run:
    """A new run folder for a campaign, open for writing.

    Args:
        folder: to create.
        campaign: or its file, whose folder holds the user's code that it names.

    Raises:
        InputError: if the file is not valid, or the folder is in use.
        BusyError, StoreError: if the folder cannot be written.
    """
    if isinstance(campaign, Path):
        campaign = read_campaign(campaign, code=campaign.absolute().parent, run=folder)
    check_unused(folder, campaign)
    return Run(folder, campaign, create_folder(folder, campaign), write=True)


def check_unused(folder: Path, campaign: Campaign) -> None:
    """Check that a folder holds no campaign yet.

    Raises:
        InputError: with the command that continues the one it holds.
    """
    if (folder / SETTINGS).exists():
        again = resume_command(folder, campaign)
        raise InputError(f"{folder}: holds a campaign already; `{again}` continues it.")


def open_run(folder: Path, *, write: bool = False, code: Path | None = None, features: bool = True) -> Run:
    """The run in a folder.

    Args:
        folder: of the run.
        write: whether this process becomes its only writer.
        code: folder of the user's code, which is then run.
        features: whether custom features are needed.

    Raises:
        InputError: if there is no campaign in the folder or its settings are not valid.
        StoreError: if the record cannot be read.
        BusyError: if another process is writing to it.
    """
    return Run(folder, *opened(folder, write, code, features), write)


def resume_command(folder: Path, campaign: Campaign | None = None) -> str:
    """The command that continues a campaign, ready to be pasted; with the folder of the user's code."""
    command = f"activefail resume {quoted(folder)}"
    if campaign is None or (isinstance(campaign.settings.simulator, str) and not campaign.sources):
        return command
    return f"{command} --code {'FOLDER' if campaign.code is None else quoted(campaign.code)}"
