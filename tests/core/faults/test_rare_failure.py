"""A search for rare failure, killed at random moments again and again: the same designs, results and states."""

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cases import some
from commandline import activefail, record, started
from patience import until

from activefail.record.run_folder import FolderStore

CAMPAIGN = """
seed = {seed}
simulator = {{ python = "limit:{name}", margins = ["g"] }}
stop = {{ probability = "failure" }}
[space]
x = {{ distribution = "normal", mean = 0, sd = 1 }}
y = {{ distribution = "lognormal", mean = 1, sd = 0.2 }}
[sampling]
batch = {batch}
budget = 45
"""

LIMITS = """
def bent(design):
    return 3.5 - design["x"] - 0.4 * design["y"] ** 2

def truncated(design):
    return max(0.0, bent(design))
"""


def learned(folder: Path) -> dict[str, bytes]:
    with FolderStore.open(folder, write=False) as store:
        state = store.latest_state()
    assert state is not None
    return {"iteration": bytes(state[0]), **{name: array.tobytes() for name, array in state[1].items()}}


def recorded(folder: Path) -> int:
    if not (folder / "campaign.toml").exists():
        return 0
    with FolderStore.open(folder, write=False) as store:
        return sum(map(len, store.batches))


def wait_for_more(process: subprocess.Popen[str], folder: Path, before: int) -> None:
    until(lambda: process.poll() is not None or recorded(folder) > before, "a batch, or the campaign's end")


@pytest.mark.parametrize(("name", "batch"), some([("bent", 1), ("truncated", 4)], ("truncated", 4)))
def test_killed_at_random_it_is_resumed_to_the_same_bits(
    tmp_path: Path, name: str, batch: int, every_fault: bool, survived: Callable[[], None]
) -> None:
    (tmp_path / "limit.py").write_text(LIMITS)
    file, kills, rng = tmp_path / "made.toml", 10 if every_fault else 2, np.random.default_rng(batch)
    file.write_text(CAMPAIGN.format(name=name, seed=3, batch=batch))
    assert activefail("run", file, "--out", tmp_path / "whole").code == 0
    folder, words = tmp_path / "killed", ("run", file, "--out", tmp_path / "killed")
    for _ in range(kills):
        with started(*words) as process:
            wait_for_more(process, folder, recorded(folder))
            # Anywhere in the next iterations: while it looks, learns, proposes, records or checks.
            time.sleep(rng.uniform(0.0, 0.3))
            process.kill()
            killed = process.wait() == -signal.SIGKILL
        if killed:
            survived()
        if (folder / "campaign.toml").exists():
            words = ("resume", folder, "--code", tmp_path)
    result = activefail("resume", folder, "--code", tmp_path)
    assert result.code == 0, result.err
    assert record(folder) == record(tmp_path / "whole")
    assert "check" in {row["origin"] for row in record(folder)}
    assert learned(folder) == learned(tmp_path / "whole")
