"""A design: its search and verification, and what stands beside it: other bounds, and the chart of required values."""

from collections.abc import Mapping

import numpy as np

from activefail.campaign.hazard import FRICTION
from activefail.campaign.question import Question
from activefail.progress import Stage, silent
from activefail.risk.design.design_task import RISK_CATEGORIES, DesignTask
from activefail.risk.design.findings import BEARING_PERIOD, DesignFindings
from activefail.risk.design.required_chart import RequiredChart, required_chart
from activefail.risk.design.search import find_design
from activefail.verification.probability_estimator import Estimator

_ACROSS, _LINES = 6, 3
"""Values of the two variables of a chart."""

_MIDDLE = (0.1, 0.9)
"""Shares of a range between which a chart's values lie."""


def search_design(
    estimator: Estimator, task: DesignTask, with_chart: bool = False, stage: Stage = silent
) -> DesignFindings:
    """Find a design and verify it, with the chart of required values if it is wanted (see `Run.design`)."""
    designed = find_design(estimator, task, stage)
    chart = chart_of(estimator, task, designed.values, stage) if with_chart else None
    hazard, at_design = task.asked.hazard, task.asked.at(designed.values)

    def probabilities(question: Question) -> tuple[float, ...]:
        return tuple(estimator.probability(one.outcome, question) for one in task.requirements)

    at_upper: tuple[float, ...] = ()
    at_least: tuple[float, ...] = ()
    if hazard is not None and (upper := hazard.at_bound("upper")).factors:
        at_upper = probabilities(at_design.under(upper))
    if hazard is not None and task.rate is not None:
        at_least = probabilities(at_design.under(hazard, task.rate.velocity))
    outside = designed.question.outside(estimator.campaign.space)
    return DesignFindings(designed, outside, at_upper, at_least, chart)


def chart_of(
    estimator: Estimator, task: DesignTask, held: Mapping[str, float], stage: Stage = silent
) -> RequiredChart | None:
    """The chart of the required first free variable against two others; None if there are no two others.

    Args:
        estimator: has the classifier; nothing is simulated.
        task: what a design must meet.
        held: values of the other free variables.
        stage: called with each stage of the work.
    """
    space, fixed = estimator.campaign.space, {**task.question.fixed, **held}
    certain = [name for name in space.names if name in fixed and name != task.free[0]]
    # The most informative ones of a bearing first.
    names = sorted(certain, key=lambda name: (name != BEARING_PERIOD, name != FRICTION, name not in task.free))
    if len(names) < 2:
        return None
    across, lines = (next(one for one in space.parameters if one.name == name) for name in names[:2])
    x = np.linspace(across.low, across.high, _ACROSS)
    low, high = (lines.low + share * (lines.high - lines.low) for share in _MIDDLE)
    values = np.unique(np.append(np.linspace(low, high, _LINES), fixed[lines.name]))
    one = task.requirements[0]
    of_categories = list(RISK_CATEGORIES.values()) if one.target in RISK_CATEGORIES.values() else []
    targets = np.array(sorted({one.target, *of_categories}, reverse=True))
    standardised = estimator.standardised(one.outcome)
    return required_chart(task, held, standardised, (across.name, x), (lines.name, values), targets, stage)
