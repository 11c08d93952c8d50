"""How long commands that only read a run folder take: `status`, `export` and `predict`, each in a fresh process.

    python studies/commands.py [--repeats 7] [--campaign quick]

The medians by wall clock and processor time, on the shipped campaign, with 100 designs to predict. The first call of
each command, which reads the libraries from the disk, is not counted.
"""

import statistics
import sys
import tempfile
from functools import partial

from study import asked, head, line, time_of_command

PROGRAM = (sys.executable, "-m", "activefail")
EXPORT = ("export", "run", "--csv", "simulations.csv")
COMMANDS = (("status", "run"), EXPORT, ("predict", "run", "--csv", EXPORT[-1], "--out", "predictions.csv"))


def main():
    options = asked(__doc__, repeats=7, campaign="quick")
    with tempfile.TemporaryDirectory() as folder:
        timed = partial(time_of_command, cwd=folder)
        timed([*PROGRAM, "run", options.campaign, "--out", "run", "-q"])
        head("command", "wall clock [s]", "processor [s]")
        for words in COMMANDS:
            timed([*PROGRAM, *words])
            wall, processor, _ = zip(*(timed([*PROGRAM, *words]) for _ in range(options.repeats)), strict=True)
            line(f"`{words[0]}`", f"{statistics.median(wall):.2f}", f"{statistics.median(processor):.2f}")


if __name__ == "__main__":
    main()
