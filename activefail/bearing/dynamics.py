"""Equations of motion of the planar bodies, their static equilibrium and their energy.

Coordinates (x_s, z_s, θ, x_t, z_t): the slider's centre and counter-clockwise rotation, and the apex of the top plate's
dish, in the frame of the bottom plate, which follows the ground. Metres, radians, seconds.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from activefail.bearing import integrator
from activefail.bearing.contact import Plate, vertex_force, vertex_jacobian
from activefail.bearing.design import GRAVITY, Bearing, Model, Pulse
from activefail.bearing.pulse import ground_acceleration, ground_jerk

COORDINATES = 5


class System(NamedTuple):
    """A bearing under a pulse, as the kernels see it."""

    slider_mass: float  # m [kg]
    slider_inertia: float  # I [kg m2]
    plate_mass: float  # M [kg]
    half_width: float  # D_sl/2 [m]
    half_height: float  # h_sl/2 [m]
    rim_height: float  # h_rim [m]
    bottom: Plate
    top: Plate
    amplitude: float  # A_p [m/s2]
    period: float  # T_p [s]


class Energy(NamedTuple):
    """Mechanical energy [J], and powers [W] at an instant."""

    stored: float  # kinetic, gravitational and elastic
    dissipation: float  # lost to friction and dampers
    input: float  # done by the ground motion's inertial forces


def system(bearing: Bearing, pulse: Pulse, model: Model) -> System:
    """The constants of the equations of motion (masses and dampers as the model's settings say)."""
    area = math.pi * bearing.slider_diameter**2 / 4.0
    slider_mass = model.slider_density * area * bearing.slider_height
    plate_mass = bearing.plate_mass
    if model.restitution == "pairwise":
        pair = slider_mass * plate_mass / (slider_mass + plate_mass)
        masses = ((slider_mass, slider_mass), (pair, pair))
    else:
        masses = ((plate_mass, 2.0 * plate_mass), (plate_mass, 2.0 * plate_mass))
    half_dish = bearing.dish_diameter / 2.0
    edge = bearing.radius - math.sqrt(bearing.radius**2 - half_dish**2)

    def plate(dish_mass: float, rim_mass: float) -> Plate:
        return Plate(
            radius=float(bearing.radius),
            rim_distance=half_dish,
            rim_top=edge + bearing.rim_height,
            stiffness=float(bearing.stiffness),
            dish_damping=2.0 * model.damping_ratio * math.sqrt(dish_mass * bearing.stiffness),
            rim_damping=2.0 * model.damping_ratio * math.sqrt(rim_mass * bearing.stiffness),
            mu=float(bearing.mu),
            friction_velocity=float(model.friction_velocity),
        )

    return System(
        slider_mass=slider_mass,
        slider_inertia=slider_mass * (bearing.slider_diameter**2 / 16.0 + bearing.slider_height**2 / 12.0),
        plate_mass=plate_mass,
        half_width=bearing.slider_diameter / 2.0,
        half_height=bearing.slider_height / 2.0,
        rim_height=float(bearing.rim_height),
        bottom=plate(*masses[0]),
        top=plate(*masses[1]),
        amplitude=float(pulse.amplitude),
        period=float(pulse.period),
    )


@njit(cache=True, error_model="numpy")
def _static_height(radius, half_width, load, stiffness):
    """Height of a pair of vertices above a dish's apex [m] when together they carry `load` [N]."""
    penetration = 0.0
    # A contraction with a factor of about δ/R: a few rounds reach rounding.
    for _ in range(60):
        distance = radius + penetration
        incline = math.sqrt(distance * distance - half_width * half_width) / distance
        penetration = (0.5 * load / (incline * stiffness)) ** (2.0 / 3.0)
    distance = radius + penetration
    return radius - math.sqrt(distance * distance - half_width * half_width)


@njit(cache=True, error_model="numpy")
def equilibrium(system):
    """Coordinates of the centred bearing at rest under gravity, shape (5,)."""
    slider, plate = system.slider_mass * GRAVITY, system.plate_mass * GRAVITY
    below = _static_height(system.bottom.radius, system.half_width, slider + plate, system.bottom.stiffness)
    above = _static_height(system.top.radius, system.half_width, plate, system.top.stiffness)
    z_s = below + system.half_height
    return np.array([0.0, z_s, 0.0, 0.0, z_s + system.half_height + above])


@njit(cache=True, error_model="numpy")
def lever(system, vertex, theta):
    """From the slider's centre to a vertex (0, 1: bottom left, right; 2, 3: top left, right) [m]."""
    b_x = system.half_width if vertex % 2 == 1 else -system.half_width
    b_z = system.half_height if vertex >= 2 else -system.half_height
    cosine, sine = math.cos(theta), math.sin(theta)
    return cosine * b_x - sine * b_z, sine * b_x + cosine * b_z


@njit(cache=True, error_model="numpy")
def seen_by_plate(vertex, r_x, r_z, q):
    """Position (u, w) of a vertex as the plate that it faces sees it [m]."""
    if vertex < 2:
        return q[0] + r_x, q[1] + r_z
    return q[0] + r_x - q[3], q[4] - q[1] - r_z


@njit(cache=True, error_model="numpy")
def speed_seen_by_plate(vertex, r_x, r_z, v):
    """Velocity of a vertex as the plate that it faces sees it [m/s]."""
    if vertex < 2:
        return v[0] - v[2] * r_z, v[1] + v[2] * r_x
    return v[0] - v[2] * r_z - v[3], v[4] - v[1] - v[2] * r_x


@njit(cache=True, error_model="numpy")
def dfp_acceleration(system, t, q, v, out):
    """Accelerations of the five coordinates, written into `out`, shape (5,)."""
    f_x, f_z, torque, top_x, top_z = 0.0, 0.0, 0.0, 0.0, 0.0
    for vertex in range(4):
        r_x, r_z = lever(system, vertex, q[2])
        u, w = seen_by_plate(vertex, r_x, r_z, q)
        du, dw = speed_seen_by_plate(vertex, r_x, r_z, v)
        if vertex < 2:
            force = vertex_force(u, w, du, dw, system.bottom)
            on_x, on_z = force.u, force.w
        else:
            force = vertex_force(u, w, du, dw, system.top)
            on_x, on_z = force.u, -force.w
            top_x -= on_x
            top_z -= on_z
        f_x += on_x
        f_z += on_z
        torque += r_x * on_z - r_z * on_x
    ground = ground_acceleration(t, system.amplitude, system.period)
    out[0] = f_x / system.slider_mass - ground
    out[1] = f_z / system.slider_mass - GRAVITY
    out[2] = torque / system.slider_inertia
    out[3] = top_x / system.plate_mass - ground
    out[4] = top_z / system.plate_mass - GRAVITY


@njit(cache=True, error_model="numpy")
def dfp_linearisation(system, t, q, v, by_q, by_v, by_t):
    """∂a/∂q, ∂a/∂v, shapes (5, 5), and ∂a/∂t, shape (5,), analytically."""
    by_q[:] = 0.0
    by_v[:] = 0.0
    omega = v[2]
    for vertex in range(4):
        r_x, r_z = lever(system, vertex, q[2])
        u, w = seen_by_plate(vertex, r_x, r_z, q)
        du, dw = speed_seen_by_plate(vertex, r_x, r_z, v)
        # The top plate sees the vertical axis reversed.
        if vertex < 2:
            sign = 1.0
            f_u, f_w, fu_u, fu_w, fu_du, fu_dw, fw_u, fw_w, fw_du, fw_dw = vertex_jacobian(u, w, du, dw, system.bottom)
        else:
            sign = -1.0
            f_u, f_w, fu_u, fu_w, fu_du, fu_dw, fw_u, fw_w, fw_du, fw_dw = vertex_jacobian(u, w, du, dw, system.top)
        if f_u == 0.0 and f_w == 0.0 and fu_u == 0.0 and fw_w == 0.0 and fu_du == 0.0 and fw_dw == 0.0:
            continue
        # Horizontal (x) and vertical (z) force on the slider by slider position, angle, and their rates.
        x_x, x_z = fu_u, sign * fu_w
        z_x, z_z = sign * fw_u, fw_w
        x_vx, x_vz = fu_du, sign * fu_dw
        z_vx, z_vz = sign * fw_du, fw_dw
        x_theta = -r_z * x_x + r_x * x_z - omega * (r_x * x_vx + r_z * x_vz)
        z_theta = -r_z * z_x + r_x * z_z - omega * (r_x * z_vx + r_z * z_vz)
        x_omega = -r_z * x_vx + r_x * x_vz
        z_omega = -r_z * z_vx + r_x * z_vz
        f_x, f_z = f_u, sign * f_w

        by_q[0, 0] += x_x
        by_q[0, 1] += x_z
        by_q[0, 2] += x_theta
        by_q[1, 0] += z_x
        by_q[1, 1] += z_z
        by_q[1, 2] += z_theta
        by_q[2, 0] += r_x * z_x - r_z * x_x
        by_q[2, 1] += r_x * z_z - r_z * x_z
        by_q[2, 2] += r_x * z_theta - r_z * x_theta - r_z * f_z - r_x * f_x
        by_v[0, 0] += x_vx
        by_v[0, 1] += x_vz
        by_v[0, 2] += x_omega
        by_v[1, 0] += z_vx
        by_v[1, 1] += z_vz
        by_v[1, 2] += z_omega
        by_v[2, 0] += r_x * z_vx - r_z * x_vx
        by_v[2, 1] += r_x * z_vz - r_z * x_vz
        by_v[2, 2] += r_x * z_omega - r_z * x_omega
        if vertex >= 2:
            # The top plate's position enters with the opposite sign of the slider's, and so does its force.
            for matrix, xx, xz, zx, zz, xt, zt in (
                (by_q, x_x, x_z, z_x, z_z, x_theta, z_theta),
                (by_v, x_vx, x_vz, z_vx, z_vz, x_omega, z_omega),
            ):
                matrix[0, 3] -= xx
                matrix[0, 4] -= xz
                matrix[1, 3] -= zx
                matrix[1, 4] -= zz
                matrix[2, 3] -= r_x * zx - r_z * xx
                matrix[2, 4] -= r_x * zz - r_z * xz
                matrix[3, 0] -= xx
                matrix[3, 1] -= xz
                matrix[3, 2] -= xt
                matrix[4, 0] -= zx
                matrix[4, 1] -= zz
                matrix[4, 2] -= zt
                matrix[3, 3] += xx
                matrix[3, 4] += xz
                matrix[4, 3] += zx
                matrix[4, 4] += zz
    for i in range(5):
        by_q[0, i] /= system.slider_mass
        by_q[1, i] /= system.slider_mass
        by_q[2, i] /= system.slider_inertia
        by_q[3, i] /= system.plate_mass
        by_q[4, i] /= system.plate_mass
        by_v[0, i] /= system.slider_mass
        by_v[1, i] /= system.slider_mass
        by_v[2, i] /= system.slider_inertia
        by_v[3, i] /= system.plate_mass
        by_v[4, i] /= system.plate_mass
    jerk = ground_jerk(t, system.amplitude, system.period)
    by_t[0] = -jerk
    by_t[1] = 0.0
    by_t[2] = 0.0
    by_t[3] = -jerk
    by_t[4] = 0.0


@overload(integrator.acceleration)
def _acceleration(problem, t, q, v, out):
    if getattr(problem, "instance_class", None) is System:
        return lambda problem, t, q, v, out: dfp_acceleration(problem, t, q, v, out)
    return None


@overload(integrator.linearisation)
def _linearisation(problem, t, q, v, by_q, by_v, by_t):
    if getattr(problem, "instance_class", None) is System:
        return lambda problem, t, q, v, by_q, by_v, by_t: dfp_linearisation(problem, t, q, v, by_q, by_v, by_t)
    return None


@njit(cache=True, error_model="numpy")
def energy(system, t, q, v):
    """Stored energy [J], dissipated power and the ground motion's power [W] at a state; an `Energy`."""
    m, M = system.slider_mass, system.plate_mass
    stored = 0.5 * m * (v[0] * v[0] + v[1] * v[1]) + 0.5 * system.slider_inertia * v[2] * v[2]
    stored += 0.5 * M * (v[3] * v[3] + v[4] * v[4]) + GRAVITY * (m * q[1] + M * q[4])
    dissipation = 0.0
    for vertex in range(4):
        r_x, r_z = lever(system, vertex, q[2])
        u, w = seen_by_plate(vertex, r_x, r_z, q)
        du, dw = speed_seen_by_plate(vertex, r_x, r_z, v)
        force = vertex_force(u, w, du, dw, system.bottom if vertex < 2 else system.top)
        stored += force.stored
        dissipation += force.dissipation
    ground = ground_acceleration(t, system.amplitude, system.period)
    return Energy(stored, dissipation, -(m * v[0] + M * v[3]) * ground)
