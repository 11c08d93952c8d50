"""A campaign in processes that can be traced and killed, and what its course is compared by."""

import errno
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from faults.victim import BUDGET, Inline, campaign, opened
from patience import PATIENCE

from activefail.loop.running import run
from activefail.record.run_folder import FolderStore

CORE = Path(__file__).parents[1]
TESTS = CORE.parent


def few(states: list[Any], every: bool, number: int = 5) -> list[Any]:
    """All of some states, or a few of them, the first and the last included."""
    if every or len(states) <= number:
        return states
    return [states[round(i * (len(states) - 1) / (number - 1))] for i in range(number)]


# --- the campaign ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Course:
    """All that a campaign did: every bit of its batches, of its sets and of what it learned."""

    chain: str
    sets: dict[str, bytes]
    iteration: int
    learned: dict[str, bytes]

    @classmethod
    def of(cls, store: FolderStore) -> "Course":
        # The stub takes no time, so that the chain's digest is over designs, origins, outcomes, causes and margins.
        state = store.latest_state()
        assert state is not None
        kept = store.read_set("validation-0")
        assert kept is not None
        return cls(
            store.digest,
            {"X": kept[0].tobytes(), "outcome": kept[1].outcome.tobytes(), "margins": kept[1].margins.tobytes()},
            state[0],
            {name: array.tobytes() for name, array in state[1].items()},
        )


def finished(folder: Path) -> Course:
    """The course of the campaign in a folder, once it has been taken to its budget."""
    with opened(folder) as store:
        run(campaign(), store, Inline(), BUDGET)
        return Course.of(store)


# --- processes to be killed --------------------------------------------------------------------------------------


@dataclass
class Victim:
    """A process that runs a campaign and waits at a point of its work until the test continues it."""

    server: "Victims"
    pid: int
    log: Path
    gate: int = -1
    reports: list[str] = field(default_factory=list)

    def go_on(self) -> None:
        """Let it continue from where it waits."""
        os.write(self.gate, b"\n")
        os.close(self.gate)

    def end(self) -> int:
        """Its exit code, below 0 for a signal; `told` is what it was told until then."""
        code = int(self.server.answer({"wait": self.pid}))
        self.reports = self.log.read_text().splitlines() if self.log.exists() else []
        return code

    @property
    def acknowledged(self) -> list[str]:
        """What the record acknowledged: lines like "commit 3 <digest>", "state 1" and "set <name>"."""
        return [line for line in self.reports if line.split()[0] in ("commit", "state", "set")]


class Victims:
    """A process that has loaded all libraries and forks the victims."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.number = 0
        path = os.pathsep.join([*map(str, (CORE, TESTS, TESTS.parent)), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.process = subprocess.Popen(
            [sys.executable, "-m", "faults.victim"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=folder,
            # Without the current folder among those that modules are looked for in: each victim changes it.
            env=os.environ | {"PYTHONPATH": path, "PYTHONSAFEPATH": "1"},
        )
        assert self.answer() == "ready"

    def answer(self, command: dict[str, Any] | None = None) -> str:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        if command is not None:
            self.process.stdin.write(json.dumps(command) + "\n")
            self.process.stdin.flush()
        line = self.process.stdout.readline()
        assert line, "the process that forks the victims has died"
        return line.strip()

    def start(self, run_folder: Path, place: str, commits: int | None = None, fault: str | None = None) -> Victim:
        """A victim that waits at a place of its work: where what `marked` names begins, for the n-th time.

        Args:
            run_folder: of the campaign.
            place: like "commit 3"; "" is before anything.
            commits: after how many it stops; at its budget if None.
            fault: what it does to itself, see `faults.victim`.
        """
        self.number += 1
        fifo, log = (self.folder / f"{name}-{self.number}" for name in ("fifo", "log"))
        os.mkfifo(fifo)
        task = {"folder": str(run_folder), "log": str(log), "fifo": str(fifo), "place": place, "commits": commits}
        victim = Victim(self, int(self.answer(task | {"fault": fault})), log)
        give_up = time.monotonic() + PATIENCE
        while True:
            try:
                victim.gate = os.open(fifo, os.O_WRONLY | os.O_NONBLOCK)
                return victim
            except OSError as error:
                if error.errno != errno.ENXIO:  # nobody reads from it yet
                    raise
                state = Path(f"/proc/{victim.pid}/stat").read_text().rpartition(")")[2].split()[0]
                reports = log.read_text() if log.exists() else ""
                assert state not in "ZX", f"the victim ended before it came to {place!r}: {reports}"
                assert time.monotonic() < give_up, f"the victim did not come to {place!r}: {reports}"
                time.sleep(0.002)

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(PATIENCE)
        assert self.process.stdout is not None
        self.process.stdout.close()


@contextmanager
def traced(pid: int, *options: str) -> Iterator[None]:
    """Have strace watch a process that waits, until it ends."""
    with tempfile.TemporaryFile("w+") as errors:
        strace = subprocess.Popen(["strace", "-p", str(pid), *options], stderr=errors)
        try:
            # As soon as strace is its tracer the process may still make calls that strace does not see. Once strace
            # says that it has attached, it has interrupted the process as well.
            while f"Process {pid} attached" not in (said := os.pread(errors.fileno(), 10_000, 0).decode()):
                if strace.poll() is not None:
                    pytest.fail(f"strace ended: {said}")
                time.sleep(0.001)
            yield
            strace.wait(PATIENCE)
        finally:
            strace.kill()
            strace.wait()
