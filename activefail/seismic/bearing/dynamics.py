"""Equations of motion of the planar bodies, their static equilibrium and their energy.

Coordinates (x_s, z_s, θ, x_t, z_t): the slider's centre and counter-clockwise rotation, and the apex of the top plate's
dish, in the frame of the bottom plate, which moves with the ground. Units: metres, radians, seconds.
"""

import math
from typing import NamedTuple

from numba import njit
from numba.extending import overload

from activefail.seismic.bearing import ground, integrator
from activefail.seismic.bearing.contact import Plate, vertex_force, vertex_jacobian
from activefail.seismic.bearing.design import GRAVITY, Bearing, Model, Pulse
from activefail.seismic.bearing.ground import Ricker, Segment
from activefail.seismic.bearing.kernels import INLINE, KERNEL, kernel
from activefail.seismic.bearing.lanes import Lanes, lanes, numbers
from activefail.seismic.bearing.tuples import axpy_rows, scaled

COORDINATES = 5


class System(NamedTuple):
    """The constants of a bearing and its ground motion, for the kernels."""

    slider_mass: float  # m [kg]
    slider_inertia: float  # I [kg m2]
    plate_mass: float  # M [kg]
    half_width: float  # D_sl/2 [m]
    half_height: float  # h_sl/2 [m]
    rim_height: float  # h_rim [m]
    tilt_limit: float  # tilt beyond which the slider overturns [rad]
    rim_deformation: float  # plastic deformation at which an arc of a rim breaks [m]; infinite if it is rigid
    bottom: Plate
    top: Plate
    motion: Ricker | Segment  # of the ground


class Energy(NamedTuple):
    """Mechanical energy [J], and powers [W] at an instant."""

    stored: float  # kinetic, gravitational and elastic
    dissipation: float  # power lost to friction and dampers
    input: float  # power of the ground motion's inertial forces


def system(bearing: Bearing, motion: Pulse | Segment, model: Model) -> System:
    """The constants of the equations of motion, with masses and dampers from the model's settings."""
    area = math.pi * bearing.slider_diameter**2 / 4.0
    slider_mass = model.slider_density * area * bearing.slider_height
    plate_mass = bearing.plate_mass
    if model.restitution == "pairwise":
        pair = slider_mass * plate_mass / (slider_mass + plate_mass)
        masses = ((slider_mass, slider_mass), (pair, pair))
    else:
        masses = ((plate_mass, 2.0 * plate_mass), (plate_mass, 2.0 * plate_mass))
    strength, deformation = model.rim_limits
    yields = (strength * plate_mass * GRAVITY / bearing.stiffness) ** (2.0 / 3.0)
    half_dish = bearing.dish_diameter / 2.0
    edge = bearing.radius - math.sqrt(bearing.radius**2 - half_dish**2)

    def plate(dish_mass: float, rim_mass: float) -> Plate:
        return Plate(
            radius=float(bearing.radius),
            rim_distance=half_dish,
            rim_top=-math.inf if model.rim == "none" else edge + bearing.rim_height,
            stiffness=float(bearing.stiffness),
            dish_damping=2.0 * model.damping_ratio * math.sqrt(dish_mass * bearing.stiffness),
            rim_damping=2.0 * model.damping_ratio * math.sqrt(rim_mass * bearing.stiffness),
            mu=float(bearing.mu),
            friction_velocity=float(model.friction_velocity),
            strength=bearing.stiffness * yields * math.sqrt(yields),
            yield_penetration=yields,
        )

    return System(
        slider_mass=slider_mass,
        slider_inertia=slider_mass * (bearing.slider_diameter**2 / 16.0 + bearing.slider_height**2 / 12.0),
        plate_mass=plate_mass,
        half_width=bearing.slider_diameter / 2.0,
        half_height=bearing.slider_height / 2.0,
        rim_height=float(bearing.rim_height),
        tilt_limit=math.atan2(bearing.slider_diameter, bearing.slider_height),
        rim_deformation=deformation,
        bottom=plate(*masses[0]),
        top=plate(*masses[1]),
        motion=Ricker(float(motion.amplitude), float(motion.period)) if isinstance(motion, Pulse) else motion,
    )


