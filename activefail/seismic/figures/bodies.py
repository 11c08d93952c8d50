"""The bodies of one simulated bearing, to scale at an instant, as shapes that a page or an animation fills.

All lengths are in the frame of the bottom plate, as in `seismic.bearing`; gaps come from its kernels.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from activefail.pages.figures import style
from activefail.seismic.bearing import Bearing
from activefail.seismic.bearing.contact import gap, meets_rim
from activefail.seismic.bearing.dynamics import lever, seen_by_plate
from activefail.seismic.bearing.motion import Motion
from activefail.space.space import Array

ARC_POINTS = 41
"""Points of a polygon along a spherical surface; the chords are within 0.1 mm of the arc."""

PLATE_THICKNESS = 0.15
"""Drawn thickness of the plates below their apex / D_sl; the model's plates have none."""

RIM_WIDTH = 0.12
"""Drawn width of the rims / D_sl; the model's rims are walls."""


def slider_outline(bearing: Bearing) -> Array:
    """Outline of the slider relative to its centre, shape (2 ARC_POINTS, 2) [m].

    Bottom arc from left to right, then top arc from right to left, both of radius R. Rows 0, ARC_POINTS − 1, ARC_POINTS
    and −1 are the vertices at the bottom left, bottom right, top right and top left.
    """
    half_width, half_height = bearing.slider_diameter / 2.0, bearing.slider_height / 2.0
    x = np.linspace(-half_width, half_width, ARC_POINTS)
    bulge = np.sqrt(bearing.radius**2 - x**2) - math.sqrt(bearing.radius**2 - half_width**2)
    bottom = np.column_stack((x, -half_height - bulge))
    return np.vstack((bottom, -bottom))


def plate_outline(bearing: Bearing, rims: bool = True) -> Array:
    """Outline of a plate, shape (ARC_POINTS + 6, 2): u from the dish's axis, w from its apex towards the slider [m].

    Args:
        bearing: the bearing.
        rims: whether the outline includes them.
    """
    half_dish = bearing.dish_diameter / 2.0
    u = np.linspace(-half_dish, half_dish, ARC_POINTS)
    w = bearing.radius - np.sqrt(bearing.radius**2 - u**2)
    top, back = w[-1] + rims * bearing.rim_height, -PLATE_THICKNESS * bearing.slider_diameter
    outer = half_dish + RIM_WIDTH * bearing.slider_diameter
    left = [(-outer, back), (-outer, top), (-half_dish, top)]
    right = [(half_dish, top), (outer, top), (outer, back)]
    return np.vstack((left, np.column_stack((u, w)), right))


def rim_outlines(bearing: Bearing) -> tuple[Array, Array]:
    """Outlines of a plate's left and right rim, shape (4, 2), in the coordinates of `plate_outline`."""
    half_dish = bearing.dish_diameter / 2.0
    edge = bearing.radius - math.sqrt(bearing.radius**2 - half_dish**2)
    outer, top = half_dish + RIM_WIDTH * bearing.slider_diameter, edge + bearing.rim_height
    right = np.array([(half_dish, edge), (outer, edge), (outer, top), (half_dish, top)])
    return right * (-1.0, 1.0), right


def plate_parts(motion: Motion) -> tuple[Array, tuple[Array, ...]]:
    """Outlines of a plate and of its rims, which are empty without rims; a rigid rim is part of the plate too."""
    bearing, kind = motion.response.bearing, motion.response.model.rim
    return plate_outline(bearing, kind == "rigid"), () if kind == "none" else rim_outlines(bearing)


def on_slider(outline: Array, q: Array) -> Array:
    """Transform an outline from the slider's centre, shape (n, 2), to the frame of the bottom plate."""
    cosine, sine = math.cos(q[2]), math.sin(q[2])
    rotated: Array = outline @ np.array(((cosine, sine), (-sine, cosine)))
    return rotated + q[:2]


def on_top_plate(outline: Array, q: Array) -> Array:
    """Transform an outline from the top plate's coordinates, shape (n, 2), to the frame of the bottom plate."""
    return outline * (1.0, -1.0) + q[3:]


def slider_vertices(motion: Motion, q: Array) -> Array:
    """The slider's vertices in the frame of the bottom plate, shape (4, 2): bottom left, right, top left, right [m]."""
    return np.array([q[:2] + lever(motion.system, vertex, q[2]) for vertex in range(4)])


BEARS, ON_RIM, OVER_RIM, LIFTED = range(4)
"""States of a vertex: bears on the dish alone, presses on the rim, has escaped over the rim, or touches neither."""

_ANGLES = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
_CIRCLE = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES)))
VERTEX_MARKS = (
    (_CIRCLE, style.BLACK),
    (np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]), style.VERMILION),
    (np.array([(-1.3, 0.0), (0.0, -1.3), (1.3, 0.0), (0.0, 1.3)]), style.YELLOW),
    (_CIRCLE, "#ffffff"),
)
"""The outline of each state's mark, of about radius 1, and its colour."""

