"""The files of an incremental dynamic analysis: its numbers, a table of the records, and the picture."""

from pathlib import Path

from activefail.csv_table import writing
from activefail.figures.ida import plot_ida
from activefail.figures.style import save_png_and_svg
from activefail.files import replacing
from activefail.json_text import json_text
from activefail.risk.ida.findings import IdaFindings


def write_ida(findings: IdaFindings, folder: Path) -> list[Path]:
    """Write ida.json, ida.csv, ida.png and ida.svg to an existing folder; returns them.

    Raises:
        OSError: if one cannot be written.
    """
    numbers = findings.as_json()
    columns = list(numbers["records"][0])
    with replacing(folder / "ida.json") as file:
        file.write(json_text(numbers))
    with writing(folder / "ida.csv", columns) as write:
        write([["" if row[name] is None else row[name] for name in columns] for row in numbers["records"]])
    return [folder / "ida.json", folder / "ida.csv", *save_png_and_svg(plot_ida(findings), folder, "ida")]
