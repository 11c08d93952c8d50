"""Simulators of one's own: a function of Python, or a program that is run once for each design."""

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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from activefail.errors import ActivefailError, InputError
from activefail.files import end_of, read_regular
from activefail.record.hdf5 import make_folder
from activefail.simulators.interface import Results, UnusableAnswerError
from activefail.simulators.user_code import SIMULATOR_KEY, load_function, look_beside
from activefail.space import Array, DesignSpace

_TOLD = 300
"""Characters of a program's last words that a message repeats."""

LONGEST_NUMBER = 100
"""Largest width and precision of a format in a command: memory and time grow with both."""

LARGEST_ANSWER = 1_000_000
"""Bytes that the file of an answer may have."""


@dataclass(frozen=True)
class PythonSimulator:
    """A function that answers one design, and runs in processes of its own.

    It is given a dictionary with the values of the variables and the fixed quantities, and returns the name of the
    outcome, or a dictionary with "outcome" and, where there are any, "margins", a dictionary of numbers. What it raises
    costs that simulation alone.

    Attributes:
        space: of the designs.
        reference: of the function, "module:function".
        code: folder of its module and of those that it imports; None if it may not be run.
        outcomes, margins: what it may answer.
        source: digest that its module must have, also on another machine; "" if any will do (see `load_function`).
        folder: of the run, in which no code is looked for.
        renew: simulations that one process may run; any number if None.
    """

    space: DesignSpace
    reference: str
    code: Path | None
    outcomes: tuple[str, ...]
    margins: tuple[str, ...]
    source: str = ""
    folder: Path | None = None
    renew: int | None = None

    causes = ("",)
    releases_gil = False

    def load(self) -> str:
        """The digest of the source of the function's module, once it is imported.

        Raises:
            InputError: if there is no such function, or it may not be run.
        """
        return load_function(self.reference, self.code, SIMULATOR_KEY, self.folder)[1]

    def prepare(self) -> None:
        """Import the function's module, which is no part of a simulation's time.

        Raises:
            InputError: as `load` does.
        """
        _loaded(self.reference, self.code, self.source, self.folder)
        if self.code is not None:
            # What it imports as it runs; another one's may have been looked for since.
            look_beside(self.code)

    def run(self, X: Array) -> Results:
        """Answer designs, (n, d), one after the other.

        Raises:
            InputError: as `load` does.
            UnusableAnswerError: if what it returns is no answer.
        """
        function = _loaded(self.reference, self.code, self.source, self.folder)
        answers = []
        for design in designs_by_name(self.space, X):
            began = time.perf_counter()
            try:
                said = function(design)
            except ActivefailError as error:
                # Raised in the user's code, it is no error of ours and costs this simulation alone.
                raise RuntimeError(f"{type(error).__name__}: {error}").with_traceback(error.__traceback__) from None
            answers.append(_read_answer(said, self.outcomes, self.margins, time.perf_counter() - began))
        return Results.concatenate(answers)


@cache
def _loaded(
    reference: str, code: Path | None, source: str, folder: Path | None
) -> Callable[[dict[str, float]], object]:
    """The function, imported once in a process for each source that it has had."""
    function, found = load_function(reference, code, SIMULATOR_KEY, folder)
    if source and found != source:
        raise InputError(
            f"{SIMULATOR_KEY}: the module of {reference}, or one that it imports from its folder, is another one here "
            f"than where the campaign was started."
        )
    return function


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
            # Of UTF-8, where a character has four bytes at the most.
            last = end_of(folder / "stderr.txt", 4 * _TOLD).decode(errors="replace").strip()[-_TOLD:]
            raise RuntimeError(f"exit code {code}; {folder}{os.sep}stderr.txt ends: {last!r}")
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
        return _read_answer(said, self.outcomes, self.margins, seconds)


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


def designs_by_name(space: DesignSpace, X: Array) -> list[dict[str, float]]:
    """Designs, (n, d), as a dictionary each: variables and fixed quantities."""
    return [{**dict(zip(space.names, row, strict=True)), **space.fixed} for row in np.asarray(X).tolist()]


def _read_answer(said: object, outcomes: tuple[str, ...], margins: tuple[str, ...], seconds: float) -> Results:
    """What a simulator of one's own said of one design, as a record holds it."""
    if isinstance(said, str):
        said = {"outcome": said}
    if not isinstance(said, Mapping):
        raise UnusableAnswerError(f"the answer must be an outcome or a table with one, got {said!r}")
    unknown = set(said) - {"outcome", "margins"}
    if unknown:
        raise UnusableAnswerError(f"the answer may hold outcome and margins, got {sorted(map(str, unknown))[0]!r} too")
    outcome, told = said.get("outcome"), said.get("margins", {})
    if outcome not in outcomes:
        raise UnusableAnswerError(f"outcome: must be one of {', '.join(outcomes)}, got {outcome!r}")
    if not isinstance(told, Mapping):
        raise UnusableAnswerError(f"margins: must be a table of {', '.join(margins) or 'nothing'}, got {told!r}")
    for name in told:
        if name not in margins:
            raise UnusableAnswerError(
                f"margins: {name!r} is not declared in simulator.margins, which names {', '.join(margins) or 'none'}"
            )
    values = [told.get(name, np.nan) for name in margins]
    for name, value in zip(margins, values, strict=True):
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise UnusableAnswerError(f"margins.{name}: must be a number, got {value!r}")
    return Results(
        np.array([outcomes.index(outcome)], dtype=np.int8),
        np.zeros(1, dtype=np.int8),
        np.array([values], dtype=np.float64).reshape(1, len(margins)),
        np.array([seconds]),
    )
