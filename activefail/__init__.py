"""Learns where a seismic isolation bearing fails, with as few simulations as possible."""

from importlib import import_module
from typing import Any

from activefail.plugins import brought, find_packages_of_plugins
from activefail.text.current_folder import NUMBA, keep_out
from activefail.version import __version__ as __version__

keep_out(NUMBA)
find_packages_of_plugins()

_MODULES = {
    **dict.fromkeys(("ActivefailError", "BusyError", "InputError", "SimulationError", "StoreError"), "errors"),
    "Run": "run.run",
    "create_run": "run.opening",
    "open_run": "run.opening",
}
"""Modules of the core's names; those of plug-ins come with them. Type checkers read `__init__.pyi`."""


def __getattr__(name: str) -> Any:
    # Lazily: the command line shows its help without loading numba.
    if name in _MODULES:
        return getattr(import_module(f"activefail.{_MODULES[name]}"), name)
    if name == "__all__":
        return sorted([*_MODULES, *brought("names")])
    # Python asks a package for names of its own before it has any.
    if not name.startswith("_") and name in (names := brought("names")):
        return names[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
