"""Estimates the probability beyond a boundary from fresh simulations, and keeps them; thins large tables of pulses.

`reliability.estimate` and `reliability.strata` compute the intervals.
"""

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.campaign.random_streams import stream
from activefail.errors import SimulationError
from activefail.execution.executor import Executor
from activefail.record.store import Store
from activefail.reliability.estimate import (
    SURE,
    Doubt,
    Plan,
    ProbabilityEstimate,
    baseline,
    deviation_of_margins,
    plan_estimate,
    plan_estimates,
)
from activefail.reliability.hidden import ModeCheck
from activefail.reliability.integral import (
    Boundaries,
    BoundariesOf,
    Lost,
    OfBoundary,
    Standardised,
    boundary_of,
    integrate,
)
from activefail.reliability.strata import StratifiedPlan, plan_strata, plan_wide_strata
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, is_impossible
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.margin import MarginLatent
from activefail.verification.mode_check import check_of, is_checked, margin_of, places_of_check
from activefail.verification.stored_sets import (
    estimate_sizes,
    name_of_check,
    name_of_estimate,
    simulated_results,
    stored_results,
)
from activefail.weighted import BLOCKS, WeightedRows

_DRAWS = 10_000
"""More than the number of independent samples that anything draws at one iteration."""

_MOST_ROWS = 8192
"""Most weighted rows that a plan predicts; a systematic sample stands for more of them."""


@dataclass(frozen=True)
class EstimateOfRows(ProbabilityEstimate):
    """A probability under weighted rows, each of which is simulated at most once.

    Its numbers of simulations are those of different rows.

    Attributes:
        draws: of rows; 0 if all rows were simulated, so that the interval is that of the numerical failures alone.
        hits: draws that ended beyond the boundary, or may have.
    """

    draws: int = 0
    hits: int = 0


@dataclass(frozen=True, eq=False)
class Existing:
    """What the classifier and m fresh simulations say of which designs exist.

    Attributes:
        classifier: share of the distribution that exists by the classifier, with its standard error.
        probability: (m,) that each design exists, by the classifier.
        exists: (m,) whether it does.
        ratio: (m,) density of the distribution over that of the draws.
    """

    classifier: OfBoundary
    probability: Array
    exists: NDArray[np.bool_]
    ratio: Array

    def share(self, confidence: float, is_complete: bool) -> tuple[float, float, float]:
        """The share that exists and its interval, which is exact if the draws are all rows of the distribution."""
        from scipy.stats import t

        if is_complete:
            exact = float(self.ratio @ self.exists / self.ratio.sum())
            return exact, exact, exact
        corrections, m = (self.exists - self.probability) * self.ratio, len(self.exists)
        doubt = float((self.ratio**2 * self.probability * (1.0 - self.probability)).mean())
        error = math.sqrt(max(float(corrections.var(ddof=1)), doubt) / m + self.classifier.error**2)
        half = float(t.ppf(0.5 + 0.5 * confidence, m - 1)) * error
        middle = min(1.0, max(1.0 / m, self.classifier.probability + float(corrections.mean())))
        return middle, max(0.5 / m, middle - half), min(1.0, middle + half)


