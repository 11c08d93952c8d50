"""Labels of simulations: texts in the user's own columns of a table of results, such as the specimen."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.record.store import Remembered, Store

_BLOCK = 100
"""Simulations whose labels are found together."""

_PART = 100_000
"""Characters of labels after which another result of the record begins."""

Labels = Sequence[Mapping[str, str]]
"""The labels of simulations by name."""

_Known = dict[str, dict[str, str]]
"""Labels by id and name."""


def new_labels(store: Store, ids: Iterable[int], labels: Labels) -> Remembered:
    """What a store must remember so that simulations have these labels; a later one replaces an earlier of its name.

    The labels of a block of ids are in parts. A part holds what was new when it was written.
    """
    blocks: dict[int, _Known] = {}
    for number, named in zip(ids, labels, strict=False):
        if named:
            blocks.setdefault(number // _BLOCK, {}).setdefault(str(number), {}).update(named)
    new: dict[tuple[str, ...], _Known] = {}
    for block, rows in blocks.items():
        parts = _parts(store, block)
        known, place, size = _joined(parts), len(parts), 0
        for row, named in rows.items():
            before = known.get(row, {})
            for name, text in named.items():
                if before.get(name) != text:
                    place, size = (place + 1, 0) if size > _PART else (place, size + len(name) + len(text))
                    new.setdefault(_key(block, place), {}).setdefault(row, {})[name] = text
    return new


def labels_of(store: Store, ids: NDArray[np.int64]) -> dict[str, list[str]]:
    """The labels of n simulations by name, empty where a simulation has none."""
    blocks = {block: _joined(_parts(store, block)) for block in np.unique(ids // _BLOCK).tolist()}
    rows = [blocks[number // _BLOCK].get(str(number), {}) for number in ids.tolist()]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name, "") for row in rows] for name in names}


def _key(block: int, part: int) -> tuple[str, ...]:
    return ("labels", str(block)) if part == 0 else ("labels", str(block), str(part))


def _parts(store: Store, block: int) -> list[Any]:
    """The parts of the labels of a block of simulations."""
    parts: list[Any] = []
    while (part := store.recall(_key(block, len(parts)))) is not None:
        parts.append(part)
    return parts


def _joined(parts: Sequence[Any]) -> _Known:
    """The labels in parts by id and name; what is none, in a stranger's record, is left out."""
    joined: _Known = {}
    for part in parts:
        for number, row in part.items() if isinstance(part, dict) else ():
            named = row.items() if isinstance(row, dict) else ()
            joined.setdefault(number, {}).update({name: str(text) for name, text in named})
    return joined
