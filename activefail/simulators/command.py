"""Custom simulators that are programs, run once for each design."""

import hashlib
import itertools
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activefail.errors import InputError, reason_of, signal_name
from activefail.simulators.code_folder import files_of, sha256, sources_of
from activefail.simulators.interface import Results, UnusableAnswerError
from activefail.simulators.placeholders import (
    PATHS,
    arguments,
    check_command,
    check_file,
    filled_file,
    named_in,
    words_of,
)
from activefail.simulators.returned import designs_by_name, objects_in, read_answer, read_objects
from activefail.simulators.user_code import COMMAND_KEY, not_permitted
from activefail.space.expressions import Expression
from activefail.space.parameter import exact
from activefail.space.space import Array, DesignSpace
from activefail.text.files import end_of, make_folder
from activefail.text.numerals import number_of_program
from activefail.text.trust import read_regular

LONGEST_EXCERPT = 300
"""Characters of a program's `stderr.txt` that a message quotes."""


LARGEST_ANSWER = 1_000_000
"""Most bytes in an answer's file."""

_LARGEST_OUTPUT = 100_000_000
"""Most bytes in a file that a pattern is searched in."""

_CUT_BEFORE = re.compile(r"(?:\d|\.|\d[eEdD][+-]?|(?<![\w-])[-−]|[=:]\s*[-−]\s*)\Z")
_CUT_AFTER = re.compile(r"\d|[.,]\d|#|[eEdD]?[+-]?\d|[-−](?!\w)|\s*[*x×·]\s*10\s*(?:\^|\*\*)")
"""What is before and after a match that is only a part of a number."""

