"""Simulations that go wrong: a worker's death costs nothing, a simulation's own fault costs that simulation."""

import errno
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Disc
from cases import exhaustive, some
from contracts.test_executor import Acting, Exhausted, Hanging, Killed, bits, designs, given_up, wait_until, within
from contracts.test_executor import Leaving as Exiting
from faults.harness import Course
from faults.simulators import Failing, Leaving, Meddling, OnceAt, Remembering, Unusual
from faults.victim import BUDGET, campaign

from activefail.campaign.assembly import Campaign
from activefail.errors import SimulationError
from activefail.execution.executor import Executor
from activefail.execution.local import ProcessExecutor, ThreadExecutor
from activefail.loop.history import History
from activefail.loop.progress import Observer, standing
from activefail.loop.running import run
from activefail.record.run_folder import FolderStore
from activefail.simulators.interface import NUMERICAL_FAILURE, Simulator, cause_name
from activefail.space.space import Array


def on(simulator: Simulator, extra: float = 0.05) -> Campaign:
    """The campaign that faults are tried on, with another simulator."""
    settings = campaign().settings.changed({"limits.numerical_failures": extra})
    return Campaign.of(settings, simulator=simulator)


@dataclass(frozen=True)
class Base(Acting):
    """Raises an error that is no Exception."""

    error: type[BaseException] = BaseException

    def act(self) -> None:
        raise self.error("stopped")


class Panic(BaseException):
    """An error like those that Rust code raises in Python."""


@pytest.mark.parametrize("error", [KeyboardInterrupt, Panic])
@pytest.mark.parametrize("make", [lambda: ProcessExecutor(2), lambda: ThreadExecutor(2)], ids=["processes", "threads"])
def test_an_error_that_is_no_exception_is_a_simulation_that_raised(
    make: Callable[[], Executor],
    error: type[BaseException],
    capfd: pytest.CaptureFixture[str],
    survived: Callable[[int], None],
) -> None:
    X = at([3], 6)
    with within(600), make() as executor:
        results = executor.run(Base(error=error), X)
        given_up(results, X, [3], "raised")
        assert f"{error.__name__}: stopped" in results.faults[3]
    assert capfd.readouterr() == ("", "")
    survived(1)


BELOW = 1.2
"""Most designs fail below it: of fewer, those among others that failed would be excused."""


@pytest.mark.parametrize(
    ("how", "cause", "says"),
    [
        ("raises", "raised", "ValueError: no convergence"),
        ("nan", "unusable_answer", "got outcome nan"),
        exhaustive(("hangs", "time_limit", "it took longer than 2 s, twice")),
        ("dies", "worker_died", "its worker process died (SIGKILL, possibly out of memory), twice"),
        ("memory", "out_of_memory", "MemoryError"),
    ],
)
def test_a_simulator_that_fails_in_a_region_is_recorded_there_and_stopped_above_the_rate_that_was_set(
    how: str, cause: str, says: str, tmp_path: Path
) -> None:
    one = on(Failing(how=how, below=BELOW), 0.1)
    fewer = one.settings.changed({"sampling.initial": 20, "sampling.budget": 24, "validation.size": 0})
    one = Campaign.of(fewer, simulator=one.simulator)
    with (
        FolderStore.create(tmp_path / "run", one.settings.text(), one.schema) as store,
        # Short only where it is reached: on a busy machine a process takes a while to die.
        ProcessExecutor(2, time_limit=2.0 if how == "hangs" else 600.0) as executor,
    ):
        with pytest.raises(SimulationError, match=r"limits\.numerical_failures allows") as stopped:
            run(one, store, executor, 24)
        assert says in str(stopped.value)
        progress = standing(one, History.of(store.batches), 24)
        assert progress.done < 24
        X = np.concatenate([batch.designs for batch in store.batches])
        outcome = np.concatenate([batch.results.outcome for batch in store.batches])
        causes = np.concatenate([batch.results.cause for batch in store.batches])
        assert ((outcome == NUMERICAL_FAILURE) == (X[:, 0] < BELOW)).all()
        assert {cause_name(Disc.causes, code) for code in causes[X[:, 0] < BELOW].tolist()} == {cause}
        # With a higher limit it continues with the record that it has.
        assert run(one, store, executor, 24, failure_limit=0.9)
        assert standing(one, History.of(store.batches), 24).done == 24


# --- what interferes with a worker -------------------------------------------------------------------------------

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="a process in a session of its own is found on Linux alone")

