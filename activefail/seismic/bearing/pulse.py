"""A pulse as ground motion: an antisymmetric Ricker wavelet (paper, eq. 1), its acceleration, jerk and velocity."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.kernels import KERNEL, kernel
from activefail.space.space import Array

_SPREAD = 2.0 * math.pi / math.sqrt(3.0)
PEAK = 1.38
"""The paper's rounded peak of |s² − 3|·s·exp(−s²/2); the exact value is 1.380119."""

_ROOT = math.sqrt(3.0)
"""The value of |s|, besides 0, at which the ground acceleration changes sign."""

HALF_DURATION = 1.5
"""The pulse lasts from 1.5 T_p before its centre to 1.5 T_p after, where 4·10⁻⁵ of its peak remain."""

VELOCITY_PER_ACCELERATION = 1.0 / (PEAK * _SPREAD)
"""Peak ground velocity of a pulse over A_p T_p: its velocity is largest at its centre."""

VELOCITY_PERIOD = math.sqrt(1.5)
"""Period of the peak of the velocity spectrum over T_p, the peak of the acceleration spectrum.

Published periods of pulses are those of a wavelet that fits the velocity. They are divided by this number."""


def amplitude_of(velocity: Array, period: Array) -> Array:
    """Amplitude A_p [g] of pulses with a peak ground velocity [m/s] and a period T_p [s]."""
    return velocity / (VELOCITY_PER_ACCELERATION * period * GRAVITY)


def velocity_of(amplitude: Array, period: Array) -> Array:
    """Peak ground velocity [m/s] of pulses with an amplitude A_p [g] and a period T_p [s]."""
    return amplitude * (VELOCITY_PER_ACCELERATION * period * GRAVITY)


def ground_velocity(t: NDArray[np.floating[Any]], amplitude: float, period: float) -> Array:
    """Ground velocity [m/s] at times t [s], (n,), of a pulse of amplitude A_p [m/s²] and period T_p [s].

    It is the integral of `ground_acceleration` from minus infinity on.
    """
    s = _SPREAD * t / period
    return amplitude * VELOCITY_PER_ACCELERATION * period * (1.0 - s * s) * np.exp(-0.5 * s * s)


@kernel(**KERNEL)
def ground_acceleration(t, amplitude, period):
    """Ground acceleration ü_g [m/s²] at time t [s] of a pulse of amplitude A_p [m/s²] and period T_p [s]."""
    s = _SPREAD * t / period
    return amplitude / PEAK * (s * s - 3.0) * s * math.exp(-0.5 * s * s)


@kernel(**KERNEL)
def ground_jerk(t, amplitude, period):
    """Time derivative of the ground acceleration [m/s³]."""
    s = _SPREAD * t / period
    s2 = s * s
    return amplitude / PEAK * _SPREAD / period * (6.0 * s2 - 3.0 - s2 * s2) * math.exp(-0.5 * s2)


@kernel(**KERNEL)
def impulse_to_come(t, amplitude, period):
    """∫ |ü_g| dt from t on [m/s]."""
    s = _SPREAD * t / period
    # (s² − 1)·exp(−s²/2) is a primitive of −(s² − 3)·s·exp(−s²/2), which changes sign at 0 and ±√3.
    primitive, at_root, at_zero = (s * s - 1.0) * math.exp(-0.5 * s * s), 2.0 * math.exp(-1.5), -1.0
    if s >= _ROOT:
        area = primitive
    elif s >= 0.0:
        area = 2.0 * at_root - primitive
    elif s >= -_ROOT:
        area = 2.0 * (at_root - at_zero) + primitive
    else:
        area = 4.0 * at_root - 2.0 * at_zero - primitive
    return abs(amplitude) / PEAK * period / _SPREAD * area
