"""The files of a design: a page, its numbers, the bearing as values of variables, and pictures."""

from pathlib import Path
from typing import TYPE_CHECKING

from activefail import __version__
from activefail.figures.design import marks_of, plot_required
from activefail.figures.svg import inline
from activefail.findings.quantities import by_name
from activefail.json_text import json_text
from activefail.report.environment import page_environment
from activefail.report.folder import write_folder
from activefail.risk.design.findings import DesignFindings
from activefail.visible import or_worse

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_design(findings: DesignFindings, folder: Path) -> list[Path]:
    """Write a design's files into a folder; returns the files."""
    figures = {}
    if findings.chart is not None:
        figures["required"] = plot_required(findings.chart, by_name(findings.campaign), marks_of(findings))
    texts = {
        "design.html": render_design(findings, figures.get("required")),
        "design.json": json_text(findings.as_json()) + "\n",
        "design.toml": _values_text(findings),
    }
    return write_folder(folder, texts, figures)


def _values_text(findings: DesignFindings) -> str:
    """The design as TOML, for --fixed of other commands."""
    units = {parameter.name: parameter.unit for parameter in findings.campaign.space.parameters}
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
