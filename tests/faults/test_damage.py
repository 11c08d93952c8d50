"""Damaged, missing and foreign files: set aside or refused, and never taken for data."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from commandline import activefail
from faults.harness import Course, few, finished
from faults.test_kills import begun
from faults.victim import COMMITS
from record.test_store import (
    SCHEMA,
    SETTINGS,
    batch,
    contents,
    enormous,
    external_link,
    external_storage,
    filtered,
    forged,
    group,
    objects,
    other_type,
    references,
    segment_file,
    soft_link,
    virtual,
    written,
)

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import parse_settings
from activefail.errors import DamagedError, StoreError
from activefail.loop.initial import initial_designs
from activefail.record import hdf5 as image
from activefail.record.attachments import decode_set, decode_state
from activefail.record.batch import INITIAL, Batch
from activefail.record.run_folder import FolderStore
from activefail.record.segment import decode_segment

Survived = Callable[[int], None]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A record of three batches, three states and a set."""
    held = tmp_path / "run"
    with FolderStore.create(held, SETTINGS, SCHEMA) as store:
        for number in range(3):
            store.commit(batch(2, number, iteration=number))
            store.write_state(number, {"i": np.array(number)})
        store.write_set("test", batch(4).designs, batch(4).results)
    return held


def newest(folder: Path, kind: str) -> Path:
    return sorted((folder / kind).glob("*.h5"))[-1]


def kept(folder: Path) -> dict[str, object]:
    """What a reader finds."""
    with FolderStore.open(folder, SCHEMA, write=False) as store:
        state, side = store.latest_state(), store.read_set("test")
        return {
            "segments": contents(store),
            "state": None if state is None else (state[0], state[1]["i"].tolist()),
            "sets": None if side is None else (side[0].tobytes(), side[1].margins.tobytes()),
        }


def without_newest(whole: dict[str, object], kind: str) -> dict[str, object]:
    match kind:
        case "segments":
            # What was learned from the batch that is gone is not believed either.
            return whole | {"segments": whole["segments"][:-1], "state": (1, 1)}  # type: ignore[index]
        case "state":
            return whole | {"state": (1, 1)}
        case _:
            return whole | {"sets": None}


def decoded(path: Path) -> Callable[[bytes], object]:
    """What reads a file of this name, given its bytes."""
    match path.parent.name:
        case "segments":
            return lambda data: decode_segment(path.name, data)
        case "state":
            digest = image_attribute(path, "chain")
            return lambda data: decode_state(data, int(path.stem), {digest})
        case _:
            return lambda data: decode_set(data, SETTINGS)


def image_attribute(path: Path, name: str) -> str:
    with image.open_image(path.read_bytes()) as opened:
        return opened.attribute(name)


@pytest.mark.parametrize("kind", ["segments", "state", "sets"])
def test_a_file_cut_to_any_length_counts_for_nothing_and_takes_nothing_with_it(
    folder: Path, kind: str, every_fault: bool, survived: Survived
) -> None:
    whole, path = kept(folder), newest(folder, kind)
    data, read = path.read_bytes(), decoded(path)
    read(data)
    lengths = list(range(len(data)))
    for length in lengths:
        with pytest.raises(DamagedError):
            read(data[:length])
        survived(1)
    for length in few(lengths, False, 200 if every_fault else 15):
        path.write_bytes(data[:length])
        assert kept(folder) == without_newest(whole, kind), length
    path.write_bytes(data)
    assert kept(folder) == whole


