"""A reduced model of the collision with the rims: three degrees of freedom, from shortly before the first touch.

The slider is nearly massless, about 1/2500 of the top plate, so the forces of the plates on it balance. The motion is
symmetric about the slider's centre, which stays halfway between the dishes' apexes (at the first touch of the
bearing model, x_s/x_t is 0.5 within 10⁻⁴, and both rims are touched within 0.1 ms). The unknowns are the plate's
displacement x and height z and the slider's rotation θ, with two vertices instead of four:

    M ẍ = F_x − M ü_g,    M z̈ = F_z − M g,    I θ̈ = 2 T

with force F and torque T of the bottom plate on the slider's bottom vertices (`contact.vertex_force`). The motion until
0.6 s before the first touch is that of the sliding block (`sliding`). The last 0.6 s are two or
three periods of the elastic rocking, which determines tilt and speed at the rim. The slider's I is raised to
0.005 M D_sl², still negligible compared with the plate's, so explicit steps of 0.5 to 1 ms suffice. The model alone
predicts failure correctly for 98.5 % of Table 1's samples at a quarter of the bearing model's cost; most errors are
second passes.
"""

import math
from typing import NamedTuple

import numpy as np

from activefail.seismic.bearing.contact import Plate, gap, vertex_force, with_arc
from activefail.seismic.bearing.design import GRAVITY, Model, table_1_rows
from activefail.seismic.bearing.ground import Ricker, acceleration, is_harmless, shaking_of
from activefail.seismic.bearing.kernels import kernel
from activefail.seismic.bearing.sliding import STEPS, drift, slide
from activefail.space.space import Array

_INERTIA = 0.005
"""The slider's moment of inertia over M D_sl²."""

_FRICTION_VELOCITY = 0.02
"""Velocity over which Coulomb friction is regularised [m/s]; 0.005 and 0.1 change results as little as the step."""

_LEAD = 0.6
"""Start of the model before the sliding block's first touch [s]; 0.5 to 0.7 are as good, 0 and 1 are worse."""

_LONGEST_STEP = 1e-3
"""Upper bound of a step [s]."""

_AFTERMATH = 1.0
"""Time simulated after the ground motion [s]."""


class Choices(NamedTuple):
    """What a `Model` says of a collision."""

    slider_diameter: float  # D_sl [m]
    slider_density: float  # [kg/m3]
    restitution: float  # e
    damping_ratio: float  # of the contacts
    assembly: bool  # whether the damper has the plate's mass
    rim_strength: float  # over M g
    rim_deformation: float  # plastic, at which a rim breaks [m]

    @classmethod
    def of(cls, model: Model) -> "Choices":
        """Those of a model."""
        return cls(
            model.slider_diameter,
            model.slider_density,
            model.restitution_coefficient,
            model.damping_ratio,
            model.restitution == "assembly",
            *model.rim_limits,
        )


@kernel(nogil=True, error_model="numpy")
def touching_displacement(half_dish, half_width, length, slider_height):
    """Displacement of the top plate at which the seated slider touches both rims [m].

    Tilted by α = asin(x/L), its lower vertex is at x/2 (1 + h_sl/L) + D_sl/2 cos α, the rim at D_out/2.
    """
    x = 2.0 * (half_dish - half_width)
    # A contraction, with a factor of at most 0.15 over Table 1.
    for _ in range(12):
        sine = x / length
        cosine = math.sqrt(max(1.0 - sine * sine, 0.0))
        x = 2.0 * (half_dish - half_width * cosine) / (1.0 + slider_height / length)
    return x


@kernel(nogil=True, error_model="numpy")
def _step(plate, plate_mass, inertia, half_width, half_height, speed):
    """A stable explicit step [s] for a collision at the given speed [m/s]."""
    static = (0.5 * plate_mass * GRAVITY / plate.stiffness) ** (2.0 / 3.0)
    # Deepest Hertz penetration of a mass M arriving with v: (5 M v² / 4 k)^(2/5).
    deepest = static + (1.25 * plate_mass * speed * speed / plate.stiffness) ** 0.4
    lever = 4.0 * (half_width * half_width + half_height * half_height)
    frequency = math.sqrt(1.5 * plate.stiffness * math.sqrt(deepest) * lever / inertia)
    damping = max(plate.dish_damping, plate.rim_damping) * deepest**0.25 * lever / inertia
    return min(_LONGEST_STEP, 0.8 / frequency, 1.0 / damping if damping > 0.0 else math.inf)


