"""Commands on campaigns: run, resume, status, predict, verify, export."""

import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from activefail.cli.common import (
    INTERRUPTED,
    Code,
    ExecutorName,
    RunFolder,
    Scheduler,
    Workers,
    check_output,
    make_executor,
    progress_bar,
    resume_command,
    show_warnings,
    stop_on_signals,
)
from activefail.cli.screen import terminal
from activefail.errors import InputError
from activefail.shares import interval_percent, percent
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.campaign.loop import Observer, Progress
    from activefail.campaign.summary import Summary
    from activefail.campaign.verification import ErrorEstimate
    from activefail.execution.executor import AsynchronousExecutor
    from activefail.record.run_folder import FolderStore


def run(
    campaign: Annotated[Path, typer.Argument(help="Campaign file.", metavar="CAMPAIGN.toml", show_default=False)],
    out: Annotated[Path, typer.Option(help="Run folder to create.", show_default=False)],
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the file's.", show_default=False)] = None,
    budget: Annotated[int | None, typer.Option(help="Simulations, instead of the file's.", show_default=False)] = None,
    workers: Workers = None,
    executor: ExecutorName = "local",
    scheduler: Scheduler = None,
) -> None:
    """Start a campaign in a new run folder and take it to its budget."""
    from activefail.campaign.opening import create_run, read_campaign

    check_output("--out", out)
    code = campaign.absolute().parent
    assembled = read_campaign(campaign, seed, budget, code=code, run=out)
    if (out / "campaign.toml").exists():
        again = resume_command(out, assembled)
        raise InputError(f"{out}: holds a campaign already; `{again}` goes on with it.")
    # The executor first: what keeps it from working leaves no folder behind.
    with make_executor(assembled, workers, executor, scheduler) as working, create_run(out, assembled) as store:
        again = f"{resume_command(out, assembled)}{_executor_options(executor, scheduler)}"
        show_warnings(store)
        _take_to_budget(assembled, store, out, assembled.settings.sampling.budget, working, again)


def _executor_options(executor: str, scheduler: str | None) -> str:
    """The options by which a command is given the same cluster again."""
    return "" if scheduler is None else f" --executor {executor} --scheduler {shlex.quote(scheduler)}"


def resume(
    folder: RunFolder,
    budget: Annotated[
        int | None, typer.Option(help="Simulations in all, instead of the campaign's.", show_default=False)
    ] = None,
    workers: Workers = None,
    executor: ExecutorName = "local",
    scheduler: Scheduler = None,
    numerical_failures: Annotated[
        float | None,
        typer.Option(
            help="Share of them to stop above, instead of the campaign's.", min=0.0, max=1.0, show_default=False
        ),
    ] = None,
    ignore_stop: Annotated[bool, typer.Option("--ignore-stop", help="Go on although it is good enough.")] = False,
    code: Code = None,
) -> None:
    """Go on with a campaign that was interrupted, or beyond its budget."""
    from activefail.campaign.opening import open_campaign

    with open_campaign(folder, write=True, code=code) as (assembled, store):
        show_warnings(store)
        target = assembled.settings.sampling.budget if budget is None else budget
        if target < 2:
            raise InputError(f"--budget: must be at least 2, got {target}.")
        done = sum(len(batch) for batch in store.batches)
        if budget is not None and budget < done:
            raise InputError(f"--budget: must be at least the {done} simulations that are done, got {budget}.")
        extra = "" if budget is None else f" --budget {budget}"
        if numerical_failures is not None:
            extra += f" --numerical-failures {numerical_failures:g}"
        again = f"{resume_command(folder, assembled)}{_executor_options(executor, scheduler)}"
        again += " --ignore-stop" if ignore_stop else ""
        with make_executor(assembled, workers, executor, scheduler) as working:
            _take_to_budget(
                assembled, store, folder, target, working, again, extra, numerical_failures, not ignore_stop
            )


class _Stops(NamedTuple):
    """What is said of a campaign that is asked to stop: then, after it has, and where it had to at once."""

    stopping: str
    in_order: str
    at_once: str


_IN_BATCHES = _Stops("stopping after this batch", "after a whole batch", "batches that were recorded are safe")
_WITHOUT_BATCHES = _Stops(
    "stopping: no simulation is begun any more, those in flight are waited for and recorded",
    "with nothing in flight",
    "what was recorded is safe, what was in flight will be simulated again",
)


