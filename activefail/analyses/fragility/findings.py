"""Fragility: the probability of each outcome against one variable, with what follows from it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from activefail.analyses.findings.lines import titled
from activefail.analyses.fragility.band import NOT_VERIFIED, Interval, VerifiedLevel, capacity_interval
from activefail.analyses.fragility.capacities import CONFIDENCE, Fragility, Lognormal
from activefail.analyses.fragility.curve import (
    Capacity,
    Curve,
    Ladder,
    Risk,
    why_not_fitted,
)
from activefail.analyses.stripes.findings import StripeFindings
from activefail.campaign.hazard import Deaggregation
from activefail.simulators.interface import Terms
from activefail.space.parameter import Choice
from activefail.space.shares import percent, significant
from activefail.space.space import Array
from activefail.text.csv_table import Target, writing
from activefail.text.json_text import json_values, named
from activefail.visible import or_worse

CAPACITIES = (0.025, 0.10, 0.50)
"""Probabilities of the reported capacities."""

NO_RATES = "the hazard has no curve of annual rates"
"""Why there is no risk, which the hazard's assumptions say too."""

_UNEQUAL, _NOT_FINITE = (
    "the values are not alike in probability, or too few fail",
    "one is fitted to the capacities of finitely many values, with --wrong",
)
"""Why there is no lognormal curve."""

_OF_RISK = {"least": "least_pgv_m_s", "at_least": "at_least_pgv"}
"""Keys of a risk in JSON that are not the attributes."""

_GIVES = "gives intervals from fresh simulations"

WITHOUT_INTERVAL = "the classifier's number, without an interval"


_SMOOTH = " They assume a limit state that is smooth between simulations."


@dataclass(frozen=True, eq=False)
class BoundaryFragility:
    """The fragility of one boundary.

    Attributes:
        outcome: its name; the probability is of it or a more severe one.
        curve: with the added uncertainties, if there are any.
        alone: the curve of the loads alone; None without added uncertainty.
        verified: levels with intervals.
        fit: the lognormal curve of the capacities of finitely many values, with intervals over their groups; None if
            the curve is of a distribution.
        at_median: by property bound, the probability at the hazard's median; None without a hazard.
        risk: None without annual rates.
        deaggregation: None without a hazard.
    """

    outcome: str
    curve: Curve
    alone: Curve | None = None
    verified: tuple[VerifiedLevel, ...] = ()
    fit: Fragility | None = None
    at_median: Mapping[str, float] | None = None
    risk: Risk | None = None
    deaggregation: Deaggregation | None = None

    def capacity(self, p: float) -> tuple[Capacity, Interval]:
        """The level at which the curve first exceeds a probability, with what was verified of it."""
        return self.curve.capacity(p), capacity_interval(self.curve, self.verified, p)

    def misfit(self, fit: Lognormal) -> tuple[float, float]:
        """Largest difference of a lognormal curve to the curve at a level of the ladder, and this level."""
        levels = self.curve.ladder.levels
        missed = np.abs(fit.at(levels) - self.curve.probability)
        worst = int(np.argmax(missed))
        return float(missed[worst]), float(levels[worst])


