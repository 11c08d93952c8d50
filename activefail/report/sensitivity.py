"""The page of `activefail sensitivity --out`, with its pictures and its table."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.figures.sensitivity import plot_indices, plot_moves
from activefail.figures.style import save_png_and_svg
from activefail.files import replacing
from activefail.findings.quantities import Quantity, custom_quantity, plain, quantity
from activefail.report.environment import markdown_environment
from activefail.risk.sensitivity.findings import SensitivityFindings, write_csv
from activefail.shares import percent
from activefail.simulators.bearing import DfpSimulator
from activefail.visible import or_worse, visible

PAGE, TABLE, INDICES, MOVES = "sensitivity.md", "sensitivity.csv", "indices", "one_at_a_time"
"""Files of a sensitivity's folder; the last two are pictures, with their suffixes."""


def _cells(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """The cells of a table in Markdown."""
    return [[visible(cell).replace("|", r"\|") for cell in row] for row in rows]


def _quantities(sensitivity: SensitivityFindings, campaign: Campaign) -> Mapping[str, Quantity]:
    describe = quantity if isinstance(campaign.simulator, DfpSimulator) else custom_quantity
    return {name: describe(name, unit) for name, unit in sensitivity.units.items()}


def write_sensitivity(sensitivity: SensitivityFindings, campaign: Campaign, out: Path) -> list[Path]:
    """Write the page, the table and the pictures (SVG, PNG) into a folder; returns the files.

    Raises:
        InputError: if a file cannot be written.
    """
    quantities, title, figures = _quantities(sensitivity, campaign), visible(sensitivity.heading), {}
    if sensitivity.moves:
        name = plain(or_worse(sensitivity.outcome, sensitivity.outcomes))
        figures[MOVES] = plot_moves(sensitivity.moves, sensitivity.probability, name, quantities)
    if sensitivity.indices:
        figures[INDICES] = plot_indices(sensitivity.indices, sensitivity.confidence, quantities)
    text = (
        markdown_environment()
        .get_template("sensitivity.md.j2")
        .render(
            title=f"{title[0].upper()}{title[1:]}",
            probability=percent(sensitivity.probability) if sensitivity.moves else "",
            moves=_cells(sensitivity.move_rows),
            moves_picture=MOVES,
            indices=_cells(sensitivity.index_rows),
            indices_picture=INDICES,
            about=[(name, visible(text)) for name, text in sensitivity.about],
            notes=[visible(note) for note in sensitivity.notes],
        )
    )
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / PAGE) as page:
        page.write(text)
    write_csv(sensitivity, out / TABLE)
    pictures = [file for name, figure in figures.items() for file in save_png_and_svg(figure, out, name)]
    return [out / PAGE, out / TABLE, *pictures]
