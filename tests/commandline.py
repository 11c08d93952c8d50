"""Runs the program: in this process, or in a separate one."""

import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from unittest import mock

import held
import pytest
import typer
from patience import PATIENCE, until

from activefail.cli import app, main
from activefail.record.run_folder import FolderStore

TESTS = Path(__file__).parent

# As in a process of its own, the commands are built once: this takes longer than many of them.
_BUILT = typer.main.get_command(app)


@dataclass(frozen=True)
class CommandResult:
    code: int
    out: str
    err: str


def activefail(*words: str | Path) -> CommandResult:
    """The output of a command line, in this process; an exception that the program does not catch is a failure."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with (
        mock.patch.object(sys, "argv", ["activefail", *map(str, words)]),
        mock.patch.object(typer.main, "get_command", return_value=_BUILT),
        mock.patch.dict(os.environ, {"COLUMNS": "200", "TERMINAL_WIDTH": "200"}),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as left:
            code = left.code or 0
    assert isinstance(code, int)
    if "--json" in words and out.getvalue():
        _check_documented(str(words[0]), json.loads(out.getvalue()))
    return CommandResult(code, out.getvalue(), err.getvalue())


_BY_NAME = {
    "at_limit_of_range",
    "bearing",
    "all",
    "chosen",
    "given",
    "initial",
    "estimates",
    "fixed",
    "free",
    "length_scales",
}
_BY_NAME |= {"margins", "measures", "model", "outcomes", "p_values", "probability", "properties", "pulses", "recall"}
_BY_NAME |= {"modes", "record_factor", "statistics", "targets", "uncertainty", "values", "versions"}
"""Keys of JSON objects whose own keys are names of variables, outcomes and the like."""


def _check_documented(command: str, printed: dict[str, object]) -> None:
    """Assert that the page on JSON has every key that a command prints."""
    assert printed["version"] == (2 if command in ("design", "fragility") else 1)
    page = TESTS.parent / "docs" / "reference" / "json.md"
    whole = page.read_text(encoding="utf-8")

    def section(name: str) -> str:
        return whole.partition(f"\n## {name}\n")[2].partition("\n## ")[0]

    text = whole.partition("\n## ")[0] + section(command)
    text += "".join(map(section, re.findall(r"\(#([a-z]+)\)", text)))  # keys that it says are there

    def undocumented(value: object, by_name: bool = False) -> set[str]:
        if isinstance(value, list):
            return {key for one in value for key in undocumented(one)}
        if not isinstance(value, dict):
            return set()
        missing = set() if by_name else {key for key in value if f"`{key}`" not in text and f".{key}`" not in text}
        return missing.union(*(undocumented(one, key in _BY_NAME) for key, one in value.items()))

    del printed["version"]
    missing = undocumented(printed)
    assert not missing, f"{command} --json: {sorted(missing)}"


def refused(result: CommandResult, *parts: str, code: int = 2) -> None:
    """Assert that the program ended in one message on stderr with all these parts."""
    assert (result.code, result.out) == (code, "")
    assert result.err.startswith("activefail: ")
    assert "Traceback" not in result.err
    assert [part for part in parts if part not in result.err] == []


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file, strict=True))


def record(folder: Path) -> list[dict[str, str]]:
    """All that a campaign has recorded, as `export` writes it, without the wall times."""
    target = folder.with_suffix(".csv")
    assert activefail("export", folder, "--csv", target).code == 0
    return [{name: cell for name, cell in row.items() if name != "seconds"} for row in table(target)]


def sets(folder: Path) -> dict[str, list[int]]:
    """The outcomes in each set of a run folder."""
    with FolderStore.open(folder, write=False) as store:
        kept = {name: store.read_set(name) for name in store.set_names()}
    return {name: one[1].outcome.tolist() for name, one in kept.items() if one is not None}


@contextmanager
def started(
    *words: str | Path, module: str = "activefail.cli", environment: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """The program in a process of its own, which leads a group as a terminal's command does, ended with the block."""
    # A shell has its background jobs ignore Ctrl-C, and what they start would too.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(
            [sys.executable, "-u", "-m", module, *map(str, words)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            process_group=0,
            env=os.environ | (environment or {}),
        )
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def struck_as_by_a_terminal(process: subprocess.Popen[str], then: Callable[[], None] = lambda: None) -> str:
    """Send Ctrl-C to a process and all that it has started; its output then. None of them may be left."""
    os.killpg(process.pid, signal.SIGINT)
    then()
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert "Traceback" not in err

    def gone() -> bool:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return True
        return False

    until(gone, "the end of all that it had started")
    return err


@dataclass(frozen=True)
class Held:
    """The program in a process of its own, with one of its functions held (see `held`)."""

    process: subprocess.Popen[str]
    folder: Path

    def wait(self, number: int = 1) -> list[int]:
        """Wait until the function is held in so many calls; the processes that they are in."""

        def noted() -> list[int]:
            assert self.process.poll() is None, self.process.communicate()
            numbers = [int(name.partition("-")[0]) for name in os.listdir(self.folder) if name != held.OPEN]
            return numbers if len(numbers) >= number else []

        return until(noted, "the program to come to what is held")

    def release(self) -> None:
        """Let the function return, here and in all calls to come."""
        (self.folder / held.OPEN).touch()


@contextmanager
def holding(place: str, *words: str | Path, passing: int = 0) -> Iterator[Held]:
    """The program with a function held from its call after the first so many on."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.pathsep.join([str(TESTS), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {held.VARIABLE: json.dumps([place, folder, passing]), "PYTHONPATH": path}
        with started(*words, module="held", environment=environment) as process:
            yield Held(process, Path(folder))


def wait_for(lines: IO[str] | None, start: str) -> None:
    """Read lines of a program's pipe until one begins so."""
    assert lines is not None
    for line in lines:
        if line.startswith(start):
            return
    pytest.fail(f"the program ended before it said {start!r}")
