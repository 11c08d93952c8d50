"""The command line: parse, call, print."""

import math
import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from activefail.errors import ActivefailError, InputError

if TYPE_CHECKING:
    from activefail.bearing import Model, Response, Tolerance
    from activefail.campaign.campaign import Campaign
    from activefail.campaign.loop import Observer, Progress
    from activefail.campaign.record import Store
    from activefail.campaign.verification import ErrorEstimate

app = typer.Typer(
    help="Learn where a seismic isolation bearing fails, with as few simulations as possible.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Plain help: markup would take a unit in brackets for a style.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

RunFolder = Annotated[Path, typer.Argument(help="Run folder of a campaign.", metavar="DIR", show_default=False)]


def main() -> None:
    """Run the command line; a user's mistake ends in one message and exit code 2, another fault in 1."""
    try:
        app()
    except ActivefailError as error:
        print(f"activefail: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InputError) else 1)
    except BrokenPipeError:
        # `| head`, say. The rest of the output goes nowhere, so that closing it at exit does not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(
            "activefail: stopped, since the reader of its output went away; what was recorded is safe", file=sys.stderr
        )
        sys.exit(1)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"activefail: {error.filename or 'output'}: {error.strerror}", file=sys.stderr)
        sys.exit(1)


def _show_version(asked: bool) -> None:
    if asked:
        from activefail import __version__

        print(f"activefail {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None: ...


# --- simulate ---------------------------------------------------------------------------------------------------


@app.command()
def simulate(
    t_b: Annotated[float | None, typer.Option(help="Bearing period T_b [s].", show_default=False)] = None,
    mu: Annotated[float | None, typer.Option(help="Friction coefficient.", show_default=False)] = None,
    d_tot: Annotated[float | None, typer.Option(help="Displacement capacity D_tot [m].", show_default=False)] = None,
    h_sl_ratio: Annotated[
        float | None, typer.Option(help="Slider height over slider diameter.", show_default=False)
    ] = None,
    h_rim_ratio: Annotated[
        float | None, typer.Option(help="Rim height over slider diameter.", show_default=False)
    ] = None,
    p: Annotated[float | None, typer.Option(help="Pressure on the slider [MPa].", show_default=False)] = None,
    k: Annotated[float | None, typer.Option(help="Contact stiffness [N/m^1.5].", show_default=False)] = None,
    t_p: Annotated[float | None, typer.Option(help="Pulse period T_p [s].", show_default=False)] = None,
    a_p: Annotated[float | None, typer.Option(help="Pulse amplitude A_p [g].", show_default=False)] = None,
    csv: Annotated[
        Path | None,
        typer.Option(help="Table of designs: T_b,mu,D_tot,h_sl_ratio,h_rim_ratio,p,k,T_p,A_p.", show_default=False),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where to write the table's answers.", show_default=False)] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the response (.png, .svg or .pdf).", show_default=False)
    ] = None,
    animate: Annotated[Path | None, typer.Option(help="Film the bearing (.gif or .mp4).", show_default=False)] = None,
    slider_diameter: Annotated[float, typer.Option(help="Slider diameter D_sl [m].")] = 0.30,
    restitution_coefficient: Annotated[float, typer.Option(help="Coefficient of restitution of a rim impact.")] = 0.65,
    slider_density: Annotated[float, typer.Option(help="Density of the slider [kg/m3].")] = 7850.0,
    loss_of_confinement: Annotated[
        bool, typer.Option(help="Whether a slider that no rim holds any more has failed.")
    ] = True,
    restitution: Annotated[str, typer.Option(help="Mass in the damper: pairwise or assembly.")] = "pairwise",
    friction_velocity: Annotated[float, typer.Option(help="Velocity over which friction is regularised [m/s].")] = 1e-3,
    tolerance: Annotated[float, typer.Option(help="Relative tolerance of the integration.")] = 1e-4,
) -> None:
    """Simulate one bearing under one pulse, or a table of them."""
    from activefail.bearing.design import Model, Tolerance

    design = {
        "--t-b": t_b,
        "--mu": mu,
        "--d-tot": d_tot,
        "--h-sl-ratio": h_sl_ratio,
        "--h-rim-ratio": h_rim_ratio,
        "--p": p,
        "--k": k,
        "--t-p": t_p,
        "--a-p": a_p,
    }
    model = Model(
        slider_diameter=slider_diameter,
        restitution_coefficient=restitution_coefficient,
        restitution=restitution,
        slider_density=slider_density,
        friction_velocity=friction_velocity,
        loss_of_confinement=loss_of_confinement,
    )
    integration = Tolerance(relative=tolerance)
    given = [option for option, value in design.items() if value is not None]
    if csv is not None:
        if given or plot or animate:
            single = [*given, "--plot" if plot else "--animate"][0]
            raise InputError(f"--csv simulates a table; {single} belongs to one design.")
        if out is None:
            raise InputError("--csv needs --out FILE, where the answers are written.")
        _simulate_table(csv, out, model, integration)
        return
    missing = [option for option, value in design.items() if value is None]
    if missing:
        raise InputError(
            f"A design needs all nine variables; missing: {', '.join(missing)}. (Or give --csv and --out.)"
        )
    if out is not None:
        raise InputError("--out goes with --csv; use --plot or --animate for one design.")
    _simulate_one([value for value in design.values() if value is not None], model, integration, plot, animate)


def _simulate_one(
    design: list[float], model: "Model", tolerance: "Tolerance", plot: Path | None, animate: Path | None
) -> None:
    from activefail.bearing.design import TABLE_1, Bearing, Pulse
    from activefail.bearing.simulation import simulate_one

    for path in (plot, animate):
        if path is not None and not path.absolute().parent.is_dir():
            raise InputError(f"{path}: the folder {path.absolute().parent} does not exist.")
    if plot is not None and plot.suffix.lower() not in {".png", ".svg", ".pdf"}:
        raise InputError(f"{plot}: a plot's name must end in .png, .svg or .pdf.")
    if animate is not None and animate.suffix.lower() not in {".gif", ".mp4"}:
        raise InputError(f"{animate}: a film's name must end in .gif or .mp4.")
    response = simulate_one(
        Bearing.from_row(design, model.slider_diameter), Pulse.from_table(*design[7:]), model, tolerance
    )
    _print_response(response)
    for parameter, value in zip(TABLE_1.parameters, design, strict=True):
        if not parameter.low <= value <= parameter.high:
            print(
                f"note: {parameter.name} = {value:g} lies outside the paper's range "
                f"{parameter.low:g} to {parameter.high:g}",
                file=sys.stderr,
            )
    if plot is not None:
        from activefail.report.motion import plot_response

        with _writing(plot):
            plot_response(response).savefig(plot)
        print(f"plot       {plot}")
    if animate is not None:
        from activefail.report.animation import save_animation

        with _writing(animate):
            save_animation(response, animate)
        print(f"film       {animate}")
    if response.outcome == "numerical_failure":
        raise typer.Exit(1)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from None


def _print_response(response: "Response") -> None:
    margins = response.margins

    def row(name: str, value: str, meaning: str) -> None:
        print(f"{name:<10} {value:<10} {meaning}")

    print(f"outcome    {response.outcome}{f' ({response.cause})' if response.cause else ''}")
    if response.outcome == "numerical_failure":
        print("           the integration gave up; this says nothing about the bearing")
    if margins["first_touch_time"] == margins["first_touch_time"]:
        speed = margins["first_touch_velocity"]
        row("impact", f"{margins['first_touch_time']:.3f} s", f"first rim touch, at {speed:.3f} m/s")
    if margins["failure_time"] == margins["failure_time"]:
        row("failure", f"{margins['failure_time']:.3f} s", "after the pulse's centre")
    row("x / D_tot", f"{margins['peak_displacement_ratio']:.3f}", "peak displacement over the capacity")
    row("F_rim / Mg", f"{margins['peak_rim_force_ratio']:.3f}", "peak rim force over the weight")
    row("gap / rim", f"{margins['peak_gap_ratio']:.3f}", "largest uplift of a plate over the rim height; lost above 1")
    row("tilt", f"{margins['peak_tilt']:.3f} rad", "largest rotation of the slider")
    steps, rejected = margins["steps"], margins["rejected_steps"]
    row("energy", f"{margins['energy_error']:.1e}", f"imbalance, relative; {steps:.0f} steps, {rejected:.0f} rejected")


def _simulate_table(source: Path, target: Path, model: "Model", tolerance: "Tolerance") -> None:
    from activefail.study.tables import simulate_table

    began = time.monotonic()
    with _progress_bar("simulating") as begin:
        counts = simulate_table(source, target, model, tolerance, begin)
    total = sum(counts.values())
    print(
        f"{total} designs in {time.monotonic() - began:.1f} s: "
        + ", ".join(f"{n} {name}" for name, n in counts.items())
    )
    print(f"written to {target}")


@contextmanager
def _progress_bar(title: str) -> Iterator[Callable[[int], Callable[[int], None]]]:
    """A bar on a terminal, nothing otherwise; yields what takes the total and returns what takes the rows done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:

        def begin(total: int) -> Callable[[int], None]:
            task = bar.add_task(title, total=total)
            return lambda done: bar.advance(task, done)

        yield begin


# --- campaigns --------------------------------------------------------------------------------------------------


@app.command()
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


@app.command()
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
        _show_warnings(store.warnings)
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
            _stop_on_signals() as stop,
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
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """The first Ctrl-C or SIGTERM asks for a stop after the batch, the second stops at once."""
    asked = False

    def ask(number: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        print("\nstopping after this batch; once more to stop now", file=sys.stderr)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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


def _show_warnings(warnings: tuple[str, ...]) -> None:
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


@app.command()
def status(folder: RunFolder) -> None:
    """Show where a campaign stands; safe while it runs."""
    from activefail.campaign.folder import open_campaign
    from activefail.campaign.loop import standing

    with open_campaign(folder, write=False) as (campaign, store):
        _show_warnings(store.warnings)
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


@app.command()
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
        _show_warnings(store.warnings)
        if not store.batches:
            raise InputError(f"{folder}: has no simulations to learn from yet.")
        classifier = current_classifier(campaign, store, write=False)
        with _progress_bar("predicting") as begin:
            outside = predict_table(campaign, classifier, csv, out, begin)
    if outside:
        print(f"warning: outside the campaign's ranges, where it extrapolates: {outside} designs", file=sys.stderr)
    print(f"written to {out}")


@app.command()
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
        _show_warnings(store.warnings)
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


@app.command()
def export(folder: RunFolder, csv: Annotated[Path, typer.Option(help="Table to write.", show_default=False)]) -> None:
    """Write every simulation of a campaign to a table."""
    from activefail.campaign.folder import open_campaign
    from activefail.study.tables import export_table

    with open_campaign(folder, write=False) as (campaign, store):
        _show_warnings(store.warnings)
        number = export_table(campaign, store, csv)
    print(f"{number} simulations written to {csv}")


@app.command()
def compare(
    source: Annotated[
        Path, typer.Argument(help="Run folder, or campaign file.", metavar="DIR|CAMPAIGN.toml", show_default=False)
    ],
    budgets: Annotated[
        str | None,
        typer.Option(
            help="Of a run folder: numbers of simulations, like 250,500; five by default.", show_default=False
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(help="Of a campaign file: how many seeds.", min=1, max=100)] = 5,
    criteria: Annotated[
        str | None, typer.Option(help="Of a campaign file: criteria, like entropy,bald; its own by default.")
    ] = None,
    features: Annotated[
        str | None, typer.Option(help="Of a campaign file: features, like paper,sliding; its own by default.")
    ] = None,
    static: Annotated[
        str | None,
        typer.Option(help="Of a campaign file: sizes of static hypercubes; its initial and budget by default."),
    ] = None,
    test: Annotated[
        int | None,
        typer.Option(help="Fresh designs to judge by; 2000 for a folder, 5000 for a file.", min=10, max=1_000_000),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Of a campaign file: arms side by side; all cores by default.", min=1)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Of a campaign file: folder of the comparison.", show_default=False)
    ] = None,
) -> None:
    """Judge active sampling and static Latin hypercubes on the same fresh designs.

    Of a run folder: this campaign, against static designs of the same sizes. Of a campaign file: campaigns and static
    designs over several seeds, criteria and features; it can be interrupted and goes on when given again.
    """
    if source.is_dir():
        for name, value in {"criteria": criteria, "features": features, "static": static, "out": out}.items():
            if value is not None:
                raise InputError(f"--{name}: is for the comparison of a campaign file, and {source} is a run folder.")
        _compare_run(source, None if budgets is None else _parse_sizes("--budgets", budgets), test or 2000)
        return
    if budgets is not None:
        raise InputError(f"--budgets: is for the comparison of a run folder, and {source} is none.")
    if out is None:
        raise InputError("--out: required for the comparison of a campaign file.")
    _compare_seeds(source, seeds, criteria, features, static, test or 5000, jobs, out)


def _compare_run(folder: Path, sizes: list[int] | None, test: int) -> None:
    from activefail.campaign.executor import local_executor
    from activefail.campaign.folder import open_campaign
    from activefail.study.compare import compare as compare_samplings

    with open_campaign(folder, write=True) as (campaign, store), local_executor(campaign.simulator) as executor:
        _show_warnings(store.warnings)
        scores = compare_samplings(
            campaign, store, executor, sizes, test, stage=lambda text: print(text, file=sys.stderr, flush=True)
        )
    boundary = campaign.settings.acquisition.main_boundary
    print(
        f"{'simulations':>11}  {'sampling':<8}  {f'{boundary} accuracy':>18} {'95 % interval':>16}"
        f"  {'outcome accuracy':>16}  {'log score':>9}"
    )
    for row in sorted(scores, key=lambda score: (score.simulations, score.sampling)):
        print(
            f"{row.simulations:>11}  {row.sampling:<8}  {100 * row.accuracy:>16.2f} % "
            f"{100 * row.low:>6.2f} to {100 * row.high:.2f} %"
            f"  {100 * row.outcome_accuracy:>14.2f} %  {row.log_score:>9.4f}"
        )

    from activefail.report.curves import plot_learning_curves
    from activefail.study.compare import Score
    from activefail.table import writing

    results = folder / "compare"
    with _writing(results):
        results.mkdir(exist_ok=True)
        with writing(results / "scores.csv", [*Score.columns(), "test_designs"]) as write:
            write([[*score.row(), test] for score in scores])
        figure = plot_learning_curves(scores, boundary, test)
        for suffix in ("png", "svg"):
            figure.savefig(results / f"learning_curves.{suffix}")
    print(f"table      {results / 'scores.csv'}")
    print(f"curves     {results / 'learning_curves.png'} and .svg")


def _compare_seeds(
    file: Path,
    seeds: int,
    criteria: str | None,
    features: str | None,
    static: str | None,
    test: int,
    jobs: int | None,
    out: Path,
) -> None:
    from activefail.campaign.config import read_settings
    from activefail.report.comparison import comparison_lines, write_comparison
    from activefail.study.seeds import OWN, Plan, compare_seeds

    settings = read_settings(file)
    sampling, own = settings.sampling, settings.classifier.features
    plan = Plan(
        settings,
        seeds,
        _parse_names(criteria) or (settings.acquisition.criterion,),
        _parse_names(features) or (own if isinstance(own, str) else OWN,),
        tuple(sorted({sampling.initial, sampling.budget}) if static is None else _parse_sizes("--static", static)),
        test,
    )

    def stage(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    with _writing(out), _stop_on_signals() as stop:
        scores = compare_seeds(
            plan,
            out,
            jobs or os.cpu_count() or 1,
            stage,
            lambda done, all_: stage(f"{done} of {all_} arms scored"),
            stop,
        )
        if scores is None:
            print(f"stopped; what was scored is kept in {out}. The same command goes on.", file=sys.stderr)
            raise typer.Exit(130)
        page = write_comparison(plan, scores, out)
    print("\n".join(comparison_lines(scores)))
    print(f"page       {page}")


def _parse_names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


@app.command()
def paper(
    draws: Annotated[int, typer.Option(help="Independent samples of 250 simulations.", min=4, max=1000)] = 20,
    fresh: Annotated[int, typer.Option(help="Fresh designs to judge by.", min=100, max=1_000_000)] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of everything.", min=0)] = 1,
    out: Annotated[Path, typer.Option(help="Folder for reproduction.md and its figures.")] = Path("runs/reproduction"),
) -> None:
    """Reproduce the paper: its tables and figures beside ours, with intervals."""
    from activefail.report.claims import claims
    from activefail.report.reproduction import write_reproduction
    from activefail.study.paper import run_study

    def stage(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    with _writing(out):
        out.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    study = run_study(draws, fresh, seed, stage)
    command = {"draws": draws, "fresh": fresh, "seed": seed, "cores": os.cpu_count() or 1}
    command["minutes"] = math.ceil((time.monotonic() - begun) / 60.0)
    with _writing(out):
        page = write_reproduction(study, out, command, stage)
    for line in claims(study):
        print(f"{line.item}: {line.verdict.replace('*', '')}")
        print(f"    paper {line.paper or '–'}   ours {line.ours}   one sample {line.one_sample or '–'}")
    print(f"page       {page}")


def _parse_sizes(option: str, text: str) -> list[int]:
    try:
        sizes = sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise InputError(f"{option}: must be whole numbers with commas between them, got {text!r}.") from None
    if sizes[0] < 2:
        raise InputError(f"{option}: must be at least 2, got {sizes[0]}.")
    return sizes


if __name__ == "__main__":
    main()
