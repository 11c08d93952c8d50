"""The chart of required values: the least value of a variable that meets a target, against two others."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.design.design_task import RISK_CATEGORIES, DesignTask
from activefail.estimates.integral import Standardised
from activefail.estimates.probability_estimator import Estimator
from activefail.plugins import brought
from activefail.space.space import Array
from activefail.text.progress import Stage, silent

_POINTS = 256
"""Least points of an integral of the chart: its lines are read off by eye."""

_ALONG, _ACROSS, _LINES = 11, 6, 3
"""Values of the required variable, of the axis and of the lines."""

_MIDDLE = (0.1, 0.9)
"""Shares of a range between which the values of the lines lie."""


@dataclass(frozen=True, eq=False)
class RequiredChart:
    """The smallest value of a variable that meets each target, without interval."""

    name: str  # the required variable
    across: str  # the variable of the axis
    lines: str  # the variable of the lines
    x: Array  # (n,) values on the axis
    values: Array  # (m,) values of the lines
    targets: Array  # (t,) probabilities
    outcome: str  # that has them
    required: Array  # (t, m, n) value of the required variable; NaN where none of its range meets the target

    @property
    def numbers(self) -> dict[str, Any]:
        """What `--json` shows of it."""
        return {
            "required": self.name,
            "across": {"name": self.across, "values": self.x},
            "lines": {"name": self.lines, "values": self.values},
            "targets": self.targets,
            "outcome": self.outcome,
            "values": self.required,
            "interval": None,
            "reason": "the classifier's values, without simulation",
        }


def chart_of(
    estimator: Estimator, task: DesignTask, held: Mapping[str, float], stage: Stage = silent
) -> RequiredChart | None:
    """The chart of the required first free variable against two others; None if there are no three with order.

    Args:
        estimator: has the classifier; nothing is simulated.
        task: what a design must meet.
        held: values of the other free variables.
        stage: called with each stage of the work.
    """
    space, fixed = estimator.campaign.space, {**task.question.fixed, **held}
    ordered = {one.name: one for one in space.parameters if not one.choices}
    certain = [name for name in ordered if name in fixed and name != task.free[0]]
    first = brought("free").get(task.free[0], ())
    names = sorted(certain, key=lambda name: (*(name != one for one in first), name not in task.free))
    if len(names) < 2 or task.free[0] not in ordered:
        return None
    across, lines = ordered[names[0]], ordered[names[1]]
    x = np.unique(across.rounded(np.linspace(across.low, across.high, _ACROSS)))
    low, high = (lines.low + share * (lines.high - lines.low) for share in _MIDDLE)
    values = np.unique(np.append(lines.rounded(np.linspace(low, high, _LINES)), fixed[lines.name]))
    one = task.requirements[0]
    of_categories = list(RISK_CATEGORIES.values()) if one.target in RISK_CATEGORIES.values() else []
    targets = np.array(sorted({one.target, *of_categories}, reverse=True))
    standardised = estimator.standardised(one.outcome)
    return required_chart(task, held, standardised, (across.name, x), (lines.name, values), targets, stage)


def required_chart(
    task: DesignTask,
    held: Mapping[str, float],
    standardised: Standardised,
    across: tuple[str, Array],
    lines: tuple[str, Array],
    targets: Array,
    stage: Stage = silent,
) -> RequiredChart:
    """The chart of a task's first requirement.

    Args:
        task: the task; its first free variable is the required one.
        held: values of its other free variables, unless the chart varies them.
        standardised: the boundary's latent.
        across: variable of the axis and its values.
        lines: variable of the lines and its values.
        targets: probabilities, (t,).
        stage: called with each stage of the work.
    """
    name = task.free[0]
    grid = np.linspace(task.low[name], task.high[name], _ALONG)
    points = max(_POINTS, task.points // 4)
    required = np.full((len(targets), len(lines[1]), len(across[1])), np.nan)
    for m, value in enumerate(lines[1].tolist()):
        stage(f"drawing the chart: {lines[0]} = {value:.3g}")
        for n, x in enumerate(across[1].tolist()):
            shown = {**held, across[0]: x, lines[0]: value}
            questions = (task.question.at({**shown, name: value}) for value in grid.tolist())
            P = np.array([classifier_probability(standardised, question, points) for question in questions])
            towards_safety = slice(None) if P[-1] <= P[0] else slice(None, None, -1)
            ordered = grid[towards_safety], P[towards_safety]
            required[:, m, n] = [least_value(*ordered, target) for target in targets.tolist()]
    return RequiredChart(
        name, across[0], lines[0], across[1], lines[1], targets, task.requirements[0].outcome, required
    )


def least_value(grid: Array, P: Array, target: float) -> float:
    """The first value beyond which a probability never exceeds its target; NaN if there is none.

    The probability is interpolated by its logarithm.

    Args:
        grid: (n,) values towards the safe side.
        P: (n,) probabilities.
        target: the probability.
    """
    above = np.flatnonzero(target < P)
    if not len(above):
        return float(grid[0])
    last = int(above[-1])
    if last == len(grid) - 1:
        return float("nan")
    logs = np.log(np.maximum(P[last : last + 2], 1e-12))
    share = (logs[0] - np.log(target)) / (logs[0] - logs[1])
    return float(grid[last] + share * (grid[last + 1] - grid[last]))