@pytest.mark.parametrize("kind", ["segments", "state", "sets"])
def test_a_file_with_any_changed_bit_counts_for_nothing_and_takes_nothing_with_it(
    folder: Path, kind: str, every_fault: bool, survived: Survived
) -> None:
    whole, path = kept(folder), newest(folder, kind)
    data, read = bytearray(path.read_bytes()), decoded(path)
    bits = list(range(8 * len(data))) if every_fault else [8 * place + place % 8 for place in range(len(data))]
    for bit in bits:
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DamagedError):
            read(bytes(data))
        data[bit // 8] ^= 1 << bit % 8
        survived(1)
    for bit in few(bits, False, 200 if every_fault else 15):
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        assert kept(folder) == without_newest(whole, kind), bit
        data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    assert kept(folder) == whole


@pytest.mark.parametrize("kind", ["segments", "state", "sets"])
@pytest.mark.parametrize("fill", [b"\0", b"\xff"])
def test_a_page_that_the_disk_lost_is_noticed(folder: Path, kind: str, fill: bytes, survived: Survived) -> None:
    whole, path = kept(folder), newest(folder, kind)
    data = path.read_bytes()
    for first in range(0, len(data), 512):
        path.write_bytes(data[:first] + fill * len(data[first : first + 512]) + data[first + 512 :])
        if path.read_bytes() != data:
            assert kept(folder) == without_newest(whole, kind), first
            survived(1)


def test_settings_that_are_cut_or_have_any_changed_bit_are_refused(folder: Path, survived: Survived) -> None:
    path = folder / "campaign.toml"
    data = bytearray(path.read_bytes())
    for bit in range(8 * len(data)):
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        with pytest.raises(StoreError, match=r"settings were changed|no longer UTF-8"):
            FolderStore.open(folder, SCHEMA, write=True)
        data[bit // 8] ^= 1 << bit % 8
        survived(1)
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(StoreError, match="settings were changed"):
            FolderStore.open(folder, SCHEMA, write=True)
        survived(1)


@pytest.mark.parametrize("how", ["missing", "damaged"])
def test_any_segment_but_the_last_that_is_gone_is_refused_by_its_designs(
    tmp_path: Path, how: str, survived: Survived
) -> None:
    written(tmp_path / "whole", 2, 3, 4, 1)
    first = 0
    for index, size in enumerate((2, 3, 4)):
        folder = Path(shutil.copytree(tmp_path / "whole", tmp_path / str(index)))
        path = segment_file(folder, index)
        path.unlink() if how == "missing" else path.write_bytes(path.read_bytes()[::-1])
        for write in (True, False):
            with pytest.raises(StoreError, match=f"Designs {first} to {first + size - 1} are missing"):
                FolderStore.open(folder, SCHEMA, write=write)
        first += size
        survived(1)


def test_a_last_segment_that_is_gone_is_simulated_again_to_the_same_campaign(
    tmp_path: Path, uninterrupted: Course
) -> None:
    folder = begun(tmp_path / "run", COMMITS - 1, compact_at=64)
    newest(folder, "segments").unlink()
    with FolderStore.open(folder, write=False) as store:
        store.latest_state()
        assert any("was not learned from the batches of this record" in warning for warning in store.warnings)
    assert finished(folder) == uninterrupted


def enormous_designs(file: h5py.File) -> None:
    del file["designs"]
    file.create_dataset("designs", (10**12, 2), "<f8", chunks=(1000, 2), fletcher32=True)


FORGERIES = [external_link, soft_link, external_storage, virtual, filtered, group, enormous_designs]


@pytest.mark.parametrize(
    ("kind", "change"),
    [(kind, change) for kind in ("segments", "state", "sets") for change in FORGERIES]
    + [("segments", change) for change in (objects, references, other_type, enormous)],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_no_file_that_agrees_with_itself_makes_the_program_read_another_one_or_more_than_it_holds(
    tmp_path: Path, kind: str, change: Callable[..., None]
) -> None:
    folder = tmp_path / "run"
    with FolderStore.create(folder, SETTINGS, SCHEMA) as store:
        store.commit(batch(3))
        store.write_set("test", batch(3).designs, batch(3).results)
        store.write_state(1, {"designs": batch(3).designs})
    path = newest(folder, kind)
    forged(path, change)
    with FolderStore.open(folder, SCHEMA, write=False) as store:
        parts = {"segments": store.batches, "state": store.latest_state(), "sets": store.read_set("test")}
        assert not parts[kind]
        assert path.name in store.warnings[0]


def test_a_file_that_is_broken_in_any_way_and_agrees_with_itself_does_not_crash_the_program(
    tmp_path: Path, every_fault: bool, survived: Survived
) -> None:
    written(tmp_path / "run", 3)
    path = segment_file(tmp_path / "run", 0)
    body = path.read_bytes()[image.BLOCK_BYTES :]
    rng = np.random.default_rng(11)
    tries = 3000 if every_fault else 150
    # In a process of its own: HDF5 is a library in C.
    child = os.fork()
    if child == 0:
        code = 0
        for _ in range(tries):
            broken = bytearray(body)
            for place in rng.integers(0, len(body), rng.integers(1, 4)):
                broken[place] = rng.integers(0, 256)
            try:
                decode_segment(path.name, image.user_block(bytes(broken)) + broken)
            except StoreError:
                pass
            except BaseException:
                code = 1
                break
        os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    survived(tries)


@pytest.mark.parametrize("change", [*FORGERIES, enormous], ids=lambda change: change.__name__)
def test_a_foreign_run_folder_brings_no_command_to_a_traceback(tmp_path: Path, change: Callable[..., None]) -> None:
    campaign = Campaign.of(parse_settings("sampling = { initial = 20, budget = 30, batch = 5 }", "foreign"))
    folder = tmp_path / "run"
    with FolderStore.create(folder, campaign.settings.text(), campaign.schema) as store:
        for first in (0, 3):
            X = initial_designs(campaign)[first : first + 3]
            store.commit(Batch(0, X, np.full(3, INITIAL, dtype=np.int8), campaign.simulator.run(X)))
    path = newest(folder, "segments")
    forged(path, change)
    for command in (["status", folder], ["export", folder, "--csv", tmp_path / "out.csv"], ["resume", folder]):
        result = activefail(*command, *(["--budget", "3"] if command[0] == "resume" else []))
        assert result.code == 0, result.err
        assert result.err.startswith(f"warning: segments/{path.name} ")
        assert len([line for line in result.err.splitlines() if "initial designs without" not in line]) == 1
    assert path.with_name(f"{path.name}.quarantine").exists()
