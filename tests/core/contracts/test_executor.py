"""The contract of every Executor."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaign.stub import HIGH, LOW, Disc
from cases import exhaustive, some
from patience import Clock
from threadpoolctl import threadpool_info

from activefail.errors import SimulationError
from activefail.execution.dask import DaskExecutor
from activefail.execution.executor import AsynchronousExecutor, Executor
from activefail.execution.local import ProcessExecutor, ThreadExecutor, local_executor
from activefail.record.batch import Schema
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace

pytestmark = pytest.mark.faults

PLANE = DesignSpace((Parameter("x", LOW[0], HIGH[0]), Parameter("y", LOW[1], HIGH[1])))


def designs(n: int) -> Array:
    return PLANE.from_unit(np.random.default_rng(n).random((n, 2)))


def bits(results: Results) -> tuple[bytes, ...]:
    return tuple(a.tobytes() for a in (results.outcome, results.cause, results.margins, results.seconds))


class Acting(Disc):
    """A disc that does something in the worker before it answers the designs whose first number is 0."""

    def act(self) -> None:
        raise NotImplementedError

    def run(self, X: Array) -> Results:
        if (X[:, 0] == 0.0).any():
            self.act()
        return super().run(X)


class Raising(Acting):
    def act(self) -> None:
        raise ZeroDivisionError("the stiffness vanished")


class Leaving(Acting):
    def act(self) -> None:
        os._exit(3)


class Killed(Acting):
    def act(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Exhausted(Acting):
    def act(self) -> None:
        np.empty(2**58)


class Refusing(Acting):
    def act(self) -> None:
        raise SimulationError("no licence")


class Crashing(Acting):
    def act(self) -> None:
        os.kill(os.getpid(), signal.SIGSEGV)


class Forking(Acting):
    """Leaves a process behind that holds the worker's pipes open."""

    def act(self) -> None:
        if os.fork() == 0:
            time.sleep(600)
        os.kill(os.getpid(), signal.SIGKILL)


class Hanging(Acting):
    def act(self) -> None:
        time.sleep(600)


class Stopped(Acting):
    def act(self) -> None:
        os.kill(os.getpid(), signal.SIGSTOP)


@dataclass(frozen=True)
class Starting(Acting):
    """Starts a command that never ends and waits for it; notes both in a folder."""

    folder: str = ""

    def act(self) -> None:
        command = subprocess.Popen(["sleep", "600"])
        for pid in (os.getpid(), command.pid):
            Path(self.folder, str(pid)).touch()
        command.wait()


@dataclass(frozen=True)
class Noted(Disc):
    """Notes its process in a folder and never answers."""

    folder: str = ""

    def run(self, X: Array) -> Results:
        Path(self.folder, str(os.getpid())).touch()
        while True:
            time.sleep(0.01)


@dataclass(frozen=True)
class Once(Disc):
    """What another disc does in the worker, the first time; a disc from then on."""

    other: Disc | None = None
    note: str = ""

    def run(self, X: Array) -> Results:
        if (X[:, 0] == 0.0).any() and not Path(self.note).exists():
            Path(self.note).touch()
            assert self.other is not None
            return self.other.run(X)
        return Disc().run(X)


@dataclass(frozen=True)
class Lying(Disc):
    """Gives the designs whose first number is 0 an outcome of its own."""

    outcome: float = 0.0

    def run(self, X: Array) -> Results:
        answers = super().run(X)
        return replace(answers, outcome=np.where(X[:, 0] == 0.0, self.outcome, answers.outcome))


class Nothing(Disc):
    def run(self, X: Array) -> Results:
        return None if (X[:, 0] == 0.0).any() else super().run(X)  # type: ignore[return-value]


class Short(Disc):
    def run(self, X: Array) -> Results:
        return super().run(X[X[:, 0] != 0.0])


class Textual(Disc):
    def run(self, X: Array) -> Results:
        answers = super().run(X)
        return replace(answers, outcome=np.array(["safe"] * len(X))) if (X[:, 0] == 0.0).any() else answers


class Unloadable(Disc):
    def __reduce__(self) -> Any:
        return _raise, ()


class Deadly(Disc):
    def __reduce__(self) -> Any:
        return os._exit, (4,)


def _raise() -> None:
    raise ValueError("no such material")


class Interrupted(Acting):
    def act(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)  # a signal waits for the interpreter to look


