"""Labels of simulations: texts in the user's own columns of a table of results, such as the specimen."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from activefail.record.store import Store

_BLOCK = 100
"""Simulations whose labels are one entry of the record."""

_LONGEST = 1000
"""Most characters of a label."""


def keep_labels(store: Store, ids: Sequence[int], labels: Sequence[Mapping[str, str]]) -> None:
    """Record labels by name of n simulations; a later one replaces an earlier one of its name."""
    blocks: dict[int, dict[str, dict[str, str]]] = {}
    for number, named in zip(ids, labels, strict=True):
        if named:
            cut = {name: text[:_LONGEST] for name, text in named.items()}
            blocks.setdefault(number // _BLOCK, {})[str(number)] = cut
    for block, new in blocks.items():
        known = _block(store, block)
        joined = known | {number: known.get(number, {}) | named for number, named in new.items()}
        if joined != known:
            store.remember(("labels", str(block)), joined)


def labels_of(store: Store, ids: NDArray[np.int64]) -> dict[str, list[str]]:
    """The labels of n simulations by name, empty where a simulation has none."""
    blocks = {block: _block(store, block) for block in np.unique(ids // _BLOCK).tolist()}
    rows = [blocks[number // _BLOCK].get(str(number), {}) for number in ids.tolist()]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name, "") for row in rows] for name in names}


def _block(store: Store, block: int) -> dict[str, dict[str, str]]:
    """The labels of a block of simulations, by id and name; what is none, in a stranger's record, is left out."""
    known = store.recall(("labels", str(block)))
    named = known.items() if isinstance(known, dict) else ()
    return {number: {name: str(text) for name, text in row.items()} for number, row in named if isinstance(row, dict)}
