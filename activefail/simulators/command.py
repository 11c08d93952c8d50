"""Custom simulators that are programs, run once for each design."""

import hashlib
import json
import os
import re
import resource
import shlex
import shutil
import signal
import string
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activefail.errors import InputError, signal_name
from activefail.files import end_of, make_folder
from activefail.simulators.interface import Results, UnusableAnswerError
from activefail.simulators.returned import designs_by_name, read_answer
from activefail.space import Array, DesignSpace
from activefail.trust import read_regular

LONGEST_EXCERPT = 300
"""Characters of a program's `stderr.txt` that a message quotes."""


LONGEST_NUMBER = 100
"""Largest width and precision in a format of a command: memory and time grow with both."""


LARGEST_ANSWER = 1_000_000
"""Most bytes in an answer's file."""


@dataclass(frozen=True)
class CommandSimulator:
    """A program that simulates one design per run, in a folder named after the design.

    The folder contains `design.json`, with the values of the variables and the fixed quantities, and the program's
    output (`stdout.txt`, `stderr.txt`). The command runs without a shell. In it, `{name}` is replaced by a value,
    `{here}` by the folder of the user's code, and `{out}` by the file to which the program writes its answer: a JSON
    object with "outcome" and, optionally, "margins".

    Attributes:
        space: design space.
        command: the program and its arguments.
        here: the value of `{here}`; None if the program may not be run.
        work: parent of the designs' folders.
        outcomes, margins: the names that an answer may contain.
        retries: how often the program is run again if its exit code is not 0 or its answer is unusable.
        keep: whether to keep the folders of successful simulations.
        largest_file: largest file that the program may write [bytes]; a program that exceeds it is killed.
        levels: of the only margin (see `read_answer`).
    """

    space: DesignSpace
    command: str
    here: Path | None
    work: Path
    outcomes: tuple[str, ...]
    margins: tuple[str, ...]
    retries: int = 0
    keep: bool = True
    largest_file: int = 10_000_000_000
    levels: tuple[float, ...] = ()
    failing: tuple[int, ...] = ()
    impossible: tuple[int, ...] = ()

    causes = ("",)
    releases_gil = False
    isolated = True

    def __post_init__(self) -> None:
        quantities = (*self.space.names, *self.space.fixed)
        for name in ("out", "here"):
            if name in quantities:
                raise InputError(f"space.{name}: `{{{name}}}` is reserved in simulator.command; rename the variable.")
        known = dict.fromkeys(quantities, 1.0) | {"out": "out", "here": "here"}
        try:
            parts = shlex.split(self.command)
            fields = [field for part in parts for field in string.Formatter().parse(part) if field[1] is not None]
            names = [name for _, name, _, _ in fields]
            for _, field, form, _ in fields:
                if "{" in (form or ""):
                    raise ValueError(f"the format of {{{field}}} must not contain braces")
                if any(len(digits.lstrip("0")) > 3 or int(digits) > LONGEST_NUMBER for digits in _digits(form or "")):
                    raise ValueError(
                        f"the format of {{{field}}} must have a width and a precision of at most {LONGEST_NUMBER}"
                    )
                if field not in known:
                    raise ValueError(f"{{{field}}} is unknown; use one of {', '.join(f'{{{name}}}' for name in known)}")
            if "out" not in names:
                raise ValueError("the command must contain {out}, the file for the program's answer")
            for part in parts:
                part.format_map(known)
        except ValueError as error:
            raise InputError(f"simulator.command: {error}; got {self.command!r}.") from None

    def arguments(self, design: Mapping[str, float], out: Path) -> list[str]:
        """The program and its arguments for a design."""
        # With enough digits for the program to read the same number.
        values = {name: _Number(value) for name, value in design.items()} | {"out": str(out), "here": str(self.here)}
        return [part.format_map(values) for part in shlex.split(self.command)]

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d), one after the other.

        Raises:
            InputError: if the program may not be run.
            OSError: if the program cannot be started or its folder cannot be written.
            RuntimeError: if its exit code is not 0.
            UnusableAnswerError: if its answer is missing or breaks a rule.
        """
        if self.here is None:
            raise InputError(
                f"simulator.command: {self.command!r} is a program that the campaign file names. A run folder may come "
                "from someone else, so such a program runs only if you name the folder of its files with --code."
            )
        answers = []
        for row, design in zip(np.asarray(X), designs_by_name(self.space, X), strict=True):
            folder = self.work / hashlib.sha256(row.tobytes()).hexdigest()[:16]
            for retries_left in reversed(range(1 + self.retries)):
                try:
                    answers.append(self._run_once(design, folder))
                    break
                except (RuntimeError, UnusableAnswerError):
                    if not retries_left:
                        raise
            if not self.keep:
                shutil.rmtree(folder, ignore_errors=True)
        return Results.concatenate(answers)

    def _run_once(self, design: Mapping[str, float], folder: Path) -> Results:
        # An answer left by an earlier attempt must not be read.
        shutil.rmtree(folder, ignore_errors=True)
        if not self.work.is_dir():
            make_folder(self.work)
        folder.mkdir()
        (folder / "design.json").write_text(json.dumps(design, indent=1) + "\n")
        out = folder / "answer.json"
        began = time.perf_counter()
        with (folder / "stdout.txt").open("wb") as stdout, (folder / "stderr.txt").open("wb") as stderr:
            # The worker's supervisor kills it along with the worker.
            with _largest_file(self.largest_file):
                program = subprocess.Popen(
                    self.arguments(design, out), cwd=folder, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr
                )
            code = program.wait()
        seconds = time.perf_counter() - began
        if code == -signal.SIGXFSZ:
            raise RuntimeError(
                f"the program exceeded simulator.largest_file ({self.largest_file} bytes) with a file in {folder}"
            )
        if code != 0:
            # A UTF-8 character has at most four bytes.
            end = end_of(folder / "stderr.txt", 4 * LONGEST_EXCERPT).decode(errors="replace").strip()
            how = f"exit code {code}" + (f" ({signal_name(-code)})" if code < 0 else "")
            raise RuntimeError(f"{how}; {folder}{os.sep}stderr.txt ends: {end[-LONGEST_EXCERPT:]!r}")
        try:
            # The program may link to a file of its results.
            written = read_regular(out, LARGEST_ANSWER, follow=True)
        except FileNotFoundError:
            raise UnusableAnswerError(f"the program did not write {out}") from None
        except ValueError as error:
            raise UnusableAnswerError(f"{out} {error}") from None
        try:
            answer = json.loads(written)
        except (ValueError, RecursionError) as error:
            raise UnusableAnswerError(f"{out} is not JSON: {error}") from None
        return read_answer(answer, self.outcomes, self.margins, self.levels, seconds)


@contextmanager
def _largest_file(size: int) -> Iterator[None]:
    """Limit the file size [bytes] of processes started in the context; this process is limited only meanwhile."""
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    lower = size if before == resource.RLIM_INFINITY else min(size, before)
    resource.setrlimit(resource.RLIMIT_FSIZE, (lower, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))


def _digits(form: str) -> list[str]:
    """The numbers in a format: width, precision, and a fill character that is a digit."""
    return re.findall(r"\d+", form)  # digits of any script, as Python accepts them


class _Number(float):
    """A number whose default format has all digits."""

    def __format__(self, form: str) -> str:
        return format(float(self), form) if form else repr(float(self))
