"""The page of `activefail fragility --out`, with its files; `fragility_section` shows the same curves in the report."""

from pathlib import Path
from typing import Any

from activefail import __version__
from activefail.errors import InputError
from activefail.figures.fragility import plot_fragility_findings
from activefail.figures.style import save_png_and_svg
from activefail.files import make_folder, replacing, target_of
from activefail.findings.quantities import quantity
from activefail.report.environment import page_environment
from activefail.report.picture import picture
from activefail.risk.fragility.curve_files import write_files
from activefail.risk.fragility.findings import (
    FragilityFindings,
    fixed_in_words,
    heading,
    of_boundary,
    why_no_risk,
)
from activefail.visible import or_worse, visible

PAGE, PICTURE = "fragility.html", "fragility"
"""Names of the page, and of the picture without its suffix."""


def write_fragility(findings: FragilityFindings, folder: Path) -> list[Path]:
    """Write the page, the findings as JSON, tables, pictures and files for other programs; returns the files.

    Args:
        findings: the findings.
        folder: is made if it is missing.

    Raises:
        InputError: if the folder is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: must be a folder, but is a file.")
    make_folder(folder)
    files = [folder / PAGE]
    with replacing(target_of(files[0])) as file:
        file.write(render_fragility(findings))
    files += write_files(findings, folder)
    return files + save_png_and_svg(plot_fragility_findings(findings), folder, PICTURE)


def render_fragility(findings: FragilityFindings) -> str:
    """The page."""
    shown = curves_shown(findings)
    return (
        page_environment()
        .get_template("fragility.html.j2")
        .render(version=__version__, title=shown["heading"], curves=shown)
    )


def curves_shown(findings: FragilityFindings) -> dict[str, Any]:
    """The texts and the picture of the curves, for the template `curves.html.j2`."""
    title = heading(findings)
    title = title[0].upper() + title[1:]
    rows = [
        (visible(or_worse(one.outcome, findings.outcomes)), _rows(of_boundary(findings, one)))
        for one in reversed(findings.boundaries)
    ]
    return {
        "heading": title,
        "variable": quantity(findings.ladder.name, findings.ladder.unit).text,
        "given": fixed_in_words(findings),
        "picture": picture(plot_fragility_findings(findings), "curves", title),
        "boundaries": rows,
        "has_alone": any(one.alone is not None for one in findings.boundaries),
        "has_lognormal": any(one.lognormal is not None for one in findings.boundaries),
        "has_pulses": (parts := findings.boundaries[-1].deaggregation) is not None and parts.of_failures is not None,
        "has_verification": findings.has_verification,
        "no_risk": why_no_risk(findings),
        "notes": [visible(sentence) for sentence in findings.assumptions],
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
