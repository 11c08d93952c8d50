"""What `Run.design` does: a search and its verification, with the chart of required values."""

from collections.abc import Callable, Mapping

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import FRICTION, Hazard, hazard_question
from activefail.risk.design.design_task import RISK_CATEGORIES, DesignTask
from activefail.risk.design.findings import BEARING_PERIOD, DesignFindings
from activefail.risk.design.required_chart import RequiredChart, required_chart
from activefail.risk.design.search import Designed, find_design
from activefail.verification.probability_estimator import Estimator

_ACROSS, _LINES = 6, 3
"""Values of the two variables of a chart."""

_MIDDLE = (0.1, 0.9)
"""Shares of a range between which a chart's values lie."""


def search_design(
    estimator: Estimator,
    task: DesignTask,
    hazard: Hazard | None = None,
    with_chart: bool = False,
    stage: Callable[[str], None] = lambda _: None,
) -> DesignFindings:
    """Find a design and verify it, with the chart of required values if it is wanted (see `Run.design`).

    Args:
        estimator: simulates.
        task: what the design must meet.
        hazard: of the task's question; None for another question.
        with_chart: whether to compute the chart.
        stage: called with each stage of the work.
    """
    campaign = estimator.campaign
    designed = find_design(estimator, task, stage)
    chart = chart_of(estimator, task, designed.values, stage) if with_chart else None
    return DesignFindings(
        campaign,
        designed,
        hazard,
        designed.question.outside(campaign.space),
        _at_upper_bounds(estimator, designed, hazard),
        _at_least_velocity(estimator, designed, hazard),
        chart,
    )


def _at_upper_bounds(estimator: Estimator, designed: Designed, hazard: Hazard | None) -> tuple[float, ...]:
    """The classifier's probabilities at the upper property bounds; nothing without such bounds."""
    if hazard is None or not hazard.at_bound("upper").factors:
        return ()
    return _probabilities(estimator, designed, hazard.at_bound("upper"))


def _at_least_velocity(estimator: Estimator, designed: Designed, hazard: Hazard | None) -> tuple[float, ...]:
    """The classifier's probabilities at the least velocity of a hazard's curve; nothing unless targets are risks."""
    if hazard is None or designed.task.rate is None:
        return ()
    return _probabilities(estimator, designed, hazard, designed.task.rate.velocity)


def _probabilities(
    estimator: Estimator, designed: Designed, hazard: Hazard, pgv: float | None = None
) -> tuple[float, ...]:
    campaign = estimator.campaign
    values = {name: value for name, value in designed.question.fixed.items() if name in campaign.space.names}
    question = hazard_question(hazard, campaign.settings, campaign.space, values, pgv)
    return tuple(estimator.probability(one.outcome, question) for one in designed.task.requirements)


def chart_of(
    estimator: Estimator,
    task: DesignTask,
    held: Mapping[str, float],
    stage: Callable[[str], None] = lambda _: None,
) -> RequiredChart | None:
    """The chart of the required first free variable against two others; None if there are no two others.

    Args:
        estimator: has the classifier; nothing is simulated.
        task: what a design must meet.
        held: values of the other free variables.
        stage: called with each stage of the work.
    """
    campaign, fixed = estimator.campaign, {**task.question.fixed, **held}
    names = _axes_of_chart(campaign, task, fixed)
    if len(names) < 2:
        return None
    ranges = {p.name: (p.low, p.high) for p in campaign.space.parameters}
    at = {name: low + np.array(_MIDDLE) * (high - low) for name, (low, high) in ranges.items()}
    across, lines = names[:2]
    x = np.linspace(ranges[across][0], ranges[across][1], _ACROSS)
    values = np.unique(np.append(np.linspace(at[lines][0], at[lines][1], _LINES), fixed[lines]))
    one = task.requirements[0]
    of_categories = list(RISK_CATEGORIES.values()) if any(one.target == p for p in RISK_CATEGORIES.values()) else []
    targets = np.array(sorted({one.target, *of_categories}, reverse=True))
    standardised = estimator.standardised(one.outcome)
    return required_chart(task, held, standardised, (across, x), (lines, values), targets, stage)


def _axes_of_chart(campaign: Campaign, task: DesignTask, fixed: Mapping[str, float]) -> list[str]:
    """Variables that have a value, the most informative ones of a bearing first."""
    certain = [name for name in campaign.space.names if name in fixed and name != task.free[0]]
    return sorted(certain, key=lambda name: (name != BEARING_PERIOD, name != FRICTION, name not in task.free))
