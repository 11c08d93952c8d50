"""The bearing model: a double friction pendulum bearing under a pulse, with rim impact, slider rotation and uplift."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from activefail.seismic.bearing.accelerogram import Accelerogram
    from activefail.seismic.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance
    from activefail.seismic.bearing.simulation import Response, Responses, simulate, simulate_one, simulate_records

__all__ = [
    "TABLE_1",
    "Accelerogram",
    "Bearing",
    "Model",
    "Pulse",
    "Response",
    "Responses",
    "Tolerance",
    "simulate",
    "simulate_one",
    "simulate_records",
]

_DESIGN = ("TABLE_1", "Bearing", "Model", "Pulse", "Tolerance")


def __getattr__(name: str) -> Any:
    # Lazily: settings know the model's defaults without loading numba.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "design" if name in _DESIGN else "accelerogram" if name == "Accelerogram" else "simulation"
    return getattr(import_module(f"activefail.seismic.bearing.{module}"), name)