@dataclass(frozen=True, eq=False)
class FragilityFindings:
    """The probability of each outcome, or a more severe one, against one variable.

    Attributes:
        title: of the hazard or the question.
        ladder: the variable's levels.
        boundaries: the least severe outcome first.
        outside: (n,) share of the question outside the campaign's design space at each level.
        from_outside: (n, boundaries) share of each probability that comes from there.
        fixed: values of variables.
        given: the same in words.
        refused: why the campaign cannot have fresh simulations, such as "requires a simulator"; empty if it can.
        confidence: of the intervals.
        notes: what was assumed, as sentences.
        outcomes: of the simulator, the least severe first.
        terms: the design in the designer's terms; None if the simulator has none, or a value is uncertain.
        loads: what the hazard's loads are, such as "pulses".
        median: the hazard's median of the intensity; None without a hazard.
        outside_hazard: share of the whole hazard outside the design space; None without a hazard.
        why_no_risk: empty if there is a risk.
    """

    title: str
    ladder: Ladder
    boundaries: tuple[BoundaryFragility, ...]
    outside: Array
    from_outside: Array
    fixed: Mapping[str, Choice]
    given: str
    refused: str
    confidence: float
    notes: tuple[str, ...]
    outcomes: tuple[str, ...]
    terms: Terms | None = None
    median: float | None = None
    loads: str = "loads"
    outside_hazard: float | None = None
    why_no_risk: str = "a risk requires a hazard with annual rates"

    exit_code = 0

    def write_table(self, target: Target) -> None:
        """Write the curves: a row for each level of the ladder and for each verified level.

        Columns: the variable; `kind`, ladder or verified; the share outside the design space; for each outcome the
        curve `p_<outcome>`, that without added uncertainty, the lognormal one, and the verified probability with its
        interval. Cells are empty where there is no number.
        """
        levels = [(level, "ladder", outside) for level, outside in zip(self.ladder.levels, self.outside, strict=True)]
        levels += [(checked.level, "verified", "") for one in self.boundaries for checked in one.verified]
        rows = [self._row(*level) for level in sorted(levels, key=lambda level: level[:2])]
        with writing(target, list(rows[0])) as write:
            write([list(row.values()) for row in rows])

    def _row(self, level: float, kind: str, outside: float | str) -> dict[str, Any]:
        level = self.ladder.levels.dtype.type(level).item()
        row: dict[str, Any] = {self.ladder.name: level, "kind": kind, "outside_design_space": outside}
        for one in self.boundaries:
            name = f"p_{one.outcome}"
            estimate = next((it.estimate for it in one.verified if kind == "verified" and it.level == level), None)
            row[name] = float(one.curve.at(level))
            row[f"{name}_pulses_alone"] = "" if one.alone is None else float(one.alone.at(level))
            row[f"{name}_lognormal"] = "" if one.fit is None else float(one.fit.fit.at(level))
            row[f"{name}_verified"] = estimate.probability if estimate else ""
            row[f"{name}_low"] = estimate.low if estimate else ""
            row[f"{name}_high"] = estimate.high if estimate else ""
        return row

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        text = [heading(self)]
        if self.given:
            text.append(f"given      {self.given}")
        for one in reversed(self.boundaries):
            text.append(f"{or_worse(one.outcome, self.outcomes)}:")
            for title, line in of_boundary(self, one):
                text.append(f"  {title:>6}    {line}" if title.endswith("%") else f"  {title:<9} {line}")
        text.append(
            f"intervals  shown where {'' if self.by_stripes else 'fresh '}simulations give one; every other number is "
            "the classifier's, without an interval"
            if self.has_verification
            else f"intervals  none: every number is the classifier's; --verify N {self.refused or _GIVES}"
        )
        text += titled(("note", sentence) for sentence in self.assumptions)
        return text + ([] if self.terms is None else titled(self.terms.lines()))

    @property
    def has_verification(self) -> bool:
        """Whether any level was verified."""
        return any(one.verified for one in self.boundaries)

    @property
    def by_stripes(self) -> bool:
        """Whether the verified levels are of finitely many values."""
        return any(isinstance(level.estimate, StripeFindings) for one in self.boundaries for level in one.verified)

    @property
    def assumptions(self) -> list[str]:
        """What was assumed, and what contradicts it, as sentences."""
        sentences = list(self.notes)
        for one in self.boundaries:
            surprising = sum(level.estimate.surprising for level in one.verified)
            fresh = sum(level.estimate.simulations for level in one.verified)
            if surprising:
                sentences.append(
                    f"Fresh simulations ({surprising} of {fresh}) contradict the classifier where it was sure, so its "
                    "boundary is wrong there. Continue the campaign before you use these curves."
                )
        if self.has_verification:
            sentences.append(
                f"The intervals are pointwise: each one alone has {100.0 * self.confidence:g} % confidence; together "
                f"they have less.{'' if self.by_stripes else _SMOOTH}"
            )
        curves = np.array([one.curve.probability for one in self.boundaries])
        between = (curves >= 0.01) & (curves <= 0.9)
        outside = self.outside[between.any(axis=0)]
        if len(outside) and outside.max() > 0.0:
            least, most = percent(float(outside.min())), percent(float(outside.max()))
            share = most if least == most else f"{least} to {most}"
            sentences.append(
                f"Where the curves are between 1 and 90 %, {share} of the distribution lies outside the campaign's "
                "design space, where the classifier extrapolates, and up to "
                f"{percent(float(self.from_outside[between.T].max()))} of a probability comes from there."
            )
        return sentences

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        return json_values(
            {
                "version": 2,
                "question": self.title,
                "fixed": self.fixed,
                "variable": named(self.ladder, "name", "unit", "levels"),
                "outside_design_space": self.outside,
                "outside_design_space_of_hazard": self.outside_hazard,
                "hazard_median": self.median,
                "outcomes": {one.outcome: self._numbers(one) for one in self.boundaries},
                "assumptions": self.assumptions,
            }
        )

    def _numbers(self, one: BoundaryFragility) -> dict[str, Any]:
        fall, risk, alone, ratio = one.curve.fall, one.risk, one.alone, self.margin_ratio(one)
        of_curve = "only the verified levels have intervals" if one.verified else NOT_VERIFIED
        capacities = ((p, *one.capacity(p)) for p in CAPACITIES)
        return {
            "curve": _without_interval(of_curve, probability=one.curve.probability),
            "curve_of_pulses_alone": alone
            and _without_interval(levels=alone.ladder.levels, probability=alone.probability),
            **named(one.curve, "resolution", "rises"),
            "falls": fall and {"by": fall.size, "from": fall.start, "to": fall.end},
            "capacities": [{"probability": p, **at._asdict(), **band._asdict()} for p, at, band in capacities],
            "lognormal": one.fit and _of_capacities(one, one.fit),
            "lognormal_reason": None if one.fit else self._why_not_fitted(one),
            "verified": [
                {
                    "level": level,
                    **estimate.numbers,
                    "confidence": estimate.confidence,
                    "classifier_probability": float(one.curve.at(level)),
                }
                for level, estimate in one.verified
            ],
            "at_hazard_median": one.at_median and _without_interval(probability=one.at_median),
            "margin_ratio": ratio and {"value": ratio, **self._interval_of_ratio(one)},
            "risk": risk
            and _without_interval(**{_OF_RISK.get(key, key): value for key, value in risk._asdict().items()}),
            "risk_reason": self.why_no_risk or None,
            "deaggregation": one.deaggregation and one.deaggregation.numbers,
        }

    def _why_not_fitted(self, one: BoundaryFragility) -> str:
        return (why_not_fitted(one.curve) or _UNEQUAL) if self.by_stripes else _NOT_FINITE

    def _interval_of_ratio(self, one: BoundaryFragility) -> dict[str, Any]:
        _, interval = one.capacity(0.5)
        ends = {end: at and self.median and at / self.median for end, at in named(interval, "low", "high").items()}
        return {**ends, **named(interval, "confidence", "interval_reason")}

    def margin_ratio(self, one: BoundaryFragility) -> float | None:
        """The 50 % capacity over the hazard's median; None if either is unknown."""
        level = one.curve.capacity(0.5).level
        return None if level is None or self.median is None else level / self.median


