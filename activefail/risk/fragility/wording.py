"""Fragility findings in words."""

from collections.abc import Sequence

from activefail.risk.fragility.band import Interval
from activefail.risk.fragility.curve import Capacity
from activefail.risk.fragility.deaggregation import Deaggregation
from activefail.risk.fragility.findings import CAPACITIES, BoundaryFragility, FragilityFindings
from activefail.risk.fragility.lognormal import why_not_fitted
from activefail.risk.fragility.rates import YEARS
from activefail.shares import percent
from activefail.visible import or_worse, visible


def lines(findings: FragilityFindings, outcomes: Sequence[str]) -> list[str]:
    """The findings as lines.

    Args:
        findings: the findings.
        outcomes: of the simulator, the least severe first.
    """
    text_lines = [heading(findings)]
    if findings.fixed:
        text_lines.append(f"given      {fixed_in_words(findings)}")
    for one in reversed(findings.boundaries):
        text_lines.append(f"{visible(or_worse(one.outcome, outcomes))}:")
        for title, text in of_boundary(findings, one):
            text_lines.append(f"  {title:>6}    {text}" if title.endswith("%") else f"  {title:<9} {text}")
    if why := why_no_risk(findings):
        text_lines.append(f"risk       none: {why}")
    text_lines.append(
        "intervals  shown where fresh simulations give one; every other number is the classifier's, without an interval"
        if findings.has_verification
        else "intervals  none: every number is the classifier's; --verify N gives intervals from fresh simulations"
    )
    text_lines += [f"note       {visible(sentence)}" for sentence in findings.assumptions]
    return text_lines


def heading(findings: FragilityFindings) -> str:
    """What the curves are of."""
    variable = f"{findings.ladder.name} [{findings.ladder.unit}]" if findings.ladder.unit else findings.ladder.name
    return f"fragility against {variable}, under {visible(findings.title)}"


def fixed_in_words(findings: FragilityFindings) -> str:
    """The values of variables."""
    return ", ".join(f"{name} {value:g}" for name, value in findings.fixed.items())


def why_no_risk(findings: FragilityFindings) -> str:
    """Why there is no risk; empty if there is one, or if an assumption says it."""
    is_noted = any("annual rates" in note for note in findings.notes)
    return findings.why_no_risk if findings.median is not None and not is_noted else ""


def of_boundary(findings: FragilityFindings, one: BoundaryFragility) -> list[tuple[str, str]]:
    """Titles and texts of one boundary; the capacities' titles are probabilities, a continued title is empty."""
    unit = f" {findings.ladder.unit}" if findings.ladder.unit else ""
    rows = [(percent(p), _capacity(*one.capacity(p), unit)) for p in CAPACITIES]
    fit = one.lognormal
    if fit is None:
        rows.append(("lognormal", f"none is fitted: {why_not_fitted(one.curve)}"))
    else:
        text = (
            f"median {fit.median:.3g}{unit}, dispersion {fit.dispersion:.3g}; it differs from the curve by up to "
            f"{100.0 * fit.misfit:.2g} points, at {fit.misfit_at:.3g}{unit}"
        )
        rows.append(("lognormal", text))
    if one.alone is not None:
        levels = [one.alone.capacity(p).level for p in CAPACITIES]
        shown = ", ".join("none" if level is None else f"{level:.3g}" for level in levels)
        rows.append(("not added", f"capacities without the added uncertainty: {shown}{unit}"))
    if (fall := one.curve.fall) is not None:
        text = (
            f"the curve falls by {100.0 * fall.size:.2g} points between {fall.start:.3g} and {fall.end:.3g}{unit}; a "
            "capacity is the level at which the curve first exceeds its probability"
        )
        rows.append(("falls", text))
    if one.at_median is not None and findings.median is not None:
        bounds = ", ".join(
            f"{percent(p)} ({bound} bound)" if bound != "nominal" else f"{percent(p)} (nominal)"
            for bound, p in one.at_median.items()
        )
        ratio = findings.margin_ratio(one)
        tail = "" if ratio is None else f"; the 50 % capacity is {ratio:.3g} times this median (margin ratio)"
        rows.append(("hazard", f"at its median of {findings.median:.3g}{unit}: {bounds}{tail}"))
    if one.risk is not None:
        text = (
            f"{percent(one.risk.in_50_years, 2)} in {YEARS:g} years ({one.risk.annual_rate:.2g} a year); "
            f"{percent(one.risk.outside)} of the rate comes from velocities outside the hazard curve, where the curve "
            "is extrapolated"
        )
        rows.append(("risk", text))
    for level in one.verified:
        estimate = level.estimate
        text = (
            f"{level.level:.3g}{unit}: {percent(estimate.probability)}, {percent(estimate.low)} to "
            f"{percent(estimate.high)} with {100.0 * estimate.confidence:g} % confidence; {estimate.simulations} fresh "
            f"simulations, contradictions: {estimate.wrong}"
        )
        rows.append(("verified", text))
    if one.deaggregation is not None:
        rows += _of_pulses(one.deaggregation)
    return rows


def _capacity(capacity: Capacity, interval: Interval, unit: str) -> str:
    if capacity.level is None:
        return f"none: {capacity.reason}"
    shown = f"{capacity.level:.3g}{unit}"
    if interval.low is None and interval.high is None:
        return shown
    if interval.low is not None and interval.high is not None:
        ends = f"interval {interval.low:.3g} to {interval.high:.3g}"
    elif interval.high is not None:
        ends = f"interval up to {interval.high:.3g}, the lower end is unknown"
    else:
        ends = f"interval from {interval.low:.3g}, the upper end is unknown"
    unknown = f" ({interval.reason})" if interval.reason else ""
    middle = "" if interval.middle is None else f"; {interval.middle:.3g} after correction by the simulations"
    return f"{shown}{middle}, {ends}{unknown}"


def _of_pulses(parts: Deaggregation) -> list[tuple[str, str]]:
    whole = f"{percent(parts.probability)} under the whole hazard"
    if parts.period_of_failures is None or parts.velocity_of_failures is None:
        return [("pulses", f"{whole}: failure is too rare to be attributed to pulses")]
    rows = [("pulses", whole)]
    for title, period, velocity in (
        ("of the failures", parts.period_of_failures, parts.velocity_of_failures),
        ("of all pulses", parts.period_of_pulses, parts.velocity_of_pulses),
    ):
        text = (
            f"{title}: T_p {period.median:.3g} s ({period.low:.3g} to {period.high:.3g}), PGV "
            f"{velocity.median:.3g} m/s ({velocity.low:.3g} to {velocity.high:.3g}); medians and 90 % ranges"
        )
        rows.append(("", text))
    return rows
