"""How long work reports its progress."""

from collections.abc import Callable

Begin = Callable[[int], Callable[[int], None]]
"""Called with the number of steps of some work; returns a callback for finished ones."""

Stage = Callable[[str], None]
"""Called with each stage of some work as it begins."""


def uncounted(total: int) -> Callable[[int], None]:
    """Show no progress."""
    return lambda done: None


def silent(stage: str) -> None:
    """Show no stage."""