def _of_capacities(one: BoundaryFragility, fit: Fragility) -> dict[str, Any]:
    """The lognormal curve of capacities, with its intervals."""
    misfit, at = one.misfit(fit.fit)
    ends = {"median_interval": list(fit.median) or None, "dispersion_interval": list(fit.dispersion) or None}
    of_fit = {**named(fit.fit, "median", "dispersion"), "largest_misfit": misfit, "largest_misfit_at": at, **ends}
    reason = "those of median and dispersion are over groups"
    return _without_interval(reason, **of_fit) | {"confidence": CONFIDENCE}


def _without_interval(reason: str = WITHOUT_INTERVAL, **numbers: Any) -> dict[str, Any]:
    return {**numbers, "interval": None, "interval_reason": reason}


def heading(findings: FragilityFindings) -> str:
    """What the curves are of."""
    variable = f"{findings.ladder.name} [{findings.ladder.unit}]" if findings.ladder.unit else findings.ladder.name
    return f"fragility against {variable}, under {findings.title}"


def of_boundary(findings: FragilityFindings, one: BoundaryFragility) -> list[tuple[str, str]]:
    """Titles and texts of one boundary; the capacities' titles are probabilities, a continued title is empty."""
    unit = unit_of(findings)
    rows = [(percent(p), _capacity(*one.capacity(p), unit)) for p in CAPACITIES]
    for level in one.verified:
        estimate = level.estimate
        text = (
            f"{level.level:.3g}{unit}: {percent(estimate.probability)}, {percent(estimate.low)} to "
            f"{percent(estimate.high)} with {100.0 * estimate.confidence:g} % confidence; {estimate.basis}"
        )
        rows.append(("verified", text))
    return rows + beside_capacities(findings, one)


