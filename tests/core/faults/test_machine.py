"""A machine that fails: full disks, limits, folders that cannot be written, clocks that jump, and a second process."""

import errno
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, record
from faults.harness import Course, Victim, Victims, few, finished
from faults.test_kills import assert_nothing_lost, begun
from faults.victim import COMMITS, opened

from activefail.errors import StoreError
from activefail.record.asked import Asked
from activefail.record.batch import ACTIVE
from activefail.record.run_folder import FolderStore

Survived = Callable[[], None]
Disk = Callable[[int], Path]

TINY = """
seed = 3
sampling = { initial = 20, budget = 30, batch = 5 }
simulator = { python = "plate:run", margins = ["g"] }
space = { x = { low = 0, high = 1 }, y = { low = 0, high = 1 } }
"""
"""A campaign whose run folder comes to some 30 kB."""


def write_tiny(folder: Path) -> None:
    """Write that campaign's file and its code."""
    (folder / "tiny.toml").write_text(TINY)
    (folder / "plate.py").write_text("def run(design):\n    return 1.3 - design['x'] - design['y']\n")


def test_a_disk_that_is_full_at_any_page_ends_the_campaign_with_the_reason_and_loses_nothing(
    small_disk: Disk, victims: Victims, uninterrupted: Course, every_fault: bool, survived: Survived
) -> None:
    ended = set()
    # A page of the disk is 4 kB; the campaign's folder needs some eight of them.
    for kilobytes in few(list(range(4, 60, 4)), every_fault, 4):
        disk = small_disk(kilobytes)
        victim = victims.start(disk / "run", "")
        victim.go_on()
        code = victim.end()
        ended.add(code)
        if code:
            assert code == 1, victim.reports
            assert re.search(rf"error Cannot .*{disk}.*No space left on device", victim.reports[-1]), victim.reports[-1]
        small_disk(2000)
        assert_nothing_lost(victim, disk / "run", uninterrupted)
        shutil.rmtree(disk / "run")
        survived()
    assert ended == {0, 1}


