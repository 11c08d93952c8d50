"""Search a design from what a user states: targets, a hazard or a question, and which variables may change."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from activefail.campaign.asked import check_designs_of
from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import FRICTION, Hazard, hazard_question, is_hazard, read_hazard
from activefail.campaign.question import Question, question_of, read_question
from activefail.execution.executor import Executor
from activefail.record.store import Store
from activefail.reliability.estimate import standardised_latent
from activefail.risk.design import Designed, find_design
from activefail.risk.findings import BEARING_PERIOD, DesignFindings
from activefail.risk.model import classifier_probability
from activefail.risk.required import RequiredChart, required_chart
from activefail.risk.task import RISK_CATEGORIES, DesignTask, design_task, read_targets
from activefail.surrogate.classifier import Classifier

_ACROSS, _LINES = 6, 3
"""Values of the two variables of a chart."""

_MIDDLE = (0.1, 0.9)
"""Shares of a range between which a chart's values lie."""


def search_design(
    campaign: Campaign,
    store: Store,
    executor: Executor,
    classifier: Classifier,
    iteration: int,
    target: str,
    source: Question | Path | str | None,
    fixed: Mapping[str, float],
    free: Sequence[str] = (),
    cost: str = "",
    confidence: float = 0.95,
    simulations: int = 500,
    with_chart: bool = False,
    stage: Callable[[str], None] = lambda _: None,
) -> DesignFindings:
    """Find a design and verify it (see `Run.design`).

    Raises:
        InputError: naming the argument or the file, the rule and the value.
    """
    requirements = read_targets(target, campaign.simulator.outcomes, campaign.settings.acquisition.main_boundary)
    hazard, question = _asked(campaign, source, fixed)
    check_designs_of(question, campaign.simulator, "fixed")
    task = design_task(campaign, question, requirements, free, cost, confidence, simulations)
    found = find_design(campaign, store, executor, classifier, iteration, task, stage)
    chart = _chart(campaign, classifier, found, stage) if with_chart else None
    return DesignFindings(
        campaign,
        found,
        hazard,
        found.question.share_outside(campaign.space),
        _at_upper_bounds(campaign, classifier, found, hazard),
        chart,
    )


def _asked(
    campaign: Campaign, source: Question | Path | str | None, fixed: Mapping[str, float]
) -> tuple[Hazard | None, Question]:
    if isinstance(source, Question):
        return None, source.at(fixed)
    if source is None:
        return None, question_of(campaign.settings, campaign.space, fixed)
    path = Path(source)
    if is_hazard(path):
        hazard = read_hazard(path)
        return hazard, hazard_question(hazard, campaign.settings, campaign.space, fixed)
    return None, read_question(path, campaign.settings, campaign.space, fixed)


def _at_upper_bounds(
    campaign: Campaign, classifier: Classifier, found: Designed, hazard: Hazard | None
) -> tuple[float, ...]:
    """The classifier's probabilities at the upper property bounds; nothing without such bounds."""
    if hazard is None or not hazard.at_bound("upper").factors:
        return ()
    values = {name: value for name, value in found.question.fixed.items() if name in campaign.space.names}
    question = hazard_question(hazard.at_bound("upper"), campaign.settings, campaign.space, values)
    return tuple(
        classifier_probability(standardised_latent(classifier.latent(one.outcome), campaign.features), question)
        for one in found.task.requirements
    )


def _chart(
    campaign: Campaign, classifier: Classifier, found: Designed, stage: Callable[[str], None]
) -> RequiredChart | None:
    """The chart of the required first free variable against two others; None if there are no two others."""
    task = found.task
    names = _axes_of_chart(campaign, task, found.question)
    if len(names) < 2:
        return None
    ranges = {p.name: (p.low, p.high) for p in campaign.space.parameters}
    at = {name: low + np.array(_MIDDLE) * (high - low) for name, (low, high) in ranges.items()}
    across, lines = names[:2]
    x = np.linspace(ranges[across][0], ranges[across][1], _ACROSS)
    values = np.unique(np.append(np.linspace(at[lines][0], at[lines][1], _LINES), found.question.fixed[lines]))
    one = task.requirements[0]
    of_categories = list(RISK_CATEGORIES.values()) if any(one.target == p for p in RISK_CATEGORIES.values()) else []
    targets = np.array(sorted({one.target, *of_categories}, reverse=True))
    standardised = standardised_latent(classifier.latent(one.outcome), campaign.features)
    return required_chart(task, found.values, standardised, (across, x), (lines, values), targets, stage)


def _axes_of_chart(campaign: Campaign, task: DesignTask, question: Question) -> list[str]:
    """Variables that have a value, the most telling ones of a bearing first."""
    certain = [name for name in campaign.space.names if name in question.fixed and name != task.free[0]]
    return sorted(certain, key=lambda name: (name != BEARING_PERIOD, name != FRICTION, name not in task.free))
