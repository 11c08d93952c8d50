"""Equations of motion of the planar bodies, their static equilibrium and their energy.

Coordinates (x_s, z_s, θ, x_t, z_t): the slider's centre and counter-clockwise rotation, and the apex of the top plate's
dish, in the frame of the bottom plate, which follows the ground. Metres, radians, seconds.
"""

import math
from typing import NamedTuple

from numba import njit
from numba.extending import overload

from activefail.bearing import integrator
from activefail.bearing.contact import Plate, vertex_force, vertex_jacobian
from activefail.bearing.design import GRAVITY, Bearing, Model, Pulse
from activefail.bearing.pulse import ground_acceleration, ground_jerk
from activefail.bearing.tuples import axpy, axpy_rows, scaled

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
def static_contact(plate, half_width, load):
    """Height over a dish's apex and penetration [m] of two level vertices that together carry `load` [N]."""
    penetration = 0.0
    # A contraction with a factor of about δ/R: a few rounds reach rounding.
    for _ in range(20):
        distance = plate.radius + penetration
        incline = math.sqrt(distance * distance - half_width * half_width) / distance
        penetration = (0.5 * load / (incline * plate.stiffness)) ** (2.0 / 3.0)
    distance = plate.radius + penetration
    return plate.radius - math.sqrt(distance * distance - half_width * half_width), penetration


@njit(cache=True, error_model="numpy")
def equilibrium(system):
    """Coordinates of the centred bearing at rest under gravity."""
    slider, plate = system.slider_mass * GRAVITY, system.plate_mass * GRAVITY
    below, _ = static_contact(system.bottom, system.half_width, slider + plate)
    above, _ = static_contact(system.top, system.half_width, plate)
    z_s = below + system.half_height
    return 0.0, z_s, 0.0, 0.0, z_s + system.half_height + above


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


@njit(forceinline=True, error_model="numpy")
def _force_on_slider(system, vertex, q, v):
    """Force (x, z) and moment about the slider's centre at a vertex."""
    r_x, r_z = lever(system, vertex, q[2])
    u, w = seen_by_plate(vertex, r_x, r_z, q)
    du, dw = speed_seen_by_plate(vertex, r_x, r_z, v)
    force = vertex_force(u, w, du, dw, system.bottom if vertex < 2 else system.top)
    # The top plate sees the vertical axis reversed.
    f_x, f_z = force.u, force.w if vertex < 2 else -force.w
    return f_x, f_z, r_x * f_z - r_z * f_x


@njit(forceinline=True, error_model="numpy")
def _accelerations(system, below, above, ground):
    """Accelerations from the forces on the slider at its bottom vertices and at its top ones, and the ground's."""
    slider, plate = 1.0 / system.slider_mass, 1.0 / system.plate_mass
    return (
        slider * (below[0] + above[0]) - ground,
        slider * (below[1] + above[1]) - GRAVITY,
        (below[2] + above[2]) / system.slider_inertia,
        -plate * above[0] - ground,
        -plate * above[1] - GRAVITY,
    )


@njit(cache=True, error_model="numpy")
def dfp_acceleration(system, t, q, v):
    """Accelerations of the five coordinates."""
    below = axpy(1.0, _force_on_slider(system, 0, q, v), _force_on_slider(system, 1, q, v))
    above = axpy(1.0, _force_on_slider(system, 2, q, v), _force_on_slider(system, 3, q, v))
    return _accelerations(system, below, above, ground_acceleration(t, system.amplitude, system.period))


