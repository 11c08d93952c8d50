import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from numba import njit
from numba.core import config

import activefail
from activefail.campaign.provenance import _LIBRARY_OPTIONS
from activefail.seismic.bearing import kernels
from activefail.seismic.bearing.kernels import compiler_options, folder_of_kernels, kept_kernels, physics_digest


def test_kernels_of_earlier_sources_are_deleted_and_those_of_the_present_sources_stay(tmp_path: Path) -> None:
    source = tmp_path / "contact.py"
    source.write_text("x")
    kernel = folder_of_kernels(tmp_path) / "bearing_1" / "contact.f-1.1.nbc"
    kernel.parent.mkdir(parents=True)
    kernel.write_bytes(b"x")
    assert folder_of_kernels(tmp_path) in kernel.parents
    assert kernel.exists()
    source.write_text("y")
    assert folder_of_kernels(tmp_path) not in kernel.parents
    assert not kernel.exists()


def test_kernels_compiled_under_other_options_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "contact.py").write_text("x")
    # The machine may set some of these options itself.
    for name, value in kernels._DEFAULTS.items():
        monkeypatch.setattr(config, name, value, raising=False)
    folders = {folder_of_kernels(tmp_path)}
    assert compiler_options() == "defaults"
    for name, value in (("OPT", 0), ("SLP_VECTORIZE", 1), ("CPU_NAME", "generic"), ("DEBUGINFO_DEFAULT", 1)):
        with monkeypatch.context() as patched:
            patched.setattr(config, name, value)
            assert compiler_options() == f"NUMBA_{name}={value}"
            folders.add(folder_of_kernels(tmp_path))
    assert len(folders) == 5


RECORDED = (
    ({}, "defaults defaults defaults"),
    ({"NUMBA_OPT": "max"}, "NUMBA_OPT=max NUMBA_OPT=max defaults"),
    (
        {"NUMBA_OPT": "1", "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2", "OPENBLAS_CORETYPE": "Haswell"},
        "NUMBA_OPT=1 NUMBA_OPT=1 GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2 OPENBLAS_CORETYPE=Haswell",
    ),
)
"""Options in the environment, and what is recorded of them."""


@pytest.fixture(scope="module")
def another_cache(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A folder in which processes with different options keep a kernel, and what each of them records."""
    folder = tmp_path_factory.mktemp("cache")
    code = (
        "from activefail.seismic.bearing.pulse import ground_acceleration; ground_acceleration(0.1, 1.0, 1.0)\n"
        "from activefail.campaign.provenance import provenance, simulation_versions\n"
        "print(provenance()['numba_options'], simulation_versions()['numba_options'], provenance()['library_options'])"
    )
    # The machine may set some of these variables itself.
    unset = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", *_LIBRARY_OPTIONS))}
    return folder, [
        subprocess.run(
            [sys.executable, "-c", code],
            env=unset | options | {"NUMBA_CACHE_DIR": str(folder)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
        for options, _ in RECORDED
    ]


def test_the_environment_selects_the_kernels_and_is_recorded(another_cache: tuple[Path, list[str]]) -> None:
    folder, printed = another_cache
    assert printed == [recorded for _, recorded in RECORDED]
    assert len(list(folder.rglob("pulse.ground_acceleration*.nbi"))) == 3


def test_the_digest_of_the_physics_changes_with_the_syntax_and_not_with_words(tmp_path: Path) -> None:
    def digest(code: str) -> str:
        (tmp_path / "contact.py").write_text(code)
        physics_digest.cache_clear()
        return physics_digest(tmp_path)

    before = digest('"""Forces."""\n\ndef force(x: float) -> float:\n    """A force."""\n    return 2.0 * x\n')
    assert digest("def force(x: float) -> float:  # in newtons\n    return 2.0 * (x)\n") == before
    for changed in ("2.0 * y", "3.0 * x", "2.0 + x"):
        assert digest(f"def force(x: float) -> float:\n    return {changed}\n") != before


def test_kernels_in_another_cache_are_kept_by_the_sources_digest(another_cache: tuple[Path, list[str]]) -> None:
    folder, _ = another_cache
    assert [path.name for path in folder.iterdir()] == [folder_of_kernels().parent.name]
    assert list(folder.rglob("pulse.ground_acceleration*.nbi"))


@pytest.mark.parametrize(
    ("mode", "parent", "kept"),
    [
        (0o755, 0o755, True),
        (0o755, 0o1777, True),
        (0o1777, 0o755, False),
        (0o777, 0o755, False),
        (0o755, 0o777, False),
    ],
)
def test_kernels_are_kept_only_where_no_other_user_may_write(
    tmp_path: Path, mode: int, parent: int, kept: bool
) -> None:
    folder = tmp_path / "parent" / "cache"
    folder.mkdir(parents=True)
    folder.chmod(mode)
    folder.parent.chmod(parent)
    for _ in range(2):
        with kept_kernels(folder):
            kernel = njit(cache=True)(lambda x: x + 1.0)
        assert kernel(2.0) == 3.0
    assert bool(list(folder.rglob("*.nbi"))) is kept


def test_a_folder_that_is_created_for_kernels_is_private_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        with kept_kernels(tmp_path / "one" / "two"):
            kernel = njit(cache=True)(lambda x: x + 1.0)
    finally:
        os.umask(before)
    assert kernel(2.0) == 3.0
    assert list(tmp_path.rglob("*.nbi"))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a folder away")
@pytest.mark.parametrize("which", ["cache", "parent"])
def test_kernels_are_not_kept_in_another_user_s_folder(tmp_path: Path, which: str) -> None:
    folder = tmp_path / "parent" / "cache"
    folder.mkdir(parents=True)
    os.chown(folder if which == "cache" else folder.parent, 12345, 0)
    with kept_kernels(folder):
        kernel = njit(cache=True)(lambda x: x + 1.0)
    assert kernel(2.0) == 3.0
    assert not list(folder.rglob("*.nbi"))


def test_without_compilation_the_bearing_is_refused_with_the_reason() -> None:
    code = "import sys; from activefail.cli import program; program()"
    design = ["--t-b", "4", "--mu", "0.06", "--d-tot", "0.6", "--h-sl-ratio", "0.8", "--h-rim-ratio", "0.1"]
    design += ["--p", "45", "--k", "2e9", "--t-p", "2", "--a-p", "0.3"]
    done = subprocess.run(
        [sys.executable, "-c", code, "simulate", *design],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    assert "NUMBA_DISABLE_JIT is set, but the bearing's kernels run only when compiled" in done.stderr


ON_A_COPY = """
from activefail.seismic.bearing.kernels import KERNEL, kernel
from activefail.seismic.bearing.pulse import ground_acceleration

# `pulse` is compiled into a kernel of another file.
@kernel(**KERNEL)
def twice(t):
    return 2.0 * ground_acceleration(t, 1.0, 1.0)

print(twice(0.1), sum(twice.stats.cache_hits.values()))
"""


@pytest.fixture
def on_a_copy(tmp_path: Path) -> Callable[..., tuple[float, int]]:
    """Computes with a copy of the package: a kernel's result, and whether it was compiled before (1) or now (0)."""
    package = Path(activefail.__file__).parent
    shutil.copytree(package, tmp_path / "activefail", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "probe.py").write_text(ON_A_COPY)
    clean = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}

    def computed(**environment: str) -> tuple[float, int]:
        done = subprocess.run(
            [sys.executable, "-m", "probe"],
            cwd=tmp_path,
            env=clean | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"} | environment,
            check=True,
            capture_output=True,
            text=True,
        )
        assert done.stderr == ""
        result, hits = done.stdout.split()
        return float(result), int(hits)

    return computed