@dataclass(frozen=True, eq=False)
class Sampled:
    """Fresh simulations that estimate a probability.

    Attributes:
        plan: of the draws.
        beyond: (m,) whether each ended beyond the boundary.
        answered: (m,) whether each gave an outcome.
        first: (s,) one draw of each simulation, if rows are drawn; None if every draw is simulated.
        is_complete: whether the draws are all rows of the distribution.
        error: standard error of the classifier's probability, from blocks of rows that stand for a distribution.
        check: of a question; None if none was made.
        exists: which designs exist; None if all do.
        severer: the same simulations for the more severe outcomes; empty if others answer for these.
    """

    plan: Plan | StratifiedPlan
    beyond: NDArray[np.bool_]
    answered: NDArray[np.bool_]
    first: NDArray[np.int_] | None = None
    is_complete: bool = False
    error: float = 0.0
    check: ModeCheck | None = None
    exists: "Existing | None" = None
    severer: "tuple[Sampled, ...]" = ()

    def estimate(self, confidence: float) -> ProbabilityEstimate:
        """The probability with an interval of this confidence, at least those of the more severe outcomes."""
        estimates = [one._of_outcome(confidence) for one in (self, *self.severer)]
        largest = {name: max(getattr(one, name) for one in estimates) for name in ("probability", "low", "high")}
        return replace(estimates[0], **largest)

    def _of_outcome(self, confidence: float) -> ProbabilityEstimate:
        """The probability among the designs that exist, with an interval of this confidence (see `_among_all`)."""
        estimate = self._among_all(confidence)
        if self.exists is None:
            return estimate
        middle, low, high = self.exists.share(confidence, self.is_complete)
        return replace(
            estimate,
            probability=min(1.0, estimate.probability / middle),
            low=min(1.0, estimate.low / high),
            high=min(1.0, estimate.high / low),
        )

    def _among_all(self, confidence: float) -> ProbabilityEstimate:
        """The probability with an interval of this confidence, which includes the error of the blocks.

        If the margins of the check lie farther from the classifier's than those of the fresh simulations, they decide
        how wide the interval is. They do not change the estimate.
        """
        from scipy.stats import t

        if self.is_complete:
            return self._counted(self._known(confidence))
        plan, check = self.plan, self.check
        if check is not None and isinstance(plan, Plan):
            plan = plan.deviating(max(plan.deviation, check.deviation))
        estimate = plan.estimate(self.beyond, self.answered, confidence)
        if check is not None:
            estimate = replace(estimate, deviation=self.deviation, check=check)
        if self.first is not None:
            estimate = self._counted(estimate)
        if not self.error:
            return estimate
        half = float(t.ppf(0.5 + 0.5 * confidence, BLOCKS - 1)) * self.error
        middle = estimate.probability
        return replace(
            estimate,
            low=max(0.0, middle - math.hypot(middle - estimate.low, half)),
            high=min(1.0, middle + math.hypot(estimate.high - middle, half)),
        )

    @property
    def deviation(self) -> float:
        """Of the margins of the fresh simulations; 1 without margins."""
        return self.plan.deviation if isinstance(self.plan, Plan) else 1.0

    def _known(self, confidence: float) -> ProbabilityEstimate:
        """The share of all rows, of which only the numerical failures are unknown."""
        assert isinstance(self.plan, Plan)
        share, predicted = self.plan.ratio / self.plan.ratio.sum(), self.plan.predicted
        beyond = self.beyond & self.answered
        low, high = float(share @ beyond), float(share @ (beyond | ~self.answered))
        hit, missed = float(share @ (beyond & predicted)), float(share @ (~predicted & (beyond | ~self.answered)))
        return ProbabilityEstimate(
            probability=float(share @ np.where(self.answered, self.beyond, predicted)),
            low=low,
            high=high,
            confidence=confidence,
            simulations=0,
            unanswered=0,
            beyond=0,
            wrong=0,
            surprising=0,
            recall=hit / low if low else float("nan"),
            recall_low=hit / (hit + missed) if hit else 0.0,
            method="all rows of the distribution",
        )

    def _counted(self, estimate: ProbabilityEstimate) -> EstimateOfRows:
        """The estimate with the numbers of simulations in place of those of draws."""
        plan, first = self.plan, self.first
        beyond, answered = self.beyond[first], self.answered[first]
        wrong = answered & (beyond != plan.predicted[first])
        numbers = asdict(estimate) | {
            "simulations": len(beyond),
            "unanswered": int((~answered).sum()),
            "beyond": int((beyond & answered).sum()),
            "wrong": int(wrong.sum()),
            "surprising": int((wrong & (np.abs(plan.standardised[first]) > SURE)).sum()),
        }
        hits = int((self.beyond | ~self.answered).sum())
        return EstimateOfRows(**numbers, draws=0 if self.is_complete else len(self.beyond), hits=hits)


