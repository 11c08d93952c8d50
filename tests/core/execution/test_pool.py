"""Pools of processes: what they promise, whatever ends their block."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from patience import until

from activefail.errors import SimulationError
from activefail.execution.pool import ProcessPool
from activefail.execution.worker import stopping


def note(path: Path) -> None:
    with path.open("a") as file:
        file.write(f"{os.getpid()} ")


def sleep(path: Path) -> None:
    note(path)
    time.sleep(600.0)


def wait_until_asked(path: Path) -> str:
    note(path)
    while not stopping():
        time.sleep(0.01)
    return "stopped"


def noted(path: Path, number: int) -> list[int]:
    """The processes that have noted themselves, once they are so many."""
    until(lambda: path.exists() and len(path.read_text().split()) >= number, f"{number} processes")
    return [int(pid) for pid in path.read_text().split()]


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def test_calls_are_computed_in_other_processes_which_nobody_has_asked_to_stop() -> None:
    with ProcessPool(2, "nothing is kept") as pool:
        assert [pool.submit(divmod, n, 3).result() for n in range(4)] == [(0, 0), (0, 1), (0, 2), (1, 0)]
        assert pool.submit(os.getpid).result() != os.getpid()
        assert not pool.submit(stopping).result()
    assert not stopping()


def test_every_process_hears_that_it_is_asked_to_stop(tmp_path: Path) -> None:
    with ProcessPool(2, "nothing is kept") as pool:
        calls = [pool.submit(wait_until_asked, tmp_path / "pids") for _ in range(2)]
        noted(tmp_path / "pids", 2)
        pool.ask_to_stop()
        assert [call.result() for call in calls] == ["stopped", "stopped"]


def test_calls_that_wait_at_the_end_of_the_block_are_cancelled(tmp_path: Path) -> None:
    with ProcessPool(1, "nothing is kept") as pool:
        calls = [pool.submit(wait_until_asked, tmp_path / "pids") for _ in range(20)]
        noted(tmp_path / "pids", 1)
        pool.ask_to_stop()
    assert calls[0].result() == "stopped"
    assert calls[-1].cancelled()


def test_an_exception_that_leaves_the_block_ends_the_processes_at_once(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), ProcessPool(2, "nothing is kept") as pool:  # noqa: PT012
        for _ in range(2):
            pool.submit(sleep, tmp_path / "pids")
        pids = noted(tmp_path / "pids", 2)
        raise KeyboardInterrupt
    assert all(is_gone(pid) for pid in pids)


@pytest.mark.parametrize("victim", [0, 1])
def test_a_process_that_dies_is_an_error_that_says_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, victim: int
) -> None:
    # With a slow start, the executor's thread waits before it knows the second process.
    spawn = ProcessPoolExecutor._spawn_process
    monkeypatch.setattr(ProcessPoolExecutor, "_spawn_process", lambda self: (time.sleep(0.5), spawn(self)))
    kept = "A worker process died (killed, or out of memory); two of three are kept."
    with pytest.raises(SimulationError) as died, ProcessPool(2, "two of three are kept") as pool:  # noqa: PT012
        calls = [pool.submit(sleep, tmp_path / "pids") for _ in range(2)]
        os.kill(noted(tmp_path / "pids", 2)[victim], signal.SIGKILL)
        for call in calls:
            call.result()
    assert str(died.value) == kept


def test_the_processes_of_a_program_that_is_killed_end(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import sys\nfrom pathlib import Path\n"
        f"sys.path.extend({[str(Path(__file__).parents[place]) for place in (1, 2)]!r})\n"
        "from activefail.execution.pool import ProcessPool\nfrom execution.test_pool import sleep\n"
        "if __name__ == '__main__':\n"
        "    with ProcessPool(2, '') as pool:\n"
        f"        calls = [pool.submit(sleep, Path({str(tmp_path / 'pids')!r})) for _ in range(2)]\n"
        "        calls[0].result()\n"
    )
    with subprocess.Popen([sys.executable, program]) as process:
        pids = noted(tmp_path / "pids", 2)
        process.kill()
    for pid in pids:
        until(lambda pid=pid: is_gone(pid), "the end of what it had started")
