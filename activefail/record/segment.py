"""Segments: immutable files of whole batches, in a chain of digests that starts with settings and schema."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail import __version__
from activefail.errors import DamagedError, StoreError
from activefail.record.batch import COLUMNS, Batch, Schema, batch_of, columns_of, results_of
from activefail.record.hdf5 import Image, encode, open_image
from activefail.visible import visible

ASKED_ENTRY = "asked"
"""The entry of a batch's provenance that says which designs had been handed out."""

CORRECTED_ENTRY = "corrected"
"""The entry of a batch's provenance that says which results had been corrected."""


def continues(known: str, entry: Callable[[int], str]) -> bool:
    """Whether a list still begins as it was noted.

    Args:
        known: the list's entry when it was noted: its length, a space and a digest; empty if there was no list.
        entry: the entry for the first so many rows of the list.
    """
    count = known.partition(" ")[0]
    return not known or bool(re.fullmatch("[0-9]{1,9}", count) and entry(int(count)) == known)


SCHEMA_VERSION = 1
"""Version of the meaning of the files' datasets and attributes."""


def chain_start(settings: str, schema: Schema) -> str:
    """The digest at the start of a campaign's chain (SHA-256 of the settings' SHA-256 and the schema)."""
    return hashlib.sha256(sha256(settings).encode() + schema.text.encode()).hexdigest()


def chain_next(before: str, batch: Batch) -> str:
    """The digest after a batch: SHA-256 of the previous digest and every bit of the batch."""
    columns = columns_of(batch)
    digest = hashlib.sha256(bytes.fromhex(before))
    digest.update(f"{batch.iteration} {batch.designs.shape} {batch.results.margins.shape}\n".encode())
    for name, dtype in COLUMNS.items():
        digest.update(columns[name].astype(dtype, copy=False).tobytes())
    return digest.hexdigest()


def sha256(text: str) -> str:
    """SHA-256 of a text, in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class Segment:
    """One file of the record: whole batches, numbered by their designs' ids, and their place in the chain."""

    settings: str
    schema: Schema
    first: int
    before: str
    batches: tuple[Batch, ...]
    provenance: Mapping[str, str]

    @cached_property
    def chain(self) -> dict[int, str]:
        """The chain's digest before each id at which a batch begins, and after the last design."""
        end, digest = self.first, self.before
        chain = {end: digest}
        for batch in self.batches:
            end, digest = end + len(batch), chain_next(digest, batch)
            chain[end] = digest
        return chain

    @property
    def last(self) -> int:
        """Id of the last design."""
        return max(self.chain) - 1

    @property
    def after(self) -> str:
        """The chain's digest after the last design."""
        return self.chain[self.last + 1]

    @property
    def name(self) -> str:
        """Name of the file."""
        return segment_name(self.first, self.last)


def segment_name(first: int, last: int) -> str:
    """Name of the file with the designs `first` to `last`."""
    return f"{first:09d}-{last:09d}.h5"


def encode_segment(segment: Segment) -> bytes:
    """The bytes of a segment's file."""
    columns = [columns_of(batch) for batch in segment.batches]
    content: dict[str, NDArray[Any] | str] = {
        **{name: np.concatenate([part[name] for part in columns]) for name in COLUMNS},
        "iteration": np.array([batch.iteration for batch in segment.batches], dtype=np.int64),
        "size": np.array([len(batch) for batch in segment.batches], dtype=np.int64),
        "settings": segment.settings,
        "schema": segment.schema.text,
    }
    attributes = {
        "schema_version": str(SCHEMA_VERSION),
        "first": str(segment.first),
        "last": str(segment.last),
        "chain_before": segment.before,
        "chain_after": segment.after,
        "settings_sha256": sha256(segment.settings),
    }
    return encode(content, attributes | {f"provenance.{name}": text for name, text in segment.provenance.items()})


