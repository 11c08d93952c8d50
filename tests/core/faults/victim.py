"""Campaigns that are run to be killed, each in a process of its own, forked from one that has loaded all libraries.

`python -m faults.victim` reads commands, one JSON object a line. For a task it prints the process that does it; asked
to wait for a process, it prints its exit code. At the place that the task names the process waits until something comes
through its fifo, so that it can be traced from there on. Its log has a line for each commit,
state and set that the record acknowledged. Names under `/-/`, which do not exist, mark in a trace where each of these
begins and ends.
"""

import errno
import fcntl
import json
import os
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py  # noqa: F401 (before the victims, so that they make no system calls for it)
import numpy as np
from campaign.stub import Disc, disc
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import ActivefailError
from activefail.execution.executor import Arrived
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.threads import one_thread
from activefail.loop import proposing  # noqa: F401 (as h5py: `ask` loads it only to propose)
from activefail.loop.asking import ask
from activefail.loop.in_flight import HandedOut
from activefail.loop.progress import Observer
from activefail.loop.running import run
from activefail.loop.telling import add, correct, drop, tell
from activefail.record.batch import GIVEN, Batch
from activefail.record.run_folder import FolderStore
from activefail.record.store import NOTHING, Remembered
from activefail.simulators.interface import Results, Simulator
from activefail.space.space import Array

INITIAL, BUDGET, BATCH = 6, 12, 3
COMMITS = BUDGET // BATCH


class Inline:
    """Simulates in the calling thread: a second thread would have system calls of its own."""

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        return simulator.run(X)

    def __enter__(self) -> "Inline":
        return self

    def __exit__(self, *exception: object) -> None: ...


def campaign() -> Campaign:
    """The campaign that every fault is tried on."""
    return disc(Disc(), initial=INITIAL, budget=BUDGET, batch=BATCH, extra="validation.size = 5")


class Gate:
    """Waits at one place of the work.

    Attributes:
        place: where; empty once it has waited.
        fifo: what it waits for.
        seen: how often each kind of place was come to.
    """

    def __init__(self, place: str = "", fifo: str = "") -> None:
        self.place, self.fifo = place, fifo
        self.seen: Counter[str] = Counter()

    @contextmanager
    def marked(self, name: str) -> Iterator[None]:
        """Mark where something begins and ends, and wait there if this is the place."""
        self.seen[name] += 1
        if self.place == f"{name} {self.seen[name]}":
            self.wait()
        os.access(f"/-/{name}/begins", os.F_OK)
        yield
        os.access(f"/-/{name}/ends", os.F_OK)

    def wait(self) -> None:
        # Left open: to close it would be one more system call of what follows.
        os.read(os.open(self.fifo, os.O_RDONLY), 1)


class Logging(FolderStore):
    """A record that logs what it acknowledges."""

    gate = Gate()
    log = -1
    lists_commits = True

    def commit(self, batch: Batch, also: Remembered = NOTHING) -> None:
        with self.gate.marked("commit"):
            super().commit(batch, also)
        if self.lists_commits:
            self.tell(f"commit {len(self.batches)} {self.digest}")

    def close(self) -> None:
        with self.gate.marked("closing"):
            super().close()

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        with self.gate.marked("state"):
            super().write_state(iteration, arrays)
        if self.lists_commits:
            self.tell(f"state {iteration}")

    def write_set(self, name: str, X: Array, results: Results) -> None:
        with self.gate.marked("set"):
            super().write_set(name, X, results)
        self.tell(f"set {name}")

    def tell(self, line: str) -> None:
        """Write a line to the log."""
        if self.log >= 0:
            os.write(self.log, f"{line}\n".encode())


def opened(folder: Path) -> Logging:
    """The victim's record, made if it is not there."""
    one = campaign()
    if (folder / "campaign.toml").exists():
        with Logging.gate.marked("opening"):
            return Logging.open(folder, one.schema, write=True)
    with Logging.gate.marked("creation"):
        return Logging.create(folder, one.settings.text(), one.schema)


