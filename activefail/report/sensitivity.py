"""The sensitivity of a probability, as text, table and page."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from activefail.campaign.assembly import Campaign
from activefail.csv_table import Target, writing
from activefail.figures.sensitivity import plot_indices, plot_moves
from activefail.figures.style import save_png_and_svg
from activefail.files import replacing, writing_to
from activefail.findings.quantities import Quantity, custom_quantity, plain, quantity, significant
from activefail.report.environment import markdown_environment
from activefail.risk.sensitivity.findings import HIGH, LOW, Sensitivity
from activefail.risk.sensitivity.sobol import Estimate
from activefail.shares import percent
from activefail.simulators.bearing import DfpSimulator
from activefail.visible import or_worse, visible

PAGE, TABLE, INDICES, MOVES = "sensitivity.md", "sensitivity.csv", "indices", "one_at_a_time"
"""Files of a sensitivity's folder; the last two are pictures, with their suffixes."""

_NONE = "–"


def _in_words(estimate: Estimate) -> str:
    return f"{estimate.value:.3f} ({estimate.low:.3f} to {estimate.high:.3f})"


def _p_value(p: float) -> str:
    return "< 0.001" if p < 1e-3 else f"{p:.3f}"


def _labels(sensitivity: Sensitivity) -> dict[str, str]:
    units = sensitivity.units
    return {name: f"{visible(name)} [{visible(unit)}]" if unit else visible(name) for name, unit in units.items()}


def index_rows(sensitivity: Sensitivity) -> list[list[str]]:
    """The table of indices, with its header; empty without indices."""
    if not sensitivity.indices:
        return []
    labels, scales, p_values = _labels(sensitivity), sensitivity.length_scales, sensitivity.p_values
    interval = f"({100 * sensitivity.confidence:g} % interval)"
    rows = [["variable", f"first index {interval}", f"total index {interval}", "length scale", "p-value"]]
    for name, first, total in sensitivity.indices:
        scale = f"{scales[name]:.3g}" if name in scales else _NONE
        p_value = _p_value(p_values[name]) if name in p_values else _NONE
        rows.append([labels[name], _in_words(first), _in_words(total), scale, p_value])
    return rows


def move_rows(sensitivity: Sensitivity) -> list[list[str]]:
    """The table of one variable at a time, with its header; empty without a hazard."""
    if not sensitivity.moves:
        return []
    labels = _labels(sensitivity)
    low, high = f"{100 * LOW:g} %", f"{100 * HIGH:g} %"
    rows = [["variable", "base value", f"at its {low} quantile", f"at its {high} quantile"]]
    for move in sensitivity.moves:
        at_low = f"{percent(move.at_low)} at {significant(move.low)}"
        at_high = f"{percent(move.at_high)} at {significant(move.high)}"
        rows.append([labels[move.name], significant(move.value), at_low, at_high])
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of a table as lines with aligned columns."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))] if rows else []
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def heading(sensitivity: Sensitivity, outcomes: Sequence[str]) -> str:
    """What the numbers are about."""
    name = visible(or_worse(sensitivity.outcome, outcomes))
    return f"sensitivity of the probability of {name} under {visible(sensitivity.title)}, by the classifier"


def about(sensitivity: Sensitivity) -> list[tuple[str, str]]:
    """Titles and sentences beside the tables."""
    lines = []
    if sensitivity.samples:
        over = "designs" if sensitivity.is_given_designs else "the distribution"
        lines.append(
            (
                "mean",
                f"{percent(sensitivity.mean)} over {over}; standard deviation {percent(sensitivity.sd)}; no interval",
            )
        )
    if others := {name: x for name, x in sensitivity.length_scales.items() if name not in sensitivity.units}:
        scales = ", ".join(f"{visible(name)} {scale:.3g}" for name, scale in others.items())
        lines.append(("features", f"length scales of other features: {scales}"))
    sampled = f"{sensitivity.samples} samples, " if sensitivity.samples else ""
    lines.append(("from", f"{sampled}{sensitivity.evaluations} evaluations of the classifier, no simulation"))
    share = percent(sensitivity.outside)
    lines.append(
        (
            "outside",
            f"{share} of the sampled designs lie outside the campaign's space, where the classifier extrapolates",
        )
    )
    return lines


def _numbers(estimate: Estimate) -> dict[str, float]:
    return {"value": estimate.value, "low": estimate.low, "high": estimate.high}


