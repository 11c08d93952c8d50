"""Commands that compare samplings with each other, and our results with the paper's."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from activefail.cli.common import AsJson, Code, opened_run, print_json, show_stage, show_unseen
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.interrupts import INTERRUPTED, stop_on_signals
from activefail.record.layout import check_output
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.comparison.seeds import ComparisonPlan


def compare(
    source: Annotated[
        Path,
        typer.Argument(
            help="Run folder, campaign file, or the name of a shipped campaign.",
            metavar="DIR|CAMPAIGN.toml",
            show_default=False,
        ),
    ],
    budgets: Annotated[
        str | None,
        typer.Option(
            help="With a run folder: numbers of simulations, such as 250,500; six sizes by default.", show_default=False
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            help="Number of seeds. Default: 5; with a run folder 1, of the static designs alone.",
            min=1,
            max=100,
        ),
    ] = None,
    criteria: Annotated[
        str | None,
        typer.Option(help="With a campaign file: criteria, such as entropy,bald; those of the file by default."),
    ] = None,
    features: Annotated[
        str | None,
        typer.Option(help="With a campaign file: features, such as paper,sliding; those of the file by default."),
    ] = None,
    static: Annotated[
        str | None,
        typer.Option(
            help="Sizes of static designs. Default: `initial` and `budget` of the file; with a run folder, --budgets."
        ),
    ] = None,
    test: Annotated[
        int | None,
        typer.Option(
            help="Fresh test designs. Default: 2000 for a run folder, 5000 for a file.", min=10, max=1_000_000
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="With a campaign file: campaigns and static designs in parallel; all cores by default.", min=1
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="With a campaign file: folder of the comparison.", show_default=False)
    ] = None,
    as_json: AsJson = False,
    code: Code = None,
) -> None:
    """Compare active sampling with static designs.

    Both are scored on the same fresh designs. For a run folder: compares the campaign with static designs, and ends
    with the size of a static design that is as accurate. For a campaign file: compares campaigns and static designs
    over seeds, criteria and features; after an interruption, the same command continues.
    """
    from activefail.campaign.on_disk import campaign_file

    sizes = _parse_sizes("--static", static, least=2)
    if source.is_dir():
        of_files = {"criteria": criteria, "features": features, "jobs": jobs, "out": out}
        _check_unset(of_files, f"a campaign file; {source} is a run folder")
        _compare_run(source, _parse_sizes("--budgets", budgets), sizes, seeds or 1, test, as_json, code)
        return
    source = campaign_file(source)
    if source.suffix != ".toml":
        raise InputError(f"{source}: is not a run folder or a campaign file (.toml).")
    of_folders = {"budgets": budgets, "code": code}
    _check_unset(of_folders, f"a run folder; {source} is a campaign file")
    if out is None:
        raise InputError("--out: required for the comparison of a campaign file.")
    check_output("--out", out)
    from activefail.comparison.seeds import ComparisonPlan

    plan = ComparisonPlan.of(source, seeds, _parse_names(criteria), _parse_names(features), sizes, test)
    _compare_seeds(plan, out, jobs, as_json)


def _check_unset(options: Mapping[str, object], only: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name}: only for the comparison of {only}.")


def _parse_names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def _parse_sizes(option: str, text: str | None, least: int | None = None) -> list[int]:
    try:
        sizes = [] if text is None else sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise InputError(f"{option}: must be whole numbers separated by commas, got {text!r}.") from None
    if least is not None and sizes and sizes[0] < least:
        raise InputError(f"{option}: must be at least {least}, got {sizes[0]}.")
    return sizes


def _compare_run(
    folder: Path,
    budgets: list[int],
    static: list[int],
    seeds: int,
    test: int | None,
    as_json: bool,
    code: Path | None,
) -> None:
    with opened_run(folder, write=True, code=code) as opened:
        found = opened.compare(budgets, test or 2000, static, seeds, stage=show_stage)
        show_unseen(opened.summary)
    if as_json:
        print_json(found.as_json())
        return
    print("\n".join(map(visible, found.lines)))


def _compare_seeds(plan: "ComparisonPlan", out: Path, jobs: int | None, as_json: bool) -> None:
    from activefail.report.comparison import comparison_json, comparison_lines, run_comparison

    try:
        with stop_on_signals() as stop:
            compared = run_comparison(plan, out, jobs, show_stage, stop)
    except KeyboardInterrupt:
        compared = None
    if compared is None:
        print(f"stopped; scores are kept in {visible(str(out))}. Run the same command to continue.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    scores, page = compared
    if as_json:
        print_json(comparison_json(plan, scores) | {"page": str(page)})
        return
    print("\n".join(comparison_lines(scores)))
    print(f"page       {visible(str(page))}")


def paper(
    draws: Annotated[int, typer.Option(help="Independent samples of 250 simulations.", min=4, max=1000)] = 20,
    fresh: Annotated[int, typer.Option(help="Fresh test designs.", min=100, max=1_000_000)] = 4000,
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 1,
    out: Annotated[Path, typer.Option(help="Folder for reproduction.md and its figures.")] = Path("runs/reproduction"),
    as_json: AsJson = False,
) -> None:
    """Reproduce the paper's tables and figures, with intervals."""
    from activefail.paper.claims import claims
    from activefail.paper.study import run_study
    from activefail.report.reproduction import write_reproduction

    check_output("--out", out)
    with writing_to(out):
        out.mkdir(parents=True, exist_ok=True)
    try:
        study = run_study(draws, fresh, seed, show_stage)
    except KeyboardInterrupt:
        print("stopped; nothing was saved. Run the same command to start over.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    page = write_reproduction(study, out, show_stage)
    if as_json:
        counts = {"simulations": study.data.simulations, "numerical_failures": study.data.numerical_failures}
        found = [claim.as_json() for claim in claims(study)]
        print_json({**study.command, **counts, "claims": found, "page": str(page)})
        return
    print("\n".join(line for claim in claims(study) for line in claim.lines))
    print(f"page       {visible(str(page))}")
