"""The file `asked.h5`: the designs that `ask` handed out, with a flag for those that were dropped.

It lists every such design with its id. A design's result is in the batches, like
that of any other simulation; so a design is in flight until a batch holds it, or until it was dropped.
"""

import hashlib
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import DamagedError
from activefail.record.batch import ACTIVE, CHECK, GIVEN, INITIAL
from activefail.record.hdf5 import encode, open_image
from activefail.record.segment import SCHEMA_VERSION, check_version
from activefail.space import Array

_COLUMNS = {"id": "<i8", "designs": "<f8", "origin": "i1", "learned": "<i8", "dropped": "i1"}

LARGEST_ASKED = 1_000_000_000
"""Most bytes of the file: more than a campaign of a million designs needs."""

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
        return type(self)(
            *(np.concatenate([getattr(self, field.name), getattr(later, field.name)]) for field in fields(self))
        )

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

    def digest_of(self, count: int) -> str:
        """The number of the first designs, and a digest of them; a list never loses designs, it only grows."""
        return f"{count} {hashlib.sha256(self.designs[:count].astype('<f8').tobytes()).hexdigest()[:16]}"

    @property
    def dropped_designs(self) -> Array:
        """The designs that were dropped, (j, d)."""
        return np.asarray(self.designs[self.dropped == 1])

    def copy(self) -> Self:
        """A list that shares no array with this one."""
        return type(self)(*(getattr(self, field.name).copy() for field in fields(self)))


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


def encode_asked(asked: Asked, campaign: str, corrected: str = "") -> bytes:
    """The bytes of the file.

    Args:
        asked: the designs.
        campaign: the digest at the start of the campaign's chain.
        corrected: the entry of the corrections that the record has (`Corrections.entry`); empty without any.
    """
    content: dict[str, NDArray[Any] | str] = {
        "id": asked.id,
        "designs": asked.designs,
        "origin": asked.origin,
        "learned": asked.learned,
        "dropped": asked.dropped,
    }
    attributes = {"schema_version": str(SCHEMA_VERSION), "campaign": campaign}
    return encode(content, attributes | ({"corrected": corrected} if corrected else {}))


def decode_asked(data: bytes, campaign: str, dimension: int) -> tuple[Asked, str]:
    """The designs in a file of this campaign, and the entry of the corrections that the record had then.

    Older files have no such entry; it is empty for them.

    Args:
        data: the file.
        campaign: the digest at the start of its chain.
        dimension: number of variables.

    Raises:
        DamagedError: if the file is damaged or belongs to another campaign.
        StoreError: if another version wrote it.
    """
    with open_image(data) as image:
        check_version(image)
        if image.attribute("campaign") != campaign:
            raise DamagedError("belongs to another campaign")
        _, shape = image.declared("id")
        k = shape[0]
        columns = {
            name: image.array(name, dtype, (k, dimension) if name == "designs" else (k,))
            for name, dtype in _COLUMNS.items()
        }
        asked = Asked(**columns)
        if not asked.is_valid:
            raise DamagedError("lists designs, ids or flags that `ask` never writes")
        return asked, image.attributes("corrected").get("", "")
