"""Damaged files of a run folder: dropped, refused by their place or learned again, and never taken for data."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail
from faults.harness import Course, few, finished
from faults.test_kills import begun
from faults.victim import COMMITS
from pounding import write_campaign
from record.test_run_folder import SCHEMA, SETTINGS, WRITES, batch, contents, entries

from activefail.errors import StoreError
from activefail.record.checkpoint import decode
from activefail.record.run_folder import FolderStore

Survived = Callable[[int], None]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A record with events of every kind; a batch is the last."""
    held = tmp_path / "run"
    with FolderStore.create(held, SETTINGS, SCHEMA, provenance={"numpy": "2.4"}) as store:
        for number in range(2):
            store.commit(batch(2, number))
        for write in WRITES.values():
            write(store)
        store.commit(batch(2, 3, iteration=1))
        store.write_state(3, {"i": np.array(3), "sites": np.arange(6.0)})
    return held


def kept(folder: Path, write: bool = False) -> dict[str, object]:
    """What a store finds."""
    with FolderStore.open(folder, SCHEMA, write=write) as store:
        state, side = store.latest_state(), store.read_set("test")
        return {
            "batches": contents(store),
            "asked": store.asked.designs.tobytes(),
            "corrections": store.corrections.results.margins.tobytes(),
            "state": None if state is None else (state[0], {name: a.tobytes() for name, a in state[1].items()}),
            "set": None if side is None else (side[0].tobytes(), side[1].margins.tobytes()),
            "result": store.recall(("a", "b")),
        }


def check_damaged(folder: Path, whole: dict[str, object], first_damage: int, places: list[int]) -> None:
    """Assert that a journal damaged at a byte counts up to its last entry, or is refused by the entry's place."""
    if first_damage < places[-2]:
        at = max((place for place in places if place <= first_damage), default=0)
        for write in (False, True):
            with pytest.raises(StoreError) as caught:
                FolderStore.open(folder, SCHEMA, write=write)
            expected = f"journal, byte {at}: the entry" if at else "this version of activefail cannot read it"
            assert expected in str(caught.value)
    else:
        assert kept(folder) == whole | {"batches": whole["batches"][:-1], "state": None}  # type: ignore[index]


def cut_at_entries(folder: Path) -> dict[int, dict[str, object]]:
    """What a store finds in a journal that ends after an entry, by its length."""
    path, data = folder / "journal", (folder / "journal").read_bytes()
    found = {}
    for place in entries(folder)[1:]:
        path.write_bytes(data[:place])
        found[place] = kept(folder)
    return found


def test_a_journal_cut_to_any_length_counts_up_to_its_last_whole_entry(folder: Path, survived: Survived) -> None:
    path, data = folder / "journal", (folder / "journal").read_bytes()
    found = cut_at_entries(folder)
    assert len({repr(one) for one in found.values()}) == len(found) - 1  # the first one changes nothing but provenance
    for length in range(len(data)):
        path.write_bytes(data[:length])
        if length < min(found):
            with pytest.raises(StoreError, match="journal"):
                FolderStore.open(folder, SCHEMA, write=False)
        else:
            assert kept(folder) == found[max(place for place in found if place <= length)]
        survived(1)


