"""A rigid block sliding between two stops: a cheap model of the bearing up to its rim touches.

While the slider stays between the rims, the top plate moves nearly like a block of mass M on a friction pendulum,

    ẍ = −g x/L − μ (2R/L) g sgn(ẋ) − ü_g,    L = 2 √(R² − D_sl²/4) − h_sl,

and the rims act as stops at |x| = D_tot that return a share e of its speed. L is the distance between the centres of
the two circles on which the vertices move, the length of the equivalent pendulum; 2R/L is the lever of friction on two
dishes.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from activefail.bearing.design import GRAVITY, Model, table_1_rows
from activefail.bearing.pulse import HALF_DURATION, ground_acceleration
from activefail.space import Array

STEPS = 400
"""Steps per pulse period, or per second if that is shorter; over Table 1 the median error of v* is then 3·10⁻⁴."""


class Slide(NamedTuple):
    """The motion of a block between its stops."""

    speed: float  # largest speed at a stop [m/s]; 0 if none is reached
    push: float  # outward acceleration −ü_g·sgn(x) from the ground at that instant [m/s²]
    peak: float  # largest |x|, at most the stop's [m]
    first_speed: float  # speed at the first touch [m/s]; 0 without one
    first_time: float  # time of the first touch, after the pulse's centre [s]
    first_side: float  # side of the first touch, -1 or 1


@njit(cache=True, nogil=True, error_model="numpy")
def slide(stiffness, friction, stop, restitution, amplitude, period, steps):
    """The `Slide` of a block that starts from rest between its stops.

    Leapfrog method: displacements at whole steps, velocities at half steps; Coulomb friction is an impulse that at most
    stops the block. The motion after the pulse follows in closed form from its energy.

    Args:
        stiffness: g/L [1/s²].
        friction: deceleration by sliding friction [m/s²].
        stop: displacement of the stops [m]; infinite for none.
        restitution: share of the speed that a stop returns.
        amplitude: A_p of the pulse [m/s²].
        period: T_p of the pulse [s].
        steps: steps per period, or per second if that is shorter.
    """
    # The natural period also bounds the step, for bearings far stiffer than Table 1's.
    shortest = min(period, 1.0, 2.0 * math.pi / math.sqrt(stiffness))
    count = math.ceil(2.0 * HALF_DURATION * period / shortest * steps)
    dt = 2.0 * HALF_DURATION * period / count
    x, v, change = 0.0, 0.0, 0.0
    speed, push, peak = 0.0, 0.0, 0.0
    first_speed, first_time, first_side = 0.0, 0.0, 1.0
    for n in range(count):
        ground = ground_acceleration(-HALF_DURATION * period + n * dt, amplitude, period)
        before = v
        v -= dt * (stiffness * x + ground)
        v = math.copysign(max(abs(v) - dt * friction, 0.0), v)
        change = v - before
        start = x
        x += dt * v
        if abs(x) > stop:
            side = math.copysign(1.0, x)
            share = (side * stop - start) / (x - start)
            # `v` is the velocity at the midpoint of the step; extrapolate it to the stop.
            arrival = abs(v + (share - 0.5) * change)
            at_stop = (n + share) * dt - HALF_DURATION * period
            if first_speed == 0.0:
                first_speed, first_time, first_side = arrival, at_stop, side
            if arrival > speed:
                speed, push = arrival, -side * ground_acceleration(at_stop, amplitude, period)
            departure = -side * restitution * arrival
            x = side * stop + (1.0 - share) * dt * departure
            v = departure + (0.5 - share) * change
            peak = stop
        peak = max(peak, abs(x))
    v += 0.5 * change
    # Without ground motion, ½v² + ½(g/L)x² decreases by friction times distance, and the next peak is the largest.
    outwards = x * math.copysign(1.0, v)
    total = v * v + stiffness * x * x + 2.0 * friction * outwards
    square = total - stiffness * stop * stop - 2.0 * friction * stop if stop < math.inf else -1.0
    if square > 0.0:
        peak = stop
        if first_speed == 0.0:
            # At some time after the pulse; the exact time does not matter without ground motion.
            first_speed, first_time, first_side = math.sqrt(square), HALF_DURATION * period, math.copysign(1.0, v)
        if square > speed * speed:
            speed, push = math.sqrt(square), 0.0
    elif v != 0.0:
        next_peak = (math.sqrt(friction * friction + stiffness * total) - friction) / stiffness
        peak = max(peak, next_peak)
    return Slide(speed, push, peak, first_speed, first_time, first_side)


@njit(cache=True, nogil=True, error_model="numpy")
def drift(stiffness, friction, amplitude, period, steps, until):
    """Displacement [m] and velocity [m/s] of the block of `slide` without stops at time `until` [s] in the pulse."""
    shortest = min(period, 1.0, 2.0 * math.pi / math.sqrt(stiffness))
    duration = max(until + HALF_DURATION * period, 0.0)
    count = max(math.ceil(duration / shortest * steps), 1)
    dt = duration / count
    x, v, change = 0.0, 0.0, 0.0
    for n in range(count):
        before = v
        v -= dt * (stiffness * x + ground_acceleration(n * dt - HALF_DURATION * period, amplitude, period))
        v = math.copysign(max(abs(v) - dt * friction, 0.0), v)
        change = v - before
        x += dt * v
    return x, v + 0.5 * change


@njit(cache=True, nogil=True, error_model="numpy")
def _features(X, slider_diameter, restitution, steps, out):
    for row in range(len(X)):
        T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, _, _, T_p, A_p = X[row]
        rate = T_b / (2.0 * math.pi)
        radius = 0.5 * GRAVITY * (rate * rate)
        length = (
            2.0 * math.sqrt(radius * radius - 0.25 * (slider_diameter * slider_diameter)) - h_sl_ratio * slider_diameter
        )
        # Also for NaN.
        if not (length > 0.0 and mu >= 0.0 and D_tot > 0.0 and h_rim_ratio > 0.0 and 0.0 < T_p < math.inf):
            continue
        stiffness = GRAVITY / length
        block = slide(stiffness, mu * 2.0 * radius * stiffness, D_tot, restitution, A_p * GRAVITY, T_p, steps)
        speed = block.speed
        if speed == 0.0:
            speed = -math.sqrt(stiffness * max(D_tot * D_tot - block.peak * block.peak, 0.0))
        out[row, 0] = speed / math.sqrt(2.0 * GRAVITY * h_rim_ratio * slider_diameter)
        out[row, 1] = block.push / GRAVITY


SLIDING_FEATURES = ("v*", "a*")
"""Names of the columns of `sliding_features`."""


def sliding_features(X: Array, model: Model | None = None) -> Array:
    """The sliding block's features of designs in Table 1's order and units, (n, 9) -> (n, 2).

    v* is the largest speed at the stop over √(2 g h_rim), the speed that lifts a weight over the rim; if the stop is
    not reached, it is −√(g/L (D_tot² − peak²)), the missing speed, over the same. a* is the outward acceleration from
    the ground at that instant in g, 0 if the stop is not reached. A design that cannot be built has NaN.

    Args:
        model: source of slider diameter and restitution coefficient.

    Raises:
        InputError: if X has another shape or does not contain numbers.
    """
    model = model or Model()
    X = table_1_rows(X)
    out = np.full((len(X), len(SLIDING_FEATURES)), np.nan)
    _features(X, model.slider_diameter, model.restitution_coefficient, STEPS, out)
    return out
