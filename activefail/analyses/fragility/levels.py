"""The levels of a curve, what is asked at each, and the classifier's answer there."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from activefail.analyses.fragility.curve import Curve, Ladder
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import AMPLITUDE, PERIOD, PGV, Question
from activefail.errors import InputError
from activefail.estimates.integral import Boundaries, Integral, integral_of
from activefail.seismic.bearing.pulse import amplitude_of
from activefail.seismic.hazard.hazard import Hazard
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows, weighted_quantiles
from activefail.visible import visible

PulseIntensity = Literal["pgv", "a_p"]

UNITS = {"pgv": (PGV, "m/s"), "a_p": (AMPLITUDE, "g")}
"""Name and unit of each intensity."""

_PER_DECADE = 24
"""Levels of a ladder of intensities in a factor of ten."""

_RANGES = {"pgv": (0.1, 4.0), "a_p": (0.02, 2.0)}
"""Range of each ladder of intensities."""

_STEPS = 40
"""Steps of the ladder of another variable."""

_MOST_LEVELS = 500
"""Most levels of a variable with a step, which has one for each value."""

RESOLUTION = 0.001
"""Standard error of the integration at a level that is small enough for a curve."""

_STEEP, _HALVINGS = 0.05, 2
"""Change of a probability for which a step of a ladder is halved, and how often."""


_BOUNDS = "bounds (--range)"


def ladder_of(
    asked: Inquiry,
    intensity: PulseIntensity = "pgv",
    against: str | None = None,
    bounds: tuple[float, float] | None = None,
) -> Ladder:
    """The levels of a curve: of the intensity of a hazard's pulses, or of an uncertain variable of another question.

    Args:
        asked: what is asked.
        intensity: with a hazard.
        against: the variable, without one; its ladder has 40 steps.
        bounds: of the variable's levels; those of the campaign if None.

    Raises:
        InputError: naming the argument, the rule and the value.
    """
    if asked.hazard is not None:
        if against is not None:
            raise InputError("against: cannot be combined with hazard.")
        return intensity_ladder(intensity, asked.hazard)
    if against is None:
        raise InputError("hazard, against: exactly one is required, a hazard file or the variable of the curve.")
    question, space = asked.question, asked.campaign.space
    if any(one.name == against and one.choices for one in space.parameters):
        raise InputError(f"against: {against} has choices without order; give it one by `fixed`, a curve for each.")
    if against in question.fixed:
        raise InputError(f"against: {against} has the value {question.fixed[against]:g}; leave it out of --fixed.")
    if against not in question.space.names:
        known = ", ".join(question.space.names)
        raise InputError(f"against: must be one of the uncertain variables ({known}), got {visible(repr(against))}.")
    if question.space.dimension < 2:
        raise InputError(f"against: no variable besides {against} is uncertain, so there is nothing to integrate over.")
    parameters = [*space.parameters, *getattr(question.space, "parameters", ())]
    known_one = next((one for one in parameters if one.name == against), None)
    if bounds is None:
        if known_one is None:
            raise InputError(f"{_BOUNDS}: required, because {against} has no bounds in the campaign.")
        bounds = known_one.low, known_one.high
    low, high = bounds
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"{_BOUNDS}: must be two finite numbers with `low < high`, got {low:g},{high:g}.")
    is_log = known_one is not None and known_one.distribution in ("log_uniform", "lognormal") and low > 0.0
    levels = (np.geomspace if is_log else np.linspace)(low, high, _STEPS + 1)
    if in_steps := known_one is not None and known_one.step is not None:
        assert known_one is not None
        levels = known_one.values[(known_one.values >= low) & (known_one.values <= high)]
        if not (known_one.contains(low) and known_one.contains(high)) or len(levels) > _MOST_LEVELS:
            raise InputError(f"{_BOUNDS}: {known_one.rule}, with at most {_MOST_LEVELS} values, got {low:g},{high:g}.")
    if space.constraints:
        levels = levels[[question.at({against: level}).has_designs for level in levels.tolist()]]
    if len(levels) < 2:
        raise InputError(f"{_BOUNDS}: must hold two levels at which designs exist, got {low:g},{high:g}.")
    levels = known_one.column(levels) if known_one is not None else levels
    return Ladder(against, known_one.unit if known_one else "", levels, is_log, in_steps)


def intensity_ladder(intensity: PulseIntensity, hazard: Hazard) -> Ladder:
    """The ladder of an intensity: 24 fixed levels in a factor of ten; it includes the hazard's curve."""
    low, high = _RANGES[intensity]
    if intensity == "pgv":
        low, high = min(low, hazard.median_velocity), max(high, hazard.median_velocity)
        if hazard.settings.curve is not None:
            low, high = min(low, hazard.settings.curve.pgv_m_s[0]), max(high, hazard.settings.curve.pgv_m_s[-1])
    first, last = (_PER_DECADE * np.log10(end) for end in (low, high))
    steps = np.arange(int(np.floor(first + 1e-9)), int(np.ceil(last - 1e-9)) + 1)
    name, unit = UNITS[intensity]
    return Ladder(name, unit, np.asarray(10.0 ** (steps / _PER_DECADE)), is_log=True)


