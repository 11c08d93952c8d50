"""What a campaign has learned: trained from its record, saved beside it, and found again after an interruption."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.history import History
from activefail.errors import DamagedError
from activefail.record.store import Store
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, train
from activefail.surrogate.state import classifier_from_state, classifier_state


def learn(campaign: Campaign, history: History, iteration: int, warm: Classifier | None) -> Classifier:
    """The classifier of an iteration: trained on the initial design and the first `iteration` chosen batches."""
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
"""A saved state: its iteration, its arrays, and the classifier in it."""


def restore(
    campaign: Campaign,
    store: Store,
    through: int,
    check: Callable[[int, Mapping[str, NDArray[Any]]], None] = lambda iteration, state: None,
) -> Saved | None:
    """The newest saved state of at most iteration `through`; None when there is none.

    Args:
        campaign: that it belongs to.
        store: that holds it.
        through: the last iteration that is known.
        check: raises DamagedError where a state lacks something else that it must hold.
    """
    kernel, outcomes = campaign.settings.classifier.kernel, campaign.simulator.outcomes
    while (saved := store.latest_state()) is not None and saved[0] <= through:
        iteration, state = saved
        known = History.of(store.batches).through(iteration).training
        try:
            check(iteration, state)
            classifier = classifier_from_state(state, known.designs, known.outcome, outcomes, campaign.features, kernel)
            return iteration, state, classifier
        except KeyError:  # saved by a version that kept less: learned again from the record
            break
        except DamagedError as error:
            store.reject_state(iteration, str(error))
    return None


def current_classifier(campaign: Campaign, store: Store, write: bool) -> Classifier:
    """The classifier of all recorded batches, exactly as the running loop has it.

    What was saved is taken from there; what came since is learned again in the same order, from the same starts.

    Args:
        write: whether to save what was learned here.
    """
    history = History.of(store.batches)
    last = history.last_iteration
    saved = restore(campaign, store, last)
    iteration, classifier = (-1, None) if saved is None else (saved[0], saved[2])
    for following in range(iteration + 1, last + 1):
        classifier = learn(campaign, history, following, classifier)
        if write:
            store.write_state(following, classifier_state(classifier))
    assert classifier is not None
    return classifier


def accuracy(classifier: Classifier, severity: int, X: Array, outcome: NDArray[np.int8]) -> float:
    """Share of designs on the right side of the boundary below `severity`."""
    mean = classifier.latents[severity - 1].moments(classifier.features(X)).mean
    return float(np.mean((mean > 0.0) == (outcome >= severity)))
