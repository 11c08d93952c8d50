"""Simulations that go wrong: a worker's death costs nothing, a simulation's own fault costs that simulation."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Disc
from contracts.test_executor import Exhausted, Hanging, Killed, Leaving
from faults.harness import Course
from faults.simulators import Failing, OnceAt
from faults.victim import BUDGET, campaign

from activefail.campaign.campaign import Campaign
from activefail.campaign.executor import ProcessExecutor
from activefail.campaign.loop import run, standing
from activefail.campaign.simulator import NUMERICAL_FAILURE, Simulator, cause_name
from activefail.campaign.store import FolderStore
from activefail.errors import SimulationError


def on(simulator: Simulator, more: float = 0.05) -> Campaign:
    """The campaign that faults are tried on, with another simulator."""
    settings = campaign().settings.changed({"limits.numerical_failures": more})
    return Campaign.with_simulator(settings, simulator)


@pytest.mark.parametrize("fault", [Killed, Leaving, Hanging, Exhausted])
def test_workers_that_die_or_hang_now_and_then_change_no_bit_of_the_campaign(
    fault: type[Disc], uninterrupted: Course, tmp_path: Path, survived: Callable[[int], None]
) -> None:
    one = on(OnceAt(fault=fault(), folder=str(tmp_path), every=2))
    with (
        FolderStore.create(tmp_path / "run", campaign().settings.text(), one.schema) as store,
        ProcessExecutor(2, time_limit=2.0) as executor,
    ):
        assert run(one, store, executor, BUDGET)
        assert Course.of(store) == uninterrupted
        assert executor.first_fault == ""
    faults = len(list(tmp_path.glob("at-*")))
    assert faults > 2
    survived(faults)


@pytest.mark.parametrize(
    ("how", "cause", "says"),
    [
        ("raises", "raised", "ValueError: no convergence"),
        ("nan", "unusable_answer", "got outcome nan"),
        ("hangs", "time_limit", "it took longer than 0.5 s, twice"),
        ("dies", "worker_died", "its worker process died (SIGKILL, out of memory perhaps), twice"),
        ("memory", "out_of_memory", "MemoryError"),
    ],
)
def test_a_simulator_that_fails_in_a_region_is_recorded_there_and_stopped_above_the_rate_that_was_set(
    how: str, cause: str, says: str, tmp_path: Path
) -> None:
    one = on(Failing(how=how, below=-1.0), 0.1)
    one = Campaign.with_simulator(
        one.settings.changed({"sampling.initial": 20, "sampling.budget": 24, "validation.size": 0}), one.simulator
    )
    began = time.monotonic()
    with (
        FolderStore.create(tmp_path / "run", one.settings.text(), one.schema) as store,
        # Short only where it is reached: on a busy machine a process takes a while to die.
        ProcessExecutor(2, time_limit=0.5 if how == "hangs" else 60.0) as executor,
    ):
        with pytest.raises(SimulationError, match=r"limits\.numerical_failures allows") as stopped:
            run(one, store, executor, 24)
        assert says in str(stopped.value)
        progress = standing(one, store.batches, 24)
        assert progress.done < 24
        X = np.concatenate([batch.designs for batch in store.batches])
        outcome = np.concatenate([batch.results.outcome for batch in store.batches])
        causes = np.concatenate([batch.results.cause for batch in store.batches])
        assert ((outcome == NUMERICAL_FAILURE) == (X[:, 0] < -1.0)).all()
        assert {cause_name(Disc.causes, code) for code in causes[X[:, 0] < -1.0].tolist()} == {cause}
        # Allowed more, it goes on with what it has.
        assert run(one, store, executor, 24, failure_limit=0.9)
        assert standing(one, store.batches, 24).done == 24
    assert time.monotonic() - began < 300.0
