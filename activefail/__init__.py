"""Learns where a seismic isolation bearing fails, with as few simulations as possible."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from activefail.bearing import (
        TABLE_1,
        Bearing,
        Model,
        Pulse,
        Response,
        Responses,
        Tolerance,
        simulate,
        simulate_one,
    )
    from activefail.errors import ActivefailError, BusyError, InputError, SimulationError, StoreError
    from activefail.opening import create_run, open_run
    from activefail.run import Run

__version__ = "0.1.0"

__all__ = [
    "TABLE_1",
    "ActivefailError",
    "Bearing",
    "BusyError",
    "InputError",
    "Model",
    "Pulse",
    "Response",
    "Responses",
    "Run",
    "SimulationError",
    "StoreError",
    "Tolerance",
    "create_run",
    "open_run",
    "simulate",
    "simulate_one",
]

_ERRORS = ("ActivefailError", "BusyError", "InputError", "SimulationError", "StoreError")

_MODULES = {"Run": "run", "create_run": "opening", "open_run": "opening", **dict.fromkeys(_ERRORS, "errors")}


def __getattr__(name: str) -> Any:
    # Lazily: the command line shows its help without loading numba.
    if name in __all__:
        return getattr(import_module(f"activefail.{_MODULES.get(name, 'bearing')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
