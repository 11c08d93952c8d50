"""`activefail sensitivity`: which variables move a probability."""

from pathlib import Path
from typing import Annotated

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
    show_note,
    show_unseen,
    table_output,
)
from activefail.display import progress_bar
from activefail.errors import InputError
from activefail.shares import percent
from activefail.visible import visible


def sensitivity(
    folder: RunFolder,
    hazard: Annotated[
        Path | None,
        typer.Option(
            help="Hazard file (docs/hazard.md); the sensitivity of a design's probability, averaged over the pulses.",
            show_default=False,
        ),
    ] = None,
    question: Annotated[
        Path | None,
        typer.Option(
            help="File with other distributions of the variables (docs/probability.md).",
            show_default=False,
        ),
    ] = None,
    fixed: Fixed = None,
    outcome: Annotated[
        str | None,
        typer.Option(
            help="Outcome whose probability is explained. Default: the outcome of the target boundary.",
            show_default=False,
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            help="Points of the sample: a power of two, at least 16. Default: as many as take about two minutes.",
            min=16,
        ),
    ] = None,
    confidence: Annotated[float, typer.Option(help="Confidence of the intervals.", min=0.5, max=0.999)] = 0.95,
    as_json: AsJson = False,
    csv: Annotated[
        Path | None, typer.Option(help="CSV table to write; - is standard output.", show_default=False)
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for a page with pictures.", show_default=False)] = None,
    code: Code = None,
) -> None:
    """Show which variables affect a probability most.

    The classifier gives Sobol' indices, and the effect of one variable at a time.
    """
    check_out(out)
    check_table("--csv", csv)
    if as_json and csv == STANDARD:
        raise InputError("--json: cannot be combined with `--csv -`; both write to standard output.")
    from activefail.report import sensitivity as words

    with opened_run(folder, code=code) as opened:
        with progress_bar("evaluating") as begin:
            findings = opened.sensitivity(hazard, question, fixed, outcome, samples, confidence, begin)
        summary, campaign = opened.summary, opened.campaign
    show_unseen(summary)
    if out is not None:
        page = words.write_sensitivity(findings, campaign, out)
        show_note(f"page written to {visible(str(page))}")
    if csv is not None:
        with table_output("--csv", csv) as target:
            words.write_csv(findings, target)
        show_note(f"table written to {name_of(csv)}")
    if csv == STANDARD:
        return
    if as_json:
        print_json(words.as_json(findings))
        return
    print(visible(words.heading(findings, campaign.simulator.outcomes)))
    if findings.moves:
        print(
            f"\nprobability {percent(findings.probability)} with all variables at their base values, without an "
            "interval"
        )
        print("\n".join(map(visible, words.aligned(words.move_rows(findings)))))
    if findings.indices:
        print("\nSobol' indices")
        print("\n".join(map(visible, words.aligned(words.index_rows(findings)))))
    print()
    for title, text in words.about(findings):
        print(visible(f"{title:<10} {text}"))
    for sentence in findings.notes:
        print(f"note       {visible(sentence)}")
