"""Force laws (contact, damping, friction) and geometry of a slider's vertex against the plate that it faces.

All quantities are in the plate's frame: u is the horizontal distance of the vertex from the dish's axis (positive to
the right) and w its height above the dish's apex, towards the slider. In this frame both plates are alike.
"""

import math
from typing import NamedTuple

from numba import njit, types
from numba.extending import overload

from activefail.seismic.bearing.kernels import INLINE, KERNEL, kernel
from activefail.seismic.bearing.lanes import any_positive, positive, sign, sqrt, where
from activefail.seismic.bearing.tuples import axpy

LEAST_PENETRATION = 1e-10
"""Floor of the penetration [m] in the damper's derivative, which is singular at first touch."""


class Plate(NamedTuple):
    """A dish with its rim."""

    radius: float  # R [m]
    rim_distance: float  # D_out/2 [m]
    rim_top: float  # z_e + h_rim, height of the rim's top above the apex [m]
    stiffness: float  # k [N/m^1.5]
    dish_damping: float  # 2 xi sqrt(m_eff k) on the dish [N s/m^1.25]
    rim_damping: float  # the same on the rim
    mu: float  # friction coefficient [-]
    friction_velocity: float  # v_r [m/s]
    strength: float = math.inf  # normal force at which the rim yields [N]; infinite if it is rigid
    yield_penetration: float = math.inf  # at which the Hertz spring has that force [m]
    left: float = 0.0  # plastic deformation of the rim's left arc [m]; infinite if it is broken
    right: float = 0.0


class Force(NamedTuple):
    """Forces of a plate on a vertex, with the terms of the energy balance."""

    u: float  # horizontal force [N]
    w: float  # force away from the plate [N]
    rim: float  # normal force of the rim [N]
    demand: float  # that of a rim that does not yield [N]
    dissipation: float  # power of friction and damper, positive when energy is lost [W]
    stored: float  # elastic energy [J]


@kernel(**KERNEL)
def gap(u, w, plate):
    """Distance of a vertex from the undeformed dish [m]; negative when it penetrates."""
    height = w - plate.radius
    return plate.radius - sqrt(u * u + height * height)


@njit(**INLINE)
def with_arc(plate, u, deformation):
    """A plate with this plastic deformation [m] of the arc on the side of u."""
    return Plate(
        plate.radius,
        plate.rim_distance,
        plate.rim_top,
        plate.stiffness,
        plate.dish_damping,
        plate.rim_damping,
        plate.mu,
        plate.friction_velocity,
        plate.strength,
        plate.yield_penetration,
        plate.left if u > 0.0 else deformation,
        deformation if u > 0.0 else plate.right,
    )


@njit(**INLINE)
def beyond_rim(u, plate):
    """Distance of a vertex beyond the rim's wall, which stands where plastic deformation has left it [m]."""
    return abs(u) - (plate.rim_distance + (where(u, plate.right) + where(0.0 - u, plate.left)))


@kernel(**KERNEL)
def meets_rim(u, w, plate):
    """Whether a vertex penetrates the rim, which extends downwards without end."""
    return beyond_rim(u, plate) > 0.0 and w < plate.rim_top


def _excess(value, limit):
    """Part of a value above its limit; 0 if that is None."""
    raise NotImplementedError


@overload(_excess, jit_options=INLINE)
def _excess_overload(value, limit):
    if isinstance(limit, types.NoneType):
        return lambda value, limit: 0.0
    return lambda value, limit: positive(value - limit)


@njit(**INLINE)
def _contact_force(n_u, n_w, penetration, du, dw, damping, strength, yield_penetration, plate):
    """Force of one contact with inward normal n: Hertz, damped while approaching [Jankowski2006], and friction.

    The normal force is at most `strength`, and the spring's beyond `yield_penetration` constant, unless these are None.
    The wall moves between steps (`rims`); within a step, the stored energy includes the plastic work.
    """
    rate, slip = -(du * n_u + dw * n_w), du * n_w - dw * n_u
    whole = positive(penetration)
    plastic = _excess(whole, yield_penetration)
    depth = whole - plastic
    root = sqrt(depth)
    damper = damping * sqrt(root) * positive(rate)
    normal = plate.stiffness * depth * root + damper
    excess = _excess(normal, strength)
    normal = normal - excess
    friction = -plate.mu * normal * slip / sqrt(slip * slip + plate.friction_velocity * plate.friction_velocity)
    return Force(
        normal * n_u + friction * n_w,
        normal * n_w - friction * n_u,
        normal,
        plate.stiffness * whole * sqrt(whole) + damper,
        (damper - excess) * rate - friction * slip,
        (0.4 * plate.stiffness * depth * depth + plate.stiffness * (plastic * depth)) * root,
    )


@njit(**INLINE)
def _into_rim(u, w, plate):
    """Penetration of the rim [m], positive only for a vertex in contact with it."""
    return where(plate.rim_top - w, beyond_rim(u, plate))


