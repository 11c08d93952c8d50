"""Designs simulated beside a campaign, kept in its run folder: validation, tests, verification."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.errors import SimulationError
from activefail.execution.executor import Executor
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space import Array

_PART = 500
"""Designs of a set that are simulated and saved together."""


def simulated_outcomes(
    campaign: Campaign,
    store: Store,
    executor: Executor,
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
    twin: str = "",
) -> NDArray[np.int8] | None:
    """Outcomes, (n,), of the designs of a set, (n, d), simulated once and then read; -1 without an answer.

    The set is kept in parts, so that an interruption loses one part at most. None when it was asked to stop.

    Args:
        campaign, store, executor: that the set belongs to, is kept in, and is simulated by.
        name: of the set.
        X: its designs.
        stop: whether to stop before the next part.
        twin: name of a set that may hold the same designs; these are copied and not simulated again.

    Raises:
        SimulationError: if none of a part's simulations gives an answer: a fault of the simulator's. The part is not
            kept: it would stand for the set when the fault is mended.
    """
    outcomes = [np.empty(0, dtype=np.int8)]
    for part, first in enumerate(range(0, len(X), _PART)):
        rows, key = X[first : first + _PART], f"{name}-{part}"
        saved = _same(store.read_set(key), rows)
        if saved is None and twin and (saved := _same(store.read_set(f"{twin}-{part}"), rows)) is not None:
            store.write_set(key, *saved)
        if saved is None:
            if stop():
                return None
            saved = (rows, executor.run(campaign.simulator, rows))
            if (saved[1].outcome == NUMERICAL_FAILURE).all():
                fault = (
                    f" Why the first abandoned simulation failed: {executor.first_fault}"
                    if executor.first_fault
                    else ""
                )
                raise SimulationError(
                    f"None of the {len(rows)} simulations for {name} gave an answer; they are not kept.{fault}"
                )
            store.write_set(key, *saved)
        outcomes.append(saved[1].outcome)
    return np.concatenate(outcomes)


def _same(saved: tuple[Array, Results] | None, X: Array) -> tuple[Array, Results] | None:
    """A set if it holds just these designs."""
    return saved if saved is not None and np.array_equal(saved[0], X) else None


def simulated_set(
    campaign: Campaign, store: Store, executor: Executor, name: str, X: Array, stop: Callable[[], bool] = lambda: False
) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs of a set and their outcomes, those without an answer left out; None when it was asked to stop."""
    outcome = simulated_outcomes(campaign, store, executor, name, X, stop)
    if outcome is None:
        return None
    answered = outcome != NUMERICAL_FAILURE
    return X[answered], outcome[answered]
