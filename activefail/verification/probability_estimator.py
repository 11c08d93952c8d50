"""Estimates the probability beyond a boundary from fresh simulations, and keeps them; thins large tables of pulses.

`reliability.estimate` and `reliability.strata` compute the intervals.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.acquisition.population import finite
from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.campaign.random_streams import stream
from activefail.errors import SimulationError
from activefail.execution.executor import Executor
from activefail.record.store import Store
from activefail.reliability.estimate import (
    AllRows,
    Plan,
    ProbabilityEstimate,
    baseline,
    counted,
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
    existence,
    integrate,
)
from activefail.reliability.modes import FreshModes, Sides, corrected_modes, counted_modes, doubt_of_modes
from activefail.reliability.strata import StratifiedPlan, plan_strata, plan_wide_strata
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, is_impossible
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.surrogate.latent import VariationalGP
from activefail.surrogate.system import ByMargins, SystemLatent
from activefail.verification.mode_check import check_of, is_checked, margin_of, places_of_check
from activefail.verification.stored_sets import (
    estimate_sizes,
    kind_of_estimate,
    set_name,
    simulated_results,
    stored_results,
)
from activefail.weighted import BLOCKS, WeightedRows

_DRAWS = 10_000
"""More than the number of independent samples that anything draws at one iteration."""

_MOST_ROWS = 8192
"""Most weighted rows that a plan predicts; a systematic sample stands for more of them."""


AnyPlan = Plan | StratifiedPlan | AllRows

ResultsOf = Callable[[str, Array], Results | None]
"""The name and the designs of a stored set, (n, d) -> their results; None if they are not stored."""


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
        error: standard error of the classifier's probability, from blocks of rows that stand for a distribution.
        check: of a question; None if none was made.
        exists: which designs exist; None if all do.
        severer: the same simulations for the more severe outcomes; empty if others answer for these.
        lost: as of the estimate.
        modes: what the simulations say of the modes of a system; None if the campaign has none.
        repeatable: whether equal designs have equal results; otherwise noise explains outcomes that are not improbable.
    """

    plan: AnyPlan
    beyond: NDArray[np.bool_]
    answered: NDArray[np.bool_]
    first: NDArray[np.int_] | None = None
    error: float = 0.0
    check: ModeCheck | None = None
    exists: Existing | None = None
    severer: "tuple[Sampled, ...]" = ()
    lost: tuple[float, float] | None = None
    modes: FreshModes | None = None
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
        middle, low, high = self.exists.share(confidence, isinstance(self.plan, AllRows))
        return replace(
            estimate,
            probability=min(1.0, estimate.probability / middle),
            low=min(1.0, estimate.low / high),
            high=min(1.0, estimate.high / low),
            exists=low,
        )

    def _among_all(self, confidence: float) -> ProbabilityEstimate:
        """The probability with an interval of this confidence, which includes the error of the blocks.

        If the margins of the check lie farther from the classifier's than those of the fresh simulations, they decide
        how wide the interval is. They do not change the estimate.
        """
        from scipy.stats import t

        plan, check, deviation = self.plan, self.check, 1.0
        if isinstance(plan, Plan):
            deviation = plan.deviation
            plan = plan if check is None else plan.deviating(max(deviation, check.deviation))
        estimate = plan.estimate(self.beyond, self.answered, confidence)
        estimate = replace(estimate, deviation=deviation, check=check)
        if self.first is not None:
            rows = self.first
            numbers = counted(plan.standardised[rows], self.beyond[rows], self.answered[rows])
            estimate = replace(estimate, **numbers._asdict())
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
        integral = question.integral(self.boundaries, self.campaign.space)
        return integral.of(self.classifier.outcomes.index(outcome) - 1).probability

    def plan(self, outcome: str, simulations: int, question: Question) -> Plan | StratifiedPlan:
        """The fresh simulations that `sample` makes, unless it simulates all rows of a distribution."""
        return self._planned(outcome, simulations, _thinned(question, simulations))[0]

    def sample(self, outcome: str, simulations: int, question: Question, checks: bool = False) -> Sampled:
        """Simulate fresh designs for the probability of an outcome or a more severe one.

        Args:
            outcome: its name.
            simulations: number of fresh simulations; at least 2. Of weighted rows, no row is simulated twice, and if
                there are no more rows than that, all of them are, unless the simulator does not repeat.
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
        plans: Sequence[AnyPlan]
        repeatable = self.classifier.repeatable
        if repeatable and isinstance(rows, WeightedRows) and not rows.is_sample and simulations >= len(rows.X):
            # Any other sample would be the same rows.
            simulations, question = len(rows.X), question.drawn(0)
            plans = [AllRows(rows.X, rows.weight, of_designs(question.designs(rows.X)))]
        else:
            plans = self._planned(outcome, simulations, question)
        X = question.designs(plans[0].designs)
        first, draws = None, np.arange(len(X))
        if repeatable and isinstance(rows, WeightedRows):
            # No row is simulated twice.
            X, first, draws = np.unique(X, axis=0, return_index=True, return_inverse=True)
        kept = (self.iteration, simulations)
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
            share = integrate(boundary, rows, designs=question.designs).of(0)
            exists = Existing(share, ndtr(boundary(X[draws]))[:, 0], ~impossible[draws], plans[0].ratio)
        error = error_of_rows(of_designs, question)

        def sampled_of(number: int, plan: AnyPlan) -> Sampled:
            latent = self.classifier.latents[number - 1]
            if isinstance(plan, Plan) and isinstance(latent, ByMargins):
                margin = margin_of(self.campaign, self.classifier, number, results.outcome, results.margins)
                plan = plan.deviating(deviation_of_margins(latent, self.campaign.features, X, margin))
            return Sampled(plan, (results.outcome >= number)[draws], answered[draws], first, error, exists=exists)

        sampled, *severer = (sampled_of(number, plan) for number, plan in enumerate(plans, start=severity))
        lost = None if classifier.unknown is None else self._lost(classifier, outcome, question)
        modes = None if self.campaign.system is None else self._modes(sampled, results, draws, question)
        sampled = replace(sampled, severer=tuple(severer), lost=lost, modes=modes, repeatable=repeatable)
        if not (checks and is_checked(question, self.classifier.latent(outcome))):
            return sampled
        name = set_name("check", question.digest[:16], severity, *kept)
        return replace(sampled, check=self._check(sampled, X, outcome, question, name, results_of))

    def _modes(self, sampled: Sampled, results: Results, draws: NDArray[np.int_], question: Question) -> FreshModes:
        """What the simulations of a sample, (m,) of the draws, say of the modes of the campaign's system."""
        latent, system, plan = self.classifier.latents[0], self.campaign.system, sampled.plan
        assert system is not None
        margins = np.where(sampled.answered[:, None], results.margins[draws], np.nan)
        if not (isinstance(plan, Plan) and isinstance(latent, SystemLatent)):
            return counted_modes(system, plan.ratio, margins)
        rng = stream(self.campaign.settings.seed, "modes", _DRAWS * self.iteration + question.draw)
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

    def _with_ends(self, plan: AnyPlan, classifier: Classifier, question: Question, severity: int) -> AnyPlan:
        """The plan with ends for lost runs; strata and all rows need none, because each stands for its own share."""
        if not isinstance(plan, Plan) or plan.of is None:
            return plan
        ends = []
        for lost in ("none", "all"):
            of = boundary_of(classifier, self.campaign.features, classifier.outcomes[severity], lost)

            def boundary(X: Array, of: Standardised = of) -> Array:
                return of(question.designs(X))

            ends.append(plan.of(boundary, baseline(boundary, question.space)))
        return replace(plan, ends=(ends[0], ends[1]))

    def _lost(self, classifier: Classifier, outcome: str, question: Question) -> tuple[float, float]:
        """The classifier's probability if none, and if all, of the runs that are probably lost end beyond."""

        def share(lost: Lost) -> float:
            boundary = BoundariesOf(classifier, self.campaign.features, lost, outcome)
            return question.integral(boundary, self.campaign.space).of(0).probability

        return share("none"), share("all")

    def _check(
        self, sampled: Sampled, X: Array, outcome: str, question: Question, name: str, results_of: ResultsOf
    ) -> ModeCheck | None:
        """The mode check, far from the fresh simulations X and from all of the campaign's; None without results."""
        learned = [batch.designs for batch in self.store.batches if batch.iteration <= self.iteration]
        # The estimate, unlike its interval, is the same for every confidence.
        probability = sampled.estimate(0.9).probability
        rng = stream(self.campaign.settings.seed, "hidden", _DRAWS * self.iteration + question.draw)
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

    def _planned(self, outcome: str, simulations: int, question: Question) -> Sequence[Plan | StratifiedPlan]:
        """The fresh simulations that estimate a probability, and the same for more severe outcomes.

        If they are not shared, those of an outcome are drawn by importance where it is very rare, or learned from a
        margin.
        """
        seed, rows = self.campaign.settings.seed, question.space
        rng = stream(seed, "estimate", self.iteration)
        if question.draw:
            rng = stream(seed, "draw", _DRAWS * self.iteration + question.draw)

        def boundaries(lost: Lost) -> Boundaries:
            of_designs = BoundariesOf(self.classifier, self.campaign.features, lost)
            return lambda X: of_designs(question.designs(X))

        severity, learned = self.classifier.outcomes.index(outcome), boundaries("learned")
        if self._is_shared(question):
            ends = [] if self.classifier.unknown is None else [boundaries("none"), boundaries("all")]
            latent = self.classifier.latents[0]

            def of_modes(X: Array) -> Array:
                assert isinstance(latent, SystemLatent)
                return doubt_of_modes(latent.system, self._sides(latent, question)(X))

            beside = of_modes if isinstance(latent, SystemLatent) else None
            return plan_estimates([learned, *ends], rows, simulations, rng, beside)[severity - 1 :]

        def standardised(X: Array) -> Array:
            return learned(X)[:, severity - 1]

        in_strata = not isinstance(self.classifier.latent(outcome), ByMargins)
        if in_strata and (plan := plan_strata(standardised, rows, simulations, rng)) is not None:
            return [plan]
        share = baseline(standardised, rows)
        if in_strata and (plan := plan_wide_strata(standardised, rows, share, simulations, rng)) is not None:
            return [plan]
        return [plan_estimate(standardised, rows, share, simulations, rng)]


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
