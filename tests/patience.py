"""How long tests wait for an event that must happen.

No test says how fast anything is: `studies/` measures that. A test waits for an event, and fails after a limit
only so that it does not hang if the event never comes.
"""

import time
from collections.abc import Callable
from typing import Any, TypeVar

PATIENCE = 600.0
"""How long a test waits for an event [s]: many times what the slowest one takes on a busy machine."""

T = TypeVar("T")


class Clock:
    """The module `time` with a monotonic clock of a test's own, for a module to be given instead of it.

    A time limit is over once the test has it be over, neither sooner nor later.

    Args:
        now: the time [s].
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self.monotonic = now

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)


def until(holds: Callable[[], T], what: str = "an event") -> T:
    """Wait until something holds, and give what it gave."""
    give_up = time.monotonic() + PATIENCE
    while not (value := holds()):
        assert time.monotonic() < give_up, f"waited {PATIENCE:.0f} s for {what}"
        time.sleep(0.02)
    return value
