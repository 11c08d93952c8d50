"""What the faults are tried on."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from faults.harness import Course, Victims, finished
from patience import until


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.faults)


@pytest.fixture(scope="session")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Course:
    """What the campaign does when nothing interrupts it."""
    return finished(tmp_path_factory.mktemp("uninterrupted") / "run")


@pytest.fixture(scope="session")
def victims(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Victims]:
    server = Victims(tmp_path_factory.mktemp("victims"))
    yield server
    server.close()


@pytest.fixture(scope="session")
def strace() -> str:
    """The tracer, where there is one that may trace."""
    actual = shutil.which("strace")
    if actual is None:
        pytest.skip("strace is not installed (Debian: apt install strace)")
    sleeping = subprocess.Popen(["sleep", "3600"])
    words = [actual, "-qq", "-e", "trace=none", "-e", "inject=write:error=EIO:when=1", "-p", str(sleeping.pid)]
    tracer = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    try:
        watched = f"TracerPid:\t{tracer.pid}\n"
        until(
            lambda: tracer.poll() is not None or watched in Path(f"/proc/{sleeping.pid}/status").read_text(),
            "strace to trace or to end",
        )
        if tracer.poll() is not None:
            pytest.skip(f"strace may not trace here: {tracer.communicate()[1].strip()}")
        return actual
    finally:
        for process in (tracer, sleeping):
            process.kill()
            process.communicate()


# --- file systems ------------------------------------------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Makes a file system of so many kB, or gives it another size."""
    place = tmp_path / "disk"
    place.mkdir()

    def sized(kilobytes: int) -> Path:
        remount = "remount," if place.is_mount() else ""
        command = ["mount", "-t", "tmpfs", "-o", f"{remount}size={kilobytes}k", "tmpfs", str(place)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"a small file system cannot be mounted here: {done.stderr.strip()}")
        return place

    yield sized
    if place.is_mount():
        subprocess.run(["umount", str(place)], check=True)
    with suppress(OSError):
        place.rmdir()
