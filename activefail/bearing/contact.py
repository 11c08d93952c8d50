"""Force laws and geometry of a slider's vertex against the plate that it faces.

Everything here is in the plate's own frame: u is the horizontal distance of the vertex from the dish's axis
(positive to the right) and w its height above the dish's apex, towards the slider. Both plates look alike in it.
"""

import math
from typing import NamedTuple

from numba import njit

LEAST_PENETRATION = 1e-10
"""Floor of the penetration [m] in the damper's derivative, which is singular at first touch."""


class Plate(NamedTuple):
    """What a vertex meets: a dish with its rim."""

    radius: float  # R [m]
    rim_distance: float  # D_out/2 [m]
    rim_top: float  # z_e + h_rim, height of the rim's top above the apex [m]
    stiffness: float  # k [N/m^1.5]
    dish_damping: float  # 2 xi sqrt(m_eff k) on the dish [N s/m^1.25]
    rim_damping: float  # the same on the rim
    mu: float  # friction coefficient [-]
    friction_velocity: float  # v_r [m/s]


class Force(NamedTuple):
    """Forces of a plate on a vertex, split as the energy balance needs them."""

    u: float  # horizontal force [N]
    w: float  # force away from the plate [N]
    rim: float  # normal force of the rim [N]
    dissipation: float  # power of friction and damper, positive when energy is lost [W]
    stored: float  # elastic energy [J]


@njit(cache=True, error_model="numpy")
def gap(u, w, plate):
    """Distance of a vertex from the undeformed dish [m]; negative when it penetrates."""
    height = w - plate.radius
    return plate.radius - math.sqrt(u * u + height * height)


@njit(cache=True, error_model="numpy")
def meets_rim(u, w, plate):
    """Whether a vertex penetrates the rim, which has no lower end."""
    return abs(u) > plate.rim_distance and w < plate.rim_top


@njit(cache=True, error_model="numpy")
def _normal_force(penetration, rate, damping, stiffness):
    """Hertz normal force and the damper's share of it [N] (Jankowski 2006): damped while approaching only."""
    root = math.sqrt(penetration)
    damper = damping * math.sqrt(root) * rate if rate > 0.0 else 0.0
    return stiffness * penetration * root + damper, damper


@njit(cache=True, error_model="numpy")
def _friction(normal, slip, plate):
    """Regularised Coulomb friction [N] against the slip velocity [m/s]."""
    return -plate.mu * normal * slip / math.sqrt(slip * slip + plate.friction_velocity * plate.friction_velocity)


@njit(cache=True, error_model="numpy")
def vertex_force(u, w, du, dw, plate):
    """Force of dish and rim on a vertex at (u, w) [m] moving with (du, dw) [m/s]; a `Force`."""
    force_u, force_w, rim, dissipation, stored = 0.0, 0.0, 0.0, 0.0, 0.0
    height = plate.radius - w
    if height > 0.0:
        distance = math.sqrt(u * u + height * height)
        penetration = distance - plate.radius
        if penetration > 0.0:
            n_u, n_w = -u / distance, height / distance
            rate = -(du * n_u + dw * n_w)
            slip = du * n_w - dw * n_u
            normal, damper = _normal_force(penetration, rate, plate.dish_damping, plate.stiffness)
            friction = _friction(normal, slip, plate)
            force_u += normal * n_u + friction * n_w
            force_w += normal * n_w - friction * n_u
            dissipation += damper * rate - friction * slip
            stored += 0.4 * plate.stiffness * penetration * penetration * math.sqrt(penetration)
    if meets_rim(u, w, plate):
        side = 1.0 if u > 0.0 else -1.0
        penetration = abs(u) - plate.rim_distance
        rate = side * du
        rim, damper = _normal_force(penetration, rate, plate.rim_damping, plate.stiffness)
        friction = _friction(rim, dw, plate)
        force_u -= side * rim
        force_w += friction
        dissipation += damper * rate - friction * dw
        stored += 0.4 * plate.stiffness * penetration * penetration * math.sqrt(penetration)
    return Force(force_u, force_w, rim, dissipation, stored)


@njit(cache=True, error_model="numpy")
def _contact_jacobian(n_u, n_w, penetration, curvature, du, dw, damping, plate):
    """Force of one contact and its derivatives, a tuple of 10.

    (F_u, F_w, then ∂F_u and ∂F_w with respect to u, w, du, dw). The normal n turns by `curvature` [1/m] along the
    tangent t = (n_w, −n_u): dn = −t (t·dx)·curvature, dt = n (t·dx)·curvature; dδ = −n·dx.
    """
    t_u, t_w = n_w, -n_u
    rate = -(du * n_u + dw * n_w)
    slip = du * t_u + dw * t_w
    root = math.sqrt(penetration)
    normal = plate.stiffness * penetration * root
    normal_by_penetration = 1.5 * plate.stiffness * root
    normal_by_rate = 0.0
    if rate > 0.0:
        normal_by_rate = damping * math.sqrt(root)
        normal += normal_by_rate * rate
        # dN/dδ of the damper, c δ̇ / (4 δ^(3/4)), is singular at first touch.
        floored = max(penetration, LEAST_PENETRATION)
        normal_by_penetration += 0.25 * damping * rate * math.sqrt(math.sqrt(floored)) / floored
    norm = 1.0 / math.sqrt(slip * slip + plate.friction_velocity * plate.friction_velocity)
    share = slip * norm
    friction = -plate.mu * normal * share
    friction_by_slip = -plate.mu * normal * norm * (1.0 - share * share)

    # Subscripts: n, t a move along the normal and the tangent; vn, vt a change of velocity along them.
    normal_n = -normal_by_penetration
    normal_t = normal_by_rate * slip * curvature
    normal_vn = -normal_by_rate
    friction_n = -plate.mu * share * normal_n
    friction_t = -plate.mu * share * normal_t - friction_by_slip * rate * curvature
    friction_vn = -plate.mu * share * normal_vn
    friction_vt = friction_by_slip
    # F = N n + T t; the turning normal adds -N t + T n per tangential move.
    along_n_t = normal_t + friction * curvature
    along_t_t = friction_t - normal * curvature

    f_u = normal * n_u + friction * t_u
    f_w = normal * n_w + friction * t_w
    # columns: move along n and along t, turned into u and w
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


@njit(cache=True, error_model="numpy")
def vertex_jacobian(u, w, du, dw, plate):
    """Force of dish and rim on a vertex and its derivatives, as `_contact_jacobian` gives them, summed."""
    dish = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    rim = dish
    height = plate.radius - w
    if height > 0.0:
        distance = math.sqrt(u * u + height * height)
        penetration = distance - plate.radius
        if penetration > 0.0:
            dish = _contact_jacobian(
                -u / distance, height / distance, penetration, 1.0 / distance, du, dw, plate.dish_damping, plate
            )
    if meets_rim(u, w, plate):
        side = 1.0 if u > 0.0 else -1.0
        rim = _contact_jacobian(-side, 0.0, abs(u) - plate.rim_distance, 0.0, du, dw, plate.rim_damping, plate)
    return (
        dish[0] + rim[0],
        dish[1] + rim[1],
        dish[2] + rim[2],
        dish[3] + rim[3],
        dish[4] + rim[4],
        dish[5] + rim[5],
        dish[6] + rim[6],
        dish[7] + rim[7],
        dish[8] + rim[8],
        dish[9] + rim[9],
    )
