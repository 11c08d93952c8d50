"""How a pulse or an accelerogram continues after a time: its next sample, its end, and the impulse to come.

`simulation.integrate` calls these functions with the samples of an accelerogram, or with None for a pulse. The type
chooses the formula, so that a pulse pays nothing for accelerograms.
"""

import math

from numba import njit, types
from numba.extending import overload

from activefail.seismic.bearing.dynamics import with_parts
from activefail.seismic.bearing.ground import Samples, Segment, is_type
from activefail.seismic.bearing.kernels import INLINE
from activefail.seismic.bearing.pulse import HALF_DURATION, impulse_to_come

_ROUNDING = 1e-9
"""Part of an interval between samples that is taken as none."""


def shaking(system, samples):
    """Times at which the ground begins and ends to move, and the first step to try [s]."""
    raise NotImplementedError


def at_sample(samples, t, k):
    """The last sample at or before t [s], if k is one before; 0 for a pulse."""
    raise NotImplementedError


def from_sample(system, samples, k):
    """The system whose ground moves as after sample k."""
    raise NotImplementedError


def longest_step(system, samples, t, step, k, ends, longest):
    """The longest step [s] at time t, after sample k, of a motion that ends at `ends`; at most `longest`.

    Of an accelerogram it is a whole part of the time to the next sample, no longer than the step to be tried if this
    is shorter: a remainder would be a tiny step, after which the next ones grow threefold at most.
    """
    raise NotImplementedError


def to_come(system, samples, t, k):
    """∫ |ü_g| dt from time t on [m/s], after sample k; at least that of the vector's norm with a vertical component."""
    raise NotImplementedError


def rises(samples):
    """Whether the ground moves vertically too."""
    raise NotImplementedError


def is_over(samples, t, ends):
    """Whether a run without a rim touch may end: for an accelerogram at any time."""
    raise NotImplementedError


@overload(shaking, jit_options=INLINE)
def _shaking(system, samples):
    def of_pulse(system, samples):
        t = -HALF_DURATION * system.motion.period
        return t, -t, 1e-3 * system.motion.period

    def of_samples(system, samples):
        return 0.0, (len(samples.acceleration) - 1) * samples.dt, min(1e-3, samples.dt)

    return _of(samples, of_pulse, of_samples)


@overload(at_sample, jit_options=INLINE)
def _at_sample(samples, t, k):
    def of_pulse(samples, t, k):
        return 0

    def of_samples(samples, t, k):
        while k < len(samples.acceleration) - 1 and (k + 1) * samples.dt - t <= _ROUNDING * samples.dt:
            k += 1
        return k

    return _of(samples, of_pulse, of_samples)


@overload(from_sample, jit_options=INLINE)
def _from_sample(system, samples, k):
    def of_pulse(system, samples, k):
        return system

    def of_samples(system, samples, k):
        a, up, dt = samples.acceleration, samples.vertical, samples.dt
        if k < len(a) - 1:
            motion = Segment(a[k], (a[k + 1] - a[k]) / dt, k * dt, up[k], (up[k + 1] - up[k]) / dt)
        else:
            motion = Segment(0.0, 0.0, k * dt, 0.0, 0.0)
        return with_parts(system, system.bottom, system.top, motion)

    return _of(samples, of_pulse, of_samples)


@overload(longest_step, jit_options=INLINE)
def _longest_step(system, samples, t, step, k, ends, longest):
    def of_pulse(system, samples, t, step, k, ends, longest):
        # At most a tenth of the pulse, so that no step from rest skips it.
        return min(longest, 0.1 * system.motion.period) if t < ends else longest

    def of_samples(system, samples, t, step, k, ends, longest):
        if k >= len(samples.acceleration) - 1:
            return longest
        left = (k + 1) * samples.dt - t
        return min(longest, left / math.ceil(left / step))

    return _of(samples, of_pulse, of_samples)


@overload(to_come, jit_options=INLINE)
def _to_come(system, samples, t, k):
    def of_pulse(system, samples, t, k):
        return impulse_to_come(t, system.motion.amplitude, system.motion.period)

    def of_samples(system, samples, t, k):
        if k >= len(samples.acceleration) - 1:
            return 0.0
        h = (k + 1) * samples.dt - t
        across = _area(h, samples.acceleration[k + 1], system.motion.jerk)
        up = _area(h, samples.vertical[k + 1], system.motion.vertical_jerk)
        return across + up + samples.impulse[k + 1]

    return _of(samples, of_pulse, of_samples)


@overload(rises, jit_options=INLINE)
def _rises(samples):
    return _of(samples, lambda samples: False, lambda samples: samples.vertical.any())


@overload(is_over, jit_options=INLINE)
def _is_over(samples, t, ends):
    def of_pulse(samples, t, ends):
        return t > ends

    def of_samples(samples, t, ends):
        return True

    return _of(samples, of_pulse, of_samples)


@njit(**INLINE)
def _area(h, last, jerk):
    """∫ |acceleration| dt [m/s] over the time h [s] before a sample with the acceleration `last`."""
    first = last - h * jerk
    if first * last < 0.0:
        return 0.5 * h * (first * first + last * last) / (abs(first) + abs(last))
    return 0.5 * h * (abs(first) + abs(last))


def _of(samples, of_pulse, of_samples):
    if isinstance(samples, types.NoneType):
        return of_pulse
    return of_samples if is_type(samples, Samples) else None
