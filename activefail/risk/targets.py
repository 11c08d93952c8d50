"""Targets of the probability of failure, by name."""

from typing import NamedTuple


class Target(NamedTuple):
    """A largest probability of failure under the risk-targeted maximum considered earthquake, MCE_R.

    Attributes:
        name: of the target.
        probability: given MCE_R.
    """

    name: str
    probability: float


TARGETS = (
    Target("risk category II", 0.10),
    Target("risk category III", 0.05),
    Target("risk category IV", 0.025),
)
"""Structural stability under MCE_R [ASCE2017, table 1.3-2]."""
