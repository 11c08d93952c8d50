"""What a hazard file says, in numbers, and which share of its pulses lies outside a campaign's design space."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from activefail.analyses.design.design_task import RISK_CATEGORIES
from activefail.analyses.findings.lines import titled
from activefail.analyses.fragility.curve import Rate
from activefail.campaign.question import Outside, Question
from activefail.seismic.bearing.pulse import VELOCITY_PERIOD, amplitude_of
from activefail.seismic.hazard.hazard import Hazard, check_applies
from activefail.seismic.hazard.pulse_table import velocities
from activefail.seismic.hazard.sections import RELATIONS, MagnitudeSection
from activefail.seismic.hazard.velocity import AMPLITUDE, PERIOD, PGV
from activefail.space.shares import percent
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows, weighted_quantiles
from activefail.text.json_text import json_values, named

_SHARES = (0.05, 0.5, 0.95)
_NORMAL_95 = 1.6448536269514722
"""Standard normal quantile of 95 %."""


_VELOCITY_PULSE = "T_velocity"
"""Name of the period of the velocity pulse, which publications give."""

_QUANTITIES = ((PERIOD, "s"), (_VELOCITY_PULSE, "s"), (PGV, "m/s"), (AMPLITUDE, "g"))


class Spread(NamedTuple):
    """The distribution of one quantity of the pulses, without added uncertainty."""

    name: str
    unit: str
    low: float  # quantile of 5 %
    median: float
    high: float  # of 95 %
    dispersion: float  # standard deviation of the logarithm


@dataclass(frozen=True)
class HazardSummary:
    """A hazard in numbers."""

    hazard: Hazard  # the hazard
    spreads: tuple[Spread, ...]  # T_p, the period of the velocity pulse, PGV and A_p
    correlation: float  # of ln PGV with ln T_p
    outside: Outside | None = None  # what lies outside a campaign's design space; None without a campaign
    bearing: tuple[str, ...] = ()  # variables of the bearing whose values entered there

    exit_code = 0

    @classmethod
    def of(
        cls, hazard: Hazard, space: DesignSpace | None = None, fixed: Mapping[str, float] | None = None
    ) -> "HazardSummary":
        """The numbers of a hazard.

        Args:
            hazard: the hazard; its property bound applies.
            space: of a campaign, of which the pulses may lie outside.
            fixed: values of the bearing's variables; others are left out.
        """
        spreads, correlation = _lognormal(hazard) if hazard.rows is None else _of_rows(hazard.rows)
        outside = None if space is None else _outside(hazard, space, fixed or {})
        return cls(hazard, tuple(spreads), correlation, outside, tuple(fixed or ()))

    @property
    def curve(self) -> tuple[tuple[float, float], ...]:
        """Peak ground velocities [m/s] with the annual rates at which they are exceeded; empty without a curve."""
        curve = self.hazard.settings.curve
        return tuple(zip(curve.pgv_m_s, curve.annual_rate, strict=True)) if curve else ()

    @property
    def rate_at_median(self) -> float | None:
        """Annual rate at which the median PGV is exceeded; None without a curve or beyond its ends."""
        curve, median = self.curve, self.hazard.median_velocity
        if not curve or not curve[0][0] <= median <= curve[-1][0]:
            return None
        return float(Rate(*np.array(curve).T).exceeding(np.array([median]))[0])

    @property
    def source(self) -> str:
        """Where the pulses come from, in words."""
        period = self.hazard.settings.period
        if self.hazard.rows is not None:
            number = len(self.hazard.rows.weight)
            return f"{number} pulses from {self.hazard.settings.samples}"
        if isinstance(period, MagnitudeSection):
            is_own = period.dispersion is not None and RELATIONS[period.relation].dispersion != period.dispersion
            stated = "; the file gives the dispersion" if is_own else ""
            return f"lognormal distributions; periods of M {period.M:g} by {period.relation}{stated}"
        return "lognormal distributions"

    @property
    def assumptions(self) -> list[str]:
        """What the hazard assumes and leaves out, as sentences."""
        return [
            "T_p is the period at which the Fourier spectrum of the pulse's acceleration peaks. That of its velocity "
            f"peaks at √1.5 T_p = {_VELOCITY_PULSE}. Published periods are taken to be {_VELOCITY_PULSE}.",
            *self.hazard.assumptions,
        ]

    @property
    def lines(self) -> list[str]:
        """The summary as lines of a terminal."""
        hazard, settings = self.hazard, self.hazard.settings
        rows = [("hazard", hazard.title), ("pulses", self.source)]
        for name, unit, low, median, high, dispersion in self.spreads:
            quantiles = f"median {median:.3g} {unit}, 5 to 95 % {low:.3g} to {high:.3g} {unit}"
            rows.append((name, f"{quantiles}, dispersion {dispersion:.3g}"))
        rows.append(("correlation", f"{self.correlation:.3g} between ln PGV and ln T_p"))
        if (bounds := settings.properties) is not None:
            friction = f"friction × {bounds.mu_lower:g} to × {bounds.mu_upper:g}"
            rows.append(("properties", f"{friction}, displacement capacity × {bounds.D_tot_lower:g}"))
        if (factor := settings.record_factor) is not None:
            numbers = f"bias {factor.bias:g} and dispersion {factor.dispersion:g} of the logarithm"
            rows.append(("records", f"capacity over that under pulses: {numbers}"))
        if (added := settings.uncertainty) is not None:
            parts = f"design requirements {added.design_requirements:g}, test data {added.test_data:g}"
            rows.append(("uncertainty", f"{parts}, modelling {added.modelling:g}; together {added.total:.3g}"))
        rows += [("curve", f"PGV above {pgv:g} m/s: {_rate_text(rate)}") for pgv, rate in self.curve]
        if self.rate_at_median is not None:
            rows.append(("", f"PGV above its median: {_rate_text(self.rate_at_median)}"))
        targets = ", ".join(f"{100.0 * share:g} % for risk category {name}" for name, share in RISK_CATEGORIES.items())
        rows.append(("targets", f"{targets}; probability of failure given MCE_R (ASCE 7-16)"))
        if self.outside is not None:
            with_added = ", with the added uncertainty," if hazard.added_dispersion or hazard.bias else ""
            lie = f"of the pulses{with_added} lie outside the campaign's design space; none is clipped"
            rows.append(("outside", f"{percent(self.outside.share)} {lie}"))
            for name, unit, side, bound, share in self.outside.parts:
                rows.append(("", f"{name} {side} {bound:g}{f' {unit}' if unit else ''}: {percent(share)}"))
        return titled([*rows, *(("note", sentence) for sentence in self.assumptions)], 12)

    def as_json(self) -> dict[str, Any]:
        """The summary as JSON values."""
        hazard, outside = self.hazard, self.outside
        sections = named(hazard.settings, "properties", "record_factor", "uncertainty")
        return json_values(
            {
                **named(hazard, "title"),
                "source": self.source,
                "pulses": {one.name: dict(zip(Spread._fields[1:], one[1:], strict=True)) for one in self.spreads},
                "correlation_of_logarithms": self.correlation,
                **{name: section and section.model_dump() for name, section in sections.items()},
                **named(hazard, "added_dispersion", "bias"),
                "curve": [{"pgv_m_s": v, "annual_rate": rate, "return_period": 1.0 / rate} for v, rate in self.curve],
                "annual_rate_at_median_pgv": self.rate_at_median,
                "targets": RISK_CATEGORIES,
                "assumptions": self.assumptions,
                "outside": outside
                and {
                    "total": outside.share,
                    "parts": outside.parts,
                    "bearing": self.bearing,
                    "interval": None,
                    "interval_reason": f"the share of {len(outside.X):,} points of a scrambled Sobol' sequence",
                },
            }
        )


def _outside(hazard: Hazard, space: DesignSpace, fixed: Mapping[str, float]) -> Outside:
    """What of a hazard's pulses lies outside a design space, in the variables of the pulse and those with values."""
    check_applies(hazard, space, fixed)
    known = tuple(one for one in space.parameters if one.name in {PERIOD, AMPLITUDE, *fixed})
    pulses, certain = hazard.pulses()
    names = tuple(one.name for one in known)
    return Question(hazard.title, names, pulses, {**fixed, **certain}, hazard.factors).outside(DesignSpace(known))


