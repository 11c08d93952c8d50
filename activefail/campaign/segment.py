"""Segments: whole batches in one immutable file each, in a chain of digests that begins with settings and schema."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.image import DamagedError, Image, encode, opened
from activefail.campaign.record import COLUMNS, Batch, Schema, batch_of, columns_of
from activefail.errors import StoreError

SCHEMA_VERSION = 1
"""Version of what the datasets and attributes of the files mean."""


def chain_start(settings: str, schema: Schema) -> str:
    """The digest that the chain of a campaign begins with (SHA-256 over the settings' SHA-256 and the schema)."""
    return hashlib.sha256(sha256(settings).encode() + schema.text.encode()).hexdigest()


def chain_next(before: str, batch: Batch) -> str:
    """The digest after a batch: SHA-256 over the one before it and every bit of the batch."""
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
        """The chain's digest before the design of each id at which a batch begins, and after the last design."""
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
        return f"{self.first:09d}-{self.last:09d}.h5"


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


def decode_segment(name: str, data: bytes) -> Segment:
    """The segment in a file of this name.

    Raises:
        DamagedError: if the file is not whole or not what its name says.
        StoreError: if it was written in another version.
    """
    with opened(data) as image:
        check_version(image)
        settings, schema = image.text("settings"), Schema.from_text(image.text("schema"))
        first, n = int(image.attribute("first")), int(image.attribute("last")) - int(image.attribute("first")) + 1
        columns = read_columns(image, list(COLUMNS), n, schema)
        _, sizes_shape = image.declared("size")
        sizes, iterations = (image.array(key, "<i8", sizes_shape) for key in ("size", "iteration"))
        if sizes.ndim != 1 or sizes.min() < 1 or sum(sizes.tolist()) != n:
            raise DamagedError(f"holds {n} designs in batches of {sizes.tolist()}")
        parts = {key: np.split(array, np.cumsum(sizes)[:-1]) for key, array in columns.items()}
        batches = tuple(
            batch_of(int(iteration), {key: part[i] for key, part in parts.items()})
            for i, iteration in enumerate(iterations)
        )
        before, after = image.attribute("chain_before"), image.attribute("chain_after")
        segment = Segment(settings, schema, first, before, batches, image.attributes("provenance."))
        if (segment.name, segment.after, sha256(settings)) != (name, after, image.attribute("settings_sha256")):
            raise DamagedError("is not the file that its name, its chain and its settings' SHA-256 say")
    return segment


def read_columns(image: Image, names: Sequence[str], n: int, schema: Schema) -> dict[str, NDArray[Any]]:
    """The named columns of n designs, their declared types and shapes checked before they are read."""
    widths = {"designs": len(schema.variables), "margins": len(schema.margins)}
    return {name: image.array(name, COLUMNS[name], (n, widths[name]) if name in widths else (n,)) for name in names}


def check_version(image: Image) -> None:
    """Raise StoreError if a file was written in another schema version."""
    written = image.attribute("schema_version")
    if written != str(SCHEMA_VERSION):
        program = image.attributes("provenance.").get("activefail", "of an unknown version")
        raise StoreError(
            f"was written in schema version {written} by activefail {program}; "
            f"this program (activefail {program_version()}) reads schema version {SCHEMA_VERSION}."
        )


def program_version() -> str:
    """The version of activefail that runs."""
    try:
        return version("activefail")
    except PackageNotFoundError:
        return "unknown"


def merge(segments: Sequence[Segment]) -> Segment:
    """One segment with the batches of consecutive ones."""
    provenance = {}
    for key in sorted({key for segment in segments for key in segment.provenance}):
        # Where the programs changed in between, the merged file says from which design on.
        changes = {
            run[0].first: text
            for text, group in groupby(segments, key=lambda segment: segment.provenance.get(key, ""))
            if (run := list(group))
        }
        provenance[key] = next(iter(changes.values())) if len(changes) == 1 else json.dumps(changes)
    start = segments[0]
    batches = tuple(batch for segment in segments for batch in segment.batches)
    return Segment(start.settings, start.schema, start.first, start.before, batches, provenance)


@dataclass(frozen=True)
class Recovery:
    """What a folder's segments come to: the chain, and what can go without losing a design."""

    chain: tuple[Segment, ...]
    covered: tuple[str, ...]  # inputs of a compaction that was interrupted
    damaged: Mapping[str, str]  # name -> reason; none of them stands before a valid segment


def recover(segments: Sequence[Segment], damaged: Mapping[str, str], start: str) -> Recovery:
    """The longest chain of segments from design 0 on, where the widest one wins.

    Raises:
        StoreError: if designs are missing before valid segments, or segments contradict each other.
    """
    chain: list[Segment] = []
    digests = {0: start}
    end = 0
    while fits := [segment for segment in segments if segment.first == end and segment.before == digests[end]]:
        chain.append(max(fits, key=lambda segment: segment.last))
        digests |= chain[-1].chain
        end = max(digests)
    covered, beyond, strays = [], [], {}
    for segment in segments:
        if segment.first > end:
            beyond.append(segment)
        elif segment.first == end:
            strays[segment.name] = "does not continue the chain of this campaign"
        elif segment in chain:
            continue
        elif segment.chain.items() <= digests.items():
            covered.append(segment.name)
        else:
            rivals = [other.name for other in chain if other.first <= segment.last and segment.first <= other.last]
            raise StoreError(
                f"Two writers have written different designs under the same ids: {segment.name} against "
                f"{', '.join(rivals)}. Nothing was changed. Move the wrong one out of segments/ to go on."
            )
    damaged = {**damaged, **strays}
    if beyond:
        later = min(beyond, key=lambda segment: segment.first)
        bad = "; ".join(f"{name} {reason}" for name, reason in sorted(damaged.items()))
        raise StoreError(
            f"Designs {end} to {later.first - 1} are missing ({bad or 'there is no file with them'}), yet there "
            f"{'are' if len(beyond) > 1 else 'is'} {', '.join(sorted(segment.name for segment in beyond))}. Nothing "
            f"was changed. Restore the missing file from a copy, or move the later ones out of segments/ to go on "
            f"from design {end}."
        )
    return Recovery(tuple(chain), tuple(covered), damaged)
