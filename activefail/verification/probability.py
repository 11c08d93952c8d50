"""Estimate the probability beyond a boundary from fresh simulations, which are kept in the run folder."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.campaign.random_streams import stream
from activefail.execution.executor import Executor
from activefail.record.store import Store
from activefail.reliability.estimate import (
    Plan,
    ProbabilityEstimate,
    Standardised,
    estimated,
    integrated,
    plan_common,
    plan_estimate,
    standardised_latent,
)
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier
from activefail.verification.stored_sets import estimate_sizes, name_of_estimate, simulated_outcomes, stored_outcomes
from activefail.weighted import BLOCKS, WeightedRows

_DRAWS = 10_000
"""More than the number of independent samples that anything draws at one iteration."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """Fresh simulations that estimate a probability.

    Attributes:
        plan: of the simulations.
        beyond: (m,) whether each ended beyond the boundary.
        answered: (m,) whether each gave an outcome.
        error: standard error of the classifier's probability, from blocks of rows that stand for a distribution.
    """

    plan: Plan
    beyond: NDArray[np.bool_]
    answered: NDArray[np.bool_]
    error: float = 0.0

    def estimate(self, confidence: float) -> ProbabilityEstimate:
        """The probability with an interval of this confidence, which includes the error of the blocks."""
        from scipy.stats import t

        found = estimated(self.plan, self.beyond, self.answered, confidence)
        if not self.error:
            return found
        half = float(t.ppf(0.5 + 0.5 * confidence, BLOCKS - 1)) * self.error
        middle = found.probability
        return replace(
            found,
            low=max(0.0, middle - math.hypot(middle - found.low, half)),
            high=min(1.0, middle + math.hypot(found.high - middle, half)),
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
    """

    campaign: Campaign
    store: Store
    executor: Executor | None
    classifier: Classifier
    iteration: int

    def standardised(self, outcome: str) -> Standardised:
        """The latent of an outcome's boundary as a function of designs."""
        return standardised_latent(self.classifier.latent(outcome), self.campaign.features)

    def plan(self, outcome: str, simulations: int, question: Question) -> Plan:
        """The fresh simulations that `sample` makes."""
        return planned(self.campaign, self.standardised(outcome), self.iteration, simulations, question)

    def sample(self, outcome: str, simulations: int, question: Question) -> Sampled:
        """Simulate fresh designs for the probability of an outcome or a more severe one.

        Args:
            outcome: its name.
            simulations: number of fresh simulations; at least 2.
            question: the distribution of the variables.

        Raises:
            SimulationError: if none of the simulations gives an outcome.
        """
        assert self.executor is not None
        severity = self.campaign.simulator.outcomes.index(outcome)
        plan = self.plan(outcome, simulations, question)
        name = name_of_estimate(severity, self.iteration, simulations, question.digest)
        designs = question.designs(plan.designs)
        outcomes = simulated_outcomes(self.campaign, self.store, self.executor, name, designs)
        assert outcomes is not None  # no stop was requested
        error = error_of_rows(self.standardised(outcome), question)
        return Sampled(plan, outcomes >= severity, outcomes != NUMERICAL_FAILURE, error)

    def stored(self, outcome: str, question: Question, confidence: float) -> ProbabilityEstimate | None:
        """The estimate from stored simulations (see `stored_estimate`)."""
        given = (self.campaign, self.store, self.classifier, self.iteration)
        return stored_estimate(*given, outcome, confidence, question)


def stored_estimate(
    campaign: Campaign,
    store: Store,
    classifier: Classifier,
    iteration: int,
    outcome: str,
    confidence: float,
    question: Question,
) -> ProbabilityEstimate | None:
    """The estimate from the largest stored set of fresh simulations of a question, or None.

    It simulates nothing.

    Args:
        campaign, store, classifier, iteration: as for `Estimator`.
        outcome: its name.
        confidence: of the interval.
        question: the distribution of the variables.
    """
    severity = campaign.simulator.outcomes.index(outcome)
    of_designs = standardised_latent(classifier.latent(outcome), campaign.features)
    for simulations in estimate_sizes(store, severity, iteration, question.digest):
        plan = planned(campaign, of_designs, iteration, simulations, question)
        name = name_of_estimate(severity, iteration, simulations, question.digest)
        outcomes = stored_outcomes(store, name, question.designs(plan.designs))
        if outcomes is not None:
            error = error_of_rows(of_designs, question)
            sampled = Sampled(plan, outcomes >= severity, outcomes != NUMERICAL_FAILURE, error)
            return sampled.estimate(confidence)
    return None


def error_of_rows(standardised: Standardised, question: Question) -> float:
    """Standard error of a classifier's probability; 0 unless rows that are a sample stand for the distribution."""
    rows = question.space
    if not (isinstance(rows, WeightedRows) and rows.is_sample):
        return 0.0
    return float(rows.standard_error(standardised(question.designs(rows.X)) > 0.0))


def planned(campaign: Campaign, of_designs: Standardised, iteration: int, simulations: int, question: Question) -> Plan:
    """The fresh simulations that estimate a probability under a question, from the latent as a function of designs."""
    rng = stream(campaign.settings.seed, "estimate", iteration)
    if question.draw:
        rng = stream(campaign.settings.seed, "draw", _DRAWS * iteration + question.draw)

    def standardised(X: Array) -> Array:
        return of_designs(question.designs(X))

    if question.draw and isinstance(question.space, DesignSpace):
        plan = plan_common(standardised, question.space, simulations, rng)
        if plan is not None:
            return plan
    integral = integrated(standardised, question.space, rng)
    return plan_estimate(standardised, question.space, integral, simulations, rng)
