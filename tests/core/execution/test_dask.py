"""Campaigns on a Dask cluster: a real scheduler and real workers, which are killed, added and restarted."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Timer

import numpy as np
import pytest
from campaign.stub import Disc, disc
from cases import some
from commandline import activefail, record, refused, started, wait_for
from execution.sent import Ambush, Deadly, Fatal, Noted, Unknown, versions
from patience import PATIENCE, until

from activefail.campaign.provenance import simulation_versions
from activefail.errors import SimulationError
from activefail.execution.dask import DaskExecutor
from activefail.execution.local import ThreadExecutor
from activefail.loop.progress import Observer, Progress
from activefail.loop.running import run
from activefail.record.batch import columns_of
from activefail.record.memory import MemoryStore
from activefail.run.opening import open_run
from activefail.simulators.function import PythonSimulator
from activefail.simulators.interface import WORKER_DIED
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

distributed = pytest.importorskip("distributed", reason="Dask is an optional extra (activefail[cluster])")

CORE = Path(__file__).parents[1]
TESTS = CORE.parent


class Cluster:
    """A scheduler and its workers, each a process of its own on this machine."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = 0
        self.workers: dict[str, subprocess.Popen[bytes]] = {}
        self.begin()

    def begin(self) -> None:
        """Start the scheduler, at the same address as before if there was one."""
        log = self.folder / "scheduler.log"
        self.scheduler = self._started("scheduler", log, "--host", "127.0.0.1", "--port", str(self.port))
        until(lambda: "Scheduler at:" in log.read_text())
        line = next(line for line in reversed(log.read_text().splitlines()) if "Scheduler at:" in line)
        self.address = line.split()[-1]
        self.port = int(self.address.rpartition(":")[2])

    def add(self, name: str, *options: str) -> None:
        """Start a worker, without a nanny that would start it again unless the options ask for one."""
        log = self.folder / f"{name}.log"
        self.workers[name] = self._started(
            "worker",
            log,
            self.address,
            *("--nthreads", "1", "--name", name, "--host", "127.0.0.1"),
            *(options or ("--no-nanny",)),
        )
        until(lambda: "Registered to" in log.read_text())

    def _started(self, what: str, log: Path, *options: str) -> subprocess.Popen[bytes]:
        with log.open("ab") as file:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", what, *options, "--no-dashboard"],
                stdout=file,
                stderr=file,
                cwd=self.folder,
                env=os.environ
                | {
                    "PYTHONPATH": os.pathsep.join(map(str, (CORE, TESTS, TESTS.parent))),
                    "DASK_TEMPORARY_DIRECTORY": str(self.folder),
                },
            )

    def close(self) -> None:
        for process in (*self.workers.values(), self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler with two workers, for tests that leave all three as they were: each takes a second to start."""
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        made.add("one")
        made.add("two")
        yield made
    finally:
        made.close()


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without workers."""
    made = Cluster(tmp_path)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def cluster(alone: Cluster) -> Cluster:
    """A scheduler with two workers."""
    alone.add("one")
    alone.add("two")
    return alone


def plan(folder: Path, seconds: float = 0.2):
    simulator = Noted(folder=str(folder), seconds=seconds)
    return disc(simulator, initial=12, budget=28, batch=4, asynchronous=True)


def check_whole(store: MemoryStore) -> None:
    """Assert that a campaign has all its simulations, once each."""
    X = np.concatenate([batch.designs for batch in store.batches])
    assert len(np.unique(X, axis=0)) == len(X) == 28
    assert all((batch.results.outcome == Disc().run(batch.designs).outcome).all() for batch in store.batches)


@pytest.mark.faults
@pytest.mark.exhaustive
def test_a_worker_that_is_killed_without_batches_costs_no_simulation(cluster: Cluster, tmp_path: Path) -> None:
    campaign = plan(tmp_path)
    store = MemoryStore(campaign.schema)

    def kill(progress: Progress) -> None:
        if progress.done >= 16 and cluster.workers["one"].poll() is None:
            cluster.workers["one"].kill()
            cluster.workers["one"].wait()

    with DaskExecutor(cluster.address) as executor:
        observer = Observer(kill)
        assert run(campaign, store, executor, 28, observer)
        assert observer.faults == []
    check_whole(store)
    assert cluster.workers["one"].returncode == -signal.SIGKILL


@pytest.mark.faults
@pytest.mark.parametrize("batch", some([1, 5], 5))  # of the initial design, and of chosen ones
def test_a_worker_that_is_killed_in_mid_batch_changes_no_bit_of_a_campaign_in_batches(
    cluster: Cluster, tmp_path: Path, batch: int
) -> None:
    undisturbed, store = (MemoryStore(disc().schema) for _ in range(2))
    with ThreadExecutor(2) as here:
        assert run(disc(), undisturbed, here, 28)
    design = tuple(undisturbed.batches[batch].designs[1].tolist())
    observer = Observer()
    with DaskExecutor(cluster.address) as executor:
        assert run(disc(Ambush(folder=str(tmp_path), design=design)), store, executor, 28, observer)
        assert observer.faults == []
    cluster_bits, bits = (
        [(one.iteration, *(array.tobytes() for array in columns_of(one).values())) for one in kept.batches]
        for kept in (store, undisturbed)
    )
    assert cluster_bits == bits
    assert sorted(worker.poll() or 0 for worker in cluster.workers.values()) == [-signal.SIGKILL, 0]


@pytest.mark.faults
def test_a_simulation_that_ends_its_process_costs_itself_and_not_the_worker(cluster: Cluster) -> None:
    X = np.array([[0.0, 20.0], [2.5, 20.0], [1.0, 20.0], [2.9, 30.0]])
    with DaskExecutor(cluster.address) as executor:
        results = executor.run(Fatal(), X)
    assert (results.cause == WORKER_DIED).tolist() == [False, True, False, True]
    assert sorted(results.faults) == [1, 3]
    assert all("its worker process died (SIGKILL" in fault for fault in results.faults.values())
    assert all(worker.poll() is None for worker in cluster.workers.values())


UNRULY = """
import os, pathlib, time
def run(design):
    pathlib.Path(__file__).with_name(f"pid-{os.getpid()}").touch()
    if design["x"] > 3.5:
        time.sleep(600)
    if design["x"] < 0.5:
        os._exit(3)
    return "failure" if design["x"] > 1.5 else "safe"
"""


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_workers_as_dask_starts_them_simulate_functions_with_a_time_limit(alone: Cluster, tmp_path: Path) -> None:
    # Beside a nanny a worker is a daemon, which Python refuses to have children.
    alone.add("one", "--nanny")
    assert "Start Nanny at" in (tmp_path / "one.log").read_text()
    (tmp_path / "unruly.py").write_text(UNRULY)
    limited = TOML.replace('"slow:run"', '"unruly:run", time_limit = 3.0') + "[limits]\nnumerical_failures = 1.0\n"
    (tmp_path / "unruly.toml").write_text(limited)
    dask = ("--executor", "dask", "--scheduler", alone.address)
    result = activefail("run", tmp_path / "unruly.toml", "--out", tmp_path / "unruly", *dask)
    assert result.code == 0, result.err
    rows = record(tmp_path / "unruly")
    assert len(rows) == 24
    for row in rows:
        x = float(row["x"])
        assert row["cause"] == ("time_limit" if x > 3.5 else "worker_died" if x < 0.5 else "")
    assert {row["cause"] for row in rows} == {"time_limit", "worker_died", ""}
    alone.close()
    processes = [int(path.name.removeprefix("pid-")) for path in tmp_path.glob("pid-*")]
    assert len(processes) > 2
    until(lambda: not any(map(is_running, processes)))


def test_workers_that_cannot_load_what_they_are_sent_end_the_campaign_in_words(shared: Cluster) -> None:
    with (
        DaskExecutor(shared.address) as executor,
        pytest.raises(SimulationError, match=r"could not simulate design .*The workers need this machine's versions"),
    ):
        executor.run(Unknown(), np.array([[0.0, 20.0]]))


@pytest.mark.faults
@pytest.mark.exhaustive
def test_a_design_that_costs_worker_after_worker_is_given_up(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("activefail.execution.dask._TRIES", 1)
    with ExitStack() as stack:
        executor = stack.enter_context(DaskExecutor(cluster.address))
        for name in ("three", "four"):
            cluster.add(name)
        results = executor.run(Deadly(), np.array([[2.5, 20.0]]))
    assert "its workers were lost" in results.faults[0]
    assert results.cause.tolist() == [WORKER_DIED]


TOML = """
seed = 5
sampling = { initial = 12, budget = 24, batch = 4, asynchronous = true }
acquisition.boundary = "failure"
simulator = { python = "slow:run" }
[space]
x = { low = 0.0, high = 4.0 }
y = { low = 1.0, high = 3.0 }
"""

# Of all processes' simulations the ninth and those after it wait until they may end.
SLOW = """
import itertools, pathlib, time
def run(design):
    folder = pathlib.Path(__file__).parent
    for number in itertools.count(1):
        try:
            (folder / f"begun-{number}").touch(exist_ok=False)
            break
        except FileExistsError:
            pass
    while number > 8 and not (folder / "open").exists():
        time.sleep(0.02)
    return "failure" if design["x"] > 1.5 else "safe"
"""


@pytest.mark.faults
@pytest.mark.exhaustive
def test_a_scheduler_that_is_restarted_stops_the_campaign_which_goes_on_later(cluster: Cluster, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "mine.toml").write_text(TOML)
    folder = tmp_path / "run"
    dask = ("--executor", "dask", "--scheduler", cluster.address)
    with started("run", tmp_path / "mine.toml", "--out", folder, *dask) as process:
        until(lambda: (folder / "campaign.toml").exists() and len(record(folder)) > 2)
        cluster.scheduler.kill()
        cluster.scheduler.wait()
        cluster.begin()
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 1, err
    assert f"The Dask scheduler at {cluster.address} was lost" in err
    assert "Traceback" not in err
    before = record(folder)
    assert 0 < len(before) < 24
    for worker in cluster.workers.values():
        worker.kill()
        worker.wait()
    (tmp_path / "open").touch()
    cluster.add("three")
    result = activefail("resume", folder, *dask, "--code", tmp_path)
    assert result.code == 0, result.err
    rows = record(folder)
    assert rows[: len(before)] == before
    assert len({(row["x"], row["y"]) for row in rows}) == 24


@pytest.mark.faults
def test_a_scheduler_that_is_lost_while_the_program_does_other_things_is_told(alone: Cluster) -> None:
    lost = "The Dask scheduler at .* was lost"
    with DaskExecutor(alone.address) as executor:
        alone.scheduler.kill()
        until(lambda: executor._client.status == "closed")
        with pytest.raises(SimulationError, match=lost):
            executor.run(Disc(), np.zeros((1, 2)))
        with pytest.raises(SimulationError, match=lost):
            executor.start(Disc(), 0, np.zeros(2))


LONG = """
seed = 11
simulator = { python = "sleepy:run", time_limit = 3.0, repeatable = true }
sampling = { initial = 40, budget = 200, batch = 20, asynchronous = false }
limits.numerical_failures = 0.2
[space]
x = { low = 0.0, high = 4.0 }
y = { low = 1.0, high = 3.0 }
"""

# Every run leaves a line when it begins.
SLEEPY = """
import os, pathlib, time
def run(design):
    line = f"{design['x']!r},{design['y']!r}\\n".encode()
    file = os.open(pathlib.Path(__file__).with_name("begun"), os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(file, line)
    os.close(file)
    time.sleep(60.0 if 2.0 < design["y"] < 2.03 else 0.05)
    return "failure" if design["x"] > 1.5 + 0.2 * design["y"] else "safe"
"""


@pytest.mark.faults
@pytest.mark.parametrize("asynchronous", some([False, True], False))
def test_a_campaign_that_is_killed_twice_repeats_only_what_was_in_flight(
    cluster: Cluster, tmp_path: Path, asynchronous: bool
) -> None:
    rng, folder, begun = np.random.default_rng(), tmp_path / "run", tmp_path / "begun"
    settled: dict[tuple[float, float], int] = {}

    def times() -> Counter[tuple[float, ...]]:
        return Counter(tuple(map(float, line.split(","))) for line in begun.read_text().splitlines())

    def settle() -> list[dict[str, str]]:
        # What is recorded is never simulated again.
        rows = record(folder)
        designs, number = [(float(row["x"]), float(row["y"])) for row in rows], times()
        settled.update({design: number[design] for design in designs if design not in settled})
        return rows

    (tmp_path / "sleepy.py").write_text(SLEEPY)
    (tmp_path / "long.toml").write_text(LONG.replace("false", str(asynchronous).lower()))
    dask = ("--executor", "dask", "--scheduler", cluster.address)
    words: tuple[str | Path, ...] = ("run", tmp_path / "long.toml", "--out", folder, *dask)
    for low, high, lost, added in ((45, 90, "one", "three"), (120, 190, "two", "four")):
        at = int(rng.integers(low, high))
        with started(*words) as process:
            until(lambda at=at: begun.exists() and begun.read_text().count("\n") >= at)
            settle()
            cluster.workers[lost].kill()
            cluster.workers[lost].wait()
            cluster.add(added)
            time.sleep(rng.uniform(0.0, 0.5))
            process.kill()
            assert process.wait() == -signal.SIGKILL
        before = settle()
        with open_run(folder, code=tmp_path) as opened:
            assert len(opened.handed_out.in_flight) <= 20
        words = ("resume", folder, "--code", tmp_path, *dask)
    result = activefail(*words)
    assert result.code == 0, result.err
    rows = record(folder)
    assert rows[: len(before)] == before
    designs = [(float(row["x"]), float(row["y"])) for row in rows]
    assert len(designs) == len(set(designs)) == 200
    hang = {design for design in designs if 2.0 < design[1] < 2.03}
    assert {design for design, row in zip(designs, rows, strict=True) if row["cause"] == "time_limit"} == hang != set()
    number = times()
    assert number.keys() == set(designs)
    assert {design: number[design] for design in settled} == settled


def hear(process: subprocess.Popen[str], start: str) -> None:
    """Read what a program says until a line begins so; it is ended where none does."""
    give_up = Timer(PATIENCE, process.kill)
    give_up.start()
    try:
        wait_for(process.stderr, start)
    finally:
        give_up.cancel()


@pytest.mark.faults
@pytest.mark.parametrize("asynchronous", some([True, False], True))
def test_a_cluster_without_workers_is_told_and_waited_for(alone: Cluster, tmp_path: Path, asynchronous: bool) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "mine.toml").write_text(TOML.replace("true", str(asynchronous).lower()))
    folder, waiting = tmp_path / "run", f"waiting for workers at {alone.address}"
    dask = ("--executor", "dask", "--scheduler", alone.address)
    with started("run", tmp_path / "mine.toml", "--out", folder, *dask) as process:
        hear(process, waiting)
        # Nothing is running, so the first Ctrl-C may wait forever, and the message says so.
        process.send_signal(signal.SIGINT)
        hear(process, "stopping")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert record(folder) == []
    with started("resume", folder, *dask, "--code", tmp_path) as process:
        hear(process, waiting)
        alone.add("one")
        until(lambda: (folder / "campaign.toml").exists() and len(record(folder)) > 1)
        alone.workers["one"].kill()
        # Reported again, once.
        hear(process, waiting)
        (tmp_path / "open").touch()
        alone.add("two")
        _, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (0, "")
    assert len({(row["x"], row["y"]) for row in record(folder)}) == 24


def test_modules_beside_a_function_are_found_on_a_cluster_and_are_those_of_now(shared: Cluster, tmp_path: Path) -> None:
    space = DesignSpace((Parameter("x", 0.0, 2.0),))
    (tmp_path / "mine.py").write_text("import limit\n\ndef run(design):\n    return limit.judged(design['x'])\n")
    with DaskExecutor(shared.address) as executor:
        for least in (1.5, 0.25):
            (tmp_path / "limit.py").write_text(f"def judged(x):\n    return 'failure' if x > {least} else 'safe'\n")
            simulator = PythonSimulator(space, "mine:run", tmp_path, ("safe", "failure"), ())
            results = executor.run(replace(simulator, source=simulator.load()), np.array([[0.0], [1.0], [2.0]]))
            assert results.faults == {}
            assert results.outcome.tolist() == [0, int(least < 1.0), 1]


def test_the_processes_that_simulate_on_a_cluster_end_with_the_campaign(shared: Cluster, tmp_path: Path) -> None:
    space = DesignSpace((Parameter("x", 0.0, 2.0),))
    (tmp_path / "model.py").write_text("import os\n\ndef run(design):\n    return float(os.getpid())\n")
    simulator = PythonSimulator(space, "model:run", tmp_path, ("safe", "failure"), ("pid",), levels=(0.0,))
    with DaskExecutor(shared.address) as other:
        with DaskExecutor(shared.address) as executor:
            pid, kept = (int(one.run(simulator, np.array([[1.0]])).margins[0, 0]) for one in (executor, other))
        until(lambda: not Path(f"/proc/{pid}").exists())
        assert Path(f"/proc/{kept}").exists()
    until(lambda: not Path(f"/proc/{kept}").exists())


@pytest.mark.faults
@pytest.mark.exhaustive
def test_a_cluster_that_is_not_there_is_told_and_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(TOML)
    (tmp_path / "slow.py").write_text(SLOW)
    words = ("run", tmp_path / "mine.toml", "--out", tmp_path / "run")
    refused(activefail(*words, "--executor", "dask"), "--executor dask requires --scheduler")
    refused(activefail(*words, "--scheduler", "tcp://127.0.0.1:1"), "--scheduler requires --executor dask")
    dask = (*words, "--executor", "dask", "--scheduler")
    refused(activefail(*dask, "127.0.0.1:1", "--workers", "2"), "--workers requires --executor local")
    for address in ("tcp://127.0.0.1:1", "nonsense://x", "tcp://"):
        refused(activefail(*dask, address), f"--scheduler: no Dask scheduler answers at {address!r}")
    assert not (tmp_path / "run").exists()


def test_workers_of_other_versions_than_this_machine_s_answer_nothing(shared: Cluster) -> None:
    X = disc(initial=12).space.latin_hypercube(4, np.random.default_rng(0))
    with DaskExecutor(shared.address, versions=versions) as executor:
        with pytest.raises(SimulationError, match="differs from this machine: leader there there, here here") as raised:
            executor.run(Disc(), X)
        assert "none was recorded" in str(raised.value)
    with DaskExecutor(shared.address, versions=simulation_versions) as executor:
        assert executor.run(Disc(), X).outcome.tolist() == Disc().run(X).outcome.tolist()
