"""Searches for the cheapest design that meets its targets under finitely many values, such as records, by stripes."""

from collections.abc import Callable

import numpy as np

from activefail.analyses.design.design_task import DesignTask
from activefail.analyses.design.search import Candidate, Designed, Look
from activefail.analyses.stripes.stripe import Stripes
from activefail.errors import InputError
from activefail.space.shares import values_in_words
from activefail.space.space import Array

STEPS = 40
"""Steps of the range of a continuous free variable."""

_MEETS = 1.0 + 1e-9
"""Largest ratio of a probability to its target that meets it: weights that sum to the target may round above it."""


def design_by_stripes(stripes: Stripes, task: DesignTask, wrong: float) -> Designed:
    """Find the cheapest values of the free variables whose probabilities meet their targets.

    Of a single variable that is to be small it assumes that the probabilities fall with it. The classifier predicts
    where they meet the targets, and stripes there and beside it bracket the result, by steps that double; bisection
    ends the search. Of a catalogue, the cheapest design that the classifier predicts to meet them is asked for, until
    one does; if it predicts none, the safest one, until none seems safer than one that was asked for. The classifier
    learns from each stripe.

    Args:
        stripes: asks.
        task: with one free variable, which is to be small, or with finitely many designs.
        wrong: as for `Stripes.ask`.

    Raises:
        InputError: if the task has neither, or risks in a number of years.
    """
    if not (task.is_line or task.is_finite):
        raise InputError(
            "wrong: requires one free variable, which is made small, or free variables with steps or choices; leave "
            "the cost out, and fix the others."
        )
    if task.rate is not None:
        raise InputError("wrong: requires a target probability, not a risk in a number of years.")
    candidates, outcomes = candidates_of(task), [one.outcome for one in task.requirements]
    looks: dict[int, Look] = {}
    found: dict[int, Array] = {}  # by simulations
    predicted: dict[int, Array] = {}  # by the present classifier

    def model(place: int) -> Array:
        if place not in predicted:
            question = task.question.at(candidates[place])
            predicted[place] = np.array([stripes.predicted(question, outcome).probability for outcome in outcomes])
        return predicted[place]

    def ratio(place: int) -> float:
        """The largest ratio of a probability to its target, by the classifier if the place has not been asked for."""
        return float(((found[place] if place in found else model(place)) / task.targets).max())

    def meets(place: int) -> bool:
        if place not in looks:
            values, question = candidates[place], task.question.at(candidates[place])
            candidate = Candidate(values, model(place), ratio(place) <= _MEETS)
            stripes.stage(values_in_words(task.asked.campaign.space, values))
            asked = tuple(stripes.ask(question, outcome, wrong) for outcome in outcomes)
            looks[place] = Look(candidate, asked, 0.5 + 0.5 * task.confidence)
            found[place] = np.array([one.probability for one in asked])
            predicted.clear()
        return ratio(place) <= _MEETS

    last = len(candidates) - 1
    if task.is_line:
        start = min(last, _first(len(candidates), last // 2, lambda place: ratio(place) <= _MEETS))
        result = min(last, _first(len(candidates), start, meets))
    else:
        result = _of_catalogue(last, ratio, meets)
    number = list(looks).index(result) + 1
    return Designed(task, tuple(looks.values()), number, "met" if meets(result) else "out of reach")


def candidates_of(task: DesignTask) -> list[dict[str, float]]:
    """Values of the free variables that could be the result, the cheapest first.

    Raises:
        InputError: if constraints allow none.
    """
    return task.candidates({}) if task.is_finite else _grid(task)


def _of_catalogue(last: int, ratio: Callable[[int], float], meets: Callable[[int], bool]) -> int:
    """The place of the cheapest design of a catalogue that meets the targets, or of the safest.

    Args:
        last: place of the dearest.
        ratio: the largest ratio of a probability to its target at a place, by the classifier until it is asked for.
        meets: asks for a place.
    """
    asked = set[int]()
    while True:
        # The classifier learns from each stripe. The first that promises to meet the targets is the least so far.
        ratios = [ratio(0)]
        while ratios[-1] > _MEETS and len(ratios) <= last:
            ratios.append(ratio(len(ratios)))
        place = int(np.argmin(ratios))
        if place in asked:
            return place
        meets(place)
        asked.add(place)


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
