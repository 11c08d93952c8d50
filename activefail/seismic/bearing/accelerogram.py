"""A recorded ground acceleration, linear between its samples."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from activefail.errors import InputError
from activefail.seismic.bearing.ground import Samples, Segment, samples
from activefail.space.parameter import LARGEST
from activefail.space.space import Array

STILL = Segment(0.0, 0.0, 0.0, 0.0, 0.0)
"""A ground at rest, with which a system is built before its first sample."""

EVEN = 1e-3
"""Largest difference between two intervals that count as equal, as a share: files round their times."""


@dataclass(frozen=True, eq=False)
class Accelerogram:
    """The ground acceleration of an earthquake at equal intervals; the first sample is at time 0.

    Before the first and after the last sample the ground does not accelerate.

    Attributes:
        acceleration: (n,) [m/s2], at least two.
        dt: interval between samples [s].
        name: of the record, for messages and plots.
        vertical: (n,) vertical acceleration, up [m/s2]; None if the ground moves horizontally only.
        notes: what to know of the file that it comes from, as ends of sentences that begin with its name.

    Raises:
        InputError: naming the rule and the value.
    """

    acceleration: Array
    dt: float
    name: str = ""
    vertical: Array | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dt) and self.dt > 0.0):
            raise InputError(f"dt: must be positive and finite, got {self.dt} s.")
        object.__setattr__(self, "acceleration", _checked("acceleration", self.acceleration))
        if self.vertical is None:
            return
        object.__setattr__(self, "vertical", _checked("vertical", self.vertical))
        if len(self.vertical) != len(self.acceleration):
            raise InputError(
                f"vertical: must have as many samples as acceleration, {len(self.acceleration)}, got "
                f"{len(self.vertical)}."
            )

    def scaled(self, factor: float) -> "Accelerogram":
        """The record with all accelerations multiplied, the vertical ones too.

        Raises:
            InputError: if the factor is not finite, or makes an acceleration too large.
        """
        if not math.isfinite(factor):
            raise InputError(f"scale: must be finite, got {factor}.")
        largest = self.peak if self.vertical is None else max(self.peak, float(np.abs(self.vertical).max()))
        if not abs(factor) * largest <= LARGEST:
            raise InputError(
                f"scale: must keep accelerations of up to {largest:.3g} m/s2 below {LARGEST:g} m/s2, got {factor:g}."
            )
        vertical = None if self.vertical is None else factor * self.vertical
        return replace(self, acceleration=factor * self.acceleration, vertical=vertical)

    def with_vertical(self, component: "Accelerogram") -> "Accelerogram":
        """The record with the acceleration of another one as its vertical component, up.

        The shorter of both is continued with zeros: after its last sample the ground does not accelerate.

        Raises:
            InputError: if the intervals differ.
        """
        if abs(component.dt - self.dt) > EVEN * self.dt:
            raise InputError(
                f"vertical: must have the interval of the horizontal component, {self.dt:g} s, got {component.dt:g} s."
            )
        missing = len(self.acceleration) - len(component.acceleration)
        return replace(
            self,
            acceleration=np.pad(self.acceleration, (0, max(-missing, 0))),
            vertical=np.pad(component.acceleration, (0, max(missing, 0))),
            notes=(*self.notes, *(f"(vertical) {note}" for note in component.notes)),
        )

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
        return samples(self.acceleration, float(self.dt), self.vertical)


def _checked(name: str, values: Array) -> Array:
    """A component, which cannot be changed."""
    try:
        checked = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be numbers.") from None
    if checked.ndim != 1 or len(checked) < 2:
        raise InputError(f"{name}: must have one axis with at least 2 samples, got shape {checked.shape}.")
    bad = np.flatnonzero(~np.isfinite(checked))
    if len(bad):
        raise InputError(f"{name}: sample {bad[0] + 1} must be finite, got {checked[bad[0]]}.")
    large = np.flatnonzero(np.abs(checked) > LARGEST)
    if len(large):
        raise InputError(
            f"{name}: sample {large[0] + 1} must be at most {LARGEST:g} m/s2 in magnitude, got {checked[large[0]]:g}."
        )
    checked.setflags(write=False)
    return checked
