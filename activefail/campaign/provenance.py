"""What a campaign's bits depend on besides its settings: versions, threads and the processor."""

import platform
from importlib.metadata import version

from activefail import __version__
from activefail.bearing.kernels import sources_digest

_PACKAGES = ("numpy", "scipy", "torch", "gpytorch", "botorch", "numba", "h5py")


def simulation_versions() -> dict[str, str]:
    """What the answers of simulations depend on, whichever machine computes them."""
    return {
        "activefail": __version__,
        "python": platform.python_version(),
        **{name: version(name) or "unknown" for name in ("numpy", "numba")},
        "bearing_sources": sources_digest(),
    }


def provenance() -> dict[str, str]:
    """Versions of Python, of the packages that compute and of the physics, threads of a sum, and the processor."""
    record = {"python": platform.python_version(), "threads": "1", "machine": platform.machine()}
    # None where a package's metadata is there and cannot be read.
    record |= {name: version(name) or "unknown" for name in _PACKAGES}
    import llvmlite.binding as llvm

    record["bearing_sources"] = sources_digest()
    record["processor"] = llvm.get_host_cpu_name()
    # The features that numba compiles for; two machines of one name can differ in them.
    record["processor_features"] = ",".join(
        sorted(name for name, there in llvm.get_host_cpu_features().items() if there)
    )
    return record
