"""The cheapest design whose probabilities of outcomes meet their targets, verified by fresh simulations."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from activefail.campaign.question import Question
from activefail.reliability.estimate import (
    ProbabilityEstimate,
    Standardised,
    expected_half_width,
)
from activefail.risk.design.task import LOOKS, DesignTask
from activefail.risk.model import POINTS, classifier_probability
from activefail.space import Array
from activefail.verification.probability import Estimator, Sampled

_GRID = 13
"""Values of the first free variable at which a line is scanned."""

_COARSE_GRID, _COARSE_POINTS = 7, 256
"""The same, and points of an integral, while other free variables are searched."""

_SAMPLED, _REFINED = 16, 30
"""Lines that begin the search over each further free variable, and most lines of its refinement."""

_FINE = 2e-4
"""Accuracy of the first free variable, in units of its range."""

_CONFIDENCES = (0.5, 0.8, 0.9, 0.95, 0.99)
"""Confidences for which a result says what they would cost."""

_IMAGINED = len(LOOKS) + 1
"""Number of the sample of pulses that predicts the width of an interval and is not simulated."""

_LEAST = 1e-12
"""Least probability whose logarithm is taken."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A design that may meet the requirements.

    Attributes:
        values: of the free variables.
        model: (r,) the classifier's probabilities.
        is_feasible: whether these meet the aims; if not, no design does and this one comes nearest.
    """

    values: Mapping[str, float]
    model: Array
    is_feasible: bool


@dataclass(frozen=True, eq=False)
class Look:
    """Fresh simulations of a candidate.

    Attributes:
        candidate: the design.
        sampled: (r,) the simulations of each requirement.
        confidence: of the intervals.
    """

    candidate: Candidate
    sampled: tuple[Sampled, ...]
    confidence: float

    @cached_property
    def estimates(self) -> tuple[ProbabilityEstimate, ...]:
        """The probability of each requirement's outcome."""
        return tuple(sampled.estimate(self.confidence) for sampled in self.sampled)

    @property
    def simulations(self) -> int:
        """Fresh simulations of this look."""
        return sum(estimate.simulations for estimate in self.estimates)

    def meets(self, targets: Array) -> bool:
        """Whether all upper bounds meet the targets."""
        return all(estimate.high <= target for estimate, target in zip(self.estimates, targets, strict=True))


Status = Literal["verified", "not verified", "out of reach"]


@dataclass(frozen=True, eq=False)
class Designed:
    """The result of a search for a design.

    Attributes:
        task: what was asked.
        looks: at candidates; the last one is the result.
        status: "verified"; "not verified" if every look exceeded a target; "out of reach" if no design meets the
            targets under the classifier, and the result is the nearest.
        costs: confidence -> value of the first free variable that it would take, the others held; NaN if out of range.
    """

    task: DesignTask
    looks: tuple[Look, ...]
    status: Status
    costs: Mapping[float, float]

    @property
    def last(self) -> Look:
        """The look at the result."""
        return self.looks[-1]

    @property
    def values(self) -> Mapping[str, float]:
        """The values of the free variables."""
        return self.last.candidate.values

    @property
    def question(self) -> Question:
        """The distribution of the variables at the result."""
        return self.task.question.at(self.values)

    @property
    def simulations(self) -> int:
        """All fresh simulations."""
        return sum(look.simulations for look in self.looks)

    @property
    def at_limit(self) -> dict[str, str]:
        """Free variables whose value is a limit of their range, and which limit."""
        sides = {}
        for name, value in self.values.items():
            near = 2.0 * _FINE * (self.task.high[name] - self.task.low[name])
            if value <= self.task.low[name] + near:
                sides[name] = "lower"
            elif value >= self.task.high[name] - near:
                sides[name] = "upper"
        return sides


