"""The target boundaries of a campaign and the share of designs for each."""

from collections.abc import Mapping


def boundary_shares(boundary: str | Mapping[str, float]) -> dict[str, float]:
    """The share of active designs for each target boundary, by outcome; the shares sum to 1.

    Args:
        boundary: one outcome, or positive finite weights by outcome.
    """
    weights = {boundary: 1.0} if isinstance(boundary, str) else boundary
    # Divide by the largest first: the sum of huge weights would overflow.
    largest = max(weights.values())
    scaled = {name: weight / largest for name, weight in weights.items()}
    return {name: weight / sum(scaled.values()) for name, weight in scaled.items()}
