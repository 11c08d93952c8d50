"""The bearing model: a double friction pendulum bearing under a pulse, with rim impact, slider rotation and uplift."""

from activefail.bearing.kernels import remove_stale_kernels

# Must run before any kernel is loaded.
remove_stale_kernels()

from activefail.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance  # noqa: E402
from activefail.bearing.simulation import Response, Responses, simulate, simulate_one  # noqa: E402

__all__ = ["TABLE_1", "Bearing", "Model", "Pulse", "Response", "Responses", "Tolerance", "simulate", "simulate_one"]
