"""The versions, options, threads and processor that a campaign's exact results depend on, besides its settings."""

import os
import platform
from functools import cache
from importlib.metadata import version

from activefail.seismic.bearing.kernels import compiler_options, physics_digest
from activefail.version import __version__
from activefail.visible import visible

BEARING_SOURCES = "bearing_sources"
"""The entry for the digest of the bearing's physics."""

_PACKAGES = ("numpy", "scipy", "torch", "gpytorch", "botorch", "numba", "h5py")

_LIBRARY_OPTIONS = (
    "ATEN_CPU_CAPABILITY",
    "GLIBC_TUNABLES",
    "MKL_CBWR",
    "MKL_DEBUG_CPU_TYPE",
    "MKL_ENABLE_INSTRUCTIONS",
    "NPY_DISABLE_CPU_FEATURES",
    "NPY_ENABLE_CPU_FEATURES",
    "ONEDNN_MAX_CPU_ISA",
    "OPENBLAS_CORETYPE",
)
"""Environment variables that select other code in the C library, NumPy, OpenBLAS, MKL and PyTorch."""


@cache
def _version(name: str) -> str:
    """The version of an installed package. It is kept, because each opening of a run folder asks for it."""
    # `version` returns None if the package's metadata is unreadable.
    return version(name) or "unknown"


def simulation_versions() -> dict[str, str]:
    """The versions that simulation results depend on, on any machine."""
    return {
        "activefail": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in ("numpy", "numba")},
        BEARING_SOURCES: physics_digest(),
        "numba_options": compiler_options(),
    }


def provenance() -> dict[str, str]:
    """Versions of Python, numerical packages and physics; number of threads; processor; options of the libraries."""
    record = {"python": platform.python_version(), "threads": "1", "machine": platform.machine()}
    record |= {name: _version(name) for name in _PACKAGES}
    import llvmlite.binding as llvm

    record[BEARING_SOURCES] = physics_digest()
    record["processor"] = llvm.get_host_cpu_name()
    # Numba compiles for these features; two machines of the same name can differ in them.
    record["processor_features"] = ",".join(
        sorted(name for name, present in llvm.get_host_cpu_features().items() if present)
    )
    record["numba_options"] = compiler_options()
    options = [f"{name}={visible(os.environ[name])}" for name in _LIBRARY_OPTIONS if name in os.environ]
    record["library_options"] = " ".join(options) or "defaults"
    return record