@njit(forceinline=True, error_model="numpy")
def _linearised_force(system, vertex, q, v):
    """Force (x, z) and moment on the slider at a vertex, and their derivatives by (x_s, z_s, θ) and by the velocities."""
    r_x, r_z = lever(system, vertex, q[2])
    u, w = seen_by_plate(vertex, r_x, r_z, q)
    du, dw = speed_seen_by_plate(vertex, r_x, r_z, v)
    f_u, f_w, fu_u, fu_w, fu_du, fu_dw, fw_u, fw_w, fw_du, fw_dw = vertex_jacobian(
        u, w, du, dw, system.bottom if vertex < 2 else system.top
    )
    # The top plate sees the vertical axis reversed.
    sign = 1.0 if vertex < 2 else -1.0
    f_x, f_z = f_u, sign * f_w
    x_x, x_z, z_x, z_z = fu_u, sign * fu_w, sign * fw_u, fw_w
    x_vx, x_vz, z_vx, z_vz = fu_du, sign * fu_dw, sign * fw_du, fw_dw
    omega = v[2]
    x_theta = -r_z * x_x + r_x * x_z - omega * (r_x * x_vx + r_z * x_vz)
    z_theta = -r_z * z_x + r_x * z_z - omega * (r_x * z_vx + r_z * z_vz)
    x_omega = -r_z * x_vx + r_x * x_vz
    z_omega = -r_z * z_vx + r_x * z_vz
    force = (f_x, f_z, r_x * f_z - r_z * f_x)
    by_position = (
        (x_x, x_z, x_theta),
        (z_x, z_z, z_theta),
        (
            r_x * z_x - r_z * x_x,
            r_x * z_z - r_z * x_z,
            r_x * z_theta - r_z * x_theta - r_z * f_z - r_x * f_x,
        ),
    )
    by_velocity = (
        (x_vx, x_vz, x_omega),
        (z_vx, z_vz, z_omega),
        (r_x * z_vx - r_z * x_vx, r_x * z_vz - r_z * x_vz, r_x * z_omega - r_z * x_omega),
    )
    return force, by_position, by_velocity


@njit(forceinline=True, error_model="numpy")
def _by_coordinates(system, below, above):
    """∂a of all coordinates from the derivatives at the bottom vertices and at the top ones, each 3 x 3.

    The top plate's position enters with the opposite sign of the slider's, and so does its force.
    """
    slider, turn, plate = 1.0 / system.slider_mass, 1.0 / system.slider_inertia, 1.0 / system.plate_mass
    both = axpy_rows(1.0, below, above)
    return (
        scaled(slider, (*both[0], -above[0][0], -above[0][1])),
        scaled(slider, (*both[1], -above[1][0], -above[1][1])),
        scaled(turn, (*both[2], -above[2][0], -above[2][1])),
        scaled(-plate, (*above[0], -above[0][0], -above[0][1])),
        scaled(-plate, (*above[1], -above[1][0], -above[1][1])),
    )


@njit(cache=True, error_model="numpy")
def dfp_linearisation(system, t, q, v):
    """Accelerations, ∂a/∂q and ∂a/∂v (5 rows each) and ∂a/∂t, analytically."""
    force_0, by_q_0, by_v_0 = _linearised_force(system, 0, q, v)
    force_1, by_q_1, by_v_1 = _linearised_force(system, 1, q, v)
    force_2, by_q_2, by_v_2 = _linearised_force(system, 2, q, v)
    force_3, by_q_3, by_v_3 = _linearised_force(system, 3, q, v)
    ground = ground_acceleration(t, system.amplitude, system.period)
    jerk = ground_jerk(t, system.amplitude, system.period)
    return (
        _accelerations(system, axpy(1.0, force_0, force_1), axpy(1.0, force_2, force_3), ground),
        _by_coordinates(system, axpy_rows(1.0, by_q_0, by_q_1), axpy_rows(1.0, by_q_2, by_q_3)),
        _by_coordinates(system, axpy_rows(1.0, by_v_0, by_v_1), axpy_rows(1.0, by_v_2, by_v_3)),
        (-jerk, 0.0, 0.0, -jerk, 0.0),
    )


@overload(integrator.acceleration)
def _acceleration(problem, t, q, v):
    if getattr(problem, "instance_class", None) is System:
        return lambda problem, t, q, v: dfp_acceleration(problem, t, q, v)
    return None


@overload(integrator.linearisation)
def _linearisation(problem, t, q, v):
    if getattr(problem, "instance_class", None) is System:
        return lambda problem, t, q, v: dfp_linearisation(problem, t, q, v)
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
