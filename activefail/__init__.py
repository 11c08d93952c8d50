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

__version__ = "0.1.0"

__all__ = ["TABLE_1", "Bearing", "Model", "Pulse", "Response", "Responses", "Tolerance", "simulate", "simulate_one"]


def __getattr__(name: str) -> Any:
    # Lazily: the command line shows its help without loading numba.
    if name in __all__:
        return getattr(import_module("activefail.bearing"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
