"""Killed, or refused by the system, at every system call: what was acknowledged stays, and the campaign is the same."""

import errno
import os
import re
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from faults.harness import Course, Victim, Victims, few, finished, traced
from faults.victim import BUDGET, COMMITS, Inline, campaign, opened

from activefail.loop.progress import Observer
from activefail.loop.running import run
from activefail.record.layout import QUARANTINE
from activefail.record.run_folder import FolderStore
from activefail.text.files import TEMPORARY

Call = tuple[str, int]
"""A system call and how often it was made before, since the tracer was there."""


def begun(folder: Path, commits: int) -> Path:
    """The run folder of the victims' campaign after some commits."""
    with opened(folder) as store:
        run(campaign(), store, Inline(), BUDGET, Observer(stop=lambda: len(store.batches) >= commits))
    return folder


def crashed(folder: Path) -> Path:
    """A run folder in which opening has all there is to tidy up: an entry that was cut, and leftovers."""
    begun(folder, COMMITS - 1)
    path = folder / "journal"
    path.write_bytes(path.read_bytes()[:-1])
    (folder / f"{TEMPORARY}{0:016x}").write_text("half")
    return folder


# Where the work begins, and at which place of it the system calls are tried.
WINDOWS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "creation": (lambda folder: folder, "creation 1"),
    "set": (lambda folder: folder, "set 1"),
    "commit": (lambda folder: begun(folder, COMMITS - 1), "commit 1"),
    "state": (lambda folder: begun(folder, COMMITS - 1), "state 1"),
    "closing": (lambda folder: begun(folder, COMMITS - 1), "closing 1"),
    "opening": (crashed, "opening 1"),
}


@pytest.fixture(params=WINDOWS)
def window(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str]:
    """A run folder, to be copied, and the place of the work."""
    make, place = WINDOWS[request.param]
    return make(tmp_path / "base"), place


def calls_of(victims: Victims, window: tuple[Path, str], folder: Path, fault: str | None = None) -> list[Call]:
    """The system calls between the beginning and the end of a place of the work."""
    base, place = window
    _copied(base, folder / "traced")
    victim = victims.start(folder / "traced", place, fault=fault)
    with traced(victim.pid, "-o", str(folder / "trace")):
        victim.go_on()
        assert victim.end() == 0, victim.reports
    return _between((folder / "trace").read_text().splitlines(), place.split()[0])


def _copied(base: Path, folder: Path) -> Path:
    if base.exists():
        shutil.copytree(base, folder)
    return folder


# How often threads wait for each other is up to the scheduler, and how often memory is taken and returned depends on
# addresses and threads, so that a number does not name one of these calls. They change no file: a kill at one of them
# is a kill between the calls beside it.
UNCOUNTED = ("futex", "sched_yield", "brk", "madvise", "mmap", "mprotect", "munmap")


def _between(trace: list[str], name: str) -> list[Call]:
    calls, made, within = [], Counter[str](), False
    for line in trace:
        called = re.match(r"(\w+)\(", line)
        if called is None:
            continue
        if f"/-/{name}/" in line:
            if within:
                return calls
            within = True
        elif within and "/-/" not in line and called[1] not in UNCOUNTED:
            calls.append((called[1], made[called[1]] + 1))
        made[called[1]] += 1
    pytest.fail(f"{name} has no end in the trace")


def assert_nothing_lost(victim: Victim, folder: Path, uninterrupted: Course, alone: bool = True) -> None:
    """Assert that all acknowledged data exists, and that the campaign continues as if nothing had happened.

    Args:
        alone: whether there was no second writer on a file system without locks. Two write over each other's states,
            which can be learned again, and leave entries that do not count.
    """
    reports = victim.acknowledged
    if reports:
        with FolderStore.open(folder, write=False) as store:
            acknowledged = [line.split()[1:] for line in reports if line.startswith("commit")]
            for number, digest in acknowledged:
                assert digest_after(store, int(number)) == digest
            state = store.latest_state()
            iterations = [int(line.split()[1]) for line in reports if line.startswith("state")]
            if iterations and alone:
                assert state is not None
                assert state[0] >= max(iterations)
            for line in reports:
                if line.startswith("set"):
                    assert store.read_set(line.split()[1]) is not None
    assert finished(folder) == uninterrupted
    with opened(folder) as store:
        assert store.warnings == ()
    names = [path.name for path in folder.rglob("*")]
    assert not [name for name in names if name.startswith(TEMPORARY)]
    if alone and "full" not in folder.name:
        # An entry is one write, so that a kill leaves the whole of it or nothing; what was cut before is set aside.
        assert (QUARANTINE in names) == ("opening" in folder.name)


