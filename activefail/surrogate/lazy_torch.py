"""torch, imported at its first use: its import takes longer than the predictions that do without it."""

from typing import Any


def __getattr__(name: str) -> Any:
    import torch

    value = globals()[name] = getattr(torch, name)
    return value
