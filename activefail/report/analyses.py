"""Where the answers of the analyses go: each with its page, its numbers, its tables and its pictures."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activefail import __version__
from activefail.campaign.assembly import Campaign
from activefail.csv_table import writing
from activefail.figures.risk import marks_of, plot_fragility_findings, plot_ida, plot_indices, plot_moves, plot_required
from activefail.figures.style import save_png_and_svg
from activefail.figures.svg import inline
from activefail.files import make_folder, replacing, target_of
from activefail.findings.quantities import by_name, custom_quantity, plain, quantity
from activefail.json_text import json_text
from activefail.report.environment import markdown_environment, page_environment
from activefail.risk.design.by_stripes import DesignByStripes
from activefail.risk.design.findings import DesignFindings
from activefail.risk.fragility.by_stripes import FragilityByStripes
from activefail.risk.fragility.exports import files_of
from activefail.risk.fragility.findings import (
    FragilityFindings,
    fixed_in_words,
    heading,
    of_boundary,
    why_no_risk,
)
from activefail.risk.ida.findings import IdaFindings
from activefail.risk.sensitivity.findings import SensitivityFindings, write_csv
from activefail.simulators.bearing import DfpSimulator
from activefail.visible import or_worse, words

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_folder(
    folder: Path, files: Mapping[str, str | Callable[[Path], None]], figures: "Mapping[str, Figure]"
) -> list[Path]:
    """Write files into a folder, which is made if it is missing; returns them.

    Args:
        folder: of the files.
        files: text, or what writes a table, by name of the file.
        figures: by name of the picture, which is written as PNG and SVG.

    Raises:
        InputError, OSError: if a file cannot be written.
    """
    make_folder(folder)
    for name, content in files.items():
        if callable(content):
            content(folder / name)
            continue
        with replacing(target_of(folder / name)) as file:
            file.write(content)
    pictures = [path for name, figure in figures.items() for path in save_png_and_svg(figure, folder, name)]
    return [*(folder / name for name in files), *pictures]


def write_fragility(findings: FragilityFindings | FragilityByStripes, folder: Path) -> list[Path]:
    """Write the page, the findings as JSON, tables, pictures and files for other programs; returns the files."""
    if isinstance(findings, FragilityByStripes):
        return write_folder(folder, {"fragility.json": json_text(findings.as_json()) + "\n"}, {})
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
        "columns": [or_worse(one.outcome, findings.outcomes) for one in reversed(findings.boundaries)],
        "rows": _rows([of_boundary(findings, one) for one in reversed(findings.boundaries)]),
        "verified": [
            (or_worse(one.outcome, findings.outcomes), level) for one in findings.boundaries for level in one.verified
        ],
        "unit": findings.ladder.unit,
        "has_alone": any(one.alone is not None for one in findings.boundaries),
        "has_lognormal": any(one.is_lognormal for one in findings.boundaries),
        "has_pulses": parts is not None and parts.failures is not None,
        "has_verification": findings.has_verification,
        "no_risk": why_no_risk(findings),
        "notes": findings.assumptions,
    }


def _rows(columns: list[list[tuple[str, str]]]) -> list[tuple[str, list[list[str]]]]:
    """Titles, each with its texts in each column, without verified levels; an empty title continues the one before."""
    rows: dict[str, list[list[str]]] = {}
    for number, titled in enumerate(columns):
        last = ""
        for title, text in titled:
            last = title or last
            rows.setdefault(last, [[] for _ in columns])[number].append(text)
    rows.pop("verified", None)
    return [(f"capacity at {title}" if title.endswith("%") else title, texts) for title, texts in rows.items()]


def write_design(findings: DesignFindings | DesignByStripes, campaign: Campaign, folder: Path) -> list[Path]:
    """Write a design's files into a folder; returns the files."""
    figures = {}
    texts = {
        "design.json": json_text(findings.as_json()) + "\n",
        "design.toml": _values_text(findings, campaign),
    }
    if isinstance(findings, DesignFindings):
        if findings.chart is not None:
            figures["required"] = plot_required(findings.chart, by_name(campaign), marks_of(findings))
        texts = {"design.html": render_design(findings, figures.get("required")), **texts}
    return write_folder(folder, texts, figures)


def _values_text(findings: DesignFindings | DesignByStripes, campaign: Campaign) -> str:
    """The design as TOML, for --fixed of other commands."""
    units = {parameter.name: parameter.unit for parameter in campaign.space.parameters}
    lines = [f"# {findings.verdict}"]
    for name, value in findings.bearing.items():
        unit = f"  # {units[name]}" if units.get(name) else ""
        lines.append(f"{name} = {value!r}{unit}")
    return "\n".join(lines) + "\n"


def render_design(findings: DesignFindings, figure: "Figure | None" = None) -> str:
    """The page, with the figure of the chart if there is one."""
    designed, chart, outcomes = findings.designed, findings.chart, findings.campaign.simulator.outcomes
    drawn = None
    if figure is not None and chart is not None:
        drawn = inline(figure, "required", f"Required {chart.name} against {chart.across}")
    return (
        page_environment()
        .get_template("design.html.j2")
        .render(
            version=__version__,
            title=f"Design for {designed.question.title}",
            findings=findings,
            designed=designed,
            task=designed.task,
            shown=by_name(findings.campaign),
            targets=[
                f"P({or_worse(one.outcome, outcomes)}) ≤ {100.0 * one.target:.4g} %"
                for one in designed.task.requirements
            ],
            chart=drawn,
            lines=[line for line in findings.rows if line[0] not in ("widen", "design", "result", "note")],
        )
    )


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


def write_ida(findings: IdaFindings, folder: Path) -> list[Path]:
    """Write the page, ida.json, ida.csv, ida.png and ida.svg into a folder; returns the files."""
    numbers, figure = findings.as_json(), plot_ida(findings)
    columns = list(numbers["records"][0])

    def write_table(path: Path) -> None:
        with writing(path, columns) as write:
            write([["" if row[name] is None else row[name] for name in columns] for row in numbers["records"]])

    title = f"Capacities of {len(numbers['records'])} records for {words(findings.outcome)}"
    page = (
        page_environment()
        .get_template("ida.html.j2")
        .render(
            version=__version__,
            title=title,
            findings=findings,
            rows=findings.rows,
            records=numbers["records"],
            drawn=inline(figure, "ida", title),
        )
    )
    texts = {"ida.html": page, "ida.json": json_text(numbers) + "\n"}
    return write_folder(folder, {**texts, "ida.csv": write_table}, {"ida": figure})
