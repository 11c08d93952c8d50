"""Where simulations run: threads, worker processes with time limits, or a Dask cluster."""