MARKS = "black bears on the dish, red presses on the rim, yellow has escaped over the rim, white has lifted off"
"""What the marks of the slider's vertices mean."""


def vertex_states(motion: Motion, time: float) -> list[int]:
    """The state of each of the four vertices at a time [s]: `BEARS`, `ON_RIM`, `OVER_RIM` or `LIFTED`."""
    states, q, plates = [], motion.position(time), motion.plates(time)
    for vertex in range(4):
        plate = plates[vertex // 2]
        u, w = seen_by_plate(vertex, *lever(motion.system, vertex, q[2]), q)
        if meets_rim(u, w, plate):
            states.append(ON_RIM)
        elif abs(u) >= plate.rim_distance and w >= plate.rim_top:
            states.append(OVER_RIM)
        else:
            states.append(LIFTED if gap(u, w, plate) > 0.0 else BEARS)
    return states


def extent(motion: Motion) -> tuple[Array, Array]:
    """Lower left and upper right corner of a drawing of the whole motion, with a margin, shape (2,) each."""
    bearing = motion.response.bearing
    (plate, rims), body = plate_parts(motion), slider_outline(bearing)
    plate = np.vstack((plate, *rims))
    q = motion.position(motion.fine_times())
    bodies = [plate]
    # The polygons are outermost near the extremes of the coordinates; the margin covers the difference.
    for row in {int(extreme) for column in q.T for extreme in (column.argmin(), column.argmax())}:
        bodies += [on_top_plate(plate, q[row]), on_slider(body, q[row])]
    points = np.vstack(bodies)
    margin = 0.12 * bearing.slider_diameter
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    # Room for the arrow of the ground acceleration and its label.
    low[1] -= 0.45 * bearing.slider_diameter
    return low, high


class Shape(NamedTuple):
    """A polygon of a drawing.

    Attributes:
        outline: its vertices, (n, 2) [m].
        fill, edge: its colours; an empty fill leaves the outline.
        opacity: upper bodies are translucent, since bodies overlap where contact springs are compressed.
    """

    outline: Array
    fill: str
    edge: str
    opacity: float = 1.0


def shapes(motion: Motion, time: float) -> Iterator[Shape]:
    """The bodies at a time [s], clipped to the simulated motion, from the lowest to the uppermost.

    The plates with their rims, the slider with a mark at each vertex, and an arrow of the ground acceleration.
    """
    bearing, q = motion.response.bearing, motion.position(time)
    plate, rims = plate_parts(motion)
    arcs = motion.rims(time).tolist()
    yield from _half(plate, rims, arcs[:2], 1.0)
    for shape in _half(plate, rims, arcs[2:], 0.8):
        yield shape._replace(outline=on_top_plate(shape.outline, q))
    yield Shape(on_slider(slider_outline(bearing), q), style.SKY_BLUE, style.BLUE, 0.9)
    size = 0.03 * bearing.slider_diameter
    for vertex, state in zip(slider_vertices(motion, q), vertex_states(motion, time), strict=True):
        mark, colour = VERTEX_MARKS[state]
        yield Shape(vertex + size * mark, colour, style.BLACK)
    yield Shape(_arrow(motion, time), style.PURPLE, style.PURPLE)


def _half(plate: Array, rims: Sequence[Array], arcs: Sequence[float], opacity: float) -> Iterator[Shape]:
    """A plate with its rims, which move outwards as they yield; of a broken one, whose arc is NaN, a line is left."""
    yield Shape(plate, style.LIGHT_GREY, style.GREY, opacity)
    for outline, arc, side in zip(rims, arcs, (-1.0, 1.0), strict=False):
        if math.isfinite(arc):
            yield Shape(outline + np.array((side * arc, 0.0)), style.GREY, style.GREY, opacity)
        else:
            yield Shape(outline, "", style.VERMILION, opacity)


def _arrow(motion: Motion, time: float) -> Array:
    """An arrow below the bottom plate, proportional to the ground acceleration, shape (7, 2)."""
    bearing, pulse = motion.response.bearing, motion.response.pulse
    share = float(motion.ground(np.array([time]))[0]) / max(pulse.peak, 1e-12)
    length, half = 0.4 * bearing.dish_diameter * share, 0.03 * bearing.slider_diameter
    neck = length - math.copysign(min(abs(length), 5.0 * half), length)
    x = np.array((0.0, neck, neck, length, neck, neck, 0.0))
    z = np.array((1.0, 1.0, 2.5, 0.0, -2.5, -1.0, -1.0)) * half
    return np.column_stack((x, z - (PLATE_THICKNESS + 0.2) * bearing.slider_diameter))
