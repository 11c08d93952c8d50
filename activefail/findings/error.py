"""The classifier's error in numbers and words."""

from dataclasses import dataclass
from typing import Any

from activefail.findings.lines import titled
from activefail.shares import percent
from activefail.verification.error import ErrorEstimate


@dataclass(frozen=True)
class ErrorFindings:
    """The share of the design space that the classifier gets wrong.

    Attributes:
        estimate: of the error, with its interval.
        boundary: outcome of the target boundary.
        learned: simulations of the campaign, without fresh ones.
        iteration: of the classifier.
    """

    estimate: ErrorEstimate
    boundary: str
    learned: int
    iteration: int

    exit_code = 0

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        one = self.estimate
        rows = [
            ("campaign", f"{self.learned} simulations, iteration {self.iteration}"),
            ("error", f"{one.text} of the design space on the wrong side of the boundary of {self.boundary}"),
            (
                "",
                f"{100 * one.confidence:g} % interval from {one.in_words}, {one.wrong} of them misclassified; the "
                "error is their weighted share",
            ),
            ("expected", f"{percent(one.expected, 2)} by the classifier's own probabilities, without an interval"),
        ]
        return titled(rows)

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        of_campaign = {"campaign_simulations": self.learned, "iteration": self.iteration}
        return {"boundary": self.boundary, **self.estimate.as_json(), **of_campaign}
