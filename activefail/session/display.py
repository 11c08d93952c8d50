"""Shows the progress of a campaign and of other long work on the terminal."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from html import escape
from typing import TYPE_CHECKING

from activefail.session.interrupts import stop_on_signals
from activefail.space.shares import alike, feasible_share, lognormal_interval, percent
from activefail.space.space import REACH
from activefail.text.screen import terminal
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.execution.executor import CountingExecutor, Executor
    from activefail.loop.probability_rule import Looks
    from activefail.loop.progress import Observer, Progress


_BETWEEN_LINES = 10.0
"""Least time between two lines of progress where there is no terminal [s]."""

_log = logging.getLogger("activefail")


def is_quiet() -> bool:
    """Whether progress is not to be shown: the package's log, which `-q` sets, takes warnings only."""
    return _log.level >= logging.WARNING


def is_verbose() -> bool:
    """Whether details are to be shown: the package's log, which `-v` sets, takes messages for debugging."""
    return _log.level == logging.DEBUG


def with_times(enter: Callable[[str], None]) -> Callable[[str], None]:
    """`enter`, which receives the name of each stage as it begins, with the times of the stages in the log (`-v`)."""
    name, began = "", 0.0

    def timed(stage: str) -> None:
        nonlocal name, began
        now = time.monotonic()
        if name:
            _log.debug("%s: %.1f s", name, now - began)
        name, began = stage, now
        enter(stage)

    return timed


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int], Callable[[int], None]]]:
    """A progress bar on a terminal and in a notebook, otherwise a line every 10 s.

    Yields a function that takes the total number of rows and returns a callback for finished rows.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(file=terminal(sys.stderr), stderr=True)
    if console.is_jupyter:
        # Rich's own bars for notebooks need ipywidgets; a cell shows a line that returns to its start.
        console = Console(file=sys.stderr, force_terminal=True, force_jupyter=False, width=79)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=is_quiet() or not console.is_terminal) as bar:

        def begin(total: int) -> Callable[[int], None]:
            task, finished, shown_at = bar.add_task(title, total=total), 0, time.monotonic()

            def advance(done: int) -> None:
                nonlocal finished, shown_at
                bar.advance(task, done)
                finished += done
                if bar.disable and not is_quiet() and time.monotonic() - shown_at > _BETWEEN_LINES:
                    shown_at = time.monotonic()
                    print(f"{title}: {finished} of {total}", file=sys.stderr, flush=True)

            return advance

        yield begin


def shown_executor(executor: "Executor") -> "CountingExecutor":
    """An executor that shows a progress bar while it simulates designs."""
    from activefail.execution.executor import CountingExecutor

    return CountingExecutor(executor, lambda: progress_bar("simulating"))


@contextmanager
def campaign_display(campaign: "Campaign", stop: Callable[[], bool]) -> Iterator["Observer"]:
    """A live display on a terminal and in a notebook; otherwise, and with the stages' times, one line per batch."""
    from rich.console import Console

    from activefail.loop.progress import Observer

    if is_quiet():
        yield Observer(stop=stop)
        return
    if _is_notebook() and not is_verbose():
        yield _notebook_observer(campaign, stop)
        return
    console = Console(file=terminal(sys.stdout))
    if not console.is_terminal or is_verbose():
        shown_iteration, shown_at = -1, -60.0

        def show(progress: "Progress") -> None:
            nonlocal shown_iteration, shown_at
            # Batches of the initial design are too frequent for a line each.
            learned = progress.done >= campaign.settings.sampling.initial
            if shown_iteration < 0:
                print(seeking_line(campaign))
            if learned or progress.iteration != shown_iteration or time.monotonic() - shown_at > _BETWEEN_LINES:
                shown_iteration, shown_at = progress.iteration, time.monotonic()
                print(_progress_line(campaign, progress), flush=True)

        yield Observer(show, with_times(lambda _: None), stop)
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

    # Text on separate lines: next to the bar, a narrow terminal would truncate it.
    with Live(Group(Text(seeking_line(campaign)), bar, below), console=console, refresh_per_second=8):
        yield Observer(update, enter, stop)
        below.plain = line


