"""Rims that yield and break: how far a step moves their walls.

The wall of an arc, left or right, stands at D_out/2 + p from its dish's axis. The arcs of a plate are opposite parts of
a ring and far from each other, so each has its own plastic deformation p. Where the normal force would exceed the
strength S, the wall moves outwards as far as keeps the force at S: with δ = |u| − D_out/2 − p,

    k δ^(3/2) + c δ^(1/4) δ̇ = S

An arc that would move beyond its largest deformation breaks: its wall is at infinity. A step of the integrator takes p
as constant and the normal force as at most S (`contact`), which is exact while the wall moves; `yielded` then moves it.
"""

import math

from activefail.seismic.bearing.contact import beyond_rim, vertex_force, with_arc
from activefail.seismic.bearing.dynamics import lever, seen_by_plate, speed_seen_by_plate, with_parts
from activefail.seismic.bearing.kernels import KERNEL, kernel


@kernel(**KERNEL)
def _penetration(first, step, plate):
    """Penetration after a time `step` [s] at the strength, from the penetration `first` [m].

    It is y^(4/5), where c ẏ = 5/4 (S − k y^(6/5)) is regular at first touch. One implicit step, by Newton's method from
    above, which converges because the equation is convex.
    """
    begin, lag = first**1.25, plate.rim_damping / (1.25 * step)
    y = max(begin, plate.yield_penetration**1.25)
    for _ in range(8):
        slope = lag + 1.2 * plate.stiffness * y**0.2
        if slope > 0.0:
            y -= (lag * (y - begin) + plate.stiffness * y**1.2 - plate.strength) / slope
    return max(y, 0.0) ** 0.8


@kernel(**KERNEL)
def yielded(system, before, q, v, step):
    """The system whose walls have moved, from the coordinates `before` to the state (q, v) after a time `step` [s]."""
    for vertex in range(4):
        plate = system.bottom if vertex < 2 else system.top
        r_x, r_z = lever(system, vertex, q[2])
        u, w = seen_by_plate(vertex, r_x, r_z, q)
        du, dw = speed_seen_by_plate(vertex, r_x, r_z, v)
        if not vertex_force(u, w, du, dw, plate).demand > plate.strength:
            continue
        r_x, r_z = lever(system, vertex, before[2])
        u_before, _ = seen_by_plate(vertex, r_x, r_z, before)
        penetration = _penetration(max(0.0, beyond_rim(u_before, plate)), step, plate)
        arc = plate.right if u > 0.0 else plate.left
        arc += max(0.0, beyond_rim(u, plate) - penetration)
        if arc >= system.rim_deformation:
            arc = math.inf
        plate = with_arc(plate, u, arc)
        bottom, top = (plate, system.top) if vertex < 2 else (system.bottom, plate)
        system = with_parts(system, bottom, top, system.motion)
    return system


@kernel(**KERNEL)
def most_deformed(system):
    """Largest plastic deformation of an arc [m]; infinite if one is broken."""
    return max(system.bottom.left, system.bottom.right, system.top.left, system.top.right)