def test_on_a_full_disk_the_program_says_so_in_one_line_and_the_same_campaign_can_be_resumed(
    small_disk: Disk, tmp_path: Path
) -> None:
    write_tiny(tmp_path)
    assert activefail("run", tmp_path / "tiny.toml", "--out", tmp_path / "straight").code == 0
    disk = small_disk(300)
    (disk / "ballast").write_bytes(bytes(307_200 - 4 * 4096))
    result = activefail("run", tmp_path / "tiny.toml", "--out", disk / "run")
    assert result.code == 1
    (line,) = result.err.splitlines()
    assert line.startswith(f"activefail: Cannot write {disk / 'run'}")
    assert line.endswith("No space left on device. Existing data is intact. Fix the problem, then resume.")
    with FolderStore.open(disk / "run", write=False) as store:
        assert 0 < len(store.batches) < 6
    repeated = activefail("resume", disk / "run")
    assert repeated.code == 1
    assert "No space left on device" in repeated.err
    (disk / "ballast").unlink()
    assert activefail("resume", disk / "run").code == 0
    # The table would not fit on the disk with the run folder.
    shutil.move(disk / "run", tmp_path / "run")
    assert record(tmp_path / "run") == record(tmp_path / "straight")


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path): (path.lstat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
        for path in sorted(folder.rglob("*"))
    }


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_simulated(
    small_disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tiny(tmp_path)
    disk = small_disk(2000)
    assert activefail("run", tmp_path / "tiny.toml", "--out", disk / "run", "--budget", "22").code == 0
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    before = tree(disk)

    def simulated(*arguments: object) -> None:
        raise AssertionError("it simulates")

    monkeypatch.setattr("activefail.simulators.function.PythonSimulator.run", simulated)
    for words in (
        ["resume", disk / "run", "--budget", "30"],
        ["run", tmp_path / "tiny.toml", "--out", disk / "new"],
        ["verify", disk / "run"],
        ["compare", disk / "run"],
    ):
        result = activefail(*words)
        assert (result.code, result.out) == (1, ""), result
        (line,) = result.err.splitlines()
        assert re.match(rf"activefail: Cannot (write to|create) {disk}/\w+: Read-only file system", line), line
    # To read it needs no right to write.
    assert "22 of 22 simulations" in activefail("status", disk / "run").out
    assert activefail("export", disk / "run", "--csv", tmp_path / "all.csv").code == 0
    assert tree(disk) == before


MEETINGS = {
    # Whoever is second finds the lock taken, wherever the first one is; before the folder stands, too.
    None: [
        *((0, "set 1", second) for second in ("", "creation 1")),
        *((commits, first, "") for commits in range(COMMITS) for first in ("commit 1", "state 1", "closing 1")),
    ],
    # Without it the second one gets past the first, whose next event finds another end of the journal.
    "without locks": [
        (0, "set 1", ""),
        *((commits, "commit 1", second) for commits in range(1, COMMITS) for second in ("", "commit 1")),
    ],
}
"""How many batches there are before, where the first of two writers waits, and how far the second came before it."""


@pytest.mark.parametrize("fault", MEETINGS)
def test_two_processes_that_begin_or_go_on_with_a_campaign_at_once_are_one_writer_at_a_time(
    victims: Victims,
    uninterrupted: Course,
    tmp_path: Path,
    fault: str | None,
    every_fault: bool,
    survived: Survived,
) -> None:
    for number, (commits, place, before) in enumerate(few(MEETINGS[fault], every_fault)):
        folder = tmp_path / str(number)
        if commits:
            begun(folder, commits)
        second = victims.start(folder, before, fault=fault)
        first = victims.start(folder, place, fault=fault)
        second.go_on()
        code = second.end()
        first.go_on()
        codes = first.end(), code
        if fault is None:
            assert codes == (0, 1), (place, before, first.reports, second.reports)
            refusal = second.reports[-1]
            assert "Another process is writing to" in refusal or "is not empty" in refusal, refusal
        else:
            assert codes == (1, 0), (place, before, first.reports, second.reports)
            assert "error " in first.reports[-1]
        check_writers([first, second], folder, uninterrupted, fault)
        survived()


def check_writers(both: list[Victim], folder: Path, uninterrupted: Course, fault: str | None) -> None:
    """Assert that no batch was acknowledged to both of two writers, and that nothing is lost."""
    batches = [line for victim in both for line in victim.acknowledged if line.startswith("commit")]
    assert len(batches) == len(set(batches))
    for victim in both:
        assert_nothing_lost(victim, folder, uninterrupted, alone=fault is None)


def changes(store: FolderStore) -> dict[str, Callable[[], object]]:
    """Every way in which the program changes a run folder that is open."""
    one, kept = store.batches[-1], store.read_set("validation-0")
    assert kept is not None
    return {
        "commit": lambda: store.commit(one),
        "state": lambda: store.write_state(9, {"a": np.zeros(2)}),
        "set": lambda: store.write_set("validation-0", *kept),
        "result": lambda: store.remember(("a",), 1),
        "asked": lambda: store.hand_out(Asked.of(np.array([10**6]), one.designs[:1], ACTIVE, 0)),
    }


@pytest.mark.parametrize("change", ["commit", "state", "set", "result", "asked"])
@pytest.mark.parametrize("fate", ["moved", "moved and replaced", "removed and replaced"])
@pytest.mark.parametrize("locks", [True, False], ids=["locks", "no locks"])
def test_a_writer_whose_folder_went_elsewhere_changes_nothing_under_its_old_name(
    change: str,
    fate: str,
    locks: bool,
    uninterrupted: Course,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    survived: Survived,
) -> None:
    if not locks:
        monkeypatch.setattr("fcntl.flock", without_flock)
    folder, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    with opened(begun(folder, 2)) as store:
        changed = changes(store)
        folder.rename(elsewhere) if "moved" in fate else shutil.rmtree(folder)
        if "replaced" in fate:
            begun(folder, 1)
        before = tree(tmp_path)
        with pytest.raises(StoreError, match=r"was moved, removed or replaced while .* Nothing more is written"):
            changed[change]()
        for later in ("commit", "state", "set", "result"):
            with pytest.raises(StoreError, match=r"resume it at its new place; its committed batches are intact"):
                changed[later]()
        assert tree(tmp_path) == before
    for left in (folder, elsewhere):
        if left.exists():
            assert finished(left) == uninterrupted
    survived()


def without_flock(*arguments: object) -> None:
    raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
