"""The files of a design: a page, its numbers, the bearing as values of variables, and pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from activefail import __version__
from activefail.errors import InputError
from activefail.figures.design import marks_of, plot_required
from activefail.figures.style import save_png_and_svg
from activefail.files import make_folder, replacing, target_of
from activefail.json_text import json_text
from activefail.report.environment import page_environment
from activefail.report.picture import picture
from activefail.risk.design.findings import DesignFindings
from activefail.risk.design.required_chart import RequiredChart
from activefail.shares import percent
from activefail.visible import or_worse

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE, NUMBERS, VALUES, CHART = "design.html", "design.json", "design.toml", "required"
"""Names of the files."""


def write_design(findings: DesignFindings, folder: Path) -> list[Path]:
    """Write a design's files into a folder, which is made if it is missing; returns the files.

    Raises:
        InputError: if the folder is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: must be a folder, but is a file.")
    make_folder(folder)
    texts = {
        PAGE: render_design(findings),
        NUMBERS: json_text(findings.as_json()) + "\n",
        VALUES: values_text(findings),
    }
    files = [folder / name for name in texts]
    for name, text in texts.items():
        with replacing(target_of(folder / name)) as file:
            file.write(text)
    if findings.chart is not None:
        figure = _chart(findings, findings.chart)
        files += save_png_and_svg(figure, folder, CHART)
    return files


def _chart(findings: DesignFindings, chart: RequiredChart) -> "Figure":
    return plot_required(chart, findings.campaign.space, marks_of(findings))


def values_text(findings: DesignFindings) -> str:
    """The design as TOML, for --fixed of other commands."""
    units = {parameter.name: parameter.unit for parameter in findings.campaign.space.parameters}
    lines = [f"# {findings.verdict}"]
    for name, value in findings.bearing.items():
        unit = f"  # {units[name]}" if units.get(name) else ""
        lines.append(f"{name} = {value!r}{unit}")
    return "\n".join(lines) + "\n"


def render_design(findings: DesignFindings) -> str:
    """The page."""
    units = {parameter.name: parameter.unit for parameter in findings.campaign.space.parameters}
    designed = findings.designed
    looks: list[dict[str, Any]] = [
        {
            "values": ", ".join(f"{name} = {value:.4g}" for name, value in look.candidate.values.items()),
            "model": [percent(share, 2) for share in look.candidate.model.tolist()],
            "confidence": f"{100.0 * look.of_bound:.3g} %",
            "estimates": look.estimates,
        }
        for look in designed.looks
    ]
    chart = None
    if findings.chart is not None:
        what = f"Required {findings.chart.name} against {findings.chart.across}"
        chart = picture(_chart(findings, findings.chart), CHART, what)
    return (
        page_environment()
        .get_template("design.html.j2")
        .render(
            version=__version__,
            title=f"Design for {designed.question.title}",
            findings=findings,
            designed=designed,
            task=designed.task,
            units=units,
            looks=looks,
            targets=[
                f"P({or_worse(one.outcome, findings.campaign.simulator.outcomes)}) ≤ {100.0 * one.target:.4g} %"
                for one in designed.task.requirements
            ],
            chart=chart,
            lines=[line for line in findings.rows if line[0] not in ("widen", "design", "result", "note")],
        )
    )
