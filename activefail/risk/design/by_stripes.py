"""The cheapest design that meets its targets under finitely many values, such as records, stripe by stripe."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from activefail.errors import InputError
from activefail.findings.lines import titled
from activefail.json_text import json_values
from activefail.risk.design.design_task import DesignTask
from activefail.risk.design.findings import OUT_OF_REACH
from activefail.shares import short
from activefail.stripes.findings import StripeFindings
from activefail.stripes.stripe import Stripe, Stripes
from activefail.visible import visible

STEPS = 40
"""Steps of the range of a continuous free variable."""

_MEETS = 1.0 + 1e-9
"""Largest ratio of a probability to its target that meets it: weights that sum to the target may round above it."""


@dataclass(frozen=True, eq=False)
class DesignByStripes:
    """A design that meets its targets under finitely many values, or the largest or safest one.

    Attributes:
        task: what was asked.
        candidates: values of the free variables that could be the result, the cheapest first.
        stripes: by the place of a candidate, one stripe for each requirement.
        place: of the result.
    """

    task: DesignTask
    candidates: list[dict[str, float]]
    stripes: dict[int, tuple[Stripe, ...]]
    place: int

    @cached_property
    def found(self) -> tuple[StripeFindings, ...]:
        """The probability of each requirement's outcome at the result; the confidence is that of the intervals."""
        campaign, confidence = self.task.asked.campaign, self.task.confidence
        return tuple(StripeFindings.of(campaign, one, confidence) for one in self.stripes[self.place])

    @property
    def bearing(self) -> dict[str, Any]:
        """The values of all variables that are certain, by name."""
        return self.found[0].fixed

    @property
    def simulations(self) -> int:
        """Of this command."""
        return sum(one.new for stripes in self.stripes.values() for one in stripes)

    @property
    def meets(self) -> bool:
        """Whether the result meets its targets."""
        return _ratio(self.task, self.stripes[self.place]) <= _MEETS

    @property
    def exit_code(self) -> int:
        """`OUT_OF_REACH` if no design meets its targets."""
        return 0 if self.meets else OUT_OF_REACH

    @property
    def verdict(self) -> str:
        """What the result is, in one sentence."""
        name = self.task.free[0]
        if not _is_line(self.task):
            count = len(self.candidates)
            before = self.place if self.meets else count
            looked = sum(place < before for place in self.stripes)
            missed = f"{looked} miss it by their simulations, and {before - looked} by the classifier"
            if not self.meets:
                return f"None of {count} designs meets the target under these values: {missed}. This one is the safest."
            return (
                f"The cheapest of {count} designs that meets the target under these values, or the first of equally "
                f"cheap ones. Of the {before} before it, {missed}."
            )
        if not self.meets:
            return f"This largest {name} of the campaign's range does not meet the target under these values."
        if self.place == 0:
            return f"The least {name} of the campaign's range meets the target under these values."
        probabilities = ", ".join(f"{100.0 * one.probability:.3g} %" for one in self.stripes[self.place - 1])
        below = f"{name} = {self.candidates[self.place - 1][name]:.4g} has {probabilities}"
        return f"The smallest {name} that meets the target under these values; {below}."

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        known = {name: one if isinstance(one, str) else short(one) for name, one in self.bearing.items()}
        rows = [("design", visible(", ".join(f"{name} = {value}" for name, value in known.items())))]
        rows.append(("result", self.verdict))
        targets = [f"{100.0 * one.target:.4g} %" for one in self.task.requirements]
        rows.append(("target", f"{', '.join(targets)}; met by the values themselves, not by the upper ends below"))
        count = len(self.stripes) * len(self.found[0].stripe.values)
        stripes = f"{len(self.stripes)} values of {', '.join(self.task.free)}"
        rows.append(("from", f"{self.simulations} simulations now at {stripes}; all values would take {count}"))
        return [*titled(rows), *(line for one in self.found for line in one.lines)]

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        tried, written = sorted(self.stripes), self.task.asked.campaign.space.written
        probabilities = [[one.probability for one in self.stripes[place]] for place in tried]
        return json_values(
            {
                "status": "met" if self.meets else "out of reach",
                "bearing": self.bearing,
                "free": self.task.ranges,
                "simulations": self.simulations,
                "targets": {one.outcome: one.target for one in self.task.requirements},
                "outcomes": {key: of for one in self.found for key, of in one.as_json()["outcomes"].items()},
                "tried": [
                    {
                        "values": written(self.candidates[place]),
                        "probability": dict(zip(self._outcomes, shares, strict=True)),
                    }
                    for place, shares in zip(tried, probabilities, strict=True)
                ],
            }
        )

    @property
    def _outcomes(self) -> list[str]:
        return [one.outcome for one in self.task.requirements]


