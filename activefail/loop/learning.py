"""Train a campaign's classifier from its record, from several starts, and restore it from saved states."""

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.fitting import MakePrior, condition, fit
from activefail.learning.model.latent import CustomModel, Latent, Learner, VariationalGP
from activefail.learning.model.likelihoods import Probit
from activefail.learning.model.state import classifier_from_state, classifier_state
from activefail.learning.model.training import train
from activefail.loop.history import History
from activefail.loop.probability_rule import Looks, looked, looks_from_state, looks_state
from activefail.loop.saved_learning import code_state, margins_of, restore
from activefail.loop.stop_rule import how_met, note_met
from activefail.record.store import Store
from activefail.simulators.interface import is_impossible
from activefail.simulators.user_code import KERNEL_KEY, LEARNER_KEYS, LIKELIHOOD_KEY, MODEL_KEY
from activefail.space.space import Array

STARTED_AFRESH = 250
"""Most simulations for which hyperparameters are learned from several starts: 0.1 to 0.5 s for each further one.

The objective has local optima at which a boundary finer than the design looks like noise. A start from the previous
iteration stays at such an optimum whatever is simulated afterwards."""

_BETTER = 1.0
"""By how much the objective must be larger from another start [nats]; starts that end together differ by less."""


def learner_of(campaign: Campaign) -> Learner:
    """How latents are learned from outcomes."""
    custom, kernel = campaign.learner, campaign.settings.classifier.kernel
    repeatable = campaign.settings.is_repeatable
    if MODEL_KEY in custom:
        return CustomModel(custom[MODEL_KEY], repeatable)
    likelihood = custom.get(LIKELIHOOD_KEY, Probit)
    return VariationalGP(kernel if isinstance(kernel, str) else custom[KERNEL_KEY], likelihood, repeatable)


def learn_from(campaign: Campaign, history: History, warm: Classifier | None = None) -> Classifier:
    """A classifier of all simulations of a history, as the campaign's own settings train it.

    Raises:
        InputError: if none of them has an outcome.
    """
    known, learner = history.training, learner_of(campaign)
    margins, outcomes = margins_of(campaign, known), campaign.simulator.outcomes
    with campaign.custom_code(*LEARNER_KEYS):
        classifier = train(known.designs, known.outcome, outcomes, campaign.features, learner, warm, margins)
        if len(known) <= STARTED_AFRESH and isinstance(learner, VariationalGP):
            make = learner.default_prior
            latents = (_from_other_starts(one, make) if isinstance(one, Latent) else one for one in classifier.latents)
            classifier = replace(classifier, latents=tuple(latents))
        return with_lost(campaign, classifier, history)


def _from_other_starts(latent: Latent, make: MakePrior) -> Latent:
    """The latent, or one whose hyperparameters, learned from another start, explain the same outcomes clearly better.

    The starts are the default one, and length scales half as long.
    """
    trained = latent.trained
    n, m = trained.features.shape
    if trained.learned_on < n:  # its hyperparameters were kept
        return latent
    data = trained.features, trained.labels
    starts = [fit(*data, make)]
    if trained.prior.length_scales is not None:
        fine = make(m)
        fine.mean_module.initialize(constant=trained.prior.mean_module.constant.detach())
        fine.covar_module.base_kernel.initialize(lengthscale=0.5 * math.sqrt(m))
        starts.append(fit(*data, make, condition(fine.requires_grad_(False), *data)))
    best = max(starts, key=lambda start: start.objective)
    return Latent(best) if best.objective > trained.objective + _BETTER else latent


def with_lost(campaign: Campaign, classifier: Classifier, history: History) -> Classifier:
    """A classifier with what the simulations say about where there is no result.

    It is learned anew each time, so that no saved state needs it.
    """
    history = history.without_leading_failures
    if history.answered.all():
        return classifier
    impossible = is_impossible(campaign.simulator, history.outcome, history.cause)

    def latent(lost: NDArray[np.bool_]) -> Latent | None:
        if not lost.any():
            return None
        learner = learner_of(campaign)
        gp = learner if isinstance(learner, VariationalGP) else VariationalGP("matern52")
        return gp.learned(campaign.features.to_learn(history.designs), lost)

    return replace(classifier, unknown=latent(~history.answered & ~impossible), impossible=latent(impossible))


