"""`activefail report`: a campaign as an HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import Code, RunFolder, opened_run, show_stage
from activefail.cli.options import with_options
from activefail.errors import InputError
from activefail.files import check_file
from activefail.record.layout import check_output
from activefail.requests import FIXED
from activefail.visible import visible


@with_options(fixed=FIXED)
def report(
    folder: RunFolder,
    out: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the run folder by default.", show_default=False)
    ] = None,
    hazard: Annotated[
        Path | None,
        typer.Option(
            help="Hazard file (docs/hazard.md): adds fragility curves and the bearing that each target requires.",
            show_default=False,
        ),
    ] = None,
    fixed: Path | None = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="With --hazard: largest acceptable probability, such as 0.10, or a risk category; by default all "
            "three categories.",
            show_default=False,
        ),
    ] = None,
    code: Code = None,
) -> None:
    """Write a campaign's results to one HTML file.

    The file needs no other file and no network.
    """
    from activefail.record.layout import REPORT

    check_output("--out", out)
    check_file(out, "a report", (".html", ".htm"))
    if hazard is None and (fixed is not None or target is not None):
        raise InputError(f"--{'fixed' if fixed is not None else 'target'} requires --hazard.")
    page = out or folder / REPORT
    with opened_run(folder, code=code) as opened:
        evidence = opened.report(page, show_stage, hazard, fixed, target)
    for reason in evidence.missing.values():
        print(f"missing    {visible(reason)}")
    print(f"report     {visible(str(page))}")