class Slow(Disc):
    """A disc whose first designs take longest."""

    def run(self, X: Array) -> Results:
        time.sleep(0.05 * float((X[:, 0] < 0.0).any()))
        return super().run(X)


class Threads(Disc):
    """Answers how many threads this process would use for a product of matrices, in place of the margin."""

    def run(self, X: Array) -> Results:
        most = max(library["num_threads"] for library in threadpool_info())
        answers = super().run(X)
        return Results(answers.outcome, answers.cause, np.full((len(X), 1), float(most)), answers.seconds)


EXECUTORS: dict[str, Callable[[], AsynchronousExecutor]] = {
    "one thread": lambda: ThreadExecutor(1),
    "three threads": lambda: ThreadExecutor(3),
    "two processes": lambda: ProcessExecutor(2),
}


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask cluster of two workers."""
    distributed = pytest.importorskip("distributed", reason="Dask is an optional extra")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module", params=[*EXECUTORS, "dask"])
def executor(request: pytest.FixtureRequest) -> Iterator[AsynchronousExecutor]:
    if request.param == "dask":
        with DaskExecutor(request.getfixturevalue("scheduler")) as made:
            yield made
    else:
        with EXECUTORS[request.param]() as made:
            yield made


def given_up(results: Results, X: Array, rows: list[int], cause: str) -> None:
    """Assert that these rows, and no others, are numerical failures with a cause and a fault that names the design."""
    failed = results.outcome == NUMERICAL_FAILURE
    assert np.flatnonzero(failed).tolist() == rows
    assert {cause_name(Disc.causes, code) for code in results.cause[failed].tolist()} == {cause}
    assert sorted(results.faults) == rows
    assert all(fault.startswith(f"design {X[row].tolist()}: ") for row, fault in results.faults.items())
    assert np.isnan(results.margins[failed]).all()
    assert bits(results[~failed]) == bits(Disc().run(X[~failed]))
    Schema(PLANE.names, Disc.outcomes, Disc.causes, Disc.margins).check(X, results)


def started_here() -> set[str]:
    """The processes that this one has started; none where the system does not say so."""
    return {pid for children in Path("/proc/self/task").glob("*/children") for pid in children.read_text().split()}


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait for an event that must happen; the caller limits the time."""
    while not holds():
        time.sleep(0.01)


