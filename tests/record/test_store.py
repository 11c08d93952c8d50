"""The run folder: what survives crashes, full disks, changed bits, second writers and hostile files."""

import errno
import fcntl
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace as changed
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from activefail import files
from activefail.errors import BusyError, DamagedError, InputError, StoreError
from activefail.files import replacing
from activefail.record import compaction, recovery
from activefail.record import hdf5 as image
from activefail.record import run_folder as store_module
from activefail.record import segment as segment_module
from activefail.record.asked import Asked
from activefail.record.attachments import encode_set
from activefail.record.batch import ACTIVE, Batch, Schema, columns_of
from activefail.record.recovery import recover
from activefail.record.run_folder import FolderStore
from activefail.record.segment import Segment, chain_next, chain_start
from activefail.simulators.interface import Results

pytestmark = pytest.mark.faults

SCHEMA = Schema(("radius", "mu"), ("none", "failure"), ("", "uplift"), ("drift",))
SETTINGS = 'seed = 1\nname = "Lager"\n'


def batch(n: int, seed: int = 0, iteration: int = 0) -> Batch:
    rng = np.random.default_rng([seed, n])
    codes = rng.integers(0, 2, (3, n)).astype(np.int8)
    return Batch(
        iteration, rng.normal(size=(n, 2)), codes[0], Results(codes[1], codes[2], rng.random((n, 1)), rng.random(n))
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


def snapshot(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every name below a folder with its time of change and content."""
    return {
        str(path.relative_to(folder)): (path.lstat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
        for path in sorted([folder, *folder.rglob("*")])
    }


def segments(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "segments").iterdir())


def segment_file(folder: Path, index: int) -> Path:
    return sorted((folder / "segments").glob("*.h5"))[index]


class Kill(BaseException):
    """Stands for kill -9: nothing after it reaches the system."""


class Faults:
    """The module `os` as the store sees it, where calls can fail, fall short or kill.

    `fault(name, arguments, number)` is asked before each call that the store makes to change a file or make it
    durable; it may raise, or return a value in place of the call's.
    """

    CALLS = ("open", "write", "fsync", "fstat", "close", "link", "unlink", "replace", "rename")

    def __init__(self, fault: Callable[[str, tuple[Any, ...], int], Any]) -> None:
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
def faults() -> Iterator[Callable[..., Faults]]:
    """Install faults in the store's modules; an argument None takes them away."""
    patch = pytest.MonkeyPatch()

    def install(fault: Callable[[str, tuple[Any, ...], int], Any] | None) -> Faults:
        patch.undo()
        proxy = Faults(fault or (lambda *_: None))
        patch.setattr(files, "os", proxy)
        patch.setattr(store_module, "os", proxy)
        patch.setattr(recovery, "os", proxy)
        return proxy

    yield install
    patch.undo()


def kill_at(number: int) -> Callable[[str, tuple[Any, ...], int], Any]:
    def fault(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        if count == number and name == "write":
            os.write(arguments[0], arguments[1][: len(arguments[1]) // 2])
        if count >= number:  # a dead process makes no further calls either, so no `finally` can tidy up
            raise Kill

    return fault


def fail(names: str, code: int, times: int = 1) -> Callable[[str, tuple[Any, ...], int], Any]:
    left = [times]

    def fault(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        if name in names.split() and left[0]:
            left[0] -= 1
            raise OSError(code, os.strerror(code))

    return fault


@pytest.fixture
def unlocked(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a file system whose locks do nothing."""

    class Nothing:
        held = True

        def is_in(self, folder: Path) -> bool:
            return True

        def release(self) -> None: ...

    monkeypatch.setattr(store_module, "FolderLock", lambda folder: Nothing())


# Create and open


def test_a_new_folder_holds_the_frozen_settings_and_the_folders_of_the_record(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "runs" / "a", SETTINGS, SCHEMA) as store:
        assert store.settings == SETTINGS
    assert (tmp_path / "runs" / "a" / "campaign.toml").read_bytes() == SETTINGS.encode()
    assert sorted(os.listdir(tmp_path / "runs" / "a")) == [".lock", "campaign.toml", "segments", "sets", "state"]


def test_a_folder_that_is_not_empty_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=r"not empty \(it holds notes.txt\)"):
        FolderStore.create(tmp_path, SETTINGS, SCHEMA)
    assert snapshot(tmp_path) == before


def test_a_campaign_is_not_created_over_another_one(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 3)
    with pytest.raises(InputError, match="not empty"):
        FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA)
    assert read(tmp_path / "run") == held


def test_a_folder_that_cannot_be_written_is_refused_with_the_systems_reason(
    tmp_path: Path, faults: Callable[..., Faults], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=f"{tmp_path}/file/run: cannot be a run folder: Not a directory"):
        FolderStore.create(tmp_path / "file" / "run", SETTINGS, SCHEMA)

    def read_only(name: str, arguments: tuple[Any, ...], number: int) -> Any:
        if name == "open" and arguments[1] & os.O_CREAT:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    faults(read_only)
    with pytest.raises(StoreError, match=r"campaign.toml: Read-only file system"):
        FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA)
    faults(None)
    written(tmp_path / "there", 2)

    def refuse(descriptor: int, how: int) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(StoreError, match=f"Cannot write to {tmp_path}/there: Permission denied"):
        FolderStore.open(tmp_path / "there", SCHEMA, write=True)


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


def test_a_folder_without_permission_to_write_is_refused(place_of_a_user: Path) -> None:
    run = place_of_a_user / "run"
    written(run, 2)
    run.chmod(0o500)
    (run / ".lock").chmod(0o400)
    try:
        with pytest.raises(StoreError, match="Permission denied"):
            FolderStore.open(run, SCHEMA, write=True)
        with pytest.raises(StoreError, match="Permission denied"):
            FolderStore.create(run / "new", SETTINGS, SCHEMA)
    finally:
        run.chmod(0o700)
    FolderStore.open(run, SCHEMA, write=False).close()


def test_a_file_system_without_hard_links_is_refused_before_simulating(
    tmp_path: Path, faults: Callable[..., Faults]
) -> None:
    faults(fail("link", errno.EPERM))
    with pytest.raises(StoreError, match="must support hard links"):
        FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA)


def test_a_creation_killed_at_any_call_can_be_done_again_or_opened(
    tmp_path: Path, faults: Callable[..., Faults]
) -> None:
    for number in range(1, 100):
        folder = tmp_path / str(number)
        faults(kill_at(number))
        try:
            FolderStore.create(folder, SETTINGS, SCHEMA).close()
            break
        except Kill:
            pass
        faults(None)
        opener = FolderStore.open if (folder / "campaign.toml").exists() else FolderStore.create
        arguments: dict[str, Any] = {"write": True} if opener == FolderStore.open else {"settings": SETTINGS}
        with opener(folder, schema=SCHEMA, **arguments) as store:
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


def test_a_lost_campaign_toml_can_be_restored_from_a_segment(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 2)
    (tmp_path / "run" / "campaign.toml").unlink()
    with pytest.raises(StoreError, match=r"000000000-000000001\.h5 holds its text, in the dataset 'settings'"):
        FolderStore.open(tmp_path / "run", write=True)
    with h5py.File(segment_file(tmp_path / "run", 0)) as file:
        (tmp_path / "run" / "campaign.toml").write_bytes(file["settings"][0])
    assert read(tmp_path / "run") == held


def test_the_schema_is_taken_from_the_segments_if_none_is_given(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    with FolderStore.open(tmp_path / "run", write=True) as store:
        assert store.schema == SCHEMA
        store.commit(batch(2, 1))
    assert len(read(tmp_path / "run")) == 2


def test_without_a_batch_only_a_schema_opens_a_folder_for_writing(tmp_path: Path) -> None:
    FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA).close()
    with pytest.raises(InputError, match="no batch yet"):
        FolderStore.open(tmp_path / "run", write=True)
    with FolderStore.open(tmp_path / "run", write=False) as store:
        assert (store.batches, store.latest_state(), store.schema) == ((), None, None)
    FolderStore.open(tmp_path / "run", SCHEMA, write=True).close()


def test_a_run_folder_copied_without_its_empty_folders_still_opens(tmp_path: Path) -> None:
    FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA).close()
    for name in ("segments", "state", "sets", ".lock"):
        shutil.rmtree(tmp_path / "run" / name) if name != ".lock" else (tmp_path / "run" / name).unlink()
    assert read(tmp_path / "run") == []
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
        store.commit(batch(3))
    assert len(read(tmp_path / "run")) == 1


def test_opening_to_read_changes_nothing_and_names_what_is_wrong(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    held = written(folder, 2, 3)
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        store.write_state(1, {"a": np.zeros(2)})
        store.commit(batch(4, 2))
        store.write_state(2, {"a": np.ones(2)})
        store.write_set("test", np.zeros((2, 2)), batch(2).results)
    for path in (segment_file(folder, -1), folder / "state" / "000000002.h5", folder / "sets" / "test.h5"):
        path.write_bytes(path.read_bytes()[:-1])
    (folder / "segments" / ".tmp-000000009-000000010.h5-0").write_text("left by a crash")
    (folder / "segments" / "copy of 000000000-000000001.h5").write_text("")
    (folder / ".lock").unlink()
    before = snapshot(folder)
    with FolderStore.open(folder, SCHEMA, write=False) as store:
        assert contents(store) == held
        state = store.latest_state()
        assert state is not None
        assert state[0] == 1
        assert store.read_set("test") is None
        with pytest.raises(StoreError, match="reading only"):
            store.commit(batch(2))
        warnings = "\n".join(store.warnings)
    assert snapshot(folder) == before
    for name in ("segments/000000005-000000008.h5", "state/000000002.h5", "sets/test.h5", "segments/copy of"):
        assert name in warnings
    assert len(warnings.splitlines()) == 4


def test_the_same_content_gives_the_same_bytes_and_other_tools_can_read_them(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with FolderStore.create(tmp_path / name, SETTINGS, SCHEMA, provenance={"numpy": "2.x", "note": ""}) as store:
            store.commit(batch(4, iteration=2))
    paths = [segment_file(tmp_path / name, 0) for name in ("a", "b")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert paths[0].read_bytes().startswith(b"activefail record\nformat 1\nlength ")
    with h5py.File(paths[0]) as file:
        assert file.userblock_size == 512
        assert np.array_equal(file["designs"], batch(4).designs)
        assert file["designs"].fletcher32
        assert file["iteration"][:] == [2]
        assert file["settings"][0].decode() == SETTINGS
        assert (file.attrs["provenance.numpy"], file.attrs["provenance.note"]) == (b"2.x", b"")
        assert file.attrs["provenance.activefail"]


def test_provenance_is_not_in_the_chain(tmp_path: Path) -> None:
    chains = []
    for name, text in (("a", "1"), ("b", "2")):
        with FolderStore.create(tmp_path / name, SETTINGS, SCHEMA, provenance={"torch": text}) as store:
            store.commit(batch(4))
        with h5py.File(segment_file(tmp_path / name, 0)) as file:
            chains.append(file.attrs["chain_after"])
    assert chains[0] == chains[1]


def test_every_part_of_a_batch_is_in_the_chain() -> None:
    start, one = chain_start(SETTINGS, SCHEMA), batch(3)
    digests = {chain_next(start, one), chain_next(chain_start("other", SCHEMA), one)}
    digests |= {chain_next(chain_start(SETTINGS, changed(SCHEMA, margins=("gap",))), one)}
    digests |= {chain_next(start, changed(one, iteration=1))}
    for name in ("designs", "origin"):
        digests |= {chain_next(start, changed(one, **{name: 1 - getattr(one, name)}))}
    for name in ("outcome", "cause", "margins", "seconds"):
        answers = changed(one.results, **{name: 1 - getattr(one.results, name)})
        digests |= {chain_next(start, changed(one, results=answers))}
    assert len(digests) == 10
    assert chain_next(start, batch(3)) in digests


# Settings, schema and versions


@pytest.mark.parametrize("write", [True, False])
def test_changed_settings_are_refused_with_a_diff(tmp_path: Path, write: bool) -> None:
    written(tmp_path / "run", 2, 3)
    path = tmp_path / "run" / "campaign.toml"
    path.write_text(path.read_text().replace("seed = 1", "seed = 2"))
    before = snapshot(tmp_path / "run")
    with pytest.raises(StoreError, match="changed after the campaign began") as caught:
        FolderStore.open(tmp_path / "run", SCHEMA, write=write)
    assert snapshot(tmp_path / "run") == before
    assert "-seed = 1\n+seed = 2" in str(caught.value)
    assert "segments/000000000-000000001.h5" in str(caught.value)
    assert "Restore the frozen copy" in str(caught.value)


def test_settings_with_other_line_ends_are_other_settings(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    (tmp_path / "run" / "campaign.toml").write_bytes(SETTINGS.replace("\n", "\r\n").encode())
    with pytest.raises(StoreError, match="only line endings"):
        FolderStore.open(tmp_path / "run", SCHEMA, write=True)


def test_a_resume_under_other_versions_is_told(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA, provenance={"torch": "2.12", "numpy": "2.4"}) as store:
        store.commit(batch(3))
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True, provenance={"torch": "2.12", "numpy": "2.4"}) as store:
        assert store.warnings == ()
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True, provenance={"torch": "2.13", "numpy": "2.4"}) as store:
        (warning,) = store.warnings
        assert "torch 2.12 -> 2.13" in warning
        assert "numpy" not in warning


def test_of_digests_that_changed_the_beginning_is_told(tmp_path: Path) -> None:
    for digit, opener in (("a", FolderStore.create), ("b", FolderStore.open)):
        arguments = {"write": True} if digit == "b" else {"settings": SETTINGS}
        kept = {"bearing_sources": digit * 64}
        with opener(tmp_path / "run", schema=SCHEMA, provenance=kept, **arguments) as store:
            store.commit(batch(3))
            warnings = store.warnings
    assert warnings[0].endswith(": bearing_sources aaaaaaaa -> bbbbbbbb.")


def test_another_schema_is_refused_with_both(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    before = snapshot(tmp_path / "run")
    with pytest.raises(StoreError, match=r"The variables are not .*\('radius', 'mu'\).*\('mu', 'radius'\)"):
        FolderStore.open(tmp_path / "run", changed(SCHEMA, variables=("mu", "radius")), write=True)
    after = snapshot(tmp_path / "run")
    assert after == before


@pytest.mark.parametrize(
    ("module", "name", "rule"),
    [
        (image, "FORMAT", "format 2; this program reads format 1"),
        (segment_module, "SCHEMA_VERSION", "schema version 2 .* 1"),
    ],
)
def test_a_record_of_another_version_is_refused_and_not_quarantined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, name: str, rule: str
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(module, name, 2)
        written(tmp_path / "run", 2)
    before = segments(tmp_path / "run")
    with pytest.raises(StoreError, match=f"000000000-000000001.h5 was written in {rule}"):
        FolderStore.open(tmp_path / "run", SCHEMA, write=True)
    assert segments(tmp_path / "run") == before


# Damage


def test_a_file_cut_at_any_length_is_noticed(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    data = segment_file(tmp_path / "run", 0).read_bytes()
    image.verify(data)
    for length in range(len(data)):
        with pytest.raises(DamagedError):
            image.verify(data[:length])
    with pytest.raises(DamagedError):
        image.verify(data + b"\0")


def test_any_changed_bit_is_noticed_before_hdf5_sees_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "run", 1)
    data = bytearray(segment_file(tmp_path / "run", 0).read_bytes())

    def touched(*arguments: object) -> None:
        raise AssertionError("HDF5 was given a damaged file")

    monkeypatch.setattr(image.h5py, "File", touched)
    # Every bit of the block; beyond it one bit of each byte, for SHA-256 treats all bits alike.
    bits = [8 * i + j for i in range(512) for j in range(8)] + [8 * i + i % 8 for i in range(512, len(data))]
    for bit in bits:
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DamagedError), image.open_image(bytes(data)):
            pass
        data[bit // 8] ^= 1 << bit % 8


def test_a_truncated_last_segment_is_quarantined_and_the_earlier_ones_survive(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 2, 3)
    path = segment_file(tmp_path / "run", 1)
    data = path.read_bytes()
    for length in [0, 1, 511, 512, 513, *range(600, len(data), len(data) // 25), len(data) - 1]:
        path.write_bytes(data[:length])
        with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
            assert contents(store) == held[:1]
            assert re.fullmatch(
                f"segments/{path.name} is truncated .* renamed to {path.name}.quarantine .*", *store.warnings
            )
        aside = path.with_name(path.name + ".quarantine")
        assert aside.read_bytes() == data[:length]
        aside.unlink()


def test_random_flipped_bits_never_give_wrong_data(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 2, 3)
    path = segment_file(tmp_path / "run", 1)
    data = path.read_bytes()
    for bit in np.random.default_rng(7).choice(8 * len(data), 300, replace=False):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        with FolderStore.open(tmp_path / "run", SCHEMA, write=False) as store:
            assert contents(store) == held[:1]
            assert len(store.warnings) == 1


def test_after_a_quarantine_the_campaign_goes_on_and_no_quarantined_file_is_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    held = written(folder, 2, 3)
    for text in ("first", "second"):
        segment_file(folder, 1).write_text(text)
        with FolderStore.open(folder, SCHEMA, write=True) as store:
            assert contents(store) == held[:1]
            store.commit(batch(3, 1))
    name = "000000002-000000004.h5"
    assert segments(folder) == ["000000000-000000001.h5", name, f"{name}.quarantine", f"{name}.quarantine-2"]
    assert (folder / "segments" / f"{name}.quarantine").read_text() == "first"
    assert read(folder) == held


@pytest.mark.parametrize("write", [True, False])
@pytest.mark.parametrize("how", ["missing", "damaged"])
def test_a_gap_in_the_middle_is_refused_and_named(tmp_path: Path, how: str, write: bool) -> None:
    written(tmp_path / "run", 2, 3, 4, 1)
    path = segment_file(tmp_path / "run", 1)
    path.unlink() if how == "missing" else path.write_text("rubbish")
    (tmp_path / "run" / "segments" / ".tmp-left").write_text("")
    before = snapshot(tmp_path / "run")
    with pytest.raises(StoreError, match="Designs 2 to 4 are missing") as caught:
        FolderStore.open(tmp_path / "run", SCHEMA, write=write)
    after = snapshot(tmp_path / "run")
    assert after == before
    assert ("000000002-000000004.h5" in str(caught.value)) == (how == "damaged")
    assert "000000005-000000008.h5, 000000009-000000009.h5" in str(caught.value)


def test_a_table_that_a_reader_writes_into_the_run_folder_outlives_a_writer_that_opens_it(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA):
        pass
    with replacing(tmp_path / "run" / "predicted.csv") as file:
        file.write("half")
        with FolderStore.open(tmp_path / "run", SCHEMA, write=True):
            file.write(" and half")
    assert (tmp_path / "run" / "predicted.csv").read_text() == "half and half"


def test_a_segment_under_a_wrong_name_is_not_believed(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 2, 3)
    path = segment_file(tmp_path / "run", 1)
    path.rename(path.with_name("000000002-000000005.h5"))
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
        assert contents(store) == held[:1]
        assert "000000002-000000005.h5 does not match its name" in store.warnings[0]


def test_a_segment_of_another_campaign_with_the_same_settings_is_quarantined(tmp_path: Path) -> None:
    held = written(tmp_path / "run", 2)
    with FolderStore.create(tmp_path / "other", SETTINGS, SCHEMA) as store:
        store.commit(batch(2, 8))
        store.commit(batch(3, 9))
    shutil.copy(segment_file(tmp_path / "other", 1), tmp_path / "run" / "segments")
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
        assert contents(store) == held
        assert "does not follow the last batch" in store.warnings[0]
    assert segments(tmp_path / "run")[-1] == "000000002-000000004.h5.quarantine"


def test_segments_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    written(tmp_path / "run", 2, 3)
    with FolderStore.create(tmp_path / "other", SETTINGS, SCHEMA) as store:
        store.commit(batch(4, 8))
    shutil.copy(segment_file(tmp_path / "other", 0), tmp_path / "run" / "segments")
    before = snapshot(tmp_path / "run")
    with pytest.raises(StoreError, match="Two writers") as caught:
        FolderStore.open(tmp_path / "run", SCHEMA, write=True)
    after = snapshot(tmp_path / "run")
    assert after == before
    assert "000000000-000000001.h5" in str(caught.value)
    assert "000000000-000000003.h5" in str(caught.value)


def test_a_broken_state_is_skipped_for_an_older_one_and_only_three_are_kept(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        for iteration in range(5):
            store.commit(batch(2, iteration, iteration))
            store.write_state(iteration, {"i": np.array(iteration)})
        assert sorted(os.listdir(folder / "state")) == ["000000002.h5", "000000003.h5", "000000004.h5"]
        (folder / "state" / "000000004.h5").write_bytes(b"")
        for _ in range(2):
            state = store.latest_state()
            assert state is not None
            assert (state[0], state[1]["i"]) == (3, 3)
        assert len(store.warnings) == 1
        for name in ("000000002.h5", "000000003.h5"):
            (folder / "state" / name).write_bytes(b"")
        assert store.latest_state() is None


def test_a_state_that_learned_from_a_quarantined_batch_is_skipped(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        for iteration in range(2):
            store.commit(batch(2, iteration, iteration))
            store.write_state(iteration, {"i": np.array(iteration)})
    segment_file(folder, 1).write_bytes(b"")
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        state = store.latest_state()
        assert state is not None
        assert state[0] == 0
        store.commit(batch(2, 77, 1))
        state = store.latest_state()
        assert state is not None
        assert state[0] == 0
        assert any("state/000000001.h5 was not learned" in warning for warning in store.warnings)


def test_a_damaged_set_and_a_set_of_another_campaign_are_quarantined_and_read_as_none(tmp_path: Path) -> None:
    for name, text in (("run", SETTINGS), ("other", "seed = 9")):
        with FolderStore.create(tmp_path / name, text, SCHEMA) as store:
            store.write_set("test", np.ones((3, 2)), batch(3).results)
    path = tmp_path / "run" / "sets" / "test.h5"
    whole = path.read_bytes()
    for data in (whole[:-1], (tmp_path / "other" / "sets" / "test.h5").read_bytes()):
        path.write_bytes(data)
        with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
            assert store.read_set("test") is None
            assert "sets/test.h5" in store.warnings[0]
        assert not path.exists()
    assert len(os.listdir(path.parent)) == 2
    path.write_bytes(whole)
    with FolderStore.open(tmp_path / "run", SCHEMA, write=False) as store:
        assert store.read_set("test") is not None


@pytest.mark.parametrize("write", [True, False])
def test_a_set_that_other_code_simulated_is_not_used_and_the_difference_is_named(tmp_path: Path, write: bool) -> None:
    def opened(write: bool, **provenance: str) -> FolderStore:
        return FolderStore.open(
            tmp_path / "run", SCHEMA, write=write, provenance=provenance, decisive=("model", "other")
        )

    first = {"provenance": {"model": "a" * 64, "numpy": "1"}, "decisive": ("model", "other")}
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA, **first) as store:  # type: ignore[arg-type]
        store.write_set("test", np.ones((3, 2)), batch(3).results)
        assert store.read_set("test") is not None
    # Only what decides the results is compared, and only if it is known now.
    for provenance in ({"model": "a" * 64, "numpy": "2"}, {"numpy": "1", "other": "1"}):
        with opened(write, **provenance) as store:
            assert store.read_set("test") is not None
            assert store.warnings == ()
    kept = snapshot(tmp_path / "run" / "sets")
    with opened(write, model="b" * 64) as store:
        assert store.read_set("test") is None
        (warning,) = store.warnings
        says = "sets/test.h5 was simulated with different code (model aaaaaaaa -> bbbbbbbb); it is not used."
        assert warning == says + (" Its designs are simulated again when they are needed." if write else "")
        assert snapshot(tmp_path / "run" / "sets") == kept
        if write:
            store.write_set("test", np.ones((3, 2)), batch(3).results)
            assert store.read_set("test") is not None


def test_a_set_without_provenance_is_used(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        data = encode_set(np.ones((3, 2)), batch(3).results, SCHEMA, store.digest, {})
        (tmp_path / "run" / "sets" / "test.h5").write_bytes(data)
    now = {"provenance": {"model": "b"}, "decisive": ("model",)}
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True, **now) as store:  # type: ignore[arg-type]
        assert store.read_set("test") is not None
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


def handed_out(*ids: int) -> Asked:
    designs = np.random.default_rng(len(ids)).random((len(ids), 2))
    return Asked.of(np.array(ids, dtype=np.int64), designs, ACTIVE, 0)


def test_a_list_of_handed_out_designs_that_could_not_be_written_leaves_the_one_before(
    tmp_path: Path, faults: Callable[..., Faults]
) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        store.write_asked(handed_out(0))
        faults(fail("write", errno.ENOSPC))
        with pytest.raises(StoreError, match="No space left"):
            store.write_asked(handed_out(0, 1))
        faults(None)
        assert store.asked.id.tolist() == [0]


def test_kill_9_releases_the_lock_and_loses_no_acknowledged_batch(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    written(folder, 2)
    program = (
        "import sys, numpy as np\n"
        "from activefail.record.batch import Batch\nfrom activefail.record.run_folder import FolderStore\n"
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
        assert store.warnings == ()


@pytest.mark.usefixtures("unlocked")
@pytest.mark.parametrize("sizes", [(3, 3), (3, 5), (5, 3)])
def test_without_the_lock_the_link_fences_a_second_writer(tmp_path: Path, sizes: tuple[int, int]) -> None:
    written(tmp_path / "run", 2)
    first, second = (FolderStore.open(tmp_path / "run", SCHEMA, write=True) for _ in range(2))
    first.commit(batch(sizes[0], 1))
    held = contents(first)
    for _ in range(2):
        with pytest.raises(StoreError, match=r"another (writer created it|process)"):
            second.commit(batch(sizes[1], 2))
    assert len(second.batches) == 1
    assert len(segments(tmp_path / "run")) == 2
    assert read(tmp_path / "run") == held


@pytest.mark.usefixtures("unlocked")
@pytest.mark.parametrize("sizes", [(3, 3), (3, 5), (5, 3)])
def test_of_two_writers_that_link_at_the_same_time_at_most_one_is_acknowledged(
    tmp_path: Path, faults: Callable[..., Faults], sizes: tuple[int, int]
) -> None:
    written(tmp_path / "run", 2)
    first, second = (FolderStore.open(tmp_path / "run", SCHEMA, write=True) for _ in range(2))

    def overtaken(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        if name == "link" and len(second.batches) == 1:
            faults(None)
            second.commit(batch(sizes[1], 2))

    faults(overtaken)
    with pytest.raises(StoreError, match=r"another (writer created it|process)"):
        first.commit(batch(sizes[0], 1))
    assert read(tmp_path / "run") == contents(second)
    assert len(second.batches) == 2


@pytest.mark.usefixtures("unlocked")
def test_without_the_lock_a_writer_that_missed_a_compaction_is_fenced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compaction, "COMPACT_AT", 3)
    written(tmp_path / "run", 2)
    first, second = (FolderStore.open(tmp_path / "run", SCHEMA, write=True) for _ in range(2))
    for seed in (1, 2):
        first.commit(batch(2, seed))
    assert segments(tmp_path / "run") == ["000000000-000000005.h5"]
    with pytest.raises(
        StoreError, match=r"another process has recorded designs under the same ids in 000000000-000000005\.h5"
    ):
        second.commit(batch(2, 9))
    assert read(tmp_path / "run") == contents(first)


# The machine


def test_a_commit_killed_at_any_call_leaves_all_batches_before_it_and_at_most_its_own(
    tmp_path: Path, faults: Callable[..., Faults]
) -> None:
    held = written(tmp_path / "base", 2, 3)
    seen = set()
    for number in range(1, 100):
        folder = tmp_path / str(number)
        shutil.copytree(tmp_path / "base", folder)
        store = FolderStore.open(folder, SCHEMA, write=True)
        calls = faults(kill_at(number))
        try:
            store.commit(batch(4, 2))
            break
        except Kill:
            pass
        faults(None)
        with pytest.raises(StoreError, match="interrupted"):
            store.commit(batch(4, 2))
        store.close()
        assert len(read(folder)) in (2, 3)
        with FolderStore.open(folder, SCHEMA, write=True) as reopened:
            kept_state = contents(reopened)
            assert kept_state[:2] == held
            assert len(kept_state) == (3 if "link" in calls.made[: number - 1] else 2)
            assert reopened.warnings == ()
            if len(kept_state) == 2:
                reopened.commit(batch(4, 2))
            assert [len(one) for one in reopened.batches] == [2, 3, 4]
        assert len(segments(folder)) == 3
        seen.add(len(kept_state))
    store.close()
    assert seen == {2, 3}
    assert number > 8


def test_a_state_write_killed_at_any_call_leaves_the_state_before_or_the_new_one(
    tmp_path: Path, faults: Callable[..., Faults]
) -> None:
    with FolderStore.create(tmp_path / "base", SETTINGS, SCHEMA) as store:
        for iteration in range(3):
            store.write_state(iteration, {"i": np.array(iteration)})
    seen = []
    for number in range(1, 100):
        folder = tmp_path / str(number)
        shutil.copytree(tmp_path / "base", folder)
        store = FolderStore.open(folder, SCHEMA, write=True)
        faults(kill_at(number))
        try:
            store.write_state(3, {"i": np.array(3)})
            break
        except Kill:
            pass
        faults(None)
        store.close()
        with FolderStore.open(folder, SCHEMA, write=True) as reopened:
            state = reopened.latest_state()
            assert state is not None
            assert state[0] == state[1]["i"]
            seen.append(state[0])
            reopened.write_state(3, {"i": np.array(3)})
            assert len(os.listdir(folder / "state")) == 3
    store.close()
    assert seen == sorted(seen)
    assert set(seen) == {2, 3}


def test_a_file_is_durable_before_it_has_its_name_and_its_name_before_anything_follows(
    tmp_path: Path, faults: Callable[..., Faults], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = ["open", "write", "fsync", "fstat", "close"]
    commit = [*file, "link", "unlink", "open", "fsync", "close"]
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        calls = faults(None)
        store.commit(batch(3))
        assert calls.made == commit
        monkeypatch.setattr(compaction, "COMPACT_AT", 2)
        calls = faults(None)
        store.commit(batch(2))
        # The merged file, with its name, is durable before the two inputs go.
        assert calls.made == [*commit, *commit, "unlink", "unlink", "open", "fsync", "close"]
        calls = faults(None)
        store.write_state(1, {})
        assert calls.made == [*file, "replace", "open", "fsync", "close"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EFBIG, errno.EDQUOT])
@pytest.mark.parametrize("call", ["open", "write", "link"])
def test_a_full_or_failing_disk_gives_the_systems_reason_and_can_be_resumed(
    tmp_path: Path, faults: Callable[..., Faults], call: str, code: int
) -> None:
    folder = tmp_path / "run"
    held = written(folder, 2)
    names = sorted(snapshot(folder))
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        faults(fail(call, code))
        with pytest.raises(StoreError, match=f"segments/000000002-000000004.h5: {os.strerror(code)}"):
            store.commit(batch(3, 1))
        assert sorted(snapshot(folder)) == names
        assert contents(store) == held == read(folder)
        store.commit(batch(3, 1))
        assert read(folder) == contents(store)
    assert len(read(folder)) == 2


@pytest.mark.parametrize("which", [1, 2])
def test_after_a_failed_fsync_this_store_writes_nothing_more(
    tmp_path: Path, faults: Callable[..., Faults], which: int
) -> None:
    folder = tmp_path / "run"
    held = written(folder, 2)
    store = FolderStore.open(folder, SCHEMA, write=True)
    count = [0]

    def fault(name: str, arguments: tuple[Any, ...], number: int) -> Any:
        count[0] += name == "fsync"
        if name == "fsync" and count[0] == which:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    faults(fault)
    with pytest.raises(StoreError, match=r"Input/output error \(fsync\)"):
        store.commit(batch(3, 1))
    assert count[0] == which, "fsync must not be tried again"
    for write in (
        lambda: store.commit(batch(3, 1)),
        lambda: store.write_state(1, {}),
        lambda: store.write_set("test", np.zeros((3, 2)), batch(3).results),
        store.compact,
    ):
        with pytest.raises(StoreError, match=r"fsync"):
            write()
    assert count[0] == which
    assert contents(store) == held
    store.close()
    faults(None)
    with FolderStore.open(folder, SCHEMA, write=True) as reopened:
        # The first fsync is the file's, before the link; the second the folder's, after it.
        assert contents(reopened)[:1] == held
        assert len(reopened.batches) == which
        assert not [name for name in segments(folder) if name.startswith(".tmp-")]


def test_a_limit_on_the_size_of_files_is_an_error_not_a_crash(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        try:
            with pytest.raises(StoreError, match="File too large"):
                store.commit(batch(3))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert segments(tmp_path / "run") == []
        store.commit(batch(3))
    assert len(read(tmp_path / "run")) == 1


def test_short_writes_lose_nothing(tmp_path: Path, faults: Callable[..., Faults]) -> None:
    rng = np.random.default_rng(3)

    def short(name: str, arguments: tuple[Any, ...], count: int) -> Any:
        return os.write(arguments[0], arguments[1][: rng.integers(1, 50)]) if name == "write" else None

    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        calls = faults(short)
        store.commit(batch(3))
        assert calls.made.count("write") > 50
        faults(None)
        assert read(tmp_path / "run") == contents(store)


def test_a_write_that_the_system_claims_but_does_not_make_is_noticed(
    tmp_path: Path, faults: Callable[..., Faults]
) -> None:
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as store:
        faults(lambda name, arguments, count: len(arguments[1]) if name == "write" else None)
        with pytest.raises(StoreError, match="0 bytes are on the disk"):
            store.commit(batch(3))
        faults(lambda name, arguments, count: 0 if name == "write" else None)
        with pytest.raises(StoreError, match="accepted no more bytes"):
            store.commit(batch(3))
    assert segments(tmp_path / "run") == []


def test_temporaries_of_a_crash_are_removed_only_when_opened_to_write(tmp_path: Path) -> None:
    written(tmp_path / "run", 2)
    left = [tmp_path / "run" / place / ".tmp-x.h5-00" for place in (".", "segments", "state", "sets")]
    for path in left:
        path.write_text("half")
    read(tmp_path / "run")
    assert all(path.exists() for path in left)
    FolderStore.open(tmp_path / "run", SCHEMA, write=True).close()
    assert not any(path.exists() for path in left)


# Compaction


def test_sixty_four_batches_become_one_file_and_stay_bit_for_bit(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    held = []
    for session, count in enumerate((40, 30)):
        opener: Any = FolderStore.open if session else FolderStore.create
        arguments = {"write": True} if session else {"settings": SETTINGS}
        with opener(folder, schema=SCHEMA, provenance={"numpy": str(session)}, **arguments) as store:
            for seed in range(count):
                store.commit(batch(1 + seed % 3, seed, iteration=seed))
            held = contents(store)
            store.write_state(session, {"a": np.zeros(1)})
    assert len(segments(folder)) == 7
    assert read(folder) == held
    with h5py.File(segment_file(folder, 0)) as file:
        assert len(file["size"]) == 64
        # 40 batches of 1, 2, 3, 1, ... designs came before the second session.
        assert file.attrs["provenance.numpy"] == b'{"0": "0", "79": "1"}'
    digest = chain_start(SETTINGS, SCHEMA)
    with FolderStore.open(folder, SCHEMA, write=True) as store:
        assert store.latest_state() is not None
        for one in store.batches:
            digest = chain_next(digest, one)
    with h5py.File(segment_file(folder, -1)) as file:
        assert file.attrs["chain_after"].decode() == digest


@pytest.mark.parametrize("largest", [10**9, 40])
def test_many_batches_are_few_files_and_no_design_is_written_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faults: Callable[..., Faults], largest: int
) -> None:
    monkeypatch.setattr(compaction, "COMPACT_AT", 4)
    monkeypatch.setattr(compaction, "LARGEST", largest)
    merged: list[int] = []
    merge = compaction.merge

    def noting(run: Any) -> Segment:
        merged.append(sum(len(one) for segment in run for one in segment.batches))
        return merge(run)

    monkeypatch.setattr(compaction, "merge", noting)
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA, provenance={"numpy": "1"}) as store:
        for seed in range(100):
            store.commit(batch(1 + seed % 3, seed))
            most = 3 * 3 + (store.batches and sum(map(len, store.batches)) * 4) // largest
            assert len(segments(tmp_path / "run")) <= most + 4
        held, designs = contents(store), sum(map(len, store.batches))
        # 4³ ≤ 100 < 4⁴: each design was merged at most three times.
        assert sum(merged) <= 3 * designs
        assert max(merged) <= largest
    assert read(tmp_path / "run") == held


def test_files_of_merged_files_still_say_which_program_wrote_what(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compaction, "COMPACT_AT", 2)
    FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA).close()
    for seed, version in enumerate("1122"):
        with FolderStore.open(tmp_path / "run", SCHEMA, write=True, provenance={"numpy": version}) as store:
            warned = [warning for warning in store.warnings if "bit-identical" in warning]
            assert len(warned) == (seed == 2), store.warnings
            store.commit(batch(3, seed))
    with h5py.File(segment_file(tmp_path / "run", 0)) as file:
        assert len(file["size"]) == 4
        assert file.attrs["provenance.numpy"] == b'{"0": "1", "6": "2"}'


def test_a_compaction_killed_at_any_call_loses_and_doubles_nothing(
    tmp_path: Path, faults: Callable[..., Faults], monkeypatch: pytest.MonkeyPatch
) -> None:
    held = written(tmp_path / "base", 2, 3, 1, 2)
    monkeypatch.setattr(compaction, "COMPACT_AT", 4)
    for number in range(1, 100):
        folder = tmp_path / str(number)
        shutil.copytree(tmp_path / "base", folder)
        store = FolderStore.open(folder, SCHEMA, write=True)
        calls = faults(kill_at(number))
        try:
            store.compact()
            break
        except Kill:
            pass
        faults(None)
        store.close()
        assert read(folder) == held
        with FolderStore.open(folder, SCHEMA, write=True) as reopened:
            assert contents(reopened) == held
            assert reopened.warnings == ()
            # Whatever the interrupted compaction left has gone, and only that.
            assert len(segments(folder)) == (1 if "link" in calls.made[: number - 1] else 4)
            reopened.compact()
            reopened.commit(batch(4, 9))
            assert len(segments(folder)) == 2
            assert contents(reopened)[:4] == held
        assert read(folder)[:4] == held
    store.close()
    assert number > 12


def test_a_compaction_that_fails_does_not_take_back_the_commit(
    tmp_path: Path, faults: Callable[..., Faults], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compaction, "COMPACT_AT", 3)
    written(tmp_path / "run", 2, 2)
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
        opened = [0]

        def fault(name: str, arguments: tuple[Any, ...], count: int) -> Any:
            if name == "link":
                opened[0] += 1
                if opened[0] == 2:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        faults(fault)
        store.commit(batch(2, 2))
        assert "No space left" in store.warnings[0]
        assert len(segments(tmp_path / "run")) == 3
        store.commit(batch(2, 3))
        assert segments(tmp_path / "run") == ["000000000-000000007.h5"]
        assert read(tmp_path / "run") == contents(store)


def test_a_damaged_merged_file_is_no_loss_while_its_inputs_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = written(tmp_path / "run", 2, 3)
    shutil.copytree(tmp_path / "run", tmp_path / "copy")
    monkeypatch.setattr(compaction, "COMPACT_AT", 2)
    with FolderStore.open(tmp_path / "copy", SCHEMA, write=True) as store:
        store.compact()
    merged = segment_file(tmp_path / "copy", 0)
    (tmp_path / "run" / "segments" / merged.name).write_bytes(merged.read_bytes()[:-5])
    with FolderStore.open(tmp_path / "run", SCHEMA, write=True) as store:
        assert contents(store) == held
        assert merged.name in store.warnings[0]
    assert read(tmp_path / "run") == held


def test_a_reader_is_not_disturbed_by_a_compaction_while_it_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compaction, "COMPACT_AT", 3)
    with FolderStore.create(tmp_path / "run", SETTINGS, SCHEMA) as writer:
        # Three are merged already, and stay while the other two are merged away under the reader.
        for seed in range(5):
            writer.commit(batch(2, seed))
        listing = recovery.plain_files
        late = [True]

        def files(folder: Path) -> list[str]:
            names = listing(folder)
            if late.pop() if late else False:
                writer.commit(batch(2, 5))
            return names

        monkeypatch.setattr(recovery, "plain_files", files)
        assert read(tmp_path / "run") == contents(writer)
        assert segments(tmp_path / "run") == ["000000000-000000005.h5", "000000006-000000011.h5"]


@settings(deadline=None)
@given(st.data())
def test_recovery_gives_the_longest_record_that_the_files_cover_or_names_the_gap(data: st.DataObject) -> None:
    sizes = data.draw(st.lists(st.integers(1, 3), min_size=1, max_size=7))
    cuts = sorted(data.draw(st.sets(st.integers(0, len(sizes)))) | {0, len(sizes)})
    ends = np.cumsum([0, *sizes])
    start = chain_start(SETTINGS, SCHEMA)
    digests = [start]
    batches = [batch(n, i) for i, n in enumerate(sizes)]
    for one in batches:
        digests.append(chain_next(digests[-1], one))
    ranges = {(i, i + 1) for i in range(len(sizes))} | set(pairwise(cuts))
    kept = data.draw(st.lists(st.sampled_from(sorted(ranges)), unique=True))
    files = [Segment(SETTINGS, SCHEMA, int(ends[i]), digests[i], tuple(batches[i:j]), {}) for i, j in kept]
    covered = {one for i, j in kept for one in range(i, j)}
    whole = next(i for i in range(len(sizes) + 1) if i not in covered)
    if len(covered) > whole:
        following = min(i for i, j in kept if i >= whole)
        with pytest.raises(StoreError, match=f"Designs {ends[whole]} to {ends[following] - 1} are missing"):
            recover(files, {}, start)
        return
    kept_state = recover(files, {"x": "is bad"}, start)
    assert [one for segment in kept_state.chain for one in segment.batches] == batches[:whole]
    assert len(kept_state.chain) + len(kept_state.covered) == len(files)
    assert kept_state.damaged == {"x": "is bad"}


# Foreign files


def forged(path: Path, change: Callable[[h5py.File], None]) -> None:
    """Change a file with any HDF5 tool and give it a block that agrees with it."""
    with h5py.File(path, "r+") as file:
        change(file)
    body = path.read_bytes()[512:]
    path.write_bytes(image.user_block(body) + body)
    image.verify(path.read_bytes())


def external_link(file: h5py.File) -> None:
    del file["designs"]
    file["designs"] = h5py.ExternalLink("other.h5", "designs")


def soft_link(file: h5py.File) -> None:
    file.move("designs", "there")
    file["designs"] = h5py.SoftLink("/there")


def external_storage(file: h5py.File) -> None:
    del file["designs"]
    secret = Path(file.filename).parents[2] / "secret"
    secret.write_bytes(b"x" * 48)
    file.create_dataset("designs", (3, 2), "<f8", external=[(str(secret), 0, 48)])
    assert file["designs"][0, 0] != 0, "plain HDF5 does read it"


def virtual(file: h5py.File) -> None:
    del file["designs"]
    layout = h5py.VirtualLayout((3, 2), "<f8")
    layout[:] = h5py.VirtualSource("other.h5", "designs", (3, 2))
    file.create_virtual_dataset("designs", layout)


def filtered(file: h5py.File) -> None:
    del file["designs"]
    file.create_dataset("designs", data=batch(3).designs, chunks=(3, 2), compression="gzip")


def objects(file: h5py.File) -> None:
    file.create_dataset("more", data=["text"], dtype=h5py.string_dtype(), chunks=(1,))
    del file["settings"]
    file.move("more", "settings")


def references(file: h5py.File) -> None:
    file.attrs["chain_before"] = file.ref


def enormous(file: h5py.File) -> None:
    for name in ("designs", "origin", "outcome", "cause", "margins", "seconds"):
        dtype, width = file[name].dtype, file[name].shape[1:]
        del file[name]
        file.create_dataset(name, (10**12, *width), dtype, chunks=(1000, *width), fletcher32=True)
    file.attrs["last"] = np.bytes_(str(2 + 10**12 - 1))


def other_shape(file: h5py.File) -> None:
    del file["margins"]
    file.create_dataset("margins", data=np.zeros((3, 2)), chunks=(3, 2), fletcher32=True)


def other_type(file: h5py.File) -> None:
    del file["designs"]
    file.create_dataset("designs", data=np.zeros((3, 2), "<f4"), chunks=(3, 2), fletcher32=True)


def group(file: h5py.File) -> None:
    file.create_group("more")


def without_designs(file: h5py.File) -> None:
    del file["designs"]


def changed_value(file: h5py.File) -> None:
    file["designs"][0, 0] = 0.5


def wrong_sizes(file: h5py.File) -> None:
    file["size"][0] = 2


def nameless_outcome(file: h5py.File) -> None:
    file["outcome"][0] = 100


def nameless_cause(file: h5py.File) -> None:
    file["cause"][0] = 100


def not_a_number(file: h5py.File) -> None:
    file["designs"][1, 0] = np.nan


def wrong_schema(file: h5py.File) -> None:
    file["schema"][0] = b"[]"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (external_link, "ExternalLink 'designs'"),
        (soft_link, "SoftLink 'designs'"),
        (external_storage, "another file"),
        (virtual, "virtual"),
        (filtered, "filter other than fletcher32"),
        (objects, "declares 'settings' with type object"),
        (references, "attribute 'chain_before'"),
        (enormous, "more than the file holds"),
        (other_shape, "expected"),
        (other_type, "expected"),
        (group, "not a dataset"),
        (without_designs, "no dataset 'designs'"),
        (changed_value, "its chain"),
        (wrong_sizes, "in batches of [2]"),
        (nameless_outcome, "`-1 <= outcome < 2` must hold, got"),
        (nameless_cause, "`-5 <= cause < 2` must hold, got"),
        (not_a_number, "`designs` must be finite, got nan for 'radius' in row 1"),
        (wrong_schema, "has content that activefail never writes"),
    ],
)
def test_a_foreign_file_with_a_right_checksum_is_not_read(
    tmp_path: Path, change: Callable[[h5py.File], None], reason: str
) -> None:
    held = written(tmp_path / "run", 2, 3)
    path = segment_file(tmp_path / "run", 1)
    forged(path, change)
    with FolderStore.open(tmp_path / "run", SCHEMA, write=False) as store:
        assert contents(store) == held[:1]
        assert reason in store.warnings[0]


def test_foreign_states_and_sets_are_not_read_either(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        store.write_state(1, {"designs": batch(3).designs})
        store.write_set("test", batch(3).designs, batch(3).results)
        for change in (external_link, external_storage, virtual, filtered):
            for path in (folder / "state" / "000000001.h5", folder / "sets" / "test.h5"):
                whole = path.read_bytes()
                forged(path, change)
                assert (store.latest_state() if path.parent.name == "state" else store.read_set("test")) is None
                path.write_bytes(whole)
            assert store.latest_state() is not None
            assert store.read_set("test") is not None


@pytest.mark.parametrize("write", [True, False])
def test_links_to_files_elsewhere_are_refused_by_name(tmp_path: Path, write: bool) -> None:
    written(tmp_path / "run", 2, 3)
    path = segment_file(tmp_path / "run", 1)
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match=rf"segments/{path.name} is a symbolic link; activefail follows no links"):
        FolderStore.open(tmp_path / "run", SCHEMA, write=write)
