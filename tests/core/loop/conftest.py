"""Tests of the loop's parts compute with one thread, as `Run` does: with several, sums differ in their last bits."""

from collections.abc import Iterator

import pytest

from activefail.learning.model.threads import one_thread


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    with one_thread():
        yield