_OWN_FILES = ("design.json", "stdout.txt", "stderr.txt", "answer.json")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class CommandSimulator:
    """A program that simulates one design per run, in a folder named after the design.

    The folder contains `design.json`, with the values of the variables and the fixed quantities, and the program's
    output (`stdout.txt`, `stderr.txt`). The command runs without a shell. In it, `{name}` is replaced by a value,
    `{here}` by the folder of the user's code, and `{out}` by the file to which the program writes its answer: a JSON
    object with "outcome" and, optionally, "margins" and "cause", or with the outputs in `expressions`. The environment
    has the same: AF_HERE, AF_OUT, and AF_<name>.

    The value of a variable with a set of records, such as `record`, is the path of a text file in the folder, with an
    acceleration [m/s²] in each line; `record_dt` is its interval [s], and `record_name` the name of the record.

    Attributes:
        space: design space.
        command: the program and its arguments.
        here: the value of `{here}`; None if the program may not be run.
        work: parent of the designs' folders.
        outcomes, margins, causes: the names that an answer may contain; the first cause is none.
        retries: how often the program is run again if its exit code is not 0 or its answer is unusable.
        keep: whether to keep the folders of successful simulations.
        largest_file: largest file that the program may write [bytes]; a program that exceeds it is killed.
        levels, system, truncated, expressions: of the margins (see `read_answer`); the outputs follow the margins.
        templates: input files, filled in and written to the folder under their names without `.in`.
        copies: files and folders that are copied to the folder. Both are relative to `here`.
        pattern: regular expression with one group, whose last match in `output` is the answer, or one by output; None
            reads `{out}`.
        output: a file in the folder.
        cores: of one simulation.
        repeatable: whether a design has one folder; otherwise another run has its own, with a number.
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
    system: Callable[[Array], Array] | None = None
    truncated: tuple[str, ...] = ()
    expressions: Mapping[str, Expression] | None = None
    failing: tuple[int, ...] = ()
    impossible: tuple[int, ...] = ()
    causes: tuple[str, ...] = ("",)
    templates: tuple[str, ...] = ()
    copies: tuple[str, ...] = ()
    pattern: str | Mapping[str, str] | None = None
    output: str = "stdout.txt"
    cores: int = 1
    repeatable: bool = True

    releases_gil = False
    isolated = True

    def __post_init__(self) -> None:
        quantities = self._example
        records = [f"{one.name}.txt" for one in self.space.parameters if one.payload is not None]
        for name in quantities:
            if name.lower() in PATHS:
                raise InputError(f"space.{name}: `{{{name}}}` is reserved in simulator.command; rename the variable.")
        check_command(self.command, quantities)
        names = [
            *_OWN_FILES,
            *records,
            *(_target(file) for file in self.templates),
            *(Path(file).name for file in self.copies),
        ]
        for name in names:
            if names.count(name) > 1 or not name:
                raise InputError(f"simulator.template, simulator.copy: a run's folder can have only one {name!r}.")
        if self.pattern is not None and self.output in names[len(_OWN_FILES) :]:
            raise InputError(f"simulator.output: must be a file that the program writes, got {self.output!r}.")
        if Path(self.output).is_absolute() or ".." in Path(self.output).parts:
            raise InputError(f"simulator.output: must be a file in the folder of the run, got {self.output!r}.")
        if self.here is not None:
            _ = self.filled
            for file in self.copies:
                source = self.here / file
                if not source.exists():
                    raise InputError(f"simulator.copy: {source} does not exist.")
                if self.work.resolve().is_relative_to(source.resolve()):
                    raise InputError(f"simulator.copy: {source} must not hold the run folder.")

    @property
    def _example(self) -> dict[str, Any]:
        """The quantities of a design, with examples of their values."""
        design = designs_by_name(self.space, self.space.low[None])[0]
        for one in self.space.parameters:
            if one.payload is not None:
                for name, example in {f"{one.name}_dt": 0.01, f"{one.name}_name": design[one.name]}.items():
                    if name in design:
                        raise InputError(f"space.{name}: tells a program of the variable {one.name}; rename it.")
                    design[name] = example
        return design

    def digest(self) -> str:
        """Of the files in `here` that decide results: templates, copies, and what the command names.

        These are files, folders with a slash in `here`, and modules, with what they import from their folder or `here`,
        and files in `here` that other files name, such as a shell's script.
        """
        here, words = self.here, words_of(self.command)
        assert here is not None
        inside = {word for word in words if "/" in word and here.resolve() in (here / word).resolve().parents}
        named = inside | {word for word in words if os.path.isfile(here / word)}
        paths = [here / name for name in (*self.templates, *self.copies, *named) if not os.path.isabs(name)]
        files = [file for path in paths for file in ([path] if os.path.isfile(path) else path.rglob("*"))]
        digests: dict[Path, str] = {}
        for file in filter(Path.is_file, files):  # the list grows
            if file.suffix == ".py":
                digests |= sources_of(file, file.parent)
            elif file not in digests:
                content = file.read_bytes()
                digests[file] = sha256(content)
                files += named_in(content[:LARGEST_ANSWER].decode(errors="replace"), here)
        for file in files_of([name for word in words for name in (word, f"{word}.__main__")], here):
            digests |= sources_of(file, here)
        lines = [f"{os.path.relpath(file, self.here)} {digest}\n" for file, digest in sorted(digests.items())]
        return sha256("".join(lines).encode())

    @property
    def filled(self) -> dict[str, list[str]]:
        """The quantities that each template asks for.

        Raises:
            InputError: if a template cannot be read, or asks for no quantity or an unknown one.
        """
        quantities = self._example
        asked = {}
        for file in self.templates:
            try:
                asked[file] = check_file(self._template(file), quantities)
            except (OSError, ValueError) as error:
                reason = f"cannot be read: {reason_of(error)}" if isinstance(error, OSError) else str(error)
                raise InputError(f"simulator.template: {file}: {reason}.") from None
        return asked

    @property
    def unnamed(self) -> list[str]:
        """The variables that neither the command nor a template names, although it names others or there is one."""
        named = {*itertools.chain(*self.filled.values()), *re.findall(r"(?:\{|AF_)(\w+)", self.command)}
        # A scaled record has its level in it.
        named |= {one.payload.level for one in self.space.parameters if one.payload and one.name in named}
        names = self.space.names
        return [name for name in names if name not in named] if self.templates or named & {*names} else []

    def _template(self, file: str) -> str:
        assert self.here is not None
        # Other encodings than UTF-8 stay what they are.
        return (self.here / file).read_bytes().decode(errors="surrogateescape")

    def folder_of(self, x: Array) -> Path:
        """The folder of a design, (d,)."""
        return self.work / hashlib.sha256(np.asarray(x, dtype=np.float64).tobytes()).hexdigest()[:16]

    def check_permitted(self) -> None:
        """Check that the program may be run."""
        if self.here is None:
            raise not_permitted(COMMAND_KEY, repr(self.command))

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d), one after the other.

        Raises:
            OSError: if the program cannot be started or its folder cannot be written.
            RuntimeError: if its exit code is not 0.
            UnusableAnswerError: if its answer is missing or breaks a rule.
        """
        self.check_permitted()
        read_objects(self.space)
        answers = []
        for row, design in zip(np.asarray(X), designs_by_name(self.space, X), strict=True):
            for retries_left in reversed(range(1 + self.retries)):
                try:
                    folder = self._new_folder(row)
                    answers.append(self._run_once(design, folder))
                    break
                except (RuntimeError, UnusableAnswerError):
                    if not retries_left:
                        raise
            if not self.keep:
                shutil.rmtree(folder, ignore_errors=True)
        return Results.concatenate(answers)

    def _new_folder(self, x: Array) -> Path:
        """An empty folder for a run of a design, (d,)."""
        first = self.folder_of(x)
        if self.repeatable:
            # An answer left by an earlier attempt must not be read.
            shutil.rmtree(first, ignore_errors=True)
        if not self.work.is_dir():
            make_folder(self.work)
        numbered = (first.with_name(f"{first.name}-{number}") for number in itertools.count(2))
        for folder in itertools.chain([first], numbered):
            with suppress(FileExistsError):
                folder.mkdir()
                break
        return folder

    def _run_once(self, design: Mapping[str, Any], folder: Path) -> Results:
        for name, record in objects_in(self.space, design).items():
            file, motion = folder / f"{name}.txt", record.motion
            file.write_text("".join(f"{a!r}\n" for a in motion.acceleration.tolist()))
            design = {**design, name: str(file), f"{name}_dt": motion.dt, f"{name}_name": record.name}
        (folder / "design.json").write_text(json.dumps(design, indent=1) + "\n")
        self._prepare(design, folder)
        assert self.here is not None
        out = folder / "answer.json"
        paths = {"here": self.here, "out": out}
        environment = os.environ | {f"AF_{name}": exact(value) for name, value in design.items()}
        environment |= {PATHS[name]: str(path) for name, path in paths.items()}
        environment |= dict.fromkeys(_THREADS, str(self.cores))
        began = time.perf_counter()
        with (folder / "stdout.txt").open("wb") as stdout, (folder / "stderr.txt").open("wb") as stderr:
            # The worker's supervisor kills it along with the worker.
            with _largest_file(self.largest_file):
                program = subprocess.Popen(
                    arguments(self.command, design, paths),
                    cwd=folder,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=stdout,
                    stderr=stderr,
                )
            code = program.wait()
        seconds = time.perf_counter() - began
        if code == -signal.SIGXFSZ:
            raise RuntimeError(
                f"the program exceeded simulator.largest_file ({self.largest_file} bytes) with a file in its folder"
            )
        # A UTF-8 character has at most four bytes.
        lines = end_of(folder / "stderr.txt", 4 * LONGEST_EXCERPT).decode(errors="replace").strip().splitlines()
        said = f"; stderr.txt ends with {lines[-1][-LONGEST_EXCERPT:]!r}" if lines else "; stderr.txt is empty"
        if code != 0:
            raise RuntimeError(f"exit code {code}{f' ({signal_name(-code)})' if code < 0 else ''}{said}")
        try:
            answer = self._answer(folder, out)
        except UnusableAnswerError as error:
            raise UnusableAnswerError(f"{error}{said}") from None
        names = self.outcomes, self.margins, self.levels
        return read_answer(answer, *names, seconds, self.system, self.causes, self.truncated, self.expressions)

    def _answer(self, folder: Path, out: Path) -> object:
        """What the program wrote.

        Raises:
            UnusableAnswerError: if it is no answer.
        """
        if isinstance(self.pattern, str):
            return _matched(self.pattern, folder / self.output)
        if self.pattern is not None:
            return {name: _matched(pattern, folder / self.output) for name, pattern in self.pattern.items()}
        # The program may link to a file of its results.
        written = _read(out, LARGEST_ANSWER, "; its path is {out} in the command, or $AF_OUT in the environment")
        try:
            return json.loads(written)
        except (ValueError, RecursionError) as error:
            raise UnusableAnswerError(f"{out.name} is not JSON: {error}") from None

    def _prepare(self, design: Mapping[str, Any], folder: Path) -> None:
        """Write the templates with a design's values, and copy files, to its folder."""
        assert self.here is not None
        for file in self.templates:
            text = filled_file(self._template(file), design)
            (folder / _target(file)).write_bytes(text.encode(errors="surrogateescape"))
        for file in self.copies:
            source = self.here / file
            (shutil.copytree if source.is_dir() else shutil.copy2)(source, folder / source.name)
        if self.output not in _OWN_FILES:
            # A copied file is no answer.
            (folder / self.output).unlink(missing_ok=True)


