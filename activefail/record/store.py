"""The store interface: how a campaign's record is kept, and what a store guarantees."""

import re
from collections.abc import Mapping
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.record.asked import Asked
from activefail.record.batch import Batch, Schema
from activefail.record.corrections import Corrections
from activefail.simulators.interface import Results
from activefail.space.space import Array

Remembered = Mapping[tuple[str, ...], Any]
"""Computed results: values of JSON by what they are of."""

NOTHING: Remembered = {}


class Store(Protocol):
    """The record of a campaign: batches, states of what was learned, and sets of designs outside the budget.

    **Durability.** What a method writes is durable once it returns. Durable data survives the process and, if the disk
    honours fsync, the loss of power. `MemoryStore` keeps its data as long as the object lives.

    **Readers.** Whatever was written is visible as a whole or not at all. A reader of a folder in which another process
    writes has what was written when the reader was opened, and nothing later. States alone are read on demand; a state
    that was learned from a batch unknown to the reader is skipped.

    **Writers.** At most one store writes to a record. A second one is refused when it is opened or, on a file system
    without locks, when it writes.

    **Threads and processes.** Any thread may call a store, but only one at a time. A store is not pickled and not used
    after a fork.

    **Arrays.** A store copies its arguments before it returns; the caller keeps its arrays. The arrays of `batches`
    belong to the store and are read-only. The caller owns the arrays that `latest_state` and `read_set` return. All
    arrays keep their bits, including NaN payloads and signed zeros. The faults of results are not kept.

    **Exceptions.** After InputError nothing has changed, and the store stays usable. After StoreError the record holds
    all acknowledged data and nothing else, and the call can be repeated, with one exception: if fsync failed
    (SyncError) or a write was interrupted, the store refuses every later write with StoreError; opened again, the
    record holds all acknowledged batches and perhaps the last one.

    **Closing.** A store is a context manager that closes itself and propagates exceptions. A closed store refuses
    writes with StoreError and can still be read.
    """

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in the order of their commits, with the corrections of their results.

        A later commit or correction does not change the returned tuple.
        """
        ...

    def commit(self, batch: Batch, also: Remembered = NOTHING) -> None:
        """Append a batch, and computed results in the same write; they are durable when this returns.

        Args:
            batch: the batch.
            also: results to `remember`, by identity.

        Raises:
            InputError: if the batch does not match the store's schema, or has neither the iteration of the last batch
                nor the next one.
            StoreError: if it cannot be written, or the store may not write; no reader ever sees a part of it.
        """
        ...

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays, learned from the batches so far; durable when this returns.

        A state that includes fewer batches of its iteration than the record is skipped.
        A state of the same iteration is replaced. States of later iterations are dropped: they belong to
        discarded batches. The newest two states are kept. A lost state costs only time, as it can be learned
        again.

        Args:
            iteration: last iteration that the state includes; at least 0.
            arrays: float64 or int64 arrays of any shape, under non-empty names.

        Raises:
            InputError: if an array has another type, a name is empty or the iteration is negative.
            StoreError: if they cannot be written, or the store may not write; the older states stay.
        """
        ...

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state and its iteration, among intact, not rejected states learned from these batches.

        A state is skipped if its iteration has got another batch since.
        """
        ...

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip the state of an iteration in this object until it is written again.

        A store that may not write allows this too, since the record does not change.

        Args:
            iteration: iteration of the state, which need not exist.
            reason: completes "<file> ..." in a warning.
        """
        ...

    @property
    def asked(self) -> Asked:
        """The designs that were handed out so far."""
        ...

    def hand_out(self, designs: Asked) -> None:
        """Keep designs that are handed out; they are durable when this returns.

        Raises:
            InputError: if they have another number of variables, or ids that are not larger than all before; or if they
                were learned from an iteration without a batch.
            StoreError: if they cannot be written, or the store may not write.
        """
        ...

    def drop(self, ids: NDArray[np.int64]) -> None:
        """Give up designs that were handed out; durable when this returns.

        Raises:
            StoreError: if it cannot be written, or the store may not write.
        """
        ...

    @property
    def corrections(self) -> Corrections:
        """The corrections of the batches, in the order in which they were made."""
        ...

    def correct(self, place: NDArray[np.int64], results: Results, also: Remembered = NOTHING) -> None:
        """Replace results of committed batches; durable, all or none of them, when this returns.

        `batches` has the new results from then on; `corrections` keeps the former ones. States that were learned from
        a former result are skipped.

        Args:
            place: (k,) of the simulations in the record, from 0; k ≥ 1.
            results: the k new results.
            also: as for `commit`.

        Raises:
            InputError: if there is none, a place is not one of the record or occurs twice, or a result does not match
                the schema.
            StoreError: if they cannot be written, or the store may not write; the former results stay.
        """
        ...

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep designs X, shape (n, d), and their results outside the budget; replaces a set of the same name.

        Raises:
            InputError: if the name is not made of letters, digits, `_` and `-`, or the set does not match the schema.
            StoreError: if it cannot be written, or the store may not write; the older set stays.
        """
        ...

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None if there is none.

        Also None if other code than the current code simulated the set; a warning then reports this.
        """
        ...

    def set_names(self) -> list[str]:
        """Names of the sets, sorted."""
        ...

    @property
    def digest(self) -> str:
        """A digest of all batches and corrections."""
        ...

    def remember(self, identity: tuple[str, ...], value: Any) -> None:
        """Keep a result that was computed from the record; replaces one of the same identity.

        Args:
            identity: what it is of: all that it depends on.
            value: of JSON; tuples become lists.

        Raises:
            TypeError, ValueError: if it is not a value of JSON, is nested too deep or has a whole number of more than
                64 bits.
            StoreError: if it cannot be written, or the store may not write; the older result stays.
        """
        ...

    def recall(self, identity: tuple[str, ...]) -> Any:
        """The computed result of this identity; None if there is none."""
        ...

    def close(self) -> None:
        """Refuse further writes and allow another writer. A second call does nothing."""
        ...

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


def checked_state(iteration: int, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Copies of a state's arrays."""
    if iteration < 0 or not all(arrays):
        raise InputError(
            f"A state must have `iteration >= 0` and a name for each array, got {iteration} and {list(arrays)}."
        )
    state = {name: np.array(array) for name, array in arrays.items()}
    for name, array in state.items():
        if array.dtype not in (np.float64, np.int64):
            raise InputError(f"A state must hold float64 or int64 arrays, got {array.dtype} for {name!r}.")
    return state


def check_asked(asked: Asked, schema: Schema, iteration: int) -> None:
    """Raise InputError if designs that were handed out, in a record up to an iteration, break a rule."""
    if not asked.is_valid:
        raise InputError("Designs that were handed out need finite values, increasing ids and known origins.")
    if asked.designs.shape[1] != len(schema.variables):
        raise InputError(
            f"`designs` must have {len(schema.variables)} columns {schema.variables}, got {asked.designs.shape[1]}."
        )
    if asked.next_iteration > iteration + 1:
        raise InputError(f"`learned <= {iteration}` must hold, got {asked.next_iteration - 1}.")


def check_set(name: str, X: Array, results: Results, schema: Schema) -> None:
    """Raise InputError if a set's name or shapes break a rule."""
    if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise InputError(f"The name of a set must be made of letters, digits, `_` and `-`, got {name!r}.")
    if X.ndim != 2 or len(X) != len(results):
        raise InputError(f"A set needs (n, d) designs and n results, got shape {X.shape} and {len(results)}.")
    schema.check(X, results)