def work(folder: Path, log: Path, commits: int | None, fault: str | None) -> int:
    """Take the campaign in a folder on, to its budget or a number of commits; the exit code as the command line's."""
    Logging.log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    if fault == "without locks":
        without_locks()
    try:
        with opened(folder) as record:
            if fault == "elsewhere":
                elsewhere(record)
                return 0
            observer = Observer(stop=lambda: commits is not None and len(record.batches) >= commits)
            run(campaign(), record, Inline(), BUDGET, observer)
            for warning in record.warnings:
                os.write(Logging.log, f"warning {warning}\n".encode())
    except ActivefailError as error:
        os.write(Logging.log, f"error {error}\n".encode())
        return 1
    except BaseException:
        os.write(Logging.log, f"traceback {traceback.format_exc()!r}\n".encode())
        return 70
    return 0


DROPPED = 7
"""The id of the design that is given up: one that the criterion chose."""

WRONG = (2, 6)
"""The ids of simulations whose result is corrected: one of the initial design, and the one that was given."""


def elsewhere(record: Logging) -> None:
    """Take the campaign to its budget by `ask`, `tell`, `drop`, `add` and corrections.

    Every step follows from the record alone.
    """
    one, gate = campaign(), record.gate
    # A line written within a command would be one more system call of it.
    record.lists_commits = False
    while True:
        handed_out = HandedOut.of(record)
        flight, history = handed_out.in_flight, handed_out.history
        if len(history) > BATCH and not (history.origin == GIVEN).any():
            X = one.space.from_unit(np.array([[0.3, 0.6]]))
            with gate.marked("add"):
                add(one, record, X, one.simulator.run(X), labels=[{"note": "given"}])
            record.tell("added")
        elif DROPPED in flight.id:
            with gate.marked("drop"):
                drop(record, np.array([DROPPED]))
            record.tell(f"dropped {DROPPED}")
        elif len(record.corrections) < 2 * len(WRONG) and {*WRONG} <= {*history.id.tolist()}:
            # First wrong ones, then the right ones again.
            rows = np.flatnonzero(np.isin(history.id, WRONG))
            results = one.simulator.run(history.designs[rows])
            if not len(record.corrections):
                results = replace(results, outcome=(1 - results.outcome).astype(np.int8))
            with gate.marked("correct"):
                labels = [{"note": f"corrected {len(record.corrections)}"}] * len(rows)
                correct(one, record, history.id[rows], results, labels=labels)
            record.tell(f"corrected {len(record.corrections)}")
        elif len(flight):
            part = flight[:2]
            with gate.marked("tell"):
                labels = [{"note": f"told {number}"} for number in part.id.tolist()]
                tell(one, record, part.id, one.simulator.run(part.designs), labels=labels)
            record.tell(f"told {' '.join(map(str, part.id.tolist()))}")
        else:
            with gate.marked("ask"):
                proposed = ask(one, record, BATCH, BUDGET).designs
            if not len(proposed):
                return
            record.tell(f"asked {' '.join(map(str, proposed.id.tolist()))}")


def without_locks() -> None:
    """As on a file system without locks."""

    def refused(*arguments: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    fcntl.flock = refused


def serve() -> None:
    """Obey until the input ends."""
    # Before the victims, as h5py: torch loads more modules when it first learns, and SciPy its direction numbers.
    with one_thread():
        VariationalGP().learned(np.eye(3), np.array([True, False, True]))
    campaign().space.sobol(2, np.random.default_rng(0))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for line in sys.stdin:
        command = json.loads(line)
        if "wait" in command:
            answer = os.waitstatus_to_exitcode(os.waitpid(command["wait"], 0)[1])
        else:
            answer = os.fork()
            if answer == 0:
                Logging.gate = Gate(command["place"], command["fifo"])
                if not command["place"]:
                    Logging.gate.wait()
                os._exit(work(Path(command["folder"]), Path(command["log"]), command["commits"], command["fault"]))
        sys.stdout.write(f"{answer}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    serve()
