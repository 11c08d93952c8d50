"""`activefail fragility`: probabilities against an intensity or a variable."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from activefail.cli.common import (
    STANDARD,
    AsJson,
    Code,
    Fixed,
    RunFolder,
    check_out,
    check_table,
    name_of,
    opened_run,
    print_json,
    show_stage,
    show_unseen,
    table_output,
)
from activefail.errors import InputError
from activefail.files import writing_to
from activefail.visible import visible


def fragility(
    folder: RunFolder,
    hazard: Annotated[
        Path | None,
        typer.Option(
            help="Hazard file; the curves are against the intensity of its pulses (docs/hazard.md).", show_default=False
        ),
    ] = None,
    fixed: Fixed = None,
    intensity: Annotated[
        Literal["pgv", "a_p"], typer.Option(help="With --hazard: peak ground velocity, or amplitude of the pulses.")
    ] = "pgv",
    against: Annotated[
        str | None,
        typer.Option(help="Without --hazard: the variable of the curves.", metavar="VARIABLE", show_default=False),
    ] = None,
    bounds: Annotated[
        str | None,
        typer.Option(
            "--range",
            help="With --against: range of the variable; that of the campaign by default.",
            metavar="LOW,HIGH",
            show_default=False,
        ),
    ] = None,
    question: Annotated[
        Path | None,
        typer.Option(help="With --against: file with other distributions (docs/probability.md).", show_default=False),
    ] = None,
    verify: Annotated[
        int, typer.Option(help="Fresh simulations, outside the budget, for intervals.", min=0, max=1_000_000)
    ] = 0,
    confidence: Annotated[float, typer.Option(help="Confidence of the intervals.", min=0.5, max=0.999)] = 0.95,
    outcome: Annotated[
        str | None,
        typer.Option(help="Outcome whose curve is verified. Default: the outcome of the target boundary."),
    ] = None,
    as_json: AsJson = False,
    csv: Annotated[
        Path | None, typer.Option(help="Table of the curves to write; - is standard output.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the page fragility.html, its pictures, fragility.json, tables, and files for pelicun and "
            "OpenQuake.",
            show_default=False,
        ),
    ] = None,
    code: Code = None,
) -> None:
    """Show the probability of each outcome against intensity.

    The curves are for the outcome or a more severe one, against the intensity of the pulse or another variable.
    """
    check_out(out)
    check_table("--csv", csv)
    if csv == STANDARD and as_json:
        raise InputError("--csv -: cannot be combined with --json; both write to standard output.")
    ends = None if bounds is None else _parsed_range(bounds)
    with opened_run(folder, write=verify > 0, code=code) as opened:
        findings = opened.fragility(
            hazard, fixed, intensity, against, ends, question, verify, confidence, outcome, stage=show_stage
        )
        show_unseen(opened.summary)
        outcomes = opened.campaign.simulator.outcomes
    from activefail.risk.fragility.curve_files import write_curves
    from activefail.risk.fragility.wording import lines
    from activefail.simulators.bearing import terms_of

    terms = terms_of(opened.campaign.simulator, findings.fixed)
    if csv is not None:
        with table_output("--csv", csv) as target:
            write_curves(findings, target)
    written = []
    if out is not None:
        from activefail.report.fragility import write_fragility

        with writing_to(out):
            written = write_fragility(findings, outcomes, out)
    if as_json:
        print_json(findings.as_json())
        return
    if csv == STANDARD:
        return
    print("\n".join(map(visible, lines(findings, outcomes))))
    if terms is not None:
        print("\n".join(f"{title:<10} {text}" for title, text in terms.lines()))
    if csv is not None:
        print(f"table      {name_of(csv)}")
    if out is not None:
        print(f"written    in {visible(str(out))}: {', '.join(path.name for path in written)}")


def _parsed_range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--range: must be two numbers separated by a comma, got {text!r}.") from None
    return low, high
