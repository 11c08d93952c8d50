"""The versions, threads and processor that a campaign's bits depend on besides its settings."""

import platform
from importlib.metadata import version

from activefail import __version__
from activefail.bearing.kernels import sources_digest

_PACKAGES = ("numpy", "scipy", "torch", "gpytorch", "botorch", "numba", "h5py")


def simulation_versions() -> dict[str, str]:
    """The versions that simulation results depend on, on any machine."""
    return {
        "activefail": __version__,
        "python": platform.python_version(),
        **{name: version(name) or "unknown" for name in ("numpy", "numba")},
        "bearing_sources": sources_digest(),
    }


def provenance() -> dict[str, str]:
    """Versions of Python, numerical packages and physics; number of threads; processor."""
    record = {"python": platform.python_version(), "threads": "1", "machine": platform.machine()}
    # `version` returns None if a package's metadata is unreadable.
    record |= {name: version(name) or "unknown" for name in _PACKAGES}
    import llvmlite.binding as llvm

    record["bearing_sources"] = sources_digest()
    record["processor"] = llvm.get_host_cpu_name()
    # Numba compiles for these features; two machines of the same name can differ in them.
    record["processor_features"] = ",".join(
        sorted(name for name, present in llvm.get_host_cpu_features().items() if present)
    )
    return record
