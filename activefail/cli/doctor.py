"""`activefail doctor`: what works in this installation, and what is missing."""

import typer


def doctor() -> None:
    """Check the installation.

    Shows versions, cores, extras and compiled kernels, and runs a self-test. It takes a second once the simulator is
    compiled.
    """
    from activefail.diagnosis import diagnosis

    works = True
    for finding in diagnosis():
        print(f"{finding.title:<11} {finding.text}", flush=True)
        works = works and not finding.is_fault
    if not works:
        raise typer.Exit(1)
