"""Commands on campaigns: run, resume, status, predict, verify, export."""

import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from activefail.cli.common import RunFolder, progress_bar, show_warnings, stop_on_signals
from activefail.errors import InputError

if TYPE_CHECKING:
    from activefail.campaign.campaign import Campaign
    from activefail.campaign.loop import Observer, Progress
    from activefail.campaign.record import Store
    from activefail.campaign.verification import ErrorEstimate


def run(
    campaign: Annotated[Path, typer.Argument(help="Campaign file.", metavar="CAMPAIGN.toml", show_default=False)],
    out: Annotated[Path, typer.Option(help="Run folder to create.", show_default=False)],
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the file's.", show_default=False)] = None,
    budget: Annotated[int | None, typer.Option(help="Simulations, instead of the file's.", show_default=False)] = None,
    workers: Annotated[int | None, typer.Option(help="Side by side; all cores by default.", min=1)] = None,
) -> None:
    """Start a campaign in a new run folder and take it to its budget."""
    from activefail.campaign.folder import create_run, read_campaign

    assembled = read_campaign(campaign, seed, budget)
    if (out / "campaign.toml").exists():
        raise InputError(f"{out}: holds a campaign already; `{_resume(out)}` goes on with it.")
    with create_run(out, assembled) as store:
        _take_to_budget(assembled, store, out, assembled.settings.sampling.budget, workers)


def _resume(folder: Path) -> str:
    """The command that goes on with a campaign, ready to be pasted."""
    return f"activefail resume {shlex.quote(str(folder))}"


