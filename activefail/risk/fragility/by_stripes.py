"""A fragility curve under finitely many values, such as records: a stripe at each of a few levels."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.question import Question
from activefail.csv_table import Target, writing
from activefail.errors import InputError
from activefail.findings.lines import aligned, titled
from activefail.json_text import json_values
from activefail.risk.fragility.curve import Ladder
from activefail.risk.ida.collapse import CONFIDENCE, Fragility, fit_lognormal, fitted
from activefail.shares import interval_percent, percent, significant, values_in_words
from activefail.space import Array
from activefail.stripes.findings import StripeFindings
from activefail.stripes.stripe import Stripe, Stripes
from activefail.visible import or_worse

LEVELS = 4
"""Levels of a curve by stripes."""

_FIRST, _LAST = 0.05, 0.7
"""Probabilities by the classifier between which the levels lie."""

_COARSE = 3
"""Steps of the ladder between levels at which the classifier is asked where these are."""


@dataclass(frozen=True, eq=False)
class FragilityByStripes:
    """The probability of an outcome or a more severe one at a few levels, and the lognormal curve of its values.

    Attributes:
        ladder: of the variable, m levels.
        beyond: (m, n) whether each value is, or is predicted to be, beyond the boundary at each level of the ladder.
        levels: (k,) increasing.
        stripes: (k,) what was found at each.
        found: (k,) the same in numbers and words.
        given: values of the other variables, in words.
    """

    ladder: Ladder
    beyond: NDArray[np.bool_]
    levels: Array
    stripes: tuple[Stripe, ...]
    found: tuple[StripeFindings, ...]
    given: str

    exit_code = 0

    @cached_property
    def brackets(self) -> tuple[Array, Array]:
        """For each value the highest level that it survives below its capacity, and its capacity, (n,) each.

        They are 0 below the lowest level, and infinite above the highest.
        """
        levels = self.ladder.levels
        first = np.where(self.beyond.any(axis=0), self.beyond.argmax(axis=0), len(levels))
        return np.append(0.0, levels)[first], np.append(levels, np.inf)[first]

    @cached_property
    def fit(self) -> Fragility | None:
        """The lognormal curve, with intervals over groups if there are any; None where the levels do not bound it.

        Values without the same probability have none, and a variable that is not positive.
        """
        values = self.stripes[0].values
        if not self.ladder.levels[0] > 0.0 or not np.allclose(values.weight, values.weight[0]):
            return None
        if values.group is None:
            return None if (one := fit_lognormal(*self.brackets)) is None else Fragility(one, (), ())
        return fitted(*self.brackets, list(map(str, values.group.tolist())))

    @property
    def simulations(self) -> int:
        """Of this command."""
        return sum(one.new for one in self.stripes)

    @property
    def event(self) -> str:
        """The outcome or a more severe one, in words."""
        return or_worse(self.found[0].stripe.outcome, self.found[0].outcomes)

    @property
    def heading(self) -> str:
        """What the curve is of."""
        return f"probability of {self.event} against {self.ladder.name}"

    @property
    def why_no_median(self) -> str:
        """Why there is no median between the levels; empty if there is one."""
        (first, last), weight = self.ladder.levels[[0, -1]].tolist(), self.stripes[0].values.weight
        if not np.allclose(weight, weight[0]):
            return "the values are not equally probable"
        why = ""
        if not first > 0.0:
            why = "the levels are not all positive"
        elif self.fit is None:
            why = "the levels do not bound it"
        elif not first <= self.fit.fit.median <= last:
            why = "it lies beyond every level, an extrapolation"
        return why and f"{why}; choose others with --range"

    @property
    def table(self) -> list[list[str]]:
        """A header, and a row for each level."""
        title = f"{self.ladder.name} [{self.ladder.unit}]" if self.ladder.unit else self.ladder.name
        sure = f"{100.0 * self.found[0].confidence:g} %"
        rows = [[title, "P", f"these, {sure}", f"others, {sure}", "simulated", "now"]]
        for level, found in zip(self.levels.tolist(), self.found, strict=True):
            others = "–" if found.others is None else interval_percent(*found.others, 1)
            known = f"{int(found.stripe.known.sum())} of {len(found.stripe.values)}"
            share, these = percent(found.stripe.probability), interval_percent(*found.these, 1)
            rows.append([f"{level:.4g}", share, these, others, known, str(found.stripe.new)])
        return rows

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts."""
        why = self.why_no_median
        texts = [("lognormal", f"none: {why}")]
        if self.fit is not None:
            unit = f" {self.ladder.unit}" if self.ladder.unit else ""
            median, dispersion = f"{significant(self.fit.fit.median)}{unit}", significant(self.fit.fit.dispersion)
            basis = f"of capacities between {len(self.ladder.levels)} levels; intervals leave out wrong predictions"
            texts = [
                ("median", f"{median}{_ends(self.fit.median)}{why and f'; {why}'}"),
                ("dispersion", f"{dispersion}{_ends(self.fit.dispersion)}"),
                ("fit", basis),
            ]
        count = len(self.stripes) * len(self.stripes[0].values)
        return [*texts, ("from", f"{self.simulations} simulations now; all values at all levels would take {count}")]

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        # The intervals assume no more at any level than where the largest share is taken to be wrong.
        widest = max(self.found, key=lambda one: (one.stripe.predicted.any(), one.stripe.sure_wrong.mean))
        notes = [("note", sentence) for sentence in widest.assumptions]
        head = self.heading + (f" at {self.given}" if self.given else "")
        return [head, *aligned(self.table), *titled([*self.rows, *notes])]

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        outcome, fit = self.stripes[0].outcome, self.fit
        return json_values(
            {
                "variable": self.ladder.name,
                "outcome": outcome,
                "simulations": self.simulations,
                "levels": [
                    {"level": level, **one.as_json()["outcomes"][outcome]}
                    for level, one in zip(self.levels.tolist(), self.found, strict=True)
                ],
                "lognormal": fit
                and {
                    "median": fit.fit.median,
                    "dispersion": fit.fit.dispersion,
                    "median_interval": list(fit.median) or None,
                    "dispersion_interval": list(fit.dispersion) or None,
                    "confidence": CONFIDENCE,
                },
            }
        )

    def write_table(self, target: Target) -> None:
        """Write a row for each level: the probability with both intervals, and how many values are simulated."""
        header = ["probability", "low", "high", "others_low", "others_high", "simulated", "predicted"]
        with writing(target, [self.ladder.name, *header]) as write:
            for level, one in zip(self.levels.tolist(), self.found, strict=True):
                others = ("", "") if one.others is None else one.others
                counts = int(one.stripe.known.sum()), int(one.stripe.predicted.sum())
                write([[level, one.stripe.probability, *one.these, *others, *counts]])


