"""Corrections: results of a record that were wrong, and what replaces them. The journal keeps both."""

import bisect
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.record.batch import Batch, Schema, answers_of, results_of
from activefail.simulators.interface import Results
from activefail.space.space import Array


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
    def none(cls, schema: Schema) -> Self:
        """No corrections."""
        codes, empty = np.empty(0, dtype=np.int8), np.empty(0)
        results = Results(codes, codes, np.empty((0, len(schema.margins))), empty)
        return cls(np.empty(0, dtype=np.int64), np.empty((0, len(schema.variables))), results, results)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The corrections of several lists, in order."""
        return cls(
            np.concatenate([part.place for part in parts]),
            np.concatenate([part.designs for part in parts]),
            Results.concatenate([part.former for part in parts]),
            Results.concatenate([part.results for part in parts]),
        )

    def __len__(self) -> int:
        return len(self.place)


def correcting(batches: Sequence[Batch], place: NDArray[np.int64], results: Results, schema: Schema) -> Corrections:
    """The corrections that give simulations of a record these results.

    Args:
        batches: of the record, with its former corrections.
        place: (k,) of the simulations, k ≥ 1.
        results: the k new results.
        schema: of the record.
    """
    ends, places = _ends(batches), place.tolist()
    simulations = ends[-1] if ends else 0
    if not places or len({*places}) < len(places) or not all(0 <= one < simulations for one in places):
        raise InputError(f"`place` must be different places below {simulations}, got {places}.")
    found = [_found(batches, ends, one) for one in places]
    designs = np.stack([batches[number].designs[row] for number, row in found])
    schema.check(designs, results)
    former = [batches[number].results[row : row + 1] for number, row in found]
    return Corrections(place.astype(np.int64), designs, Results.concatenate(former), results)


def correct_batches(batches: list[Batch], corrections: Corrections) -> None:
    """Put the corrected results into the list of a record's batches; the former batches do not change."""
    ends = _ends(batches)
    found = [_found(batches, ends, place) for place in corrections.place.tolist()]
    for number in {number for number, _ in found}:
        here = np.array([k for k, (other, _) in enumerate(found) if other == number])
        rows = np.array([found[k][1] for k in here])
        columns = {name: column.copy() for name, column in answers_of(batches[number].results).items()}
        for name, column in answers_of(corrections.results).items():
            columns[name][rows] = column[here]
            columns[name].flags.writeable = False
        batches[number] = replace(batches[number], results=results_of(columns))


def _ends(batches: Sequence[Batch]) -> list[int]:
    return list(itertools.accumulate(map(len, batches)))


def _found(batches: Sequence[Batch], ends: Sequence[int], place: int) -> tuple[int, int]:
    """The batch with a place of the record, and the row in it."""
    number = bisect.bisect_right(ends, place)
    return number, place - (ends[number] - len(batches[number]))
