"""Which outcomes' boundaries a campaign seeks, and how much it gives each."""

from collections.abc import Mapping


def boundary_shares(boundary: str | Mapping[str, float]) -> dict[str, float]:
    """The outcomes whose boundaries are sought, and each one's share of the chosen designs; their sum is 1.

    Args:
        boundary: one outcome, or positive finite weights of several.
    """
    weights = {boundary: 1.0} if isinstance(boundary, str) else boundary
    # By the largest first: the sum of huge weights must not overflow.
    largest = max(weights.values())
    scaled = {name: weight / largest for name, weight in weights.items()}
    return {name: weight / sum(scaled.values()) for name, weight in scaled.items()}
