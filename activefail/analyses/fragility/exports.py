"""The files of fragility curves: tables, JSON, and what plug-ins make for other programs."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from activefail.analyses.fragility.findings import FragilityFindings
from activefail.plugins import brought
from activefail.text.csv_table import Target, writing
from activefail.text.json_text import json_text


def files_of(findings: FragilityFindings) -> dict[str, str | Callable[[Path], None]]:
    """The tables, the findings as JSON, and the curves for other programs: texts, or what writes a table."""
    files: dict[str, str | Callable[[Path], None]] = {"fragility.csv": findings.write_table}
    if any(one.deaggregation is not None for one in findings.boundaries):
        files["deaggregation.csv"] = partial(_write_deaggregation, findings)
    files["fragility.json"] = json_text(findings.as_json()) + "\n"
    # Each at least as high as those of more severe outcomes, in spite of errors of the integration.
    nested = np.maximum.accumulate([one.curve.probability for one in reversed(findings.boundaries)])[::-1]
    curves = {one.outcome: curve for one, curve in zip(findings.boundaries, nested, strict=True)}
    made = {name: of_curves(findings.ladder, curves) for name, of_curves in brought("curves").items()}
    return files | {name: text for name, text in made.items() if text is not None}


def _write_deaggregation(findings: FragilityFindings, target: Target) -> None:
    parts = {one.outcome: one.deaggregation for one in findings.boundaries if one.deaggregation is not None}
    with writing(target, ["outcome", *next(iter(parts.values())).header]) as write:
        for outcome, one in parts.items():
            write([[outcome, *row] for row in one.table])
