"""`activefail compare`: active sampling against static designs."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from activefail.cli.common import AsJson, Code, opened_run, show_findings, show_stage, show_unseen
from activefail.errors import InputError
from activefail.record.layout import check_output
from activefail.run.analysis import REQUIRED, Findings, option
from activefail.session.interrupts import INTERRUPTED, stop_on_signals
from activefail.visible import visible


def compare(
    source: Path = option(
        REQUIRED,
        "Run folder, campaign file, or the name of a shipped campaign.",
        Path,
        is_argument=True,
        metavar="DIR|CAMPAIGN.toml",
    ),
    budgets: str | None = option(
        None, "With a run folder: numbers of simulations, such as 250,500; six sizes by default."
    ),
    seeds: int | None = option(
        None, "Number of seeds. Default: 5; with a run folder 1, of the static designs alone.", int, low=1, high=100
    ),
    criteria: str | None = option(
        None, "With a campaign file: criteria, such as entropy,bald; those of the file by default."
    ),
    features: str | None = option(
        None, "With a campaign file: features, such as paper,sliding; those of the file by default."
    ),
    static: str | None = option(
        None,
        "Sizes of static designs. Default: `initial` and `budget` of the file; with a run folder, --budgets.",
    ),
    test: int | None = option(
        None, "Fresh test designs. Default: 2000 for a run folder, 5000 for a file.", int, low=10, high=1_000_000
    ),
    jobs: int | None = option(
        None, "With a campaign file: campaigns and static designs in parallel; all cores by default.", int, low=1
    ),
    out: Path | None = option(None, "With a campaign file: folder of the comparison.", Path),
    as_json: AsJson = False,
    code: Code = None,
) -> None:
    """Compare active sampling with static designs.

    Both are scored on the same fresh designs. For a run folder: compares the campaign with static designs, and ends
    with the size of a static design that is as accurate. For a campaign file: compares campaigns and static designs
    over seeds, criteria and features; after an interruption, the same command continues.
    """
    from activefail.campaign.on_disk import campaign_file

    found: Findings
    sizes = _sizes("--static", static, least=2)
    if source.is_dir():
        of_files = {"criteria": criteria, "features": features, "jobs": jobs, "out": out}
        _check_unset(of_files, f"a campaign file; {source} is a run folder")
        with opened_run(source, write=True, code=code) as opened:
            of_run = _sizes("--budgets", budgets), test or 2000, sizes, seeds or 1
            found = opened.compare(*of_run, stage=show_stage)
            show_unseen(opened.summary)
    else:
        file = campaign_file(source)
        if file.suffix != ".toml":
            raise InputError(f"{file}: is not a run folder or a campaign file (.toml).")
        _check_unset({"budgets": budgets, "code": code}, f"a run folder; {file} is a campaign file")
        if out is None:
            raise InputError("--out: required for the comparison of a campaign file.")
        check_output("--out", out)
        found = _over_seeds(out, jobs, file, seeds, _names(criteria), _names(features), sizes, test)
    show_findings(found, as_json)


def _over_seeds(out: Path, jobs: int | None, *plan: Any) -> Findings:
    """The comparison of a campaign file (see `ComparisonPlan.of`)."""
    from activefail.analyses.comparison.seeds import ComparisonPlan
    from activefail.pages.report.comparison import run_comparison

    asked = ComparisonPlan.of(*plan)
    try:
        with stop_on_signals() as stop:
            found = run_comparison(asked, out, jobs, show_stage, stop)
    except KeyboardInterrupt:
        found = None
    if found is None:
        print(f"stopped; scores are kept in {visible(str(out))}. Run the same command to continue.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED)
    return found


def _check_unset(options: Mapping[str, object], only: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name}: only for the comparison of {only}.")


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def _sizes(option: str, text: str | None, least: int | None = None) -> list[int]:
    try:
        sizes = [] if text is None else sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise InputError(f"{option}: must be whole numbers separated by commas, got {text!r}.") from None
    if least is not None and sizes and sizes[0] < least:
        raise InputError(f"{option}: must be at least {least}, got {sizes[0]}.")
    return sizes
