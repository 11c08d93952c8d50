"""The compiled kernels: their compiler options, and checks of cached kernels against the sources."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from activefail.errors import InputError

KERNEL: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
"""Options of every kernel: division by zero gives infinity; a product and a sum may be fused, with one rounding.

Results then depend on the processor type, as they already do through the exponential, and on numba's options in the
environment. Kernels write squares as products, because numba compiles a power with a whole exponent as a function of
its own, once in a process, with the options of the first kernel that uses it.
"""

_PACKAGE = Path(__file__).parent


def remove_stale_kernels(package: Path = _PACKAGE) -> int:
    """Delete all compiled kernels of a package if a source is newer than the oldest one; returns the number deleted.

    numba checks only a kernel's own file, not those of the functions that it calls: after a change in one of these it
    would continue to use the old code.
    """
    removed = 0
    # A read-only package was not edited in place.
    with suppress(OSError):
        compiled = [*(package / "__pycache__").glob("*.nbi"), *(package / "__pycache__").glob("*.nbc")]
        built = [index.stat().st_mtime for index in compiled if index.suffix == ".nbi"]
        if built and max(source.stat().st_mtime for source in package.glob("*.py")) > min(built):
            for path in compiled:
                path.unlink(missing_ok=True)
                removed += 1
    return removed


@contextmanager
def cached_by_sources(package: Path = _PACKAGE) -> Iterator[None]:
    """Keep kernels that are defined meanwhile in a folder of these sources, if numba's cache is not in the package.

    The cache is elsewhere if `NUMBA_CACHE_DIR` says so, or if the package cannot be written. `remove_stale_kernels`
    does not see it.
    """
    from numba.core import config
    from numba.misc.appdirs import AppDirs

    before = config.CACHE_DIR
    elsewhere = before or ("" if os.access(package, os.W_OK) else AppDirs("numba", False).user_cache_dir)
    if elsewhere:
        config.CACHE_DIR = str(Path(elsewhere) / f"activefail-{sources_digest(package)[:16]}")
    try:
        yield
    finally:
        config.CACHE_DIR = before


def check_compiled() -> None:
    """Check that numba compiles.

    Raises:
        InputError: if `NUMBA_DISABLE_JIT` is set.
    """
    from numba.core import config

    if config.DISABLE_JIT:
        raise InputError("NUMBA_DISABLE_JIT is set, but the kernels of the bearing run only compiled. Unset it.")


def sources_digest(package: Path = _PACKAGE) -> str:
    """SHA-256 of the package's sources, which identifies the version of the physics."""
    digest = hashlib.sha256()
    for source in sorted(package.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()
