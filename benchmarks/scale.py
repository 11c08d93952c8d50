"""The cost of a campaign's driver as the campaign grows, with many workers and a simulator that takes no time.

    python benchmarks/scale.py --workers 64 --simulations 100000 --batch 500 --folder DIR

The problem is a ball in four variables, with one boundary and an initial design of 1,000. At each doubling it prints
the milliseconds per simulation since the last line, wall clock and processor, divided into proposing, simulating and
recording, and learning; the memory; and the size of the run folder. The record is on the file system of --folder.
"""

import argparse
import resource
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.execution.local import ThreadExecutor
from activefail.loop.batches import run
from activefail.loop.progress import Observer, Progress
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results
from activefail.space import Array


class Ball:
    """Fails within a ball in the middle of the unit cube; takes no time."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("",), ("distance",), True

    def run(self, X: Array) -> Results:
        distance = 0.4 - np.linalg.norm(X - 0.5, axis=1)
        n = len(X)
        return Results((distance > 0.0).astype(np.int8), np.zeros(n, dtype=np.int8), distance[:, None], np.zeros(n))


class Account:
    """The division of the time since the last line."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.stage_now, self.since = "starting", time.perf_counter()
        self.spent: Counter[str] = Counter()
        self.done, self.cpu, self.next = 0, time.process_time(), 0
        print(
            f"{'simulations':>11} {'ms each':>8} {'cpu ms':>8}  {'proposing':>9} {'simulating':>10} {'learning':>8}"
            f" {'memory MB':>9} {'folder MB':>9}"
        )

    def stage(self, name: str) -> None:
        now = time.perf_counter()
        self.spent[self.stage_now] += now - self.since
        self.stage_now, self.since = name, now

    def progress(self, progress: Progress) -> None:
        self.stage(self.stage_now)
        if progress.done < self.next or progress.iteration == 0:
            return
        n = progress.done - self.done
        cpu = time.process_time()
        parts = [1e3 * self.spent[name] / n for name in ("proposing", "simulating", "learning")]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        size = sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file()) / 1e6
        print(
            f"{progress.done:>11} {1e3 * sum(self.spent.values()) / n:>8.1f} {1e3 * (cpu - self.cpu) / n:>8.1f}"
            f"  {parts[0]:>9.1f} {parts[1]:>10.2f} {parts[2]:>8.1f} {memory:>9.0f} {size:>9.1f}",
            flush=True,
        )
        self.spent.clear()
        self.done, self.cpu, self.next = progress.done, cpu, 2 * progress.done


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=64)
    parser.add_argument("--simulations", type=int, default=100_000)
    parser.add_argument("--batch", type=int, default=500)
    parser.add_argument("--folder", type=Path, help="where the run folder is made; one for temporary files if none")
    options = parser.parse_args()
    space = "\n".join(f"space.x{i} = {{ low = 0.0, high = 1.0 }}" for i in range(4))
    text = f"""
        classifier.features = "design"
        {space}
        sampling = {{ initial = 1000, budget = {options.simulations}, batch = {options.batch} }}"""
    campaign = Campaign.of(parse_settings(text, "scale"), simulator=Ball())
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