@contextmanager
def display_with_stop(campaign: "Campaign", requested: str) -> Iterator["Observer"]:
    """A display that also lets Ctrl-C stop the campaign after a batch.

    Args:
        campaign: the campaign.
        requested: is shown once a stop is requested.
    """
    # Only the main thread can handle signals.
    handles = threading.current_thread() is threading.main_thread()
    signals = stop_on_signals(requested) if handles else nullcontext(lambda: False)
    with signals as stop, campaign_display(campaign, stop) as observer:
        yield observer


def _is_notebook() -> bool:
    """Whether a notebook's kernel runs this process."""
    # Without it, no notebook runs; it need not be installed.
    ipython = sys.modules.get("IPython")
    return ipython is not None and getattr(ipython.get_ipython(), "kernel", None) is not None


def _notebook_observer(campaign: "Campaign", stop: Callable[[], bool]) -> "Observer":
    """An observer that shows a bar below the cell, and keeps its last state there."""
    from IPython.display import HTML, display

    from activefail.loop.progress import Observer

    bar, line = "<progress></progress>", ""

    def page(stage: str) -> HTML:
        texts = (seeking_line(campaign), " | ".join(filter(None, (line, stage))))
        above, below = (escape(text) for text in texts)
        return HTML(f"<div>{above}<br>{bar}<br>{below}</div>")

    shown = display(page("starting"), display_id=True)

    def update(progress: "Progress") -> None:
        nonlocal bar, line
        bar = f'<progress value="{progress.done}" max="{progress.budget}"></progress> {progress.done}/{progress.budget}'
        line = _progress_line(campaign, progress, bar=True)
        shown.update(page(""))

    return Observer(update, lambda stage: shown.update(page(stage)), stop)


def seeking_line(campaign: "Campaign") -> str:
    """Which boundary a campaign seeks, and how severe its outcomes are: their order is the user's."""
    shares = campaign.settings.acquisition.boundaries
    targets = " and ".join(
        f"the boundary of {name}" + (f" ({percent(share, 0)})" if share < 1.0 else "") for name, share in shares.items()
    )
    if campaign.space.constraints:
        targets += f", of the {feasible_share(campaign.space)} of designs that meet the constraints"
    return f"seeking    {targets} (outcomes from least to most severe: {', '.join(campaign.simulator.outcomes)})"


def _counts(campaign: "Campaign", progress: "Progress") -> str:
    names = (*campaign.simulator.outcomes, "numerical failures")
    counts = (*progress.counts, progress.numerical_failures)
    return ", ".join(f"{count} {name}" for count, name in zip(counts, names, strict=True))


def _progress_line(campaign: "Campaign", progress: "Progress", bar: bool = False) -> str:
    parts = [] if bar else [f"{progress.done}/{progress.budget} simulations"]
    parts += [f"iteration {progress.iteration}", _counts(campaign, progress)]
    if progress.unseen and progress.done >= campaign.settings.sampling.initial:
        parts.append(f"searching for {' and '.join(progress.unseen)} (not seen yet)")
    if progress.looks is not None:
        parts.append(probability_text(progress.looks, bool(progress.unseen)))
    if progress.error is not None:
        parts.append(f"error {progress.error.in_words[0]}")
    if progress.accuracy is not None:
        shares = ", ".join(f"{percent(share)} {name}" for name, share in progress.recall.items())
        parts.append(f"accuracy {percent(progress.accuracy)}, recall {shares}")
    if progress.seconds_left is not None and progress.done < progress.budget:
        parts.append(f"{progress.seconds_left:.0f} s left")
    return visible(" | ".join(parts))


def probability_text(looks: "Looks", unseen: bool) -> str:
    """A probability under the classifier, with the interval of its posterior once every outcome was seen."""
    if unseen:
        return f"probability {alike(looks.probability)[0]} under the classifier, without an interval"
    ends = lognormal_interval(looks.probability, looks.sd, REACH)
    probability, low, high = alike(looks.probability, *ends)
    return f"probability {probability} under the classifier, 95 % interval {low} to {high}"
