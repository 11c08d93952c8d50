"""Commands that compare: samplings with each other, and our results with the paper's."""

import math
import os
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import INTERRUPTED, Code, check_output, show_warnings, stop_on_signals, writing_to
from activefail.errors import InputError
from activefail.shares import interval_percent, percent
from activefail.visible import visible


def compare(
    source: Annotated[
        Path, typer.Argument(help="Run folder, or campaign file.", metavar="DIR|CAMPAIGN.toml", show_default=False)
    ],
    budgets: Annotated[
        str | None,
        typer.Option(help="Of a run folder: numbers of simulations, like 250,500; six by default.", show_default=False),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(help="Of a campaign file: how many seeds; 5 by default.", min=1, max=100)
    ] = None,
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
    code: Code = None,
) -> None:
    """Judge active sampling and static Latin hypercubes on the same fresh designs.

    Of a run folder: this campaign, against static designs of the same sizes. Of a campaign file: campaigns and static
    designs over several seeds, criteria and features; it can be interrupted and goes on when given again.
    """
    if source.is_dir():
        for name, value in {
            "seeds": seeds,
            "criteria": criteria,
            "features": features,
            "static": static,
            "jobs": jobs,
            "out": out,
        }.items():
            if value is not None:
                raise InputError(f"--{name}: is for the comparison of a campaign file, and {source} is a run folder.")
        _compare_run(source, None if budgets is None else _parse_sizes("--budgets", budgets), test or 2000, code)
        return
    if source.suffix != ".toml":
        raise InputError(f"{source}: is not a run folder, nor a campaign file (.toml).")
    for name, value in {"budgets": budgets, "code": code}.items():
        if value is not None:
            raise InputError(f"--{name}: is for the comparison of a run folder, and {source} is none.")
    if out is None:
        raise InputError("--out: required for the comparison of a campaign file.")
    _compare_seeds(source, seeds or 5, criteria, features, static, test or 5000, jobs, out)


def _compare_run(folder: Path, sizes: list[int] | None, test: int, code: Path | None) -> None:
    from activefail.campaign.opening import open_campaign
    from activefail.comparison.static import compare as compare_samplings
    from activefail.execution.local import local_executor

    with (
        open_campaign(folder, write=True, code=code) as (campaign, store),
        local_executor(campaign.simulator, time_limit=campaign.time_limit) as executor,
    ):
        show_warnings(store)
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
            f"{row.simulations:>11}  {row.sampling:<8}  {percent(row.accuracy, 2):>18} "
            f"{interval_percent(row.low, row.high):>16}  {percent(row.outcome_accuracy, 2):>16}  {row.log_score:>9.4f}"
        )
    print("recall of each outcome: share of the test designs with it that are predicted so, with a 95 % interval")
    for row in sorted(scores, key=lambda score: (score.simulations, score.sampling)):
        recall = ", ".join(f"{name} {one.in_words}" for name, one in row.recall.items())
        print(f"{row.simulations:>11}  {row.sampling:<8}  {recall}")

    from activefail.comparison.static import Score
    from activefail.csv_table import writing
    from activefail.figures.curves import plot_learning_curves
    from activefail.figures.style import save
    from activefail.record.layout import COMPARISON

    results = folder / COMPARISON
    with writing_to(results):
        results.mkdir(exist_ok=True)
        columns = [*Score.columns(), *Score.recall_columns(campaign.simulator.outcomes), "test_unanswered"]
        with writing(results / "scores.csv", columns) as write:
            write([[*score.row(), test - score.test_designs] for score in scores])
        figure = plot_learning_curves(scores, boundary, scores[0].test_designs)
        for suffix in ("png", "svg"):
            save(figure, results / f"learning_curves.{suffix}")
    print(f"table      {visible(str(results / 'scores.csv'))}")
    print(f"curves     {visible(str(results / 'learning_curves.png'))} and .svg")


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
    from activefail.campaign.settings import read_settings
    from activefail.comparison.seeds import OWN, Plan, compare_seeds
    from activefail.report.comparison import comparison_lines, write_comparison

    check_output("--out", out)
    settings = read_settings(file)
    sizes = [] if static is None else _parse_sizes("--static", static)
    if any(size < 2 for size in sizes):
        raise InputError(f"--static: must be at least 2, got {sizes[0]}.")
    sampling, own = settings.sampling, settings.classifier.features
    plan = Plan(
        settings,
        seeds,
        _parse_names(criteria) or (settings.acquisition.criterion,),
        _parse_names(features) or (own if isinstance(own, str) else OWN,),
        tuple(sizes or sorted({sampling.initial, sampling.budget})),
        test,
        file.absolute().parent,
    )

    def stage(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    try:
        with writing_to(out), stop_on_signals() as stop:
            scores = compare_seeds(
                plan,
                out,
                jobs or os.cpu_count() or 1,
                stage,
                lambda done, all_: stage(f"{done} of {all_} arms scored"),
                stop,
            )
            page = None if scores is None else write_comparison(plan, scores, out)
    except KeyboardInterrupt:
        scores = page = None
    if scores is None or page is None:
        print(f"stopped; what was scored is kept in {visible(str(out))}. The same command goes on.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    print("\n".join(comparison_lines(scores)))
    print(f"page       {visible(str(page))}")


def _parse_names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def paper(
    draws: Annotated[int, typer.Option(help="Independent samples of 250 simulations.", min=4, max=1000)] = 20,
    fresh: Annotated[int, typer.Option(help="Fresh designs to judge by.", min=100, max=1_000_000)] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of everything.", min=0)] = 1,
    out: Annotated[Path, typer.Option(help="Folder for reproduction.md and its figures.")] = Path("runs/reproduction"),
) -> None:
    """Reproduce the paper: its tables and figures beside ours, with intervals."""
    from activefail.paper.claims import claims
    from activefail.paper.study import run_study
    from activefail.report.reproduction import write_reproduction

    def stage(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    check_output("--out", out)
    with writing_to(out):
        out.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    try:
        study = run_study(draws, fresh, seed, stage)
    except KeyboardInterrupt:
        print("stopped; nothing is kept of it. The same command begins anew.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    command = {"draws": draws, "fresh": fresh, "seed": seed, "cores": os.cpu_count() or 1}
    command["minutes"] = math.ceil((time.monotonic() - begun) / 60.0)
    with writing_to(out):
        page = write_reproduction(study, out, command, stage)
    for line in claims(study):
        print(f"{line.item}: {line.verdict.replace('*', '')}")
        print(f"    paper {line.paper or '–'}   ours {line.ours}   one sample {line.one_sample or '–'}")
    print(f"page       {visible(str(page))}")


def _parse_sizes(option: str, text: str) -> list[int]:
    try:
        return sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise InputError(f"{option}: must be whole numbers with commas between them, got {text!r}.") from None
