"""What the classifier says of a failure that may be rare: its probability against simulations, and its most probable
design."""

from dataclasses import dataclass

import numpy as np

from activefail.analyses.findings.estimates import ProbabilityFindings, bound_without_model
from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.estimates.design_point import DesignPoint, design_point
from activefail.estimates.estimate import ProbabilityEstimate
from activefail.estimates.integral import BoundariesOf, boundary_of, integrate
from activefail.estimates.model_probability import model_probability
from activefail.estimates.probability_estimator import Estimator
from activefail.estimates.scores import learning_curve
from activefail.learning.criteria.by_margin import SIZE
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.system import ByMargins
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.initial import initial_size
from activefail.loop.learning import Learned, learn_from
from activefail.record.store import Store
from activefail.session.session import Session
from activefail.space.shares import lognormal_interval
from activefail.space.space import REACH, Array
from activefail.text.progress import Stage, silent

RARE = 0.05
"""Probability below which accuracy says little: a classifier without any failure would be right in 95 %."""

_POINTS = 12
"""Most points of a curve of the probability."""


@dataclass(frozen=True)
class FailureFindings:
    """The failure probability of a campaign and how it came to be known.

    Attributes:
        simulations: (k,) numbers of simulations that were learned from.
        probability: (k,) the classifier's probability of the target boundary's outcome or a more severe one.
        low, high: (k,) 95 % interval under the classifier; NaN where the boundary was learned from outcomes.
        seen: (k,) simulations beyond the boundary.
        point: the point of the boundary nearest to the medians; None if all designs are on one side, or a
            variable has a step or the designs have constraints.
        estimate: from fresh simulations at the last iteration; None if there are none.
        asked: the same under the campaign's question; None if it asks none or there are none.
        bound: upper bound from the initial design alone, without a model, one-sided at 90 %.
        is_known: whether the campaign met its stop rule for a probability.
    """

    simulations: Array
    probability: Array
    low: Array
    high: Array
    seen: Array
    point: DesignPoint | None
    estimate: ProbabilityEstimate | None
    asked: ProbabilityFindings | None
    bound: float
    is_known: bool

    @property
    def best(self) -> float:
        """The best known value: from fresh simulations if there are any, else the classifier's."""
        return self.estimate.probability if self.estimate else float(self.probability[-1])

    @property
    def is_rare(self) -> bool:
        """Whether failure, or its absence, is so rare that accuracy says little."""
        return min(self.best, 1.0 - self.best) < RARE


def failure_findings(run: Session, stage: Stage = silent) -> FailureFindings | None:
    """The findings; None unless the campaign learned from a margin, seeks a probability, or estimated one.

    Args:
        run: the run folder.
        stage: called with each stage of the work.
    """
    learned = run.learn(stage)
    with one_thread():
        return _failure_findings(run.campaign, run.store, learned, stage)


def _failure_findings(campaign: Campaign, store: Store, learned: Learned, stage: Stage) -> FailureFindings | None:
    history, outcome = History.of(store.batches), campaign.settings.acquisition.main_boundary
    classifier, latent = learned.classifier, learned.classifier.latent(outcome)
    stage("reading the estimate of the probability")
    estimator = Estimator(campaign, store, None, classifier, history.last_iteration)
    estimate, asked = estimator.stored(outcome, Question.of_space(campaign.space), 0.9, checks=True), None
    answer = estimator.stored(outcome, campaign.question, 0.9, checks=True) if campaign.question.digest else None
    if answer is not None:
        asked = ProbabilityFindings.of(campaign, history, classifier, outcome, answer, campaign.question)
    is_sought = campaign.settings.probability_rule is not None or isinstance(latent, ByMargins)
    if estimate is None and asked is None and not is_sought:
        return None
    rows, fitted = list[tuple[float, ...]](), None
    rule = campaign.settings.probability_rule
    points = learning_curve(store) if rule is not None and rule.probability == outcome else []
    kept = {point.simulations: point.probability for point in points if point.probability}
    for n in _sizes(campaign, history):
        if n in kept:
            rows.append((n, *kept[n], _seen(campaign, history[:n])))
            continue
        stage(f"learning from the first {n} simulations")
        fitted = classifier if n == len(history) else learn_from(campaign, history[:n], fitted)
        rows.append((n, *_probability(campaign, fitted, outcome), _seen(campaign, history[:n])))
    stage("searching for the most probable failure")
    point = None
    if not campaign.space.constraints and all(one.step is None for one in campaign.space.parameters):
        # The first-order method knows neither constraints nor steps.
        boundary = boundary_of(classifier, campaign.features, outcome)
        point = design_point(boundary, campaign.space, np.random.default_rng(0))
    simulations, probability, low, high, seen = np.array(rows, dtype=np.float64).T
    return FailureFindings(
        simulations=simulations,
        probability=probability,
        low=low,
        high=high,
        seen=seen,
        point=point,
        estimate=estimate,
        asked=asked,
        bound=bound_without_model(campaign, history, outcome).high,
        is_known=learned.looks.is_known,
    )


def _sizes(campaign: Campaign, history: History) -> list[int]:
    """Numbers of simulations at the ends of some batches, from the initial design on."""
    ends = 1 + np.flatnonzero(np.diff(history.iteration, append=history.last_iteration + 1))
    initial = initial_size(campaign, history)
    ends = ends[ends >= min(initial, len(history))]
    shown = np.unique(np.linspace(0, len(ends) - 1, min(_POINTS, len(ends))).round().astype(int))
    return [int(n) for n in ends[shown] if history[:n].answered.any()]


def _probability(campaign: Campaign, classifier: Classifier, outcome: str) -> tuple[float, float, float]:
    """The classifier's probability with its 95 % interval."""
    latent, rng = classifier.latent(outcome), np.random.default_rng(0)
    if isinstance(latent, ByMargins):
        known = model_probability(classifier, campaign.features, campaign.space, outcome, SIZE, rng)
        return known.mean, *lognormal_interval(known.mean, float(np.hypot(known.sd, known.error)), REACH)
    integral = integrate(BoundariesOf(classifier, campaign.features), campaign.space)
    return float(integral.probability[classifier.outcomes.index(outcome) - 1]), np.nan, np.nan


def _seen(campaign: Campaign, history: History) -> int:
    return int((history.training.outcome >= campaign.severity).sum())