@njit(**INLINE)
def with_parts(system, bottom, top, motion):
    """A system with these plates and this motion of the ground, which may be of another type."""
    return System(
        system.slider_mass,
        system.slider_inertia,
        system.plate_mass,
        system.half_width,
        system.half_height,
        system.rim_height,
        system.tilt_limit,
        system.rim_deformation,
        bottom,
        top,
        motion,
    )


@kernel(**KERNEL)
def static_contact(plate, half_width, load):
    """Height above a dish's apex and penetration [m] of two level vertices that together carry `load` [N]."""
    penetration = 0.0
    # A contraction with a factor of about δ/R, which converges to rounding in a few iterations.
    for _ in range(20):
        distance = plate.radius + penetration
        incline = math.sqrt(distance * distance - half_width * half_width) / distance
        penetration = (0.5 * load / (incline * plate.stiffness)) ** (2.0 / 3.0)
    distance = plate.radius + penetration
    return plate.radius - math.sqrt(distance * distance - half_width * half_width), penetration


@kernel(**KERNEL)
def equilibrium(system):
    """Coordinates of the centred bearing at rest under gravity."""
    slider, plate = system.slider_mass * GRAVITY, system.plate_mass * GRAVITY
    below, _ = static_contact(system.bottom, system.half_width, slider + plate)
    above, _ = static_contact(system.top, system.half_width, plate)
    z_s = below + system.half_height
    return 0.0, z_s, 0.0, 0.0, z_s + system.half_height + above


@njit(**INLINE)
def cosine_and_sine(angle):
    """cos and sin of an angle [rad], accurate except for the last digit; the polynomials of Cephes up to π/4."""
    if abs(angle) > 0.25 * math.pi:
        return math.cos(angle), math.sin(angle)
    z = angle * angle
    sine = 2.75573136213857245213e-6 + z * (-2.50507477628578072866e-8 + z * 1.58962301576546568060e-10)
    sine = -1.66666666666666307295e-1 + z * (8.33333333332211858878e-3 + z * (-1.98412698295895385996e-4 + z * sine))
    cosine = -2.75573141792967388112e-7 + z * (2.08757008419747316778e-9 - z * 1.13585365213876817300e-11)
    cosine = 4.16666666666665929218e-2 + z * (-1.38888888888730564116e-3 + z * (2.48015872888517045348e-5 + z * cosine))
    return 1.0 - 0.5 * z + z * z * cosine, angle + angle * z * sine


@kernel(**KERNEL)
def lever(system, vertex, theta):
    """Vector from the slider's centre to a vertex (0, 1: bottom left, right; 2, 3: top left, right) [m]."""
    b_x = system.half_width if vertex % 2 == 1 else -system.half_width
    b_z = system.half_height if vertex >= 2 else -system.half_height
    cosine, sine = cosine_and_sine(theta)
    return cosine * b_x - sine * b_z, sine * b_x + cosine * b_z


@kernel(**KERNEL)
def seen_by_plate(vertex, r_x, r_z, q):
    """Position (u, w) of a vertex in the frame of the plate that it faces [m]."""
    if vertex < 2:
        return q[0] + r_x, q[1] + r_z
    return q[0] + r_x - q[3], q[4] - q[1] - r_z


@kernel(**KERNEL)
def speed_seen_by_plate(vertex, r_x, r_z, v):
    """Velocity of a vertex in the frame of the plate that it faces [m/s]."""
    if vertex < 2:
        return v[0] - v[2] * r_z, v[1] + v[2] * r_x
    return v[0] - v[2] * r_z - v[3], v[4] - v[1] - v[2] * r_x


