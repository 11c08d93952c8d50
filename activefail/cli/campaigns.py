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
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the file's.", show_default=False)] = None,
    budget: Annotated[int | None, typer.Option(help="Simulations, instead of the file's.", show_default=False)] = None,
    workers: Workers = None,
    executor: ExecutorName = "local",
    scheduler: Scheduler = None,
) -> None:
    """Start a campaign in a new run folder and take it to its budget."""
    from activefail.campaign.opening import read_campaign
    from activefail.run import check_unused, create_run

    check_output("--out", out)
    assembled = read_campaign(campaign, seed, budget, code=campaign.absolute().parent, run=out)
    check_unused(out, assembled)
    # The executor first: what keeps it from working leaves no folder behind.
    with make_executor(assembled, workers, executor, scheduler) as working, create_run(out, assembled) as created:
        _take(created, working, _Terms(options=_executor_options(executor, scheduler)))


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
    ignore_stop: Annotated[
        bool, typer.Option("--ignore-stop", help="Continue even if the stop rule is already met.")
    ] = False,
    code: Code = None,
) -> None:
    """Continue a campaign that was interrupted, or beyond its budget."""
    from activefail.run import open_run

    with open_run(folder, write=True, code=code) as opened:
        show_warnings(opened.store)
        opened.check_budget(budget)
        with make_executor(opened.campaign, workers, executor, scheduler) as working:
            options = _executor_options(executor, scheduler)
            _take(opened, working, _Terms(budget, numerical_failures, ignore_stop, options))


def _executor_options(executor: str, scheduler: str | None) -> str:
    """The options that name the same cluster again."""
    return "" if scheduler is None else f" --executor {executor} --scheduler {shlex.quote(scheduler)}"


class _Terms(NamedTuple):
    """What a command line says of how a campaign is taken on (see `Run.take`)."""

    budget: int | None = None
    failure_limit: float | None = None
    ignore_stop: bool = False
    options: str = ""


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


def _take(run: "Run", executor: "AsynchronousExecutor", terms: _Terms) -> None:
    """Take a campaign on, and say how that ends."""
    show_warnings(run.store)
    if warning := run.stop_rule_warning:
        print(f"warning: {warning}", file=sys.stderr)
    stops = _WITHOUT_BATCHES if run.settings.sampling.asynchronous else _IN_BATCHES
    again = run.resume_command(*terms)
    try:
        with stop_on_signals(stops.stopping) as stop, campaign_display(run.campaign, stop) as observer:
            taken = run.take(*terms[:3], executor, observer, terms.options)
    except KeyboardInterrupt:
        print(f"stopped; {stops.at_once}. Continue with: {again}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    show_warnings(run.store)
    if taken.first_fault:
        print(f"warning: a simulation was abandoned; why the first failed: {taken.first_fault}", file=sys.stderr)
    if not taken.finished:
        print(f"stopped {stops.in_order}. Continue with: {again}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    rule = run.settings.stop
    if rule is not None and taken.progress.done < taken.progress.budget:
        print(
            f"good       enough after {taken.progress.done} simulations: an error of at most {100 * rule.error:g} % at "
            f"the {visible(run.boundary)} boundary is verified with {100 * rule.confidence:g} % confidence, over all "
            f"looks"
        )
    show_unseen(run.summary)
    print(f"results    {visible(str(run.folder))}")


def status(folder: RunFolder) -> None:
    """Show where a campaign stands; safe while it runs."""
    from activefail.campaign.summary import is_verified, read_summary

    summary = read_summary(folder)
    if summary is None:
        from activefail.run import open_run

        with open_run(folder, features=False) as opened:
            show_warnings(opened.store)
            summary = opened.summary
    print(f"campaign   {visible(summary.plan.description or folder.name)}")
    for title, text in summary.lines:
        print(f"{title:<10} {text}")
    show_unseen(summary)
    if summary.done < summary.plan.budget:
        again = f"activefail resume {quoted(folder)}{' --code FOLDER' if summary.plan.own_code else ''}"
        print(f"continue   {again}")
        if is_verified(folder, summary):
            print(f"           {again} --ignore-stop, where it ended by its stop rule")


def predict(
    folder: RunFolder,
    csv: Annotated[Path, typer.Option(help="Table of designs.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Where to write it with probabilities.", show_default=False)],
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
        print(f"warning: outside the campaign's ranges, where it extrapolates: {outside} designs", file=sys.stderr)
    print(f"written to {visible(str(out))}")


def verify(
    folder: RunFolder,
    simulations: Annotated[int, typer.Option(help="Fresh ones, outside the budget.", min=10, max=1_000_000)] = 200,
    confidence: Annotated[float, typer.Option(help="Of the interval.", min=0.5, max=0.999)] = 0.9,
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
        f"           {100 * confidence:g} % interval: {error.in_words}, {error.wrong} of them "
        "misclassified, in parts of unequal weight"
    )
    print(f"expected   {percent(error.expected, 2)} by the classifier's own probabilities, which have no interval")
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