def unit_of(findings: FragilityFindings) -> str:
    """The unit of the levels, as it follows a number."""
    return f" {findings.ladder.unit}" if findings.ladder.unit else ""


def beside_capacities(findings: FragilityFindings, one: BoundaryFragility) -> list[tuple[str, str]]:
    """Those of `of_boundary` after the capacities and the verified levels."""
    unit, rows = unit_of(findings), list[tuple[str, str]]()
    if one.fit is not None:
        fit, (misfit, at) = one.fit.fit, one.misfit(one.fit.fit)
        text = (
            f"median {fit.median:.3g}{unit}{_over_groups(one.fit.median)}, dispersion {fit.dispersion:.3g}"
            f"{_over_groups(one.fit.dispersion)}; it differs from the curve by up to {100.0 * misfit:.2g} points, at "
            f"{at:.3g}{unit}; its intervals leave out wrong predictions"
        )
        rows.append(("lognormal", text))
    elif findings.by_stripes:
        rows.append(("lognormal", f"none is fitted: {why_not_fitted(one.curve) or _UNEQUAL}"))
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
            f"{percent(one.risk.probability, 2)} in {one.risk.years:g} years ({one.risk.annual_rate:.2g} a year); "
            f"{percent(one.risk.share_outside_hazard_curve)} of the rate comes from above the hazard curve, where "
            f"it is extrapolated. {findings.loads.capitalize()} below {one.risk.least:g}{unit}, where it begins, are "
            f"left out; the probability there is {percent(one.risk.at_least)}"
        )
        rows.append(("risk", text))
    if one.deaggregation is not None:
        rows += one.deaggregation.rows
    return rows


def _over_groups(ends: tuple[float, float] | tuple[()]) -> str:
    if not ends:
        return " (no interval)"
    return f" ({' to '.join(map(significant, ends))}, {100.0 * CONFIDENCE:g} %, over groups)"


def _capacity(capacity: Capacity, interval: Interval, unit: str) -> str:
    shown = f"none: {capacity.reason}" if capacity.level is None else f"{significant(capacity.level)}{unit}"
    if not (ends := ends_in_words(interval)):
        return shown
    unknown = f" ({interval.interval_reason})" if interval.interval_reason else ""
    if (middle := interval.verified) is not None:
        shown += f"; {significant(middle)} after correction by the simulations"
    return f"{shown}, interval {ends}{unknown}"


def ends_in_words(interval: Interval) -> str:
    """The ends of a capacity's interval; empty if both are unknown."""
    low, high = ("" if end is None else significant(end) for end in (interval.low, interval.high))
    if low and high:
        return f"{low} to {high}"
    return f"from {low}" if low else f"up to {high}" if high else ""
