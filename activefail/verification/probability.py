"""Estimate the probability beyond a boundary from fresh simulations, which are kept in the run folder."""

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.execution.executor import Executor
from activefail.record.store import Store
from activefail.reliability.estimate import ProbabilityEstimate, estimated, integrated, plan_estimate, standardised_latent
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.surrogate.classifier import Classifier
from activefail.verification.stored_sets import name_of_estimate, simulated_outcomes


def estimate_probability(
    campaign: Campaign,
    store: Store,
    executor: Executor,
    classifier: Classifier,
    iteration: int,
    outcome: str,
    simulations: int,
    confidence: float,
) -> ProbabilityEstimate:
    """The probability of an outcome or a more severe one, with the classifier of an iteration.

    Args:
        campaign: the campaign.
        store: holds the fresh simulations.
        executor: runs those that are not stored yet.
        classifier: of the iteration.
        iteration: the last one of the record.
        outcome: its name.
        simulations: number of fresh simulations; at least 2.
        confidence: of the interval.

    Raises:
        SimulationError: if none of the simulations gives an outcome.
    """
    severity = campaign.simulator.outcomes.index(outcome)
    rng = stream(campaign.settings.seed, "estimate", iteration)
    standardised = standardised_latent(classifier.latent(outcome), campaign.features)
    integral = integrated(standardised, campaign.space, rng)
    plan = plan_estimate(standardised, campaign.space, integral, simulations, rng)
    name = name_of_estimate(severity, iteration, simulations)
    outcomes = simulated_outcomes(campaign, store, executor, name, plan.designs)
    assert outcomes is not None  # no stop was requested
    answered = np.asarray(outcomes != NUMERICAL_FAILURE)
    return estimated(plan, np.asarray(outcomes >= severity), answered, confidence)
