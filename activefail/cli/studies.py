"""Commands that compare samplings with each other, and our results with the paper's."""

import math
import os
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import Code, show_stage, show_unseen, show_warnings
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.interrupts import INTERRUPTED, stop_on_signals
from activefail.record.layout import check_output
from activefail.visible import visible


def compare(
    source: Annotated[
        Path, typer.Argument(help="Run folder, or campaign file.", metavar="DIR|CAMPAIGN.toml", show_default=False)
    ],
    budgets: Annotated[
        str | None,
        typer.Option(help="Run folder: numbers of simulations, like 250,500; six by default.", show_default=False),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(help="Campaign file: number of seeds; 5 by default.", min=1, max=100)
    ] = None,
    criteria: Annotated[
        str | None, typer.Option(help="Campaign file: criteria, like entropy,bald; by default the file's.")
    ] = None,
    features: Annotated[
        str | None, typer.Option(help="Campaign file: features, like paper,sliding; by default the file's.")
    ] = None,
    static: Annotated[
        str | None,
        typer.Option(help="Campaign file: sizes of static designs; by default the file's initial and budget."),
    ] = None,
    test: Annotated[
        int | None,
        typer.Option(help="Fresh test designs; 2000 for a run folder, 5000 for a file.", min=10, max=1_000_000),
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Campaign file: parallel arms; all cores by default.", min=1)] = None,
    out: Annotated[
        Path | None, typer.Option(help="Campaign file: folder of the comparison.", show_default=False)
    ] = None,
    code: Code = None,
) -> None:
    """Compare active sampling with static designs on the same fresh designs.

    For a run folder: compares the campaign with static designs of the same sizes. For a campaign file: compares
    campaigns and static designs over seeds, criteria and features; after an interruption, the same command continues.
    """
    if source.is_dir():
        names = ("seeds", "criteria", "features", "static", "jobs", "out")
        for name, value in zip(names, (seeds, criteria, features, static, jobs, out), strict=True):
            if value is not None:
                raise InputError(f"--{name}: only for the comparison of a campaign file; {source} is a run folder.")
        _compare_run(source, None if budgets is None else _parse_sizes("--budgets", budgets), test or 2000, code)
        return
    if source.suffix != ".toml":
        raise InputError(f"{source}: is not a run folder or a campaign file (.toml).")
    for name, value in {"budgets": budgets, "code": code}.items():
        if value is not None:
            raise InputError(f"--{name}: only for the comparison of a run folder; {source} is a campaign file.")
    if out is None:
        raise InputError("--out: required for the comparison of a campaign file.")
    _compare_seeds(source, seeds or 5, criteria, features, static, test or 5000, jobs, out)


def _compare_run(folder: Path, sizes: list[int] | None, test: int, code: Path | None) -> None:
    from activefail.comparison.static import score_lines
    from activefail.record.layout import COMPARISON
    from activefail.run import open_run

    results = folder / COMPARISON
    with open_run(folder, write=True, code=code) as opened:
        show_warnings(opened.store)
        scores = opened.compare(sizes, test, show_stage)
        show_unseen(opened.summary)
    print("\n".join(score_lines(scores, opened.boundary)))
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
    from activefail.comparison.seeds import CUSTOM, ComparisonPlan, compare_seeds
    from activefail.report.comparison import comparison_lines, write_comparison

    check_output("--out", out)
    settings = read_settings(file)
    sizes = [] if static is None else _parse_sizes("--static", static)
    if any(size < 2 for size in sizes):
        raise InputError(f"--static: must be at least 2, got {sizes[0]}.")
    sampling, default_features = settings.sampling, settings.classifier.features
    plan = ComparisonPlan(
        settings,
        seeds,
        _parse_names(criteria) or (settings.acquisition.criterion,),
        _parse_names(features) or (default_features if isinstance(default_features, str) else CUSTOM,),
        tuple(sizes or sorted({sampling.initial, sampling.budget})),
        test,
        file.absolute().parent,
    )

    try:
        with writing_to(out), stop_on_signals() as stop:
            scores = compare_seeds(
                plan,
                out,
                jobs or os.cpu_count() or 1,
                show_stage,
                lambda done, total: show_stage(f"{done} of {total} arms scored"),
                stop,
            )
            page = None if scores is None else write_comparison(plan, scores, out)
    except KeyboardInterrupt:
        scores = page = None
    if scores is None or page is None:
        print(f"stopped; scores are kept in {visible(str(out))}. The same command continues.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    print("\n".join(comparison_lines(scores)))
    print(f"page       {visible(str(page))}")


def _parse_names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def paper(
    draws: Annotated[int, typer.Option(help="Independent samples of 250 simulations.", min=4, max=1000)] = 20,
    fresh: Annotated[int, typer.Option(help="Fresh test designs.", min=100, max=1_000_000)] = 4000,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 1,
    out: Annotated[Path, typer.Option(help="Folder for reproduction.md and its figures.")] = Path("runs/reproduction"),
) -> None:
    """Reproduce the paper's tables and figures, with intervals."""
    from activefail.paper.claims import claims
    from activefail.paper.study import run_study
    from activefail.report.reproduction import write_reproduction

    check_output("--out", out)
    with writing_to(out):
        out.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    try:
        study = run_study(draws, fresh, seed, show_stage)
    except KeyboardInterrupt:
        print("stopped; nothing was saved. The same command starts over.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    command = {"draws": draws, "fresh": fresh, "seed": seed, "cores": os.cpu_count() or 1}
    command["minutes"] = math.ceil((time.monotonic() - start) / 60.0)
    with writing_to(out):
        page = write_reproduction(study, out, command, show_stage)
    for line in claims(study):
        print(f"{line.item}: {line.verdict.replace('*', '')}")
        print(f"    paper {line.paper or '–'}   ours {line.ours}   one sample {line.one_sample or '–'}")
    print(f"page       {visible(str(page))}")


def _parse_sizes(option: str, text: str) -> list[int]:
    try:
        return sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise InputError(f"{option}: must be whole numbers separated by commas, got {text!r}.") from None
