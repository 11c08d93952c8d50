"""The records of a variable whose values are those of a set of ground motions, read once in each process."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError, naming
from activefail.seismic.motions.accelerogram_sets import P695, RecordSet, SetRecord, read_record_set
from activefail.seismic.motions.intensity import Intensity
from activefail.space.space import Array

MEASURES = ("pga", "pgv", "sa:0.3", "sa:1", "sa:3")
"""Intensities of a design's ground motion that are features of it."""


@dataclass(frozen=True)
class Motions:
    """The ground motions of a variable: what its choices, the names of records, stand for. No pickle has them.

    Attributes:
        variable: its name.
        place: a folder of records, or a set of FEMA P695.
        unit, dt: as for `read_record_set`; None if they are not stated.
        digest: of the records (`digest_of`).
        level: name of the quantity to which each record is scaled; empty if records are as they are.
        measure: the intensity that `level` is, as for `Intensity.of`.
        may_read: whether a folder may be read; if not, it was named by someone whom the user need not trust.
    """

    variable: str
    place: str
    unit: str | None
    dt: float | None
    digest: str
    level: str = ""
    measure: str = "factor"
    may_read: bool = True

    def __call__(self) -> tuple[SetRecord, ...]:
        """The records as they are, in the order of the choices.

        Raises:
            InputError: if they cannot or may not be read, or are others than the digest says.
        """
        return self.found.records

    @property
    def found(self) -> RecordSet:
        """The set; raises as a call does."""
        return _read(self)

    @property
    def notes(self) -> list[str]:
        """What is worth knowing of the set; raises as a call does."""
        return self.found.notes

    @staticmethod
    def read(variable: str, place: str, unit: str | None, dt: float | None) -> RecordSet:
        """The records of a set for a variable."""
        with naming(f"space.{variable}.set: "):
            try:
                return read_record_set(place, unit, dt)
            except InputError as error:
                raise InputError(str(error).replace("--unit", "`unit`").replace("--dt", "`dt`")) from None

    def factors(self, which: NDArray[np.intp], quantities: Mapping[str, Any]) -> Array:
        """By what the record of each design is multiplied, (n,).

        Args:
            which: (n,) numbers of the records.
            quantities: of the designs, by name.
        """
        if not self.level:
            return np.ones(len(which))
        return np.asarray(quantities[self.level] / _intensities(self, self.measure)[which])

    def in_design(self, number: int, quantities: Mapping[str, Any]) -> SetRecord:
        """The record of a design, scaled, as a simulator gets it."""
        record, (factor,) = self()[number], self.factors(np.array([number]), quantities)
        return replace(record, motion=record.motion.scaled(float(factor))) if self.level else record

    @property
    def _measures(self) -> list[str]:
        """The measures that are features: the variable of the level is one already."""
        of_level = Intensity.of(self.measure).name if self.level else ""
        return [text for text in MEASURES if Intensity.of(text).name != of_level]

    @property
    def feature_names(self) -> tuple[str, ...]:
        """The names of its features."""
        return tuple(f"{self.variable} {Intensity.of(text).name}" for text in self._measures)

    def features(self, which: NDArray[np.intp], quantities: Mapping[str, Any]) -> Array:
        """Intensities of the designs' scaled records, (n, m); see `factors`."""
        factors = self.factors(which, quantities)
        return np.column_stack([factors * _intensities(self, text)[which] for text in self._measures])


@cache
def _read(motions: Motions) -> RecordSet:
    if not motions.may_read and motions.place not in P695:
        raise InputError(
            f"space.{motions.variable}.set: {motions.place} is a folder of records. A run folder may come from someone "
            "else, so this folder is read only if you name the campaign file's folder with --code, or code=FOLDER in "
            "Python."
        )
    found = Motions.read(motions.variable, motions.place, motions.unit, motions.dt)
    if found.digest != motions.digest:
        raise InputError(
            f"space.{motions.variable}.set: the records of {motions.place} are not those of the campaign: their digest "
            f"is {found.digest}, not {motions.digest}. Restore them, or begin a new campaign."
        )
    return found


@cache
def _intensities(motions: Motions, measure: str) -> Array:
    """The intensity of each record as it is, (k,)."""
    of = Intensity.of(measure)
    return np.array([of.of_record(record.motion) for record in motions()])
