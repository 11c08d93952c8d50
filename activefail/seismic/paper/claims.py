"""The paper's claims compared with activefail's results: intervals and a verdict for each."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from statsmodels.stats.proportion import proportion_confint

from activefail.seismic.features import PAPER_FEATURES
from activefail.seismic.ida.sample_mean import Estimate, Interval, contains
from activefail.seismic.paper import published
from activefail.seismic.paper.study import SIGNIFICANCE, Draw, Study, significant_share
from activefail.space.space import Array

REPRODUCED, BY_CHANCE, NOT_REPRODUCED = "reproduced", "within one sample's spread", "**not reproduced**"

PERCENT = 0.005
"""Largest error of a share rounded to whole per cents."""

NOTICEABLE = 0.5
"""Difference [points of accuracy] below which two methods count as the same: a third of one held-out design."""


@dataclass(frozen=True)
class Claim:
    """One line of the page's first table.

    Attributes:
        item, paper, ours, one_sample, rule, verdict: the cells, as text.
        estimate: what `ours` and `one_sample` state, if it is one number.
        unit: of the estimate: "share", or "points", hundredths of a share.
    """

    item: str
    paper: str
    ours: str
    one_sample: str
    rule: str
    verdict: str
    estimate: Estimate | None = None
    unit: str = ""

    @property
    def lines(self) -> list[str]:
        """The claim for a terminal."""
        return [
            f"{self.item}: {self.verdict.replace('*', '')}",
            f"    paper {self.paper or '–'}   ours {self.ours}   one sample {self.one_sample or '–'}",
        ]

    @property
    def cells(self) -> dict[str, str]:
        """The texts of the page's table, by name."""
        names = ("item", "paper", "ours", "one_sample", "rule", "verdict")
        return {name: getattr(self, name) for name in names}

    def as_json(self) -> dict[str, object]:
        """The claim's texts, and its numbers where it has any (docs/reference/json.md)."""
        texts: dict[str, object] = {**self.cells, "verdict": self.verdict.replace("*", "")}
        if self.estimate is None:
            return texts | {"estimate": None}
        intervals = (self.estimate.of_mean, self.estimate.of_one)
        (low, high), (lowest, highest) = map(_clipped, intervals) if self.unit == "share" else intervals
        return texts | {
            "estimate": {
                "mean": self.estimate.mean,
                "low": low,
                "high": high,
                "one_sample_low": lowest,
                "one_sample_high": highest,
                "confidence": 0.95,
                "unit": self.unit,
            }
        }


def logistic(draws: list[Draw], boundary: str, name: str) -> Array:
    """A statistic of the logistic regressions of a boundary, (draws,)."""
    return np.array([getattr(draw.logistic[boundary], name) for draw in draws])


def process(draws: list[Draw], method: str, name: str) -> Array:
    """A statistic of the Gaussian processes of a method, (draws, ...)."""
    return np.array([getattr(draw.processes[method], name) for draw in draws])


def held_out(draws: list[Draw]) -> Array:
    """Held-out accuracies of the Laplace process, (draws, splits)."""
    return np.array([draw.held_out for draw in draws])


def fresh_gain(draws: list[Draw], method: str = "laplace") -> Array:
    """Fresh accuracy of a process minus that of logistic regression, trained on the same points, (draws,)."""
    return np.asarray(process(draws, method, "fresh") - np.array([draw.three_quarters for draw in draws]))


def papers_gain(draws: list[Draw]) -> Array:
    """The paper's comparison: held-out accuracy minus logistic regression's in-sample accuracy, (draws, splits)."""
    return np.asarray(held_out(draws) - logistic(draws, "failure", "in_sample")[:, None])


def length_ratio(draws: list[Draw], method: str) -> Array:
    """Median length scale of the insignificant features over that of the significant ones, (draws,)."""
    lengths = process(draws, method, "length_scales")
    significant_ones = papers_significant("failure")
    others = [i for i in range(lengths.shape[1]) if i not in significant_ones]
    return np.asarray(np.median(lengths[:, others], axis=1) / np.median(lengths[:, significant_ones], axis=1))


def significant(p_values: Array) -> list[int]:
    """Columns whose p-values are below 5 %."""
    return [i for i, p in enumerate(p_values) if p < SIGNIFICANCE]


def papers_significant(boundary: str) -> list[int]:
    """Columns that are significant in the paper."""
    return significant(np.array(published.P_VALUES[boundary]))


def majority(draws: list[Draw], boundary: str) -> list[int]:
    """Columns significant in more than half of the draws."""
    return [i for i, share in enumerate(significant_share(draws, boundary)) if share > 0.5]


def medians_outside(study: Study) -> list[int]:
    """Features whose median in the paper lies outside the prediction interval of one of our samples."""
    rows = published.table_2(study.data.X)
    return [
        i
        for i, (row, (_, theirs)) in enumerate(zip(rows, published.TABLE_2, strict=True))
        # Half a unit of the two decimals in the paper.
        if not contains(Estimate.over(row.median).of_one, theirs, 0.005)
    ]


def percent_of(share: float, n: int) -> str:
    """A share of n samples with its Wilson 95 % interval."""
    low, high = proportion_confint(share * n, n, method="wilson")
    return f"{100 * share:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def named(columns: list[int]) -> str:
    """Names of features."""
    return ", ".join(PAPER_FEATURES[i] for i in columns) or "none"


def named_with_shares(draws: list[Draw], boundary: str) -> str:
    """Features significant in most draws, with the share of draws and its interval."""
    shares = significant_share(draws, boundary)
    columns = majority(draws, boundary)
    return "; ".join(f"{PAPER_FEATURES[i]} {percent_of(shares[i], len(draws))}" for i in columns) or "none"


