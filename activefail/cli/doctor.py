"""`activefail doctor`: what works in this installation, and what is missing."""

from dataclasses import asdict

import typer

from activefail.cli.common import AsJson, print_json


def doctor(as_json: AsJson = False) -> None:
    """Check the installation.

    Shows versions, cores, extras and compiled kernels, and runs a self-test. It takes a second once the simulator is
    compiled.
    """
    from activefail.cli.diagnosis import diagnosis, versions

    found = []
    for finding in diagnosis():
        if not as_json:
            print(f"{finding.title:<11} {finding.text}", flush=True)
        found.append(finding)
    works = not any(finding.is_fault for finding in found)
    if as_json:
        print_json({"works": works, "versions": versions(), "findings": [asdict(finding) for finding in found]})
    if not works:
        raise typer.Exit(1)
