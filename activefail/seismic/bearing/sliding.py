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

from activefail.seismic.bearing.design import GRAVITY, Model, table_1_rows
from activefail.seismic.bearing.ground import Ricker, acceleration, shaking_of
from activefail.seismic.bearing.kernels import kernel
from activefail.space.space import Array

STEPS = 400
"""Steps per pulse period, or per second if that is shorter; over Table 1 the median error of v* is then 3·10⁻⁴."""


class Slide(NamedTuple):
    """The motion of a block between its stops."""

    speed: float  # largest speed at a stop [m/s]; 0 if none is reached
    push: float  # outward acceleration −ü_g·sgn(x) from the ground at that instant [m/s²]
    peak: float  # largest |x|, at most the stop's [m]
    first_speed: float  # speed at the first touch [m/s]; 0 without one
    first_time: float  # time of the first touch [s], as in the ground motion
    first_side: float  # side of the first touch, -1 or 1


@kernel(nogil=True, error_model="numpy")
def slide(stiffness, friction, stop, restitution, motion, steps):
    """The `Slide` of a block that starts from rest between its stops.

    Leapfrog method: displacements at whole steps, velocities at half steps; Coulomb friction is an impulse that at most
    stops the block. The motion after the ground's follows in closed form from its energy.

    Args:
        stiffness: g/L [1/s²].
        friction: deceleration by sliding friction [m/s²].
        stop: displacement of the stops [m]; infinite for none.
        restitution: share of the speed that a stop returns.
        motion: of the ground, a `Ricker` or a `Scaled`.
        steps: steps per pulse period, or per second if that is shorter.
    """
    begin, end, period = shaking_of(motion)
    # The natural period also bounds the step, for bearings far stiffer than Table 1's.
    shortest = min(period, 1.0, 2.0 * math.pi / math.sqrt(stiffness))
    count = math.ceil((end - begin) / shortest * steps)
    dt = (end - begin) / count
    x, v, change = 0.0, 0.0, 0.0
    speed, push, peak = 0.0, 0.0, 0.0
    first_speed, first_time, first_side = 0.0, 0.0, 1.0
    for n in range(count):
        ground = acceleration(motion, begin + n * dt)
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
            at_stop = (n + share) * dt + begin
            if first_speed == 0.0:
                first_speed, first_time, first_side = arrival, at_stop, side
            if arrival > speed:
                speed, push = arrival, -side * acceleration(motion, at_stop)
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
            # At some time after the ground motion; the exact time does not matter then.
            first_speed, first_time, first_side = math.sqrt(square), end, math.copysign(1.0, v)
        if square > speed * speed:
            speed, push = math.sqrt(square), 0.0
    elif v != 0.0:
        next_peak = (math.sqrt(friction * friction + stiffness * total) - friction) / stiffness
        peak = max(peak, next_peak)
    return Slide(speed, push, peak, first_speed, first_time, first_side)


@kernel(nogil=True, error_model="numpy")
def drift(stiffness, friction, motion, steps, until):
    """Displacement [m] and velocity [m/s] of the block of `slide` without stops at time `until` [s]."""
    begin, _, period = shaking_of(motion)
    shortest = min(period, 1.0, 2.0 * math.pi / math.sqrt(stiffness))
    duration = max(until - begin, 0.0)
    count = max(math.ceil(duration / shortest * steps), 1)
    dt = duration / count
    x, v, change = 0.0, 0.0, 0.0
    for n in range(count):
        before = v
        v -= dt * (stiffness * x + acceleration(motion, n * dt + begin))
        v = math.copysign(max(abs(v) - dt * friction, 0.0), v)
        change = v - before
        x += dt * v
    return x, v + 0.5 * change


@kernel(nogil=True, error_model="numpy")
def sliding_pair(bearing, motion, slider_diameter, restitution, steps):
    """v* and a* of a bearing, (7,), under a ground motion (`sliding_features`); NaN if it cannot be built."""
    T_b, mu, D_tot, h_sl_ratio, h_rim_ratio = bearing[0], bearing[1], bearing[2], bearing[3], bearing[4]
    rate = T_b / (2.0 * math.pi)
    radius = 0.5 * GRAVITY * (rate * rate)
    length = (
        2.0 * math.sqrt(radius * radius - 0.25 * (slider_diameter * slider_diameter)) - h_sl_ratio * slider_diameter
    )
    # Also for NaN.
    if not (length > 0.0 and mu >= 0.0 and D_tot > 0.0 and h_rim_ratio > 0.0):
        return math.nan, math.nan
    stiffness = GRAVITY / length
    block = slide(stiffness, mu * 2.0 * radius * stiffness, D_tot, restitution, motion, steps)
    speed = block.speed
    if speed == 0.0:
        speed = -math.sqrt(stiffness * max(D_tot * D_tot - block.peak * block.peak, 0.0))
    return speed / math.sqrt(2.0 * GRAVITY * h_rim_ratio * slider_diameter), block.push / GRAVITY


@kernel(nogil=True, error_model="numpy")
def _features(X, slider_diameter, restitution, steps, out):
    for row in range(len(X)):
        T_p, A_p = X[row, 7], X[row, 8]
        # Also for NaN.
        if 0.0 < T_p < math.inf:
            pair = sliding_pair(X[row, :7], Ricker(A_p * GRAVITY, T_p), slider_diameter, restitution, steps)
            out[row, 0], out[row, 1] = pair


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