UNUSUAL = {
    "a file": {"NUMBA_CACHE_DIR": "/dev/null"},
    "several locators": {"NUMBA_CACHE_LOCATOR_CLASSES": "UserWideCacheLocator,InTreeCacheLocator"},
}


@pytest.mark.faults
@pytest.mark.parametrize("environment", UNUSUAL.values(), ids=UNUSUAL.keys())
def test_wherever_numba_would_keep_kernels_none_of_other_sources_or_options_runs(
    environment: dict[str, str],
    on_a_copy: Callable[..., tuple[float, int]],
    tmp_path: Path,
    survived: Callable[..., None],
) -> None:
    before, _ = on_a_copy(**environment)
    assert on_a_copy(**environment, NUMBA_OPT="1")[1] == 0
    pulse = tmp_path / "activefail" / "seismic" / "bearing" / "pulse.py"
    pulse.write_text(pulse.read_text().replace("PEAK = 1.38\n", "PEAK = 2.76\n"))
    assert on_a_copy(**environment) == (before / 2.0, 0)
    # None is in the folder that numba uses by default.
    assert not list(tmp_path.glob("**/__pycache__/*.nbi"))
    survived(3)


def test_the_simulator_says_when_it_is_compiled_and_only_then(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "contact.py").write_text("x")
    caplog.set_level("INFO", "activefail")

    def integrate(x: float) -> float:
        return x + 1.0

    for messages in (1, 1):  # the second time it is kept
        with kept_kernels(folder_of_kernels(tmp_path)):
            kernel = njit(cache=True)(integrate)
        assert kernel(2.0) == 3.0
        assert caplog.messages == ["compiling the simulator, once; this takes some 20 s"] * messages


ANSWERS = """
import hashlib
import numpy as np
from activefail.seismic.bearing.collision import collision_features
from activefail.seismic.bearing.design import TABLE_1
from activefail.seismic.bearing.simulation import simulate
from activefail.seismic.bearing.sliding import sliding_features

X = TABLE_1.from_unit(np.random.default_rng(3).random((300, 9)))
digest = hashlib.sha256()
for answers in (simulate(X).columns, sliding_features(X), collision_features(X)):
    digest.update(answers.tobytes())
print(digest.hexdigest())
"""

COMPILED_BEFORE = """
import math
from numba import njit

for fastmath in (False, True):
    # numba compiles some operations once a process, with the options of the first kernel that uses them.
    for operate in (
        lambda x, n: x**2 + x**n,
        lambda x, n: math.copysign(math.ceil(x), x) + round(x) + x % 2.0 + x // 2.0,
        lambda x, n: min(max(abs(x), 1.0), math.hypot(x, 2.0)) + (n % 3) ** 2 + n // 2,
    ):
        njit(error_model="numpy", fastmath=fastmath)(operate)(2.5, 3)
"""


@pytest.mark.faults
def test_kernels_give_the_same_bits_whatever_was_compiled_before_them(tmp_path: Path) -> None:
    def answers(code: str, **environment: str) -> str:
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=os.environ | environment, check=True, capture_output=True, text=True).stdout

    assert answers(COMPILED_BEFORE + ANSWERS, NUMBA_CACHE_DIR=str(tmp_path)) == answers(ANSWERS)
