"""What every Executor must do, whoever does the work."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from campaign.stub import HIGH, LOW, Disc
from threadpoolctl import threadpool_info

from activefail.campaign.executor import Executor, ProcessExecutor, ThreadExecutor, local_executor
from activefail.campaign.simulator import Results
from activefail.errors import SimulationError
from activefail.space import Array, DesignSpace, Parameter

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


EXECUTORS: dict[str, Callable[[], Executor]] = {
    "one thread": lambda: ThreadExecutor(1),
    "three threads": lambda: ThreadExecutor(3),
    "two processes": lambda: ProcessExecutor(2),
}


@pytest.fixture(scope="module", params=EXECUTORS)
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    with EXECUTORS[request.param]() as made:
        yield made


@contextmanager
def within(seconds: int) -> Iterator[None]:
    """Fail where the body takes longer, in place of waiting for ever."""

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
def test_progress_sums_to_the_number_of_designs_and_comes_in_small_steps(executor: Executor, n: int) -> None:
    steps: list[int] = []
    executor.run(Disc(), designs(n), steps.append)
    assert sum(steps) == n
    assert min(steps) > 0
    assert max(steps) <= 16


def test_no_design_needs_no_worker(executor: Executor) -> None:
    steps: list[int] = []
    results = executor.run(Raising(), np.empty((0, 2)), steps.append)
    assert len(results) == 0
    assert results.margins.shape == (0, 1)
    assert results.outcome.dtype == results.cause.dtype == np.int8
    assert steps == []


@pytest.mark.parametrize("make", EXECUTORS.values(), ids=EXECUTORS.keys())
def test_what_a_simulator_raises_reaches_the_caller_as_it_is(make: Callable[[], Executor]) -> None:
    X = designs(40)
    X[20, 0] = 0.0
    with within(60), make() as executor, pytest.raises(ZeroDivisionError, match="the stiffness vanished"):
        executor.run(Raising(), X)


def test_what_progress_raises_reaches_the_caller_and_the_rest_is_not_simulated() -> None:
    rows: list[int] = []

    class Noting(Disc):
        def run(self, X: Array) -> Results:
            rows.append(len(X))
            time.sleep(0.002)
            return super().run(X)

    def stop(done: int) -> None:
        raise KeyboardInterrupt

    with within(60), ThreadExecutor(1) as executor, pytest.raises(KeyboardInterrupt):
        executor.run(Noting(), designs(1600), stop)
    assert sum(rows) < 800


@pytest.mark.parametrize("simulator", [Leaving(), Killed()], ids=["exits", "is killed"])
def test_a_worker_process_that_dies_ends_the_run_with_an_error_and_not_in_waiting(simulator: Disc) -> None:
    X = designs(40)
    X[13, 0] = 0.0
    with (
        within(60),
        ProcessExecutor(2) as executor,
        pytest.raises(SimulationError, match=r"worker process died .* its batch was not recorded"),
    ):
        executor.run(simulator, X)


def test_a_ctrl_c_that_the_worker_processes_hear_too_does_not_cost_the_batch() -> None:
    # On a terminal it goes to the whole process group; whether to stop is for the process that leads to say.
    X = designs(40)
    X[13, 0] = 0.0
    with within(60), ProcessExecutor(2) as executor:
        try:
            results = executor.run(Interrupted(), X)
        except KeyboardInterrupt:
            pytest.fail("the interrupt of a worker came back as one of the caller")
    assert bits(results) == bits(Disc().run(X))


def test_a_worker_process_computes_on_one_thread() -> None:
    with within(60), ProcessExecutor(1) as executor:
        assert executor.run(Threads(), designs(3)).margins.tolist() == [[1.0]] * 3


def test_threads_are_for_simulators_that_free_the_lock_and_processes_for_the_others() -> None:
    class Holding(Disc):
        releases_gil = False

    for simulator, expected in ((Disc(), ThreadExecutor), (Holding(), ProcessExecutor)):
        with local_executor(simulator, 1) as executor:
            assert isinstance(executor, expected)
