"""Fragility findings as lines of text."""

from collections.abc import Sequence

from activefail.risk.fragility.band import Interval
from activefail.risk.fragility.curve import Capacity
from activefail.risk.fragility.deaggregation import Deaggregation
from activefail.risk.fragility.findings import CAPACITIES, BoundaryFragility, FragilityFindings
from activefail.risk.fragility.lognormal import why_not_fitted
from activefail.risk.fragility.rates import YEARS
from activefail.shares import percent
from activefail.visible import or_worse, visible


def lines(found: FragilityFindings, outcomes: Sequence[str]) -> list[str]:
    """The findings as lines.

    Args:
        found: the findings.
        outcomes: of the simulator, the least severe first.
    """
    variable = f"{found.ladder.name} [{found.ladder.unit}]" if found.ladder.unit else found.ladder.name
    said = [f"fragility against {variable}, under {visible(found.title)}"]
    if found.fixed:
        said.append("given      " + ", ".join(f"{name} {value:g}" for name, value in found.fixed.items()))
    for one in reversed(found.boundaries):
        said += _of_boundary(found, one, visible(or_worse(one.outcome, outcomes)))
    is_said = any("annual rates" in note for note in found.notes)
    if found.why_no_risk and found.median is not None and not is_said:
        said.append(f"risk       none: {found.why_no_risk}")
    said.append(
        "intervals  only those that are shown; every other number is the classifier's, without an interval"
        if found.has_verification
        else "intervals  none: every number is the classifier's; --verify N gives intervals from fresh simulations"
    )
    said += [f"note       {visible(sentence)}" for sentence in found.assumptions]
    return said


def _of_boundary(found: FragilityFindings, one: BoundaryFragility, name: str) -> list[str]:
    unit = f" {found.ladder.unit}" if found.ladder.unit else ""
    said = [f"{name}:"]
    said += [f"  {percent(p):>6}    {_capacity(*one.capacity(p), unit)}" for p in CAPACITIES]
    fit = one.lognormal
    if fit is None:
        said.append(f"  lognormal none is fitted: {why_not_fitted(one.curve)}")
    else:
        said.append(
            f"  lognormal median {fit.median:.3g}{unit}, dispersion {fit.dispersion:.3g}; it misses the curve by up to "
            f"{fit.misfit:.2g}, at {fit.misfit_at:.3g}{unit}"
        )
    if one.alone is not None:
        levels = [one.alone.capacity(p).level for p in CAPACITIES]
        shown = ", ".join("none" if level is None else f"{level:.3g}" for level in levels)
        said.append(f"  alone     the pulses without the added uncertainty: {shown}{unit}")
    if (fall := one.curve.fall) is not None:
        said.append(
            f"  falls     by {fall.size:.2g} between {fall.start:.3g} and {fall.end:.3g}{unit}; capacities are where "
            "the curve first exceeds a probability"
        )
    if one.at_median is not None and found.median is not None:
        bounds = ", ".join(
            f"{percent(p)} ({bound} bound)" if bound != "nominal" else f"{percent(p)} (nominal)"
            for bound, p in one.at_median.items()
        )
        margin = found.margin(one)
        tail = "" if margin is None else f"; the 50 % capacity is {margin:.3g} times this median"
        said.append(f"  hazard    at its median of {found.median:.3g}{unit}: {bounds}{tail}")
    if one.risk is not None:
        said.append(
            f"  risk      {percent(one.risk.in_50_years, 2)} in {YEARS:g} years ({one.risk.annual_rate:.2g} a year); "
            f"{percent(one.risk.outside)} of it from velocities outside the hazard's curve, which is extrapolated there"
        )
    for level in one.verified:
        estimate = level.estimate
        said.append(
            f"  verified  {level.level:.3g}{unit}: {percent(estimate.probability)}, {percent(estimate.low)} to "
            f"{percent(estimate.high)} with {100.0 * estimate.confidence:g} % confidence; {estimate.simulations} fresh "
            f"simulations, {estimate.wrong} contradict the classifier"
        )
    if one.deaggregation is not None:
        said += _of_pulses(one.deaggregation)
    return said


def _capacity(capacity: Capacity, interval: Interval, unit: str) -> str:
    if capacity.level is None:
        return f"none: {capacity.reason}"
    shown = f"{capacity.level:.3g}{unit}"
    if interval.low is None and interval.high is None:
        return shown
    low, high = ("?" if end is None else f"{end:.3g}" for end in (interval.low, interval.high))
    unknown = f" (?: {interval.reason})" if interval.reason else ""
    middle = "" if interval.middle is None else f"; {interval.middle:.3g} with the simulations"
    return f"{shown}{middle}, interval {low} to {high}{unknown}"


def _of_pulses(parts: Deaggregation) -> list[str]:
    said = [f"  pulses    {percent(parts.probability)} under the whole hazard"]
    if parts.period_of_failures is None or parts.velocity_of_failures is None:
        return [f"{said[0]}: too rare to be attributed to pulses"]
    for title, period, velocity in (
        ("of these", parts.period_of_failures, parts.velocity_of_failures),
        ("of all pulses", parts.period_of_pulses, parts.velocity_of_pulses),
    ):
        said.append(
            f"            {title}: T_p {period.median:.3g} s ({period.low:.3g} to {period.high:.3g}), PGV "
            f"{velocity.median:.3g} m/s ({velocity.low:.3g} to {velocity.high:.3g}); medians and 90 % ranges"
        )
    return said