@dataclass(frozen=True, eq=False)
class Outline:
    """A segment without designs and margins, for quick reading; see Segment.

    Attributes:
        iterations, sizes: (number of batches,) int64.
        origin, outcome: (n,) int8.
        asked: which designs had been handed out (`record.asked.Asked.digest_of`); empty before the first.
        corrected: which results had been corrected (`record.corrections.Corrections.entry`); empty before the first.
    """

    settings: str
    schema: Schema
    first: int
    last: int
    before: str
    after: str
    iterations: NDArray[np.int64]
    sizes: NDArray[np.int64]
    origin: NDArray[np.int8]
    outcome: NDArray[np.int8]
    asked: str
    corrected: str

    @property
    def name(self) -> str:
        """Name of the file."""
        return segment_name(self.first, self.last)


def decode_outline(name: str, data: bytes) -> Outline:
    """The outline of the segment in a file with this name; checks every bit of the file, but not its chain.

    Raises:
        DamagedError: if the file is damaged or does not match its name.
        StoreError: if another version wrote it.
    """
    with open_image(data) as image:
        return _outline(name, image)


def decode_segment(name: str, data: bytes) -> Segment:
    """The segment in a file with this name.

    Raises:
        DamagedError: if the file is damaged or does not match its name.
        StoreError: if another version wrote it.
    """
    with open_image(data) as image:
        outline = _outline(name, image)
        known = {"origin": outline.origin, "outcome": outline.outcome}
        others = [column for column in COLUMNS if column not in known]
        columns = read_columns(image, others, len(outline.outcome), outline.schema) | known
        outline.schema.check(columns["designs"], results_of(columns))
        ends = [0, *np.cumsum(outline.sizes).tolist()]
        batches = tuple(
            batch_of(iteration, {key: column[begin:end] for key, column in columns.items()})
            for iteration, (begin, end) in zip(outline.iterations.tolist(), pairwise(ends), strict=True)
        )
        provenance = image.attributes("provenance.")
        segment = Segment(outline.settings, outline.schema, outline.first, outline.before, batches, provenance)
        if segment.after != outline.after:
            raise DamagedError(_MISNAMED)
    return segment


def _outline(name: str, image: Image) -> Outline:
    check_version(image)
    settings, schema = image.text("settings"), Schema.from_text(image.text("schema"))
    first, last = int(image.attribute("first")), int(image.attribute("last"))
    n = last - first + 1
    for column, dtype in COLUMNS.items():
        image.check(column, dtype, _shape(column, n, schema))
    origin, outcome = read_columns(image, ["origin", "outcome"], n, schema).values()
    schema.check_codes("outcome", outcome)
    _, sizes_shape = image.declared("size")
    sizes, iterations = (image.array(key, "<i8", sizes_shape) for key in ("size", "iteration"))
    if sizes.ndim != 1 or sizes.min() < 1 or sum(sizes.tolist()) != n:
        raise DamagedError(f"holds {n} designs in batches of {sizes.tolist()}")
    if (name, image.attribute("settings_sha256")) != (segment_name(first, last), sha256(settings)):
        raise DamagedError(_MISNAMED)
    before, after = image.attribute("chain_before"), image.attribute("chain_after")
    provenance = image.attributes("provenance.")
    asked, corrected = (provenance.get(entry, "") for entry in (ASKED_ENTRY, CORRECTED_ENTRY))
    return Outline(settings, schema, first, last, before, after, iterations, sizes, origin, outcome, asked, corrected)


_MISNAMED = "does not match its name, its chain or its settings' SHA-256"


def read_columns(image: Image, names: Sequence[str], n: int, schema: Schema) -> dict[str, NDArray[Any]]:
    """The named columns of n designs; their declared types and shapes are checked before reading."""
    return {name: image.array(name, COLUMNS[name], _shape(name, n, schema)) for name in names}


def _shape(column: str, n: int, schema: Schema) -> tuple[int, ...]:
    match column:
        case "designs":
            return n, len(schema.variables)
        case "margins":
            return n, len(schema.margins)
        case _:
            return (n,)


def check_version(image: Image) -> None:
    """Raise StoreError if a file has another schema version."""
    written = image.attribute("schema_version")
    if written != str(SCHEMA_VERSION):
        program = visible(image.attributes("provenance.").get("activefail", "of an unknown version"))
        raise StoreError(
            f"was written in schema version {visible(written)} by activefail {program}; "
            f"this program (activefail {__version__}) reads schema version {SCHEMA_VERSION}."
        )
