"""The data of a campaign's record: batches of designs and results, and the schema of their columns."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.simulators.interface import EXECUTION_CAUSES, NUMERICAL_FAILURE, Results
from activefail.space.space import Array

INITIAL = 0
"""Origin of a design of the initial design."""

ACTIVE = 1
"""Origin of a design that the criterion chose."""


CHECK = 2
"""Origin of a design that looks for what the classifier may have missed before a campaign ends."""

GIVEN = 3
"""Origin of a design that the campaign did not ask for."""


LARGEST_ID = 2**53
"""Largest id: a float holds it too, as it must in a table."""

# Little-endian on every machine: the digests are computed from these bytes.
COLUMNS = {
    "id": "<i8",
    "designs": "<f8",
    "origin": "i1",
    "outcome": "i1",
    "cause": "i1",
    "margins": "<f8",
    "seconds": "<f8",
}


@dataclass(frozen=True, eq=False)
class Batch:
    """Designs that were simulated together, with their results.

    Attributes:
        iteration: iteration of the loop; 0 is the initial design.
        id: (n,) int64, of the designs: how many entered the campaign before.
        designs: (n, d) float64, in the variables' units; at least one row.
        origin: (n,) int8, INITIAL, ACTIVE, CHECK or GIVEN.
        results: results of the n designs.

    Raises:
        ValueError: if the shapes disagree, there is no design, or the iteration is negative.
    """

    iteration: int
    id: NDArray[np.int64]
    designs: Array
    origin: NDArray[np.int8]
    results: Results

    def __post_init__(self) -> None:
        n = len(self.results)
        if self.designs.ndim != 2 or {len(self.designs), *self.id.shape, *self.origin.shape} != {n}:
            shapes = (self.id.shape, self.designs.shape, self.origin.shape, (n,))
            raise ValueError(f"A batch needs (n,) ids and origins, (n, d) designs and n results, got shapes {shapes}.")
        if n == 0 or self.iteration < 0:
            raise ValueError(f"`designs > 0` and `iteration >= 0` must hold, got {n} and {self.iteration}.")

    def __len__(self) -> int:
        return len(self.origin)


@dataclass(frozen=True)
class Schema:
    """What the columns and codes of a record mean.

    Attributes:
        variables: names of the columns of the designs.
        outcomes: names of the outcomes 0, 1, ...; NUMERICAL_FAILURE is an additional code.
        causes: names of the causes 0, 1, ...; EXECUTION_CAUSES are additional codes.
        margins: names of the columns of the margins, and of the outputs in their expressions.

    Raises:
        ValueError: if an attribute is not a tuple of strings.
    """

    variables: tuple[str, ...]
    outcomes: tuple[str, ...]
    causes: tuple[str, ...]
    margins: tuple[str, ...]

    def __post_init__(self) -> None:
        for field in fields(self):
            names = getattr(self, field.name)
            if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
                raise ValueError(f"`{field.name}` must be a tuple of strings, got {names!r}.")

    def check(self, designs: Array, results: Results) -> None:
        """Check that designs and results match this schema."""
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
        """Check that all codes of the column "outcome" or "cause" have names."""
        names, low = {"outcome": (self.outcomes, NUMERICAL_FAILURE), "cause": (self.causes, min(EXECUTION_CAUSES))}[
            column
        ]
        if len(codes) and not (low <= codes.min() and codes.max() < len(names)):
            raise InputError(f"`{low} <= {column} < {len(names)}` must hold, got {codes.min()} to {codes.max()}.")


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
    return Results(columns["outcome"], columns["cause"], columns["margins"], columns["seconds"])


def columns_of(batch: Batch) -> dict[str, NDArray[Any]]:
    """All columns of a batch by name."""
    return {"id": batch.id, "designs": batch.designs, "origin": batch.origin, **answers_of(batch.results)}


def batch_of(iteration: int, columns: Mapping[str, NDArray[Any]]) -> Batch:
    """The batch with these columns."""
    return Batch(iteration, columns["id"], columns["designs"], columns["origin"], results_of(columns))


def check_rows(batch: Batch, before: int) -> None:
    """Check the iteration of a batch, and its ids and origins.

    Args:
        batch: the batch.
        before: iteration of the batch before it; −1 if there is none.

    Raises:
        InputError: if the iteration is neither this one nor the next; if ids or origins have another type; if an id is
            negative, too large or occurs twice; or if an origin has no meaning.
    """
    if not max(before, 0) <= batch.iteration <= before + 1:
        raise InputError(f"`{max(before, 0)} <= iteration <= {before + 1}` must hold, got {batch.iteration}.")
    for name, column in (("id", batch.id), ("origin", batch.origin)):
        if column.dtype != np.dtype(COLUMNS[name]):
            raise InputError(f"`{name}` must be {np.dtype(COLUMNS[name]).name}, got {column.dtype}.")
    if (batch.id < 0).any() or (batch.id > LARGEST_ID).any() or len(np.unique(batch.id)) < len(batch):
        raise InputError(f"`id` must be different numbers from 0 to {LARGEST_ID}, got {batch.id.tolist()}.")
    if not np.isin(batch.origin, (INITIAL, ACTIVE, CHECK, GIVEN)).all():
        raise InputError(f"`{INITIAL} <= origin <= {GIVEN}` must hold, got {batch.origin.tolist()}.")
