"""The designs that `ask` handed out, with a flag for those that were dropped.

A design's result is in the batches, like that of any other simulation; so a design is in flight until a batch holds it,
or until it was dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.record.batch import ACTIVE, CHECK, GIVEN, INITIAL
from activefail.space import Array

_LARGEST_ID = 2**53
"""Largest id and iteration: a float holds it too, as it must in a table."""

NO_ROW = -1
"""In place of a row of the record, for a design without a result."""

NEVER = -1
"""In place of the iteration that a proposal learned from, for a design of the initial design."""


@dataclass(frozen=True, eq=False)
class Asked:
    """The k designs that were handed out, in the order of asking.

    Attributes:
        id: (k,) int64, increasing; the number of simulations that entered the campaign before.
        designs: (k, d) float64, in the variables' units.
        origin: (k,) int8, INITIAL, ACTIVE or CHECK.
        learned: (k,) int64, the iteration that the proposal had learned from; NEVER in the initial design.
        dropped: (k,) int8, 1 for a dropped design.

    Raises:
        ValueError: if the shapes disagree.
    """

    id: NDArray[np.int64]
    designs: Array
    origin: NDArray[np.int8]
    learned: NDArray[np.int64]
    dropped: NDArray[np.int8]

    def __post_init__(self) -> None:
        k = len(self.id)
        shapes = [getattr(self, field.name).shape for field in fields(self)]
        if (
            self.designs.ndim != 2
            or any(shape[0] != k for shape in shapes)
            or any(len(shape) != 1 for shape in shapes[:1] + shapes[2:])
        ):
            raise ValueError(f"Designs that were asked for need k ids, designs and flags, got shapes {shapes}.")

    @classmethod
    def none(cls, dimension: int) -> Self:
        """No designs of d variables."""
        return cls.of(np.empty(0, dtype=np.int64), np.empty((0, dimension)), INITIAL, NEVER)

    @classmethod
    def of(cls, ids: NDArray[np.int64], designs: Array, origin: int, learned: int) -> Self:
        """Designs, (k, d), of one origin, proposed after one iteration."""
        k = len(ids)
        return cls(
            ids,
            designs,
            np.full(k, origin, dtype=np.int8),
            np.full(k, learned, dtype=np.int64),
            np.zeros(k, dtype=np.int8),
        )

    def __len__(self) -> int:
        return len(self.id)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    def and_then(self, later: Self) -> Self:
        """These designs and later ones."""
        return type(self).joined([self, later])

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The designs of several lists, in order."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def without(self, rows: NDArray[np.bool_]) -> Self:
        """The same list with the marked designs, (k,), dropped."""
        return replace(self, dropped=np.where(rows, np.int8(1), self.dropped).astype(np.int8))

    @property
    def is_valid(self) -> bool:
        """Whether designs are finite, ids increase, and flags have a meaning."""
        return bool(
            np.isfinite(self.designs).all()
            and (self.id >= 0).all()
            and (self.id <= _LARGEST_ID).all()
            and (np.diff(self.id) > 0).all()
            and np.isin(self.origin, (INITIAL, ACTIVE, CHECK)).all()
            and np.isin(self.dropped, (0, 1)).all()
            and (self.learned >= NEVER).all()
            and (self.learned <= _LARGEST_ID).all()
            and len(np.unique(self.designs, axis=0)) == len(self)
        )

    def is_kept_by(self, other: Self) -> bool:
        """Whether another list of as many designs is the same, but for further dropped ones."""
        same = (
            getattr(self, name).tobytes() == getattr(other, name).tobytes() for name in ("id", "designs", "learned")
        )
        return all(same) and bool((self.dropped <= other.dropped).all())

    @property
    def dropped_designs(self) -> Array:
        """The designs that were dropped, (j, d)."""
        return np.asarray(self.designs[self.dropped == 1])


def rows_with_results(asked: Asked, designs: Array, origin: NDArray[np.int8]) -> NDArray[np.int64]:
    """The row of a record with the result of each design that was handed out, (k,); NO_ROW without a result.

    Args:
        asked: the designs that were handed out.
        designs, origin: (n, d) and (n,) of the record.
    """
    # The bits of a design identify it: a result is recorded with the design of the list, not with a user's copy.
    places = np.flatnonzero(origin != GIVEN)[::-1].tolist()
    recorded: dict[bytes, list[int]] = {}
    for row, bits in zip(places, bits_of(designs[places]), strict=True):
        recorded.setdefault(bits, []).append(row)
    rows = []
    for bits, dropped in zip(bits_of(asked.designs), asked.dropped.tolist(), strict=True):
        candidates = recorded.get(bits)
        rows.append(candidates.pop() if candidates and not dropped else NO_ROW)
    return np.array(rows, dtype=np.int64)


def bits_of(designs: Array) -> list[bytes]:
    """The bits of each of the designs, (n, d)."""
    if not designs.size:
        return [b""] * len(designs)
    rows = np.ascontiguousarray(designs)
    # Twice as fast as `tobytes` of each row.
    return [bytes(row) for row in rows.view(f"V{rows.shape[1] * rows.itemsize}").ravel().tolist()]
