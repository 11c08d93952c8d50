"""The physics: a double friction pendulum bearing under a pulse, with rim impact, slider rotation and uplift."""

from activefail.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance
from activefail.bearing.simulate import Response, Responses, simulate, simulate_one

__all__ = ["TABLE_1", "Bearing", "Model", "Pulse", "Response", "Responses", "Tolerance", "simulate", "simulate_one"]
