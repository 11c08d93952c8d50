"""The record as it grows: commits, opening, size, `status`; kill -9 and flipped bits; and all that in SQLite.

    python studies/record.py --sizes 1000 1000000 --batch 100 --kinds folder
    python studies/record.py --kills 40 --flips 400            with SQLite (docs/decisions/0016)

All kinds keep the same batches of designs with 9 variables and 13 margins. Commits are timed at the ends of records of
all kinds and sizes in turn, so that all run under the same load. Openings read every simulation, the fastest of three.
In SQLite a simulation is a row, a batch a transaction with `synchronous=FULL`, in a rollback journal and in a
write-ahead log. `sqlite-checked` also recomputes a chain of digests when it is opened, and compares it with the one in
a table.
"""

import hashlib
import os
import shutil
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from study import asked, head, line, time_of_command

from activefail.campaign.settings import parse_settings
from activefail.errors import StoreError
from activefail.record.batch import ACTIVE, INITIAL, Batch, Schema, columns_of
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results

VARIABLES, MARGINS = 9, 13
SCHEMA = Schema(
    tuple(f"x{i}" for i in range(VARIABLES)), ("safe", "failure"), ("",), tuple(f"m{i}" for i in range(MARGINS))
)
SPACE = "".join(f"space.{name} = {{ low = 0.0, high = 1.0 }}\n" for name in SCHEMA.variables)
SETTINGS = parse_settings(f'classifier.features = "design"\n{SPACE}', "record").text()
COLUMNS = ["origin", "outcome", "cause", "seconds", *SCHEMA.variables, *SCHEMA.margins]
COMMITS = 192
"""Commits that are timed at the end of each record."""


def batch(number, size):
    """The batch with a number, always the same; the first 250 simulations are the initial design."""
    rng = np.random.default_rng(number)
    codes, origin = np.zeros(size, dtype=np.int8), np.full(size, INITIAL if number * size < 250 else ACTIVE, np.int8)
    answers = Results(rng.integers(0, 2, size).astype(np.int8), codes, rng.random((size, MARGINS)), rng.random(size))
    return Batch(number, number * size + np.arange(size), rng.random((size, VARIABLES)), origin, answers)


def numbers_of(one):
    """All numbers of a batch, (n, columns)."""
    return np.column_stack([np.full(len(one), one.iteration), *columns_of(one).values()]).astype(np.float64)


class Sqlite:
    """Batches in a SQLite database."""

    def __init__(self, path, journal):
        self._base = sqlite3.connect(path, isolation_level=None)
        self._base.execute(f"PRAGMA journal_mode={journal}")
        self._base.execute("PRAGMA synchronous=FULL")
        width = len(numbers_of(batch(0, 1))[0])
        columns = ", ".join(f"c{i} {'INTEGER' if i < 4 else 'REAL'}" for i in range(width))
        self._base.execute(f"CREATE TABLE IF NOT EXISTS simulations (id INTEGER PRIMARY KEY, {columns})")
        self._base.execute("CREATE TABLE IF NOT EXISTS batches (iteration INTEGER PRIMARY KEY, chain BLOB)")
        last = self._base.execute("SELECT chain FROM batches ORDER BY iteration DESC LIMIT 1").fetchone()
        self._chain = last[0] if last else b""
        self._insert = f"INSERT INTO simulations VALUES (NULL{', ?' * width})"

    def commit(self, one):
        self._base.execute("BEGIN IMMEDIATE")
        rows = numbers_of(one)
        self._base.executemany(self._insert, rows.tolist())
        self._chain = hashlib.sha256(self._chain + rows.tobytes()).digest()
        self._base.execute("INSERT INTO batches VALUES (?, ?)", (one.iteration, self._chain))
        self._base.execute("COMMIT")

    def close(self):
        self._base.close()


def read_sqlite(path, checked):
    """All numbers of a database that passes `PRAGMA integrity_check`; `checked`: and whose chain of digests agrees.

    Raises:
        sqlite3.Error: if it is not whole.
    """
    base = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        (result,) = base.execute("PRAGMA integrity_check").fetchone()
        if result != "ok":
            raise sqlite3.DatabaseError(result)
        table = np.array(base.execute("SELECT * FROM simulations ORDER BY id").fetchall(), dtype=np.float64)[:, 1:]
        chains = base.execute("SELECT iteration, chain FROM batches ORDER BY iteration").fetchall() if checked else []
    finally:
        base.close()
    chain = b""
    for number, kept in chains:
        chain = hashlib.sha256(chain + table[table[:, 0] == number].tobytes()).digest()
        if chain != kept:
            raise sqlite3.DatabaseError(f"batch {number} is not what was written")
    if checked and len(np.unique(table[:, 0])) != len(chains):
        raise sqlite3.DatabaseError("batches are missing")
    return table


def read_folder(folder, _=True):
    """All numbers of a run folder.

    Raises:
        StoreError: if it is damaged.
    """
    with FolderStore.open(folder, write=False) as store:
        if store.warnings:
            raise StoreError(store.warnings[0])
        return np.concatenate([numbers_of(one) for one in store.batches])


def opened_folder(path):
    if not path.exists():
        return FolderStore.create(path, SETTINGS, SCHEMA)
    return FolderStore.open(path, SCHEMA, write=True)