def _clipped(interval: Interval) -> Interval:
    """An interval of a share within 0 and 1."""
    return max(interval[0], 0.0), min(interval[1], 1.0)


def span(interval: Interval, digits: int = 3, share: bool = False) -> str:
    """An interval as text; that of a share is clipped to 0 and 1."""
    low, high = _clipped(interval) if share else interval
    return f"{low:.{digits}f} to {high:.{digits}f}"


def with_mean(values: Array, digits: int = 3, share: bool = False) -> str:
    """The mean with its 95 % interval."""
    estimate = Estimate.over(values)
    return f"{estimate.mean:.{digits}f} ({span(estimate.of_mean, digits, share)})"


_BY_INTERVALS = "both intervals"


def _verdict(estimate: Estimate, theirs: float, rounding: float) -> str:
    if contains(estimate.of_mean, theirs, rounding):
        return REPRODUCED
    return BY_CHANCE if contains(estimate.of_one, theirs, rounding) else NOT_REPRODUCED


def _reproduced(yes: bool) -> str:
    return REPRODUCED if yes else NOT_REPRODUCED


def _share(item: str, theirs: float, values: Array) -> Claim:
    estimate = Estimate.over(values)
    one_sample = span(estimate.of_one, share=True)
    verdict = _verdict(estimate, theirs, PERCENT)
    ours = with_mean(values, share=True)
    return Claim(item, f"{theirs:.2f}", ours, one_sample, _BY_INTERVALS, verdict, estimate, "share")


def _gain(item: str, values: Array) -> Claim:
    estimate = Estimate.over(values)
    points = Estimate.over(100.0 * values)
    ours, one_sample = with_mean(100.0 * values, 1) + " points", span(points.of_one, 1)
    verdict = _verdict(estimate, published.GAIN, PERCENT)
    theirs = f"{100 * published.GAIN:.0f} points"
    return Claim(item, theirs, ours, one_sample, _BY_INTERVALS, verdict, points, "points")


def _significance(draws: list[Draw], boundary: str) -> Claim:
    theirs, ours = papers_significant(boundary), majority(draws, boundary)
    return Claim(
        f"features significant for {boundary}",
        named(theirs),
        named_with_shares(draws, boundary),
        "",
        "the same features in most samples",
        _reproduced(theirs == ours),
    )


def claims(study: Study) -> list[Claim]:
    """Every claim of the paper with our result, the rule and the verdict."""
    draws = study.draws
    fresh = process(draws, "laplace", "fresh")
    difference = 100.0 * (process(draws, "ep", "fresh") - fresh)
    longer = float(np.mean(length_ratio(draws, "laplace") >= 10.0))
    outside = medians_outside(study)
    return [
        *(
            _share(
                f"logistic regression, {boundary}, in-sample accuracy", theirs, logistic(draws, boundary, "in_sample")
            )
            for boundary, theirs in published.LOGISTIC.items()
        ),
        *(_significance(draws, boundary) for boundary in published.P_VALUES),
        _share("Gaussian process (Laplace), failure, held-out quarter", published.HELD_OUT, held_out(draws)),
        Claim(
            "the same on fresh designs",
            "",
            with_mean(fresh, share=True),
            span(Estimate.over(fresh).of_one, share=True),
            "",
            "not in the paper",
            Estimate.over(fresh),
            "share",
        ),
        _gain("gain over logistic regression, compared as in the paper", papers_gain(draws)),
        _gain("the same, with equal training data and fresh designs", fresh_gain(draws)),
        Claim(
            "expectation propagation against Laplace, fresh accuracy",
            "the same",
            with_mean(difference, 2) + " points",
            span(Estimate.over(difference).of_one, 2),
            f"mean within {NOTICEABLE} points",
            _reproduced(abs(float(difference.mean())) < NOTICEABLE),
            Estimate.over(difference),
            "points",
        ),
        Claim(
            "length scales, insignificant over significant features",
            "an order of magnitude",
            f"10 × or more in {percent_of(longer, len(draws))} of the samples",
            "",
            "in most samples",
            _reproduced(longer > 0.5),
        ),
        Claim(
            "medians of the features",
            "Table 2",
            f"outside: {named(outside)}",
            "",
            "all within one sample's interval",
            _reproduced(not outside),
        ),
    ]


CONCLUSIONS: dict[str, Callable[[list[Draw]], bool]] = {
    "the same two significant features for impact": lambda draws: (
        majority(draws, "impact") == papers_significant("impact")
    ),
    "the same three significant features for failure": lambda draws: (
        majority(draws, "failure") == papers_significant("failure")
    ),
    f"logistic regression, impact: {published.LOGISTIC['impact']} within one sample's spread": lambda draws: contains(
        Estimate.over(logistic(draws, "impact", "in_sample")).of_one, published.LOGISTIC["impact"], PERCENT
    ),
    f"logistic regression, failure: {published.LOGISTIC['failure']} within one sample's spread": lambda draws: contains(
        Estimate.over(logistic(draws, "failure", "in_sample")).of_one, published.LOGISTIC["failure"], PERCENT
    ),
    f"Gaussian process: {published.HELD_OUT} held out within one sample's spread": lambda draws: contains(
        Estimate.over(held_out(draws)[:, :1]).of_one, published.HELD_OUT, PERCENT
    ),
    "Gaussian process more accurate on fresh designs": lambda draws: Estimate.over(fresh_gain(draws)).of_mean[0] > 0.0,
}
"""The paper's conclusions, each as a condition on a study's draws."""
