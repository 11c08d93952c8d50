"""Learns where a seismic isolation bearing fails, with as few simulations as possible."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from activefail.current_folder import NUMBA, keep_out
from activefail.version import __version__ as __version__

if TYPE_CHECKING:
    from activefail.accelerogram_files import read_accelerogram
    from activefail.accelerogram_sets import RecordSet, SetRecord, read_record_set
    from activefail.bearing import (
        TABLE_1,
        Accelerogram,
        Bearing,
        Model,
        Pulse,
        Response,
        Responses,
        Tolerance,
        simulate,
        simulate_one,
        simulate_records,
    )
    from activefail.errors import ActivefailError, BusyError, InputError, SimulationError, StoreError
    from activefail.opening import create_run, open_run
    from activefail.risk.ida.p695 import MarginRequest
    from activefail.run import Run
    from activefail.seismic.analyses import hazard, ida

keep_out(NUMBA)

__all__ = [
    "TABLE_1",
    "Accelerogram",
    "ActivefailError",
    "Bearing",
    "BusyError",
    "InputError",
    "MarginRequest",
    "Model",
    "Pulse",
    "RecordSet",
    "Response",
    "Responses",
    "Run",
    "SetRecord",
    "SimulationError",
    "StoreError",
    "Tolerance",
    "create_run",
    "hazard",
    "ida",
    "open_run",
    "read_accelerogram",
    "read_record_set",
    "simulate",
    "simulate_one",
    "simulate_records",
]

_ERRORS = ("ActivefailError", "BusyError", "InputError", "SimulationError", "StoreError")

_MODULES = {
    "read_accelerogram": "accelerogram_files",
    **dict.fromkeys(("RecordSet", "SetRecord", "read_record_set"), "accelerogram_sets"),
    **dict.fromkeys(("hazard", "ida"), "seismic.analyses"),
    "MarginRequest": "risk.ida.p695",
    "Run": "run",
    "create_run": "opening",
    "open_run": "opening",
    **dict.fromkeys(_ERRORS, "errors"),
}


def __getattr__(name: str) -> Any:
    # Lazily: the command line shows its help without loading numba.
    if name in __all__:
        return getattr(import_module(f"activefail.{_MODULES.get(name, 'bearing')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
