import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core import config

from activefail.bearing.kernels import compiler_options, kept_kernels, sources_digest


def kept(package: Path) -> Path:
    with kept_kernels(package):
        return Path(config.CACHE_DIR)


def test_kernels_of_earlier_sources_are_deleted_and_those_of_the_present_sources_stay(tmp_path: Path) -> None:
    source = tmp_path / "contact.py"
    source.write_text("x")
    kernel = kept(tmp_path) / "bearing_1" / "contact.f-1.1.nbc"
    kernel.parent.mkdir(parents=True)
    kernel.write_bytes(b"x")
    assert kept(tmp_path) in kernel.parents
    assert kernel.exists()
    source.write_text("y")
    assert kept(tmp_path) not in kernel.parents
    assert not kernel.exists()


def test_kernels_compiled_under_other_options_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "contact.py").write_text("x")
    folders = {kept(tmp_path)}
    assert compiler_options() == "defaults"
    for name, value in (("OPT", 0), ("SLP_VECTORIZE", 1), ("CPU_NAME", "generic"), ("DEBUGINFO_DEFAULT", 1)):
        with monkeypatch.context() as patched:
            patched.setattr(config, name, value)
            assert compiler_options() == f"NUMBA_{name}={value}"
            folders.add(kept(tmp_path))
    assert len(folders) == 5


def test_the_environment_selects_the_kernels_and_is_recorded(tmp_path: Path) -> None:
    code = (
        "from activefail.bearing.pulse import ground_acceleration; ground_acceleration(0.1, 1.0, 1.0)\n"
        "from activefail.campaign.provenance import provenance, simulation_versions\n"
        "print(provenance()['numba_options'], simulation_versions()['numba_options'], provenance()['library_options'])"
    )
    for options, recorded in (
        ({}, "defaults defaults defaults"),
        ({"NUMBA_OPT": "max"}, "NUMBA_OPT=max NUMBA_OPT=max defaults"),
        (
            {"NUMBA_OPT": "1", "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2", "OPENBLAS_CORETYPE": "Haswell"},
            "NUMBA_OPT=1 NUMBA_OPT=1 GLIBC_TUNABLES=glibc.cpu.hwcaps=-AVX2 OPENBLAS_CORETYPE=Haswell",
        ),
    ):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | options | {"NUMBA_CACHE_DIR": str(tmp_path)},
            check=True,
            capture_output=True,
            text=True,
        )
        assert done.stdout.strip() == recorded
    assert len(list(tmp_path.rglob("pulse.ground_acceleration*.nbi"))) == 3


def test_the_digest_changes_with_a_source(tmp_path):
    (tmp_path / "contact.py").write_text("x")
    before = sources_digest(tmp_path)
    (tmp_path / "contact.py").write_text("y")
    assert sources_digest(tmp_path) != before


def test_kernels_in_another_cache_are_kept_by_the_sources_digest(tmp_path: Path) -> None:
    code = "from activefail.bearing.pulse import ground_acceleration; ground_acceleration(0.1, 1.0, 1.0)"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert [path.name for path in tmp_path.iterdir()] == [f"kernels-{sources_digest()[:16]}"]
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
