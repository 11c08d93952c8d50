"""Converts a target risk in a number of years into a target probability given a load of the hazard's curve."""

from collections.abc import Sequence

from activefail.analyses.design.design_task import LEAST_TARGET, Requirement
from activefail.analyses.fragility.curve import Rate
from activefail.campaign.hazard import Hazard
from activefail.errors import InputError


def at_risk(hazard: Hazard | None, requirements: Sequence[Requirement]) -> tuple[Hazard, tuple[Requirement, ...], Rate]:
    """The hazard of the loads of its curve, targets given one of them, and how often they occur.

    Args:
        hazard: of the site; None without one.
        requirements: targets in a number of years.

    Raises:
        InputError: if there is no hazard or no curve, targets are of different kinds, or one is too small or large.
    """
    years = requirements[0].years
    if any(one.years != years for one in requirements) or years is None:
        raise InputError("target: all targets must be risks in the same number of years, or none.")
    if hazard is None or hazard.rates is None:
        raise InputError("target: a risk in years requires a hazard with a [curve] of annual rates.")
    rate = Rate(*hazard.rates, years)
    of_pulse = []
    for one in requirements:
        target = rate.given_pulse(one.target)
        if not LEAST_TARGET <= target <= 0.9:
            side = "larger" if target < LEAST_TARGET else "smaller"
            raise InputError(
                f"target: {100.0 * one.target:g} % in {years:g} years is a probability of {100.0 * target:.3g} % given "
                f"{hazard.loads} of at least {rate.least:g} {hazard.unit}, where [curve] begins. This probability must "
                f"be between {100.0 * LEAST_TARGET:g} and 90 %. Begin the curve at a {side} level."
            )
        of_pulse.append(one._replace(target=target))
    return hazard.of_rates(), tuple(of_pulse), rate