@kernel(nogil=True, error_model="numpy")
def collide(
    plate, plate_mass, half_width, half_height, rim_height, length, touch, motion, t, x, dx, speed, deformation=math.inf
):
    """How close to failure a bearing comes after time t, when its seated slider is at x [m] with velocity dx [m/s].

    Args:
        plate: both dishes with their rims.
        plate_mass: M [kg].
        half_width, half_height: half the slider's width and height [m].
        rim_height: h_rim [m].
        length: L [m].
        touch: displacement at which the rims are touched [m].
        motion: of the ground, a `Ricker` or a `Scaled`.
        t, x, dx: time, displacement and velocity at the start.
        speed: expected speed at the first touch [m/s], which determines the step.
        deformation: plastic, at which a rim breaks [m].

    Returns:
        lift: √ of the largest confinement gap over h_rim; beyond h_rim the gap is extrapolated as a ballistic throw,
            gap + rate²/2g.
        tilt: largest |θ| over the overturning angle atan(D_sl/h_sl), or the largest deformation of a rim over that at
            which it breaks, elastic and plastic.
    """
    diameter = 2.0 * half_width
    inertia = _INERTIA * plate_mass * diameter * diameter
    dt = _step(plate, plate_mass, inertia, half_width, half_height, speed)
    overturning = math.atan2(half_width, half_height)
    _, motion_end, _ = shaking_of(motion)
    end = max(motion_end, t) + _AFTERMATH
    # When seated, the centres of the two circles of vertices are L plus the static penetrations apart.
    static = (0.5 * plate_mass * GRAVITY / plate.stiffness) ** (2.0 / 3.0)
    length += 2.0 * static
    breaks = plate.yield_penetration + deformation
    reach = GRAVITY * (length - math.sqrt(length * length - touch * touch))

    theta = math.asin(x / length)
    rest = 2.0 * plate.radius - length
    z = rest + length * (1.0 - math.cos(theta))
    dz, omega = dx * math.tan(theta), dx / (length * math.cos(theta))
    gap_before, lift, tilt = 0.0, 0.0, 0.0
    while t < end:
        cosine, sine = math.cos(theta), math.sin(theta)
        force_x, force_z, torque, least_gap = 0.0, 0.0, 0.0, math.inf
        for side in (-1.0, 1.0):
            r_x = side * cosine * half_width + sine * half_height
            r_z = side * sine * half_width - cosine * half_height
            u, w = 0.5 * x + r_x, 0.5 * z + r_z
            force = vertex_force(u, w, 0.5 * dx - omega * r_z, 0.5 * dz + omega * r_x, plate)
            force_x += force.u
            force_z += force.w
            torque += r_x * force.w - r_z * force.u
            least_gap = min(least_gap, gap(u, w, plate))
            if force.rim > 0.0 or force.demand > plate.strength:
                deepest = abs(u) - plate.rim_distance
                tilt = max(tilt, deepest / breaks)
                if force.demand > plate.strength:
                    arc = plate.right if u > 0.0 else plate.left
                    plate = with_arc(plate, u, max(arc, deepest - plate.yield_penetration))
        # The slider falls onto the bottom plate, so the gap at the top plate is the sum of both.
        both = 2.0 * least_gap
        if both > rim_height:
            rate = max(both - gap_before, 0.0) / dt
            return math.sqrt((both + 0.5 * rate * rate / GRAVITY) / rim_height), tilt
        gap_before = both
        lift = max(lift, both)
        tilt = max(tilt, abs(theta) / overturning)
        if tilt > 1.0:
            break
        if is_harmless(motion, t, 0.5 * (dx * dx + dz * dz) + GRAVITY * (z - rest), reach):
            break
        ground = acceleration(motion, t)
        dx += dt * (force_x / plate_mass - ground)
        dz += dt * (force_z / plate_mass - GRAVITY)
        omega += dt * 2.0 * torque / inertia
        x += dt * dx
        z += dt * dz
        theta += dt * omega
        t += dt
    return math.sqrt(lift / rim_height), tilt


