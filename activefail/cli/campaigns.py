"""Commands on campaigns: run, resume, status, predict, verify, export."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from activefail.cli.common import (
    Code,
    ExecutorName,
    RunFolder,
    Scheduler,
    Workers,
    make_executor,
    show_unseen,
    show_warnings,
)
from activefail.display import campaign_display, error_text, progress_bar
from activefail.interrupts import INTERRUPTED, stop_on_signals
from activefail.record.layout import check_output
from activefail.shares import percent
from activefail.visible import quoted, visible

if TYPE_CHECKING:
    from activefail.execution.executor import AsynchronousExecutor
    from activefail.run import Run


def run(
    campaign: Annotated[Path, typer.Argument(help="Campaign file.", metavar="CAMPAIGN.toml", show_default=False)],
    out: Annotated[Path, typer.Option(help="Run folder to create.", show_default=False)],
    seed: Annotated[int | None, typer.Option(help="Seed; overrides the file.", show_default=False)] = None,
    budget: Annotated[int | None, typer.Option(help="Simulations; overrides the file.", show_default=False)] = None,
    workers: Workers = None,
    executor: ExecutorName = "local",
    scheduler: Scheduler = None,
) -> None:
    """Run a new campaign."""
    from activefail.campaign.opening import read_campaign
    from activefail.run import check_unused, create_run

    check_output("--out", out)
    assembled = read_campaign(campaign, seed, budget, code=campaign.absolute().parent, run=out)
    check_unused(out, assembled)
    # The executor first: if it fails to start, no folder is left behind.
    with make_executor(assembled, workers, executor, scheduler) as pool, create_run(out, assembled) as created:
        _take(created, pool, _Terms(options=_executor_options(executor, scheduler)))


def resume(
    folder: RunFolder,
    budget: Annotated[
        int | None, typer.Option(help="Simulations in all; overrides the campaign.", show_default=False)
    ] = None,
    workers: Workers = None,
    executor: ExecutorName = "local",
    scheduler: Scheduler = None,
    numerical_failures: Annotated[
        float | None,
        typer.Option(help="Largest accepted share; overrides the campaign.", min=0.0, max=1.0, show_default=False),
    ] = None,
    ignore_stop: Annotated[
        bool, typer.Option("--ignore-stop", help="Continue even if the stop rule is already met.")
    ] = False,
    code: Code = None,
) -> None:
    """Continue a campaign after an interruption or beyond its budget."""
    from activefail.run import open_run

    with open_run(folder, write=True, code=code) as opened:
        show_warnings(opened.store)
        opened.check_budget(budget)
        with make_executor(opened.campaign, workers, executor, scheduler) as pool:
            options = _executor_options(executor, scheduler)
            _take(opened, pool, _Terms(budget, numerical_failures, ignore_stop, options))


def _executor_options(executor: str, scheduler: str | None) -> str:
    """The options that select the same cluster in a resume command."""
    return "" if scheduler is None else f" --executor {executor} --scheduler {shlex.quote(scheduler)}"


class _Terms(NamedTuple):
    """Options of a command line for `Run.take`."""

    budget: int | None = None
    failure_limit: float | None = None
    ignore_stop: bool = False
    options: str = ""


class _Stops(NamedTuple):
    """Messages for a stop: on request, after an orderly stop, and after an immediate one."""

    stopping: str
    in_order: str
    at_once: str


_IN_BATCHES = _Stops("stopping after this batch", "after a complete batch", "recorded batches are safe")
_ASYNCHRONOUS = _Stops(
    "stopping: waiting for the simulations in flight",
    "with nothing in flight",
    "recorded simulations are safe, those in flight will be simulated again",
)


def _take(run: "Run", executor: "AsynchronousExecutor", terms: _Terms) -> None:
    """Run a campaign to its end and print how it ended."""
    show_warnings(run.store)
    if warning := run.stop_rule_warning:
        print(f"warning: {warning}", file=sys.stderr)
    stops = _ASYNCHRONOUS if run.settings.sampling.asynchronous else _IN_BATCHES
    command = run.resume_command(*terms)
    try:
        with stop_on_signals(stops.stopping) as stop, campaign_display(run.campaign, stop) as observer:
            taken = run.take(*terms[:3], executor, observer, terms.options)
    except KeyboardInterrupt:
        print(f"stopped; {stops.at_once}. Continue with: {command}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    show_warnings(run.store)
    if taken.first_fault:
        print(f"warning: simulations were abandoned; the first failed with: {taken.first_fault}", file=sys.stderr)
    if not taken.finished:
        print(f"stopped {stops.in_order}. Continue with: {command}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    rule = run.settings.error_rule
    if rule is not None and taken.progress.done < taken.progress.budget:
        print(
            f"stop rule  met after {taken.progress.done} simulations: the error at the {visible(run.boundary)} "
            f"boundary is at most {100 * rule.error:g} %, with {100 * rule.confidence:g} % confidence over all looks"
        )
    goal = run.settings.probability_rule
    if goal is not None and taken.progress.done < taken.progress.budget:
        print(
            f"stop rule  met after {taken.progress.done} simulations: the classifier knows the probability of "
            f"{visible(goal.probability)}, and a check far from all other designs did not contradict it"
        )
    show_unseen(run.summary)
    print(f"results    {visible(str(run.folder))}")


def status(folder: RunFolder) -> None:
    """Show the progress of a campaign; safe while it runs."""
    from activefail.findings.summary import is_verified, read_summary

    summary = read_summary(folder)
    if summary is None:
        from activefail.run import open_run

        with open_run(folder, features=False) as opened:
            show_warnings(opened.store)
            summary = opened.summary
    print(f"campaign   {visible(summary.settings.description or folder.name)}")
    for title, text in summary.lines:
        print(f"{title:<10} {text}")
    show_unseen(summary)
    if summary.done < summary.settings.budget:
        command = f"activefail resume {quoted(folder)}{' --code FOLDER' if summary.settings.custom_code else ''}"
        print(f"continue   {command}")
        if is_verified(folder, summary):
            print(f"           {command} --ignore-stop, if it ended by its stop rule")


def predict(
    folder: RunFolder,
    csv: Annotated[Path, typer.Option(help="Table of designs.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Table to write, with probabilities.", show_default=False)],
    code: Code = None,
) -> None:
    """Predict the outcomes of designs with a campaign's classifier."""
    from activefail.run import open_run

    check_output("--out", out)
    with open_run(folder, code=code) as opened:
        show_warnings(opened.store)
        opened.learn()
        show_warnings(opened.store)
        with progress_bar("predicting") as begin:
            outside = opened.predict_table(csv, out, begin)
        show_unseen(opened.summary)
    if outside:
        print(f"warning: the classifier extrapolates: {outside} designs lie outside the design space", file=sys.stderr)
    print(f"written to {visible(str(out))}")


