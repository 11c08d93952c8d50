"""The versions, options, threads and processor that a campaign's exact results depend on, besides its settings."""

import os
import platform
from collections.abc import Collection
from functools import cache
from importlib.metadata import version

from activefail.campaign.named import NamedSettings
from activefail.campaign.settings import NAMED
from activefail.plugins import brought
from activefail.version import __version__
from activefail.visible import visible

_PACKAGES = ("numpy", "scipy", "torch", "gpytorch", "botorch", *brought("libraries"), "h5py")

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
        **{name: _version(name) for name in ("numpy", *brought("libraries"))},
        **{name: text for one in NAMED.values() for name, text in (one.sources() | one.options()).items()},
    }


def provenance(used: Collection[type[NamedSettings] | NamedSettings] | None = None) -> dict[str, str]:
    """Versions of Python and numerical packages; digests; number of threads; processor; options of the libraries.

    Args:
        used: what plug-ins bring of which the record has sources and options; all if None.
    """
    used = NAMED.values() if used is None else used
    record = {"python": platform.python_version(), "threads": "1", "machine": platform.machine()}
    record |= {name: _version(name) for name in _PACKAGES}
    for one in used:
        record |= one.sources()
    record |= {name: fact() for name, fact in brought("provenance").items()}
    for one in used:
        record |= one.options()
    options = [f"{name}={visible(os.environ[name])}" for name in _LIBRARY_OPTIONS if name in os.environ]
    record["library_options"] = " ".join(options) or "defaults"
    return record
