"""Energies below which a bearing can no longer touch a rim, or no longer fail; `simulation` ends a motion by them.

docs/theory.md has the proof.

A plate's part of the potential energy is W z plus the elastic energy of its two contacts, where W is the weight on it
and z the height above its apex of the midpoint of the two vertices that face it. Over all positions of the vertices at
a tilt θ of the slider, it is at least level − turn·(1 − cos θ), and at least corner + lift·sin |θ|. The rest of the
potential energy is that of the slider's height, upright·cos θ.
"""

import math
from typing import NamedTuple

from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.dynamics import static_contact
from activefail.seismic.bearing.kernels import KERNEL, kernel


class Side(NamedTuple):
    """Coefficients of the two bounds on a plate's part of the potential energy [J]."""

    level: float
    turn: float
    corner: float
    lift: float


class Barrier(NamedTuple):
    """Potential energies of a bearing [J]."""

    least: float  # minimum
    touch: float  # lower bound where a vertex is at a rim
    failure: float  # lower bound where the bearing fails


@kernel(**KERNEL)
def _give(load, stiffness):
    """Largest energy gain of a vertex from penetration under a load [N], max over δ of load·δ − 0.4 k δ^2.5 [J]."""
    return 0.6 * load * (load / stiffness) ** (2.0 / 3.0)


@kernel(**KERNEL)
def _held(weight, plate, half_width):
    """The bounds for a plate at any position of the slider."""
    height, penetration = static_contact(plate, half_width, weight)
    level = weight * height + 0.8 * plate.stiffness * penetration**2.5
    turn = weight * half_width * half_width / (plate.radius - height)
    return Side(level, turn, -_give(weight, plate.stiffness), weight * half_width)


@kernel(**KERNEL)
def _lost(weight, plate, half_width, rim_height):
    """The bounds for a plate if both vertices are at least the rim's height away from its dish."""
    rest = plate.radius - rim_height
    depth = math.sqrt(rest * rest - half_width * half_width)
    turn = weight * half_width * half_width / depth
    return Side(weight * (plate.radius - depth), turn, weight * rim_height, weight * half_width)


@kernel(**KERNEL)
def _least(bottom, top, upright, limit):
    """Least potential energy [J] up to a tilt `limit`, from the bounds for both plates."""
    level, turn = bottom.level + top.level + upright, bottom.turn + top.turn + upright
    corner, lift = bottom.corner + top.corner, bottom.lift + top.lift
    # The first bound decreases with the tilt, the second is concave. Using the first up to any tilt `split` and the
    # second beyond, each has its minimum at an end of its interval.
    split = min(limit, math.asin(min(1.0, max(0.0, (level - corner - upright) / lift))))
    return min(
        level - turn * (1.0 - math.cos(split)),
        corner + lift * math.sin(split) + upright * math.cos(split),
        corner + lift * math.sin(limit) + upright * math.cos(limit),
    )


@kernel(**KERNEL)
def _least_raised(raised, energy, other, upright, limit):
    """Least potential energy [J] up to a tilt if raising one vertex of a plate takes `energy` [J]."""
    # The midpoint is below that vertex by at most half the rise of the width; the bound `raised` still holds.
    corner, lift = energy + other.corner, other.lift - raised.lift
    split = min(limit, math.asin(min(1.0, max(0.0, (energy - raised.corner) / (2.0 * raised.lift)))))
    return min(
        corner + upright,
        corner + lift * math.sin(split) + upright * math.cos(split),
        raised.corner + other.corner + (raised.lift + other.lift) * math.sin(limit) + upright * math.cos(limit)
        if split < limit
        else math.inf,
    )


@kernel(**KERNEL)
def barrier(system, confinement):
    """The `Barrier` of a bearing, with heights above the bottom plate's apex.

    `confinement`: whether loss of confinement counts as failure.
    """
    plate, half_width = system.bottom, system.half_width
    if plate.radius < max(plate.rim_top, 2.0 * half_width):
        # In so steep a dish a vertex may be on the far side of its sphere, where no force acts.
        return Barrier(-math.inf, -math.inf, -math.inf)
    on_bottom, on_top = (system.plate_mass + system.slider_mass) * GRAVITY, system.plate_mass * GRAVITY
    upright = (2.0 * system.plate_mass + system.slider_mass) * GRAVITY * system.half_height
    limit = system.tilt_limit
    bottom, top = _held(on_bottom, plate, half_width), _held(on_top, plate, half_width)

    sine = plate.rim_distance / plate.radius
    cosine = math.sqrt(1.0 - sine * sine)
    edge = plate.radius * (1.0 - cosine)
    at_rim_below = on_bottom * edge - _give(on_bottom / cosine, plate.stiffness)
    at_rim_above = on_top * edge - _give(on_top / cosine, plate.stiffness)
    touch = min(
        _least_raised(bottom, at_rim_below, top, upright, limit),
        _least_raised(top, at_rim_above, bottom, upright, limit),
    )
    # A vertex escapes beyond the edge of a dish, even if there is no rim to rise above.
    escape = max(
        touch,
        min(
            _least_raised(bottom, on_bottom * plate.rim_top, top, upright, limit),
            _least_raised(top, on_top * plate.rim_top, bottom, upright, limit),
        ),
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