def as_json(sensitivity: Sensitivity) -> dict[str, Any]:
    """The sensitivity as JSON values."""

    def number(x: float) -> float | None:
        return None if math.isnan(x) else x

    return {
        "outcome": sensitivity.outcome,
        "question": sensitivity.title,
        "output": "probability given the design" if sensitivity.is_given_designs else "probability given all variables",
        "mean": number(sensitivity.mean),
        "standard_deviation": number(sensitivity.sd),
        "confidence": sensitivity.confidence,
        "samples": sensitivity.samples,
        "evaluations": sensitivity.evaluations,
        "pulses": sensitivity.pulses,
        "outside_design_space": sensitivity.outside,
        "indices": [
            {
                "variable": name,
                "unit": sensitivity.units[name],
                "first": _numbers(first),
                "total": _numbers(total),
            }
            for name, first, total in sensitivity.indices
        ],
        "probability": number(sensitivity.probability),
        "one_at_a_time": [
            {
                "variable": move.name,
                "unit": sensitivity.units[move.name],
                "value": move.value,
                "low": move.low,
                "high": move.high,
                "probability_at_low": move.at_low,
                "probability_at_high": move.at_high,
            }
            for move in sensitivity.moves
        ],
        "length_scales": dict(sensitivity.length_scales),
        "p_values": dict(sensitivity.p_values),
        "interval": None,
        "interval_reason": "the classifier's values, without simulation; the intervals of indices cover their sampling",
        "notes": list(sensitivity.notes),
    }


_COLUMNS = (
    *("variable", "unit", "first", "first_low", "first_high", "total", "total_low", "total_high"),
    *("length_scale", "p_value", "value", "low", "high", "probability_at_low", "probability_at_high"),
)


def write_csv(sensitivity: Sensitivity, target: Target) -> None:
    """Write a row for each variable; what a variable does not have is an empty cell.

    Raises:
        InputError: if the file cannot be written.
    """
    indices = {index.name: index for index in sensitivity.indices}
    moves = {move.name: move for move in sensitivity.moves}
    with writing(target, _COLUMNS) as write:
        for name in dict.fromkeys([*indices, *moves, *sensitivity.units]):
            cells: dict[str, object] = {"variable": name, "unit": sensitivity.units[name]}
            if index := indices.get(name):
                cells |= zip(_COLUMNS[2:8], (*index.first, *index.total), strict=True)
            if move := moves.get(name):
                values = (move.value, move.low, move.high, move.at_low, move.at_high)
                cells |= zip(_COLUMNS[10:], values, strict=True)
            cells["length_scale"] = sensitivity.length_scales.get(name, "")
            cells["p_value"] = sensitivity.p_values.get(name, "")
            write([[cells.get(column, "") for column in _COLUMNS]])


def _cells(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """The cells of a table in Markdown."""
    return [[cell.replace("|", r"\|") for cell in row] for row in rows]


def _quantities(sensitivity: Sensitivity, campaign: Campaign) -> Mapping[str, Quantity]:
    describe = quantity if isinstance(campaign.simulator, DfpSimulator) else custom_quantity
    return {name: describe(name, unit) for name, unit in sensitivity.units.items()}


def write_sensitivity(sensitivity: Sensitivity, campaign: Campaign, out: Path) -> Path:
    """Write the page, the table and the pictures (SVG, PNG) into a folder; returns the page's path.

    Raises:
        InputError: if a file cannot be written.
    """
    outcomes, quantities = campaign.simulator.outcomes, _quantities(sensitivity, campaign)
    title, figures = heading(sensitivity, outcomes), {}
    if sensitivity.moves:
        name = plain(or_worse(sensitivity.outcome, outcomes))
        figures[MOVES] = plot_moves(sensitivity.moves, sensitivity.probability, name, quantities)
    if sensitivity.indices:
        figures[INDICES] = plot_indices(sensitivity.indices, sensitivity.confidence, quantities)
    text = (
        markdown_environment()
        .get_template("sensitivity.md.j2")
        .render(
            title=f"{title[0].upper()}{title[1:]}",
            probability=percent(sensitivity.probability) if sensitivity.moves else "",
            moves=_cells(move_rows(sensitivity)),
            moves_picture=MOVES,
            indices=_cells(index_rows(sensitivity)),
            indices_picture=INDICES,
            about=about(sensitivity),
            notes=[visible(note) for note in sensitivity.notes],
        )
    )
    with writing_to(out):
        out.mkdir(parents=True, exist_ok=True)
        for file, figure in figures.items():
            save_png_and_svg(figure, out, file)
        with replacing(out / PAGE) as page:
            page.write(text)
    write_csv(sensitivity, out / TABLE)
    return out / PAGE
