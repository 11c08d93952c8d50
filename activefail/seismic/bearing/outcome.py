"""The events at an instant of a motion, the names of the outcomes, and their margins."""

import math
from typing import NamedTuple

from numba import njit

from activefail.seismic.bearing.contact import beyond_rim, gap, vertex_force
from activefail.seismic.bearing.dynamics import energy_of, of_plates, vertices
from activefail.seismic.bearing.kernels import INLINE, KERNEL, kernel
from activefail.seismic.bearing.lanes import numbers, sign

NO_IMPACT, IMPACT, FAILURE = 0, 1, 2
NUMERICAL_FAILURE = -1
OUTCOMES = ("no_impact", "impact", "failure")
"""Names of the outcomes 0, 1, 2, least severe first."""
OUTCOME_NAMES = (*OUTCOMES, "numerical_failure")
"""Names of all outcomes by index; a numerical failure, -1, is the last."""

NONE, ESCAPE, LOSS_OF_CONFINEMENT, OVERTURNING, STEPS, UNDERFLOW, NOT_FINITE, NO_TOUCH, RIM_FRACTURE = range(9)
CAUSES = (
    "",
    "escape",
    "loss_of_confinement",
    "overturning",
    "too_many_steps",
    "step_underflow",
    "not_finite",
    "failure_without_rim_touch",
    "rim_fracture",
)
"""Why a bearing failed (1 to 3, in the order of the checks, then 8) or a simulation was abandoned (4 to 7)."""


class Margins(NamedTuple):
    """Limit-state margins and other observations of a simulation; peaks are those until its end."""

    first_touch_time: float  # first rim touch, after the pulse's centre [s]; NaN without one
    first_touch_velocity: float  # approach velocity of the vertex at the rim [m/s]; NaN without one
    peak_displacement_ratio: float  # peak |x_t| / D_tot [-]
    peak_rim_force_ratio: float  # largest normal force on the rim of one plate / M g [-]
    peak_gap_ratio: float  # largest confinement gap / h_rim [-]; above 1, lost unless vertical motion lifted the plate
    peak_tilt: float  # largest |theta| [rad]
    failure_time: float  # time of failure, after the pulse's centre [s]; NaN without failure
    end_time: float  # end of the integration [s]


class Statistics(NamedTuple):
    """Cost of the solution, and its energy error."""

    energy_error: float  # largest imbalance over the larger of peak |work in| and M g * 1 mm [-]
    steps: int  # attempted steps
    rejected_steps: int
    evaluations: int  # evaluations of the equations of motion


COLUMNS = (*Margins._fields, *Statistics._fields)
"""Names of a simulation's columns in tables and records besides outcome and cause."""


class Observation(NamedTuple):
    """The event functions at an instant; a rim is touched if `touch` is positive; see `failure_cause`."""

    touch: float  # deepest rim penetration of a vertex below the top of its rim [m]
    touch_velocity: float  # velocity of that vertex towards the rim [m/s]
    rim_force: float  # larger of the two plates' sums of normal rim forces [N]
    rim_demand: float  # largest force on a rim if it did not yield [N]
    confinement_gap: float  # larger of the two plates' smaller vertex gaps [m]
    escape: float  # distance by which a vertex is both beyond and above its rim [m]
    tilt: float  # |theta| [rad]


@njit(**INLINE)
def _observation(system, q, at, force):
    """The `Observation` of the vertices `at` under a force."""
    gap_0, gap_1, gap_2, gap_3 = numbers(gap(at.u, at.w, at.plate))
    confinement_gap = max(min(gap_0, gap_1), min(gap_2, gap_3))
    on_bottom, on_top = of_plates(force.rim)
    below, over = of_plates(force.demand)
    beyond, above = beyond_rim(at.u, at.plate), at.w - at.plate.rim_top
    outward = sign(at.u) * at.du
    touch, touch_velocity, escape = -math.inf, 0.0, -math.inf
    for out, up, velocity in zip(numbers(beyond), numbers(above), numbers(outward)):  # noqa: B905
        escape = max(escape, min(out, up))
        if out > touch and up < 0.0:
            touch, touch_velocity = out, velocity
    forces = max(on_bottom, on_top), max(below, over)
    return Observation(touch, touch_velocity, *forces, confinement_gap, escape, abs(q[2]))


@kernel(**KERNEL)
def observe(system, q, v):
    """The `Observation` of a state."""
    at = vertices(system, q, v)
    return _observation(system, q, at, vertex_force(at.u, at.w, at.du, at.dw, at.plate))


@njit(**INLINE)
def examine(system, t, q, v):
    """`energy` and `observe` of a state at once."""
    at = vertices(system, q, v)
    force = vertex_force(at.u, at.w, at.du, at.dw, at.plate)
    return energy_of(system, t, q, v, force), _observation(system, q, at, force)


@kernel(**KERNEL)
def crossing(before, after, level):
    """Fraction of a step, 0 to 1, at which a function from `before` to `after` reaches `level`, linearly interpolated.

    It is 1 if the function does not reach the level, or `before` is not finite.
    """
    if not (-math.inf < before < level < after):
        return 1.0
    return (level - before) / (after - before)


@kernel(**KERNEL)
def failure_cause(observation, system, confinement):
    """The cause of failure at an instant, or NONE."""
    if observation.escape >= 0.0:
        return ESCAPE
    if confinement and observation.confinement_gap > system.rim_height:
        return LOSS_OF_CONFINEMENT
    if observation.tilt > system.tilt_limit:
        return OVERTURNING
    return NONE


@kernel(**KERNEL)
def failure_fraction(before, after, cause, system):
    """Fraction of a step, 0 to 1, at which the failure with this cause occurred."""
    if cause == ESCAPE:
        return crossing(before.escape, after.escape, 0.0)
    if cause == LOSS_OF_CONFINEMENT:
        return crossing(before.confinement_gap, after.confinement_gap, system.rim_height)
    if cause == RIM_FRACTURE:
        return crossing(before.rim_demand, after.rim_demand, system.bottom.strength)
    return crossing(before.tilt, after.tilt, system.tilt_limit)
