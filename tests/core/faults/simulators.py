"""Simulators that go wrong; apart from the tests, so that a worker loads little for them."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from campaign.stub import Disc

from activefail.simulators.interface import Results
from activefail.space.space import Array


@dataclass(frozen=True)
class OnceAt(Disc):
    """Does what another disc does to its worker at some designs, the first time that they are simulated.

    Attributes:
        every: one design in so many, selected by its digits.
    """

    fault: Disc | None = None
    folder: str = ""
    every: int = 4
    releases_gil = False

    def run(self, X: Array) -> Results:
        for design in X:
            key = int(abs(design[0]) * 1e9)
            note = Path(self.folder, f"at-{key}")
            if key % self.every == 0 and not note.exists():
                note.touch()
                assert self.fault is not None
                # That acts where the first number is 0.
                self.fault.run(np.array([[0.0, design[1]]]))
        return Disc().run(X)


@dataclass(frozen=True)
class Failing(Disc):
    """Fails in one way wherever x is below a bound."""

    how: str = "raises"
    below: float = -np.inf
    releases_gil = False

    def run(self, X: Array) -> Results:
        answers = Disc().run(X)
        bad = X[:, 0] < self.below
        if not bad.any():
            return answers
        match self.how:
            case "raises":
                raise ValueError("no convergence")
            case "nan":
                return replace(answers, outcome=np.where(bad, np.nan, answers.outcome))
            case "hangs":
                time.sleep(600)
            case "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            case "memory":
                np.empty(2**58)
        raise AssertionError(self.how)


# --- that interfere with their worker ----------------------------------------------------------------------------

DESCRIPTORS = range(3, 1024)
"""Those that a simulator has not opened itself, and a good many that it might have."""


@dataclass(frozen=True)
class Meddling(Disc):
    """Does something to its worker where the first number is 0, and gives the answer of a disc.

    Attributes:
        how: the name of a function of this module.
    """

    how: str = ""
    releases_gil = False

    def run(self, X: Array) -> Results:
        if (X[:, 0] == 0.0).any():
            globals()[self.how](X)
        return Disc().run(X)


def forks_and_returns(X: Array) -> None:
    """As where the program of a child cannot be started: both come back."""
    if os.fork() == 0:
        with suppress(OSError):
            os.execvp("no-such-program", ["x"])


def forks_and_raises(X: Array) -> None:
    """As where nobody expects that: the child's error comes back."""
    if os.fork() == 0:
        os.execvp("no-such-program", ["x"])


def forks_and_stays(X: Array) -> None:
    """A child lives on, with the worker's connection open, in a session of its own."""
    if os.fork() == 0:
        os.setsid()
        while True:
            time.sleep(60.0)


def reads(X: Array) -> None:
    """What a terminal would say."""
    if sys.stdin.read():
        raise AssertionError("a worker has something to read")


def writes(X: Array) -> None:
    """Bytes that are no answer, to every descriptor."""
    for descriptor in DESCRIPTORS:
        with suppress(OSError):
            os.write(descriptor, b"\0\0\0\5AAAAA")


def writes_a_part(X: Array) -> None:
    """Bytes after which more of an answer would come, to every descriptor; then it hangs."""
    for descriptor in DESCRIPTORS:
        with suppress(OSError):
            os.write(descriptor, b"\0\0\1\0AAAAA")
    time.sleep(600.0)


def closes(X: Array) -> None:
    """Every descriptor, as daemons do."""
    os.closerange(DESCRIPTORS.start, DESCRIPTORS.stop)


def raises(X: Array) -> None:
    """What simulators raise."""
    raise ValueError("no convergence")


def stops_its_supervisor(X: Array) -> None:
    """As a program that stops its process group, or the shell that it takes its parent for."""
    os.kill(os.getppid(), signal.SIGSTOP)


def ends_its_supervisor(X: Array) -> None:
    """In a way that can be refused; then it waits for the end."""
    os.kill(os.getppid(), signal.SIGTERM)
    time.sleep(600.0)


def dies_of_a_real_time_signal(X: Array) -> None:
    """A signal that has no name."""
    os.kill(os.getpid(), 40)


def dies_after_it_raised(X: Array) -> None:
    """Raises where it is not the first simulation of its process, dies where it is."""
    if not _simulations:
        os._exit(3)
    raises(X)


# --- that depend on the simulations before them ------------------------------------------------------------------

_simulations: list[Any] = []
"""What this process has simulated."""


@dataclass(frozen=True)
class Remembering(Disc):
    """Counts the simulations of its process, and acts by their number.

    Attributes:
        other: whose answer is given, or what it does.
        most: simulations of a process after which it raises.
        folder: where the process and the number of each simulation is noted.
        renew: simulations that one process may run.
    """

    other: Disc | None = None
    most: float = np.inf
    folder: str = ""
    renew: int | None = None
    releases_gil = False

    def run(self, X: Array) -> Results:
        number = len(_simulations)
        if self.folder:
            Path(self.folder, f"{time.monotonic_ns()}-{os.getpid()}-{number}").touch()
        if number >= self.most:
            raise OSError(24, "Too many open files")
        answers = (self.other or Disc()).run(X)
        _simulations.append(None)
        return answers


class Unusual(Disc):
    """Answers nonsense from the second simulation of a process on."""

    releases_gil = False

    def run(self, X: Array) -> Results:
        answers = Disc().run(X)
        _simulations.append(None)
        return answers if len(_simulations) < 2 else replace(answers, outcome=np.full(1, 7, np.int8))


# --- that leave something behind ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Leaving(Disc):
    """Starts processes in sessions of their own and notes them in a folder; then does something.

    Attributes:
        then: "answers", "raises", "dies" or "hangs", or "holds" the interpreter.
        folder: of the notes.
    """

    then: str = "answers"
    folder: str = ""
    renew: int | None = None
    releases_gil = False

    def run(self, X: Array) -> Results:
        self.note(os.getpid())
        self.note(subprocess.Popen(["sleep", "600"], start_new_session=True).pid)
        read, write = os.pipe()
        if os.fork() == 0:
            os.setsid()
            # Its parent ends at once, as daemons do.
            child = os.fork()
            if child == 0:
                os.execvp("sleep", ["sleep", "600"])
            os.write(write, str(child).encode())
            os._exit(0)
        self.note(int(os.read(read, 20)))
        program = subprocess.Popen([sys.executable, "-c", NEST], stdout=subprocess.PIPE)
        assert program.stdout is not None
        for _ in range(8):
            self.note(int(program.stdout.readline()))
        match self.then:
            case "raises":
                raise ValueError("no convergence")
            case "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            case "hangs":
                time.sleep(600.0)
            case "holds":
                import ctypes

                ctypes.PyDLL(None).sleep(600)
        return Disc().run(X)

    def note(self, process: int) -> None:
        """Leave a note of a process."""
        Path(self.folder, str(process)).touch()


NEST = """
import os, signal, time
for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
for _ in range(3):
    if os.fork() == 0:
        os.setsid()
os.write(1, b"%d\\n" % os.getpid())
time.sleep(600)
"""
"""A program that becomes eight processes in sessions of their own, deaf to what can be ignored."""
