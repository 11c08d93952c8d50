"""Where the answers of the analyses go: each with its page, its numbers, its tables and its pictures."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.findings.quantities import by_name, of_simulator
from activefail.analyses.fragility.capacities import CONFIDENCE
from activefail.analyses.fragility.capacities import Fragility as LognormalFit
from activefail.analyses.fragility.exports import files_of
from activefail.analyses.fragility.findings import (
    CAPACITIES,
    BoundaryFragility,
    FragilityFindings,
    beside_capacities,
    ends_in_words,
    heading,
    unit_of,
)
from activefail.analyses.sensitivity.findings import SensitivityFindings
from activefail.campaign.assembly import Campaign
from activefail.pages.figures.risk import (
    marks_of,
    plot_fragility_findings,
    plot_indices,
    plot_looks,
    plot_moves,
    plot_required,
)
from activefail.pages.figures.style import save_png_and_svg
from activefail.pages.figures.svg import inlined
from activefail.pages.report.environment import markdown_environment, page_environment
from activefail.plugins import brought
from activefail.space.shares import bounds_percent, percent, significant
from activefail.text.files import make_folder, replacing, target_of
from activefail.text.json_text import json_text
from activefail.text.quantities import Quantity, plain, quantity
from activefail.version import __version__
from activefail.visible import or_worse

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


def write_fragility(findings: FragilityFindings, folder: Path, campaign: Campaign | None = None) -> list[Path]:
    """Write the page, the findings as JSON, tables, pictures and files for other programs; returns the files."""
    variables = {} if campaign is None else by_name(campaign)
    figures = plot_fragility_findings(findings, variables)
    shown, files = curves_shown(findings, figures, variables), files_of(findings)
    programs = [name for name in brought("curves") if name in files]
    page = _page("fragility.html.j2", title=shown["heading"], curves=shown, programs=programs, refused=findings.refused)
    return write_folder(folder, {"fragility.html": page} | files, figures)


def _page(template: str, **values: Any) -> str:
    return page_environment().get_template(template).render(version=__version__, **values)


Card = tuple[str, str, str]
"""A number of the box at the head of a page: what it is, the number, and its interval or that it has none."""


def cards_of_fit(fit: LognormalFit | None, event: str, unit: str, over: str) -> list[Card]:
    """The median and the dispersion of a fitted curve, with intervals over events or groups."""
    if fit is None:
        return []
    cards = []
    for what, value, ends, of in (
        (f"median capacity for {event}", fit.fit.median, fit.median, unit),
        ("dispersion", fit.fit.dispersion, fit.dispersion, ""),
    ):
        interval = "(no interval)"
        if ends:
            low, high = map(significant, ends)
            interval = f"({low} to {high}{of} with {100.0 * CONFIDENCE:g} % confidence, over {over})"
        cards.append((what, f"{significant(value)}{of}", interval))
    return cards


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def curves_shown(
    findings: FragilityFindings, figures: "Mapping[str, Figure]", variables: Mapping[str, Quantity]
) -> dict[str, Any]:
    """The texts of the curves and the pictures, for the template `curves.html.j2`."""
    title, boundaries = _sentence(heading(findings)), findings.boundaries[::-1]
    verified = [one for one in boundaries if one.verified]
    leading = (verified or boundaries)[0]
    median, ends_of_median = leading.capacity(0.5)
    names, capacities, unknown = [or_worse(one.outcome, findings.outcomes) for one in boundaries], [], list[str]()
    for name, one in zip(names, boundaries, strict=True):
        rows = []
        for p in CAPACITIES:
            of, interval = one.capacity(p)
            ends = ends_in_words(interval)
            levels = of.level, interval.verified if ends else None
            texts = ["–" if level is None else significant(level) for level in levels]
            rows.append((f"{100.0 * p:g} %", *texts, ends or "–"))
            if reason := of.reason or (interval.interval_reason if one.verified else ""):
                unknown.append(f"{_sentence(name)}, {rows[-1][0]}: {reason}.")
        capacities.append((name, rows))
    return {
        "heading": title,
        "variable": quantity(findings.ladder.name, findings.ladder.unit, variables).text,
        "cards": _of_curve(findings, leading),
        "lacks_interval": median.level is not None and None in (ends_of_median.low, ends_of_median.high),
        "given": findings.given,
        "pictures": inlined(figures.values(), "curves", title),
        "capacities": capacities,
        "unknown": unknown,
        "verified": [(or_worse(one.outcome, findings.outcomes), one.verified) for one in verified],
        "beside": [(name, beside_capacities(findings, one)) for name, one in zip(names, boundaries, strict=True)],
        "in_unit": f" [{findings.ladder.unit}]" if findings.ladder.unit else "",
        "loads": findings.loads,
        "has_alone": any(one.alone is not None for one in findings.boundaries),
        "has_lognormal": any(one.fit is not None for one in findings.boundaries),
        "has_pulses": len(figures) > 1,
        "has_verification": findings.has_verification,
        "fresh": "" if findings.by_stripes else "fresh ",
        "notes": findings.assumptions,
    }


def _of_curve(findings: FragilityFindings, one: BoundaryFragility) -> list[Card]:
    """The median capacity of a boundary, and its risk or its probability under the hazard, if there is one."""
    event, unit, alone = or_worse(one.outcome, findings.outcomes), unit_of(findings), "by the classifier, no interval"
    if one.fit is not None and one.fit.median:
        return cards_of_fit(one.fit, event, unit, "groups")
    of, interval = one.capacity(0.5)
    level, why = of.level, of.reason or alone
    if ends := ends_in_words(interval):
        by = "by the classifier " if interval.verified is None else ""
        level = level if by else interval.verified
        other = ", the other end is unknown" if None in (interval.low, interval.high) else ""
        why = f"{by}({ends}{unit} with {100.0 * findings.confidence:g} % confidence{other})"
    cards = [(f"median capacity for {event}", "none" if level is None else f"{significant(level)}{unit}", why)]
    if one.risk is not None:
        cards.append((f"risk of {event} in {one.risk.years:g} years", percent(one.risk.probability, 2), alone))
    elif one.deaggregation is not None:
        cards.append((f"probability of {event} under the hazard", percent(one.deaggregation.probability), alone))
    return cards


def write_design(findings: DesignFindings, folder: Path, campaign: Campaign) -> list[Path]:
    """Write a design's files into a folder; returns the files."""
    figures: Mapping[str, Figure] = {}
    if findings.chart is not None:
        figures = plot_required(findings.chart, by_name(campaign), marks_of(findings))
    texts = {
        "design.html": render_design(findings, figures),
        "design.json": json_text(findings.as_json()) + "\n",
        "design.toml": _values_text(findings, campaign),
    }
    return write_folder(folder, texts, figures)


