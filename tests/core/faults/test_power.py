"""Power loss: whatever a disk may keep of what was not synchronised, nothing acknowledged is lost.

The model is what POSIX promises and no more. The content of a file is as it was at its last fsync, or anything between
that and what was written since. Of the names that were made, moved and taken away in a folder since its last fsync, any
may be on the disk and any may not; folders have names too, and without that of a folder all in it is gone.
"""

import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from faults.harness import few

from activefail.record import journal as journal_module
from activefail.record import run_folder as store_module
from activefail.record.asked import Asked
from activefail.record.batch import ACTIVE, Batch, Schema
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results
from activefail.text import files

SCHEMA = Schema(("x", "y"), ("safe", "broken"), ("", "crack"), ("distance",))
SETTINGS = "seed = 1\n"
RUN = "runs/deep/run"
"""The run folder on the disk, which holds nothing before: two folders above it are made as well."""

BATCHES = 5
MOST_SUBSETS = 64


def batch(number: int) -> Batch:
    rng = np.random.default_rng(number)
    codes = rng.integers(0, 2, (3, 3)).astype(np.int8)
    ids = 3 * number + np.arange(3)
    return Batch(
        number, ids, rng.random((3, 2)), codes[0], Results(codes[1], codes[2], rng.random((3, 1)), np.zeros(3))
    )


