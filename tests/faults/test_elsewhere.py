"""`ask`, `tell`, `drop`, `add` and corrections killed or refused at every system call: nothing acknowledged is lost."""

import errno
import os
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import some
from faults.harness import Victim, Victims, few, traced
from faults.test_kills import REFUSALS, calls_of
from faults.victim import campaign, elsewhere, opened

from activefail.errors import DamagedError, StoreError
from activefail.files import TEMPORARY
from activefail.findings.summary import read_summary
from activefail.loop.asking import ask, correct, tell
from activefail.loop.in_flight import HandedOut
from activefail.record.asked import decode_asked
from activefail.record.batch import columns_of
from activefail.record.corrections import decode_corrections
from activefail.record.layout import ASKED, CORRECTIONS
from activefail.record.run_folder import FolderStore

PLACES = ("ask 1", "ask 3", "tell 1", "tell 5", "drop 1", "add 1", "correct 1", "correct 2")
"""The first design, designs that a classifier proposes, results of both kinds, and one of each other kind."""


def rows(folder: Path) -> list[bytes]:
    """Every bit of the simulations, of the list of designs that were handed out, and of the corrections."""
    with FolderStore.open(folder, write=False) as store:
        asked = store.asked
        columns = [columns_of(batch) | {"iteration": np.full(len(batch), batch.iteration)} for batch in store.batches]
        simulated = [np.concatenate([one[name] for one in columns]).tobytes() for name in columns[0]]
        corrected = store.corrections.digest.encode()
        return [*simulated, asked.id.tobytes(), asked.designs.tobytes(), asked.dropped.tobytes(), corrected]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """What an uninterrupted campaign holds."""
    folder = tmp_path_factory.mktemp("elsewhere") / "run"
    with opened(folder) as store:
        elsewhere(store)
    return rows(folder)


def assert_nothing_lost(victim: Victim, folder: Path, whole: list[bytes]) -> None:
    """Assert that what was acknowledged is there, once, and that the campaign continues as if nothing had happened."""
    with FolderStore.open(folder, campaign().schema, write=False) as store:
        handed_out = HandedOut.of(store)
        asked = set(handed_out.asked.id.tolist())
        told = set(handed_out.asked.id[handed_out.has_result].tolist())
        dropped = set(handed_out.asked.id[handed_out.asked.dropped == 1].tolist())
        for line in victim.reports:
            word, *ids = line.split()
            if word == "corrected":
                assert len(store.corrections) >= int(ids[0]), line
            held = {"asked": asked, "told": told, "dropped": dropped}.get(word)
            if held is not None:
                assert {int(number) for number in ids} <= held, (line, asked, told, dropped)
        assert len(np.unique(handed_out.asked.designs, axis=0)) == len(handed_out.asked)
        if "added" in victim.reports:
            assert len(handed_out.history) == len(told) + 1
    with opened(folder) as store:
        elsewhere(store)
        assert store.warnings == ()
    assert rows(folder) == whole
    assert not [path.name for path in folder.rglob("*") if path.name.startswith(TEMPORARY)]


@pytest.mark.usefixtures("strace")
@pytest.mark.parametrize("place", some(PLACES, "ask 3", "tell 5", "correct 2"))
def test_killed_at_any_system_call_nothing_acknowledged_is_lost_and_no_design_is_handed_out_twice(
    place: str,
    victims: Victims,
    whole: list[bytes],
    tmp_path: Path,
    every_fault: bool,
    survived: Callable[[], None],
) -> None:
    calls = calls_of(victims, (tmp_path / "none", place), tmp_path, "elsewhere")
    assert len(calls) > 10
    name = place.split()[0]
    for call, number in few(calls, every_fault, 4):
        folder = tmp_path / f"{name}-{call}-{number}"
        for _ in range(3):
            shutil.rmtree(folder, ignore_errors=True)
            victim = victims.start(folder, place, fault="elsewhere")
            trace = tmp_path / "killed"
            inject = f"inject={call}:signal=SIGKILL:when={number}"
            with traced(victim.pid, "-e", f"trace={call},access", "-e", inject, "-o", str(trace)):
                victim.go_on()
                assert victim.end() == -signal.SIGKILL
            marks = [line for line in trace.read_text().splitlines() if f"/-/{name}/" in line]
            if len(marks) == 1:
                break
        assert len(marks) == 1, f"killed elsewhere, at call {number} of {call}"
        assert_nothing_lost(victim, folder, whole)
        shutil.rmtree(folder)
        survived()


@pytest.mark.usefixtures("strace")
@pytest.mark.parametrize("place", some(PLACES, "ask 3", "tell 5", "correct 2"))
def test_refused_any_system_call_nothing_acknowledged_is_lost_and_no_design_is_handed_out_twice(
    place: str,
    victims: Victims,
    whole: list[bytes],
    tmp_path: Path,
    every_fault: bool,
    survived: Callable[[], None],
) -> None:
    calls = calls_of(victims, (tmp_path / "none", place), tmp_path, "elsewhere")
    faults = [(call, number, error) for call, number in calls for error in REFUSALS.get(call, ())]
    assert len(faults) > 10
    for call, number, error in few(faults, every_fault, 4):
        folder = tmp_path / f"{place.split()[0]}-{call}-{number}-{error}"
        victim = victims.start(folder, place, fault="elsewhere")
        trace = tmp_path / "refused"
        inject = f"inject={call}:error={error}:when={number}"
        with traced(victim.pid, "-e", f"trace={call},write,fsync,link,rename", "-e", inject, "-o", str(trace)):
            victim.go_on()
            code = victim.end()
        lines = trace.read_text().splitlines()
        (at,) = [index for index, line in enumerate(lines) if "(INJECTED)" in line]
        assert code in (0, 1), (call, number, error, victim.reports)
        if code == 1:
            assert str(folder) in victim.reports[-1], victim.reports[-1]
            assert os.strerror(getattr(errno, error)) in victim.reports[-1], victim.reports[-1]
        if call == "fsync":
            assert code == 1
            after = [
                line for line in lines[at + 1 :] if re.match(r"(fsync|link|rename)\(|write\(\d+, \"activefail", line)
            ]
            assert after == []
        assert_nothing_lost(victim, folder, whole)
        shutil.rmtree(folder)
        survived()


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """A run folder with designs in flight."""
    folder = tmp_path / "run"
    with opened(folder) as store:
        elsewhere(store)
    return folder


