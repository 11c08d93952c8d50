"""What all tests share: the fault suite's option, and its account at the end."""

import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import hypothesis
import pytest
import wings
from patience import PATIENCE
from tools import missing

# Before numpy and torch are imported, also for the processes that tests start: two workers on two cores, each with two
# threads of BLAS, take several times as long as with one thread each, because the threads wait for each other.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

pytest_plugins = ("ran",)

# Not for what the tests start.
_file = os.environ.pop(wings.COUNTED, "")
COUNTED = Path(_file) if _file else None

# A shell that runs the suite in the background has it ignore Ctrl-C, and all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--every-fault", action="store_true", help="try every state of the fault suite, not a few of each kind"
    )
    parser.addoption("--exhaustive", action="store_true", help="run the exhaustive tests too (`make test-all`)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip tests that need a missing tool; leave exhaustive ones out, unless wanted or named by their path."""
    for item in items:
        for mark in item.iter_markers("needs"):
            if reason := missing(*mark.args):
                item.add_marker(pytest.mark.skip(reason))
    wanted = config.getoption("--exhaustive") or config.getoption("--every-fault")
    if wanted or any("::" in argument for argument in config.args):
        return
    left_out = [item for item in items if item.get_closest_marker("exhaustive")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("exhaustive")]


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to run without a tool that ACTIVEFAIL_REQUIRE names, and set up Hypothesis.

    It tries the same examples each time, and more of them, new ones, where every fault is to be tried.
    """
    for tool in os.environ.get("ACTIVEFAIL_REQUIRE", "").split():
        if reason := missing(tool):
            raise pytest.UsageError(f"ACTIVEFAIL_REQUIRE names {tool}, but {reason}")
    every = config.getoption("--every-fault")
    # How long an example takes, and its making, depends on the machine.
    timeless = hypothesis.settings(deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
    examples = 100 if config.getoption("--exhaustive") else 40
    hypothesis.settings.register_profile("same", timeless, derandomize=True, max_examples=examples)
    hypothesis.settings.register_profile("every fault", timeless, max_examples=1000)
    hypothesis.settings.load_profile("every fault" if every else "same")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the simulator once, before processes side by side would each compile it, and say that they do."""
    first = not hasattr(session.config, "workerinput") and not session.config.option.collectonly
    if first and find_spec("activefail.seismic") is not None:
        from activefail.seismic.bearing import TABLE_1, simulate

        simulate(TABLE_1.from_unit([[0.5] * 9]))


@contextmanager
def _ended_if_it_hangs(item: pytest.Item) -> Iterator[None]:
    """Fail a test that hangs, and show where; this is no claim about speed (see `patience`)."""

    def ring(number: int, frame: object) -> None:
        pytest.fail(f"this hangs: it is not done after {3 * PATIENCE:.0f} s")

    before = signal.signal(signal.SIGALRM, ring)
    # Of every fault there are thousands in one test.
    signal.alarm(0 if item.config.getoption("--every-fault") else int(3 * PATIENCE))
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    with _ended_if_it_hangs(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    with _ended_if_it_hangs(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    with _ended_if_it_hangs(item):
        return (yield)


@pytest.fixture(scope="session", autouse=True)
def state_of_all_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what activefail remembers of custom code out of the home, also for fixtures that several tests share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(autouse=True)
def state(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A state folder in which activefail remembers nothing before the test."""
    folder = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    return folder


@pytest.fixture
def every_fault(request: pytest.FixtureRequest) -> bool:
    """Whether all states are to be tried; else a few of each kind."""
    return bool(request.config.getoption("--every-fault"))


@pytest.fixture
def survived(request: pytest.FixtureRequest) -> Callable[[int], None]:
    """Counts states that a test has put the program in and that it came out of as promised."""
    counted = [0]

    def count(states: int = 1) -> None:
        counted[0] += states
        # Kept with the report, which comes back from parallel workers.
        request.node.user_properties[:] = [("states", counted[0])]

    return count


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    report_faults(terminalreporter)
    report_the_core(terminalreporter)


def report_the_core(terminalreporter: pytest.TerminalReporter) -> None:
    """Keep what the run of the core's tests counted; after the other wing's, print it (`wings`)."""
    if not COUNTED:
        return
    if COUNTED.exists():
        terminalreporter.write_line(f"tests/core: {COUNTED.read_text()}")
    else:
        parts, _ = terminalreporter.build_summary_stats_line()
        COUNTED.write_text(", ".join(text for text, _ in parts))


def report_faults(terminalreporter: pytest.TerminalReporter) -> None:
    """Report how many faults were tried, survived and skipped."""
    reports = [
        (status, report)
        for status in ("passed", "failed", "skipped")
        for report in terminalreporter.getreports(status)
        if "faults" in getattr(report, "keywords", {}) and (report.when == "call" or report.skipped)
    ]
    if not reports:
        return
    done = [report for status, report in reports if status != "skipped"]
    terminalreporter.section("faults")
    survived, failed = Counter[str](), Counter[str]()
    for report in done:
        # A test that fails has counted the states before the one that it fails at.
        survived[report.location[0]] += dict(report.user_properties).get("states", int(report.passed))
        failed[report.location[0]] += report.failed
    for place in sorted(survived):
        terminalreporter.write_line(
            f"{survived[place] + failed[place]:>7} tried, {survived[place]:>7} survived: {place}"
        )
    tried = survived.total() + failed.total()
    terminalreporter.write_line(f"faults: {tried} states tried, {survived.total()} survived, in {len(done)} tests")
    for _, report in reports:
        if report.skipped:
            reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
            terminalreporter.write_line(f"skipped: {report.nodeid.split('::')[-1]}: {reason.removeprefix('Skipped: ')}")


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write pages without their pictures, for a claim about words: drawing takes most of a page's time."""
    monkeypatch.setattr("activefail.pages.figures.svg._as_svg", lambda figure: "<svg></svg>")