def _ends(interval: tuple[float, float] | tuple[()]) -> str:
    if not interval:
        return ", without an interval"
    return f" ({significant(interval[0])} to {significant(interval[1])}, {100.0 * CONFIDENCE:g} %, over groups)"


def fragility_by_stripes(
    stripes: Stripes, question: Question, ladder: Ladder, outcome: str, wrong: float, confidence: float
) -> FragilityByStripes:
    """The curve of an outcome or a more severe one, from stripes at a few levels; each teaches the next.

    The levels lie between those at which the classifier puts 5 % and 70 % of the values beyond the boundary. They are
    asked for from the middle outwards: the middle teaches most. The classifier, which has then learned from all of
    them, says between which levels of the ladder each capacity is.

    Args:
        stripes: asks.
        question: the distribution of the variables.
        ladder: all levels.
        outcome: of the boundary.
        wrong: as for `Stripes.ask`.
        confidence: of the intervals.
    """

    def at(level: float) -> Question:
        return question.at({ladder.name: level})

    all_levels = ladder.levels.astype(np.float64)
    coarse = np.unique(np.append(all_levels[::_COARSE], all_levels[-1]))
    shares = np.array([stripes.predicted(at(level), outcome).probability for level in coarse.tolist()])
    inside = np.flatnonzero((shares >= _FIRST) & (shares <= _LAST))
    if not len(inside):
        raise InputError(
            f"wrong: the classifier puts no level of {ladder.name} between {100 * _FIRST:g} and {100 * _LAST:g} %; "
            "choose others with --range."
        )
    ends = coarse[[max(0, inside[0] - 1), min(len(coarse) - 1, inside[-1] + 1)]]
    levels = all_levels[(all_levels >= ends[0]) & (all_levels <= ends[1])]
    levels = levels[np.unique(np.linspace(0, len(levels) - 1, LEVELS).round().astype(int))]
    order = np.argsort(np.abs(np.arange(len(levels)) - len(levels) // 2), kind="stable")
    found: dict[int, Stripe] = {}
    for place in order.tolist():
        stripes.stage(f"{ladder.name} = {levels[place]:.4g}")
        found[place] = stripes.ask(at(float(levels[place])), outcome, wrong)
    asked = tuple(found[place] for place in range(len(levels)))
    beyond = np.array([stripes.predicted(at(level), outcome).beyond for level in all_levels.tolist()])
    of = tuple(StripeFindings.of(stripes.campaign, one, confidence) for one in asked)
    given = values_in_words(stripes.campaign.space, question.fixed)
    return FragilityByStripes(ladder, beyond, levels, asked, of, given)
