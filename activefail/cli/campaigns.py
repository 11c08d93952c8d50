"""Commands on campaigns: run, resume, status, predict, export."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from activefail.cli.common import (
    STANDARD,
    AsJson,
    CampaignFile,
    Code,
    RunFolder,
    name_of,
    opened_run,
    print_json,
    show_stage,
    show_unseen,
    show_warnings,
    shown_warnings,
    table_input,
    table_output,
)
from activefail.errors import InputError
from activefail.record.layout import check_output
from activefail.run.analyses import EXECUTOR, SCHEDULER, WORKERS
from activefail.run.analysis import REQUIRED, option
from activefail.session.arguments import executor_named
from activefail.session.display import progress_bar
from activefail.session.interrupts import INTERRUPTED
from activefail.visible import quoted, visible

if TYPE_CHECKING:
    from activefail.execution.executor import AsynchronousExecutor
    from activefail.run.run import Run

TO_CREATE: Any = option(REQUIRED, "Run folder to create.", Path)
SEED: Any = option(None, "Random seed; overrides the file's.", int)
BUDGET: Any = option(None, "Number of simulations; overrides the file's.", int)


def run(
    campaign: CampaignFile,
    out: Path = TO_CREATE,
    seed: int | None = SEED,
    budget: int | None = BUDGET,
    workers: int | None = WORKERS,
    executor: str = EXECUTOR,
    scheduler: str | None = SCHEDULER,
) -> None:
    """Run a new campaign."""
    from activefail.run.opening import campaign_for, create_run

    check_output("--out", out)
    assembled = campaign_for(out, campaign, seed, budget)
    # The executor first: if it fails to start, no folder is left behind.
    with (
        executor_named(assembled, workers, executor, scheduler, show_stage) as pool,
        create_run(out, assembled) as created,
    ):
        _take(created, pool, executor_options=_executor_options(executor, scheduler))


def campaigns(
    copy: Path | None = option(None, "Copy the campaigns, with their code and hazards, into this new folder.", Path),
) -> None:
    """List the campaigns that come with activefail, or copy them.

    `activefail run NAME --out DIR` runs one.
    """
    from activefail.campaign.on_disk import copy_shipped, description_of, shipped_campaigns

    if copy is not None:
        for path in copy_shipped(copy):
            print(visible(str(path)))
        return
    for name, file in shipped_campaigns().items():
        print(f"{name:<10} {visible(description_of(file))}")


def resume(
    folder: RunFolder,
    budget: int | None = option(None, "Total number of simulations; overrides the campaign's.", int),
    workers: int | None = WORKERS,
    executor: str = EXECUTOR,
    scheduler: str | None = SCHEDULER,
    numerical_failures: float | None = option(
        None, "Largest accepted share of numerical failures; overrides the campaign's.", float, low=0.0, high=1.0
    ),
    ignore_stop: bool = option(False, "Continue even if the stop rule is already met."),
    code: Code = None,
) -> None:
    """Continue a campaign after an interruption, or extend it."""
    with opened_run(folder, write=True, code=code) as opened:
        opened.check_budget(budget)
        with executor_named(opened.campaign, workers, executor, scheduler, show_stage) as pool:
            _take(opened, pool, budget, numerical_failures, ignore_stop, _executor_options(executor, scheduler))


def _executor_options(executor: str, scheduler: str | None) -> str:
    """The options that select the same cluster in a resume command."""
    return "" if scheduler is None else f" --executor {executor} --scheduler {shlex.quote(scheduler)}"


def _take(
    run: "Run",
    executor: "AsynchronousExecutor",
    budget: int | None = None,
    failure_limit: float | None = None,
    ignore_stop: bool = False,
    executor_options: str = "",
) -> None:
    """Run a campaign to its end and print how it ended."""
    command, kept = run.resume_command(budget, failure_limit, ignore_stop, executor_options), "nothing was simulated"
    try:
        stops = run.stop_messages
        kept = stops.immediate
        show_warnings([*run.store.new_warnings(), run.stop_rule_warning])
        taken = run.take(
            budget,
            failure_limit=failure_limit,
            ignore_stop=ignore_stop,
            executor=executor,
            executor_options=executor_options,
        )
    except KeyboardInterrupt:
        print(f"stopped; {kept}. Continue with: {command}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    show_warnings([*run.store.new_warnings(), taken.warning])
    if not taken.finished:
        print(f"stopped {stops.orderly}. Continue with: {command}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    for sentence in run.learned_from:
        print(f"learned    {visible(sentence)}")
    if taken.stop_rule:
        print(f"stop rule  {visible(taken.stop_rule)}")
    show_unseen(run.summary)
    if flight := run.summary.flight_in_words:
        print(
            f"in flight  {flight}; they count towards the budget. Record their results with `activefail tell`, or drop "
            "them with `activefail drop`"
        )
    print(f"results    {visible(str(run.folder))}")
    asks = run.settings.probability_rule is not None or run.settings.question is not None
    first = "probability" if asks else "verify"
    print(f"next       {', '.join(f'activefail {name} {quoted(run.folder)}' for name in (first, 'report', 'explore'))}")


def status(folder: RunFolder, as_json: AsJson = False) -> None:
    """Show the progress of a campaign; safe while it runs."""
    from activefail.analyses.findings.status import read_status

    current = read_status(folder)
    show_warnings(current.warnings)
    if as_json:
        print_json(current.as_json())
        show_unseen(current.summary)
        return
    for title, text in current.lines:
        print(f"{title:<10} {text}")
    show_unseen(current.summary)
    for title, text in current.continuation:
        print(f"{title:<10} {text}")


def predict(
    folder: RunFolder,
    csv: Path = option(REQUIRED, "Table of designs; - is standard input.", Path),
    out: Path = option(REQUIRED, "Table to write, with probabilities; - is standard output.", Path),
    after: int | None = option(None, "Learn only from the first N recorded simulations.", int, metavar="N"),
    code: Code = None,
) -> None:
    """Predict the outcomes of designs by the classifier."""
    with table_output("--out", out) as target, opened_run(folder, code=code) as opened:
        summary = opened.summary if after is None else opened.summary_after(after)
        with shown_warnings(), progress_bar("predicting") as begin:
            opened.predict_table(table_input(csv), target, begin, after)
        show_unseen(summary)
        print(f"classifier {opened.classifier_in_words(after)}")
        print(f"written to {name_of(out)}")


def export(
    folder: RunFolder,
    csv: Path | None = option(None, "CSV table to write; - is standard output.", Path),
    parquet: Path | None = option(None, "Parquet file to write.", Path),
    code: Code = None,
) -> None:
    """Write every simulation of a campaign to a table."""
    if csv is not None and parquet is None:
        with table_output("--csv", csv) as target:
            with opened_run(folder, code=code) as opened:
                number = opened.export_table(target)
            print(f"{number} simulations written to {name_of(csv)}")
    elif parquet is not None and csv is None:
        if parquet in STANDARD:
            raise InputError(
                f"--parquet: must be a file, got {str(parquet)!r}; only a CSV table can go to standard output."
            )
        check_output("--parquet", parquet)
        with opened_run(folder, code=code) as opened:
            number = opened.export_parquet(parquet)
        print(f"{number} simulations written to {visible(str(parquet))}")
    else:
        raise InputError(f"export: requires --csv or --parquet, got {'neither' if csv is None else 'both'}.")
