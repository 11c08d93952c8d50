"""The record in a run folder: what is refused, what is dropped, and what a failing machine leaves."""

import errno
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from commandline import activefail

from activefail.errors import BusyError, InputError, StoreError
from activefail.record import journal as journal_module
from activefail.record import run_folder as store_module
from activefail.record.asked import Asked
from activefail.record.batch import ACTIVE, COLUMNS, Batch, Schema, answers_of, columns_of
from activefail.record.events import Event, pack, unpack
from activefail.record.journal import FIRST_LINE
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import Results
from activefail.text import files

pytestmark = pytest.mark.faults

SCHEMA = Schema(("radius", "mu"), ("none", "failure"), ("", "uplift"), ("drift",))
SETTINGS = 'seed = 1\nname = "Lager"\n'
STORED = Path(__file__).parent / "format_2"
"""A run folder of version 0.2.0."""


def batch(n: int, seed: int = 0, iteration: int = 0) -> Batch:
    rng = np.random.default_rng([seed, n])
    codes = rng.integers(0, 2, (3, n)).astype(np.int8)
    return Batch(
        iteration,
        np.arange(n),
        rng.normal(size=(n, 2)),
        codes[0],
        Results(codes[1], codes[2], rng.random((n, 1)), rng.random(n)),
    )


def contents(store: FolderStore) -> list[tuple[object, ...]]:
    return [(one.iteration, *(array.tobytes() for array in columns_of(one).values())) for one in store.batches]


def written(folder: Path, *sizes: int) -> list[tuple[object, ...]]:
    """Make a run folder with batches of these sizes; what they hold."""
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        for seed, n in enumerate(sizes):
            store.commit(batch(n, seed))
        return contents(store)


def read(folder: Path) -> list[tuple[object, ...]]:
    with FolderStore.open(folder, SCHEMA, write=False) as store:
        return contents(store)


def entries(folder: Path) -> list[int]:
    """Where the entries of a journal begin, and where the last one ends."""
    data, places, digest = (folder / "journal").read_bytes(), [len(FIRST_LINE)], ""
    while places[-1] < len(data):
        entry = unpack(data, places[-1], digest)
        digest = entry.digest
        places.append(entry.end)
    return places


