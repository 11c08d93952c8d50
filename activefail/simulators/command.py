"""A program that is run once for each design."""

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
from activefail.files import end_of, make_folder, read_regular
from activefail.simulators.answers import designs_by_name, read_answer
from activefail.simulators.interface import Results, UnusableAnswerError
from activefail.space import Array, DesignSpace

LONGEST_EXCERPT = 300
"""Characters of a program's `stderr.txt` that a message repeats."""


LONGEST_NUMBER = 100
"""Largest width and precision of a format in a command: memory and time grow with both."""


LARGEST_ANSWER = 1_000_000
"""Bytes that the file of an answer may have."""


@dataclass(frozen=True)
class CommandSimulator:
    """A program that answers one design a run, each in a folder of its own, named after the design.

    The folder holds `design.json` with the values of the variables and the fixed quantities, and then what the program
    prints (`stdout.txt`, `stderr.txt`). In the command, which no shell sees, `{name}` stands for a value, `{out}` for
    the file that the program writes its answer to, a JSON object with "outcome" and perhaps "margins", and `{here}` for
    the folder of the campaign's own code.

    Attributes:
        space: of the designs.
        command: the program and its arguments.
        here: what `{here}` stands for; None if the program may not be run.
        work: where the folders are made.
        outcomes, margins: what it may answer.
        retries: how often it is run again where its exit code is not 0 or it leaves no answer.
        keep: whether the folders of the simulations that it answered are kept.
        largest_file: that it may write [bytes]; one that writes more is ended.
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

    causes = ("",)
    releases_gil = False
    isolated = True

    def __post_init__(self) -> None:
        quantities = (*self.space.names, *self.space.fixed)
        for name in ("out", "here"):
            if name in quantities:
                raise InputError(f"space.{name}: `{{{name}}}` has another meaning in simulator.command; rename it.")
        known = dict.fromkeys(quantities, 1.0) | {"out": "out", "here": "here"}
        try:
            parts = shlex.split(self.command)
            fields = [asked for part in parts for asked in string.Formatter().parse(part) if asked[1] is not None]
            asked = [field for _, field, _, _ in fields]
            for _, field, form, _ in fields:
                if "{" in (form or ""):
                    raise ValueError(f"a format holds no braces, as that of {{{field}}} does")
                if any(len(digits.lstrip("0")) > 3 or int(digits) > LONGEST_NUMBER for digits in _digits(form or "")):
                    raise ValueError(
                        f"a format has a width and a precision of at most {LONGEST_NUMBER}, unlike that of {{{field}}}"
                    )
                if field not in known:
                    raise ValueError(f"{{{field}}} is none of {', '.join(f'{{{name}}}' for name in known)}")
            if "out" not in asked:
                raise ValueError("the program must be told where to write its answer, by {out}")
            for part in parts:
                part.format_map(known)
        except ValueError as error:
            raise InputError(f"simulator.command: {error}; got {self.command!r}.") from None

    def arguments(self, design: Mapping[str, float], out: Path) -> list[str]:
        """The program and its arguments for a design."""
        # Enough digits that the program reads the very same number.
        values = {name: _Number(value) for name, value in design.items()} | {"out": str(out), "here": str(self.here)}
        return [part.format_map(values) for part in shlex.split(self.command)]

    def run(self, X: Array) -> Results:
        """Answer designs, (n, d), one after the other.

        Raises:
            InputError: if the program may not be run.
            OSError: if the program cannot be started, or its folder not be written.
            RuntimeError: if its exit code is not 0.
            UnusableAnswerError: if it leaves no answer.
        """
        if self.here is None:
            raise InputError(
                f"simulator.command: {self.command!r} is a program that the campaign names. A run folder may come from "
                f"someone else, so that such programs are run only where the folder of their files is named: "
                f"--code FOLDER."
            )
        answers = []
        for row, design in zip(np.asarray(X), designs_by_name(self.space, X), strict=True):
            folder = self.work / hashlib.sha256(row.tobytes()).hexdigest()[:16]
            for again in reversed(range(1 + self.retries)):
                try:
                    answers.append(self._run_once(design, folder))
                    break
                except (RuntimeError, UnusableAnswerError):
                    if not again:
                        raise
            if not self.keep:
                shutil.rmtree(folder, ignore_errors=True)
        return Results.concatenate(answers)

    def _run_once(self, design: Mapping[str, float], folder: Path) -> Results:
        # What an earlier try has left there would be taken for an answer.
        shutil.rmtree(folder, ignore_errors=True)
        if not self.work.is_dir():
            make_folder(self.work)
        folder.mkdir()
        (folder / "design.json").write_text(json.dumps(design, indent=1) + "\n")
        out = folder / "answer.json"
        began = time.perf_counter()
        with (folder / "stdout.txt").open("wb") as stdout, (folder / "stderr.txt").open("wb") as stderr:
            # The worker's supervisor ends it with the worker.
            with _largest_file(self.largest_file):
                program = subprocess.Popen(
                    self.arguments(design, out), cwd=folder, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr
                )
            code = program.wait()
        seconds = time.perf_counter() - began
        if code == -signal.SIGXFSZ:
            raise RuntimeError(f"a file in {folder} would exceed simulator.largest_file, {self.largest_file} bytes")
        if code != 0:
            # A character of UTF-8 has four bytes at most.
            end = end_of(folder / "stderr.txt", 4 * LONGEST_EXCERPT).decode(errors="replace").strip()
            how = f"exit code {code}" + (f" ({signal_name(-code)})" if code < 0 else "")
            raise RuntimeError(f"{how}; {folder}{os.sep}stderr.txt ends: {end[-LONGEST_EXCERPT:]!r}")
        try:
            # The program's own link, as to a file of its results, is followed.
            written = read_regular(out, LARGEST_ANSWER, follow=True)
        except FileNotFoundError:
            raise UnusableAnswerError(f"the program has not written {out}") from None
        except ValueError as unfit:
            raise UnusableAnswerError(f"{out} {unfit}") from None
        try:
            said = json.loads(written)
        except (ValueError, RecursionError) as malformed:
            raise UnusableAnswerError(f"{out} is not JSON: {malformed}") from None
        return read_answer(said, self.outcomes, self.margins, seconds)


@contextmanager
def _largest_file(size: int) -> Iterator[None]:
    """Processes that are started within can write no larger files [bytes]; this one can again afterwards."""
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    lower = size if before == resource.RLIM_INFINITY else min(size, before)
    resource.setrlimit(resource.RLIMIT_FSIZE, (lower, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))


def _digits(form: str) -> list[str]:
    """The numbers in a format: its width and its precision, and perhaps a digit that it fills with."""
    return re.findall(r"\d+", form)  # of any script, as Python reads them


class _Number(float):
    """A number that is written with all its digits where no other format is asked for."""

    def __format__(self, form: str) -> str:
        return format(float(self), form) if form else repr(float(self))
