"""`ask`, `tell`, `drop`, `add` and corrections killed or refused at every system call: nothing acknowledged is lost."""

import errno
import os
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cases import some
from faults.harness import Victim, Victims, few, traced
from faults.test_kills import REFUSALS, calls_of
from faults.victim import campaign, elsewhere, opened

from activefail.loop.in_flight import HandedOut
from activefail.record.batch import columns_of
from activefail.record.labels import labels_of
from activefail.record.run_folder import FolderStore
from activefail.text.files import TEMPORARY

PLACES = ("ask 1", "ask 3", "tell 1", "tell 5", "drop 1", "add 1", "correct 1", "correct 2")
"""The first design, designs that a classifier proposes, results of both kinds, and one of each other kind."""


def rows(folder: Path) -> list[bytes]:
    """Every bit of the simulations, their labels, the list of designs that were handed out, and the corrections."""
    with FolderStore.open(folder, write=False) as store:
        asked = store.asked
        columns = [columns_of(batch) | {"iteration": np.full(len(batch), batch.iteration)} for batch in store.batches]
        simulated = [np.concatenate([one[name] for one in columns]).tobytes() for name in columns[0]]
        corrected = store.corrections.place.tobytes() + store.corrections.results.outcome.tobytes()
        notes = repr(labels_of(store, np.concatenate([one["id"] for one in columns]))).encode()
        return [*simulated, asked.id.tobytes(), asked.designs.tobytes(), asked.dropped.tobytes(), corrected, notes]


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
        told = set(handed_out.asked.id[np.isin(handed_out.asked.id, handed_out.history.id)].tolist())
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
    assert len(calls) > 5
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
    assert len(faults) > 5
    for call, number, error in few(faults, every_fault, 4):
        folder = tmp_path / f"{place.split()[0]}-{call}-{number}-{error}"
        victim = victims.start(folder, place, fault="elsewhere")
        trace = tmp_path / "refused"
        inject = f"inject={call}:error={error}:when={number}"
        with traced(victim.pid, "-e", f"trace={call},write,fsync,rename", "-e", inject, "-o", str(trace)):
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
            after = [line for line in lines[at + 1 :] if re.match(r"(fsync|rename)\(|write\(\d+, \"activefail", line)]
            assert after == []
        assert_nothing_lost(victim, folder, whole)
        shutil.rmtree(folder)
        survived()
