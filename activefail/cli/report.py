"""`activefail report`: a campaign as a page."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from activefail.cli.common import Code, RunFolder, check_output, resume_command, show_warnings, writing_to
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
    from activefail.campaign.findings import findings_of
    from activefail.campaign.learning import current_classifier
    from activefail.campaign.loop import one_thread
    from activefail.campaign.opening import open_campaign
    from activefail.record.layout import REPORT
    from activefail.report.evidence import evidence_of
    from activefail.report.page import render, write_report

    check_output("--out", out)
    target = out or folder / REPORT
    if target.suffix.lower() not in {".html", ".htm"}:
        raise InputError(f"--out: must end in .html, got {str(target)!r}.")
    if out is not None and not target.absolute().parent.is_dir():
        raise InputError(f"--out: the folder {target.absolute().parent} does not exist.")

    def stage(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    with open_campaign(folder, write=False, code=code) as (campaign, store), one_thread():
        show_warnings(store)
        if not any((batch.results.outcome >= 0).any() for batch in store.batches):
            raise InputError(
                f"{folder}: has no simulations to report yet; `{resume_command(folder, campaign)}` goes on."
            )
        stage("learning")
        classifier = current_classifier(campaign, store, write=False)
        show_warnings(store)
        evidence = evidence_of(folder, campaign, store, classifier, stage)
        findings = findings_of(folder, campaign, store, classifier)
        page = render(findings, evidence, store, stage)
    with writing_to(target):
        write_report(page, target)
    for missing in evidence.missing.values():
        print(f"missing    {visible(missing)}")
    print(f"report     {visible(str(target))}")
