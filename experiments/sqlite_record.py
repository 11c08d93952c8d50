"""The record in SQLite and in a run folder: commits, opening, size, kill -9 and flipped bits (docs/decisions/0016).

    python experiments/sqlite_record.py [--folder DIR] [--kills 40] [--flips 400]

Both keep the same batches of 10 designs with 9 variables and 13 margins. In SQLite a simulation is a row, a batch a
transaction with `synchronous=FULL`, in a rollback journal and in a write-ahead log. `checked` is SQLite whose opening
also recomputes the run folder's chain of digests and compares it with the one in a table.
"""

import argparse
import hashlib
import os
import platform
import shutil
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from activefail.errors import StoreError
from activefail.record import compaction
from activefail.record.batch import ACTIVE, Batch, Schema, columns_of
from activefail.record.run_folder import FolderStore
from activefail.record.segment import Segment, chain_next, chain_start, encode_segment
from activefail.simulators.interface import Results

VARIABLES, MARGINS, SIZE = 9, 13, 10
SETTINGS = "seed = 0\n"
SCHEMA = Schema(
    tuple(f"x{i}" for i in range(VARIABLES)), ("safe", "failure"), ("",), tuple(f"m{i}" for i in range(MARGINS))
)
COLUMNS = ["origin", "outcome", "cause", "seconds", *SCHEMA.variables, *SCHEMA.margins]
COMMITS = 192
"""Three times 64: the run folder merges as often as in the long run."""


def batch(number: int) -> Batch:
    """The batch with a number, always the same."""
    rng = np.random.default_rng(number)
    codes = np.zeros(SIZE, dtype=np.int8)
    answers = Results(rng.integers(0, 2, SIZE).astype(np.int8), codes, rng.random((SIZE, MARGINS)), rng.random(SIZE))
    return Batch(number, rng.random((SIZE, VARIABLES)), np.full(SIZE, ACTIVE, dtype=np.int8), answers)


class Record(Protocol):
    """What is compared."""

    def commit(self, batch: Batch) -> None: ...
    def close(self) -> None: ...


class SqliteRecord:
    """Batches in a SQLite database."""

    def __init__(self, path: Path, journal: str) -> None:
        self._base = sqlite3.connect(path, isolation_level=None)
        self._base.execute(f"PRAGMA journal_mode={journal}")
        self._base.execute("PRAGMA synchronous=FULL")
        reals = ", ".join(f"{name} REAL" for name in COLUMNS[3:])
        self._base.execute(
            "CREATE TABLE IF NOT EXISTS simulations (id INTEGER PRIMARY KEY, iteration INTEGER, origin INTEGER, "
            f"outcome INTEGER, cause INTEGER, {reals})"
        )
        self._base.execute("CREATE TABLE IF NOT EXISTS batches (iteration INTEGER PRIMARY KEY, chain TEXT)")
        last = self._base.execute("SELECT max(iteration) FROM batches").fetchone()[0]
        self.batches = 0 if last is None else last + 1
        actual = self._base.execute("SELECT chain FROM batches WHERE iteration = ?", (last,)).fetchone()
        self._chain = actual[0] if actual else chain_start(SETTINGS, SCHEMA)

    def commit(self, batch: Batch) -> None:
        self._base.execute("BEGIN IMMEDIATE")
        self.insert(batch)
        self._base.execute("COMMIT")

    def insert(self, batch: Batch) -> None:
        """Insert a batch within a transaction."""
        answers = batch.results
        codes = (batch.origin.tolist(), answers.outcome.tolist(), answers.cause.tolist(), answers.seconds.tolist())
        reals = np.column_stack([batch.designs, answers.margins]).tolist()
        marks = ", ".join("?" * (1 + len(COLUMNS)))
        rows = [(batch.iteration, *row, *numbers) for *row, numbers in zip(*codes, reals, strict=True)]
        self._base.executemany(f"INSERT INTO simulations (iteration, {', '.join(COLUMNS)}) VALUES ({marks})", rows)
        self._chain = chain_next(self._chain, batch)
        self._base.execute("INSERT INTO batches VALUES (?, ?)", (batch.iteration, self._chain))
        self.batches += 1

    def fill(self, batches: int) -> None:
        """This number of batches in one transaction."""
        self._base.execute("BEGIN")
        for number in range(batches):
            self.insert(batch(number))
        self._base.execute("COMMIT")

    def close(self) -> None:
        self._base.close()


