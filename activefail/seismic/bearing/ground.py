"""Ground motions for the kernels: a Ricker pulse, or a recorded acceleration between its samples.

A kernel calls `acceleration` and `jerk` with a motion; the motion's type chooses the formula, as for the problems of
`integrator`. An accelerogram is linear between its samples, and no step of the bearing model crosses one (`course`).
The cheap models (`sliding`, `collision`) take a whole accelerogram as one motion.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from activefail.seismic.bearing.kernels import INLINE
from activefail.seismic.bearing.pulse import HALF_DURATION, ground_acceleration, ground_jerk
from activefail.space.space import Array


class Ricker(NamedTuple):
    """The pulse of `pulse`."""

    amplitude: float  # A_p [m/s2]
    period: float  # T_p [s]


class Segment(NamedTuple):
    """A linear acceleration, from one sample of an accelerogram to the next."""

    acceleration: float  # at the first sample [m/s2]
    jerk: float  # [m/s3]
    begin: float  # time of the first sample [s]
    vertical: float  # vertical acceleration at the first sample, up [m/s2]
    vertical_jerk: float  # [m/s3]


class Samples(NamedTuple):
    """An accelerogram, whose first sample is at time 0. Before it and after the last one the ground does not move."""

    acceleration: Array  # (n,) [m/s2]
    vertical: Array  # (n,) vertical acceleration, up [m/s2]
    impulse: Array  # (n,) ∫ (|ü_g| + |vertical|) dt from each sample on [m/s], at least that of the vector's norm
    dt: float  # [s]


class Scaled(NamedTuple):
    """A whole accelerogram, multiplied by a factor. The cheap models see its horizontal component only."""

    samples: Samples
    factor: float


def samples(acceleration: Array, dt: float, vertical: Array | None = None) -> Samples:
    """The samples of an accelerogram for the kernels.

    Args:
        acceleration: (n,) [m/s2], at least two.
        dt: [s].
        vertical: (n,) vertical acceleration, up [m/s2]; None if the ground moves horizontally only.
    """
    to_come = _impulse_to_come(acceleration, dt)
    if vertical is None:
        vertical = np.zeros(len(acceleration))
    else:
        to_come = to_come + _impulse_to_come(vertical, dt)
    return Samples(np.ascontiguousarray(acceleration), np.ascontiguousarray(vertical), to_come, dt)


def _impulse_to_come(acceleration: Array, dt: float) -> Array:
    """∫ |acceleration| dt from each sample on, (n,) [m/s]."""
    a, b = np.abs(acceleration[:-1]), np.abs(acceleration[1:])
    # Within an interval the linear acceleration changes its sign at most once.
    crosses = acceleration[:-1] * acceleration[1:] < 0.0
    total = np.maximum(a + b, np.finfo(float).tiny)
    area = 0.5 * dt * np.where(crosses, (a * a + b * b) / total, a + b)
    return np.append(np.cumsum(area[::-1])[::-1], 0.0)


def is_type(motion, kind):
    """Whether a numba type is that of a NamedTuple."""
    return getattr(motion, "instance_class", None) is kind


def acceleration(motion, t):
    """Ground acceleration ü_g [m/s2] at time t [s]; overloaded for each type of motion."""
    raise NotImplementedError


def jerk(motion, t):
    """Its time derivative [m/s3]; overloaded for each type of motion."""
    raise NotImplementedError


def vertical(motion, t):
    """Vertical ground acceleration, up [m/s2], at time t [s]; overloaded for each type of motion."""
    raise NotImplementedError


def vertical_jerk(motion, t):
    """Its time derivative [m/s3]; overloaded for each type of motion."""
    raise NotImplementedError


def shaking_of(motion):
    """Times at which a whole motion begins and ends, and the shortest period that a cheap model's steps resolve [s]."""
    raise NotImplementedError


def is_harmless(motion, t, energy, least):
    """Whether a mass with `energy` [m²/s²] at time t [s] can no longer reach the energy `least`.

    A pulse says so after its end only, an accelerogram by its impulse to come, at any time.
    """
    raise NotImplementedError


@overload(acceleration, jit_options=INLINE)
def _acceleration(motion, t):
    if is_type(motion, Ricker):
        return lambda motion, t: ground_acceleration(t, motion.amplitude, motion.period)
    if is_type(motion, Segment):
        return lambda motion, t: motion.acceleration + motion.jerk * (t - motion.begin)
    if is_type(motion, Scaled):
        return _interpolated
    return None


@overload(jerk, jit_options=INLINE)
def _jerk(motion, t):
    if is_type(motion, Ricker):
        return lambda motion, t: ground_jerk(t, motion.amplitude, motion.period)
    if is_type(motion, Segment):
        return lambda motion, t: motion.jerk
    return None


@overload(vertical, jit_options=INLINE)
def _vertical(motion, t):
    if is_type(motion, Ricker):
        return lambda motion, t: 0.0
    if is_type(motion, Segment):
        return lambda motion, t: motion.vertical + motion.vertical_jerk * (t - motion.begin)
    return None


@overload(vertical_jerk, jit_options=INLINE)
def _vertical_jerk(motion, t):
    if is_type(motion, Ricker):
        return lambda motion, t: 0.0
    if is_type(motion, Segment):
        return lambda motion, t: motion.vertical_jerk
    return None


def _interpolated(motion, t):
    a = motion.samples.acceleration
    place = t / motion.samples.dt
    k = math.floor(place)
    if k < 0 or k >= len(a) - 1:
        # The last sample is an instant.
        return 0.0
    return motion.factor * (a[k] + (place - k) * (a[k + 1] - a[k]))


@overload(shaking_of, jit_options=INLINE)
def _shaking_of(motion):
    if is_type(motion, Ricker):
        return lambda motion: (-HALF_DURATION * motion.period, HALF_DURATION * motion.period, motion.period)
    if is_type(motion, Scaled):
        return lambda motion: (0.0, (len(motion.samples.acceleration) - 1) * motion.samples.dt, 1.0)
    return None


@overload(is_harmless, jit_options=INLINE)
def _is_harmless(motion, t, energy, least):
    def after_pulse(motion, t, energy, least):
        return t > HALF_DURATION * motion.period and energy < least

    def with_impulse(motion, t, energy, least):
        impulse = motion.samples.impulse
        k = min(max(math.floor(t / motion.samples.dt), 0), len(impulse) - 1)
        pushed = math.sqrt(0.5) * abs(motion.factor) * impulse[k]
        return math.sqrt(max(energy, 0.0)) + pushed < math.sqrt(least)

    if is_type(motion, Ricker):
        return after_pulse
    return with_impulse if is_type(motion, Scaled) else None
