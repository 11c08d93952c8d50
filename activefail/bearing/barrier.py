"""Energies below which a bearing meets no rim any more, or fails no more. The proof is in docs/theory.md.

A plate's part of the potential energy is W z + the elastic energy of its two contacts, with the weight W on it and the
height z, over its apex, of the middle between the two vertices that face it. Over all positions of the vertices at a
tilt θ of the slider it is at least level − turn·(1 − cos θ), and at least corner + lift·sin |θ|. What remains of the
potential energy is that of the slider's height, upright·cos θ.
"""

import math
from typing import NamedTuple

from numba import njit

from activefail.bearing.design import GRAVITY
from activefail.bearing.dynamics import static_contact
from activefail.bearing.kernels import KERNEL


class Side(NamedTuple):
    """Coefficients of the two bounds on a plate's part of the potential energy [J]."""

    level: float
    turn: float
    corner: float
    lift: float


class Barrier(NamedTuple):
    """Potential energies of a bearing [J]."""

    least: float  # there is none below
    touch: float  # at least this where a vertex is at a rim
    failure: float  # at least this where the bearing fails


@njit(cache=True, **KERNEL)
def _give(load, stiffness):
    """The most that a vertex gains by sinking in under a load [N], max over δ of load·δ − 0.4 k δ^2.5 [J]."""
    return 0.6 * load * (load / stiffness) ** (2.0 / 3.0)


@njit(cache=True, **KERNEL)
def _held(weight, plate, half_width):
    """The bounds for a plate wherever the slider is."""
    height, penetration = static_contact(plate, half_width, weight)
    level = weight * height + 0.8 * plate.stiffness * penetration**2.5
    turn = weight * half_width * half_width / (plate.radius - height)
    return Side(level, turn, -_give(weight, plate.stiffness), weight * half_width)


@njit(cache=True, **KERNEL)
def _lost(weight, plate, half_width, rim_height):
    """The bounds for a plate from whose dish both vertices are the rim's height away."""
    depth = math.sqrt((plate.radius - rim_height) ** 2 - half_width * half_width)
    turn = weight * half_width * half_width / depth
    return Side(weight * (plate.radius - depth), turn, weight * rim_height, weight * half_width)


@njit(cache=True, **KERNEL)
def _least(bottom, top, upright, limit):
    """Least potential energy [J] up to a tilt, from the bounds for both plates."""
    level, turn = bottom.level + top.level + upright, bottom.turn + top.turn + upright
    corner, lift = bottom.corner + top.corner, bottom.lift + top.lift
    # The first bound falls with the tilt, the second is concave: the first counts up to any tilt that one likes, the
    # second from there on, and each has its least at an end.
    split = min(limit, math.asin(min(1.0, max(0.0, (level - corner - upright) / lift))))
    return min(
        level - turn * (1.0 - math.cos(split)),
        corner + lift * math.sin(split) + upright * math.cos(split),
        corner + lift * math.sin(limit) + upright * math.cos(limit),
    )


@njit(cache=True, **KERNEL)
def _least_raised(raised, energy, other, upright, limit):
    """Least potential energy [J] up to a tilt where it takes `energy` [J] to raise one vertex of a plate."""
    # The middle is below that vertex by half the width's rise at most; and `raised` bounds it as ever.
    corner, lift = energy + other.corner, other.lift - raised.lift
    split = min(limit, math.asin(min(1.0, max(0.0, (energy - raised.corner) / (2.0 * raised.lift)))))
    return min(
        corner + upright,
        corner + lift * math.sin(split) + upright * math.cos(split),
        raised.corner + other.corner + (raised.lift + other.lift) * math.sin(limit) + upright * math.cos(limit)
        if split < limit
        else math.inf,
    )


@njit(cache=True, **KERNEL)
def barrier(system, confinement):
    """The `Barrier` of a bearing, with heights over the bottom plate's apex; `confinement`: whether its loss counts."""
    plate, half_width = system.bottom, system.half_width
    if plate.radius < max(plate.rim_top, 2.0 * half_width):
        # So steep a dish that a vertex may be on the far side of its sphere, where it feels no force.
        return Barrier(-math.inf, -math.inf, -math.inf)
    on_bottom, on_top = (system.plate_mass + system.slider_mass) * GRAVITY, system.plate_mass * GRAVITY
    upright = (2.0 * system.plate_mass + system.slider_mass) * GRAVITY * system.half_height
    limit = system.tilt_limit
    bottom, top = _held(on_bottom, plate, half_width), _held(on_top, plate, half_width)

    cosine = math.sqrt(1.0 - (plate.rim_distance / plate.radius) ** 2)
    edge = plate.radius * (1.0 - cosine)
    at_rim_below = on_bottom * edge - _give(on_bottom / cosine, plate.stiffness)
    at_rim_above = on_top * edge - _give(on_top / cosine, plate.stiffness)
    touch = min(
        _least_raised(bottom, at_rim_below, top, upright, limit),
        _least_raised(top, at_rim_above, bottom, upright, limit),
    )
    escape = min(
        _least_raised(bottom, on_bottom * plate.rim_top, top, upright, limit),
        _least_raised(top, on_top * plate.rim_top, bottom, upright, limit),
    )
    overturning = bottom.corner + top.corner + (bottom.lift + top.lift) * math.sin(limit) + upright * math.cos(limit)
    failure = min(escape, overturning)
    if confinement:
        failure = min(
            failure,
            _least(_lost(on_bottom, plate, half_width, system.rim_height), top, upright, limit),
            _least(bottom, _lost(on_top, plate, half_width, system.rim_height), upright, limit),
        )
    return Barrier(_least(bottom, top, upright, limit), touch, failure)