@dataclass(frozen=True, eq=False)
class _Fresh:
    """The designs of a sample, and how they are kept.

    Attributes:
        plan: of the draws.
        severer: of the same draws for the more severe outcomes; empty if other draws answer for these.
        name, name_of_check: of the stored set, and of that of the mode check.
        designs: (s, d) to simulate.
        first: as `Sampled.first`.
        place: (m,) the simulation of each draw; None if every draw is simulated.
        is_complete, error: as in `Sampled`.
        existing: share of the distribution that exists by the classifier; None if all does.
    """

    plan: Plan | StratifiedPlan
    severer: tuple[Plan, ...]
    name: str
    name_of_check: str
    designs: Array
    first: NDArray[np.int_] | None
    place: NDArray[np.int_] | None
    is_complete: bool
    error: float
    existing: OfBoundary | None

    def sampled(self, campaign: Campaign, classifier: Classifier, results: Results, severity: int) -> Sampled:
        """The sample with the results of the s simulations."""
        plan, latent = self.plan, classifier.latents[severity - 1]
        if isinstance(plan, Plan) and isinstance(latent, MarginLatent):
            margin = margin_of(campaign, classifier, severity, results.outcome, results.margins)
            plan = plan.deviating(deviation_of_margins(latent, campaign.features, self.designs, margin))
        impossible = is_impossible(campaign.simulator, results.outcome, results.cause)
        # A design that does not exist is beyond no boundary.
        answered = (results.outcome != NUMERICAL_FAILURE) | impossible
        beyond, designs, place = results.outcome >= severity, self.designs, self.place
        if place is not None:
            beyond, answered, impossible, designs = beyond[place], answered[place], impossible[place], designs[place]
        exists, boundary = None, BoundariesOf(classifier, campaign.features).exists
        if self.existing is not None and boundary is not None:
            exists = Existing(self.existing, ndtr(boundary(designs))[:, 0], ~impossible, plan.ratio)
        severer = tuple(
            replace(self, plan=one, severer=()).sampled(campaign, classifier, results, number)
            for number, one in enumerate(self.severer, start=severity + 1)
        )
        return Sampled(plan, beyond, answered, self.first, self.is_complete, self.error, exists=exists, severer=severer)


@dataclass(frozen=True, eq=False)
class Estimator:
    """Estimates probabilities with a frozen classifier and fresh simulations, which are kept in the run folder.

    Attributes:
        campaign: the campaign.
        store: holds the fresh simulations.
        executor: runs those that are not stored yet; None where nothing is simulated.
        classifier: of the iteration.
        iteration: the last one of the record.
    """

    campaign: Campaign
    store: Store
    executor: Executor | None
    classifier: Classifier
    iteration: int

    @property
    def boundaries(self) -> Boundaries:
        """All boundaries as a function of designs."""
        return BoundariesOf(self.classifier, self.campaign.features)

    def standardised(self, outcome: str) -> Standardised:
        """An outcome's boundary as a function of designs."""
        return boundary_of(self.classifier, self.campaign.features, outcome)

    def probability(self, outcome: str, question: Question) -> float:
        """The probability of an outcome or a more severe one by the classifier alone, as every place shows it."""
        integral = question.integral(self.boundaries, self.campaign.space)
        return integral.of(self.classifier.outcomes.index(outcome) - 1).probability

    def plan(self, outcome: str, simulations: int, question: Question) -> Plan | StratifiedPlan:
        """The fresh simulations that `sample` makes, unless it simulates all rows of a distribution."""
        common = (self.campaign, self.classifier, outcome, self.iteration, simulations)
        return _planned(*common, _thinned(question, simulations))[0]

    def sample(self, outcome: str, simulations: int, question: Question, checks: bool = False) -> Sampled:
        """Simulate fresh designs for the probability of an outcome or a more severe one.

        Args:
            outcome: its name.
            simulations: number of fresh simulations; at least 2. Of weighted rows, no row is simulated twice, and if
                there are no more rows than that, all of them are.
            question: the distribution of the variables.
            checks: whether to simulate the mode check too, if there is one.

        Raises:
            SimulationError: if none of the simulations gives an outcome.
        """
        assert self.executor is not None
        severity = self.campaign.simulator.outcomes.index(outcome)
        latent, question = self.classifier.latent(outcome), _thinned(question, simulations)
        fresh = _fresh(self.campaign, self.classifier, outcome, self.iteration, simulations, question)
        results = simulated_results(self.campaign, self.store, self.executor, fresh.name, fresh.designs)
        assert results is not None  # no stop was requested
        sampled = fresh.sampled(self.campaign, self.classifier, results, severity)
        if not (checks and is_checked(question, latent)):
            return sampled
        designs = _places(self.campaign, self.store, self.iteration, fresh, sampled, question)
        try:
            of_check = simulated_results(self.campaign, self.store, self.executor, fresh.name_of_check, designs)
        except SimulationError:
            # Far out, a simulator may fail everywhere. The fresh simulations stand.
            return replace(sampled, check=ModeCheck(len(designs), len(designs), 0))
        assert of_check is not None
        return replace(sampled, check=check_of(self.campaign, self.classifier, outcome, designs, of_check))

    def stored(self, outcome: str, question: Question, confidence: float) -> ProbabilityEstimate | None:
        """The estimate from stored simulations (see `stored_estimate`)."""
        common = (self.campaign, self.store, self.classifier, self.iteration)
        return stored_estimate(*common, outcome, confidence, question)