@dataclass(frozen=True)
class Learned:
    """What a campaign has learned after an iteration.

    Attributes:
        iteration: the last one that it has learned from.
        simulations: number of simulations through this iteration.
        classifier: trained on them.
        looks: of its stop rule for a probability, if it has one.
    """

    iteration: int
    simulations: int
    classifier: Classifier
    looks: Looks = field(default_factory=Looks)

    @classmethod
    def after(cls, campaign: Campaign, history: History, iteration: int, before: Self | None) -> Self:
        """What is learned from the simulations through an iteration, `before` from those through the one before."""
        earlier = None if before is None else before.classifier
        known = history.through(iteration)
        classifier = learn_from(campaign, known, earlier)
        looks = Looks() if before is None else before.looks
        if campaign.settings.probability_rule is not None:
            looks = looked(campaign, known, iteration, earlier, classifier, looks)
        return cls(iteration, len(known), classifier, looks)

    @property
    def state(self) -> dict[str, NDArray[Any]]:
        """The arrays of a saved state."""
        return classifier_state(self.classifier) | looks_state(self.looks)

    def holds(self, history: History) -> bool:
        """Whether this was learned from the beginning of a record; not if its iteration got another batch since."""
        return self.simulations == len(history.through(self.iteration))


def _learned_of(campaign: Campaign, iteration: int, state: dict[str, NDArray[Any]], history: History) -> Learned:
    """What a saved state says was learned."""
    known, looks = history.training, looks_from_state(campaign, state)
    data = known.designs, known.outcome, campaign.simulator.outcomes
    margins = margins_of(campaign, known)
    with campaign.custom_code(*LEARNER_KEYS):
        classifier = classifier_from_state(state, *data, campaign.features, learner_of(campaign), margins)
        return Learned(iteration, len(history), with_lost(campaign, classifier, history), looks)


def current(campaign: Campaign, store: Store, write: bool, before: Learned | None = None) -> Learned:
    """What a campaign has learned from all recorded batches, bit for bit as in the running loop.

    It starts from the last saved state and retrains on the later batches in the same order, from the same starts.

    Args:
        campaign: the campaign.
        store: its record.
        write: whether to save the retrained states, and that the stop rule is met.
        before: learned earlier from this record, before any correction; takes the place of the last saved state.
    """
    history = History.of(store.batches)
    learned = before
    if learned is None or not learned.holds(history):
        saved = restore(campaign, store, history.last_iteration, partial(_learned_of, campaign))
        learned = None if saved is None else saved[1]
    first = history.first_learnable if learned is None else learned.iteration + 1
    for iteration in range(first, history.last_iteration + 1):
        learned = Learned.after(campaign, history, iteration, learned)
        if write:
            store.write_state(iteration, learned.state | code_state(campaign))
    assert learned is not None
    if write:
        note_met(store, how_met(campaign, history, learned.looks))
    return learned


def classifier_after(campaign: Campaign, history: History) -> Classifier:
    """The classifier that a campaign had after its first simulations, bit for bit if they end with a batch.

    It learns again from each iteration, from the same starts as the running loop: saved states are later ones.

    Raises:
        InputError: if no simulation of the initial design has an outcome.
    """
    classifier = None
    for iteration in range(history.first_learnable, history.last_iteration + 1):
        classifier = learn_from(campaign, history.through(iteration), classifier)
    assert classifier is not None
    return classifier


def accuracy(classifier: Classifier, severity: int, X: Array, outcome: NDArray[np.int8]) -> float:
    """Share of designs, (n, d), that the classifier puts on the right side of the boundary below `severity`."""
    mean = classifier.latents[severity - 1].moments(classifier.features(X)).mean
    return float(np.mean((mean > 0.0) == (outcome >= severity)))
