"""Measures of the intensity of a record; `measures.INTENSITIES` has their names and units."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from activefail.errors import InputError
from activefail.seismic.bearing.accelerogram import Accelerogram
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.motions.measures import INTENSITIES, IntensityKind
from activefail.space.space import Array
from activefail.visible import visible

DAMPING = 0.05
"""Damping ratio of spectral accelerations."""

_IN_A_PERIOD = 100
"""Instants in a period at which the displacement of an oscillator is evaluated."""

_PERIODS = (0.01, 100.0)
"""Shortest and longest period of a spectral acceleration [s]."""


@dataclass(frozen=True)
class Intensity:
    """A measure of a record's intensity; scaling a record by a factor multiplies it.

    Attributes:
        kind: "factor" (of the record as it is), "pga" [g], "pgv" [m/s], or "sa", the pseudo-spectral acceleration [g]
            at `period`, damped by 5 %. "p695" scales all records by one factor, as [FEMA2009] does: the intensity S_T
            is that of the set, its geometric mean spectral acceleration [g] at `period`.
        period: of "sa" and "p695" [s].
        of_set: S_NRT [g], the intensity of the set as it is, for "p695"; NaN before the set is known.
    """

    kind: IntensityKind
    period: float = math.nan
    of_set: float = math.nan

    @classmethod
    def of(cls, text: str) -> Self:
        """From the kind, or "sa:T"; "p695" lacks its period and its set.

        Raises:
            InputError: if it is something else, or T is not between 0.01 and 100 s.
        """
        name, _, period = text.partition(":")
        if name in INTENSITIES and name != "sa" and not period:
            return cls(name)
        try:
            T = float(period) if name == "sa" else math.nan
        except ValueError:
            T = math.nan
        if not _PERIODS[0] <= T <= _PERIODS[1]:
            raise InputError(
                f"--scale-to: must be one of {', '.join(INTENSITIES)}, where sa:T has a period T from "
                f"{_PERIODS[0]:g} to {_PERIODS[1]:g} s, such as sa:3.5, got {visible(text)!r}."
            )
        return cls("sa", T)

    @property
    def name(self) -> str:
        """For tables and axes, such as "Sa(3.5 s)"."""
        return INTENSITIES[self.kind].name.format(T=self.period)

    @property
    def unit(self) -> str:
        """Empty for a factor."""
        return INTENSITIES[self.kind].unit

    @property
    def highest(self) -> float:
        """The highest level of a ladder by default."""
        return INTENSITIES[self.kind].highest * (self.of_set if self.kind == "p695" else 1.0)

    def of_record(self, motion: Accelerogram) -> float:
        """The intensity of a record as it is.

        Raises:
            InputError: if the record does not move.
        """
        if motion.peak == 0.0:
            raise InputError(f"{motion.name}: does not move the ground, so it cannot be scaled.")
        match self.kind:
            case "factor":
                return 1.0
            case "pga":
                return motion.peak / GRAVITY
            case "pgv":
                return motion.peak_velocity
            case "sa":
                return spectral_acceleration(motion, self.period) / GRAVITY
            case "p695":
                return self.of_set


def spectral_acceleration(motion: Accelerogram, period: float) -> float:
    """Pseudo-spectral acceleration ω² max|x| [m/s2] of the oscillator x'' + 2 ζ ω x' + ω² x = −a(t), ζ = 5 %.

    The acceleration is linear between samples. The response is exact at the samples and at instants between them, at
    least 100 in a period, so a peak is at most 0.05 % too low. At the samples alone it would be up to 9 % too low for
    a period of 0.05 s. One period of rest follows the record, in which the largest displacement may come.

    Args:
        motion: the record.
        period: of the oscillator [s].
    """
    # Imported here: importing SciPy's signals takes longer than simulating a bearing.
    from scipy.signal import lfilter

    omega, dt = 2.0 * math.pi / period, motion.dt
    a = np.append(motion.acceleration, np.zeros(math.ceil(period / dt) + 1))
    first, rate = a[:-1], np.diff(a) / dt
    # With the root λ of the oscillator, y = x' − conj(λ) x obeys y' = λ y − a, and x is Im y / Im λ.
    root = omega * complex(-DAMPING, math.sqrt(1.0 - DAMPING**2))

    def moved(y: Array, time: float) -> Array:
        growth = complex(np.exp(root * time))
        result: Array = growth * y - (growth - 1.0) / root * first - (growth - 1.0 - root * time) / root**2 * rate
        return result

    at_ends = lfilter([1.0], [1.0, -np.exp(root * dt)], moved(np.zeros(len(first)), dt))
    y = np.append(0.0, at_ends[:-1])
    parts = math.ceil(_IN_A_PERIOD * dt / period)
    largest = max(np.abs(moved(y, dt * part / parts).imag).max() for part in range(1, parts + 1))
    return float(omega**2 * largest / root.imag)
