"""Seismic isolation bearings: what the core does not know of."""
