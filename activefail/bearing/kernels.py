"""The compiled kernels: how they are compiled, and which sources those on disk belong to."""

import hashlib
from contextlib import suppress
from pathlib import Path
from typing import Any

KERNEL: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
"""Options of every kernel: a division by zero gives infinity; a product and a sum may be rounded once instead of twice.

A result then depends on the processor's kind, as it does through the exponential already, but on nothing else.
"""

_PACKAGE = Path(__file__).parent


def remove_stale_kernels(package: Path = _PACKAGE) -> int:
    """Delete every compiled kernel of a package when one of its sources is newer than the oldest; how many went.

    numba looks at a kernel's own file, not at those of the functions that it calls: after a change in one of them it
    would go on with the old physics.
    """
    removed = 0
    # A package that cannot be written to was not edited in place either.
    with suppress(OSError):
        compiled = [*(package / "__pycache__").glob("*.nbi"), *(package / "__pycache__").glob("*.nbc")]
        built = [index.stat().st_mtime for index in compiled if index.suffix == ".nbi"]
        if built and max(source.stat().st_mtime for source in package.glob("*.py")) > min(built):
            for path in compiled:
                path.unlink(missing_ok=True)
                removed += 1
    return removed


def sources_digest(package: Path = _PACKAGE) -> str:
    """SHA-256 over the package's sources: what tells one version of the physics from another."""
    digest = hashlib.sha256()
    for source in sorted(package.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()
