"""Sets of designs simulated outside the budget and kept in the run folder: names, simulation and reading.

A set is stored in parts, `<name>-<part>`, so that an interruption loses at most one part. Its name (`set_name`) is
one of

    validation                          for the accuracy shown as progress
    test-<designs>                      for comparing samplings
    static-<designs>[-seed<seed>]       a static Latin hypercube
    around-<designs>                    designs around those of a test set
    look-<iteration>-<designs>          fresh simulations of a look of the stop rule
    verification-<iteration>-<designs>  fresh simulations that a user requested; the same designs as a look's
    surface-<iteration>-<designs>       the same where the simulator does not repeat; random designs
    fresh-<number of outcome>-<iteration>-<designs>  fresh simulations that estimate a probability; the number is 1 if
                                        they answer for all outcomes
    asked-<digest>-<number of outcome>-<iteration>-<designs>  the same under a question
    check-<digest>-<number of outcome>-<iteration>-<designs>  the mode check beside them

Run folders of earlier versions may have sets `probability-…` and `question-…`, whose designs were drawn with repeats.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from activefail.errors import SimulationError
from activefail.execution.executor import Executor, run_keeping
from activefail.record.asked import bits_of
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign

_PART = 500
"""Designs in one part of a set."""

VALIDATION = "validation"


def set_name(kind: str, *parts: object) -> str:
    """The name of a set: its kind, then what the list above says."""
    return "-".join(map(str, (kind, *parts)))


def kind_of_estimate(question: str) -> str:
    """The kind of fresh simulations that estimate a probability, by the digest of the question; "" for the own one."""
    return f"asked-{question[:16]}" if question else "fresh"


def sizes_of_test_sets(store: Store) -> list[int]:
    """Sizes of the test sets with at least one stored part, the largest first."""
    return _numbers(store, r"test-(\d+)")


def estimate_sizes(store: Store, severity: int, iteration: int, question: str = "") -> list[int]:
    """Sizes of the sets that estimate a probability at an iteration, the largest first.

    A stranger's name may have any number: all these designs would be drawn to find those that are stored.
    """
    name = f"{kind_of_estimate(question)}-{severity}-{iteration}"
    parts = Counter(one.rpartition("-")[0] for one in store.set_names())
    return [size for size in _numbers(store, rf"{name}-(\d+)") if size <= _PART * parts[f"{name}-{size}"]]


def looks_before(store: Store, iteration: int) -> int:
    """Number of the stop rule's looks before an iteration."""
    return sum(earlier < iteration for earlier in _numbers(store, r"look-(\d+)-\d+"))


def _numbers(store: Store, pattern: str) -> list[int]:
    """The numbers that the pattern's group matches in the names of stored sets, the largest first."""
    matches = (re.fullmatch(rf"{pattern}-0", name) for name in store.set_names())
    return sorted((int(match[1]) for match in matches if match), reverse=True)


def stored_results(store: Store, name: str, X: Array) -> Results | None:
    """Stored results of the designs of a set, (n, d); None unless all of them are stored."""
    parts = [_same(store.read_set(f"{name}-{part}"), rows) for part, rows in enumerate(_parts(X))]
    results = [part for part in parts if part is not None]
    return Results.concatenate(results) if len(results) == len(parts) else None