def question_at(asked: Inquiry, hazard: Hazard, name: str, level: float) -> Question:
    """The question of a hazard, given the intensity of its pulses.

    Given the peak ground velocity, the period has its conditional distribution. Given the amplitude, it keeps its
    distribution: the same pulses are scaled.

    Args:
        asked: campaign and values.
        hazard: a variant of what is asked.
        name: PGV [m/s] or A_p [g].
        level: of the intensity.
    """
    if name == AMPLITUDE and (pgv := hazard.settings.pgv) is not None:
        alone = hazard.settings.model_copy(update={"pgv": pgv.model_copy(update={"correlation_with_period": 0.0})})
        hazard = replace(hazard, settings=alone)
    question = asked.under(hazard, level)
    return question if name == PGV else _with_amplitude(question)


def _with_amplitude(question: Question) -> Question:
    """A question about a velocity as one about an amplitude with the same numbers."""

    def renamed(name: str) -> str:
        return AMPLITUDE if name == PGV else name

    space = question.space
    if isinstance(space, WeightedRows):
        space = replace(space, names=tuple(map(renamed, space.names)))
    else:
        parameters = (replace(one, name=AMPLITUDE, unit="g") if one.name == PGV else one for one in space.parameters)
        space = replace(space, parameters=tuple(parameters))
    return replace(question, space=space, fixed={renamed(name): value for name, value in question.fixed.items()})


def median_intensity(hazard: Hazard, name: str) -> float:
    """Median of the hazard's peak ground velocities PGV [m/s] or amplitudes A_p [g]."""
    if name == PGV:
        return hazard.median_velocity
    rows = hazard.rows
    if rows is None:
        return float(amplitude_of(np.array(hazard.median_velocity), np.array(hazard.median_period)))
    known = AMPLITUDE in rows.names
    values = rows.column(AMPLITUDE) if known else amplitude_of(rows.column(PGV), rows.column(PERIOD))
    return float(weighted_quantiles(values, rows.weight, (0.5,))[0])


def curves_on(
    boundaries: Boundaries, question_at_level: Callable[[float], Question], ladder: Ladder, space: DesignSpace
) -> tuple[list[Curve], Array, Array]:
    """The curves of all b boundaries on one ladder, by the classifier, and what of them lies outside a design space.

    Steps of the ladder in which a curve moves by more than 0.05 are halved, at most twice.

    Returns:
        The curves; (n,) the share of the question outside the space at each level; (n, b) the share of each probability
        that comes from there.
    """

    def integral(level: float) -> Integral:
        return integral_of(question_at_level(level), boundaries, space, RESOLUTION)

    integrals = {level: integral(level) for level in ladder.levels.tolist()}
    for _ in range(0 if ladder.in_steps else _HALVINGS):
        levels = sorted(integrals)
        steps = np.abs(np.diff([integrals[level].probability for level in levels], axis=0)).max(axis=1)
        coordinates = ladder.coordinate(np.array(levels))
        for step in np.flatnonzero(steps > _STEEP):
            level = ladder.level(0.5 * (coordinates[step] + coordinates[step + 1]))
            integrals[level] = integral(level)
    levels = sorted(integrals)
    found = [integrals[level] for level in levels]
    ladder = replace(ladder, levels=np.array(levels))
    errors = np.max([one.error for one in found], axis=0).tolist()
    probabilities = np.transpose([one.probability for one in found])
    curves = [Curve(ladder, one, max(RESOLUTION, error)) for one, error in zip(probabilities, errors, strict=True)]
    outside = np.array([question_at_level(level).share_outside(space) for level in levels])
    return curves, outside, np.array([one.outside for one in found])
