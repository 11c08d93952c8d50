"""Sets of designs simulated outside the budget and kept in the run folder: names, simulation and reading.

A set is stored in parts, `<name>-<part>`, so that an interruption loses at most one part. Its name is one of

    validation                          for the accuracy shown as progress
    test-<designs>                      for comparing samplings
    static-<designs>[-seed<seed>]       a static Latin hypercube
    around-<designs>                    designs around those of a test set
    look-<iteration>-<designs>          fresh simulations of a look of the stop rule
    verification-<iteration>-<designs>  fresh simulations that a user requested; the same designs as a look's
    probability-<number of outcome>-<iteration>-<designs>  fresh simulations that estimate a probability; the number
                                        is 1 if they answer for all outcomes
    question-<digest>-<number of outcome>-<iteration>-<designs>  the same under a question
    check-<digest>-<number of outcome>-<iteration>-<designs>  the mode check beside them
"""

import re
from collections.abc import Callable, Iterable
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
"""Designs in one part of a set."""

VALIDATION = "validation"


def name_of_test_set(designs: int) -> str:
    """Name of a test set."""
    return f"test-{designs}"


def name_of_static_set(designs: int, seed: int | None = None) -> str:
    """Name of a static Latin hypercube; with its seed in a comparison over seeds."""
    return f"static-{designs}" if seed is None else f"static-{designs}-seed{seed}"


def name_of_neighbours(designs: int) -> str:
    """Name of the set of designs around those of a test set of this size."""
    return f"around-{designs}"


def name_of_look(iteration: int, designs: int) -> str:
    """Name of the fresh simulations of a look of the stop rule."""
    return f"look-{iteration}-{designs}"


def name_of_verification(iteration: int, designs: int) -> str:
    """Name of the fresh simulations that a user requested; the same designs as a look's."""
    return f"verification-{iteration}-{designs}"


def name_of_estimate(severity: int, iteration: int, designs: int, question: str = "") -> str:
    """Name of the fresh simulations that estimate the probability of an outcome, by its number.

    Args:
        severity: number of the outcome.
        iteration: of the classifier.
        designs: number of simulations.
        question: digest of the question; empty for the design measure.
    """
    of = f"{severity}-{iteration}-{designs}"
    return f"question-{question[:16]}-{of}" if question else f"probability-{of}"


def name_of_check(severity: int, iteration: int, designs: int, question: str) -> str:
    """Name of the mode check beside the fresh simulations of a question (see `name_of_estimate`)."""
    return f"check-{question[:16]}-{severity}-{iteration}-{designs}"


def first_part(name: str) -> str:
    """Name under which the first part of a set is stored."""
    return f"{name}-0"


def sizes_of_test_sets(store: Store) -> list[int]:
    """Sizes of the test sets with at least one stored part, the largest first."""
    return _numbers(store, r"test-(\d+)")


def verified_sizes(store: Store, iteration: int) -> list[int]:
    """Sizes of the sets that verify an iteration and have at least one stored part, the largest first."""
    return _numbers(store, rf"(?:look|verification)-{iteration}-(\d+)")


def estimate_sizes(store: Store, severity: int, iteration: int, question: str = "") -> list[int]:
    """Sizes of the sets that estimate a probability at an iteration, the largest first."""
    name = name_of_estimate(severity, iteration, 0, question)
    return _numbers(store, rf"{name.removesuffix('0')}(\d+)")


def looks_before(store: Store, iteration: int) -> int:
    """Number of the stop rule's looks before an iteration."""
    return sum(earlier < iteration for earlier in _numbers(store, r"look-(\d+)-\d+"))


def _numbers(store: Store, pattern: str) -> list[int]:
    """The numbers that the pattern's group matches in the names of stored sets, the largest first."""
    matches = (re.fullmatch(rf"{pattern}-0", name) for name in store.set_names())
    return sorted((int(match[1]) for match in matches if match), reverse=True)


def stored_outcomes(store: Store, name: str, X: Array) -> NDArray[np.int8] | None:
    """Stored outcomes, (n,), of the designs of a set, (n, d); None unless all of them are stored."""
    results = stored_results(store, name, X)
    return None if results is None else results.outcome


def stored_results(store: Store, name: str, X: Array) -> Results | None:
    """Stored results of the designs of a set, (n, d); None unless all of them are stored."""
    parts = [_same(store.read_set(f"{name}-{part}"), rows) for part, rows in enumerate(_parts(X))]
    results = [part[1] for part in parts if part is not None]
    return Results.concatenate(results) if len(results) == len(parts) else None


def stored_set(store: Store, name: str) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs and outcomes of the stored parts of a set, without numerical failures; None if there are none."""
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
    """Outcomes, (n,), of a set's designs; -1 for a numerical failure. None if stopped (see `simulated_results`)."""
    results = simulated_results(campaign, store, executor, name, X, stop, twin)
    return None if results is None else results.outcome


def simulated_results(
    campaign: "Campaign",
    store: Store,
    executor: "Executor",
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
    twin: str = "",
) -> Results | None:
    """Results of the designs of a set, (n, d); None if stopped.

    Stored parts are read; the others are simulated and stored.

    Args:
        campaign: the campaign of the set.
        store: holds the set.
        executor: runs the simulations.
        name: of the set.
        X: its designs.
        stop: whether to stop before the next part.
        twin: name of a set that may hold the same designs; its parts are copied instead of simulated.

    Raises:
        SimulationError: if every simulation of a part fails, which is a fault of the simulator. That part is not
            stored, so that it is simulated again once the simulator is fixed.
    """
    parts = []
    for part, rows in enumerate(_parts(X)):
        key = f"{name}-{part}"
        saved = _same(store.read_set(key), rows)
        if saved is None and twin and (saved := _same(store.read_set(f"{twin}-{part}"), rows)) is not None:
            store.write_set(key, *saved)
        if saved is None:
            if stop():
                return None
            results = executor.run(campaign.simulator, rows)
            if (results.outcome == NUMERICAL_FAILURE).all():
                raise SimulationError(
                    f"None of the {len(rows)} simulations for {name} gave an outcome. Their results were discarded."
                    + first_fault_text(results.faults.values())
                )
            saved = (rows, results)
            store.write_set(key, *saved)
        parts.append(saved[1])
    return Results.concatenate(parts)


def first_fault_text(faults: Iterable[str]) -> str:
    """A sentence for the end of a message that quotes the first fault; empty if there is none."""
    return next((f" Why the first abandoned simulation failed: {fault}" for fault in faults), "")


def _same(saved: tuple[Array, Results] | None, X: Array) -> tuple[Array, Results] | None:
    """The saved part if it holds exactly these designs, otherwise None."""
    return saved if saved is not None and np.array_equal(saved[0], X) else None


def simulated_set(
    campaign: "Campaign",
    store: Store,
    executor: "Executor",
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs and outcomes of a set, without numerical failures; None if stopped (see `simulated_outcomes`)."""
    outcome = simulated_outcomes(campaign, store, executor, name, X, stop)
    if outcome is None:
        return None
    answered = outcome != NUMERICAL_FAILURE
    return X[answered], outcome[answered]