@contextmanager
def within(seconds: int) -> Iterator[None]:
    """Fail if the body takes longer, instead of waiting forever."""

    def ring(number: int, frame: object) -> None:
        raise TimeoutError(f"not done after {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 64, 301])
def test_the_answers_are_the_simulators_in_the_order_of_the_designs(executor: Executor, n: int) -> None:
    X = designs(n)
    assert bits(executor.run(Disc(), X)) == bits(Disc().run(X))


def test_the_order_holds_where_the_first_designs_take_longest(executor: Executor) -> None:
    X = designs(24)
    X = X[np.argsort(X[:, 0])]
    assert bits(executor.run(Slow(), X)) == bits(Disc().run(X))


@pytest.mark.parametrize("n", [1, 5, 100])
def test_each_row_arrives_once_in_small_parts(executor: Executor, n: int) -> None:
    X, parts = designs(n), dict[int, Results]()
    results = executor.run(Disc(), X, parts.__setitem__)
    assert sorted(row + k for row, part in parts.items() for k in range(len(part))) == list(range(n))
    assert all(bits(part) == bits(results[row : row + len(part)]) for row, part in parts.items())
    assert max(map(len, parts.values())) <= 16


def test_single_designs_are_answered_once_each_with_their_tickets(executor: AsynchronousExecutor) -> None:
    X = designs(30)
    for ticket, x in enumerate(X[:20]):
        executor.start(Slow(), 100 + ticket, x)
    answers: dict[int, Results] = {}
    with within(600):
        while len(answers) < 30:
            for ticket, results in executor.answered(0.5):
                assert ticket not in answers
                answers[ticket] = results
                if len(answers) <= 10:  # others may be begun while some are awaited
                    executor.start(Slow(), 119 + len(answers), X[19 + len(answers)])
    assert bits(Results.concatenate([answers[100 + i] for i in range(30)])) == bits(Disc().run(X))


def test_a_batch_is_answered_while_single_designs_run_and_takes_none_of_their_answers(
    executor: AsynchronousExecutor,
) -> None:
    X = designs(12)
    for ticket in range(4):
        executor.start(Slow(), ticket, X[ticket])
    assert bits(executor.run(Disc(), X)) == bits(Disc().run(X))
    answers: dict[int, Results] = {}
    with within(600):
        while len(answers) < 4:
            answers |= dict(executor.answered(0.5))
    assert bits(Results.concatenate([answers[ticket] for ticket in range(4)])) == bits(Disc().run(X[:4]))


def test_where_nothing_is_answered_the_wait_ends_in_time(executor: AsynchronousExecutor) -> None:
    with within(600):
        assert executor.answered(0.05) == []


def test_no_design_needs_no_worker(executor: Executor) -> None:
    steps: list[int] = []
    results = executor.run(Raising(), np.empty((0, 2)), steps.append)
    assert len(results) == 0
    assert results.margins.shape == (0, 1)
    assert results.outcome.dtype == results.cause.dtype == np.int8
    assert steps == []


@pytest.mark.parametrize(
    ("simulator", "cause", "says"),
    [
        (Raising(), "raised", "ZeroDivisionError: the stiffness vanished"),
        (Exhausted(), "out_of_memory", "MemoryError"),
        (
            Lying(outcome=np.nan),
            "unusable_answer",
            "outcome in -1 to 1, cause in 0 to 2, seconds >= 0, got outcome nan",
        ),
        (Lying(outcome=7.0), "unusable_answer", "got outcome 7.0"),
        (Lying(outcome=0.5), "unusable_answer", "got outcome 0.5"),
        (Nothing(), "unusable_answer", "the simulator must return Results, got NoneType"),
        (Short(), "unusable_answer", "the margins must have shape (1, 1), got (0, 1)"),
        (Textual(), "unusable_answer", "the results must be numbers"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Disc) else None,
)
@pytest.mark.parametrize("make", EXECUTORS.values(), ids=EXECUTORS.keys())
def test_a_simulation_without_a_usable_answer_is_one_numerical_failure_with_its_cause(
    make: Callable[[], Executor], simulator: Disc, cause: str, says: str
) -> None:
    X = designs(40)
    X[20, 0] = 0.0
    steps: list[int] = []
    with within(600), make() as executor:
        results = executor.run(simulator, X, lambda _, part: steps.append(len(part)))
        given_up(results, X, [20], cause)
        assert sum(steps) == 40
        assert says in results.faults[20]
        # The executor still works. Its later results do not contain earlier faults.
        repeated = executor.run(Disc(), X)
        assert bits(repeated) == bits(Disc().run(X))
        assert repeated.faults == {}


def test_the_faults_of_a_batch_and_of_single_designs_at_the_same_time_come_with_their_own_results(
    executor: AsynchronousExecutor,
) -> None:
    X = designs(24)
    X[::5, 0] = 0.0
    for ticket in range(12):
        executor.start(Raising(), ticket, X[ticket])
    batch = executor.run(Lying(outcome=7.0), X)
    answers: dict[int, Results] = {}
    with within(600):
        while len(answers) < 12:
            answers |= dict(executor.answered(0.5))
    single = Results.concatenate([answers[ticket] for ticket in range(12)])
    given_up(batch, X, [0, 5, 10, 15, 20], "unusable_answer")
    given_up(single, X[:12], [0, 5, 10], "raised")
    assert all("got outcome 7.0" in fault for fault in batch.faults.values())
    assert all("ZeroDivisionError: the stiffness vanished" in fault for fault in single.faults.values())


@pytest.mark.parametrize("make", EXECUTORS.values(), ids=EXECUTORS.keys())
def test_two_batches_at_once_have_their_own_faults(make: Callable[[], Executor]) -> None:
    X = designs(24)
    X[::5, 0] = 0.0
    with within(600), make() as executor, ThreadPoolExecutor(2) as callers:
        raised, unusable = callers.map(lambda simulator: executor.run(simulator, X), (Raising(), Lying(outcome=7.0)))
    given_up(raised, X, [0, 5, 10, 15, 20], "raised")
    given_up(unusable, X, [0, 5, 10, 15, 20], "unusable_answer")
    assert all("ZeroDivisionError: the stiffness vanished" in fault for fault in raised.faults.values())
    assert all("got outcome 7.0" in fault for fault in unusable.faults.values())


class Loud(Acting):
    def act(self) -> None:
        raise ValueError("\x1b[2J\n" + "x" * 10_000)


def test_a_fault_is_visible_and_no_longer_than_can_be_read(executor: Executor) -> None:
    fault = executor.run(Loud(), np.zeros((1, 2))).faults[0]
    assert r"ValueError: \x1b[2J" in fault
    assert fault.isprintable()
    assert len(fault) < 2100


class Quoting(Disc):
    """A disc whose own results bring a fault."""

    def run(self, X: Array) -> Results:
        return replace(super().run(X), faults={0: "of the simulator"})


def test_only_the_executor_gives_faults(executor: Executor) -> None:
    assert executor.run(Quoting(), designs(3)).faults == {}


@pytest.mark.parametrize("make", EXECUTORS.values(), ids=EXECUTORS.keys())
def test_what_activefail_itself_raises_reaches_the_caller_as_it_is(make: Callable[[], Executor]) -> None:
    X = designs(40)
    X[20, 0] = 0.0
    with within(600), make() as executor, pytest.raises(SimulationError, match="no licence"):
        executor.run(Refusing(), X)


def test_what_progress_raises_reaches_the_caller_and_the_rest_is_not_simulated() -> None:
    rows: list[int] = []
    stopped = threading.Event()

    class Noting(Disc):
        def run(self, X: Array) -> Results:
            rows.append(len(X))
            # The second call is in flight when the first one's progress stops it all.
            assert len(rows) == 1 or stopped.wait(600)
            return super().run(X)

    class Stopping(ThreadExecutor):
        def _stop(self) -> None:
            super()._stop()
            stopped.set()

    def stop(row: int, part: Results) -> None:
        raise KeyboardInterrupt

    with within(600), Stopping(1) as executor, pytest.raises(KeyboardInterrupt):
        executor.run(Noting(), designs(1600), stop)
    assert sum(rows) <= 32


def test_leaving_an_executor_by_an_exception_waits_for_nothing_and_begins_nothing_more() -> None:
    rows: list[int] = []
    begun, go = threading.Event(), threading.Event()

    class Held(Disc):
        def run(self, X: Array) -> Results:
            rows.append(len(X))
            begun.set()
            assert go.wait(600)
            return super().run(X)

    def leave(executor: AsynchronousExecutor) -> None:
        with executor:
            for ticket, x in enumerate(designs(5)):
                executor.start(Held(), ticket, x)
            assert begun.wait(600)
            raise KeyError

    before = set(threading.enumerate())
    with within(600), pytest.raises(KeyError):
        leave(ThreadExecutor(1))
    started = set(threading.enumerate()) - before
    assert started
    go.set()
    for thread in started:
        thread.join()
    assert rows == [1]


@pytest.mark.parametrize(
    ("simulator", "cause", "says"),
    [
        (Leaving(), "worker_died", "its worker process died (exit code 3), twice"),
        (Killed(), "worker_died", "its worker process died (SIGKILL, possibly out of memory), twice"),
        (Crashing(), "worker_died", "its worker process died (SIGSEGV), twice"),
        (Forking(), "worker_died", "its worker process died (SIGKILL, possibly out of memory), twice"),
        (Hanging(), "time_limit", "it took longer than 2 s, twice"),
        exhaustive((Stopped(), "time_limit", "it took longer than 2 s, twice")),
        (Exhausted(), "out_of_memory", "MemoryError"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Disc) else None,
)
@pytest.mark.parametrize("rows", some([[13], [0, 13, 39]], [13]))
def test_a_worker_that_dies_or_hangs_twice_costs_one_simulation(
    simulator: Disc, cause: str, says: str, rows: list[int]
) -> None:
    X = designs(40)
    X[rows, 0] = 0.0
    before = started_here()
    # Short only where it is reached: on a busy machine a process needs time to die.
    with within(600), ProcessExecutor(2, time_limit=2.0 if cause == "time_limit" else 300.0) as executor:
        results = executor.run(simulator, X)
        given_up(results, X, rows, cause)
        assert all(says in fault for fault in results.faults.values())
        assert bits(executor.run(Disc(), X)) == bits(Disc().run(X))
    assert started_here() <= before


@pytest.mark.parametrize(
    "simulator",
    some([Leaving, Killed, Crashing, Forking, Hanging, Stopped, Exhausted], Leaving, Killed, Hanging, Exhausted),
)
def test_a_worker_that_dies_or_hangs_once_costs_nothing(simulator: type[Disc], tmp_path: Path) -> None:
    X = designs(40)
    X[13, 0] = 0.0
    once = Once(other=simulator(), note=str(tmp_path / "done"))
    hangs = simulator in (Hanging, Stopped)
    with within(600), ProcessExecutor(2, time_limit=2.0 if hangs else 300.0) as executor:
        results = executor.run(once, X)
    assert bits(results) == bits(Disc().run(X))
    assert results.faults == {}
    assert (tmp_path / "done").exists()


def test_what_a_hung_simulation_has_started_ends_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    X = designs(4)
    X[1, 0] = 0.0
    # A minute passes whenever both processes are noted.
    clock = Clock(lambda: 60.0 * (len(os.listdir(tmp_path)) // 2))
    monkeypatch.setattr("activefail.execution.processes.time", clock)
    with within(600), ProcessExecutor(1, time_limit=1.0) as executor:
        given_up(executor.run(Starting(folder=str(tmp_path)), X), X, [1], "time_limit")
    assert len(os.listdir(tmp_path)) == 4
    for path in tmp_path.iterdir():
        wait_until(lambda path=path: not Path(f"/proc/{path.name}").exists())


def test_workers_end_with_the_process_that_leads_them_however_it_ends(tmp_path: Path) -> None:
    program = (
        "import numpy as np\n"
        "from contracts.test_executor import Noted\n"
        "from activefail.execution.local import ProcessExecutor\n"
        "if __name__ == '__main__':\n"
        f"    ProcessExecutor(2).run(Noted(folder={str(tmp_path)!r}), np.zeros((2, 2)))\n"
    )
    (tmp_path / "lead.py").write_text(program)
    paths = [str(Path(__file__).parents[1]), *sys.path]
    process = subprocess.Popen([sys.executable, tmp_path / "lead.py"], env=os.environ | {"PYTHONPATH": ":".join(paths)})
    with within(600):
        wait_until(lambda: len(list(tmp_path.iterdir())) == 3)
        process.kill()
        process.wait()
        for path in tmp_path.glob("[0-9]*"):
            wait_until(lambda path=path: not Path(f"/proc/{path.name}").exists())


def test_a_simulator_that_no_worker_can_load_is_an_error_with_the_reason() -> None:
    for simulator, says in ((Unloadable(), "ValueError: no such material"), (Deadly(), r"its worker process died")):
        with (
            within(600),
            ProcessExecutor(2) as executor,
            pytest.raises(SimulationError, match=f"could not load the simulator: {says}"),
        ):
            executor.run(simulator, designs(5))


def test_a_clock_that_is_set_ends_no_simulation_and_lets_none_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    X = designs(6)
    X[1, 0] = 0.0
    jumps = iter([0.0, 4e9, -4e9] * 10_000)
    monkeypatch.setattr(time, "time", lambda: next(jumps))
    with within(600), ProcessExecutor(2, time_limit=2.0) as executor:
        given_up(executor.run(Hanging(), X), X, [1], "time_limit")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_time_limit_that_no_simulation_could_keep_is_refused(limit: float) -> None:
    with pytest.raises(ValueError, match="`time_limit > 0` must hold"):
        ProcessExecutor(1, time_limit=limit)


def test_a_ctrl_c_that_the_worker_processes_hear_too_does_not_cost_the_batch() -> None:
    # On a terminal it goes to the whole process group; whether to stop is for the process that leads to say.
    X = designs(40)
    X[13, 0] = 0.0
    with within(600), ProcessExecutor(2) as executor:
        try:
            results = executor.run(Interrupted(), X)
        except KeyboardInterrupt:
            pytest.fail("the interrupt of a worker came back as one of the caller")
    assert bits(results) == bits(Disc().run(X))


def test_a_worker_process_computes_on_one_thread() -> None:
    with within(600), ProcessExecutor(1) as executor:
        assert executor.run(Threads(), designs(3)).margins.tolist() == [[1.0]] * 3


def test_threads_are_for_simulators_that_free_the_lock_and_processes_for_the_others() -> None:
    class Holding(Disc):
        releases_gil = False

    for simulator, expected in ((Disc(), ThreadExecutor), (Holding(), ProcessExecutor)):
        with local_executor(simulator, 1) as executor:
            assert isinstance(executor, expected)