@dataclass(frozen=True)
class File:
    """Content on the disk, and what was written since."""

    synced: bytes
    written: bytes

    def kept(self) -> Iterator[bytes]:
        """What may be found of it."""
        yield from {
            self.synced,
            self.written,
            self.written[: (len(self.synced) + len(self.written)) // 2],
            # Its length without its content, as file systems that delay allocation may leave it.
            self.synced + bytes(len(self.written) - len(self.synced)),
        }


@dataclass(frozen=True)
class Directory:
    """A folder: its name is all there is of it."""

    def kept(self) -> Iterator[None]:
        """It is found as it is."""
        yield None


Change = tuple[tuple[str, int | None], ...]
"""Names that come to stand for a file, or for none, in one step."""


@dataclass(frozen=True)
class Moment:
    """What is on the disk, what is being written, and what the program has been told."""

    names: Mapping[str, int]
    pending: tuple[Change, ...]
    files: Mapping[int, File | Directory]
    reports: tuple[str, ...]

    def after_power_loss(self) -> Iterator[dict[str, bytes | None]]:
        """Contents by name that may be found, None for a folder."""
        for kept in self._subsets():
            names = dict(self.names)
            for change in kept:
                for name, number in change:
                    if number is None:
                        names.pop(name, None)
                    else:
                        names[name] = number
            names = {name: number for name, number in names.items() if _above(name) <= names.keys()}
            numbers = sorted(set(names.values()))
            for contents in itertools.product(*(list(self.files[number].kept()) for number in numbers)):
                stored = dict(zip(numbers, contents, strict=True))
                yield {name: stored[number] for name, number in names.items()}

    def _subsets(self) -> Iterator[tuple[Change, ...]]:
        n = len(self.pending)
        if 2**n <= MOST_SUBSETS:
            chosen = itertools.product((False, True), repeat=n)
        else:
            # All that are in order, all that lack one, and others at random.
            rng = np.random.default_rng(n)
            ordered = [tuple(i < k for i in range(n)) for k in range(n + 1)]
            lacking = [tuple(i != k for i in range(n)) for k in range(n)]
            chosen = iter([*ordered, *lacking, *(tuple(row) for row in rng.random((MOST_SUBSETS, n)) < 0.5)])
        for mask in chosen:
            yield tuple(itertools.compress(self.pending, mask))


def _above(name: str) -> set[str]:
    """The names of the folders that a path leads through."""
    return {str(folder) for folder in Path(name).parents} - {"."}


class Disk:
    """The module `os` as the record sees it, which notes at each call what a loss of power would leave."""

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)
        self.names: dict[str, int] = {}
        self.pending: list[Change] = []
        self.files: dict[int, File | Directory] = {}
        self.reports: list[str] = []
        self.open_files: dict[int, int] = {}
        self.open_folders: dict[int, str] = {}
        self.moments: list[Moment] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def note(self) -> None:
        self.moments.append(Moment(dict(self.names), tuple(self.pending), dict(self.files), tuple(self.reports)))

    def _change(self, *change: tuple[Any, int | None]) -> None:
        self.pending.append(tuple((os.path.relpath(path, self.folder), number) for path, number in change))
        self.note()

    def _number(self, path: Any) -> int:
        """Which file a name stands for, as the running system sees it."""
        name, stored = os.path.relpath(path, self.folder), None
        for known, number in [*self.names.items(), *itertools.chain(*self.pending)]:
            stored = number if known == name else stored
        assert stored is not None, name
        return stored

    def _file(self, number: int) -> File:
        file = self.files[number]
        assert isinstance(file, File)
        return file

    def mkdir(self, path: Any) -> None:
        os.mkdir(path)
        number = len(self.files)
        self.files[number] = Directory()
        self._change((path, number))

    def open(self, path: Any, flags: int, mode: int = 0o777) -> int:
        descriptor = os.open(path, flags, mode)
        if flags & os.O_DIRECTORY:
            self.open_folders[descriptor] = os.path.relpath(path, self.folder)
        elif flags & os.O_CREAT:
            number = len(self.files)
            self.files[number] = File(b"", b"")
            self.open_files[descriptor] = number
            self._change((path, number))
        elif flags & os.O_APPEND:
            self.open_files[descriptor] = self._number(path)
        return descriptor

    def write(self, descriptor: int, data: Any) -> int:
        length = os.write(descriptor, data)
        number = self.open_files[descriptor]
        file = self._file(number)
        self.files[number] = File(file.synced, file.written + bytes(data[:length]))
        self.note()
        return length

    def fsync(self, descriptor: int) -> None:
        os.fsync(descriptor)
        if descriptor in self.open_files:
            number = self.open_files[descriptor]
            self.files[number] = File(self._file(number).written, self._file(number).written)
        else:
            folder = self.open_folders[descriptor]
            within = [change for change in self.pending if os.path.dirname(change[0][0]) == folder.removeprefix(".")]
            for name, number in itertools.chain(*within):
                if number is None:
                    self.names.pop(name, None)
                else:
                    self.names[name] = number
            self.pending = [change for change in self.pending if change not in within]
        self.note()

    def close(self, descriptor: int) -> None:
        os.close(descriptor)
        self.open_files.pop(descriptor, None)
        self.open_folders.pop(descriptor, None)

    def ftruncate(self, descriptor: int, length: int) -> None:
        os.ftruncate(descriptor, length)
        file = self._file(number := self.open_files[descriptor])
        self.files[number] = File(file.synced, file.written[:length])
        self.note()

    def unlink(self, path: Any) -> None:
        os.unlink(path)
        self._change((path, None))

    def replace(self, old: Any, new: Any) -> None:
        number = self._number(old)
        os.replace(old, new)
        self._change((new, number), (old, None))


@pytest.fixture
def course(tmp_path: Path) -> Callable[[], tuple[list[Moment], str]]:
    """Makes a record with all that there is, and closes it; its moments, and its last digest."""

    def made() -> tuple[list[Moment], str]:
        (tmp_path / "disk").mkdir()
        disk = Disk(tmp_path / "disk")
        with pytest.MonkeyPatch.context() as patch:
            for module in (files, store_module, journal_module):
                patch.setattr(module, "os", disk)
            with FolderStore.create(tmp_path / "disk" / RUN, SETTINGS, SCHEMA) as store:
                disk.reports.append("created")
                for number in range(BATCHES):
                    store.commit(batch(number))
                    disk.reports.append(f"commit {number}")
                    disk.note()
                    store.write_state(number, {"i": np.array(number)})
                    disk.reports.append(f"state {number}")
                    disk.note()
                    if number == 1:
                        store.write_set("test", batch(9).designs, batch(9).results)
                        disk.reports.append("set test")
                        disk.note()
                    if number in (1, 3):
                        ids = np.arange(len(store.asked), number)
                        store.hand_out(Asked.of(ids, batch(9).designs[ids], ACTIVE, 0))
                        disk.reports.append(f"asked {number}")
                        disk.note()
                    if number == 2:
                        store.correct(np.array([1]), batch(8).results[:1])
                        disk.reports.append("corrected")
                        disk.note()
            return disk.moments, store.digest

    return made


