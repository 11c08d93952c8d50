"""How long commands that only read a run folder take: `status`, `export` and `predict`, each in a fresh process.

    python benchmarks/commands.py [--repeats 7] [--campaign quick]

The medians by wall clock and processor time, on the shipped campaign, with 100 designs to predict. The first call of
each command, which reads the libraries from the disk, is not counted.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PROGRAM = (sys.executable, "-m", "activefail")


def timed(words: list[str], folder: Path) -> tuple[float, float]:
    """Wall clock and processor time of a command [s]."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([*PROGRAM, *words], cwd=folder, check=True, capture_output=True)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--campaign", default="quick")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        timed(["run", arguments.campaign, "--out", "run", "-q"], folder)
        export = ["export", "run", "--csv", "simulations.csv"]
        commands = [["status", "run"], export, ["predict", "run", "--csv", export[-1], "--out", "predictions.csv"]]
        print("| command | wall clock [s] | processor [s] |\n|---|---|---|")
        for words in commands:
            timed(words, folder)
            wall, processor = zip(*(timed(words, folder) for _ in range(arguments.repeats)), strict=True)
            print(f"| `{words[0]}` | {statistics.median(wall):.2f} | {statistics.median(processor):.2f} |", flush=True)


if __name__ == "__main__":
    main()