def _ratio(task: DesignTask, stripes: Iterable[Stripe]) -> float:
    """The largest ratio of a probability to its target."""
    return max(one.probability / of.target for one, of in zip(stripes, task.requirements, strict=True))


def design_by_stripes(stripes: Stripes, task: DesignTask, wrong: float) -> DesignByStripes:
    """Find the cheapest values of the free variables whose probabilities meet their targets.

    Of a single variable that is to be small it assumes that the probabilities fall with it. The classifier predicts
    where they meet the targets, and stripes there and beside it bracket the result, by steps that double; bisection
    ends the search. Of a catalogue, the cheapest design that the classifier predicts to meet them is asked for, until
    one does; if it predicts none, the safest one, until none seems safer than one that was asked for.

    Args:
        stripes: asks.
        task: with one free variable, which is to be small, or with finitely many designs.
        wrong: as for `Stripes.ask`.

    Raises:
        InputError: if the task has neither, or risks in a number of years.
    """
    if not (_is_line(task) or task.is_finite):
        raise InputError(
            "wrong: requires one free variable, which is made small, or free variables with steps or choices; leave "
            "the cost out, and fix the others."
        )
    if task.rate is not None:
        raise InputError("wrong: requires a target probability, not a risk in a number of years.")
    candidates = task.candidates({}) if task.is_finite else _grid(task)
    asked: dict[int, tuple[Stripe, ...]] = {}

    def meets(place: int) -> bool:
        if place not in asked:
            question = task.question.at(candidates[place])
            written = task.asked.campaign.space.written(candidates[place])
            stripes.stage(", ".join(f"{name} = {value}" for name, value in written.items()))
            asked[place] = tuple(stripes.ask(question, one.outcome, wrong) for one in task.requirements)
        return _ratio(task, asked[place]) <= _MEETS

    def ratio(place: int) -> float:
        """The largest ratio of a probability to its target, by the classifier if the place has not been asked for."""
        question = task.question.at(candidates[place])
        return _ratio(task, asked.get(place) or (stripes.predicted(question, one.outcome) for one in task.requirements))

    last = len(candidates) - 1
    if _is_line(task):
        start = min(last, _first(len(candidates), last // 2, lambda place: ratio(place) <= _MEETS))
        return DesignByStripes(task, candidates, asked, min(last, _first(len(candidates), start, meets)))
    while True:
        # The classifier learns from each stripe. The first that promises to meet the targets is the least so far.
        ratios = [ratio(0)]
        while ratios[-1] > _MEETS and len(ratios) <= last:
            ratios.append(ratio(len(ratios)))
        place = int(np.argmin(ratios))
        if place in asked:
            return DesignByStripes(task, candidates, asked, place)
        meets(place)


def _is_line(task: DesignTask) -> bool:
    """Whether a single variable with an order is to be small."""
    return len(task.free) == 1 and not task.choices and task.cost_text == task.free[0]


def _grid(task: DesignTask) -> list[dict[str, float]]:
    """The values of a continuous variable that could be the result, as decimal numbers are written.

    Raises:
        InputError: if constraints allow none.
    """
    name = task.free[0]
    values = [float(f"{x:.12g}") for x in np.linspace(task.low[name], task.high[name], STEPS + 1)]
    if not (allowed := [{name: value} for value in values if task.allows({name: value})]):
        raise InputError(f"constraints: no value of {name} meets them.")
    return allowed


def _first(count: int, start: int, holds: Callable[[int], bool]) -> int:
    """The first of the places 0, 1, ... from which on a condition holds; `count` if it holds nowhere.

    Brackets it from `start` by steps that double, and bisects.
    """
    step, low, high = 1, -1, count
    if holds(start):
        high = start
        while high > 0 and low < 0:
            place = max(0, high - step)
            if not holds(place):
                low = place
                break
            high, step = place, 2 * step
    else:
        low = start
        while low < count - 1 and high == count:
            place = min(count - 1, low + step)
            if holds(place):
                high = place
                break
            low, step = place, 2 * step
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
