"""A recorded ground acceleration, linear between its samples."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from activefail.bearing.design import LARGEST
from activefail.bearing.ground import Samples, Segment, samples
from activefail.errors import InputError
from activefail.space import Array

STILL = Segment(0.0, 0.0, 0.0)
"""A ground at rest, with which a system is built before its first sample."""


@dataclass(frozen=True, eq=False)
class Accelerogram:
    """The ground acceleration of an earthquake at equal intervals; the first sample is at time 0.

    Before the first and after the last sample the ground does not accelerate.

    Attributes:
        acceleration: (n,) [m/s2], at least two.
        dt: interval between samples [s].
        name: of the record, for messages and plots.

    Raises:
        InputError: naming the rule and the value.
    """

    acceleration: Array
    dt: float
    name: str = ""

    def __post_init__(self) -> None:
        try:
            values = np.array(self.acceleration, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError("acceleration: must be numbers.") from None
        if values.ndim != 1 or len(values) < 2:
            raise InputError(f"acceleration: must have one axis with at least 2 samples, got shape {values.shape}.")
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InputError(f"acceleration: sample {bad[0] + 1} must be finite, got {values[bad[0]]}.")
        large = np.flatnonzero(np.abs(values) > LARGEST)
        if len(large):
            raise InputError(
                f"acceleration: sample {large[0] + 1} must be at most {LARGEST:g} m/s2 in magnitude, got "
                f"{values[large[0]]:g}."
            )
        if not (math.isfinite(self.dt) and self.dt > 0.0):
            raise InputError(f"dt: must be positive and finite, got {self.dt} s.")
        values.setflags(write=False)
        object.__setattr__(self, "acceleration", values)

    def scaled(self, factor: float) -> "Accelerogram":
        """The record with all accelerations multiplied.

        Raises:
            InputError: if the factor is not finite.
        """
        if not math.isfinite(factor):
            raise InputError(f"scale: must be finite, got {factor}.")
        return replace(self, acceleration=factor * self.acceleration)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return (len(self.acceleration) - 1) * self.dt

    @property
    def peak(self) -> float:
        """Peak ground acceleration [m/s2]."""
        return float(np.abs(self.acceleration).max())

    @property
    def peak_velocity(self) -> float:
        """Peak ground velocity [m/s], from rest."""
        a = self.acceleration
        return float(np.abs(np.cumsum(0.5 * self.dt * (a[1:] + a[:-1]))).max())

    def at(self, t: Array) -> Array:
        """Accelerations at times t, (n,) [m/s2]."""
        times = self.dt * np.arange(len(self.acceleration))
        return np.interp(t, times, self.acceleration, left=0.0, right=0.0)

    @cached_property
    def samples(self) -> Samples:
        """The record for the kernels."""
        return samples(self.acceleration, float(self.dt))