def _rate_text(rate: float) -> str:
    return f"annual rate {rate:.3g} (return period {1.0 / rate:,.0f} years)"


def _lognormal(hazard: Hazard) -> tuple[list[Spread], float]:
    """The spreads of lognormal distributions, and the correlation."""
    pgv = hazard.settings.pgv
    assert pgv is not None
    T, one, other, rho = hazard.median_period, hazard.period_dispersion, pgv.dispersion, pgv.correlation_with_period
    # A_p is proportional to PGV/T_p, so its logarithm is a difference of normal variables.
    of_amplitude = math.sqrt(one * one + other * other - 2.0 * rho * one * other)
    amplitude = float(amplitude_of(np.asarray(pgv.median_m_s), np.asarray(T)))
    medians, dispersions = (T, T * VELOCITY_PERIOD, pgv.median_m_s, amplitude), (one, one, other, of_amplitude)
    spreads = []
    for quantity, median, dispersion in zip(_QUANTITIES, medians, dispersions, strict=True):
        factor = math.exp(_NORMAL_95 * dispersion)
        spreads.append(Spread(*quantity, median / factor, median, median * factor, dispersion))
    return spreads, rho


def _of_rows(rows: WeightedRows) -> tuple[list[Spread], float]:
    """The spreads of a table of pulses, and the correlation."""
    weight = rows.weight / rows.weight.sum()
    period, pgv = rows.column(PERIOD), velocities(rows)

    def centred(values: Array) -> Array:
        logarithms = np.log(values)
        return np.asarray(logarithms - weight @ logarithms)

    columns = (period, period * VELOCITY_PERIOD, pgv, amplitude_of(pgv, period))
    spreads = []
    for quantity, values in zip(_QUANTITIES, columns, strict=True):
        low, median, high = weighted_quantiles(values, weight, _SHARES).tolist()
        spreads.append(Spread(*quantity, low, median, high, math.sqrt(float(weight @ centred(values) ** 2))))
    product = spreads[0].dispersion * spreads[2].dispersion
    covariance = float(weight @ (centred(period) * centred(pgv)))
    # Rows of one period, or of one velocity, have no correlation.
    return spreads, max(-1.0, min(1.0, covariance / product)) if product > 1e-12 else 0.0
