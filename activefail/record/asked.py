"""The designs that were handed out: by `ask` to be simulated elsewhere, and by the loop before it simulates them.

A design's result is in the batches, under the same id; so a design is in flight until a batch holds its id, or until it
was dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.record.batch import ACTIVE, CHECK, INITIAL, LARGEST_ID
from activefail.space.space import Array

NEVER = -1
"""In place of the iteration that a proposal learned from, for a design of the initial design."""


@dataclass(frozen=True, eq=False)
class Asked:
    """The k designs that were handed out, in the order of asking.

    Attributes:
        id: (k,) int64, increasing; the number of designs that entered the campaign before.
        designs: (k, d) float64, in the variables' units.
        origin: (k,) int8, INITIAL, ACTIVE or CHECK.
        learned: (k,) int64, the iteration that the proposal had learned from; NEVER in the initial design.
        loop: (k,) int8, 1 for a design that the loop simulates, 0 for one that is simulated elsewhere.
        dropped: (k,) int8, 1 for a dropped design.

    Raises:
        ValueError: if the shapes disagree.
    """

    id: NDArray[np.int64]
    designs: Array
    origin: NDArray[np.int8]
    learned: NDArray[np.int64]
    loop: NDArray[np.int8]
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
    def of(cls, ids: NDArray[np.int64], designs: Array, origin: int, learned: int, loop: bool = False) -> Self:
        """Designs, (k, d), of one origin, proposed after one iteration."""
        k = len(ids)
        return cls(
            ids,
            designs,
            np.full(k, origin, dtype=np.int8),
            np.full(k, learned, dtype=np.int64),
            np.full(k, loop, dtype=np.int8),
            np.zeros(k, dtype=np.int8),
        )

    def __len__(self) -> int:
        return len(self.id)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The designs of several lists, in order."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def without(self, ids: NDArray[np.int64]) -> Self:
        """The same list with the designs of these ids dropped."""
        return replace(self, dropped=np.where(np.isin(self.id, ids), np.int8(1), self.dropped).astype(np.int8))

    def in_flight(self, recorded: NDArray[np.int64]) -> Self:
        """The designs that have not been dropped and whose ids are not among the recorded ones, (n,)."""
        return self[~np.isin(self.id, recorded) & (self.dropped == 0)]

    @property
    def is_valid(self) -> bool:
        """Whether designs are finite, ids increase, and flags have a meaning."""
        return bool(
            np.isfinite(self.designs).all()
            and (self.id >= 0).all()
            and (self.id <= LARGEST_ID).all()
            and (np.diff(self.id) > 0).all()
            and np.isin(self.origin, (INITIAL, ACTIVE, CHECK)).all()
            and np.isin(self.loop, (0, 1)).all()
            and np.isin(self.dropped, (0, 1)).all()
            and (self.learned >= NEVER).all()
        )

    @property
    def next_iteration(self) -> int:
        """The iteration of the next results: one more than the last that a proposal learned from.

        So results that arrive in parts give the same classifiers as the same results at once.
        """
        return int(self.learned.max(initial=NEVER)) + 1

    @property
    def dropped_designs(self) -> Array:
        """The designs that were dropped, (j, d)."""
        return np.asarray(self.designs[self.dropped == 1])


def are_among(designs: Array, others: Array) -> NDArray[np.bool_]:
    """Which of the designs, (n, d), have the bits of one of the others, (m, d)."""
    known = set(bits_of(others))
    return np.array([bits in known for bits in bits_of(designs)], dtype=bool)


def bits_of(designs: Array) -> list[bytes]:
    """The bits of each of the designs, (n, d)."""
    if not designs.size:
        return [b""] * len(designs)
    rows = np.ascontiguousarray(designs)
    # Twice as fast as `tobytes` of each row.
    return [bytes(row) for row in rows.view(f"V{rows.shape[1] * rows.itemsize}").ravel().tolist()]
