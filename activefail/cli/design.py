"""`activefail design`: the cheapest design that meets a target."""

from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import (
    AsJson,
    Code,
    Fixed,
    RunFolder,
    check_out,
    opened_run,
    print_json,
    show_stage,
    show_unseen,
)
from activefail.files import writing_to
from activefail.visible import visible

OUT_OF_REACH = 3
"""Exit code if no design was shown to meet its target."""


def design(
    folder: RunFolder,
    target: Annotated[
        str,
        typer.Option(
            help="Largest acceptable probability of failure, such as 0.10 or 10%; a risk category, II, III or IV; a "
            "risk such as '1% in 50 years'; or one for each outcome, such as failure=0.05,impact=0.3, where "
            "impact means impact or worse.",
            show_default=False,
        ),
    ],
    hazard: Annotated[
        Path | None, typer.Option(help="Hazard file of the site (docs/hazard.md).", show_default=False)
    ] = None,
    question: Annotated[
        Path | None,
        typer.Option(help="Question file instead of a hazard (docs/probability.md).", show_default=False),
    ] = None,
    fixed: Fixed = None,
    free: Annotated[
        str | None,
        typer.Option(help="Variables to design, such as D_tot,mu; D_tot by default.", show_default=False),
    ] = None,
    cost: Annotated[
        str | None,
        typer.Option(
            help="Expression to minimise, such as 'D_tot * (1 + 20 * mu)'; the first free variable by default.",
            show_default=False,
        ),
    ] = None,
    confidence: Annotated[float, typer.Option(help="Confidence that the target is met.", min=0.5, max=0.999)] = 0.95,
    simulations: Annotated[
        int,
        typer.Option(
            help="Maximum number of fresh simulations for each target; not part of the budget.", min=50, max=1_000_000
        ),
    ] = 1000,
    chart: Annotated[bool, typer.Option(help="Compute the chart of required values, with --out.")] = True,
    as_json: AsJson = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the page design.html, its pictures, and design.json and design.toml.", show_default=False
        ),
    ] = None,
    code: Code = None,
) -> None:
    """Find and verify the smallest design that meets a target.

    The target is a probability of an outcome, such as failure.
    """
    check_out(out)
    with opened_run(folder, write=True, code=code) as opened:
        findings = opened.design(
            target,
            hazard,
            question,
            fixed,
            [name.strip() for name in free.split(",")] if free is not None else (),
            cost or "",
            confidence,
            simulations,
            chart and out is not None,
            show_stage,
        )
        show_unseen(opened.summary)
    written = []
    if out is not None:
        from activefail.report.design import write_design

        with writing_to(out):
            written = write_design(findings, out)
    if as_json:
        print_json(findings.as_json())
    else:
        for title, text in findings.lines():
            print(visible(f"{title:<10} {text}"))
        if out is not None:
            print(f"written    in {visible(str(out))}: {', '.join(path.name for path in written)}")
    if findings.designed.status != "verified":
        raise typer.Exit(OUT_OF_REACH)
