"""The terms of a campaign's record: batches of designs and answers, what their columns mean, and what a store does.

`MemoryStore` keeps a record in memory; `activefail.record.run_folder.FolderStore` keeps it in a run folder.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError, StoreError
from activefail.simulators.interface import EXECUTION_CAUSES, NUMERICAL_FAILURE, Results
from activefail.space import Array

SEED = 0
"""Origin of a design that stood before any learning."""

ACTIVE = 1
"""Origin of a design that the learner chose."""

STATES_KEPT = 3
"""How many states of what was learned a store keeps."""

# Little-endian, whatever the machine: the digests are over these bytes.
COLUMNS = {"designs": "<f8", "origin": "i1", "outcome": "i1", "cause": "i1", "margins": "<f8", "seconds": "<f8"}


@dataclass(frozen=True, eq=False)
class Batch:
    """Designs that were simulated together, and the answers.

    Attributes:
        iteration: of the loop; 0 is the seed design.
        designs: (n, d) float64, in the variables' units; at least one row.
        origin: (n,) int8, SEED or ACTIVE.
        results: of the n designs.

    Raises:
        ValueError: if the shapes do not agree, there is no design or the iteration is negative.
    """

    iteration: int
    designs: Array
    origin: NDArray[np.int8]
    results: Results

    def __post_init__(self) -> None:
        n = len(self.results)
        if self.designs.ndim != 2 or len(self.designs) != n or self.origin.shape != (n,):
            shapes = (self.designs.shape, self.origin.shape, (n,))
            raise ValueError(f"A batch needs (n, d) designs, (n,) origins and n results, got shapes {shapes}.")
        if n == 0 or self.iteration < 0:
            raise ValueError(f"`designs > 0` and `iteration >= 0` must hold, got {n} and {self.iteration}.")

    def __len__(self) -> int:
        return len(self.origin)


@dataclass(frozen=True)
class Schema:
    """What the columns and codes of a record mean.

    Attributes:
        variables: names of the columns of the designs.
        outcomes: names of the outcomes 0, 1, ...; NUMERICAL_FAILURE stands beside them.
        causes: names of the causes 0, 1, ...; EXECUTION_CAUSES stand beside them.
        margins: names of the columns of the margins.

    Raises:
        ValueError: if one of them is not a tuple of texts.
    """

    variables: tuple[str, ...]
    outcomes: tuple[str, ...]
    causes: tuple[str, ...]
    margins: tuple[str, ...]

    def __post_init__(self) -> None:
        for field in fields(self):
            names = getattr(self, field.name)
            if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
                raise ValueError(f"`{field.name}` must be a tuple of texts, got {names!r}.")

    @classmethod
    def from_text(cls, text: str) -> Self:
        """The schema that `text` gave."""
        return cls(**{name: tuple(names) for name, names in json.loads(text).items()})

    @property
    def text(self) -> str:
        """The schema as JSON, always the same for the same names."""
        return json.dumps(asdict(self), ensure_ascii=True, separators=(",", ":"))

    def check(self, designs: Array, results: Results) -> None:
        """Check that designs and results are of this schema, bit for bit what a file can hold.

        Raises:
            InputError: if a type, a number of columns or a code is not.
        """
        columns = {"designs": designs, **answers_of(results)}
        for name, array in columns.items():
            if array.dtype != np.dtype(COLUMNS[name]):
                raise InputError(f"`{name}` must be {np.dtype(COLUMNS[name]).name}, got {array.dtype}.")
        for name, names in (("designs", self.variables), ("margins", self.margins)):
            if columns[name].shape[1] != len(names):
                raise InputError(f"`{name}` must have {len(names)} columns {names}, got {columns[name].shape[1]}.")
        if not np.isfinite(designs).all():
            row, column = np.argwhere(~np.isfinite(designs))[0].tolist()
            raise InputError(
                f"`designs` must be finite, got {designs[row, column]} for {self.variables[column]!r} in row {row}."
            )
        self.check_codes("outcome", results.outcome)
        self.check_codes("cause", results.cause)

    def check_codes(self, column: str, codes: NDArray[np.int8]) -> None:
        """Check that all codes of the column "outcome" or "cause" have a name.

        Raises:
            InputError: if one has not.
        """
        names, low = {"outcome": (self.outcomes, NUMERICAL_FAILURE), "cause": (self.causes, min(EXECUTION_CAUSES))}[
            column
        ]
        if len(codes) and not (low <= codes.min() and codes.max() < len(names)):
            raise InputError(f"`{low} <= {column} < {len(names)}` must hold, got {codes.min()} to {codes.max()}.")


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


class MemoryStore:
    """A record that lasts as long as this object."""

    def __init__(self, schema: Schema) -> None:
        self.schema = schema
        self._batches: tuple[Batch, ...] = ()
        self._states: dict[int, dict[str, NDArray[Any]]] = {}
        self._sets: dict[str, tuple[Array, Results]] = {}
        self._open = True

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in order."""
        return self._batches

    def commit(self, batch: Batch) -> None:
        """Append a batch (see Store)."""
        self._check_open()
        self._batches = (*self._batches, own_copy(batch, self.schema))

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays (see Store)."""
        self._check_open()
        kept = [i for i in sorted(self._states) if i < iteration][1 - STATES_KEPT :]
        self._states = {i: self._states[i] for i in kept} | {iteration: checked_state(iteration, arrays)}

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state (see Store)."""
        if not self._states:
            return None
        iteration = max(self._states)
        return iteration, {name: array.copy() for name, array in self._states[iteration].items()}

    def reject_state(self, iteration: int, reason: str) -> None:
        """Forget a state (see Store)."""
        self._states.pop(iteration, None)

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep a set (see Store)."""
        self._check_open()
        check_set(name, X, results, self.schema)
        self._sets[name] = X.copy(), copied(results)

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None (see Store)."""
        if name not in self._sets:
            return None
        X, results = self._sets[name]
        return X.copy(), copied(results)

    def set_names(self) -> list[str]:
        """Names of the sets (see Store)."""
        return sorted(self._sets)

    def close(self) -> None:
        """Refuse further writing."""
        self._open = False

    def _check_open(self) -> None:
        if not self._open:
            raise StoreError("This store is closed.")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def answers_of(results: Results) -> dict[str, NDArray[Any]]:
    """The columns of results by name."""
    return {
        "outcome": results.outcome,
        "cause": results.cause,
        "margins": results.margins,
        "seconds": results.seconds,
    }


def results_of(columns: Mapping[str, NDArray[Any]]) -> Results:
    """The results among the columns of a batch."""
    return Results(**{name: array for name, array in columns.items() if name not in ("designs", "origin")})


def copied(results: Results) -> Results:
    """Results that share no array with the given ones."""
    return Results(**{name: array.copy() for name, array in answers_of(results).items()})


def columns_of(batch: Batch) -> dict[str, NDArray[Any]]:
    """All columns of a batch by name."""
    return {"designs": batch.designs, "origin": batch.origin, **answers_of(batch.results)}


def batch_of(iteration: int, columns: Mapping[str, NDArray[Any]]) -> Batch:
    """The batch of these columns; its arrays are made read-only."""
    for array in columns.values():
        array.flags.writeable = False
    return Batch(iteration, columns["designs"], columns["origin"], results_of(columns))


def own_copy(batch: Batch, schema: Schema) -> Batch:
    """The store's own copy of a batch that is of the schema."""
    schema.check(batch.designs, batch.results)
    if batch.origin.dtype != np.int8:
        raise InputError(f"`origin` must be int8, got {batch.origin.dtype}.")
    return batch_of(batch.iteration, {name: array.copy() for name, array in columns_of(batch).items()})


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