def test_a_damaged_list_of_designs_is_never_read_as_another_one(
    begun: Path, every_fault: bool, survived: Callable[[], None]
) -> None:
    path = begun / ASKED
    data = path.read_bytes()
    for position in few(list(range(8 * len(data))), False, 4000 if every_fault else 200):
        spoilt = bytearray(data)
        spoilt[position // 8] ^= 1 << (position % 8)
        with pytest.raises(StoreError):
            decode_asked(bytes(spoilt), "", 2)
        survived()
    for length in few(list(range(len(data))), False, 400 if every_fault else 50):
        path.write_bytes(data[:length])
        with FolderStore.open(begun, write=False) as store, pytest.raises(StoreError, match="It lists the designs in"):
            store.asked
        survived()


def test_a_list_of_another_campaign_is_refused(begun: Path) -> None:
    with FolderStore.open(begun, write=False) as store:
        data, start = (begun / ASKED).read_bytes(), store.segments[0].before
    assert len(decode_asked(data, start, 2)[0]) > 6
    with pytest.raises(DamagedError, match="belongs to another campaign"):
        decode_asked(data, "0" * 64, 2)
    with pytest.raises(DamagedError, match="declares 'designs'"):
        decode_asked(data, start, 3)


def test_damaged_corrections_are_refused_and_so_is_a_list_that_is_gone_or_older(
    begun: Path, every_fault: bool, survived: Callable[[], None]
) -> None:
    path = begun / CORRECTIONS
    data = path.read_bytes()
    for position in few(list(range(8 * len(data))), False, 4000 if every_fault else 100):
        spoilt = bytearray(data)
        spoilt[position // 8] ^= 1 << (position % 8)
        path.write_bytes(bytes(spoilt))
        with pytest.raises(StoreError):
            FolderStore.open(begun, write=False)
        survived()
    path.write_bytes(data[:100])
    with pytest.raises(StoreError, match=r"lists corrected results\. Restore it from a copy"):
        FolderStore.open(begun, write=False)
    path.unlink()
    with pytest.raises(StoreError, match="results that were corrected would be wrong again"):
        FolderStore.open(begun, write=False)
    assert read_summary(begun) is None


def test_corrections_of_another_campaign_are_refused(begun: Path) -> None:
    data = (begun / CORRECTIONS).read_bytes()
    with FolderStore.open(begun, write=False) as store:
        start = store.segments[0].before
    assert len(decode_corrections(data, start, campaign().schema)) == 4
    with pytest.raises(DamagedError, match="belongs to another campaign"):
        decode_corrections(data, "0" * 64, campaign().schema)


def test_a_correction_whose_batch_was_lost_is_not_applied_to_another_result(begun: Path) -> None:
    with opened(begun) as store:
        handed_out = HandedOut.of(store)
        last = handed_out.ids[-1:]
        kept = rows(begun)
        result = store.batches[-1].results[-1:]
        correct(campaign(), store, last, replace(result, outcome=(1 - result.outcome).astype(np.int8)))
    assert rows(begun) != kept
    former = (begun / CORRECTIONS).read_bytes()
    segment = max((begun / "segments").iterdir())
    segment.write_bytes(segment.read_bytes()[:-1])
    with FolderStore.open(begun, campaign().schema, write=False) as store:
        assert not [text for text in store.warnings if "corrections" in text]
        left = len(store.corrections)
    with opened(begun) as store:
        assert any(
            "1 of the corrections were removed, because the results that they replaced were lost" in text
            for text in store.warnings
        )
        assert len(store.corrections) == left == 4
        # The same place, the same design, the same result as the one that was corrected.
        tell(campaign(), store, last, result)
        assert store.batches[-1].results.outcome[-1:].tobytes() == result.outcome.tobytes()
    with opened(begun) as store:
        assert store.warnings == ()
        assert len(store.corrections) == left
    assert (begun / f"{CORRECTIONS}.quarantine").read_bytes() == former


def test_all_corrections_may_be_lost(tmp_path: Path) -> None:
    with opened(tmp_path / "run") as store:
        designs = ask(campaign(), store, 2, 12).designs
        tell(campaign(), store, designs.id, campaign().simulator.run(designs.designs))
        result = store.batches[0].results[:1]
        correct(campaign(), store, designs.id[:1], replace(result, outcome=(1 - result.outcome).astype(np.int8)))
    (segment,) = (tmp_path / "run" / "segments").iterdir()
    segment.write_bytes(b"")
    for warned in (True, False):
        with opened(tmp_path / "run") as store:
            assert len(store.corrections) == 0
            assert len([text for text in store.warnings if "lost" in text]) == warned
