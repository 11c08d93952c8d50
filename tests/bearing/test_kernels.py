import os
import subprocess
import sys
from pathlib import Path

from activefail.bearing.kernels import remove_stale_kernels, sources_digest


def package(folder, source_time, kernel_time):
    (folder / "__pycache__").mkdir(parents=True)
    for path, moment in (
        (folder / "contact.py", source_time),
        (folder / "__pycache__" / "contact.f-1.nbi", kernel_time),
        (folder / "__pycache__" / "contact.f-1.1.nbc", kernel_time),
    ):
        path.write_text("x")
        os.utime(path, (moment, moment))
    return folder


def test_kernels_older_than_a_source_are_removed(tmp_path):
    stale = package(tmp_path / "a", source_time=2000, kernel_time=1000)
    assert remove_stale_kernels(stale) == 2
    assert list((stale / "__pycache__").iterdir()) == []


def test_kernels_newer_than_all_sources_stay(tmp_path):
    fresh = package(tmp_path / "a", source_time=1000, kernel_time=2000)
    assert remove_stale_kernels(fresh) == 0
    assert len(list((fresh / "__pycache__").iterdir())) == 2


def test_a_package_without_kernels_is_left_alone(tmp_path):
    (tmp_path / "contact.py").write_text("x")
    assert remove_stale_kernels(tmp_path) == 0


def test_the_digest_changes_with_a_source(tmp_path):
    (tmp_path / "contact.py").write_text("x")
    before = sources_digest(tmp_path)
    (tmp_path / "contact.py").write_text("y")
    assert sources_digest(tmp_path) != before


def test_kernels_in_another_cache_are_kept_by_the_sources_digest(tmp_path: Path) -> None:
    code = "from activefail.bearing.pulse import ground_acceleration; ground_acceleration(0.1, 1.0, 1.0)"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert [path.name for path in tmp_path.iterdir()] == [f"activefail-{sources_digest()[:16]}"]
    assert list(tmp_path.rglob("pulse.ground_acceleration*.nbi"))


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
    assert "NUMBA_DISABLE_JIT is set, but the kernels of the bearing run only compiled" in done.stderr


ANSWERS = """
import hashlib
import numpy as np
from activefail.bearing.collision import collision_features
from activefail.bearing.design import TABLE_1
from activefail.bearing.simulation import simulate
from activefail.bearing.sliding import sliding_features

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


def test_kernels_give_the_same_bits_whatever_was_compiled_before_them(tmp_path: Path) -> None:
    def answers(code: str, **environment: str) -> str:
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=os.environ | environment, check=True, capture_output=True, text=True).stdout

    assert answers(COMPILED_BEFORE + ANSWERS, NUMBA_CACHE_DIR=str(tmp_path)) == answers(ANSWERS)
