"""What the tests of risks share: the simulators that they write run in this process."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def in_this_process(simulations_in_this_process: None) -> None:
    """All of them claim numbers and messages."""
