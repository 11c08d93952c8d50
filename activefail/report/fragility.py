"""The page of `activefail fragility --out`, with its files; `fragility_section` shows the same curves in the report."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from activefail import __version__
from activefail.figures.fragility import plot_fragility_findings
from activefail.figures.svg import inline
from activefail.findings.quantities import quantity
from activefail.report.environment import page_environment
from activefail.report.folder import write_folder
from activefail.risk.fragility.exports import files_of
from activefail.risk.fragility.findings import (
    FragilityFindings,
    fixed_in_words,
    heading,
    of_boundary,
    why_no_risk,
)
from activefail.visible import or_worse

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_fragility(findings: FragilityFindings, folder: Path) -> list[Path]:
    """Write the page, the findings as JSON, tables, pictures and files for other programs; returns the files."""
    figure = plot_fragility_findings(findings)
    shown = curves_shown(findings, figure)
    template = page_environment().get_template("fragility.html.j2")
    page = template.render(version=__version__, title=shown["heading"], curves=shown)
    return write_folder(folder, {"fragility.html": page} | files_of(findings), {"fragility": figure})


def curves_shown(findings: FragilityFindings, figure: "Figure") -> dict[str, Any]:
    """The texts of the curves and the picture, for the template `curves.html.j2`."""
    title = heading(findings)
    title = title[0].upper() + title[1:]
    parts = findings.boundaries[-1].deaggregation
    return {
        "heading": title,
        "variable": quantity(findings.ladder.name, findings.ladder.unit).text,
        "given": fixed_in_words(findings),
        "picture": inline(figure, "curves", title),
        "boundaries": [
            (or_worse(one.outcome, findings.outcomes), _rows(of_boundary(findings, one)))
            for one in reversed(findings.boundaries)
        ],
        "has_alone": any(one.alone is not None for one in findings.boundaries),
        "has_lognormal": any(one.lognormal is not None for one in findings.boundaries),
        "has_pulses": parts is not None and parts.failures is not None,
        "has_verification": findings.has_verification,
        "no_risk": why_no_risk(findings),
        "notes": findings.assumptions,
    }


def _rows(titled: list[tuple[str, str]]) -> list[tuple[str, list[str]]]:
    """Titles, each with its texts; an empty title continues the one before."""
    rows: list[tuple[str, list[str]]] = []
    for title, text in titled:
        if rows and title in ("", rows[-1][0]):
            rows[-1][1].append(text)
        else:
            rows.append((f"capacity at {title}" if title.endswith("%") else title, [text]))
    return rows