def test_a_journal_with_any_changed_bit_is_refused_by_its_place_or_loses_its_last_entry(
    folder: Path, every_fault: bool, survived: Survived
) -> None:
    whole, path, places = kept(folder), folder / "journal", entries(folder)
    data = bytearray(path.read_bytes())
    bits = list(range(8 * len(data))) if every_fault else [8 * place + place % 8 for place in range(0, len(data), 7)]
    for bit in bits:
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        check_damaged(folder, whole, bit // 8, places)
        data[bit // 8] ^= 1 << bit % 8
        survived(1)
    path.write_bytes(data)
    assert kept(folder) == whole


@pytest.mark.parametrize("fill", [b"\0", b"\xff"])
def test_a_page_that_the_disk_lost_is_noticed(folder: Path, fill: bytes, survived: Survived) -> None:
    path, data = folder / "journal", (folder / "journal").read_bytes()
    found = cut_at_entries(folder)
    for first in range(0, len(data), 512):
        path.write_bytes(data[:first] + fill * len(data[first : first + 512]) + data[first + 512 :])
        if first < min(found) or any(first + 512 <= place < len(data) for place in found):
            with pytest.raises(StoreError, match="journal"):
                FolderStore.open(folder, SCHEMA, write=False)
        else:
            assert kept(folder) == found[max(place for place in found if place <= first)]
        survived(1)


def test_what_follows_the_last_entry_is_set_aside_and_the_campaign_goes_on(folder: Path) -> None:
    path = folder / "journal"
    for number in (1, 2):
        data, last = path.read_bytes(), entries(folder)[-2]
        path.write_bytes(data[:-3])
        with FolderStore.open(folder, SCHEMA, write=False) as store:
            assert store.warnings == ()  # another process may be writing it
        with FolderStore.open(folder, SCHEMA, write=True, provenance={"numpy": "2.4"}) as store:
            says = f"journal, byte {last}: the last entry is incomplete; it was moved to journal.quarantine."
            assert store.warnings[0].startswith(says)
            store.commit(batch(2, 3, iteration=1))
        quarantined = (folder / "journal.quarantine").read_bytes()
        assert quarantined.endswith(data[last:-3])
        assert quarantined.count(b"activefail ") == number
        assert path.read_bytes() == data
        assert kept(folder, write=True)["result"] == {"value": 1.5}


def test_a_checkpoint_with_any_damage_is_learned_again(folder: Path, every_fault: bool, survived: Survived) -> None:
    whole, path = kept(folder), folder / "checkpoint.h5"
    data = bytearray(path.read_bytes())
    bits = list(range(8 * len(data))) if every_fault else [8 * place + place % 8 for place in range(len(data))]
    for bit in bits:
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(StoreError):
            decode(bytes(data))
        data[bit // 8] ^= 1 << bit % 8
        survived(1)
    for length in range(len(data)):
        with pytest.raises(StoreError):
            decode(bytes(data[:length]))
        survived(1)
    for length in few(list(range(len(data))), False, 15):
        path.write_bytes(data[:length])
        assert kept(folder) == whole | {"state": None}
    path.write_bytes(data)
    assert kept(folder) == whole


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


def test_a_last_batch_that_is_damaged_is_simulated_again_to_the_same_campaign(
    tmp_path: Path, uninterrupted: Course, survived: Survived
) -> None:
    begun(tmp_path / "base", COMMITS - 1)
    for damage in ("cut", "altered"):
        folder = Path(shutil.copytree(tmp_path / "base", tmp_path / damage))
        path = folder / "journal"
        data = path.read_bytes()
        path.write_bytes(data[:-1] if damage == "cut" else data[:-1] + bytes([data[-1] ^ 1]))
        assert finished(folder) == uninterrupted
        survived(1)


def test_a_damaged_folder_brings_no_command_to_a_traceback(tmp_path: Path) -> None:
    write_campaign(tmp_path / "tiny.toml", "sampling = { initial = 20, budget = 30, batch = 5 }\n")
    folder = tmp_path / "run"
    assert activefail("run", tmp_path / "tiny.toml", "--out", folder, "--budget", "22").code == 0
    path, places = folder / "journal", entries(folder)
    data = path.read_bytes()
    for damage, code in ((places[2] + 200, 1), (len(data) - 1, 0)):
        path.write_bytes(data[:damage] + bytes([data[damage] ^ 1]) + data[damage + 1 :])
        for command in (["status", folder], ["export", folder, "--csv", tmp_path / "out.csv"], ["resume", folder]):
            result = activefail(*command, *(["--budget", "22"] if command[0] == "resume" else []))
            assert result.code == code, result.err
            assert f"journal, byte {places[-2] if code == 0 else places[2]}: the " in result.err
            assert "Traceback" not in result.err
