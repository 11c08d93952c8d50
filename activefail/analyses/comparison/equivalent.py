"""The size of a static design that is as accurate as a campaign."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from activefail.analyses.comparison.static import by_size, median_score, score_lines
from activefail.estimates.scores import Score
from activefail.record.layout import CURVES, SCORES
from activefail.space.shares import percent
from activefail.space.space import Array

_Z = 1.96
"""Least difference of two accuracies that no chance explains, in standard errors."""


@dataclass(frozen=True)
class Equivalent:
    """The size of a static design that is as accurate at the target boundary as a campaign's last score.

    The size is interpolated in the logarithm of the size, on the medians of the static designs' accuracies. It has no
    confidence interval: `lowest` and `highest` are the sizes along the single series of static designs, and there is
    one campaign.

    Attributes:
        simulations: of the campaign.
        accuracy: its accuracy.
        test_designs: number of test designs.
        size: of a static design as accurate as the campaign; None if the largest one is less accurate.
        lowest, highest: the same for each series of static designs; None as for `size`.
        static_accuracy: of the median static design of the campaign's size; None without one of this size.
        series: number of static designs of each size.
        smallest, largest: static sizes.
    """

    simulations: int
    accuracy: float
    test_designs: int
    size: float | None
    lowest: float | None
    highest: float | None
    static_accuracy: float | None
    series: int
    smallest: int
    largest: int

    def in_words(self, boundary: str) -> str:
        """A sentence, for example for the end of `activefail compare`."""
        right = (
            f"After {self.simulations} simulations the campaign is right about {boundary} for "
            f"{percent(self.accuracy, 2)} of {self.test_designs:,} fresh designs"
        )
        if self.size is None:
            text = f"{right}, more often than static sampling after {self.largest:,}"
        elif self.size <= self.smallest:
            text = f"{right}, not more often than static sampling after {self.smallest:,}"
        else:
            text = f"{right}, as often as static sampling after about {_rounded(self.size):,}"
        if self.series == 1:
            text += " (from one static design of each size; another gives another number)."
        else:
            low, high = (self._bound(size) for size in (self.lowest, self.highest))
            along = low if low == high else f"{low} to {high}"
            text += f" ({along} over the {self.series} series of static designs)."
        if self.static_accuracy is not None and not self.differs:
            text += (
                f" A static design of the same size is right for {percent(self.static_accuracy, 2)}: "
                f"{self.test_designs:,} test designs show no difference."
            )
        return text

    @property
    def differs(self) -> bool:
        """Whether the accuracy differs from that of a static design of the same size, by two independent test sets.

        Both share one set, on which they mostly err alike: a difference that this finds is larger than by chance.
        """
        if self.static_accuracy is None:
            return False
        variance = sum(p * (1.0 - p) for p in (self.accuracy, self.static_accuracy)) / self.test_designs
        return bool(abs(self.accuracy - self.static_accuracy) > _Z * np.sqrt(variance))

    def _bound(self, size: float | None) -> str:
        if size is None:
            return f"more than {self.largest:,}"
        return f"at most {self.smallest:,}" if size <= self.smallest else f"{_rounded(size):,}"


def equivalent(scores: Sequence[Score]) -> Equivalent | None:
    """The equivalent static size of the last active score; None without scores of both samplings."""
    active = max((row for row in scores if row.sampling == "active"), key=lambda row: row.simulations, default=None)
    groups = by_size([row for row in scores if row.sampling == "static"])
    if active is None or not groups:
        return None
    # A table from elsewhere may lack some designs.
    series = min(len(group) for group in groups)
    accuracy = np.array([[row.accuracy for row in group[:series]] for group in groups])
    sizes = np.array([group[0].simulations for group in groups])

    same = [group for group in groups if group[0].simulations == active.simulations]

    def reached(columns: slice) -> float | None:
        return simulations_to_reach(sizes, np.median(accuracy[:, columns], axis=1), active.accuracy)

    each = sorted((reached(slice(k, k + 1)) for k in range(series)), key=lambda size: np.inf if size is None else size)
    return Equivalent(
        active.simulations,
        active.accuracy,
        active.test_designs,
        reached(slice(None)),
        each[0],
        each[-1],
        median_score(same[0]).accuracy if same else None,
        series,
        int(sizes[0]),
        int(sizes[-1]),
    )


def simulations_to_reach(sizes: NDArray[np.int64], accuracies: Array, level: float) -> float | None:
    """The size at which accuracies, (n,) by size, first reach a level, interpolated in log n; None if never."""
    reached = np.nonzero(accuracies >= level)[0]
    if not len(reached):
        return None
    after = int(reached[0])
    if after == 0:
        return float(sizes[0])
    share = (level - accuracies[after - 1]) / (accuracies[after] - accuracies[after - 1])
    return float(np.exp(np.log(sizes[after - 1]) + share * np.log(sizes[after] / sizes[after - 1])))


def _rounded(size: float) -> int:
    """A size to two significant digits: interpolation does not give more."""
    return int(float(f"{size:.2g}"))


@dataclass(frozen=True)
class ComparisonFindings:
    """The scores of a campaign and of static designs.

    Attributes:
        scores: of both, at each number of simulations.
        boundary: outcome of the target boundary.
        folder: with the table and the figure.
    """

    scores: list[Score]
    boundary: str
    folder: Path
    exit_code: ClassVar[int] = 0

    @property
    def equivalent(self) -> Equivalent | None:
        """The size of a static design that is as accurate as the campaign; None without a static design."""
        return equivalent(self.scores)

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        return [
            *score_lines(self.scores, self.boundary),
            f"table      {self.folder}/{SCORES}",
            f"curves     {self.folder}/{CURVES}.png and .svg",
            *([] if self.equivalent is None else [self.equivalent.in_words(self.boundary)]),
        ]

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        same = None if self.equivalent is None else asdict(self.equivalent)
        return {"boundary": self.boundary, "scores": [asdict(row) for row in self.scores], "equivalent": same}
