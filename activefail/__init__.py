"""Learns where a seismic isolation bearing fails, with as few simulations as possible."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from activefail.text.current_folder import NUMBA, keep_out
from activefail.version import __version__ as __version__

if TYPE_CHECKING:
    from activefail.errors import ActivefailError, BusyError, InputError, SimulationError, StoreError
    from activefail.run.opening import create_run, open_run
    from activefail.run.run import Run
    from activefail.seismic.analyses import hazard, ida
    from activefail.seismic.bearing import (
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
    from activefail.seismic.ida.p695 import MarginRequest
    from activefail.seismic.motions.accelerogram_files import read_accelerogram
    from activefail.seismic.motions.accelerogram_sets import RecordSet, SetRecord, read_record_set

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
    "read_accelerogram": "seismic.motions.accelerogram_files",
    **dict.fromkeys(("RecordSet", "SetRecord", "read_record_set"), "seismic.motions.accelerogram_sets"),
    **dict.fromkeys(("hazard", "ida"), "seismic.analyses"),
    "MarginRequest": "seismic.ida.p695",
    "Run": "run.run",
    "create_run": "run.opening",
    "open_run": "run.opening",
    **dict.fromkeys(_ERRORS, "errors"),
}


def __getattr__(name: str) -> Any:
    # Lazily: the command line shows its help without loading numba.
    if name in __all__:
        return getattr(import_module(f"activefail.{_MODULES.get(name, 'seismic.bearing')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