def _places(
    campaign: Campaign, store: Store, iteration: int, fresh: _Fresh, sampled: Sampled, question: Question
) -> Array:
    """The designs of the mode check beside fresh simulations, far from these and from all of the campaign's."""
    learned = [batch.designs for batch in store.batches if batch.iteration <= iteration]
    # The estimate, unlike its interval, is the same for every confidence.
    probability = sampled.estimate(0.9).probability
    rng = stream(campaign.settings.seed, "hidden", _DRAWS * iteration + question.draw)
    return places_of_check(campaign, question, np.concatenate([*learned, fresh.designs]), probability, rng)


def stored_estimate(
    campaign: Campaign,
    store: Store,
    classifier: Classifier,
    iteration: int,
    outcome: str,
    confidence: float,
    question: Question,
    checks: bool = False,
) -> ProbabilityEstimate | None:
    """The estimate from the largest stored set of fresh simulations of a question, or None.

    It simulates nothing.

    Args:
        campaign, store, classifier, iteration: as for `Estimator`.
        outcome: its name.
        confidence: of the interval.
        question: the distribution of the variables.
        checks: whether to read the mode check too, if it is stored.
    """
    severity = campaign.simulator.outcomes.index(outcome)
    latent, number = classifier.latent(outcome), _number(classifier, outcome, question)
    sizes = estimate_sizes(store, number, iteration, question.digest)
    if (thinned := _thinned(question, 0)) is not question:
        sizes += estimate_sizes(store, number, iteration, thinned.digest)
    for simulations in sizes:
        fresh = _fresh(campaign, classifier, outcome, iteration, simulations, _thinned(question, simulations))
        results = stored_results(store, fresh.name, fresh.designs)
        if results is None:
            continue
        sampled = fresh.sampled(campaign, classifier, results, severity)
        if checks and is_checked(question, latent):
            designs = _places(campaign, store, iteration, fresh, sampled, question)
            if (of_check := stored_results(store, fresh.name_of_check, designs)) is not None:
                sampled = replace(sampled, check=check_of(campaign, classifier, outcome, designs, of_check))
        return sampled.estimate(confidence)
    return None


def _thinned(question: Question, simulations: int) -> Question:
    """The question with fewer weighted rows if there are many, unless all of them are simulated."""
    rows = question.space
    if not isinstance(rows, WeightedRows) or len(rows.X) <= max(_MOST_ROWS, simulations):
        return question
    return replace(question, space=rows.thinned(_MOST_ROWS))


