"""Reliability problems whose failure is rare, as simulators of a campaign."""

from dataclasses import dataclass

import numpy as np

from activefail.campaign.settings import CampaignSettings
from activefail.simulators.interface import Results


@dataclass(frozen=True)
class RareProblem:
    """A limit state over independent normal variables; failure where it is at most 0.

    Attributes:
        name: of the problem.
        means, sds: (d,) of the variables.
        probability: of failure, as published.
    """

    name: str
    means: tuple[float, ...]
    sds: tuple[float, ...]
    probability: float

    outcomes = ("safe", "failure")
    causes = ("",)
    margins = ()
    releases_gil = True

    def limit(self, X: np.ndarray) -> np.ndarray:
        """The limit state at designs, (n, d)."""
        if self.name == "four-branch":
            x, y = X.T
            bent = 3.0 + 0.1 * (x - y) ** 2
            branches = [bent - (x + y) / 2**0.5, bent + (x + y) / 2**0.5, x - y + 7 / 2**0.5, y - x + 7 / 2**0.5]
            return np.min(branches, axis=0)
        a, b, c, d, e, f, g = X.T
        load = d**2 - 4.0 * e * f * g**2 + d * (f + 4.0 * e + 2.0 * f * g)
        return 15.59e4 - a * b**3 / (2.0 * c**3) * load / (d * e * (d + f + 2.0 * f * g))

    def run(self, X: np.ndarray) -> Results:
        """Answer designs, (n, d)."""
        failed, nothing = (self.limit(X) <= 0.0).astype(np.int8), np.zeros(len(X))
        return Results(failed, nothing.astype(np.int8), np.empty((len(X), 0)), nothing)

    def settings(self, **changes: object) -> CampaignSettings:
        """Settings of a campaign on it: variables within six standard deviations; other keys with `__` for a dot."""
        space = {
            f"x{number}": {"low": mean - 6.0 * sd, "high": mean + 6.0 * sd, "distribution": "truncated_normal"}
            | {"mean": mean, "sd": sd}
            for number, (mean, sd) in enumerate(zip(self.means, self.sds, strict=True), start=1)
        }
        named = {key.replace("__", "."): value for key, value in changes.items()}
        return CampaignSettings().changed({"space": space, "classifier.features": "design"} | named)


FOUR_BRANCH = RareProblem("four-branch", (0.0, 0.0), (1.0, 1.0), 2.2e-3)
"""Series system with k = 7 (Waarts 2000)."""

_PLATE = (350.0, 50.8, 3.81, 173.0, 9.38, 33.1, 0.036)
RP38 = RareProblem("RP38", _PLATE, tuple(0.1 * mean for mean in _PLATE), 8.1e-3)
"""Of the reliability challenge of Rozsas and Slobbe (2019)."""
