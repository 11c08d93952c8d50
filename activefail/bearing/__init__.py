"""The bearing model: a double friction pendulum bearing under a pulse, with rim impact, slider rotation and uplift."""

from activefail.bearing.kernels import kept_kernels

with kept_kernels():
    # Not used here: imported so that their kernels are defined here too.
    from activefail.bearing import collision, motion, record_features  # noqa: F401
    from activefail.bearing.accelerogram import Accelerogram
    from activefail.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance
    from activefail.bearing.simulation import Response, Responses, simulate, simulate_one, simulate_records

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