def stored_set(store: Store, name: str) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs and outcomes of the stored parts of a set, without numerical failures; None if there are none."""
    parts: list[tuple[Array, Results]] = []
    while (part := store.read_set(f"{name}-{len(parts)}")) is not None:
        parts.append(part)
    if not parts:
        return None
    X, outcome = _answered(
        np.concatenate([X for X, _ in parts]), Results.concatenate([results for _, results in parts])
    )
    return (X, outcome) if len(X) else None


def simulated_results(
    campaign: "Campaign",
    store: Store,
    executor: Executor,
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
    twin: str = "",
    announce: Callable[[int], None] = lambda _: None,
) -> Results | None:
    """Results of the designs of a set, (n, d); None if stopped.

    Stored parts are read; the others are simulated and stored. What has an outcome when an exception ends a part, such
    as Ctrl-C, is stored as `begun-<name>-<part>`, from which the part continues.

    Args:
        campaign: the campaign of the set.
        store: holds the set.
        executor: runs the simulations.
        name: of the set.
        X: its designs.
        stop: whether to stop before the next part.
        twin: name of a set that may hold the same designs; its parts are copied instead of simulated.
        announce: called before the first simulation with the number of designs that will be simulated.

    Raises:
        SimulationError: if every simulation of a part fails, which is a fault of the simulator. That part is not
            stored, so that it is simulated again once the simulator is fixed.
    """
    found: list[Results | None] = []
    for part, rows in enumerate(_parts(X)):
        results = _same(store.read_set(f"{name}-{part}"), rows)
        if results is None and twin and (results := _same(store.read_set(f"{twin}-{part}"), rows)) is not None:
            store.write_set(f"{name}-{part}", rows, results)
        found.append(results)
    missing = [(f"{name}-{part}", rows) for part, rows in enumerate(_parts(X)) if found[part] is None]
    if missing and not stop():
        announce(sum(int((_begun(store, key, rows)[1] < 0).sum()) for key, rows in missing))
    for key, rows in missing:
        if stop():
            return None
        results = _simulated(campaign, store, executor, key, rows)
        if (results.outcome == NUMERICAL_FAILURE).all():
            raise SimulationError(
                f"None of the {len(rows)} simulations for {name} gave an outcome. Their results were discarded."
                + first_fault_text(results.faults.values())
            )
        store.write_set(key, rows, results)
        found[found.index(None)] = results
    return Results.concatenate([results for results in found if results is not None])


def _begun(store: Store, key: str, X: Array) -> tuple[Results | None, NDArray[np.intp]]:
    """What an interruption left of a part, and the place of each design's result there, (n,); -1 if it has none."""
    if (kept := store.read_set(f"begun-{key}")) is None:
        return None, np.full(len(X), -1)
    places: dict[bytes, list[int]] = {}
    for place, design in enumerate(bits_of(kept[0])):
        places.setdefault(design, []).append(place)
    # Equal designs may differ in their results.
    return kept[1], np.array([places[design].pop() if places.get(design) else -1 for design in bits_of(X)])


def _simulated(campaign: "Campaign", store: Store, executor: Executor, key: str, X: Array) -> Results:
    """Results of the designs of a part, (n, d), of which an interruption may have left some."""
    kept, place = _begun(store, key, X)
    left = place < 0

    def keep(designs: Array, results: Results) -> None:
        if kept is not None:
            designs, results = np.concatenate([X[~left], designs]), Results.concatenate([kept[place[~left]], results])
        store.write_set(f"begun-{key}", designs, results)

    fresh = run_keeping(executor, campaign.simulator, X[left], keep)
    if kept is None:
        return fresh
    return Results.concatenate([kept, fresh])[np.where(left, len(kept) + np.cumsum(left) - 1, place)]


def simulated_set(
    campaign: "Campaign",
    store: Store,
    executor: Executor,
    name: str,
    X: Array,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[Array, NDArray[np.int8]] | None:
    """Designs and outcomes of a set, without numerical failures; None if stopped (see `simulated_results`)."""
    results = simulated_results(campaign, store, executor, name, X, stop)
    return None if results is None else _answered(X, results)


def first_fault_text(faults: Iterable[str]) -> str:
    """A sentence for the end of a message that quotes the first fault; empty if there is none."""
    return next((f" Why the first simulation failed: {fault}" for fault in faults), "")


def _parts(X: Array) -> list[Array]:
    return [X[first : first + _PART] for first in range(0, len(X), _PART)]


def _same(saved: tuple[Array, Results] | None, X: Array) -> Results | None:
    """The results of a saved part if it holds exactly these designs, otherwise None."""
    return saved[1] if saved is not None and np.array_equal(saved[0], X) else None


def _answered(X: Array, results: Results) -> tuple[Array, NDArray[np.int8]]:
    answered = results.outcome != NUMERICAL_FAILURE
    return X[answered], results.outcome[answered]