@njit(**INLINE)
def vertex_force(u, w, du, dw, plate):
    """`Force` of dish and rim on a vertex at (u, w) [m] with velocity (du, dw) [m/s].

    The arguments are numbers, or lanes of the four vertices.
    """
    height = plate.radius - w
    distance = sqrt(u * u + height * height)
    penetration = where(height, distance - plate.radius)
    dish = _contact_force(-u / distance, height / distance, penetration, du, dw, plate.dish_damping, None, None, plate)
    force_u, force_w, rim, dissipation, stored = dish.u, dish.w, 0.0 * dish.rim, dish.dissipation, dish.stored
    demand = rim
    if any_positive(where(plate.rim_top - w, abs(u) - plate.rim_distance)):
        penetration, limits = _into_rim(u, w, plate), (plate.strength, plate.yield_penetration)
        wall = _contact_force(-sign(u), 0.0 * u, penetration, du, dw, plate.rim_damping, *limits, plate)
        force_u, force_w, rim, demand = force_u + wall.u, force_w + wall.w, wall.rim, wall.demand
        dissipation, stored = dissipation + wall.dissipation, stored + wall.stored
    return Force(force_u, force_w, rim, demand, dissipation, stored)


@njit(**INLINE)
def _contact_jacobian(n_u, n_w, penetration, curvature, du, dw, damping, strength, yield_penetration, plate):
    """Force of one contact and its derivatives, a tuple of 10.

    (F_u, F_w, then ∂F_u and ∂F_w with respect to u, w, du, dw). The normal n turns by `curvature` [1/m] along the
    tangent t = (n_w, −n_u): dn = −t (t·dx)·curvature, dt = n (t·dx)·curvature; dδ = −n·dx.
    """
    t_u, t_w = n_w, -n_u
    rate, slip = -(du * n_u + dw * n_w), du * t_u + dw * t_w
    depth = positive(penetration)
    plastic = _excess(depth, yield_penetration)
    depth = depth - plastic
    root = sqrt(depth)
    normal_by_rate = where(rate, damping * sqrt(root))
    normal = plate.stiffness * depth * root + normal_by_rate * rate
    excess = _excess(normal, strength)
    normal = normal - excess
    # dN/dδ of the damper, c δ̇ / (4 δ^(3/4)), is singular at first touch.
    floored = LEAST_PENETRATION + positive(depth - LEAST_PENETRATION)
    singular = 0.25 * damping * positive(rate) * sqrt(sqrt(floored)) / floored
    normal_by_penetration = 1.5 * plate.stiffness * root + where(penetration, singular)
    # At the strength the normal force is constant.
    normal_by_penetration = normal_by_penetration - where(excess + plastic, normal_by_penetration)
    normal_by_rate = normal_by_rate - where(excess + plastic, normal_by_rate)
    norm = 1.0 / sqrt(slip * slip + plate.friction_velocity * plate.friction_velocity)
    share = slip * norm
    friction = -plate.mu * normal * share
    friction_by_slip = -plate.mu * normal * norm * (1.0 - share * share)

    # Subscripts: n and t, displacement along normal and tangent; vn and vt, velocity along them.
    normal_n = -normal_by_penetration
    normal_t = normal_by_rate * slip * curvature
    normal_vn = -normal_by_rate
    friction_n = -plate.mu * share * normal_n
    friction_t = -plate.mu * share * normal_t - friction_by_slip * rate * curvature
    friction_vn = -plate.mu * share * normal_vn
    friction_vt = friction_by_slip
    # F = N n + T t; the rotation of the normal adds (-N t + T n)·curvature per tangential displacement.
    along_n_t = normal_t + friction * curvature
    along_t_t = friction_t - normal * curvature

    f_u = normal * n_u + friction * t_u
    f_w = normal * n_w + friction * t_w
    # Columns: derivatives along n and t, rotated into u and w below.
    fu_n, fw_n = normal_n * n_u + friction_n * t_u, normal_n * n_w + friction_n * t_w
    fu_t, fw_t = along_n_t * n_u + along_t_t * t_u, along_n_t * n_w + along_t_t * t_w
    fu_vn, fw_vn = normal_vn * n_u + friction_vn * t_u, normal_vn * n_w + friction_vn * t_w
    fu_vt, fw_vt = friction_vt * t_u, friction_vt * t_w
    return (
        f_u,
        f_w,
        fu_n * n_u + fu_t * t_u,
        fu_n * n_w + fu_t * t_w,
        fu_vn * n_u + fu_vt * t_u,
        fu_vn * n_w + fu_vt * t_w,
        fw_n * n_u + fw_t * t_u,
        fw_n * n_w + fw_t * t_w,
        fw_vn * n_u + fw_vt * t_u,
        fw_vn * n_w + fw_vt * t_w,
    )


@njit(**INLINE)
def vertex_jacobian(u, w, du, dw, plate):
    """Force of dish and rim on a vertex and its derivatives, the sum of two `_contact_jacobian` tuples."""
    height = plate.radius - w
    distance = sqrt(u * u + height * height)
    penetration = where(height, distance - plate.radius)
    inverse = 1.0 / distance
    summed = _contact_jacobian(
        -u * inverse, height * inverse, penetration, inverse, du, dw, plate.dish_damping, None, None, plate
    )
    if any_positive(where(plate.rim_top - w, abs(u) - plate.rim_distance)):
        flat = 0.0 * u
        penetration, limits = _into_rim(u, w, plate), (plate.strength, plate.yield_penetration)
        rim = _contact_jacobian(-sign(u), flat, penetration, flat, du, dw, plate.rim_damping, *limits, plate)
        summed = axpy(1.0, summed, rim)
    return summed