HARMLESS = ["forks_and_returns", "forks_and_raises", "forks_and_stays", "reads", "stops_its_supervisor"]
"""What costs no simulation, though it is done each time."""

HARMFUL = {
    "writes": "its reply was malformed, twice",
    "closes": "its worker process died (exit code 1), twice",
    "ends_its_supervisor": "its worker process died (exit code 0), twice",
    "dies_of_a_real_time_signal": "its worker process died (signal 40), twice",
}
"""What costs a simulation if it is done each time, and how that is put."""


def at(rows: list[int], n: int = 40) -> Array:
    """Designs, at some of which a simulator acts."""
    X = designs(n)
    X[rows, 0] = 0.0
    return X


DISTURBING = [Killed(), Exhausted(), Exiting(), Hanging(), *(Meddling(how=how) for how in (*HARMLESS, *HARMFUL))]


@LINUX
@pytest.mark.parametrize(
    "fault",
    some(DISTURBING, *DISTURBING[:2], *DISTURBING[4:]),
    ids=lambda fault: getattr(fault, "how", type(fault).__name__),
)
def test_workers_that_are_disturbed_now_and_then_change_no_bit_of_the_campaign(
    fault: Disc, uninterrupted: Course, tmp_path: Path, survived: Callable[[int], None]
) -> None:
    one = on(OnceAt(fault=fault, folder=str(tmp_path), every=2))
    with (
        FolderStore.create(tmp_path / "run", campaign().settings.text(), one.schema) as store,
        ProcessExecutor(2, time_limit=2.0 if isinstance(fault, Hanging) else None) as executor,
    ):
        observer = Observer()
        assert run(one, store, executor, BUDGET, observer)
        assert Course.of(store) == uninterrupted
        assert observer.faults == []
    injected = len(list(tmp_path.glob("at-*")))
    assert injected > 2
    survived(injected)


@LINUX
@pytest.mark.parametrize("how", [*HARMLESS, *HARMFUL])
def test_a_simulator_that_always_meddles_costs_at_most_the_simulations_where_it_does(
    how: str, survived: Callable[[int], None], capfd: pytest.CaptureFixture[str]
) -> None:
    rows = [0, 13, 14, 39]
    X = at(rows)
    with within(600), ProcessExecutor(2) as executor:
        results = executor.run(Meddling(how=how), X)
        if how in HARMFUL:
            given_up(results, X, rows, "worker_died")
            assert all(fault.endswith(f": {HARMFUL[how]}") for fault in results.faults.values())
        else:
            assert bits(results) == bits(Disc().run(X))
            assert results.faults == {}
        assert bits(executor.run(Disc(), X)) == bits(Disc().run(X))
    assert "Traceback" not in capfd.readouterr().err
    survived(len(rows))


@LINUX
def test_an_answer_of_which_the_rest_never_comes_holds_up_nobody(survived: Callable[[int], None]) -> None:
    X = at([1], 3)
    with within(600), ProcessExecutor(1) as executor:
        results = executor.run(Meddling(how="writes_a_part"), X)
    given_up(results, X, [1], "worker_died")
    assert "its worker process closed or spoiled its connection, twice" in results.faults[1]
    survived(1)


def test_a_worker_that_cannot_be_started_is_an_error_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused() -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket, "socketpair", refused)
    with (
        ProcessExecutor(1) as executor,
        pytest.raises(SimulationError, match="not be started: Too many open files"),
    ):
        executor.run(Failing(), designs(3))


# --- a worker that is spoilt ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", [Remembering(most=3), Unusual()], ids=["raises", "unusable"])
def test_what_fails_because_of_earlier_simulations_of_its_process_is_no_failure(simulator: Disc) -> None:
    X = designs(20)
    with within(600), ProcessExecutor(1) as executor:
        results = executor.run(simulator, X)
    assert bits(results) == bits(Disc().run(X))
    assert results.faults == {}


def noted(folder: Path) -> list[tuple[str, int]]:
    """Process and number of each simulation, in their order."""
    names = sorted((path.name.split("-") for path in folder.iterdir()), key=lambda parts: int(parts[0]))
    return [(process, int(number)) for _, process, number in names]