def _target(template: str) -> str:
    """The name of a filled template."""
    return Path(template).name.removesuffix(".in")


def _read(path: Path, most: int, advice: str = "") -> bytes:
    """A file that a program wrote.

    Raises:
        UnusableAnswerError: if it is missing, no regular file or too large.
    """
    try:
        return read_regular(path, most, follow=True)
    except FileNotFoundError:
        raise UnusableAnswerError(f"the program did not write {path.name}{advice}") from None
    except ValueError as error:
        raise UnusableAnswerError(f"{path.name} {error}") from None


def _matched(pattern: str, path: Path) -> float:
    """The number in the last match of a pattern in a file.

    Raises:
        UnusableAnswerError: if there is none.
    """
    text = _read(path, _LARGEST_OUTPUT).decode(errors="replace").replace("\r\n", "\n")
    *_, found = None, *re.finditer(pattern, text, re.MULTILINE)
    if found is None:
        raise UnusableAnswerError(f"{path.name} has no match of simulator.pattern, {pattern!r}")
    if found[1] and (_CUT_BEFORE.search(text, 0, found.start(1)) or _CUT_AFTER.match(text, found.end(1))):
        around = text[max(0, found.start(1) - 10) : found.end(1) + 10]
        raise UnusableAnswerError(f"simulator.pattern: must match whole numbers, got {found[1]!r} of {around!r}")
    try:
        return number_of_program(found[1] or "")
    except ValueError:
        raise UnusableAnswerError(f"simulator.pattern: must match a number, got {found[1]!r} in {path.name}") from None


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
