"""The cost of the record as it grows: a commit at 10³ and at 10⁶ stored simulations, opening it, and `status`.

    python benchmarks/store.py [--batch 100] [--folder DIR]

Campaigns with the bearing's columns (nine variables, twelve other numbers) and made-up numbers are written as
compaction would leave them. Commits, including those that merge, are timed at the end of such a record and of a small
one in turn, so that both run under the same load. Openings and `status` are the fastest of three, by wall clock and
processor time.
"""

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from activefail.bearing.design import TABLE_1
from activefail.bearing.outcome import CAUSES, COLUMNS, OUTCOMES
from activefail.campaign.settings import parse_settings
from activefail.record import compaction
from activefail.record.batch import ACTIVE, INITIAL, Batch, Schema
from activefail.record.run_folder import FolderStore
from activefail.record.segment import Segment, chain_start, encode_segment
from activefail.simulators.interface import Results

SCHEMA = Schema(TABLE_1.names, OUTCOMES, CAUSES, COLUMNS)
SMALL, LARGE = 1_000, 1_000_000
COMMITS = 192
"""Three times 64: each record is merged as often as it is in the long run."""


def batches(size: int, first: int) -> Iterator[Batch]:
    """An endless sequence of batches; the first 250 simulations are the initial design."""
    rng = np.random.default_rng(first)
    iteration = 0
    while True:
        origin = INITIAL if iteration * size < 250 else ACTIVE
        yield Batch(
            iteration,
            TABLE_1.from_unit(rng.random((size, 9))),
            np.full(size, origin, dtype=np.int8),
            Results(
                rng.integers(0, 3, size).astype(np.int8),
                np.zeros(size, dtype=np.int8),
                rng.random((size, len(COLUMNS))),
                rng.random(size),
            ),
        )
        iteration += 1


def laid_out(folder: Path, simulations: int, size: int) -> None:
    """A run folder with this number of simulations, in the files that compaction would have left."""
    settings = parse_settings(
        f"sampling = {{ initial = 250, budget = {simulations}, batch = {size} }}", "benchmark"
    ).text()
    FolderStore.create(folder, settings, SCHEMA).close()
    made, left = batches(size, 0), simulations // size
    first, before = 0, chain_start(settings, SCHEMA)
    count = 1
    while count * compaction.COMPACT_AT * size <= compaction.LARGEST:
        count *= compaction.COMPACT_AT
    while left:
        while count > left:
            count //= compaction.COMPACT_AT
        segment = Segment(settings, SCHEMA, first, before, tuple(next(made) for _ in range(count)), {})
        (folder / "segments" / segment.name).write_bytes(encode_segment(segment))
        first, before, left = segment.last + 1, segment.after, left - count


def commit_times(folders: list[Path], size: int) -> list[list[float]]:
    """Seconds of commits at the ends of records, taken in turn."""
    stores = [FolderStore.open(folder, SCHEMA, write=True) for folder in folders]
    times: list[list[float]] = [[] for _ in stores]
    made = batches(size, 1)
    for _ in range(COMMITS):
        batch = next(made)
        for store, taken in zip(stores, times, strict=True):
            began = time.perf_counter()
            store.commit(batch)
            taken.append(time.perf_counter() - began)
    for store in stores:
        store.close()
    return times


def timed(command: list[str]) -> tuple[float, float]:
    """Minimum wall time of three runs of a command, and minimum processor time."""
    walls, processors = [], []
    for _ in range(3):
        before = _children()
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        walls.append(time.perf_counter() - began)
        processors.append(_children() - before)
    return min(walls), min(processors)


def _children() -> float:
    import resource

    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


OPENING = """
import sys, time
from activefail.record.run_folder import FolderStore
began, used = time.perf_counter(), time.process_time()
with FolderStore.open(sys.argv[1], write=False) as store:
    print(time.perf_counter() - began, time.process_time() - used, sum(len(batch) for batch in store.batches))
"""


def opening(folder: Path) -> tuple[float, float]:
    """Minimum wall time of three openings, each in a new process, and minimum processor time."""
    runs = []
    for _ in range(3):
        done = subprocess.run(
            [sys.executable, "-c", OPENING, str(folder)], check=True, capture_output=True, text=True
        ).stdout.split()
        runs.append((float(done[0]), float(done[1])))
    return min(wall for wall, _ in runs), min(processor for _, processor in runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=100, help="simulations of a batch")
    parser.add_argument(
        "--folder", type=Path, help="on the file system to measure; the one for temporary files if none"
    )
    arguments = parser.parse_args()
    place = Path(tempfile.mkdtemp(dir=arguments.folder))
    try:
        small, large = place / "small", place / "large"
        laid_out(small, SMALL, arguments.batch)
        laid_out(large, LARGE, arguments.batch)
        files = len(list((large / "segments").iterdir()))
        megabytes = sum(path.stat().st_size for path in large.rglob("*") if path.is_file()) / 1e6
        print(f"record       {LARGE} simulations in batches of {arguments.batch}: {files} files, {megabytes:.0f} MB")
        wall, processor = opening(large)
        print(f"opening      {wall:.2f} s ({processor:.2f} s of the processor)")
        wall, processor = timed([sys.executable, "-m", "activefail.cli", "status", str(large)])
        print(f"status       {wall:.2f} s ({processor:.2f} s of the processor), the program's start included")
        at_small, at_large = commit_times([small, large], arguments.batch)
        for name, taken in ((f"at {SMALL}", at_small), (f"at {LARGE}", at_large)):
            print(
                f"commit       {name}: median {1e3 * statistics.median(taken):.2f} ms, "
                f"mean {1e3 * statistics.fmean(taken):.2f} ms, largest {1e3 * max(taken):.0f} ms"
            )
        medians = statistics.median(at_large) / statistics.median(at_small)
        means = statistics.fmean(at_large) / statistics.fmean(at_small)
        print(f"ratio        {medians:.2f} of the medians, {means:.2f} of the means of {COMMITS} commits")
    finally:
        shutil.rmtree(place)


if __name__ == "__main__":
    main()
