"""Cases of a claim of which `make test` or `make test-faults` tests some, and `make test-all` and `make faults` all."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def some(cases: Iterable[Any], *kept: Any) -> list[Any]:
    """The cases for `parametrize`: those that are not to be kept are marked as exhaustive."""
    cases = list(cases)
    assert all(case in cases for case in kept), kept
    return [case if case in kept else exhaustive(case) for case in cases]


def some_of(cases: Iterable[Any], kept: Collection[int]) -> list[Any]:
    """The same, with those to be kept by their places."""
    return [case if place in kept else exhaustive(case) for place, case in enumerate(cases)]


def exhaustive(case: Any) -> Any:
    """One case that only `make test-all` and `make faults` test; a tuple has the values of several arguments."""
    values = case if type(case) is tuple else (case,)  # a named tuple is one value
    return pytest.param(*values, marks=pytest.mark.exhaustive)