def verify(
    folder: RunFolder,
    simulations: Annotated[
        int, typer.Option(help="Fresh simulations, outside the budget.", min=10, max=1_000_000)
    ] = 200,
    confidence: Annotated[float, typer.Option(help="Confidence of the interval.", min=0.5, max=0.999)] = 0.9,
    code: Code = None,
) -> None:
    """Estimate how much of the design space a campaign's classifier gets wrong, with an interval."""
    from activefail.run import open_run

    with open_run(folder, write=True, code=code) as opened:
        show_warnings(opened.store)
        error = opened.verify(simulations, confidence)
        show_warnings(opened.store)
        summary = opened.summary
    print(f"campaign   {summary.done} simulations, iteration {summary.iteration}")
    print(f"error      {error_text(error)} of the design space on the wrong side of {opened.boundary}")
    print(
        f"           {100 * confidence:g} % interval from {error.in_words}, {error.wrong} of them misclassified; "
        "their weights differ"
    )
    print(f"expected   {percent(error.expected, 2)} by the classifier's own probabilities, without an interval")
    show_unseen(summary)


def export(
    folder: RunFolder,
    csv: Annotated[Path, typer.Option(help="Table to write.", show_default=False)],
    code: Code = None,
) -> None:
    """Write every simulation of a campaign to a table."""
    from activefail.run import open_run

    check_output("--csv", csv)
    with open_run(folder, code=code) as opened:
        show_warnings(opened.store)
        number = opened.export_table(csv)
    print(f"{number} simulations written to {visible(str(csv))}")