def _values_text(findings: DesignFindings, campaign: Campaign) -> str:
    """The design as TOML, for --fixed of other commands."""
    units = {parameter.name: parameter.unit for parameter in campaign.space.parameters}
    lines = [f"# {findings.verdict}"]
    for name, value in findings.bearing.items():
        unit = f"  # {units[name]}" if units.get(name) else ""
        lines.append(f"{name} = {value!r}{unit}")
    return "\n".join(lines) + "\n"


_ABOVE = {"design", "result", "verified", "met", "estimate", "note"}
"""Titles of rows that stand elsewhere on the page of a design."""


def render_design(findings: DesignFindings, figures: "Mapping[str, Figure] | None" = None) -> str:
    """The page, with the figures of the chart if there is one, else with one of the looks."""
    designed, task, outcomes = findings.designed, findings.designed.task, findings.campaign.simulator.outcomes
    title, what = f"Design for {designed.question.title}", designed.status
    events = [f"P({or_worse(one.outcome, outcomes)})" for one in task.requirements]
    targets = [f"{event} ≤ {100.0 * one.target:.4g} %" for event, one in zip(events, task.requirements, strict=True)]
    drawn = inlined((figures or {"looks": plot_looks(findings, targets)}).values(), "design", title)
    sure = f"{100.0 * designed.result.of_bound:.3g} % confidence"
    # A line breaks only between variables.
    design = findings.in_words(designed.values, with_units=True).replace(" ", "\N{NO-BREAK SPACE}")
    design = design.replace(",\N{NO-BREAK SPACE}", ", ")
    cards = [(f"design, {what}", design, "")]
    for event, one, of in zip(events, task.requirements, designed.result.estimates, strict=True):
        name = f"{event} {'under these values' if designed.by_stripes else 'from fresh simulations'}"
        values = [of.probability, of.low, of.high, one.target]
        if (rate := task.rate) is not None:
            name, values = f"risk of {event[2:-1]} in {rate.years:g} years", [rate.risk(P) for P in values]
        value, low, high, target = values
        text = f"({bounds_percent(low, high)}, each bound with {sure}; target {100.0 * target:.4g} %)"
        cards.append((name, percent(value, 2), text))
    return _page(
        "design.html.j2",
        title=title,
        findings=findings,
        designed=designed,
        task=task,
        shown=by_name(findings.campaign),
        targets=targets,
        cards=cards,
        chart=findings.chart if figures else None,
        drawn=drawn,
        lines=[line for line in findings.rows if line[0] not in _ABOVE],
    )


INDICES, MOVES = "indices", "one_at_a_time"
"""Names of the pictures, without their suffixes."""


def write_sensitivity(sensitivity: SensitivityFindings, out: Path, campaign: Campaign) -> list[Path]:
    """Write the page, the table and the pictures (SVG, PNG) into a folder; returns the files.

    Raises:
        InputError: if a file cannot be written.
    """
    quantities = {name: of_simulator(campaign, name, unit) for name, unit in sensitivity.units.items()}
    figures = {}
    if sensitivity.moves:
        name = plain(or_worse(sensitivity.outcome, sensitivity.outcomes))
        figures[MOVES] = plot_moves(sensitivity.moves, sensitivity.probability, name, quantities)
    if sensitivity.indices:
        figures[INDICES] = plot_indices(sensitivity.indices, sensitivity.confidence, quantities)
    template = markdown_environment().get_template("sensitivity.md.j2")
    page = template.render(it=sensitivity, indices_picture=INDICES, moves_picture=MOVES)
    return write_folder(out, {"sensitivity.md": page, "sensitivity.csv": sensitivity.write_table}, figures)
