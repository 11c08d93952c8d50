"""The checkpoint: the simulations as columns for any HDF5 tool, and the last two states of the classifier.

It is an HDF5 file whose user block is the line of an entry (`activefail.record.events`). The line says where the arrays
of the states lie, so that a checkpoint is read, and every bit of it checked, without the HDF5 library: that runs on
activefail's own data only, and in memory, because it crashes on a full disk and believes a flipped bit.
"""

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.errors import DamagedError
from activefail.record.batch import COLUMNS, Batch, Schema, columns_of
from activefail.record.events import head, packed, unpack

States = Mapping[int, "State"]
"""Saved states by their iteration."""


LARGEST_CHECKPOINT = 16_000_000_000
"""Most bytes of a checkpoint."""


class State(NamedTuple):
    """What was learned from a record.

    Attributes:
        record: digest of what it was learned from.
        arrays: float64 or int64, by name.
    """

    record: str
    arrays: Mapping[str, NDArray[Any]]


def load_hdf5() -> None:
    """Load the HDF5 library, which takes a while: before a campaign, not between its results."""
    import h5py  # noqa: F401


def encode(states: States, schema: Schema, batches: Sequence[Batch]) -> bytes:
    """The bytes of a checkpoint.

    Args:
        states: to keep.
        schema: of the record.
        batches: of the record; without any, the file has no columns.
    """
    import h5py

    arrays = {f"{iteration}/{name}": array for iteration, one in states.items() for name, array in one.arrays.items()}
    attributes = {"states": {str(iteration): one.record for iteration, one in states.items()}}
    types, body = packed(arrays)
    with h5py.File(
        # HDF5 distinguishes files in memory by name; nothing is written to it.
        secrets.token_hex(8),
        "w",
        driver="core",
        backing_store=False,
        libver=("v110", "v110"),
    ) as file:
        for name, array in _columns(schema, batches).items():
            file.create_dataset(name, data=array, track_times=False)
        if batches:
            file.attrs.update({name: list(value) for name, value in asdict(schema).items() if value})
        if body:
            dataset = file.create_dataset("states", data=np.frombuffer(b"".join(body), np.uint8), track_times=False)
            first = dataset.id.get_offset()
            types = [(*one, first + place) for *one, place in types]
        file.flush()
        image: bytes = file.id.get_file_image()
    # A user block has a power of two of bytes, at least 512; the number of bytes after it has at most 15 digits.
    shortest, *_ = head("checkpoint", attributes, types, [], "")
    length = 512
    while length < len(shortest) + 15:
        length *= 2
    line, *_ = head("checkpoint", attributes, types, [image], "", length)
    return line + image


def _columns(schema: Schema, batches: Sequence[Batch]) -> dict[str, NDArray[Any]]:
    if not batches:
        return {}
    columns = [columns_of(batch) for batch in batches]
    iteration = np.repeat([batch.iteration for batch in batches], [len(batch) for batch in batches])
    return {"iteration": iteration} | {name: np.concatenate([one[name] for one in columns]) for name in COLUMNS}


def decode(data: bytes) -> States:
    """The states in a checkpoint.

    Raises:
        DamagedError: if it is damaged.
    """
    event = unpack(data, 0, "").event
    states: dict[int, State] = {}
    try:
        for iteration, record in event.attributes["states"].items():
            prefix = f"{iteration}/"
            arrays = {name.removeprefix(prefix): a for name, a in event.arrays.items() if name.startswith(prefix)}
            states[int(iteration)] = State(str(record), arrays)
    except (AttributeError, LookupError, TypeError, ValueError):
        raise DamagedError("has content that activefail never writes") from None
    return states