def resume(
    folder: RunFolder,
    budget: Annotated[
        int | None, typer.Option(help="Simulations in all, instead of the campaign's.", show_default=False)
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Side by side; all cores by default.", min=1)] = None,
    numerical_failures: Annotated[
        float | None,
        typer.Option(
            help="Share of them to stop above, instead of the campaign's.", min=0.0, max=1.0, show_default=False
        ),
    ] = None,
    ignore_stop: Annotated[bool, typer.Option("--ignore-stop", help="Go on although it is good enough.")] = False,
) -> None:
    """Go on with a campaign that was interrupted, or beyond its budget."""
    from activefail.campaign.folder import open_campaign

    with open_campaign(folder, write=True) as (assembled, store):
        show_warnings(store.warnings)
        target = assembled.settings.sampling.budget if budget is None else budget
        if target < 2:
            raise InputError(f"--budget: must be at least 2, got {target}.")
        extra = "" if budget is None else f" --budget {budget}"
        if numerical_failures is not None:
            extra += f" --numerical-failures {numerical_failures:g}"
        extra += " --ignore-stop" if ignore_stop else ""
        _take_to_budget(assembled, store, folder, target, workers, extra, numerical_failures, not ignore_stop)


def _take_to_budget(
    campaign: "Campaign",
    store: "Store",
    folder: Path,
    budget: int,
    workers: int | None,
    resume_options: str = "",
    failure_limit: float | None = None,
    good_enough: bool = True,
) -> None:
    from activefail.campaign.executor import local_executor
    from activefail.campaign.loop import run as run_loop

    again = f"{_resume(folder)}{resume_options}"
    try:
        with (
            stop_on_signals() as stop,
            local_executor(campaign.simulator, workers) as executor,
            _campaign_display(campaign, stop) as observer,
        ):
            finished = run_loop(campaign, store, executor, budget, observer, failure_limit, good_enough)
    except KeyboardInterrupt:
        print(f"stopped; batches that were recorded are safe. Go on with: {again}", file=sys.stderr)
        raise typer.Exit(130) from None
    if not finished:
        print(f"stopped after a whole batch. Go on with: {again}", file=sys.stderr)
        raise typer.Exit(130)
    print(f"results    {folder}")


@contextmanager
def _campaign_display(campaign: "Campaign", stop: Callable[[], bool]) -> Iterator["Observer"]:
    """A live line on a terminal; a plain line a batch otherwise."""
    from rich.console import Console

    from activefail.campaign.loop import Observer

    console = Console()
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
    if progress.error is not None:
        parts.append(f"error {_error_text(progress.error)}")
    if progress.accuracy is not None:
        parts.append(f"accuracy {100.0 * progress.accuracy:.1f} %")
    if progress.seconds_left is not None and progress.done < progress.budget:
        parts.append(f"{progress.seconds_left:.0f} s left")
    return " | ".join(parts)


def status(folder: RunFolder) -> None:
    """Show where a campaign stands; safe while it runs."""
    from activefail.campaign.folder import open_campaign
    from activefail.campaign.loop import standing

    with open_campaign(folder, write=False) as (campaign, store):
        show_warnings(store.warnings)
        settings = campaign.settings
        progress = standing(campaign, store.batches, settings.sampling.budget)
        print(f"campaign   {settings.description or folder.name}")
        features = settings.classifier.features
        print(f"simulator  {settings.simulator}, {campaign.space.dimension} variables, seed {settings.seed}")
        sought = " and ".join(
            f"the {name} boundary" + (f" ({100 * share:.0f} %)" if share < 1.0 else "")
            for name, share in settings.acquisition.boundaries.items()
        )
        print(
            f"learner    {settings.classifier.kernel} on {features if isinstance(features, str) else features.python} "
            f"features, {settings.acquisition.criterion} at {sought}"
        )
        planned = f"{progress.done} of {progress.budget} simulations"
        if progress.done > progress.budget:
            planned = f"{progress.done} simulations, {progress.budget} were planned"
        print(f"done       {planned}, iteration {progress.iteration}")
        initial = tuple(batch for batch in store.batches if batch.iteration == 0)
        chosen = tuple(batch for batch in store.batches if batch.iteration > 0)
        for title, batches in (("initial", initial), ("chosen", chosen), ("all", store.batches)):
            print(f"{title:<10} {_counts(campaign, standing(campaign, batches, 0))}")
        if progress.done < progress.budget:
            print(f"go on      {_resume(folder)}")


def predict(
    folder: RunFolder,
    csv: Annotated[Path, typer.Option(help="Table of designs.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Where to write it with probabilities.", show_default=False)],
) -> None:
    """Predict the outcomes of designs with a campaign's classifier."""
    from activefail.campaign.folder import open_campaign
    from activefail.campaign.learning import current_classifier
    from activefail.campaign.loop import one_thread
    from activefail.study.tables import predict_table

    with open_campaign(folder, write=False) as (campaign, store), one_thread():
        show_warnings(store.warnings)
        if not store.batches:
            raise InputError(f"{folder}: has no simulations to learn from yet.")
        classifier = current_classifier(campaign, store, write=False)
        with progress_bar("predicting") as begin:
            outside = predict_table(campaign, classifier, csv, out, begin)
    if outside:
        print(f"warning: outside the campaign's ranges, where it extrapolates: {outside} designs", file=sys.stderr)
    print(f"written to {out}")


def verify(
    folder: RunFolder,
    simulations: Annotated[int, typer.Option(help="Fresh ones, outside the budget.", min=10, max=1_000_000)] = 200,
    confidence: Annotated[float, typer.Option(help="Of the interval.", min=0.5, max=0.999)] = 0.9,
) -> None:
    """Estimate how much of the design space a campaign's classifier gets wrong, with an interval."""
    from activefail.campaign.executor import local_executor
    from activefail.campaign.folder import open_campaign
    from activefail.campaign.learning import current_classifier
    from activefail.campaign.loop import one_thread, standing
    from activefail.campaign.verification import verify as verify_classifier

    with (
        open_campaign(folder, write=True) as (campaign, store),
        local_executor(campaign.simulator) as executor,
        one_thread(),
    ):
        show_warnings(store.warnings)
        progress = standing(campaign, store.batches, 0)
        if progress.done < campaign.settings.sampling.initial:
            raise InputError(f"{folder}: has not finished its initial design; there is nothing to verify yet.")
        classifier = current_classifier(campaign, store, write=True)
        error = verify_classifier(campaign, store, executor, classifier, progress.iteration, simulations, confidence)
    assert error is not None  # it was not asked to stop
    boundary = campaign.settings.acquisition.main_boundary
    print(f"campaign   {progress.done} simulations, iteration {progress.iteration}")
    print(f"error      {_error_text(error)} of the design space on the wrong side of {boundary}")
    print(
        f"           {100 * confidence:g} % interval: {error.simulations} fresh simulations, {error.wrong} of them "
        "misclassified, in parts of unequal weight; and the initial design, each point left out in turn"
    )
    print(f"expected   {100 * error.expected:.2f} % by the classifier's own probabilities")


def _error_text(error: "ErrorEstimate") -> str:
    return f"{100 * error.error:.2f} % ({100 * error.low:.2f} to {100 * error.high:.2f} %)"


def export(folder: RunFolder, csv: Annotated[Path, typer.Option(help="Table to write.", show_default=False)]) -> None:
    """Write every simulation of a campaign to a table."""
    from activefail.campaign.folder import open_campaign
    from activefail.study.tables import export_table

    with open_campaign(folder, write=False) as (campaign, store):
        show_warnings(store.warnings)
        number = export_table(campaign, store, csv)
    print(f"{number} simulations written to {csv}")