class _Model:
    """The classifier's probabilities of a task's outcomes at values of the free variables."""

    def __init__(self, task: DesignTask, standardised: tuple[Standardised, ...]) -> None:
        self._task, self._standardised = task, standardised
        self._known: dict[tuple[object, ...], Array] = {}

    def __call__(self, values: Mapping[str, float], points: int = POINTS) -> Array:
        """The probability of each requirement's outcome, (r,)."""
        key = (*values.items(), points)
        if key not in self._known:
            question = self._task.question.at(values)
            self._known[key] = np.array([classifier_probability(of, question, points) for of in self._standardised])
        return self._known[key]


def find_design(
    estimator: Estimator, task: DesignTask, stage: Callable[[str], None] = lambda _: None, with_costs: bool = True
) -> Designed:
    """Find the cheapest design that meets its targets, and verify it.

    The classifier proposes a design whose probabilities lie below the targets, by as much as the verification needs.
    Fresh simulations verify it. If an upper bound exceeds its target, the ratio of the estimate to the classifier's
    probability corrects the next proposal, which is looked at with fresh simulations of its own: those that chose a
    design never verify it. The looks share the probability of a false result.

    Args:
        estimator: simulates.
        task: what the design must meet.
        stage: called with each stage of the work.
        with_costs: whether to compute what other confidences would cost.
    """
    model = _Model(task, tuple(estimator.standardised(one.outcome) for one in task.requirements))

    def asked(candidate: Candidate, look: int) -> Question:
        return task.question.at(candidate.values).drawn(look)

    def half_widths(candidate: Candidate) -> Array:
        """Expected half widths of the intervals, (r,)."""
        question, simulations = asked(candidate, _IMAGINED), task.simulations_of(0)
        plans = [estimator.plan(one.outcome, simulations, question) for one in task.requirements]
        return np.array([expected_half_width(plan, task.of_interval(0), np.random.default_rng(0)) for plan in plans])

    stage("searching a design under the classifier")
    candidate = cheapest(task, model, task.targets)
    correction = np.ones(len(task.requirements))
    half = half_widths(candidate)
    looks: list[Look] = []
    for number, plan in enumerate(LOOKS):
        simulations, confidence = task.simulations_of(number), task.of_interval(number)
        aims = np.maximum(task.targets - plan.safety * half, 0.2 * task.targets) / correction
        stage(f"searching a design for look {number + 1}")
        candidate = cheapest(task, model, aims)
        stage(f"verifying with {simulations * len(task.requirements)} simulations")
        question = asked(candidate, number + 1)
        sampled = tuple(estimator.sample(one.outcome, simulations, question) for one in task.requirements)
        look = Look(candidate, sampled, confidence)
        looks.append(look)
        estimates = np.array([estimate.probability for estimate in look.estimates])
        if number + 1 < len(LOOKS):
            half = _half_widths_of_next(task, look, number)
        correction = np.clip(estimates / np.maximum(candidate.model, _LEAST), 0.25, 4.0)
        if look.meets(task.targets):
            break
        if not candidate.is_feasible and np.any(estimates > task.targets):
            return Designed(task, tuple(looks), "out of reach", {})
    status: Status = "verified" if looks[-1].meets(task.targets) else "not verified"
    if not with_costs:
        return Designed(task, tuple(looks), status, {})
    stage("computing what other confidences would cost")
    return Designed(task, tuple(looks), status, _costs(task, model, looks[-1]))


def _half_widths_of_next(task: DesignTask, look: Look, number: int) -> Array:
    """Expected half widths of the intervals of the look after `number`, (r,)."""
    next_confidence = task.of_interval(number + 1)
    ratio = math.sqrt(task.simulations_of(number) / task.simulations_of(number + 1))
    estimates = [sampled.estimate(next_confidence) for sampled in look.sampled]
    return np.array([ratio * (estimate.high - estimate.probability) for estimate in estimates])