def snapshot(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every name below a folder with its time of change and content."""
    return {
        str(path.relative_to(folder)): (path.lstat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
        for path in sorted([folder, *folder.rglob("*")])
    }


# What a store writes.
WRITES: dict[str, Callable[[FolderStore], None]] = {
    "commit": lambda store: store.commit(batch(4, 2)),
    "state": lambda store: store.write_state(3, {"i": np.array(3)}),
    "set": lambda store: store.write_set("test", np.zeros((3, 2)), batch(3).results),
    "asked": lambda store: store.hand_out(Asked.of(np.array([7]), np.ones((1, 2)), ACTIVE, 0)),
    "correct": lambda store: store.correct(np.array([1]), batch(1, 5).results),
    "remember": lambda store: store.remember(("a", "b"), {"value": 1.5}),
}


def kept(store: FolderStore) -> dict[str, bool]:
    """Which of these writes a store has."""
    state = store.latest_state()
    return {
        "commit": len(store.batches) == 3,
        "state": state is not None and state[0] == 3,
        "set": store.read_set("test") is not None,
        "asked": len(store.asked) == 1,
        "correct": len(store.corrections) == 1,
        "remember": store.recall(("a", "b")) == {"value": 1.5},
    }


class Kill(BaseException):
    """Stands for kill -9: nothing after it reaches the system."""


Fault = Callable[[str, tuple[Any, ...], int], Any]


class Faults:
    """The module `os` as the store sees it, where calls can fail, fall short or kill.

    `fault(name, arguments, number)` is asked before each call that the store makes to change a file or make it
    durable; it may raise, or return a value in place of the call's.
    """

    CALLS = ("open", "write", "fsync", "fstat", "close", "ftruncate", "unlink", "replace")

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self.made: list[str] = []

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in self.CALLS:
            return real

        def call(*arguments: Any) -> Any:
            self.made.append(name)
            answer = self.fault(name, arguments, len(self.made))
            return real(*arguments) if answer is None else answer

        return call


@pytest.fixture
def faults() -> Iterator[Callable[[Fault | None], Faults]]:
    """Install faults in the store's modules; an argument None takes them away."""
    patch = pytest.MonkeyPatch()

    def install(fault: Fault | None) -> Faults:
        patch.undo()
        proxy = Faults(fault or (lambda *_: None))
        for module in (files, store_module, journal_module):
            patch.setattr(module, "os", proxy)
        return proxy

    yield install
    patch.undo()


Install = Callable[[Fault | None], Faults]


def kill_at(number: int) -> Fault:
    def fault(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        if count == number and name == "write":
            os.write(arguments[0], arguments[1][: len(arguments[1]) // 2])
        if count >= number:  # a dead process makes no further calls either, so no `finally` can tidy up
            raise Kill

    return fault


def fail(name: str, code: int) -> Fault:
    left = [1]

    def fault(called: str, arguments: tuple[Any, ...], count: int) -> Any:
        if called == name and left[0]:
            left[0] -= 1
            raise OSError(code, os.strerror(code))

    return fault


# Create and open


def test_a_run_folder_is_the_frozen_settings_a_journal_and_a_checkpoint(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "a"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        assert store.settings == SETTINGS
        store.commit(batch(2))
        assert sorted(os.listdir(folder)) == ["campaign.toml", "journal"]
    assert (folder / "campaign.toml").read_bytes() == SETTINGS.encode()
    assert sorted(os.listdir(folder)) == ["campaign.toml", "checkpoint.h5", "journal"]
    assert (folder / "journal").read_bytes().startswith(b"activefail-journal, format 2 ")


def test_a_folder_that_is_not_empty_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=r"not empty \(it holds notes.txt\)"):
        FolderStore.create(tmp_path, SETTINGS, SCHEMA)
    assert snapshot(tmp_path) == before


def test_a_campaign_is_not_created_over_another_one_even_if_its_settings_are_gone(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 3)
    for name in ("checkpoint.h5", "campaign.toml"):
        with pytest.raises(InputError, match="not empty"):
            FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA)
        (tmp_path / "run" / name).unlink()
    with pytest.raises(InputError, match="its journal holds a campaign"):
        FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA)
    (tmp_path / "run" / "campaign.toml").write_text(SETTINGS)
    assert read(tmp_path / "run") == held


@pytest.mark.parametrize(
    "content",
    [
        b"mine",
        b"activefail-journal, format 1".ljust(31) + b"\n",
        FIRST_LINE[:-1],
        b"activefail",
        b"\0mine",
        b"\n" + FIRST_LINE,
    ],
)
def test_a_users_own_file_named_journal_is_not_written_over(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "journal"
    path.write_bytes(content)
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=r"its journal was not written by activefail. Choose another folder"):
        FolderStore.create(tmp_path, SETTINGS, SCHEMA)
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("content", [b"", bytes(5000), FIRST_LINE, FIRST_LINE + b"activefail 0123"])
def test_a_campaign_is_created_over_what_an_interrupted_creation_left(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "journal").write_bytes(content)
    FolderStore.create(tmp_path, SETTINGS, SCHEMA).close()
    assert read(tmp_path) == []


@pytest.fixture
def place_of_a_user(tmp_path: Path) -> Iterator[Path]:
    """A folder of the user who runs the test. That is not root, who may write everywhere."""
    if os.geteuid() != 0:
        yield tmp_path
        return
    nobody = 65534
    with tempfile.TemporaryDirectory() as folder:
        os.chown(folder, nobody, nobody)
        os.seteuid(nobody)
        try:
            yield Path(folder)
        finally:
            os.seteuid(0)


def test_a_folder_that_cannot_be_written_is_refused_with_the_systems_reason(place_of_a_user: Path) -> None:
    run = place_of_a_user / "run"
    written(run, 2)
    run.chmod(0o500)
    (run / "journal").chmod(0o400)
    try:
        with pytest.raises(StoreError, match="Permission denied"):
            FolderStore.open(run, SCHEMA, write=True)
        with pytest.raises(StoreError, match="Permission denied"):
            FolderStore.create(run / "new", SETTINGS, SCHEMA)
        with pytest.raises(InputError, match="cannot be a run folder: Not a directory"):
            FolderStore.create(run / "journal" / "run", SETTINGS, SCHEMA)
        FolderStore.open(run, SCHEMA, write=False).close()
    finally:
        run.chmod(0o700)


def test_a_creation_killed_at_any_call_can_be_done_again_or_opened(tmp_path: Path, faults: Install) -> None:
    for number in range(1, 100):
        folder = tmp_path / str(number)
        faults(kill_at(number))
        try:
            FolderStore.create(folder, SETTINGS, SCHEMA).close()
            break
        except Kill:
            pass
        faults(None)
        is_there = (folder / "campaign.toml").exists()
        store = FolderStore.open(folder, write=True) if is_there else FolderStore.create(folder, SETTINGS, SCHEMA)
        with store:
            store.commit(batch(3))
        assert not list(folder.glob(".tmp-*"))
        assert len(read(folder)) == 1
    assert number > 8


@pytest.mark.parametrize("write", [True, False])
def test_a_folder_without_a_campaign_is_refused_and_left_as_it_is(tmp_path: Path, write: bool) -> None:
    before = snapshot(tmp_path)
    with pytest.raises(StoreError, match=r"campaign.toml is missing\.$"):
        FolderStore.open(tmp_path, SCHEMA, write=write)
    assert snapshot(tmp_path) == before
    written(tmp_path / "run", 2)
    (tmp_path / "run" / "journal").unlink()
    before = snapshot(tmp_path)
    with pytest.raises(StoreError, match=r"journal|No such file"):
        FolderStore.open(tmp_path / "run", SCHEMA, write=write)
    assert snapshot(tmp_path) == before


def test_a_lost_campaign_toml_can_be_restored_from_the_journal(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 2)
    (tmp_path / "run" / "campaign.toml").unlink()
    with pytest.raises(StoreError, match="from the first entry of the journal"):
        FolderStore.open(tmp_path / "run", write=True)
    first = unpack((tmp_path / "run" / "journal").read_bytes(), len(FIRST_LINE), "")
    (tmp_path / "run" / "campaign.toml").write_text(first.event.attributes["settings"])
    assert read(tmp_path / "run") == held


# Settings, schema and versions


@pytest.mark.parametrize("write", [True, False])
def test_changed_settings_are_refused_with_a_diff(tmp_path: Path, write: bool) -> None:
    written(tmp_path / "run", 2, 3)
    path = tmp_path / "run" / "campaign.toml"
    path.write_text(SETTINGS.replace("seed = 1", "seed = 2"))
    before = snapshot(tmp_path / "run")
    with pytest.raises(StoreError, match="changed after the campaign began") as caught:
        FolderStore.open(tmp_path / "run", SCHEMA, write=write)
    assert snapshot(tmp_path / "run") == before
    assert "-seed = 1\n+seed = 2" in str(caught.value)
    path.write_bytes(SETTINGS.replace("\n", "\r\n").encode())
    with pytest.raises(StoreError, match="only line endings"):
        FolderStore.open(tmp_path / "run", SCHEMA, write=write)


def test_another_schema_is_refused_with_both(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    before = snapshot(tmp_path / "run")
    with pytest.raises(StoreError, match=r"schema is not .*\('radius', 'mu'\).*\('mu', 'radius'\)"):
        FolderStore.open(tmp_path / "run", replace(SCHEMA, variables=("mu", "radius")), write=True)
    assert snapshot(tmp_path / "run") == before


def test_versions_and_digests_that_have_changed_since_the_last_batch_are_named(tmp_path: Path) -> None:
    first = {"torch": "2.12", "numpy": "2.4", "bearing_sources": "a" * 64}
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA, provenance=first) as store:
        store.commit(batch(3))
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True, provenance=first) as store:
        assert store.warnings == ()
    now = first | {"torch": "2.13", "bearing_sources": "b" * 64}
    for expected in (1, 0):
        with FolderStore.open(tmp_path / "run", SCHEMA, write=True, provenance=now) as store:
            for warning in store.warnings:
                assert warning.endswith(": torch 2.12 -> 2.13; bearing_sources aaaaaaaa -> bbbbbbbb.")
            assert len(store.warnings) == expected
            store.commit(batch(3, 1))


def test_a_folder_of_version_0_1_is_refused_with_the_way_over(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(SETTINGS)
    for name in ("segments", "state", "sets"):
        (tmp_path / name).mkdir()
    before = snapshot(tmp_path)
    for words in (["status"], ["resume"], ["export", "--csv", tmp_path.parent / "all.csv"]):
        result = activefail(words[0], tmp_path, *words[1:])
        assert result.code == 1
        assert "was written by activefail 0.1. Continue it with that version (`activefail resume`)" in result.err
        assert "`activefail export` there, `activefail add` here" in result.err
    assert snapshot(tmp_path) == before


def test_a_journal_of_another_format_is_refused_by_its_number(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    path = tmp_path / "run" / "journal"
    path.write_bytes(path.read_bytes().replace(b"format 2", b"format 3", 1))
    before = snapshot(tmp_path / "run")
    for write in (True, False):
        with pytest.raises(StoreError, match=r"journal has format 3, not 2: .* Use the version that wrote it"):
            FolderStore.open(tmp_path / "run", write=write)
    assert snapshot(tmp_path / "run") == before


def test_a_stored_folder_of_format_2_stays_readable() -> None:
    with FolderStore.open(STORED, SCHEMA, write=False) as store:
        assert [len(one) for one in store.batches] == [3, 2, 4]
        assert store.batches[0].designs.tobytes() == batch(3).designs.tobytes()
        assert store.batches[0].results[1:2].margins.tobytes() == batch(1, 5).results.margins.tobytes()
        assert kept(store) == dict.fromkeys(WRITES, True)
        assert store.warnings == ()
        assert store.digest == (STORED / "digest").read_text().strip()


# Sets


@pytest.mark.parametrize("write", [True, False])
def test_a_set_that_other_code_simulated_is_not_used_and_the_difference_is_named(tmp_path: Path, write: bool) -> None:
    def opened(write: bool, **provenance: str) -> FolderStore:
        decisive = ("model", "other")
        return FolderStore.open(tmp_path / "run", SCHEMA, write=write, provenance=provenance, decisive=decisive)

    first = {"model": "a" * 64, "numpy": "1"}
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA, provenance=first, decisive=("model",)) as store:
        store.write_set("test", np.ones((3, 2)), batch(3).results)
        assert store.read_set("test") is not None
    # Only what decides the results is compared, and only if it is known now.
    for provenance in ({"model": "a" * 64, "numpy": "2"}, {"numpy": "1", "other": "1"}):
        with opened(False, **provenance) as store:
            assert store.read_set("test") is not None
            assert store.warnings == ()
    with opened(write, model="b" * 64) as store:
        assert store.read_set("test") is None
        says = "The set test was simulated with different code (model aaaaaaaa -> bbbbbbbb); it is not used."
        assert store.warnings[-1] == says + (" Its designs are simulated again when they are needed." if write else "")
        if write:
            store.write_set("test", np.ones((3, 2)), batch(3).results)
            assert store.read_set("test") is not None


# The checkpoint


def test_any_hdf5_tool_opens_the_checkpoint_once_a_writer_has_closed_the_record(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        for iteration, n in enumerate((3, 2)):
            store.commit(batch(n, iteration, iteration))
        store.correct(np.array([4]), batch(1, 9).results)
        store.write_state(1, {"failure/mean": np.array(2.5)})
        with h5py.File(tmp_path / "run" / "checkpoint.h5") as file:
            assert set(file) == {"states"}  # columns are not written with every state
        batches = store.batches
    with h5py.File(tmp_path / "run" / "checkpoint.h5") as file:
        assert file["iteration"][:].tolist() == [0, 0, 0, 1, 1]
        for name in COLUMNS:
            column = np.concatenate([columns_of(one)[name] for one in batches])
            assert (file[name].dtype, file[name][:].tobytes()) == (column.dtype, column.tobytes())
        assert file.attrs["variables"].tolist() == ["radius", "mu"]
    with FolderStore.open(tmp_path / "run", write=False) as store:
        saved = store.latest_state()
        assert saved is not None
        assert (saved[0], saved[1]["failure/mean"]) == (1, 2.5)


def test_a_lost_checkpoint_is_made_again_and_a_damaged_one_with_one_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        store.commit(batch(3))
        store.write_state(0, {"i": np.array(1)})
    path = folder / "checkpoint.h5"
    whole = path.read_bytes()
    for content in (None, whole[:-1], b""):
        path.unlink()
        if content is not None:
            path.write_bytes(content)
        with FolderStore.open(folder, write=True) as store:
            assert store.latest_state() is None
            assert store.latest_state() is None
            says = [] if content is None else ["checkpoint.h5 is incomplete; what it held is learned again."]
            assert list(store.warnings) == says
            store.write_state(0, {"i": np.array(1)})
        assert path.read_bytes() == whole


def test_a_state_of_another_record_is_skipped_without_a_word(tmp_path: Path) -> None:
    for seed in (0, 1):
        with FolderStore.create(tmp_path / str(seed), SETTINGS, SCHEMA) as store:
            store.commit(batch(3, seed))
            store.write_state(0, {"i": np.array(seed)})
    shutil.copy(tmp_path / "0" / "checkpoint.h5", tmp_path / "1" / "checkpoint.h5")
    with FolderStore.open(tmp_path / "1", write=False) as store:
        assert store.latest_state() is None
        assert store.warnings == ()


# Writers


def test_a_second_writer_is_refused_and_a_reader_is_not(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        store.commit(batch(2))
        with pytest.raises(BusyError, match=str(tmp_path / "run")):
            FolderStore.open(tmp_path / "run", SCHEMA, write=True)
        assert read(tmp_path / "run") == contents(store)
        store.commit(batch(2, 1))
    FolderStore.open(tmp_path / "run", SCHEMA, write=True).close()


def test_kill_9_releases_the_lock_and_loses_no_acknowledged_batch(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    written(folder, 2)
    program = (
        "import sys, numpy as np\nfrom activefail.record.run_folder import FolderStore\n"
        "store = FolderStore.open(sys.argv[1], write=True)\n"
        "while True:\n"
        "    store.commit(store.batches[0])\n"
        "    print(len(store.batches), flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(5)]
    with pytest.raises(BusyError):
        FolderStore.open(folder, SCHEMA, write=True)
    process.send_signal(signal.SIGKILL)
    acknowledged = int((lines + process.stdout.read().splitlines())[-1])
    process.wait()
    process.stdout.close()
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        assert len(store.batches) - acknowledged in (0, 1)


def without_flock(*arguments: object) -> None:
    raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, 524])
def test_a_file_system_without_locks_is_warned_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def refuse(*arguments: object) -> None:
        raise OSError(number, os.strerror(number))

    written(tmp_path / "run", 2, 2)
    monkeypatch.setattr("fcntl.flock", refuse)
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
        assert "has no locks" in store.warnings[0]


@pytest.mark.parametrize("write", WRITES)
def test_without_locks_the_journal_itself_excludes_a_second_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: str
) -> None:
    written(tmp_path / "run", 2, 2)
    monkeypatch.setattr("fcntl.flock", without_flock)
    first, second = (FolderStore.open(tmp_path / "run", SCHEMA, write=True) for _ in range(2))
    assert "has no locks" in first.warnings[0]
    first.commit(batch(3, 1))
    held = contents(first)
    if write != "state":
        for _ in range(2):
            with pytest.raises(StoreError, match="journal is not as this process left it"):
                WRITES[write](second)
    second.close()
    first.close()
    assert read(tmp_path / "run") == held


@pytest.mark.parametrize("sizes", [(3, 3), (3, 5), (5, 3)])
@pytest.mark.parametrize("call", ["write", "fstat"])
def test_of_two_writers_without_locks_at_the_same_time_at_most_one_is_acknowledged(
    tmp_path: Path, faults: Install, sizes: tuple[int, int], call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path / "run", 2)
    monkeypatch.setattr("fcntl.flock", without_flock)
    first, second = (FolderStore.open(tmp_path / "run", SCHEMA, write=True) for _ in range(2))

    def overtaken(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        if name == call and len(second.batches) == 1:
            faults(None)
            second.commit(batch(sizes[1], 2))

    faults(overtaken)
    with pytest.raises(StoreError, match="Resume"):
        first.commit(batch(sizes[0], 1))
    assert len(second.batches) == 2
    assert read(tmp_path / "run") == contents(second)


# The machine


@pytest.mark.parametrize("write", WRITES)
def test_a_write_killed_at_any_call_leaves_what_was_before_or_the_whole(
    tmp_path: Path, faults: Install, write: str
) -> None:
    held = written(tmp_path / "base", 2, 3)
    seen = []
    for number in range(1, 100):
        folder = tmp_path / str(number)
        shutil.copytree(tmp_path / "base", folder)
        store = FolderStore.open(folder, SCHEMA, write=True)
        calls = faults(kill_at(number))
        try:
            WRITES[write](store)
            break
        except Kill:
            pass
        finally:
            faults(None)
        if "write" in calls.made:
            with pytest.raises(StoreError, match="interrupted"):
                WRITES[write](store)
        store.close()
        with FolderStore.open(folder, SCHEMA, write=True) as reopened:
            seen.append(kept(reopened)[write])
            assert [one[1] for one in contents(reopened)][:2] == [one[1] for one in held]
            if not seen[-1]:
                WRITES[write](reopened)
            assert kept(reopened)[write]
        with FolderStore.open(folder, SCHEMA, write=True) as reopened:
            assert reopened.warnings == ()
    store.close()
    assert seen == sorted(seen)
    assert set(seen) == {False, True}


def test_an_event_is_one_write_and_one_fsync_and_a_checkpoint_is_durable_before_its_name(
    tmp_path: Path, faults: Install
) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        calls = faults(None)
        for write in ("commit", "set", "asked", "correct", "remember"):
            WRITES[write](store)
        # The place of the journal and its size are checked before, the size after.
        assert calls.made == ["fstat", "fstat", "write", "fstat", "fsync"] * 5
        calls = faults(None)
        WRITES["state"](store)
        file = ["open", "write", "fsync", "fstat", "close", "fstat", "replace", "open", "fsync", "close"]
        assert [name for name in calls.made if name != "open"][-8:] == [name for name in file if name != "open"]
        assert calls.made[-len(file) :] == file


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EFBIG, errno.EDQUOT])
@pytest.mark.parametrize("write", WRITES)
def test_a_full_or_failing_disk_gives_the_systems_reason_and_the_write_can_be_repeated(
    tmp_path: Path, faults: Install, write: str, code: int
) -> None:
    folder = tmp_path / "run"
    held = written(folder, 2, 3)
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        before = kept(store)

        def half(name: str, arguments: tuple[Any, ...], count: int) -> Any:
            if name == "write":
                faults(None)
                os.write(arguments[0], arguments[1][: len(arguments[1]) // 2])
                raise OSError(code, os.strerror(code))

        faults(half)
        with pytest.raises(StoreError, match=f"Cannot write {folder}/.*: {os.strerror(code)}"):
            WRITES[write](store)
        assert kept(store) == before
        assert contents(store) == held == read(folder)
        WRITES[write](store)
        assert kept(store)[write]
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        assert kept(store)[write]
        assert store.warnings == ()


@pytest.mark.parametrize("write", WRITES)
def test_after_a_failed_fsync_this_store_writes_nothing_more(tmp_path: Path, faults: Install, write: str) -> None:
    folder = tmp_path / "run"
    held = written(folder, 2, 3)
    store = FolderStore.open(folder, SCHEMA, write=True)
    faults(fail("fsync", errno.EIO))
    with pytest.raises(StoreError, match=r"Input/output error \(fsync\)"):
        WRITES[write](store)
    calls = faults(None)
    for one in WRITES.values():
        with pytest.raises(StoreError, match="fsync"):
            one(store)
    store.close()
    assert set(calls.made) <= {"close"}
    assert contents(store) == held
    with FolderStore.open(folder, SCHEMA, write=True) as reopened:
        assert [one[1] for one in contents(reopened)][:2] == [one[1] for one in held]


def test_a_limit_on_the_size_of_files_is_an_error_not_a_crash(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / "run" / "journal").stat().st_size + 100, limits[1]))
        try:
            with pytest.raises(StoreError, match="File too large"):
                store.commit(batch(3))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        store.commit(batch(3))
    assert len(read(tmp_path / "run")) == 1


def test_short_writes_lose_nothing_and_missing_ones_are_noticed(tmp_path: Path, faults: Install) -> None:
    rng = np.random.default_rng(3)

    def short(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        return os.write(arguments[0], arguments[1][: rng.integers(1, 50)]) if name == "write" else None

    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        calls = faults(short)
        store.commit(batch(3))
        assert calls.made.count("write") > 10
        faults(lambda name, arguments, count: len(arguments[1]) if name == "write" else None)
        with pytest.raises(StoreError, match="it should have"):
            store.commit(batch(3))
        faults(lambda name, arguments, count: 0 if name == "write" else None)
        with pytest.raises(StoreError, match="accepted no more bytes"):
            store.commit(batch(3))
        faults(None)
    assert len(read(tmp_path / "run")) == 1


def test_temporaries_of_a_crash_are_removed_only_when_opened_to_write(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    left, mine = tmp_path / "run" / ".tmp-0123456789abcdef", tmp_path / "run" / ".tmp-notes"
    for file in (left, mine):
        file.write_text("half")
    read(tmp_path / "run")
    assert left.exists()
    FolderStore.open(tmp_path / "run", SCHEMA, write=True).close()
    assert not left.exists()
    assert mine.exists()


@pytest.mark.parametrize("name", [".tmp-notes", ".tmp-0123456789ABCDEF", "journal.quarantine", ".tmp-"])
def test_a_new_campaign_needs_a_folder_without_files_of_the_users(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=f"not empty .it holds {name}"):
        FolderStore.create(tmp_path, SETTINGS, SCHEMA)
    assert (tmp_path / name).read_text() == "mine"


# Foreign journals


def appended(folder: Path, *events: Event) -> None:
    """Append events to a journal with right digests."""
    data, digest = (folder / "journal").read_bytes(), ""
    for place in entries(folder)[:-1]:
        digest = unpack(data, place, digest).digest
    for event in events:
        parts, digest, _ = pack(event, digest)
        data += b"".join(parts)
    (folder / "journal").write_bytes(data)


def columns(n: int = 2, **changed: Any) -> dict[str, Any]:
    return columns_of(batch(n)) | changed


def deep(levels: int, around: Callable[[Any], Any] = lambda value: [value]) -> Any:
    """A value of JSON with so many others around it."""
    value: Any = 1
    for _ in range(levels):
        value = around(value)
    return value


BAD = {
    "an unknown kind": Event("surprise", {}, {}),
    "a batch without an iteration": Event("batch", {}, columns()),
    "a batch of no designs": Event("batch", {"iteration": 0}, dict.fromkeys(COLUMNS, np.ones(0))),
    "an infinite iteration": Event("batch", {"iteration": float("inf")}, columns()),
    "columns of other lengths": Event("batch", {"iteration": 0}, columns(outcome=np.zeros(3, np.int8))),
    "designs that are not finite": Event("batch", {"iteration": 0}, columns(designs=np.full((2, 2), np.nan))),
    "an outcome without a name": Event("batch", {"iteration": 0}, columns(outcome=np.full(2, 9, np.int8))),
    "an origin without a meaning": Event("batch", {"iteration": 0}, columns(origin=np.full(2, 9, np.int8))),
    "a negative origin": Event("batch", {"iteration": 0}, columns(origin=np.full(2, -1, np.int8))),
    "a column of another type": Event("batch", {"iteration": 0}, columns(margins=np.zeros((2, 1), np.int64))),
    "a correction of nothing": Event("corrected", {}, {"place": np.array([99]), **answers_of(batch(1).results)}),
    "a set of no name": Event("set", {"name": "../x"}, {"designs": np.zeros((2, 2)), **answers_of(batch(2).results)}),
    "an id twice in a batch": Event("batch", {"iteration": 0}, columns(id=np.zeros(2, np.int64))),
    "designs twice in flight": Event("asked", {}, vars(Asked.of(np.array([1, 1]), np.zeros((2, 2)), ACTIVE, 0))),
    "a result of nothing": Event("result", {"value": 1}, {}),
    "a batch of a late iteration": Event("batch", {"iteration": 10**12}, columns()),
    "a batch after an iteration without one": Event("batch", {"iteration": 2}, columns()),
    "a batch of a negative iteration": Event("batch", {"iteration": -1}, columns()),
    "a large id": Event("batch", {"iteration": 0}, columns(id=np.array([0, 2**62]))),
    "a number of many digits": Event("result", {"of": ["a"], "value": 10**400}, {}),
    "a number of many digits as a name's value": Event("software", {"numpy": {"a": [10**20]}}, {}),
    "designs of a late iteration": Event("asked", {}, vars(Asked.of(np.array([9]), np.zeros((1, 2)), ACTIVE, 10**12))),
    "deep lists in a result": Event("result", {"of": ["a"], "value": deep(300)}, {}),
    "deep objects in a result": Event("result", {"of": ["a"], "value": deep(300, lambda value: {"a": value})}, {}),
    "another campaign": Event("campaign", {"settings": "seed = 2", "schema": {"variables": 3}}, {}),
}


@pytest.mark.parametrize("what", BAD)
def test_an_event_that_activefail_never_writes_is_refused_though_its_digest_is_right(tmp_path: Path, what: str) -> None:
    written(tmp_path / "run", 2)
    # The last entry may be an interrupted one.
    appended(tmp_path / "run", BAD[what], Event("result", {"of": ["b"], "value": 1}, {}))
    for write in (True, False):
        with pytest.raises(StoreError, match=r"journal( has content|:|, byte)"):
            FolderStore.open(tmp_path / "run", SCHEMA, write=write)


@pytest.mark.parametrize(
    "types",
    ['[["a","<f8",[1000000000000],0]]', '[["a","<f8",[-1],0]]', '[["a","|O",[1],0]]', '[["a","<f8",[1],-8]]', "[3]"],
)
def test_arrays_that_an_entry_does_not_hold_are_not_read(tmp_path: Path, types: str) -> None:
    written(tmp_path / "run", 2)
    path = tmp_path / "run" / "journal"
    before, digest = path.read_bytes(), ""
    for place in entries(tmp_path / "run")[:-1]:
        digest = unpack(before, place, digest).digest
    line = f'0 ["batch",{{}},{types}]\n'.encode()
    content = hashlib.sha256(line).hexdigest()
    sealed = hashlib.sha256(f"{digest}{content}".encode()).hexdigest()
    path.write_bytes(before + f"activefail {sealed} ".encode() + line)
    with FolderStore.open(tmp_path / "run", SCHEMA, write=False) as store:
        assert len(store.batches) == 1
        assert "has content that activefail never writes" in store.warnings[0]


@pytest.mark.parametrize("levels", [98, 300, 900, 100_000])
def test_a_deep_value_is_refused_when_it_is_kept_or_can_be_read_wherever_it_is_asked_for(
    tmp_path: Path, levels: int
) -> None:
    def recalled(store: FolderStore, frames: int) -> Any:
        return store.recall(("a",)) if not frames else recalled(store, frames - 1)

    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        if levels > 100:
            with pytest.raises((ValueError, RecursionError)):
                store.remember(("a",), deep(levels))
            store.remember(("b",), 1)
        else:
            store.remember(("a",), deep(levels))
    with FolderStore.open(tmp_path / "run", write=True) as store:
        assert recalled(store, 500) == (deep(levels) if levels <= 100 else None)


def test_an_entry_that_would_make_the_journal_too_large_to_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = written(tmp_path / "run", 2, 3)
    monkeypatch.setattr(journal_module, "LARGEST_JOURNAL", (tmp_path / "run" / "journal").stat().st_size + 800)
    with FolderStore.open(tmp_path / "run", write=True) as store:
        with pytest.raises(StoreError, match=r"it would be larger than .* bytes, and could not be read again"):
            store.commit(batch(200, 2))
        store.commit(batch(2, 3))
    assert read(tmp_path / "run")[:2] == held
    assert len(read(tmp_path / "run")) == 3


def test_settings_that_could_not_be_read_again_are_not_written(tmp_path: Path) -> None:
    text = "# " + "x" * 1_000_000
    with pytest.raises(InputError, match=r"campaign.toml must have at most 1000000 bytes, would have 1000002"):
        FolderStore.create(tmp_path / "run", text, SCHEMA)
    assert not (tmp_path / "run").exists()
