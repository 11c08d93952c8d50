"""The bearing model: a double friction pendulum bearing under a pulse, with rim impact, slider rotation and uplift."""

from activefail.bearing.kernels import cached_by_sources, remove_stale_kernels

# Both must come before any kernel is defined.
remove_stale_kernels()
with cached_by_sources():
    # Not used here: imported so that their kernels are defined here too.
    from activefail.bearing import collision, motion  # noqa: F401
    from activefail.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance
    from activefail.bearing.simulation import Response, Responses, simulate, simulate_one

__all__ = ["TABLE_1", "Bearing", "Model", "Pulse", "Response", "Responses", "Tolerance", "simulate", "simulate_one"]
