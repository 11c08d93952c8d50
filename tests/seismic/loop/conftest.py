"""Tests of the loop compute with one thread, as `Run` does: with several, sums differ in their last bits."""

from loop.conftest import _one_thread

__all__ = ["_one_thread"]
