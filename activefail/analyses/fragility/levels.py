"""The levels of a curve, what is asked at each, and the classifier's answer there."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from activefail.analyses.fragility.curve import Curve, Ladder
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.estimates.integral import Boundaries, Integral, integral_of
from activefail.space.space import Array, DesignSpace
from activefail.visible import visible

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
    against: str | None = None,
    bounds: tuple[float, float] | None = None,
) -> Ladder:
    """The levels of a curve: of the intensity of a hazard's loads, or of an uncertain variable of another question.

    Args:
        asked: what is asked.
        against: the variable, without one; its ladder has 40 steps.
        bounds: of the variable's levels; those of the campaign if None.
    """
    if asked.hazard is not None:
        if against is not None:
            raise InputError("against: cannot be combined with hazard.")
        hazard = asked.hazard
        return Ladder(hazard.intensity, hazard.unit, hazard.levels(), is_log=True)
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
