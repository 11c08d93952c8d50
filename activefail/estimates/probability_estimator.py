"""Estimates the probability beyond a boundary from fresh simulations, and keeps them; thins large tables of pulses.

`reliability.estimate` computes the intervals.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtr, ndtri

from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.campaign.random_streams import stream
from activefail.errors import SimulationError
from activefail.estimates.confidence_bounds import BOUND_CONFIDENCE
from activefail.estimates.estimate import (
    Interval,
    Plan,
    ProbabilityEstimate,
    deviation_of_margins,
    plan_estimates,
)
from activefail.estimates.hidden import ModeCheck
from activefail.estimates.integral import (
    Boundaries,
    BoundariesOf,
    Lost,
    OfBoundary,
    Standardised,
    boundary_of,
    existence,
    integral_of,
    integrate,
)
from activefail.estimates.mode_check import check_of, is_checked, margin_of, places_of_check
from activefail.estimates.modes import (
    CorrectedModes,
    CountedModes,
    Sides,
    corrected_modes,
    counted_modes,
    doubt_of_modes,
)
from activefail.estimates.stored_sets import (
    estimate_sizes,
    kind_of_estimate,
    set_name,
    simulated_results,
    stored_results,
)
from activefail.execution.executor import Executor
from activefail.learning.criteria.population import finite
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.system import ByMargins, SystemLatent
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, is_impossible
from activefail.space.space import Array
from activefail.space.weighted import BLOCKS, WeightedRows

_DRAWS = 10_000
"""More than the number of independent samples that anything draws at one iteration."""

_MOST_ROWS = 8192
"""Most weighted rows that a plan predicts; a systematic sample stands for more of them."""


ResultsOf = Callable[[str, Array], Results | None]
"""The name and the designs of a stored set, (n, d) -> their results; None if they are not stored."""


@dataclass(frozen=True, eq=False)
class Existing:
    """What the classifier and m fresh simulations say of which designs exist.

    Attributes:
        classifier: share of the distribution that exists by the classifier, with its standard error.
        probability: (m,) that each design exists, by the classifier.
        exists: (m,) whether it does.
        plan: of the draws.
    """

    classifier: OfBoundary
    probability: Array
    exists: NDArray[np.bool_]
    plan: Plan

    def share(self, confidence: float) -> Interval:
        """The share that exists and its interval, which is exact if all rows of the distribution were simulated."""
        from scipy.stats import t

        corrections, ratio, chance = self.exists - self.probability, self.plan.ratio, self.plan.chance
        m = len(corrections)
        middle = self.classifier.probability + float(corrections @ ratio) / m
        doubt = float((chance * ratio**2 * self.probability * (1.0 - self.probability)).sum()) / m**2
        error = math.sqrt(max(sum(self.plan.moments(corrections)[::2]), doubt) + self.classifier.error**2)
        if not error > 0.0:
            return middle, middle, middle
        half = float(t.ppf(0.5 + 0.5 * confidence, m - 1)) * error
        middle = min(1.0, max(1.0 / m, middle))
        return middle, max(0.5 / m, middle - half), min(1.0, middle + half)


@dataclass(frozen=True, eq=False)
class Sampled:
    """Fresh simulations that estimate a probability.

    Attributes:
        plan: of the draws.
        beyond: (m,) whether each ended beyond the boundary.
        answered: (m,) whether each gave an outcome.
        error: standard error of the classifier's probability, from blocks of rows that stand for a distribution.
        check: of a question; None if none was made.
        exists: which designs exist; None if all do.
        severer: the same simulations for the more severe outcomes; empty if others answer for these.
        lost: as of the estimate.
        modes: what the simulations say of the modes of a system; None if the campaign has none.
        repeatable: whether equal designs have equal results; otherwise noise explains outcomes that are not improbable.
    """

    plan: Plan
    beyond: NDArray[np.bool_]
    answered: NDArray[np.bool_]
    error: float = 0.0
    check: ModeCheck | None = None
    exists: Existing | None = None
    severer: "tuple[Sampled, ...]" = ()
    lost: tuple[float, float] | None = None
    modes: CorrectedModes | CountedModes | None = None
    repeatable: bool = True

    def estimate(self, confidence: float) -> ProbabilityEstimate:
        """The probability with an interval of this confidence, at least those of the more severe outcomes."""
        estimates = [one._of_outcome(confidence) for one in (self, *self.severer)]
        largest = {name: max(getattr(one, name) for one in estimates) for name in ("probability", "low", "high")}
        contradictions = estimates[0].contradictions if self.repeatable else estimates[0].surprising
        modes = () if self.modes is None else self.modes.shares(confidence)
        return replace(estimates[0], lost=self.lost, contradictions=contradictions, modes=modes, **largest)

    def _of_outcome(self, confidence: float) -> ProbabilityEstimate:
        """The probability among the designs that exist, with an interval of this confidence (see `_among_all`)."""
        estimate = self._among_all(confidence)
        if self.exists is None:
            return estimate
        middle, low, high = self.exists.share(confidence)
        return replace(
            estimate,
            probability=min(1.0, estimate.probability / middle),
            low=min(1.0, estimate.low / high),
            high=min(1.0, estimate.high / low),
            exists=low,
        )

    def _bound(self) -> float:
        """Upper bound on the probability among all designs that needs no classifier, from the draws alone.

        What was simulated for certain is known. Of the others, each hit counts with its ratio, and one more with the
        largest that there is [FayFeuer1997]. The parts of the distribution that rows stand for may be a sample.
        """
        plan, may_be = self.plan, self.beyond | ~self.answered
        of_chance, m = plan.chance > 0.0, len(may_be)
        known = float((may_be & ~of_chance) @ plan.ratio) / m
        parts = np.append(plan.ratio[may_be & of_chance], plan.widest) / m
        mean, variance, above = float(parts.sum()), float(parts @ parts), 0.0
        if mean > 0.0:
            above = variance / mean * float(gammaincinv(mean**2 / variance, BOUND_CONFIDENCE)) - mean
        of_rows = float(ndtri(BOUND_CONFIDENCE)) * math.sqrt(float(plan.sampled @ may_be))
        return min(1.0, known + mean + math.hypot(above, of_rows))

    def _among_all(self, confidence: float) -> ProbabilityEstimate:
        """The probability with an interval of this confidence, which includes the error of the blocks.

        If the margins of the check lie farther from the classifier's than those of the fresh simulations, they decide
        how wide the interval is. They do not change the estimate.
        """
        from scipy.stats import t

        plan, check = self.plan, self.check
        plan = plan if check is None else plan.deviating(max(plan.deviation, check.deviation))
        estimate = plan.estimate(self.beyond, self.answered, confidence)
        estimate = replace(estimate, deviation=self.plan.deviation, check=check, bound=self._bound())
        if not self.error:
            return estimate
        half = float(t.ppf(0.5 + 0.5 * confidence, BLOCKS - 1)) * self.error
        middle = estimate.probability
        return replace(
            estimate,
            low=max(0.0, middle - math.hypot(middle - estimate.low, half)),
            high=min(1.0, middle + math.hypot(estimate.high - middle, half)),
        )


@dataclass(frozen=True, eq=False)
class Estimator:
    """Estimates probabilities with a frozen classifier and fresh simulations, which are kept in the run folder.

    Attributes:
        campaign: the campaign.
        store: holds the fresh simulations.
        executor: runs those that are not stored yet; None where nothing is simulated.
        classifier: of the iteration.
        iteration: the last one of the record.
        announce: called with the number of simulations that are about to be made.
    """

    campaign: Campaign
    store: Store
    executor: Executor | None
    classifier: Classifier
    iteration: int
    announce: Callable[[int], None] = field(default=lambda _: None, kw_only=True)

    @property
    def boundaries(self) -> Boundaries:
        """All boundaries as a function of designs."""
        return BoundariesOf(self.classifier, self.campaign.features)

    def standardised(self, outcome: str) -> Standardised:
        """An outcome's boundary as a function of designs."""
        return boundary_of(self.classifier, self.campaign.features, outcome)

    def probability(self, outcome: str, question: Question) -> float:
        """The probability of an outcome or a more severe one by the classifier alone, as every place shows it."""
        integral = integral_of(question, self.boundaries, self.campaign.space)
        return integral.of(self.classifier.outcomes.index(outcome) - 1).probability

    def plan(self, outcome: str, simulations: int, question: Question) -> Plan:
        """The fresh simulations that `sample` makes."""
        return self._planned(outcome, simulations, _thinned(question, simulations))[0]

    def sample(self, outcome: str, simulations: int, question: Question, checks: bool = False) -> Sampled:
        """Simulate fresh designs for the probability of an outcome or a more severe one.

        Args:
            outcome: its name.
            simulations: number of fresh simulations; at least 2. No design is simulated twice; if there are no more
                different ones, all are, and again only if the simulator does not repeat.
            question: the distribution of the variables.
            checks: whether to simulate the mode check too, if there is one.

        Raises:
            SimulationError: if none of the simulations gives an outcome.
        """
        sampled = self._sampled(outcome, simulations, question, checks, lambda name, X: self.results(name, "", X))
        assert sampled is not None  # no stop was requested
        return sampled

    def results(self, name: str, twin: str, X: Array, stop: Callable[[], bool] = lambda: False) -> Results | None:
        """Results of the designs of a set, (n, d), kept in the record (see `stored_sets.simulated_results`)."""
        assert self.executor is not None
        return simulated_results(self.campaign, self.store, self.executor, name, X, stop, twin, self.announce)

    def stored(
        self, outcome: str, question: Question, confidence: float, checks: bool = False
    ) -> ProbabilityEstimate | None:
        """The estimate from the largest stored set of fresh simulations of a question, or None; simulates nothing.

        Args:
            outcome: its name.
            question: the distribution of the variables.
            confidence: of the interval.
            checks: whether to read the mode check too, if it is stored.
        """
        number = self._number(outcome, question)
        sizes = estimate_sizes(self.store, number, self.iteration, question.digest)
        if (thinned := _thinned(question, 0)) is not question:
            sizes += estimate_sizes(self.store, number, self.iteration, thinned.digest)
        for simulations in sizes:
            sampled = self._sampled(outcome, simulations, question, checks, partial(stored_results, self.store))
            if sampled is not None:
                return sampled.estimate(confidence)
        return None

    def _sampled(
        self, outcome: str, simulations: int, question: Question, checks: bool, results_of: ResultsOf
    ) -> Sampled | None:
        """The sample with these results; None if there are none."""
        question, severity = _thinned(question, simulations), self.classifier.outcomes.index(outcome)
        rows, of_designs = question.space, boundary_of(self.classifier, self.campaign.features, outcome)
        repeatable = self.classifier.repeatable
        if repeatable and isinstance(rows, WeightedRows) and not rows.is_sample:
            different = len(np.unique(question.designs(rows.X[rows.weight > 0.0]), axis=0))
            if simulations >= different:
                # Any other sample would be the same designs.
                simulations, question = different, question.drawn(0)
        plans = self._planned(outcome, simulations, question)
        X = question.designs(plans[0].designs)
        kept = (self.iteration, len(X))
        name = set_name(kind_of_estimate(question.digest), self._number(outcome, question), *kept)
        if (results := results_of(name, X)) is None:
            return None
        impossible = is_impossible(self.campaign.simulator, results.outcome, results.cause)
        # A design that does not exist is beyond no boundary.
        answered = (results.outcome != NUMERICAL_FAILURE) | impossible
        classifier = self._with_unknown(X, ~answered)
        if classifier is not self.classifier:
            plans = [self._with_ends(plan, classifier, question, place) for place, plan in enumerate(plans, severity)]
        exists, boundary = None, BoundariesOf(self.classifier, self.campaign.features).exists
        if boundary is not None:
            share = _share_of(boundary, question, self._stream("exists", question))
            exists = Existing(share, ndtr(boundary(X))[:, 0], ~impossible, plans[0])
        error = error_of_rows(of_designs, question)

        def sampled_of(number: int, plan: Plan) -> Sampled:
            latent = self.classifier.latents[number - 1]
            if isinstance(latent, ByMargins):
                margin = margin_of(self.campaign, self.classifier, number, results.outcome, results.margins)
                plan = plan.deviating(deviation_of_margins(latent, self.campaign.features, X, margin))
            return Sampled(plan, results.outcome >= number, answered, error, exists=exists)

        sampled, *severer = (sampled_of(number, plan) for number, plan in enumerate(plans, start=severity))
        lost = None if classifier.unknown is None else self._lost(classifier, outcome, question)
        modes = None if self.campaign.system is None else self._modes(sampled, results, question)
        sampled = replace(sampled, severer=tuple(severer), lost=lost, modes=modes, repeatable=repeatable)
        if not (checks and is_checked(question, self.classifier.latent(outcome))):
            return sampled
        name = set_name("check", question.digest[:16], severity, *kept)
        return replace(sampled, check=self._check(sampled, X, outcome, question, name, results_of))

    def _modes(self, sampled: Sampled, results: Results, question: Question) -> CorrectedModes | CountedModes:
        """What the m simulations of a sample say of the modes of the campaign's system."""
        latent, system, plan = self.classifier.latents[0], self.campaign.system, sampled.plan
        assert system is not None
        margins = np.where(sampled.answered[:, None], results.margins[:, : len(system.names)], np.nan)
        if not isinstance(latent, SystemLatent):
            return counted_modes(system, plan, margins)
        rng = self._stream("modes", question)
        return corrected_modes(system, plan, margins, self._sides(latent, question), question.space, rng)

    def _sides(self, latent: SystemLatent, question: Question) -> Sides:
        """The probits that each mode has failed, of values of a question's variables."""
        return lambda X: latent.sides(finite(self.campaign.features, question.designs(X)))

    def _with_unknown(self, X: Array, lost: NDArray[np.bool_]) -> Classifier:
        """The classifier that knows where runs are lost, if only fresh simulations, (n, d), have shown that any are."""
        if self.classifier.unknown is not None or not lost.any():
            return self.classifier
        known = [batch.designs for batch in self.store.batches if batch.iteration <= self.iteration]
        labels = np.concatenate([np.zeros(sum(map(len, known)), dtype=bool), lost])
        F = self.campaign.features(np.concatenate([*known, X]))
        return replace(self.classifier, unknown=VariationalGP("matern52").learned(F, labels))

    def _with_ends(self, plan: Plan, classifier: Classifier, question: Question, severity: int) -> Plan:
        """The plan with ends for lost runs."""
        assert plan.of is not None
        ends = []
        for lost in ("none", "all"):
            of = boundary_of(classifier, self.campaign.features, classifier.outcomes[severity], lost)

            def boundary(X: Array, of: Standardised = of) -> Array:
                return of(question.designs(X))

            ends.append(plan.of(boundary))
        return replace(plan, ends=(ends[0], ends[1]))

    def _lost(self, classifier: Classifier, outcome: str, question: Question) -> tuple[float, float]:
        """The classifier's probability if none, and if all, of the runs that are probably lost end beyond."""

        def share(lost: Lost) -> float:
            boundary = BoundariesOf(classifier, self.campaign.features, lost, outcome)
            return integral_of(question, boundary, self.campaign.space).of(0).probability

        return share("none"), share("all")

    def _check(
        self, sampled: Sampled, X: Array, outcome: str, question: Question, name: str, results_of: ResultsOf
    ) -> ModeCheck | None:
        """The mode check, far from the fresh simulations X and from all of the campaign's; None without results."""
        learned = [batch.designs for batch in self.store.batches if batch.iteration <= self.iteration]
        # The estimate, unlike its interval, is the same for every confidence.
        probability = sampled.estimate(0.9).probability
        rng = self._stream("hidden", question)
        known, exists = np.concatenate([*learned, X]), existence(self.boundaries)
        designs = places_of_check(self.campaign, question, known, probability, rng, exists)
        try:
            results = results_of(name, designs)
        except SimulationError:
            # Far out, a simulator may fail everywhere, or no design exists. The fresh simulations stand.
            return ModeCheck(len(designs), len(designs), 0) if exists is None else None
        return None if results is None else check_of(self.campaign, self.classifier, outcome, designs, results)

    def _is_shared(self, question: Question) -> bool:
        """Whether the same fresh simulations, drawn by importance, answer for all outcomes.

        They do under the campaign's own distribution, where runs are lost, and where boundaries are learned from
        margins: unlike outcomes, margins show how far from a boundary a design is.
        """
        by_margins = all(isinstance(latent, ByMargins) for latent in self.classifier.latents)
        return question.is_own or self.classifier.unknown is not None or by_margins

    def _number(self, outcome: str, question: Question) -> int:
        """The number of an outcome in the name of its fresh simulations; that of the first one if all share them."""
        return 1 if self._is_shared(question) else self.classifier.outcomes.index(outcome)

    def _stream(self, use: str, question: Question) -> np.random.Generator:
        """The random numbers of a use, for each draw of a question at this iteration."""
        return stream(self.campaign.settings.seed, use, _DRAWS * self.iteration + question.draw)

    def _planned(self, outcome: str, simulations: int, question: Question) -> Sequence[Plan]:
        """The fresh simulations that estimate a probability, and the same for more severe outcomes if they share them.

        Shared ones are spread over the doubt of the most severe outcome, whichever is asked for.
        """
        rng = self._stream("draw", question)

        def boundaries(lost: Lost) -> Boundaries:
            of_designs = BoundariesOf(self.classifier, self.campaign.features, lost)
            return lambda X: of_designs(question.designs(X))

        severity, learned = self.classifier.outcomes.index(outcome), boundaries("learned")
        designs, repeatable, unguided = question.designs, self.classifier.repeatable, question.unguided
        space = question.space
        if not self._is_shared(question):

            def only(X: Array) -> Array:
                return learned(X)[:, severity - 1 : severity]

            return plan_estimates([only], space, simulations, rng, None, designs, 0, repeatable, True, unguided)
        ends = [] if self.classifier.unknown is None else [boundaries("none"), boundaries("all")]
        latent = self.classifier.latents[0]

        def of_modes(X: Array) -> Array:
            assert isinstance(latent, SystemLatent)
            return doubt_of_modes(latent.system, self._sides(latent, question)(X))

        beside = of_modes if isinstance(latent, SystemLatent) else None
        every = [learned, *ends]
        plans = plan_estimates(every, space, simulations, rng, beside, designs, -1, repeatable, False, unguided)
        return plans[severity - 1 :]


def _share_of(boundary: Boundaries, question: Question, rng: np.random.Generator) -> OfBoundary:
    """The share of a question that a boundary is crossed in, by the classifier alone; of rows by all of them."""
    rows = question.space
    if isinstance(rows, WeightedRows):
        beyond = ndtr(boundary(question.designs(rows.X)))[:, 0]
        return OfBoundary(float(rows.weight @ beyond) / len(beyond), 0.0, 0.0)
    return integrate(boundary, rows, designs=question.designs, rng=rng).of(0)


def _thinned(question: Question, simulations: int) -> Question:
    """The question with fewer weighted rows if there are many, unless all of them are simulated."""
    rows = question.space
    if not isinstance(rows, WeightedRows) or len(rows.X) <= max(_MOST_ROWS, simulations):
        return question
    return replace(question, space=rows.thinned(_MOST_ROWS))


def error_of_rows(standardised: Standardised, question: Question) -> float:
    """Standard error of a classifier's probability; 0 unless rows that are a sample stand for the distribution."""
    rows = question.space
    if not (isinstance(rows, WeightedRows) and rows.is_sample):
        return 0.0
    return float(rows.standard_error(standardised(question.designs(rows.X)) > 0.0))