def restored(contents: Mapping[str, bytes | None], disk: Path) -> Path:
    """The run folder on a disk with these folders and files."""
    disk.mkdir()
    for name in sorted(contents):
        content = contents[name]
        (disk / name).mkdir() if content is None else (disk / name).write_bytes(content)
    return disk / RUN


def lost(reports: tuple[str, ...], folder: Path) -> list[str]:
    """What was acknowledged and is not there."""
    if "created" not in reports:
        return []
    if not (folder / "campaign.toml").exists():
        return ["created"]
    with FolderStore.open(folder, SCHEMA, write=False) as store:
        state, batches = store.latest_state(), len(store.batches)
        whole = {
            "created": True,
            "set test": store.read_set("test") is not None,
            "corrected": len(store.corrections) == 1,
            **{f"asked {number}": len(store.asked) >= number for number in (1, 3)},
            **{f"commit {number}": True for number in range(batches)},
            **{f"state {number}": True for number in range(-1 if state is None else state[0] + 1)},
        }
        if len(store.corrections):
            # States that learned from the former result do not count, and are learned again.
            whole |= {f"state {number}": True for number in range(3)}
    return [line for line in reports if not whole.get(line, False)]


def test_a_loss_of_power_at_any_moment_leaves_all_that_was_acknowledged(
    course: Callable[[], tuple[list[Moment], str]], tmp_path: Path, every_fault: bool, survived: Callable[[], None]
) -> None:
    moments, digest = course()
    states = {
        (moment.reports, tuple(sorted(contents.items())))
        for moment in moments
        for contents in moment.after_power_loss()
    }
    assert len(states) > 80
    for number, (reports, contents) in enumerate(few(sorted(states, key=repr), every_fault, 30)):
        folder = restored(MappingProxyType(dict(contents)), tmp_path / str(number))
        assert lost(reports, folder) == []
        opener = FolderStore.open if (folder / "campaign.toml").exists() else FolderStore.create
        arguments: dict[str, Any] = {"write": True} if opener == FolderStore.open else {"settings": SETTINGS}
        if opener == FolderStore.open and (folder / "campaign.toml").read_text() != SETTINGS:
            pytest.fail("campaign.toml has its name before its content")
        with opener(folder, schema=SCHEMA, **arguments) as store:
            for following in range(len(store.batches), BATCHES):
                if following == 3 and not len(store.corrections):
                    store.correct(np.array([1]), batch(8).results[:1])
                store.commit(batch(following))
            if not len(store.corrections):
                store.correct(np.array([1]), batch(8).results[:1])
            assert store.digest == digest
        survived()


@pytest.mark.parametrize("without", ["files", "folders", "folders above"])
def test_the_model_finds_what_a_program_without_fsync_would_lose(
    course: Callable[[], tuple[list[Moment], str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without: str
) -> None:
    if without == "files":
        for module in (files, journal_module):
            monkeypatch.setattr(module, "sync_file", lambda descriptor, path: None)
    elif without == "folders above":

        def made(folder: Path) -> None:
            for above in (folder.parent.parent, folder.parent, folder):
                files.os.mkdir(above)
            files.sync_folder(folder.parent)

        monkeypatch.setattr(store_module, "make_folder", made)
    else:
        for module in (files, journal_module):
            monkeypatch.setattr(module, "sync_folder", lambda folder: None)
    moments, _ = course()
    last = moments[-1]
    stored = 0
    for number, contents in enumerate(itertools.islice(last.after_power_loss(), 60)):
        folder = restored(contents, tmp_path / str(number))
        try:
            stored += bool(lost(last.reports, folder))
        except Exception:
            stored += 1
    assert stored > 0
