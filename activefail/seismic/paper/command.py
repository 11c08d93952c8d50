"""`activefail paper`: our results against the paper's."""

import sys
from pathlib import Path

import typer

from activefail.cli.common import AsJson, print_json, show_stage
from activefail.record.layout import check_output
from activefail.run.analysis import option
from activefail.session.interrupts import INTERRUPTED
from activefail.text.files import writing_to
from activefail.visible import visible


def paper(
    draws: int = option(20, "Independent samples of 250 simulations.", low=4, high=1000),
    fresh: int = option(4000, "Fresh test designs.", low=100, high=1_000_000),
    seed: int = option(1, "Random seed.", low=0),
    out: Path = option(Path("runs/reproduction"), "Folder for reproduction.md and its figures.", Path),
    as_json: AsJson = False,
) -> None:
    """Reproduce the paper's tables and figures, with intervals."""
    from activefail.seismic.paper.claims import claims
    from activefail.seismic.paper.reproduction import write_reproduction
    from activefail.seismic.paper.study import run_study

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
