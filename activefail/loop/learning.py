"""Train a campaign's classifier from its record, and restore it from saved states."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import DamagedError
from activefail.loop.history import History
from activefail.loop.probability_rule import Looks, looked, looks_from_state, looks_state
from activefail.record.store import Store
from activefail.simulators.interface import is_impossible
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Latent, LearnableMargins, lost_latent, train
from activefail.surrogate.covariance import Hyperparameters
from activefail.surrogate.fitting import condition, fit, objective
from activefail.surrogate.saved import SavedClassifier
from activefail.surrogate.state import classifier_from_state, classifier_state, saved_classifier

STARTED_AFRESH = 250
"""Most simulations for which hyperparameters are learned from several starts: 0.1 to 0.5 s for each further one.

The objective has local optima at which a boundary finer than the design looks like noise. A start from the previous
iteration stays at such an optimum whatever is simulated afterwards."""

_BETTER = 1.0
"""By how much the objective must be larger from another start [nats]; starts that end together differ by less."""


def learn_from(campaign: Campaign, history: History, warm: Classifier | None = None) -> Classifier:
    """A classifier of all simulations of a history, as the campaign's own settings train it.

    Raises:
        InputError: if none of them has an outcome.
    """
    known = history.training
    classifier = train(
        known.designs,
        known.outcome,
        campaign.simulator.outcomes,
        campaign.features,
        campaign.settings.classifier.kernel,
        warm,
        margins_of(campaign, known),
    )
    if len(known) <= STARTED_AFRESH:
        latents = (_from_other_starts(one) if isinstance(one, Latent) else one for one in classifier.latents)
        classifier = replace(classifier, latents=tuple(latents))
    return with_lost(campaign, classifier, history)


def _from_other_starts(latent: Latent) -> Latent:
    """The latent, or one whose hyperparameters, learned from another start, explain the same outcomes clearly better.

    The starts are the default one, and length scales half as long.
    """
    trained = latent.trained
    n, m = trained.features.shape
    if trained.learned_on < n:  # its hyperparameters were kept
        return latent
    data = trained.features, trained.labels, trained.kernel
    fine = Hyperparameters(trained.hyperparameters.mean, math.log(10.0), np.full(m, math.log(0.5 * math.sqrt(m))))
    best = max(fit(*data), fit(*data, condition(*data, fine)), key=objective)
    return Latent(best) if objective(best) > objective(trained) + _BETTER else latent


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
        kernel = campaign.settings.classifier.kernel
        return lost_latent(campaign.features(history.designs), lost, kernel)

    return replace(classifier, unknown=latent(~history.answered & ~impossible), impossible=latent(impossible))


def margins_of(campaign: Campaign, known: History) -> LearnableMargins | None:
    """The margins that a campaign's classifier may learn from; None if it learns from outcomes alone."""
    names, learns = campaign.simulator.margins, campaign.settings.classifier.learns
    if learns == "outcomes" or not names:
        return None
    columns = tuple(range(len(names))) if learns == "auto" else (names.index(learns),)
    boundaries = range(1, len(campaign.simulator.outcomes))
    values = np.stack([campaign.margins_at(severity, known.outcome, known.margins) for severity in boundaries])
    return LearnableMargins(values, campaign.levels, columns, learns != "auto")


AnyClassifier = TypeVar("AnyClassifier", Classifier, SavedClassifier)


def restore(
    campaign: Campaign, store: Store, through: int, build: Callable[..., AnyClassifier]
) -> tuple[int, Looks, AnyClassifier] | None:
    """The newest valid state up to iteration `through`: its iteration, looks and classifier; None if there is none.

    Args:
        campaign: the campaign of the state.
        store: the store that holds it.
        through: the last recorded iteration.
        build: `classifier_from_state`, or `saved_classifier` for predictions alone.
    """
    kernel, outcomes = campaign.settings.classifier.kernel, campaign.simulator.outcomes
    while (saved := store.latest_state()) is not None and saved[0] <= through:
        iteration, state = saved
        history = History.of(store.batches).through(iteration)
        known = history.training
        try:
            looks = looks_from_state(campaign, state)
            margins = margins_of(campaign, known)
            classifier = build(state, known.designs, known.outcome, outcomes, campaign.features, kernel, margins)
            if isinstance(classifier, Classifier):
                classifier = with_lost(campaign, classifier, history)
            return iteration, looks, classifier
        # Whatever is wrong with a state, the record teaches the same again.
        except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError, DamagedError) as error:
            store.reject_state(iteration, f"cannot be used ({type(error).__name__})")
    return None


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


def current(campaign: Campaign, store: Store, write: bool, before: Learned | None = None) -> Learned:
    """What a campaign has learned from all recorded batches, bit for bit as in the running loop.

    It starts from the last saved state and retrains on the later batches in the same order, from the same starts.

    Args:
        campaign: the campaign.
        store: its record.
        write: whether to save the retrained states.
        before: learned earlier from this record, before any correction; takes the place of the last saved state.
    """
    history = History.of(store.batches)
    learned = before
    if learned is None or not learned.holds(history):
        saved = restore(campaign, store, history.last_iteration, classifier_from_state)
        learned = None if saved is None else Learned(saved[0], len(history.through(saved[0])), saved[2], saved[1])
    first = history.first_learnable if learned is None else learned.iteration + 1
    for iteration in range(first, history.last_iteration + 1):
        learned = Learned.after(campaign, history, iteration, learned)
        if write:
            store.write_state(iteration, learned.state)
    assert learned is not None
    return learned


def saved_current(campaign: Campaign, store: Store) -> SavedClassifier | None:
    """The classifier of all recorded batches, for predictions alone; None if no saved state holds it."""
    last = History.of(store.batches).last_iteration
    saved = restore(campaign, store, last, saved_classifier)
    return saved[2] if saved is not None and saved[0] == last else None


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


def recall(classifier: Classifier, X: Array, outcome: NDArray[np.int8]) -> dict[str, float]:
    """For each outcome of designs, (n, d), the share of its designs that the classifier predicts to have it."""
    predicted = np.argmax(classifier.probabilities(X), axis=1)
    return {
        name: float(np.mean(predicted[outcome == code] == code))
        for code, name in enumerate(classifier.outcomes)
        if (outcome == code).any()
    }
