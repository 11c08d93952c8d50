"""A simulator that costs nothing and whose boundary is known: a disc in the plane, two variables and two outcomes."""

from dataclasses import dataclass

import numpy as np

from activefail.campaign.config import CampaignSettings, parse_settings
from activefail.campaign.simulator import NUMERICAL_FAILURE, Results
from activefail.space import Array

LOW, HIGH = np.array([-2.0, 10.0]), np.array([3.0, 50.0])
CENTRE, RADIUS = np.array([0.55, 0.4]), 0.32
"""Of the disc, in units of the variables' ranges: no bound of the plane is near its rim."""


def distance(X: Array) -> Array:
    """Signed distance of designs, (n, 2), to the boundary, in units of the ranges; positive inside the disc."""
    return np.asarray(RADIUS - np.linalg.norm((X - LOW) / (HIGH - LOW) - CENTRE, axis=1))


@dataclass(frozen=True)
class Disc:
    """Safe outside the disc, broken inside it; no answer where `x` lies below `blind`."""

    blind: float = -np.inf

    outcomes = ("safe", "broken")
    causes = ("", "crack", "blind")
    margins = ("distance",)
    releases_gil = True

    def run(self, X: Array) -> Results:
        """Answer designs (x, y), shape (n, 2)."""
        inside = distance(X) > 0.0
        blind = X[:, 0] < self.blind
        outcome = np.where(blind, NUMERICAL_FAILURE, inside).astype(np.int8)
        return Results(
            outcome, np.where(blind, 2, inside).astype(np.int8), distance(X)[:, None].copy(), np.zeros(len(X))
        )


def disc_settings(initial: int = 12, budget: int = 28, batch: int = 4, seed: int = 1, more: str = "") -> CampaignSettings:
    """Settings of a campaign on the disc; `more` is further TOML."""
    return parse_settings(
        f"""
        seed = {seed}
        sampling = {{ initial = {initial}, budget = {budget}, batch = {batch} }}
        classifier.features = "design"
        acquisition.boundary = "broken"
        space.x = {{ low = {LOW[0]}, high = {HIGH[0]} }}
        space.y = {{ low = {LOW[1]}, high = {HIGH[1]} }}
        {more}
        """,
        "disc",
    )
