"""Removes compiled kernels that are older than the sources: numba looks at a kernel's own file, not at its callees'."""

from pathlib import Path

import pytest

_BEARING = Path(__file__).parents[1] / "activefail" / "bearing"


def remove_stale_kernels(package: Path) -> int:
    """Delete every compiled kernel of a package when one of its sources is newer than the oldest; how many went."""
    compiled = [*(package / "__pycache__").glob("*.nbi"), *(package / "__pycache__").glob("*.nbc")]
    built = [index.stat().st_mtime for index in compiled if index.suffix == ".nbi"]
    if not built or max(source.stat().st_mtime for source in package.glob("*.py")) <= min(built):
        return 0
    for path in compiled:
        path.unlink(missing_ok=True)
    return len(compiled)


def pytest_configure(config: pytest.Config) -> None:
    # The workers of pytest-xdist find the job done: deleting under a running neighbour would only cost it time.
    if not hasattr(config, "workerinput"):
        remove_stale_kernels(_BEARING)