def _take_to_budget(
    campaign: "Campaign",
    store: "FolderStore",
    folder: Path,
    budget: int,
    executor: "AsynchronousExecutor",
    again: str,
    extra: str = "",
    failure_limit: float | None = None,
    good_enough: bool = True,
) -> None:
    """Run the loop; `again` is the command that goes on, `extra` what it was told of budget and limit besides."""
    from activefail.campaign.loop import run as run_loop
    from activefail.campaign.loop import standing
    from activefail.campaign.stratified import largest_unseen_share
    from activefail.campaign.summary import Summary
    from activefail.campaign.verification import confidence_of_look, least_simulations

    rule = campaign.settings.stop
    if rule is not None and (least := least_simulations(rule.error, rule.confidence)) > rule.simulations:
        shown = largest_unseen_share(rule.simulations, confidence_of_look(rule.confidence, 1))
        print(
            f"warning: stop.simulations: {rule.simulations} can show an error of at most {percent(shown)} at the first "
            f"look, if none of them is wrong; {100 * rule.error:g} % needs at least {least}",
            file=sys.stderr,
        )
    words = _WITHOUT_BATCHES if campaign.settings.sampling.asynchronous else _IN_BATCHES
    try:
        with stop_on_signals(words.stopping) as stop, _campaign_display(campaign, stop) as observer:
            finished = run_loop(campaign, store, executor, budget, observer, failure_limit, good_enough, again)
    except KeyboardInterrupt:
        print(f"stopped; {words.at_once}. Go on with: {again}{extra}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    show_warnings(store)
    if executor.first_fault:
        print(f"warning: a simulation was abandoned; why the first failed: {executor.first_fault}", file=sys.stderr)
    if not finished:
        print(f"stopped {words.in_order}. Go on with: {again}{extra}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    progress = standing(campaign, store.batches, budget)
    if rule is not None and progress.done < budget:
        print(
            f"good       enough after {progress.done} simulations: an error of at most {100 * rule.error:g} % at the "
            f"{visible(campaign.settings.acquisition.main_boundary)} boundary is verified with "
            f"{100 * rule.confidence:g} % confidence, over all looks"
        )
    _show_unseen(Summary.of(campaign.settings.text(), campaign.simulator.outcomes, store.batches))
    print(f"results    {visible(str(folder))}")


def _show_unseen(summary: "Summary") -> None:
    """A warning on the error stream where a campaign never saw an outcome."""
    if warning := summary.unseen_warning:
        print(f"warning: {visible(warning)}", file=sys.stderr)


@contextmanager
def _campaign_display(campaign: "Campaign", stop: Callable[[], bool]) -> Iterator["Observer"]:
    """A live line on a terminal; a plain line a batch otherwise."""
    from rich.console import Console

    from activefail.campaign.loop import Observer

    console = Console(file=terminal(sys.stdout))
    if not console.is_terminal:
        shown_iteration, shown_at = -1, -60.0

        def show(progress: "Progress") -> None:
            nonlocal shown_iteration, shown_at
            # Batches of the initial design come too fast to be worth a line each.
            learned = progress.done >= campaign.settings.sampling.initial
            if learned or progress.iteration != shown_iteration or time.monotonic() - shown_at > 10.0:
                shown_iteration, shown_at = progress.iteration, time.monotonic()
                print(_progress_line(campaign, progress), flush=True)

        yield Observer(show, stop=stop)
        return

    from rich.console import Group
    from rich.live import Live
    from rich.progress import BarColumn, MofNCompleteColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    bar = Bar(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console)
    task = bar.add_task("simulations", total=None)
    line, below = "", Text("starting")

    def update(progress: "Progress") -> None:
        nonlocal line
        line = _progress_line(campaign, progress, bar=True)
        bar.update(task, total=progress.budget, completed=progress.done)

    def enter(name: str) -> None:
        below.plain = f"{line} | {name}" if line else name

    # The text on lines of its own: a narrow terminal would cut it, or the bar.
    with Live(Group(bar, below), console=console, refresh_per_second=8):
        yield Observer(update, enter, stop)
        below.plain = line


def _counts(campaign: "Campaign", progress: "Progress") -> str:
    names = (*campaign.simulator.outcomes, "numerical failures")
    counts = (*progress.counts, progress.numerical_failures)
    return ", ".join(f"{count} {name}" for count, name in zip(counts, names, strict=True))


def _progress_line(campaign: "Campaign", progress: "Progress", bar: bool = False) -> str:
    parts = [] if bar else [f"{progress.done}/{progress.budget} simulations"]
    parts += [f"iteration {progress.iteration}", _counts(campaign, progress)]
    if progress.unseen and progress.done >= campaign.settings.sampling.initial:
        parts.append(f"searching for {' and '.join(progress.unseen)}, not seen yet")
    if progress.error is not None:
        parts.append(f"error {_error_text(progress.error)}")
    if progress.accuracy is not None:
        parts.append(f"accuracy {percent(progress.accuracy)}")
    if progress.seconds_left is not None and progress.done < progress.budget:
        parts.append(f"{progress.seconds_left:.0f} s left")
    return visible(" | ".join(parts))


def status(folder: RunFolder) -> None:
    """Show where a campaign stands; safe while it runs."""
    from activefail.campaign.summary import is_verified, read_summary

    summary = read_summary(folder) or _opened_summary(folder)
    plan = summary.plan
    print(f"campaign   {visible(plan.description or folder.name)}")
    print(f"simulator  {plan.simulator}, {plan.variables} variables, seed {plan.seed}")
    sought = " and ".join(
        f"the {name} boundary" + (f" ({percent(share, 0)})" if share < 1.0 else "")
        for name, share in plan.boundaries.items()
    )
    print(f"learner    {plan.kernel} on {plan.features} features, {plan.criterion} at {sought}")
    planned = f"{summary.done} of {plan.budget} simulations"
    if summary.done > plan.budget:
        planned = f"{summary.done} simulations, {plan.budget} were planned"
    print(f"done       {planned}, iteration {summary.iteration}")
    names = (*summary.outcomes, "numerical failures")
    for title, counts in (("initial", summary.initial), ("chosen", summary.chosen), ("all", summary.counts)):
        print(f"{title:<10} {', '.join(f'{n} {name}' for n, name in zip(counts.tolist(), names, strict=True))}")
    _show_unseen(summary)
    if summary.done < plan.budget:
        again = f"{resume_command(folder)}{' --code FOLDER' if plan.own_code else ''}"
        print(f"go on      {again}")
        if is_verified(folder, summary):
            print(f"           {again} --ignore-stop, where it ended by its stop rule")


def _opened_summary(folder: Path) -> "Summary":
    """The summary of a run folder whose record has to be opened for it, with what there is to warn of."""
    from activefail.campaign.opening import open_campaign
    from activefail.campaign.summary import Summary

    with open_campaign(folder, write=False, features=False) as (campaign, store):
        show_warnings(store)
        # Its text, not the file's: an older program may have left out what has a default now.
        return Summary.of(campaign.settings.text(), campaign.simulator.outcomes, store.batches)


def predict(
    folder: RunFolder,
    csv: Annotated[Path, typer.Option(help="Table of designs.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Where to write it with probabilities.", show_default=False)],
    code: Code = None,
) -> None:
    """Predict the outcomes of designs with a campaign's classifier."""
    from activefail.campaign.learning import current_classifier
    from activefail.campaign.loop import one_thread
    from activefail.campaign.opening import open_campaign
    from activefail.campaign.tables import predict_table

    check_output("--out", out)
    with open_campaign(folder, write=False, code=code) as (campaign, store), one_thread():
        show_warnings(store)
        if not store.batches:
            raise InputError(f"{folder}: has no simulations to learn from yet.")
        classifier = current_classifier(campaign, store, write=False)
        show_warnings(store)
        with progress_bar("predicting") as begin:
            outside = predict_table(campaign, classifier, csv, out, begin)
    if outside:
        print(f"warning: outside the campaign's ranges, where it extrapolates: {outside} designs", file=sys.stderr)
    print(f"written to {visible(str(out))}")


def verify(
    folder: RunFolder,
    simulations: Annotated[int, typer.Option(help="Fresh ones, outside the budget.", min=10, max=1_000_000)] = 200,
    confidence: Annotated[float, typer.Option(help="Of the interval.", min=0.5, max=0.999)] = 0.9,
    code: Code = None,
) -> None:
    """Estimate how much of the design space a campaign's classifier gets wrong, with an interval."""
    from activefail.campaign.learning import current_classifier, initial_sets
    from activefail.campaign.loop import one_thread, standing
    from activefail.campaign.opening import open_campaign
    from activefail.campaign.summary import Summary
    from activefail.campaign.verification import verify as verify_classifier
    from activefail.execution.local import local_executor

    with (
        open_campaign(folder, write=True, code=code) as (campaign, store),
        local_executor(campaign.simulator, time_limit=campaign.time_limit) as executor,
        one_thread(),
    ):
        show_warnings(store)
        progress = standing(campaign, store.batches, 0)
        if progress.done < campaign.settings.sampling.initial * initial_sets(campaign, store.batches):
            raise InputError(f"{folder}: has not finished its initial design; there is nothing to verify yet.")
        classifier = current_classifier(campaign, store, write=True)
        show_warnings(store)
        error = verify_classifier(campaign, store, executor, classifier, progress.iteration, simulations, confidence)
        summary = Summary.of(campaign.settings.text(), campaign.simulator.outcomes, store.batches)
    boundary = campaign.settings.acquisition.main_boundary
    print(f"campaign   {progress.done} simulations, iteration {progress.iteration}")
    print(f"error      {_error_text(error)} of the design space on the wrong side of {boundary}")
    print(
        f"           {100 * confidence:g} % interval: {error.in_words}, {error.wrong} of them "
        "misclassified, in parts of unequal weight"
    )
    print(f"expected   {percent(error.expected, 2)} by the classifier's own probabilities, which have no interval")
    _show_unseen(summary)


def _error_text(error: "ErrorEstimate") -> str:
    return f"{percent(error.error, 2)} ({interval_percent(error.low, error.high)})"


def export(
    folder: RunFolder,
    csv: Annotated[Path, typer.Option(help="Table to write.", show_default=False)],
    code: Code = None,
) -> None:
    """Write every simulation of a campaign to a table."""
    from activefail.campaign.opening import open_campaign
    from activefail.campaign.tables import export_table

    check_output("--csv", csv)
    with open_campaign(folder, write=False, code=code) as (campaign, store):
        show_warnings(store)
        number = export_table(campaign, store, csv)
    print(f"{number} simulations written to {visible(str(csv))}")