def _fresh(
    campaign: Campaign, classifier: Classifier, outcome: str, iteration: int, simulations: int, question: Question
) -> _Fresh:
    rows = question.space
    of_designs = boundary_of(classifier, campaign.features, outcome)
    is_complete = isinstance(rows, WeightedRows) and not rows.is_sample and simulations >= len(rows.X)
    error = 0.0
    if isinstance(rows, WeightedRows) and is_complete:
        # Any other sample would be the same rows.
        simulations, question = len(rows.X), question.drawn(0)
        z = of_designs(question.designs(rows.X))
        model, none = float((rows.weight * (z > 0.0)).mean()), Doubt(0.0, 0.0)
        plan: Plan | StratifiedPlan = Plan(rows.X, rows.weight, z > 0.0, z, model, 0.0, none, none)
        severer: tuple[Plan, ...] = ()
    else:
        plan, severer = _planned(campaign, classifier, outcome, iteration, simulations, question)
        error = error_of_rows(of_designs, question)
    kept = (iteration, simulations, question.digest)
    designs, first, place = question.designs(plan.designs), None, None
    if isinstance(rows, WeightedRows):
        designs, first, place = np.unique(designs, axis=0, return_index=True, return_inverse=True)
    exists = BoundariesOf(classifier, campaign.features).exists
    existing = None if exists is None else integrate(exists, rows, designs=question.designs).of(0)
    name = name_of_estimate(_number(classifier, outcome, question), *kept)
    of_check = name_of_check(classifier.outcomes.index(outcome), *kept)
    return _Fresh(plan, severer, name, of_check, designs, first, place, is_complete, error, existing)


def error_of_rows(standardised: Standardised, question: Question) -> float:
    """Standard error of a classifier's probability; 0 unless rows that are a sample stand for the distribution."""
    rows = question.space
    if not (isinstance(rows, WeightedRows) and rows.is_sample):
        return 0.0
    return float(rows.standard_error(standardised(question.designs(rows.X)) > 0.0))


def _is_shared(classifier: Classifier, question: Question) -> bool:
    """Whether the same fresh simulations, drawn by importance, answer for all outcomes.

    They do under the campaign's own distribution, where runs are lost, and where boundaries are learned from margins:
    unlike outcomes, margins show how far from a boundary a design is.
    """
    by_margins = all(isinstance(latent, MarginLatent) for latent in classifier.latents)
    return question.is_own or classifier.unknown is not None or by_margins


def _number(classifier: Classifier, outcome: str, question: Question) -> int:
    """The number of an outcome in the name of its fresh simulations; that of the first one if all share them."""
    return 1 if _is_shared(classifier, question) else classifier.outcomes.index(outcome)


def _planned(
    campaign: Campaign, classifier: Classifier, outcome: str, iteration: int, simulations: int, question: Question
) -> tuple[Plan | StratifiedPlan, tuple[Plan, ...]]:
    """The fresh simulations that estimate a probability under a question, and the same for more severe outcomes.

    If they are not shared, those of an outcome are drawn by importance where it is very rare, or learned from a margin.
    """
    rng = stream(campaign.settings.seed, "estimate", iteration)
    if question.draw:
        rng = stream(campaign.settings.seed, "draw", _DRAWS * iteration + question.draw)

    def boundaries(lost: Lost) -> Boundaries:
        of_designs = BoundariesOf(classifier, campaign.features, lost)
        return lambda X: of_designs(question.designs(X))

    severity = classifier.outcomes.index(outcome)
    if _is_shared(classifier, question):
        kinds: tuple[Lost, ...] = ("learned",) if classifier.unknown is None else ("learned", "none", "all")
        plans = plan_estimates([boundaries(lost) for lost in kinds], question.space, simulations, rng)
        return plans[severity - 1], tuple(plans[severity:])
    learned = boundaries("learned")

    def standardised(X: Array) -> Array:
        return learned(X)[:, severity - 1]

    in_strata = not isinstance(classifier.latent(outcome), MarginLatent)
    if in_strata and (plan := plan_strata(standardised, question.space, simulations, rng)) is not None:
        return plan, ()
    share = baseline(standardised, question.space)
    if in_strata and (plan := plan_wide_strata(standardised, question.space, share, simulations, rng)) is not None:
        return plan, ()
    return plan_estimate(standardised, question.space, share, simulations, rng), ()
