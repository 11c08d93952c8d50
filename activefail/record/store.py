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
    """Where a campaign is recorded: batches, states of what was learned, and sets of designs beside the campaign.

    **Durability.** A batch is kept from the moment `commit` returns; a state and a set from the moment `write_state`
    and `write_set` return. Kept means: it survives the process, where the store outlives it, and the loss of power,
    where the disk honours fsync. `MemoryStore` keeps everything as long as the object lives.

    **Readers.** Batches, states and sets are seen whole or not at all. A reader of a folder in which another process
    writes has the batches that were committed when it was opened: a prefix of the writer's, never more later on. States
    and sets are read when they are asked for; a state that was learned from a batch that the reader does not know is
    skipped.

    **Writers.** At most one store writes to a record. A second one is refused when it is opened or, on a file system
    without locks, when it commits.

    **Threads and processes.** One thread calls a store at a time, any thread. A store is not pickled and not used after
    a fork.

    **Arrays.** A store copies what it is given before it returns; the caller keeps its arrays. The arrays of `batches`
    are the store's and read-only. The arrays that `latest_state` and `read_set` return are the caller's own. All come
    back bit for bit, NaN payloads and signed zeros too.

    **Exceptions.** After InputError nothing has changed, and the store stays usable. After StoreError what was not
    acknowledged is not in the record, everything acknowledged is, and the call can be repeated, with one exception:
    where fsync failed (SyncError) or a write was interrupted, the store refuses every later write with StoreError;
    opened again, the record holds all acknowledged batches and perhaps the last one.

    **Closing.** A store is a context manager that closes itself and lets exceptions pass. A closed store refuses to
    write with StoreError and can still be read.
    """

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in the order of their commits; a later commit does not change a tuple given before."""
        ...

    def commit(self, batch: Batch) -> None:
        """Append a batch; it is durable when this returns.

        Raises:
            InputError: if the batch is not of the store's schema.
            StoreError: if it cannot be kept, or the store may not write; no reader ever sees a part of it.
        """
        ...

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays, learned from the batches so far; durable when this returns.

        It replaces a state of the same iteration. States of later iterations are dropped: they belong to a course that
        this campaign did not take. Of the others the newest three stay. Losing a state loses time only, as it can be
        learned again.

        Args:
            iteration: that the state includes; at least 0.
            arrays: float64 or int64, of any shape, under any names that are not empty.

        Raises:
            InputError: if an array has another type, a name is empty or the iteration is negative.
            StoreError: if they cannot be written, or the store may not write; the older states stay.
        """
        ...

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state and its iteration, of those that are whole, not rejected and learned from these batches."""
        ...

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip the state of an iteration in this object from now on, until it is written anew.

        Allowed on a store that may not write: the record does not change.

        Args:
            iteration: of the state; one that does not exist is no error.
            reason: completes "<file> ..." in a warning.
        """
        ...

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep designs X, shape (n, d), and their results beside the campaign, in the place of a set of this name.

        Raises:
            InputError: if the name is not made of letters, digits, `_` and `-`, or the set is not of the schema.
            StoreError: if it cannot be written, or the store may not write; the older set stays.
        """
        ...

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None if there is none that is whole and of this campaign."""
        ...

    def set_names(self) -> list[str]:
        """Names of the sets, sorted; `read_set` says whether one is whole."""
        ...

    def close(self) -> None:
        """Write nothing more and let another writer in. A second call does nothing."""
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