def digest_after(store: FolderStore, batches: int) -> str:
    """The digest of a record when it had so many batches."""
    path = Path(tempfile.mkdtemp()) / "run"
    with FolderStore.create(path, store.settings, store.schema) as first:
        for batch in store.batches[:batches]:
            first.commit(batch)
        digest = first.digest
    shutil.rmtree(path.parent)
    return digest


@pytest.mark.usefixtures("strace")
def test_killed_at_any_system_call_it_loses_nothing_and_goes_on_to_the_same_campaign(
    window: tuple[Path, str],
    victims: Victims,
    uninterrupted: Course,
    tmp_path: Path,
    every_fault: bool,
    survived: Callable[[], None],
) -> None:
    base, place = window
    calls = calls_of(victims, window, tmp_path)
    assert len(calls) > 5
    for name, number in few(calls, every_fault, 4):
        folder = tmp_path / f"{place.split()[0]}-{name}-{number}"
        # Now and then Python looks through its folders for modules, so that the call of this number is another one.
        for _ in range(3):
            shutil.rmtree(folder, ignore_errors=True)
            _copied(base, folder)
            victim = victims.start(folder, place)
            trace = tmp_path / "killed"
            inject = f"inject={name}:signal=SIGKILL:when={number}"
            with traced(victim.pid, "-e", f"trace={name},access", "-e", inject, "-o", str(trace)):
                victim.go_on()
                assert victim.end() == -signal.SIGKILL
            marks = [line for line in trace.read_text().splitlines() if f"/-/{place.split()[0]}/" in line]
            if len(marks) == 1:
                break
        assert len(marks) == 1, f"killed elsewhere, at call {number} of {name}"
        assert_nothing_lost(victim, folder, uninterrupted)
        shutil.rmtree(folder)
        survived()


# What the system may answer in place of doing it.
REFUSALS = {
    "openat": ("EIO", "EMFILE", "EACCES"),
    "write": ("EIO", "ENOSPC", "EDQUOT", "EFBIG"),
    "fsync": ("EIO", "ENOSPC"),
    "newfstatat": ("EIO",),
    "fstat": ("EIO",),
    "close": ("EIO",),
    "ftruncate": ("EIO",),
    "unlink": ("EIO", "EROFS"),
    "rename": ("EIO", "ENOSPC"),
    "mkdir": ("ENOSPC", "EROFS"),
    "read": ("EIO",),
    "getdents64": ("EIO",),
    "flock": ("EIO", "ENOLCK"),
}


@pytest.mark.usefixtures("strace")
def test_refused_any_system_call_it_stops_with_the_reason_or_goes_on_and_loses_nothing(
    window: tuple[Path, str],
    victims: Victims,
    uninterrupted: Course,
    tmp_path: Path,
    every_fault: bool,
    survived: Callable[[], None],
) -> None:
    base, place = window
    calls = calls_of(victims, window, tmp_path)
    faults = [(name, number, error) for name, number in calls for error in REFUSALS.get(name, ())]
    assert len(faults) > 5
    for name, number, error in few(faults, every_fault, 4):
        folder = _copied(base, tmp_path / f"{place.split()[0]}-{name}-{number}-{error}")
        victim = victims.start(folder, place)
        trace = tmp_path / "refused"
        inject = f"inject={name}:error={error}:when={number}"
        with traced(victim.pid, "-e", f"trace={name},access,write,fsync,rename", "-e", inject, "-o", str(trace)):
            victim.go_on()
            code = victim.end()
        lines = trace.read_text().splitlines()
        (at,) = [index for index, line in enumerate(lines) if "(INJECTED)" in line]
        # One message that names a file of the folder and the reason, or nothing to tell: never a traceback.
        assert code in (0, 1), (name, number, error, victim.reports)
        if code == 1:
            # The entry of a new folder is made durable in the one above it, and that one's too.
            assert str(folder.parents[1] if place == "creation 1" else folder) in victim.reports[-1], victim.reports[-1]
            assert os.strerror(getattr(errno, error)) in victim.reports[-1], victim.reports[-1]
        if name == "fsync":
            # The kernel may have dropped the pages: a second fsync would succeed without them (Rebello et al. 2020).
            # The checkpoint that closing writes can be made again.
            assert code == 1 or place == "closing 1"
            assert code == 0 or "(fsync)" in victim.reports[-1]
            after = [line for line in lines[at + 1 :] if re.match(r"(fsync|rename)\(|write\(\d+, \"activefail", line)]
            assert after == []
        assert_nothing_lost(victim, folder, uninterrupted)
        shutil.rmtree(folder)
        survived()
