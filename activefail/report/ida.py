"""The files of an incremental dynamic analysis: its numbers, a table of the records, and the picture."""

from pathlib import Path

from activefail.csv_table import writing
from activefail.figures.ida import plot_ida
from activefail.json_text import json_text
from activefail.report.folder import write_folder
from activefail.risk.ida.findings import IdaFindings


def write_ida(findings: IdaFindings, folder: Path) -> list[Path]:
    """Write ida.json, ida.csv, ida.png and ida.svg into a folder; returns the files."""
    numbers = findings.as_json()
    columns = list(numbers["records"][0])

    def write_table(path: Path) -> None:
        with writing(path, columns) as write:
            write([["" if row[name] is None else row[name] for name in columns] for row in numbers["records"]])

    return write_folder(folder, {"ida.json": json_text(numbers), "ida.csv": write_table}, {"ida": plot_ida(findings)})
