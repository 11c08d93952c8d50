"""The page of an incremental dynamic analysis, its numbers, its table and its picture."""

from pathlib import Path

from activefail.campaign.assembly import Campaign
from activefail.pages.figures.svg import inline
from activefail.pages.report.analyses import cards_of_fit, write_folder
from activefail.pages.report.environment import REPORT, page_environment
from activefail.seismic.figures.ida import plot_ida
from activefail.seismic.ida.collapse import CONFIDENCE
from activefail.seismic.ida.findings import IdaFindings
from activefail.space.shares import significant
from activefail.text.csv_table import writing
from activefail.text.json_text import json_text
from activefail.version import __version__


def write_ida(findings: IdaFindings, folder: Path, campaign: Campaign | None = None) -> list[Path]:
    """Write the page, ida.json, ida.csv, ida.png and ida.svg into a folder; returns the files."""
    numbers, figure = findings.as_json(), plot_ida(findings)
    columns = list(numbers["records"][0])

    def write_table(path: Path) -> None:
        with writing(path, columns) as write:
            write([["" if row[name] is None else row[name] for name in columns] for row in numbers["records"]])

    title = f"Capacities of {len(numbers['records'])} records for {findings.event}"
    unit, reached = f" {findings.intensity.unit}" if findings.intensity.unit else "", findings.failed
    cards = cards_of_fit(findings.fragility, findings.event, unit, "events")
    cards = cards or [(f"records that reach {findings.event}", str(reached), f"of {len(numbers['records'])}; no curve")]
    if findings.fragility is not None and findings.options is not None:
        ends = tuple(findings.options.shape_factor * end for end in findings.cmr_interval or ())
        interval = f"({' to '.join(map(significant, ends))} with {100.0 * CONFIDENCE:g} % confidence)" if ends else ""
        cards[1:] = [("adjusted collapse margin ratio", significant(findings.acmr), interval or "(no interval)")]
    drawn = inline(figure, "ida", title)
    template = page_environment("activefail.seismic.ida", REPORT).get_template("ida.html.j2")
    shown = {"title": title, "findings": findings, "cards": cards, "records": numbers["records"], "drawn": drawn}
    page = template.render(version=__version__, **shown)
    texts = {"ida.html": page, "ida.json": json_text(numbers) + "\n"}
    return write_folder(folder, {**texts, "ida.csv": write_table}, {"ida": figure})
