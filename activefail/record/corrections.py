"""Corrections: results of a record that were wrong, and what replaces them, applied when a record is read.

The batches of a record never change. The file `corrections.h5` lists the results that replace others, beside those that
they replace, in the order in which they were made. A reader applies them in this order to the batches that it has read,
so the former results stay in the segments, and in this file.
"""

import bisect
import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import DamagedError, InputError
from activefail.record.batch import COLUMNS, Batch, Schema, answers_of, copy_results, results_of
from activefail.record.hdf5 import encode, open_image
from activefail.record.segment import SCHEMA_VERSION, check_version, read_columns
from activefail.simulators.interface import Results
from activefail.space import Array

_RESULTS = ("outcome", "cause", "margins", "seconds")

_FORMER = "former_"
"""Prefix of the columns of the replaced results."""

LARGEST_CORRECTIONS = 1_000_000_000
"""Most bytes of the file."""


@dataclass(frozen=True, eq=False)
class Corrections:
    """The k corrections of a record, in the order in which they were made.

    Attributes:
        place: (k,) int64, of each corrected simulation in the record, from 0.
        designs: (k, d) float64, of these simulations.
        former: the k results that were replaced.
        results: the k results that replaced them.

    Raises:
        ValueError: if the lengths disagree.
    """

    place: NDArray[np.int64]
    designs: Array
    former: Results
    results: Results

    def __post_init__(self) -> None:
        k = len(self.place)
        if self.designs.ndim != 2 or {len(self.designs), len(self.former), len(self.results)} != {k}:
            raise ValueError(f"Corrections need {k} designs and results, got {self.designs.shape}.")

    @classmethod
    def none(cls, schema: Schema | None) -> Self:
        """No corrections."""
        variables, margins = (0, 0) if schema is None else (len(schema.variables), len(schema.margins))
        codes, empty = np.empty(0, dtype=np.int8), np.empty(0)
        results = Results(codes, codes, np.empty((0, margins)), empty)
        return cls(np.empty(0, dtype=np.int64), np.empty((0, variables)), results, results)

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> Self:
        return type(self)(self.place[rows], self.designs[rows], self.former[rows], self.results[rows])

    def and_then(self, later: Self) -> Self:
        """These corrections and later ones."""
        return type(self)(
            np.concatenate([self.place, later.place]),
            np.concatenate([self.designs, later.designs]),
            Results.concatenate([self.former, later.former]),
            Results.concatenate([self.results, later.results]),
        )

    def copy(self) -> Self:
        """Corrections that share no array with these."""
        return type(self)(self.place.copy(), self.designs.copy(), copy_results(self.former), copy_results(self.results))

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """All columns by name."""
        former = {_FORMER + name: column for name, column in answers_of(self.former).items()}
        return {"place": self.place, "designs": self.designs, **former, **answers_of(self.results)}

    @property
    def digest(self) -> str:
        """SHA-256 of every bit; empty without corrections."""
        if not len(self):
            return ""
        digest = hashlib.sha256()
        for name, column in self.columns.items():
            digest.update(np.ascontiguousarray(column, dtype=_type_of(name)).tobytes())
        return digest.hexdigest()

    def before(self, end: int) -> Self:
        """The corrections of the first `end` simulations."""
        return self[self.place < end]

    def entry(self, count: int) -> str:
        """The number of the first corrections, and a digest of them; the list only grows."""
        return f"{count} {self[:count].digest[:16]}"


def _type_of(column: str) -> str:
    return "<i8" if column == "place" else COLUMNS[column.removeprefix(_FORMER)]


