"""The store seam: what keeps a campaign's record, and what it promises."""

import re
from collections.abc import Mapping
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.record.batch import Batch, Schema
from activefail.simulators.interface import Results
from activefail.space import Array

STATES_KEPT = 3
"""How many states of what was learned a store keeps."""


class Store(Protocol):
    """Where a campaign is recorded; a context manager that closes itself.

    The arrays of `batches` are read-only and the store's own; those of states and sets are the caller's.
    """

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in order."""
        ...

    def commit(self, batch: Batch) -> None:
        """Append a batch; it is durable when this returns.

        Raises:
            InputError: if the batch is not of the store's schema.
            StoreError: if it cannot be kept; no reader ever sees a part of it.
        """
        ...

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named float64 or int64 arrays, learned from the batches so far; the last three states stay.

        States of later iterations are dropped: they belong to a course that this campaign did not take.

        Raises:
            InputError: if an array has another type or a name is empty.
            StoreError: if they cannot be written.
        """
        ...

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state that can be read and was learned from batches of this record, with its iteration."""
        ...

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip the state of an iteration from now on, until it is written anew; `reason` completes "<file> ..."."""
        ...

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep designs X, shape (n, d), and their results beside the campaign, in the place of an older set.

        Raises:
            InputError: if the name is not made of letters, digits, `_` and `-`, or the set is not of the schema.
            StoreError: if it cannot be written.
        """
        ...

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None if there is none that is whole."""
        ...

    def set_names(self) -> list[str]:
        """Names of the sets, sorted; whether they are whole is for `read_set` to say."""
        ...

    def close(self) -> None:
        """Write nothing more and let another writer in; what was read stays."""
        ...

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


def checked_state(iteration: int, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Copies of the arrays of a state."""
    if iteration < 0 or not all(arrays):
        raise InputError(f"A state needs `iteration >= 0` and names, got {iteration} and {list(arrays)}.")
    state = {name: np.array(array) for name, array in arrays.items()}
    for name, array in state.items():
        if array.dtype not in (np.float64, np.int64):
            raise InputError(f"A state holds float64 and int64 arrays, got {array.dtype} for {name!r}.")
    return state


def check_set(name: str, X: Array, results: Results, schema: Schema) -> None:
    """Raise InputError if a set's name or shapes break a rule."""
    if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise InputError(f"The name of a set must be made of letters, digits, `_` and `-`, got {name!r}.")
    if X.ndim != 2 or len(X) != len(results):
        raise InputError(f"A set needs (n, d) designs and n results, got shape {X.shape} and {len(results)}.")
    schema.check(X, results)
