"""Train a campaign's classifier from its record, and restore it from saved states."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import DamagedError
from activefail.loop.history import History
from activefail.record.store import Store
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, train
from activefail.surrogate.state import classifier_from_state, classifier_state


def learn(campaign: Campaign, history: History, iteration: int, warm: Classifier | None) -> Classifier:
    """The classifier of an iteration, trained on the initial design and the first `iteration` active batches."""
    known = history.through(iteration).training
    return train(
        known.designs,
        known.outcome,
        campaign.simulator.outcomes,
        campaign.features,
        campaign.settings.classifier.kernel,
        warm,
    )


Saved = tuple[int, dict[str, NDArray[Any]], Classifier]
"""A saved state: its iteration, its arrays and its classifier."""


def restore(
    campaign: Campaign,
    store: Store,
    through: int,
    check: Callable[[int, Mapping[str, NDArray[Any]]], None] = lambda iteration, state: None,
) -> Saved | None:
    """The newest valid state up to iteration `through`; None if there is none.

    Args:
        campaign: the campaign of the state.
        store: the store that holds it.
        through: the last recorded iteration.
        check: further check of a state; raises DamagedError.
    """
    kernel, outcomes = campaign.settings.classifier.kernel, campaign.simulator.outcomes
    while (saved := store.latest_state()) is not None and saved[0] <= through:
        iteration, state = saved
        known = History.of(store.batches).through(iteration).training
        try:
            check(iteration, state)
            classifier = classifier_from_state(state, known.designs, known.outcome, outcomes, campaign.features, kernel)
            return iteration, state, classifier
        except KeyError:  # an older version saved fewer arrays: retrain from the record
            break
        except DamagedError as error:
            store.reject_state(iteration, str(error))
    return None


def current_classifier(campaign: Campaign, store: Store, write: bool) -> Classifier:
    """The classifier of all recorded batches, bit for bit as in the running loop.

    It starts from the last saved state and retrains on the later batches in the same order, from the same starts.

    Args:
        campaign: the campaign.
        store: its record.
        write: whether to save the retrained states.
    """
    history = History.of(store.batches)
    last = history.last_iteration
    saved = restore(campaign, store, last)
    iteration, classifier = (-1, None) if saved is None else (saved[0], saved[2])
    for later in range(iteration + 1, last + 1):
        classifier = learn(campaign, history, later, classifier)
        if write:
            store.write_state(later, classifier_state(classifier))
    assert classifier is not None
    return classifier


def accuracy(classifier: Classifier, severity: int, X: Array, outcome: NDArray[np.int8]) -> float:
    """Share of designs, (n, d), that the classifier puts on the right side of the boundary below `severity`."""
    mean = classifier.latents[severity - 1].moments(classifier.features(X)).mean
    return float(np.mean((mean > 0.0) == (outcome >= severity)))
