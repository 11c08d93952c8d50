"""The clusters of the tests."""

from execution.test_dask import alone, shared

__all__ = ["alone", "shared"]