def correcting(batches: Sequence[Batch], place: NDArray[np.int64], results: Results, schema: Schema) -> Corrections:
    """The corrections that give simulations of a record these results.

    Args:
        batches: of the record, with its former corrections.
        place: (k,) of the simulations, k ≥ 1.
        results: the k new results.
        schema: of the record.

    Raises:
        InputError: if there is none, a place is not one of the record or occurs twice, or a result breaks the schema.
    """
    ends, places = _ends(batches), place.tolist()
    simulations = ends[-1] if ends else 0
    if not places or len({*places}) < len(places) or not all(0 <= one < simulations for one in places):
        raise InputError(f"`place` must be different places below {simulations}, got {places}.")
    found = [_found(batches, ends, one) for one in places]
    designs = np.stack([batches[number].designs[row] for number, row in found])
    schema.check(designs, results)
    former = [batches[number].results[row : row + 1] for number, row in found]
    return Corrections(place.astype(np.int64), designs, Results.concatenate(former), copy_results(results))


def corrected(batches: Sequence[Batch], corrections: Corrections) -> tuple[list[Batch], NDArray[np.bool_]]:
    """The batches of a record with its corrections, and which of these, (k,), were applied.

    A correction is not applied if the record has another design, or another result, at its place: the corrected batch
    was lost.
    """
    batches, ends = list(batches), _ends(batches)
    applied = np.zeros(len(corrections), dtype=bool)
    for k, place in enumerate(corrections.place.tolist()):
        if place >= (ends[-1] if ends else 0):
            continue
        number, row = _found(batches, ends, place)
        batch, one = batches[number], slice(row, row + 1)
        kept = [batch.designs[one].tobytes(), *_bits(batch.results[one])]
        if kept == [corrections.designs[k].tobytes(), *_bits(corrections.former[k : k + 1])]:
            batches[number] = _with_result(batch, row, corrections.results[k : k + 1])
            applied[k] = True
    return batches, applied


def _ends(batches: Sequence[Batch]) -> list[int]:
    return list(itertools.accumulate(map(len, batches)))


def _found(batches: Sequence[Batch], ends: Sequence[int], place: int) -> tuple[int, int]:
    """The batch with a place of the record, and the row in it."""
    number = bisect.bisect_right(ends, place)
    return number, place - (ends[number] - len(batches[number]))


def _bits(results: Results) -> list[bytes]:
    return [column.tobytes() for column in answers_of(results).values()]


def _with_result(batch: Batch, row: int, result: Results) -> Batch:
    columns = {name: column.copy() for name, column in answers_of(batch.results).items()}
    for name, column in answers_of(result).items():
        columns[name][row] = column[0]
        columns[name].flags.writeable = False
    return replace(batch, results=results_of(columns))


def encode_corrections(corrections: Corrections, schema: Schema, campaign: str) -> bytes:
    """The bytes of the file; `campaign` is the digest at the start of the campaign's chain."""
    content: dict[str, NDArray[Any] | str] = {**corrections.columns, "schema": schema.text}
    return encode(content, {"schema_version": str(SCHEMA_VERSION), "campaign": campaign})


def decode_corrections(data: bytes, campaign: str, schema: Schema) -> Corrections:
    """The corrections in a file of this campaign.

    Args:
        data: the file.
        campaign: the digest at the start of its chain.
        schema: the meaning of its columns.

    Raises:
        DamagedError: if the file is damaged or belongs to another campaign.
        StoreError: if another version wrote it.
    """
    with open_image(data) as image:
        check_version(image)
        if image.attribute("campaign") != campaign or image.text("schema") != schema.text:
            raise DamagedError("belongs to another campaign")
        _, shape = image.declared("place")
        k = shape[0]
        place = image.array("place", "<i8", (k,))
        columns = read_columns(image, ["designs", *_RESULTS], k, schema)
        former = {name: image.array(_FORMER + name, COLUMNS[name], columns[name].shape) for name in _RESULTS}
        designs, results, replaced = columns["designs"], results_of(columns), results_of(former)
        for one in (results, replaced):
            schema.check(designs, one)
        if len(place) and place.min() < 0:
            raise DamagedError("lists places that `tell` never writes")
        return Corrections(place, designs, replaced, results)


def record_digest(chain: str, corrected: str) -> str:
    """The digest of a record: that of its chain, joined with that of its corrections if there are any."""
    return hashlib.sha256(f"{chain}{corrected}".encode()).hexdigest() if corrected else chain
