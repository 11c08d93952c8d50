"""What the tests of faults share in both wings."""

from faults.test_input import taken

__all__ = ["taken"]
