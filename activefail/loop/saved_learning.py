"""What saved states say, for predictions without torch."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import DamagedError, InputError
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.margin_choice import LearnableMargins
from activefail.learning.model.saved import SavedClassifier, saved_classifier
from activefail.loop.history import History
from activefail.record.store import Store

Used = TypeVar("Used")

_CODE = "code"
"""Key of the digest of custom code in a saved state."""


def code_state(campaign: Campaign) -> dict[str, NDArray[Any]]:
    """The array of a saved state that says with which custom code it was learned; none without such code."""
    code = campaign.learner_code
    return {_CODE: np.frombuffer(bytes.fromhex(code), "<i8")} if code else {}


def margins_of(campaign: Campaign, known: History) -> LearnableMargins | None:
    """The margins that a campaign's classifier may learn from; None if it learns from outcomes alone."""
    names, learns = campaign.margins, campaign.settings.classifier.learns
    if learns == "outcomes" or not names or campaign.settings.classifier.is_custom:
        return None
    if campaign.system is not None:
        columns: tuple[int, ...] = (0,)
    else:
        columns = tuple(range(len(names))) if learns == "auto" else (names.index(learns),)
    boundaries = range(1, len(campaign.simulator.outcomes))
    values = np.stack([campaign.margins_at(severity, known.outcome, known.margins) for severity in boundaries])
    return LearnableMargins(values, campaign.levels, columns, learns != "auto", campaign.system)


def restore(
    campaign: Campaign, store: Store, through: int, use: Callable[[int, dict[str, NDArray[Any]], History], Used]
) -> tuple[int, Used] | None:
    """The newest valid state up to iteration `through`, and what is made of it; None if there is none.

    A state that other custom code has learned is not valid.

    Args:
        campaign: the campaign.
        store: the store that holds it.
        through: the last recorded iteration.
        use: makes something of an iteration, its state, and the record through this iteration.
    """
    while (saved := store.latest_state()) is not None and saved[0] <= through:
        iteration, state = saved
        if not np.array_equal(state.get(_CODE, ()), code_state(campaign).get(_CODE, ())):
            store.reject_state(iteration, "was learned with other custom code")
            continue
        try:
            return iteration, use(iteration, state, History.of(store.batches).through(iteration))
        except InputError:  # of custom code
            raise
        # Whatever is wrong with a state, the record teaches the same again.
        except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError, DamagedError) as error:
            store.reject_state(iteration, f"cannot be used ({type(error).__name__})")
    return None


def saved_current(campaign: Campaign, store: Store) -> SavedClassifier | None:
    """The classifier of all recorded batches, for predictions alone; None if no saved state holds it."""
    if campaign.settings.classifier.is_custom:
        return None

    def use(iteration: int, state: dict[str, NDArray[Any]], history: History) -> SavedClassifier:
        return _saved(campaign, state, history)

    last = History.of(store.batches).last_iteration
    saved = restore(campaign, store, last, use)
    return saved[1] if saved is not None and saved[0] == last else None


def predicting(campaign: Campaign, classifier: Classifier, history: History) -> Classifier | SavedClassifier:
    """A classifier of a history for predictions alone, with the bits of `saved_current`; itself if it is custom."""
    if campaign.settings.classifier.is_custom:
        return classifier
    from activefail.learning.model.state import classifier_state

    return _saved(campaign, classifier_state(classifier), history)


def _saved(campaign: Campaign, state: Mapping[str, NDArray[Any]], history: History) -> SavedClassifier:
    known, kernel = history.training, campaign.settings.classifier.kernel
    assert isinstance(kernel, str)
    margins, repeatable = margins_of(campaign, known), campaign.settings.is_repeatable
    outcomes, features = campaign.simulator.outcomes, campaign.features
    return saved_classifier(state, known.designs, outcomes, features, kernel, margins, repeatable)