class Vertices(NamedTuple):
    """The slider's four vertices, as lanes in the order of `lever`."""

    r_x: Lanes  # from the slider's centre [m]
    r_z: Lanes
    up: Lanes  # vertical direction away from the facing plate, 1 or -1
    u: Lanes  # position and velocity in that plate's frame [m], [m/s]
    w: Lanes
    du: Lanes
    dw: Lanes
    plate: Plate  # with lanes as attributes, except the strength


@njit(**INLINE)
def _sides(bottom, top):
    """Lanes of a quantity that differs only between the plates."""
    return lanes(bottom, bottom, top, top)


@njit(**INLINE)
def vertices(system, q, v):
    """The `Vertices` at a state."""
    bottom, top = system.bottom, system.top
    width, height = system.half_width, system.half_height
    cosine, sine = cosine_and_sine(q[2])
    b_x, b_z = lanes(-width, width, -width, width), lanes(-height, -height, height, height)
    r_x, r_z = cosine * b_x - sine * b_z, sine * b_x + cosine * b_z
    up = lanes(1.0, 1.0, -1.0, -1.0)
    plate = Plate(
        _sides(bottom.radius, top.radius),
        _sides(bottom.rim_distance, top.rim_distance),
        _sides(bottom.rim_top, top.rim_top),
        _sides(bottom.stiffness, top.stiffness),
        _sides(bottom.dish_damping, top.dish_damping),
        _sides(bottom.rim_damping, top.rim_damping),
        _sides(bottom.mu, top.mu),
        _sides(bottom.friction_velocity, top.friction_velocity),
        # The same for both plates, so that they are spread over lanes only where a rim is touched.
        bottom.strength,
        bottom.yield_penetration,
        _sides(bottom.left, top.left),
        _sides(bottom.right, top.right),
    )
    u = r_x + _sides(q[0], q[0] - q[3])
    w = up * r_z + _sides(q[1], q[4] - q[1])
    du = _sides(v[0], v[0] - v[3]) - v[2] * r_z
    dw = _sides(v[1], v[4] - v[1]) + v[2] * (up * r_x)
    return Vertices(r_x, r_z, up, u, w, du, dw, plate)


@njit(**INLINE)
def of_plates(x):
    """Sums over the vertices that face the bottom plate, and over those that face the top plate."""
    a, b, c, d = numbers(x)
    return a + b, c + d


@njit(**INLINE)
def _accelerations(system, f_x, f_z, moment, moved, risen):
    """Accelerations, from the forces and moments of the bottom and the top plate on the slider, and the ground's.

    `moved` is the ground's horizontal acceleration, `risen` the vertical one, up [m/s2].
    """
    slider, plate = 1.0 / system.slider_mass, 1.0 / system.plate_mass
    return (
        slider * (f_x[0] + f_x[1]) - moved,
        slider * (f_z[0] + f_z[1]) - (GRAVITY + risen),
        (moment[0] + moment[1]) / system.slider_inertia,
        -plate * f_x[1] - moved,
        -plate * f_z[1] - (GRAVITY + risen),
    )


@kernel(**KERNEL)
def dfp_acceleration(system, t, q, v):
    """Accelerations of the five coordinates."""
    at = vertices(system, q, v)
    force = vertex_force(at.u, at.w, at.du, at.dw, at.plate)
    f_x, f_z = force.u, at.up * force.w
    moment = at.r_x * f_z - at.r_z * f_x
    moved, risen = ground.acceleration(system.motion, t), ground.vertical(system.motion, t)
    return _accelerations(system, of_plates(f_x), of_plates(f_z), of_plates(moment), moved, risen)


@njit(**INLINE)
def _by_coordinates(system, below, above):
    """Derivatives of all accelerations, from those at the bottom and at the top vertices, each 3 x 3.

    The top plate's position and force have the opposite sign of the slider's.
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


@njit(**INLINE)
def _of_plates_rows(rows):
    """Two 3 x 3 matrices from 3 x 3 lanes, summed over the vertices of each plate."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    (a_0, a_1), (b_0, b_1), (c_0, c_1) = of_plates(a), of_plates(b), of_plates(c)
    (d_0, d_1), (e_0, e_1), (f_0, f_1) = of_plates(d), of_plates(e), of_plates(f)
    (g_0, g_1), (h_0, h_1), (i_0, i_1) = of_plates(g), of_plates(h), of_plates(i)
    return ((a_0, b_0, c_0), (d_0, e_0, f_0), (g_0, h_0, i_0)), ((a_1, b_1, c_1), (d_1, e_1, f_1), (g_1, h_1, i_1))