def _costs(task: DesignTask, model: _Model, look: Look) -> dict[float, float]:
    """The value of the first free variable that each confidence would take, the others held."""
    costs = {}
    for confidence in _CONFIDENCES:
        highs = np.array([sampled.estimate(2.0 * confidence - 1.0).high for sampled in look.sampled])
        aims = task.targets * look.candidate.model / np.maximum(highs, _LEAST)
        found = _on_line(task, model, {name: look.candidate.values[name] for name in task.free[1:]}, aims)
        costs[confidence] = found.values[task.free[0]] if found.is_feasible else math.nan
    return costs


def cheapest(task: DesignTask, model: Callable[..., Array], aims: Array) -> Candidate:
    """The cheapest design whose probabilities under the classifier meet the aims, (r,).

    On each line along the first free variable, the design is the cheapest of the interval around the safest point in
    which the probabilities stay below the aims: a failure probability need not fall with every increase of a variable.
    Further free variables are searched by a Sobol' sample of lines and the simplex method [NelderMead1965].
    """
    if len(task.free) == 1:
        return _on_line(task, model, {}, aims)
    from scipy.optimize import minimize
    from scipy.stats import qmc

    others = task.free[1:]
    low, high = (np.array([side[name] for name in others]) for side in (task.low, task.high))
    seen: list[tuple[float, Candidate, Array]] = []

    def price(u: Array) -> float:
        values = low + np.clip(u, 0.0, 1.0) * (high - low)
        found = _on_line(task, model, dict(zip(others, values.tolist(), strict=True)), aims, coarse=True)
        excess = float(np.max(np.log(np.maximum(found.model, _LEAST) / aims)))
        # Any feasible design is better than all others; these are ordered by how far off they are.
        result = math.atan(task.cost(found.values)) if found.is_feasible else 10.0 + excess
        seen.append((result, found, np.clip(u, 0.0, 1.0)))
        return result

    count = 2 ** math.ceil(math.log2(_SAMPLED * len(others)))
    for u in qmc.Sobol(len(others), rng=np.random.default_rng(0)).random(count):
        price(u)
    start = min(seen, key=lambda one: one[0])[2]
    step = np.where(start > 0.5, -0.15, 0.15)
    simplex = np.vstack([start, start + np.diag(step)])
    minimize(
        price,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": _REFINED * len(others), "xatol": 0.005, "fatol": 1e-6},
    )
    best = min(seen, key=lambda one: one[0])[1]
    return _on_line(task, model, {name: best.values[name] for name in others}, aims)


def _on_line(
    task: DesignTask, model: Callable[..., Array], held: Mapping[str, float], aims: Array, coarse: bool = False
) -> Candidate:
    """The cheapest design along the first free variable, the others held; the safest one if none meets the aims."""
    from scipy.optimize import brentq

    name = task.free[0]
    low, high = task.low[name], task.high[name]
    points, size = (_COARSE_POINTS, _COARSE_GRID) if coarse else (POINTS, _GRID)

    def candidate(x: float, is_feasible: bool = True) -> Candidate:
        values = {name: x, **held}
        return Candidate(values, model(values, points), is_feasible)

    def excess(x: float) -> float:
        """Largest logarithm of a probability over its aim."""
        return float(np.max(np.log(np.maximum(candidate(x).model, _LEAST) / aims)))

    grid = np.linspace(low, high, size)
    excesses = np.array([excess(float(x)) for x in grid])
    safest = int(np.argmin(excesses))
    if excesses[safest] > 0.0:
        return candidate(float(grid[safest]), is_feasible=False)
    first = last = safest
    while first > 0 and excesses[first - 1] <= 0.0:
        first -= 1
    while last < size - 1 and excesses[last + 1] <= 0.0:
        last += 1
    ends = [float(x) for x in grid[first : last + 1]]
    for inside, outside in ((first, first - 1), (last, last + 1)):
        if 0 <= outside < size:
            root = float(brentq(excess, grid[inside], grid[outside], xtol=_FINE * (high - low)))
            # On the safe side of the root's tolerance.
            root += math.copysign(_FINE * (high - low), grid[inside] - grid[outside])
            ends.append(min(max(root, low), high))
    return min((candidate(x) for x in ends), key=lambda one: task.cost(one.values))
