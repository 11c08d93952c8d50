"""The smallest design that meets its targets under finitely many values, such as records, stripe by stripe."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from activefail.errors import InputError
from activefail.findings.lines import titled
from activefail.json_text import json_values
from activefail.risk.design.design_task import DesignTask
from activefail.risk.design.findings import OUT_OF_REACH
from activefail.space import Array
from activefail.stripes.findings import StripeFindings
from activefail.stripes.stripe import Stripe, Stripes
from activefail.visible import visible

STEPS = 40
"""Steps of the range of a continuous free variable."""


@dataclass(frozen=True, eq=False)
class DesignByStripes:
    """A design that meets its targets under finitely many values, or the largest one.

    Attributes:
        task: what was asked; it has one free variable.
        values: of the free variable that could be the result, (k,), increasing.
        stripes: by the place of a value, one stripe for each requirement.
        place: of the result; the last one if none meets the targets.
    """

    task: DesignTask
    values: Array
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
        return _meets(self.task, self.stripes[self.place])

    @property
    def exit_code(self) -> int:
        """`OUT_OF_REACH` if no design meets its targets."""
        return 0 if self.meets else OUT_OF_REACH

    @property
    def verdict(self) -> str:
        """What the result is, in one sentence."""
        name = self.task.free[0]
        if not self.meets:
            return f"This largest {name} of the campaign's range does not meet the target under these values."
        if self.place == 0:
            return f"The least {name} of the campaign's range meets the target under these values."
        probabilities = ", ".join(f"{100.0 * one.probability:.3g} %" for one in self.stripes[self.place - 1])
        below = f"{name} = {self.values[self.place - 1]:.4g} has {probabilities}"
        return f"The smallest {name} that meets the target under these values; {below}."

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        known = {name: one if isinstance(one, str) else f"{one:.4g}" for name, one in self.bearing.items()}
        rows = [("design", visible(", ".join(f"{name} = {value}" for name, value in known.items())))]
        rows.append(("result", self.verdict))
        targets = [f"{100.0 * one.target:.4g} %" for one in self.task.requirements]
        rows.append(("target", f"{', '.join(targets)}; met by the values themselves, not by the upper ends below"))
        count = len(self.stripes) * len(self.found[0].stripe.values)
        stripes = f"{len(self.stripes)} values of {self.task.free[0]}"
        rows.append(("from", f"{self.simulations} simulations now at {stripes}, of {count} in all"))
        return [*titled(rows), *(line for one in self.found for line in one.lines)]

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        name, tried = self.task.free[0], sorted(self.stripes)
        probabilities = [[one.probability for one in self.stripes[place]] for place in tried]
        return json_values(
            {
                "status": "met" if self.meets else "out of reach",
                "bearing": self.bearing,
                "free": {name: [self.values[0], self.values[-1]]},
                "simulations": self.simulations,
                "targets": {one.outcome: one.target for one in self.task.requirements},
                "outcomes": {key: of for one in self.found for key, of in one.as_json()["outcomes"].items()},
                "tried": [
                    {"value": self.values[place], "probability": dict(zip(self._outcomes, shares, strict=True))}
                    for place, shares in zip(tried, probabilities, strict=True)
                ],
            }
        )

    @property
    def _outcomes(self) -> list[str]:
        return [one.outcome for one in self.task.requirements]


def _meets(task: DesignTask, stripes: tuple[Stripe, ...]) -> bool:
    return all(
        one.probability <= requirement.target + 1e-12
        for one, requirement in zip(stripes, task.requirements, strict=True)
    )


def design_by_stripes(stripes: Stripes, task: DesignTask, wrong: float) -> DesignByStripes:
    """Find the smallest value of the free variable whose probabilities meet their targets.

    It assumes that the probabilities fall with the variable. The classifier predicts where they meet the targets, and
    stripes there and beside it bracket the result, by steps that double; bisection ends the search.

    Args:
        stripes: asks.
        task: with one free variable, which is to be small.
        wrong: as for `Stripes.ask`.

    Raises:
        InputError: if the task has several free variables, or risks in a number of years.
    """
    if len(task.free) > 1:
        raise InputError("wrong: requires one free variable, which is made small; fix the others.")
    if task.rate is not None:
        raise InputError("wrong: requires a target probability, not a risk in a number of years.")
    name = task.free[0]
    stepped = task.stepped.get(name)
    values = _grid(task.low[name], task.high[name]) if stepped is None else stepped.values
    values = values[[task.allows({name: value}) for value in values.tolist()]]
    if not len(values):
        raise InputError(f"constraints: no value of {name} meets them.")
    asked: dict[int, tuple[Stripe, ...]] = {}

    def meets(place: int) -> bool:
        if place not in asked:
            question = task.question.at({name: float(values[place])})
            stripes.stage(f"{name} = {values[place]:.4g}")
            asked[place] = tuple(stripes.ask(question, one.outcome, wrong) for one in task.requirements)
        return _meets(task, asked[place])

    def predicted(place: int) -> bool:
        question = task.question.at({name: float(values[place])})
        return all(stripes.by_classifier(question, one.outcome) <= one.target for one in task.requirements)

    last = len(values) - 1
    start = min(last, _first(len(values), last // 2, predicted))
    return DesignByStripes(task, values, asked, min(last, _first(len(values), start, meets)))


def _grid(low: float, high: float) -> Array:
    """The values of a continuous variable that could be the result, as decimal numbers are written."""
    return np.array([float(f"{value:.12g}") for value in np.linspace(low, high, STEPS + 1)])


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