@kernel(**KERNEL)
def dfp_linearisation(system, t, q, v):
    """Accelerations, ∂a/∂q and ∂a/∂v (5 rows each) and ∂a/∂t, in closed form."""
    at = vertices(system, q, v)
    r_x, r_z, omega = at.r_x, at.r_z, v[2]
    f_u, f_w, fu_u, fu_w, fu_du, fu_dw, fw_u, fw_w, fw_du, fw_dw = vertex_jacobian(at.u, at.w, at.du, at.dw, at.plate)
    # Derivatives of the force on the slider by its position (x, z, θ) and velocity.
    f_x, f_z = f_u, at.up * f_w
    x_x, x_z, z_x, z_z = fu_u, at.up * fu_w, at.up * fw_u, fw_w
    x_vx, x_vz, z_vx, z_vz = fu_du, at.up * fu_dw, at.up * fw_du, fw_dw
    x_theta = r_x * x_z - r_z * x_x - omega * (r_x * x_vx + r_z * x_vz)
    z_theta = r_x * z_z - r_z * z_x - omega * (r_x * z_vx + r_z * z_vz)
    x_omega, z_omega = r_x * x_vz - r_z * x_vx, r_x * z_vz - r_z * z_vx
    by_position = (
        (x_x, x_z, x_theta),
        (z_x, z_z, z_theta),
        (r_x * z_x - r_z * x_x, r_x * z_z - r_z * x_z, r_x * (z_theta - f_x) - r_z * (x_theta + f_z)),
    )
    by_velocity = (
        (x_vx, x_vz, x_omega),
        (z_vx, z_vz, z_omega),
        (r_x * z_vx - r_z * x_vx, r_x * z_vz - r_z * x_vz, r_x * z_omega - r_z * x_omega),
    )
    moved, risen = ground.acceleration(system.motion, t), ground.vertical(system.motion, t)
    # From 0, so that a pulse keeps the sign of its zero.
    across, up = -ground.jerk(system.motion, t), 0.0 - ground.vertical_jerk(system.motion, t)
    return (
        _accelerations(system, of_plates(f_x), of_plates(f_z), of_plates(r_x * f_z - r_z * f_x), moved, risen),
        _by_coordinates(system, *_of_plates_rows(by_position)),
        _by_coordinates(system, *_of_plates_rows(by_velocity)),
        (across, up, 0.0, across, up),
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


@njit(**INLINE)
def energy_of(system, t, q, v, force):
    """As `energy`, from known forces on the vertices."""
    m, M = system.slider_mass, system.plate_mass
    stored = 0.5 * m * (v[0] * v[0] + v[1] * v[1]) + 0.5 * system.slider_inertia * v[2] * v[2]
    stored += 0.5 * M * (v[3] * v[3] + v[4] * v[4]) + GRAVITY * (m * q[1] + M * q[4])
    elastic, dissipation = of_plates(force.stored), of_plates(force.dissipation)
    moved, risen = ground.acceleration(system.motion, t), ground.vertical(system.motion, t)
    power = -(m * v[0] + M * v[3]) * moved - (m * v[1] + M * v[4]) * risen
    return Energy(stored + elastic[0] + elastic[1], dissipation[0] + dissipation[1], power)


@kernel(**KERNEL)
def energy(system, t, q, v):
    """The `Energy` at a state: stored energy [J], dissipated power and the ground motion's power [W]."""
    at = vertices(system, q, v)
    return energy_of(system, t, q, v, vertex_force(at.u, at.w, at.du, at.dw, at.plate))
