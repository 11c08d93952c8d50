"""The page of `activefail sensitivity --out`, with its pictures and its table."""

from functools import partial
from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.figures.sensitivity import plot_indices, plot_moves
from activefail.findings.quantities import custom_quantity, plain, quantity
from activefail.report.environment import markdown_environment
from activefail.report.folder import write_folder
from activefail.risk.sensitivity.findings import SensitivityFindings, write_csv
from activefail.simulators.bearing import DfpSimulator
from activefail.visible import or_worse

INDICES, MOVES = "indices", "one_at_a_time"
"""Names of the pictures, without their suffixes."""


def write_sensitivity(sensitivity: SensitivityFindings, campaign: Campaign, out: Path) -> list[Path]:
    """Write the page, the table and the pictures (SVG, PNG) into a folder; returns the files.

    Raises:
        InputError: if a file cannot be written.
    """
    describe = quantity if isinstance(campaign.simulator, DfpSimulator) else custom_quantity
    quantities = {name: describe(name, unit) for name, unit in sensitivity.units.items()}
    figures = {}
    if sensitivity.moves:
        name = plain(or_worse(sensitivity.outcome, sensitivity.outcomes))
        figures[MOVES] = plot_moves(sensitivity.moves, sensitivity.probability, name, quantities)
    if sensitivity.indices:
        figures[INDICES] = plot_indices(sensitivity.indices, sensitivity.confidence, quantities)
    template = markdown_environment().get_template("sensitivity.md.j2")
    page = template.render(it=sensitivity, indices_picture=INDICES, moves_picture=MOVES)
    return write_folder(out, {"sensitivity.md": page, "sensitivity.csv": partial(write_csv, sensitivity)}, figures)