def read_sqlite(path: Path, checked: bool) -> bytes:
    """SHA-256 of all rows of a database that passes `PRAGMA integrity_check`.

    Raises:
        sqlite3.Error: if it is not whole; with `checked` also if the chain of digests does not agree.
    """
    base = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        (result,) = base.execute("PRAGMA integrity_check").fetchone()
        if result != "ok":
            raise sqlite3.DatabaseError(result)
        rows = base.execute(f"SELECT iteration, {', '.join(COLUMNS)} FROM simulations ORDER BY id").fetchall()
        chains = base.execute("SELECT chain FROM batches ORDER BY iteration").fetchall() if checked else []
    finally:
        base.close()
    table = np.array(rows, dtype=np.float64)
    if checked:
        chain = chain_start(SETTINGS, SCHEMA)
        if len(chains) * SIZE != len(table):
            raise sqlite3.DatabaseError("rows are missing")
        for number, (kept,) in enumerate(chains):
            part = table[number * SIZE : (number + 1) * SIZE]
            if (part[:, 0] != number).any() or (part[:, 1:4] != part[:, 1:4].astype(np.int8)).any():
                raise sqlite3.DatabaseError(f"batch {number} holds what no batch does")
            codes = (part[:, column].astype(np.int8) for column in (1, 2, 3))
            origin, outcome, cause = codes
            reals = np.ascontiguousarray(part[:, 5:])
            designs, margins = reals[:, :VARIABLES].copy(), reals[:, VARIABLES:].copy()
            answers = Results(outcome, cause, margins, part[:, 4].copy())
            chain = chain_next(chain, Batch(int(part[0, 0]), designs, origin, answers))
            if chain != kept:
                raise sqlite3.DatabaseError(f"batch {number} is not what was written")
    return hashlib.sha256(table.tobytes()).digest()


def read_folder(folder: Path) -> bytes:
    """SHA-256 of all rows of a run folder.

    Raises:
        StoreError: if it is damaged in a way that loses designs.
    """
    with FolderStore.open(folder, write=False) as store:
        parts = [
            np.column_stack([np.full(len(one), one.iteration), *columns_of(one).values()]) for one in store.batches
        ]
    return hashlib.sha256(np.concatenate(parts).astype(np.float64).tobytes()).digest()


def lay_out(folder: Path, batches: int) -> None:
    """A run folder with this number of batches, in the files that compaction would have left."""
    FolderStore.create(folder, SETTINGS, SCHEMA).close()
    first, before, number = 0, chain_start(SETTINGS, SCHEMA), 0
    count = compaction.COMPACT_AT**2
    while number < batches:
        while count > batches - number:
            count //= compaction.COMPACT_AT
        made = tuple(batch(i) for i in range(number, number + count))
        segment = Segment(SETTINGS, SCHEMA, first, before, made, {})
        (folder / "segments" / segment.name).write_bytes(encode_segment(segment))
        first, before, number = segment.last + 1, segment.after, number + count


KINDS: dict[str, tuple[Callable[[Path], Record], Callable[[Path], bytes]]] = {
    "run folder": (lambda path: FolderStore.open(path, SCHEMA, write=True), read_folder),
    "SQLite, journal": (lambda path: SqliteRecord(path, "DELETE"), lambda path: read_sqlite(path, False)),
    "SQLite, WAL": (lambda path: SqliteRecord(path, "WAL"), lambda path: read_sqlite(path, False)),
    "SQLite, WAL, checked": (lambda path: SqliteRecord(path, "WAL"), lambda path: read_sqlite(path, True)),
}


def made(place: Path, kind: str, batches: int) -> Path:
    """A record with this number of batches."""
    path = place / f"{kind.replace(', ', '-').replace(' ', '-')}-{batches}"
    if kind == "run folder":
        lay_out(path, batches)
    else:
        base = KINDS[kind][0](path)
        base.fill(batches)
        base.close()
    return path


def size_of(path: Path) -> int:
    if path.is_dir():
        return sum(each.stat().st_size for each in path.rglob("*") if each.is_file())
    return sum(each.stat().st_size for each in path.parent.glob(f"{path.name}*"))


