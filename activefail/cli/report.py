"""`activefail report`: a campaign as a page."""

from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import Code, RunFolder, check_output, show_stage, show_warnings, writing_to
from activefail.errors import InputError
from activefail.visible import visible


def report(
    folder: RunFolder,
    out: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the run folder by default.", show_default=False)
    ] = None,
    code: Code = None,
) -> None:
    """Write what a campaign has found as one HTML file that needs nothing else."""
    from activefail.record.layout import REPORT
    from activefail.run import open_run

    check_output("--out", out)
    target = out or folder / REPORT
    if target.suffix.lower() not in {".html", ".htm"}:
        raise InputError(f"--out: must end in .html, got {str(target)!r}.")
    if out is not None and not target.absolute().parent.is_dir():
        raise InputError(f"--out: the folder {target.absolute().parent} does not exist.")
    with open_run(folder, code=code) as opened:
        show_warnings(opened.store)
        show_stage("learning")
        opened.learn()
        show_warnings(opened.store)
        with writing_to(target):
            evidence = opened.report(target, show_stage)
    for missing in evidence.missing.values():
        print(f"missing    {visible(missing)}")
    print(f"report     {visible(str(target))}")