KINDS = {
    "folder": (opened_folder, read_folder),
    "sqlite-journal": (lambda path: Sqlite(path, "DELETE"), lambda path: read_sqlite(path, False)),
    "sqlite-wal": (lambda path: Sqlite(path, "WAL"), lambda path: read_sqlite(path, False)),
    "sqlite-checked": (lambda path: Sqlite(path, "WAL"), lambda path: read_sqlite(path, True)),
}
"""How to open a record to write, and how to read all of it."""


def files_of(path):
    """The files of a record."""
    return [each for each in sorted(path.parent.rglob("*")) if each.is_file()]


def made(place, kind, batches, size):
    """A record with this number of batches, in a folder of its own."""
    path = Path(tempfile.mkdtemp(dir=place)) / "record"
    record = KINDS[kind][0](path)
    for number in range(batches):
        record.commit(batch(number, size))
    record.close()
    return path


def growth(place, kinds, sizes, size):
    """Print commits, opening, files and `status` of records of some sizes."""
    head("simulations", "record", "opening [ms]", "files", "MB", "commit [ms]: median", "mean", "largest")
    records, cells, taken = {}, {}, {}
    for simulations in sizes:
        for kind in kinds:
            path, times = made(place, kind, simulations // size, size), []
            for _ in range(3):
                began = time.perf_counter()
                KINDS[kind][1](path)
                times.append(time.perf_counter() - began)
            files = files_of(path)
            megabytes = sum(each.stat().st_size for each in files) / 1e6
            cells[simulations, kind] = f"{1e3 * min(times):.1f}", len(files), f"{megabytes:.2f}"
            if kind == "folder":
                runs = [time_of_command([sys.executable, "-m", "activefail", "status", path]) for _ in range(3)]
                wall, processor, _ = min(runs)
                print(f"status of {simulations} simulations: {wall:.2f} s, {processor:.2f} s of the processor")
            records[simulations, kind], taken[simulations, kind] = KINDS[kind][0](path), []
    for number in range(COMMITS):
        for key, record in records.items():
            one = batch(key[0] // size + number, size)
            began = time.perf_counter()
            record.commit(one)
            taken[key].append(1e3 * (time.perf_counter() - began))
    for key, record in records.items():
        record.close()
        of = statistics.median, statistics.fmean, max
        line(*key, *cells[key], *(f"{one(taken[key]):.2f}" for one in of))


def killed(place, kind, kills, size):
    """Print how many acknowledged batches survive kill -9."""
    rng, lost, partial = np.random.default_rng(0), 0, 0
    for _ in range(kills):
        path = Path(tempfile.mkdtemp(dir=place)) / "record"
        code = f"import record; record.commit_for_ever({kind!r}, {str(path)!r}, {size})"
        with subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parent, stdout=subprocess.PIPE) as child:
            child.stdout.readline()
            time.sleep(rng.uniform(0.0, 1.0))
            child.send_signal(signal.SIGKILL)
            rest = child.stdout.read().split(b"\n")[:-1]
        acknowledged = int(rest[-1]) + 1 if rest else 1
        KINDS[kind][0](path).close()  # recovers
        kept = Counter(KINDS[kind][1](path)[:, 0].tolist())
        lost += len(kept) < acknowledged
        partial += any(n != size for n in kept.values())
        shutil.rmtree(path.parent)
    print(
        f"kill -9  {kind:22s} {kills} kills: acknowledged batches lost {lost}, parts of batches {partial}", flush=True
    )


def commit_for_ever(kind, path, size):
    """Commit batches endlessly and print the number of each acknowledged one."""
    record, number = KINDS[kind][0](Path(path)), 0
    while True:
        record.commit(batch(number, size))
        os.write(1, f"{number}\n".encode())
        number += 1


def flipped(place, kind, flips, size):
    """Print the effect of a flipped bit on a record of 100 batches."""
    path, rng = made(place, kind, 100, size), np.random.default_rng(1)
    expected, seen = KINDS[kind][1](path), Counter()
    files = [each for each in files_of(path) if each.stat().st_size > 1000]
    sizes = np.array([each.stat().st_size for each in files])
    for _ in range(flips):
        file = files[rng.choice(len(files), p=sizes / sizes.sum())]
        whole = file.read_bytes()
        at = int(rng.integers(len(whole)))
        file.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << int(rng.integers(8)))]) + whole[at + 1 :])
        try:
            same = np.array_equal(KINDS[kind][1](path), expected)
            seen["read as written" if same else "WRONG, unnoticed"] += 1
        except (StoreError, sqlite3.Error, ValueError, OverflowError, TypeError):
            seen["noticed"] += 1
        file.write_bytes(whole)
    print(
        f"flips    {kind:22s} {flips} bits: " + ", ".join(f"{name} {n}" for name, n in sorted(seen.items())), flush=True
    )


def main():
    options = asked(__doc__, kinds=list(KINDS), sizes=[1_000, 100_000], batch=10, kills=0, flips=0, folder=Path)
    np.seterr(invalid="ignore")  # a flipped bit may make a NaN, which no integer is
    place = Path(tempfile.mkdtemp(dir=options.folder))
    try:
        growth(place, options.kinds, options.sizes, options.batch)
        for kind in options.kinds if options.kills else ():
            killed(place, kind, options.kills, options.batch)
        for kind in options.kinds if options.flips else ():
            flipped(place, kind, options.flips, options.batch)
    finally:
        shutil.rmtree(place)


if __name__ == "__main__":
    main()