def at_size(place: Path, simulations: int) -> None:
    """Print commits, opening and size at this number of simulations."""
    paths = {kind: made(place, kind, simulations // SIZE) for kind in KINDS}
    for kind, path in paths.items():
        megabytes, times = size_of(path) / 1e6, []
        for _ in range(3):
            began = time.perf_counter()
            KINDS[kind][1](path)
            times.append(time.perf_counter() - began)
        print(f"{simulations:7d}  {kind:22s} opening {1e3 * min(times):8.1f} ms   size {megabytes:7.2f} MB")
    records = {kind: KINDS[kind][0](path) for kind, path in paths.items()}
    taken: dict[str, list[float]] = {kind: [] for kind in records}
    for number in range(COMMITS):
        one = batch(simulations // SIZE + number)
        for kind, record in records.items():  # in turn: all run under the same load
            began = time.perf_counter()
            record.commit(one)
            taken[kind].append(time.perf_counter() - began)
    for kind, record in records.items():
        record.close()
        ms = [1e3 * seconds for seconds in taken[kind]]
        print(
            f"{simulations:7d}  {kind:22s} commit median {statistics.median(ms):6.2f} ms   "
            f"mean {statistics.fmean(ms):6.2f} ms   largest {max(ms):6.1f} ms"
        )


def commit_for_ever(kind: str, path: Path) -> None:
    """Commit batches endlessly and print the number of each acknowledged one."""
    record = KINDS[kind][0](path)
    number = 0
    while True:
        record.commit(batch(number))
        os.write(1, f"{number}\n".encode())
        number += 1


def killed(place: Path, kind: str, kills: int) -> None:
    """Print how many acknowledged batches survive kill -9."""
    rng = np.random.default_rng(0)
    lost, partial = 0, 0
    for attempt in range(kills):
        path = place / f"killed-{attempt}"
        if kind == "run folder":
            FolderStore.create(path, SETTINGS, SCHEMA).close()
        command = [sys.executable, __file__, "--commit", kind, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as child:
            assert child.stdout is not None
            child.stdout.readline()
            time.sleep(rng.uniform(0.0, 1.0))
            child.send_signal(signal.SIGKILL)
            rest = child.stdout.read().split(b"\n")[:-1]
        acknowledged = int(rest[-1]) + 1 if rest else 1
        KINDS[kind][0](path).close()  # recovers
        if kind == "run folder":
            with FolderStore.open(path, write=False) as store:
                kept = [len(one) for one in store.batches]
        else:
            read_sqlite(path, True)
            base = sqlite3.connect(path)
            kept = [n for (n,) in base.execute("SELECT count(*) FROM simulations GROUP BY iteration")]
            base.close()
        lost += len(kept) < acknowledged
        partial += any(n != SIZE for n in kept)
        if path.is_dir():
            shutil.rmtree(path)
        else:
            for each in place.glob(f"{path.name}*"):
                each.unlink()
    print(f"kill -9  {kind:22s} {kills} kills: acknowledged batches lost {lost}, parts of batches {partial}")


def flipped(place: Path, kind: str, flips: int) -> None:
    """Print the effect of a flipped bit on a record of 100 batches."""
    path = made(place / "flips", kind, 100)
    read = KINDS[kind][1]
    expected = read(path)
    files = sorted(path.rglob("*.h5")) if path.is_dir() else [path]
    sizes = np.array([file.stat().st_size for file in files])
    rng = np.random.default_rng(1)
    seen: Counter[str] = Counter()
    for _ in range(flips):
        file = files[rng.choice(len(files), p=sizes / sizes.sum())]
        whole = file.read_bytes()
        at = int(rng.integers(len(whole)))
        file.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << int(rng.integers(8)))]) + whole[at + 1 :])
        try:
            if path.is_dir():
                with FolderStore.open(path, write=False) as store:
                    noticed = bool(store.warnings)
                seen["noticed" if noticed else "read as written" if read(path) == expected else "WRONG, unnoticed"] += 1
            else:
                seen["read as written" if read(path) == expected else "WRONG, unnoticed"] += 1
        except (StoreError, sqlite3.Error, ValueError, OverflowError, TypeError):
            seen["noticed"] += 1
        file.write_bytes(whole)
    print(f"flips    {kind:22s} {flips} bits: " + ", ".join(f"{name} {n}" for name, n in sorted(seen.items())))


def main() -> None:
    np.seterr(invalid="ignore")  # a flipped bit may make a NaN, which no integer is
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--folder", type=Path, help="on the file system to measure; the one for temporary files if none"
    )
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--flips", type=int, default=400)
    parser.add_argument("--commit", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.commit:
        commit_for_ever(arguments.commit[0], Path(arguments.commit[1]))
    place = Path(tempfile.mkdtemp(dir=arguments.folder))
    try:
        print(f"Python {platform.python_version()}, SQLite {sqlite3.sqlite_version}, batches of {SIZE}")
        for simulations in (1_000, 100_000):
            at_size(place, simulations)
        for kind in KINDS:
            killed(place, kind, arguments.kills)
        (place / "flips").mkdir()
        for kind in KINDS:
            flipped(place, kind, arguments.flips)
    finally:
        shutil.rmtree(place)


if __name__ == "__main__":
    main()
