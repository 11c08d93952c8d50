"""The cost of a campaign's driver as the campaign grows, with many workers and a simulator that takes no time.

    python studies/scale.py --workers 64 --simulations 100000 --batch 500 --folder DIR

The problem is a ball in four variables, with one boundary and an initial design of 1,000. At each doubling it prints
the milliseconds per simulation since the last line, wall clock and processor, divided into proposing, simulating and
recording, and learning; the memory; and the size of the run folder. The record is on the file system of --folder.
"""

import resource
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from study import asked, campaign_of, head, line

from activefail.execution.local import ThreadExecutor
from activefail.loop.progress import Observer
from activefail.loop.running import run
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results


class Ball:
    """Fails within a ball in the middle of the unit cube; takes no time."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("",), ("distance",), True

    def run(self, X):
        distance = 0.4 - np.linalg.norm(X - 0.5, axis=1)
        n = len(X)
        return Results((distance > 0.0).astype(np.int8), np.zeros(n, dtype=np.int8), distance[:, None], np.zeros(n))


class Account:
    """The division of the time since the last line."""

    def __init__(self, folder):
        self.folder, self.spent = folder, Counter()
        self.stage_now, self.since = "starting", time.perf_counter()
        self.done, self.cpu, self.next = 0, time.process_time(), 0
        head("simulations", "ms each", "cpu ms", "proposing", "simulating", "learning", "memory MB", "folder MB")

    def stage(self, name):
        now = time.perf_counter()
        self.spent[self.stage_now] += now - self.since
        self.stage_now, self.since = name, now

    def progress(self, progress):
        self.stage(self.stage_now)
        if progress.done < self.next or progress.iteration == 0:
            return
        cpu, stages = time.process_time(), [self.spent[name] for name in ("proposing", "simulating", "learning")]
        each = [sum(self.spent.values()), cpu - self.cpu, *stages]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        size = sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file()) / 1e6
        ms = (f"{1e3 * seconds / (progress.done - self.done):.2f}" for seconds in each)
        line(progress.done, *ms, f"{memory:.0f}", f"{size:.1f}")
        self.spent.clear()
        self.done, self.cpu, self.next = progress.done, cpu, 2 * progress.done


def main():
    options = asked(__doc__, workers=64, simulations=100_000, initial=1_000, batch=500, folder=Path)
    campaign = campaign_of(
        Ball(),
        classifier__features="design",
        space={f"x{i}": {"low": 0.0, "high": 1.0} for i in range(4)},
        sampling={"initial": options.initial, "budget": options.simulations, "batch": options.batch},
    )
    with tempfile.TemporaryDirectory(dir=options.folder) as parent:
        folder = Path(parent) / "run"
        account = Account(folder)
        with (
            FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store,
            ThreadExecutor(options.workers) as executor,
        ):
            run(campaign, store, executor, options.simulations, Observer(account.progress, account.stage))


if __name__ == "__main__":
    main()
