"""`Run`: a run folder, open; the commands on run folders are its methods."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from activefail.analyses.findings.summary import Summary
from activefail.campaign.assembly import check_enough_designs
from activefail.campaign.continuing import resume_command
from activefail.campaign.inquiry import Inquiry
from activefail.errors import InputError
from activefail.learning.model.threads import one_thread, one_thread_of_blas
from activefail.loop.progress import Observer, Progress, standing
from activefail.run import analyses, exchange
from activefail.session.arguments import check_whole, source_of, target_of
from activefail.session.display import display_with_stop
from activefail.session.session import (
    Session,
    boundary_named,
    first_simulations,
    is_past_initial_design,
    local_executor,
    predicting,
    recording,
)
from activefail.text.files import path_of
from activefail.text.progress import Begin, silent, uncounted
from activefail.visible import or_worse, words

if TYPE_CHECKING:
    from pandas import DataFrame

    from activefail.analyses.findings.ending import StopMessages
    from activefail.analyses.findings.failure import FailureFindings
    from activefail.analyses.findings.results import Findings
    from activefail.campaign.question import Question
    from activefail.execution.executor import AsynchronousExecutor
    from activefail.text.csv_table import Source, Target


class Taken(NamedTuple):
    """The result of `Run.take`.

    Attributes:
        finished: whether the campaign reached its budget or its stop rule; False if it was stopped before.
        progress: of the campaign.
        first_fault: why the first simulation without a result failed, with its design; empty if all have one.
        stop_rule: how the stop rule ended the campaign before its budget, or why it cannot; empty otherwise.
    """

    finished: bool
    progress: Progress
    first_fault: str
    stop_rule: str

    @property
    def warning(self) -> str:
        """The warning about simulations without a result; empty if there are none."""
        return self.first_fault and f"simulations failed and gave no result; the first one: {self.first_fault}"


class Run(Session):
    """An open run folder: a campaign, its record and its classifier.

    `create_run` and `open_run` return one; use it as a context manager to close it. Only one process at a time can open
    a folder for writing. Reading is safe meanwhile and sees the record as of opening.

    Attributes:
        campaign: the components of the campaign.
        store: the record.
        writes: whether it is open for writing.
    """

    # ------------------------------------------------------------------------------------------- the campaign

    @property
    def summary(self) -> Summary:
        """The state of the campaign in counts."""
        return Summary.of_run(self)

    def summary_after(self, simulations: int) -> Summary:
        """The state of the campaign after its first simulations, in counts."""
        return Summary.of_run(self, first_simulations(self.history, simulations))

    @property
    def counts(self) -> dict[str, int]:
        """Simulations so far by outcome, then `numerical_failure` and the designs `in_flight`."""
        history, outcomes = self.history, self.campaign.simulator.outcomes
        counts = dict(zip(outcomes, history.counts(len(outcomes)).tolist(), strict=True))
        failures = len(history.failed_designs)
        return {**counts, "numerical_failure": failures, "in_flight": len(self.handed_out.in_flight)}

    def resume_command(
        self,
        budget: int | None = None,
        failure_limit: float | None = None,
        ignore_stop: bool = False,
        executor_options: str = "",
        changes_code: bool = False,
    ) -> str:
        """The command that continues the campaign, quoted for a shell.

        Args:
            budget, failure_limit, ignore_stop, executor_options: as for `take`.
            changes_code: whether the user changes the custom code before; the command must then name its folder.
        """
        options = executor_options + " --ignore-stop" * ignore_stop
        options += "" if budget is None else f" --budget {budget}"
        options += "" if failure_limit is None else f" --numerical-failures {failure_limit:g}"
        return resume_command(self.folder, self.campaign, changes_code) + options

    @property
    def stop_messages(self) -> "StopMessages":
        """The messages about a stop of the campaign."""
        from activefail.analyses.findings.ending import stop_messages

        return stop_messages(self.settings)

    @property
    def stop_rule_warning(self) -> str:
        """Why the stop rule cannot be met, or not at its first look; empty if it can."""
        from activefail.analyses.findings.ending import stop_rule_warning

        return stop_rule_warning(self.settings, self.learns_from_margins)

    def check_budget(self, budget: int | None) -> None:
        """Check a budget that replaces the campaign's; None is valid.

        Raises:
            InputError: if it is no whole number, below 2 or below the number of recorded simulations that count
                towards it.
        """
        if budget is None:
            return
        check_whole("budget", budget, 2)
        if self.campaign.settings.is_repeatable:
            check_enough_designs(self.space, budget)
        if budget < (done := self.history.asked_for):
            raise InputError(
                f"budget: must be at least {done}, the number of recorded simulations that count towards it, got "
                f"{budget}."
            )

    def take(
        self,
        budget: int | None = None,
        *,
        workers: int | None = None,
        progress: bool = True,
        failure_limit: float | None = None,
        ignore_stop: bool = False,
        executor: "AsynchronousExecutor | None" = None,
        observer: Observer | None = None,
        executor_options: str = "",
    ) -> Taken:
        """Run the campaign to its budget, or until its stop rule is met.

        Args:
            budget: total number of simulations; replaces the campaign's.
            workers: parallel simulations; all cores if None.
            progress: whether to show the progress, as the command line does, and to let Ctrl-C end the campaign after
                the current batch. Without it, Ctrl-C raises KeyboardInterrupt; recorded simulations are safe.
            failure_limit: largest accepted share of numerical failures; replaces the campaign's.
            ignore_stop: continue even if the stop rule is met.
            executor: runs the simulations, in place of this machine's cores.
            observer: receives progress and requests a stop, in place of `progress`.
            executor_options: command-line options that select the executor, for messages.

        Raises:
            InputError: if the budget is below 2 or below the number of recorded simulations.
            SimulationError: if the workers or too many of the simulations fail.
            StoreError: if a batch cannot be recorded.
        """
        from activefail.analyses.findings.ending import too_small_for_rule
        from activefail.loop.running import run
        from activefail.loop.stop_rule import noted

        self.check_budget(budget)
        self.campaign.check_simulates()
        target = self.settings.sampling.budget if budget is None else budget
        with ExitStack() as stack:
            if executor is None:
                executor = stack.enter_context(local_executor(self, workers))
            if observer is None:
                shown = display_with_stop(self.campaign, self.stop_messages.requested)
                observer = stack.enter_context(shown) if progress else Observer()
            # The loop records results and saves newer states, also if it fails later.
            stack.enter_context(recording(self, relearns=True))
            finished = run(
                self.campaign,
                self.store,
                executor,
                target,
                observer,
                failure_limit=failure_limit,
                use_stop_rule=not ignore_stop,
                # It follows the advice to fix the simulator.
                resume_command=self.resume_command(None, None, ignore_stop, executor_options, changes_code=True),
            )
        reached = standing(self.campaign, self.history, target)
        stop_rule = noted(self.store) if finished and not ignore_stop else ""
        if finished and not stop_rule and self.settings.probability_rule is not None:
            looks = self.learn().looks
            stop_rule = too_small_for_rule(self.settings, looks.probability) if len(looks.table) else ""
        return Taken(finished, reached, next(iter(observer.faults), ""), stop_rule)

    # ------------------------------------------------------------------------------------------- tables

    @property
    def simulations(self) -> "DataFrame":
        """The simulations so far, in the order of the record, with the columns of `activefail export`."""
        from activefail.analyses.findings.tables import simulations_frame

        return simulations_frame(self.campaign, self.store)

    @property
    def corrections(self) -> "DataFrame":
        """The corrected results, in the order of their correction.

        The columns are `id`, then `former_outcome`, `former_cause` and `former_<margin>` of the result that was
        replaced, then `outcome`, `cause` and the margins of the one that replaced it.
        """
        from activefail.analyses.findings.tables import corrections_frame

        return corrections_frame(self.campaign, self.store)

    @property
    def in_flight(self) -> "DataFrame":
        """The designs in flight: `id`, the variables in their units, and the fixed quantities."""
        from activefail.analyses.findings.tables import designs_frame

        return designs_frame(self.campaign, self.handed_out.in_flight)

    ask = exchange.ask
    tell = exchange.tell
    is_told = exchange.is_told
    drop = exchange.drop
    add = exchange.add

    def export_table(self, target: "Target | str") -> int:
        """Write every simulation as a row of a CSV table, a file or a text stream; returns their number."""
        from activefail.analyses.findings.tables import export_table

        return export_table(self.campaign, self.store, target_of("target", target))

    def export_parquet(self, target: Path | str) -> int:
        """Write every simulation as a row of a Parquet file; returns their number (needs pyarrow)."""
        from activefail.analyses.findings.tables import export_parquet

        return export_parquet(self.campaign, self.store, path_of("target", target))

    # ------------------------------------------------------------------------------------------- what was learned

    def classifier_in_words(self, after: int | None = None) -> str:
        """How many results the classifier that predicts has learned from, and what is known of its error.

        Args:
            after: number of simulations to learn from, the first ones (see `classifier_after`); all if None.
        """
        from activefail.analyses.findings.learned_from import known_in_words

        return known_in_words(self, after)

    @property
    def learned_from(self) -> list[str]:
        """What each boundary is learned from, and why; empty without a choice, or before the initial design is done."""
        from activefail.analyses.findings.learned_from import choices_in_words

        history = self.history
        if not is_past_initial_design(self) or not self.learns_from_margins:
            return []
        return choices_in_words(self.campaign, history, self.classifier) if len(history.training) else []

    @property
    def findings(self) -> "Findings":
        """The findings of the campaign so far."""
        from activefail.analyses.findings.results import findings_of

        with one_thread():
            return findings_of(self.folder, self.campaign, self.store, self.classifier)

    def failure(self, stage: Callable[[str], None] = silent) -> "FailureFindings | None":
        """What is known of the probability of failure and the most probable failure.

        Returns:
            None unless the campaign learned from a margin, seeks a probability, or estimated one.
        """
        from activefail.analyses.findings.failure import failure_findings

        return failure_findings(self, stage)

    def model(self, outcome: str | None = None) -> Any:
        """The latent of a boundary as a BoTorch model.

        Its inputs are the scaled features, (..., q, m), that `features` computes from designs. It is the very
        model of the loop: a GPyTorch variational GP of the outcomes, or of minus the warped margin that the boundary is
        learned from, or a custom model (docs/classifier.md).

        Args:
            outcome: of the boundary; the (main) target if None.

        Raises:
            InputError: if the outcome has no boundary, or there is no simulation to learn from.
        """
        return self.classifier.latent(boundary_named(self, outcome)).model

    def predict(self, X: Any) -> "DataFrame":
        """Predictions of the classifier.

        Args:
            X: designs in the variables' units: an (n, d) array or a list of rows in the order of `space`; or a
                DataFrame, a dictionary of columns, or a list of dictionaries, read by their names. Choices are as the
                campaign file has them; `space.columns` makes such a table of designs that `space` returned.

        Returns:
            One row for each design, in the given order and with the index of a DataFrame: the variables, the
            `likeliest_outcome`, the probability `p_<outcome>` of each outcome, and mean and standard deviation of the
            latent of the target boundary, `latent_mean` and `latent_sd`. The latent is positive where the outcome is
            probably beyond the boundary. A design that probably does not exist, by `simulator.lost`, has the likeliest
            outcome "does not exist" and NaN.

        Raises:
            InputError: if there is no simulation to learn from, a variable is missing or a value is not finite.
        """
        from activefail.analyses.findings.tables import designs_of, predictions_frame

        designs, classifier = designs_of(self.campaign, X), predicting(self)
        with one_thread_of_blas():
            # The table's own index: pandas joins columns by it.
            return predictions_frame(self.campaign, classifier, designs, X.index if hasattr(X, "columns") else None)

    def predict_table(
        self, source: "Source | str", target: "Target | str", begin: Begin = uncounted, after: int | None = None
    ) -> int:
        """Write a CSV table of designs with predictions added (see `activefail.analyses.findings.tables`).

        Args:
            source: table of designs: a file, or a binary stream.
            target: table to write: a file, or a text stream, which gets rows as they are computed.
            begin: called with the number of rows once they are checked; returns a callback for finished rows.
            after: number of simulations to learn from, the first ones (see `classifier_after`); all if None.

        Returns:
            Number of designs outside the design space, where the classifier extrapolates.
        """
        from activefail.analyses.findings.tables import predict_table

        source, target = source_of("source", source), target_of("target", target)
        classifier = predicting(self, after)
        with one_thread_of_blas():
            return predict_table(self.campaign, classifier, source, target, begin)

    def plot_boundary(self, x: str, y: str, at: Mapping[str, Any] | None = None, axes: Any = None) -> Any:
        """Draw the classifier's probability of the target outcome or worse over two variables, and the simulations.

        Args:
            x, y: names of the variables, which must be numbers.
            at: values of the other variables; those that it lacks are at their medians, or the most
                probable choice. Simulations with another choice, or much different other values, are pale.
            axes: matplotlib axes to draw on; new ones of pyplot if None.

        Returns:
            The axes.

        Raises:
            InputError: if a name or value is wrong, or there is no simulation to learn from.
        """
        from activefail.analyses.findings.tables import designs_of
        from activefail.pages.figures.outcome_planes import draw_boundary

        space = self.space
        for name in (x, y):
            if name not in space.names or space.parameters[space.names.index(name)].choices:
                numbers = [one.name for one in space.parameters if not one.choices]
                raise InputError(f"plot_boundary: x and y must be two of {', '.join(numbers)}, got {name!r}.")
        if x == y:
            raise InputError(f"plot_boundary: x and y must differ, got {x!r} twice.")
        if unknown := set(at or {}) - set(space.names):
            raise InputError(f"at: must name variables, one of {', '.join(space.names)}, got {', '.join(unknown)}.")
        values = {name: column[0] for name, column in space.columns(space.middle[None]).items()} | dict(at or {})
        design = designs_of(self.campaign, [values])[0]
        return draw_boundary(self.findings, space.names.index(x), space.names.index(y), design, axes)

    def plot_history(self, axes: Any = None) -> Any:
        """Draw what was known after how many simulations, as the report does.

        It is the probability of the target outcome or worse if the campaign seeks or estimated one or learned from a
        margin, otherwise the accuracy on the test set of a comparison or on the validation set.

        Args:
            axes: matplotlib axes to draw on; new ones of pyplot if None.

        Returns:
            The axes.

        Raises:
            InputError: if the campaign has neither, or there is no simulation to learn from.
        """
        from activefail.pages.figures.curves import draw_learning_curves
        from activefail.pages.figures.failure import draw_probability
        from activefail.pages.report.evidence import curve_of
        from activefail.text.quantities import plain

        failure, outcomes = self.failure(), self.campaign.simulator.outcomes
        if failure is not None:
            axes = draw_probability(axes, failure, plain(or_worse(self.boundary, outcomes)))
            axes.set_xlabel("simulations")
        else:
            with one_thread():
                curve, missing = curve_of(self.campaign, self.store)
            if curve is None:
                raise InputError(f"plot_history: requires {missing}.")
            axes = draw_learning_curves(axes, curve.scores, plain(words(self.boundary)), curve.test_size)
        axes.legend()
        return axes

    # ------------------------------------------------------------------------------------------- analyses

    verify = analyses.verify
    probability = analyses.probability
    fragility = analyses.fragility
    design = analyses.design
    sensitivity = analyses.sensitivity
    compare = analyses.compare
    report = analyses.report

    def asked(
        self,
        question: "Question | Path | str | None" = None,
        fixed: "Mapping[str, float] | Path | str | None" = None,
    ) -> "Question":
        """A distribution of the variables, under which a probability is asked for.

        Args:
            question: a question file or a hazard file, or a question itself; the campaign's question if None.
            fixed: values of variables, which are then certain: by name, or a TOML file.

        Raises:
            InputError: naming the file, the key, the rule and the value.
        """
        return Inquiry.of(self.campaign, None, question, fixed).question

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {self.history.asked_for} of {self.settings.sampling.budget} simulations)"

    def _repr_html_(self) -> str:
        """The state of the campaign, for a notebook; a run of one's own that is open for writing is not running."""
        from activefail.analyses.findings.status import read_status

        status = read_status(self.folder)
        return replace(status, is_running=status.is_running and not self.writes)._repr_html_()