def test_a_simulation_that_fails_is_tried_once_more_in_a_fresh_process_and_the_next_has_one_too(tmp_path: Path) -> None:
    X = at([2, 4, 5], 7)
    simulator = Remembering(other=Meddling(how="raises"), folder=str(tmp_path))
    with within(600), ProcessExecutor(1) as executor:
        results = executor.run(simulator, X)
    given_up(results, X, [2, 4, 5], "raised")
    assert all("ValueError: no convergence (" in fault for fault in results.faults.values())
    assert [fault.endswith("), twice") for fault in results.faults.values()] == [True, True, False]
    # The third fails after two others, and alone; the fourth has a fresh process; the sixth fails in one at once.
    assert [number for _, number in noted(tmp_path)] == [0, 1, 2, 0, 0, 1, 0, 0, 0]
    assert len({process for process, _ in noted(tmp_path)}) == 6


def test_tries_that_fail_differently_are_both_reported() -> None:
    X = at([2], 5)
    with within(600), ProcessExecutor(1) as executor:
        results = executor.run(Remembering(other=Meddling(how="dies_after_it_raised")), X)
    given_up(results, X, [2], "worker_died")
    assert "ValueError: no convergence (" in results.faults[2]
    assert results.faults[2].endswith("; then, in a fresh process: its worker process died (exit code 3)")


@pytest.mark.parametrize(("renew", "numbers"), [(1, [0] * 7), (3, [0, 1, 2, 0, 1, 2, 0]), (None, list(range(7)))])
def test_a_worker_is_renewed_as_often_as_the_simulator_asks(tmp_path: Path, renew: int, numbers: list[int]) -> None:
    X = designs(7)
    with within(600), ProcessExecutor(1) as executor:
        assert bits(executor.run(Remembering(folder=str(tmp_path), renew=renew), X)) == bits(Disc().run(X))
    assert [number for _, number in noted(tmp_path)] == numbers
    assert len({process for process, _ in noted(tmp_path)}) == numbers.count(0)


# --- what is left behind -------------------------------------------------------------------------------------------


def gone(folder: Path) -> bool:
    """Whether all processes that are noted in a folder have ended."""
    return not any(Path(f"/proc/{path.name}").exists() for path in folder.glob("[0-9]*"))


@LINUX
@pytest.mark.parametrize("then", some(["answers", "raises", "dies", "hangs", "holds"], "answers", "dies", "hangs"))
def test_what_a_simulation_starts_in_a_session_of_its_own_ends_with_its_worker(
    then: str, tmp_path: Path, survived: Callable[[int], None]
) -> None:
    X = designs(1)
    with within(600), ProcessExecutor(1, time_limit=3.0 if then in ("hangs", "holds") else None) as executor:
        results = executor.run(Leaving(then=then, folder=str(tmp_path)), X)
        if then == "answers":
            assert bits(results) == bits(Disc().run(X))
            assert not gone(tmp_path)
            executor.run(Leaving(folder=str(tmp_path)), X)
        else:
            cause = {"raises": "raised", "dies": "worker_died"}.get(then, "time_limit")
            given_up(results, X, [0], cause)
            # At once, not only at the end.
            assert gone(tmp_path)
    # However little of a simulation there was before its limit.
    assert len(list(tmp_path.glob("[0-9]*"))) >= (1 if then in ("hangs", "holds") else 11)
    assert gone(tmp_path)
    survived(1)


@LINUX
def test_what_a_simulation_has_started_ends_where_its_worker_is_renewed(tmp_path: Path) -> None:
    with within(600), ProcessExecutor(1) as executor:
        executor.run(Leaving(folder=str(tmp_path), renew=1), designs(1))
        assert not gone(tmp_path)
        executor.run(Remembering(renew=1), designs(1))
        assert gone(tmp_path)


LEADING = """
import numpy as np
from faults.simulators import Leaving
from activefail.execution.local import ProcessExecutor
ProcessExecutor(2).run(Leaving(then={then!r}, folder={folder!r}), np.zeros((2, 2)))
"""


@LINUX
@pytest.mark.parametrize("then", ["hangs", "holds"])
def test_nothing_of_a_worker_outlives_a_main_program_that_is_killed(
    then: str, tmp_path: Path, survived: Callable[[int], None]
) -> None:
    # Not guarded by `if __name__ == "__main__"`: a worker needs the main module only where the simulator is in it.
    (tmp_path / "lead.py").write_text(LEADING.format(then=then, folder=str(tmp_path)))
    paths = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    process = subprocess.Popen([sys.executable, tmp_path / "lead.py"], env=os.environ | {"PYTHONPATH": paths})
    try:
        with within(600):
            wait_until(lambda: len(list(tmp_path.glob("[0-9]*"))) == 22)
    finally:
        process.kill()
        process.wait()
    with within(600):
        wait_until(lambda: gone(tmp_path))
    survived(1)
