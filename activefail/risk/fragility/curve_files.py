"""The files of fragility curves: tables, and exports to other programs."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from activefail.csv_table import Target, writing
from activefail.json_text import json_text
from activefail.risk.fragility.deaggregation import Deaggregation
from activefail.risk.fragility.exports import OPENQUAKE, PELICUN, openquake_model, pelicun_table, why_no_exports
from activefail.risk.fragility.findings import FragilityFindings

_COMPONENT = "isolation_bearing"
"""The bearing in other programs."""


def write_curves(findings: FragilityFindings, target: Target) -> None:
    """Write the curves: a row for each level of the ladder and for each verified level.

    Columns: the variable; `kind`, ladder or verified; the share outside the design space; for each outcome the
    curve `p_<outcome>`, that of the pulses alone, the lognormal one, and the verified probability with its interval.
    Cells are empty where there is no number.
    """
    header = [findings.ladder.name, "kind", "outside_design_space"]
    for one in findings.boundaries:
        header += [f"p_{one.outcome}"]
        header += [f"p_{one.outcome}_{kind}" for kind in ("pulses_alone", "lognormal", "verified", "low", "high")]
    levels = [(float(level), "ladder") for level in findings.ladder.levels]
    levels += [(checked.level, "verified") for one in findings.boundaries for checked in one.verified]
    with writing(target, header) as write:
        write([_row(findings, level, kind) for level, kind in sorted(levels)])


def _row(findings: FragilityFindings, level: float, kind: str) -> list[Any]:
    outside = dict(zip(findings.ladder.levels.tolist(), findings.outside.tolist(), strict=True))
    row: list[Any] = [level, kind, outside.get(level, "")]
    for one in findings.boundaries:
        row.append(float(one.curve.at(level)))
        row.append("" if one.alone is None else float(one.alone.at(level)))
        row.append("" if one.lognormal is None else float(one.lognormal.at(level)))
        estimates = [checked.estimate for checked in one.verified if kind == "verified" and checked.level == level]
        row += [estimates[0].probability, estimates[0].low, estimates[0].high] if estimates else ["", "", ""]
    return row


def _write_deaggregation(parts: Sequence[tuple[str, Deaggregation]], target: Target) -> None:
    header = ["outcome", "T_p_from", "T_p_to", "PGV_from", "PGV_to", "share_of_failures", "share_of_pulses"]
    with writing(target, header) as write:
        write([row for outcome, part in parts for row in _rows_of(outcome, part)])


def _rows_of(outcome: str, parts: Deaggregation) -> Iterator[list[Any]]:
    for row in range(len(parts.period) - 1):
        for column in range(len(parts.velocity) - 1):
            share = "" if parts.of_failures is None else float(parts.of_failures[row, column])
            edges = [*parts.period[row : row + 2].tolist(), *parts.velocity[column : column + 2].tolist()]
            yield [outcome, *edges, share, float(parts.of_pulses[row, column])]


def files_of(findings: FragilityFindings) -> dict[str, str | Callable[[Path], None]]:
    """The tables, the findings as JSON, and the curves for pelicun and OpenQuake: texts, or what writes a table."""
    files: dict[str, str | Callable[[Path], None]] = {"fragility.csv": partial(write_curves, findings)}
    parts = [(one.outcome, one.deaggregation) for one in findings.boundaries if one.deaggregation is not None]
    if parts:
        files["deaggregation.csv"] = partial(_write_deaggregation, parts)
    files["fragility.json"] = json_text(findings.as_json()) + "\n"
    if not why_no_exports(findings.ladder):
        curves = {one.outcome: one.curve.probability for one in findings.boundaries}
        files[PELICUN] = pelicun_table(findings.ladder, curves, _COMPONENT)
        files[OPENQUAKE] = openquake_model(findings.ladder, curves, _COMPONENT)
    return files