@kernel(nogil=True, error_model="numpy")
def severity_of(bearing, motion, choices, steps):
    """How close to failure a bearing, (7,), comes under a ground motion (`collision_severity`)."""
    slider_diameter = choices.slider_diameter
    T_b, mu, D_tot, h_sl_ratio = bearing[0], bearing[1], bearing[2], bearing[3]
    h_rim_ratio, p, k = bearing[4], bearing[5], bearing[6]
    rate = T_b / (2.0 * math.pi)
    radius = 0.5 * GRAVITY * (rate * rate)
    half_width, half_dish = 0.5 * slider_diameter, 0.5 * (D_tot + slider_diameter)
    slider_height, rim_height = h_sl_ratio * slider_diameter, h_rim_ratio * slider_diameter
    length = 2.0 * math.sqrt(radius * radius - half_width * half_width) - slider_height
    # Also false for NaN.
    buildable = length > D_tot > 0.0 and half_dish < radius and slider_height > 0.0 and rim_height > 0.0
    if not (buildable and mu >= 0.0 and p > 0.0 and k > 0.0):
        return math.nan
    touch = touching_displacement(half_dish, half_width, length, slider_height)
    stiffness = GRAVITY / length
    friction = mu * 2.0 * radius * stiffness
    block = slide(stiffness, friction, touch, choices.restitution, motion, steps)
    if not block.first_speed > 0.0:
        return 0.0
    area = math.pi * half_width * half_width
    plate_mass, slider_mass = p * 1e6 * area / GRAVITY, choices.slider_density * area * slider_height
    dish_mass, rim_mass = (plate_mass, 2.0 * plate_mass) if choices.assembly else (slider_mass, slider_mass)
    plate = Plate(
        radius,
        half_dish,
        radius - math.sqrt(radius * radius - half_dish * half_dish) + rim_height,
        k,
        2.0 * choices.damping_ratio * math.sqrt(dish_mass * k),
        2.0 * choices.damping_ratio * math.sqrt(rim_mass * k),
        mu,
        _FRICTION_VELOCITY,
        choices.rim_strength * plate_mass * GRAVITY,
        (choices.rim_strength * plate_mass * GRAVITY / k) ** (2.0 / 3.0),
        0.0,
        0.0,
    )
    motion_begin, _, _ = shaking_of(motion)
    begin = max(block.first_time - _LEAD, motion_begin)
    x, dx = drift(stiffness, friction, motion, steps, begin)
    lift, tilt = collide(
        plate,
        plate_mass,
        half_width,
        0.5 * slider_height,
        rim_height,
        length,
        touch,
        motion,
        begin,
        x,
        dx,
        block.first_speed,
        choices.rim_deformation,
    )
    return max(lift, tilt)


@kernel(nogil=True, error_model="numpy")
def _severities(X, choices, steps, out):
    for row in range(len(X)):
        T_p, A_p = X[row, 7], X[row, 8]
        # Also false for NaN.
        if 0.0 < T_p < math.inf and abs(A_p) < math.inf:
            motion = Ricker(A_p * GRAVITY, T_p)
            out[row] = severity_of(X[row, :7], motion, choices, steps)


def collision_severity(X: Array, model: Model | None = None) -> Array:
    """How close to failure the reduced model comes, (n,): 0 without a touch, above 1 for failure.

    It is the larger of lift and tilt in `collide`; NaN for a design that cannot be built.

    Args:
        X: (n, 9) designs in Table 1's order and units.
        model: source of slider diameter, density, restitution and rims.

    Raises:
        InputError: if X has another shape or does not contain numbers.
    """
    X = table_1_rows(X)
    out = np.full(len(X), np.nan)
    _severities(X, Choices.of(model or Model()), STEPS, out)
    return out


COLLISION_FEATURES = ("m*",)
"""Names of the columns of `collision_features`."""


def collision_features(X: Array, model: Model | None = None) -> Array:
    """m* = tanh(1.5 (severity − 1)) of designs, (n, 9) -> (n, 1): steep at the failure boundary of the reduced model.

    Raises:
        InputError: as `collision_severity` does.
    """
    return np.tanh(1.5 * (collision_severity(X, model) - 1.0))[:, None]
