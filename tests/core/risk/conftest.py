"""What the tests of risks share: the simulators that they write run in this process."""

from collections.abc import Iterator

import pytest

from activefail.execution.local import ThreadExecutor


@pytest.fixture(scope="module", autouse=True)
def simulations_in_this_process() -> Iterator[None]:
    """Simulate in a thread: what is claimed here are numbers and messages, and starting processes takes most of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("activefail.execution.local.ProcessExecutor", lambda *_: ThreadExecutor(1))
        yield
