"""Designs simulated beside a campaign and kept in its run folder: their names, their simulation, and reading them.

A set is kept in parts, `<name>-<part>`, so that an interruption loses one part at most. Its name is one of

    validation                          what progress is judged on
    test-<designs>                      what samplings are compared on
    static-<designs>[-seed<seed>]       a static Latin hypercube
    look-<iteration>-<designs>          the fresh simulations of a stop rule's look
    verification-<iteration>-<designs>  those that a user asked for; at one iteration they are the same designs
"""

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from activefail.errors import SimulationError
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space import Array

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.execution.executor import Executor

_PART = 500
"""Designs of a set that are simulated and saved together."""

VALIDATION = "validation"


def name_of_test_set(designs: int) -> str:
    """Name of the test set of so many designs."""
    return f"test-{designs}"


def name_of_static_set(designs: int, seed: int | None = None) -> str:
    """Name of a static hypercube of so many designs; of a seed where several are compared."""
    return f"static-{designs}" if seed is None else f"static-{designs}-seed{seed}"


def name_of_look(iteration: int, designs: int) -> str:
    """Name of the set with the fresh simulations of a stop rule's look."""
    return f"look-{iteration}-{designs}"


def name_of_verification(iteration: int, designs: int) -> str:
    """Name of the set with the fresh simulations that a user asked for; they are the same designs."""
    return f"verification-{iteration}-{designs}"


def sizes_of_test_sets(store: Store) -> list[int]:
    """Designs of the test sets that a store has a part of, the largest first."""
    return _numbers(store, r"test-(\d+)")


def verified_sizes(store: Store, iteration: int) -> list[int]:
    """Designs of the sets that verify an iteration and have a part in a store, the largest first."""
    return _numbers(store, rf"(?:look|verification)-{iteration}-(\d+)")


def looks_before(store: Store, iteration: int) -> int:
    """How often a stop rule looked at iterations before this one."""
    return sum(looked < iteration for looked in _numbers(store, r"look-(\d+)-\d+"))


def _numbers(store: Store, pattern: str) -> list[int]:
    """Numbers in the names of a store's sets where the pattern has its group, the largest first."""
    found = (re.fullmatch(rf"{pattern}-0", name) for name in store.set_names())
    return sorted((int(name[1]) for name in found if name), reverse=True)


def stored_outcomes(store: Store, name: str, X: Array) -> NDArray[np.int8] | None:
    """Outcomes, (n,), of the designs of a set, (n, d), as they were simulated; None where not all of them were."""
    parts = [_same(store.read_set(f"{name}-{part}"), rows) for part, rows in enumerate(_parts(X))]
    kept = [part[1].outcome for part in parts if part is not None]
    return np.concatenate(kept) if len(kept) == len(parts) else None


def stored_set(store: Store, name: str) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs of a set and their outcomes as far as its parts go, unanswered ones left out; None without any."""
    parts: list[tuple[Array, Results]] = []
    while (part := store.read_set(f"{name}-{len(parts)}")) is not None:
        parts.append(part)
    if not parts:
        return None
    X, outcome = np.concatenate([part[0] for part in parts]), np.concatenate([part[1].outcome for part in parts])
    answered = outcome != NUMERICAL_FAILURE
    return (X[answered], outcome[answered]) if answered.any() else None


def _parts(X: Array) -> list[Array]:
    return [X[first : first + _PART] for first in range(0, len(X), _PART)]


def simulated_outcomes(
    campaign: "Campaign",
    store: Store,
    executor: "Executor",
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
    twin: str = "",
) -> NDArray[np.int8] | None:
    """Outcomes, (n,), of the designs of a set, (n, d), simulated once and then read; -1 without an answer.

    None when it was asked to stop.

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
    for part, rows in enumerate(_parts(X)):
        key = f"{name}-{part}"
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
    campaign: "Campaign",
    store: Store,
    executor: "Executor",
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs of a set and their outcomes, those without an answer left out; None when it was asked to stop."""
    outcome = simulated_outcomes(campaign, store, executor, name, X, stop)
    if outcome is None:
        return None
    answered = outcome != NUMERICAL_FAILURE
    return X[answered], outcome[answered]
