"""What a hazard file says, in numbers, and which share of its pulses lies outside a campaign's design space."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from activefail.acquisition.population import integration_points
from activefail.bearing.pulse import VELOCITY_PERIOD, amplitude_of
from activefail.campaign.hazard import Hazard, check_applies
from activefail.campaign.hazard_sections import RELATIONS, MagnitudeSection
from activefail.campaign.pulse_table import velocities
from activefail.campaign.question import AMPLITUDE, PERIOD, PGV, Question
from activefail.risk.design.design_task import RISK_CATEGORIES
from activefail.risk.fragility.rates import exceedance
from activefail.space import Array, DesignSpace
from activefail.weighted import weighted_quantiles

_SHARES = (0.05, 0.5, 0.95)
_NORMAL_95 = 1.6448536269514722
"""Standard normal quantile of 95 %."""

_POINTS = 2**14
"""Points that estimate a share outside."""


class Spread(NamedTuple):
    """The distribution of one quantity of the pulses, without added uncertainty.

    Attributes:
        name, unit: of the quantity.
        low, median, high: its quantiles of 5, 50 and 95 %.
        dispersion: standard deviation of its logarithm.
    """

    name: str
    unit: str
    low: float
    median: float
    high: float
    dispersion: float


class CurvePoint(NamedTuple):
    """A point of the hazard curve: the annual rate at which a peak ground velocity [m/s] is exceeded."""

    pgv: float
    rate: float

    @property
    def return_period(self) -> float:
        """Mean time between exceedances [years]."""
        return 1.0 / self.rate


class OutsidePart(NamedTuple):
    """The share of pulses beyond one bound of a campaign's design space.

    Attributes:
        name, unit: of the variable.
        side: "below" or "above".
        bound: of the variable.
        share: of the pulses.
    """

    name: str
    unit: str
    side: str
    bound: float
    share: float


@dataclass(frozen=True)
class Outside:
    """The share of pulses, with added uncertainty, outside a campaign's design space.

    Attributes:
        total: outside in any variable.
        parts: by variable and side; those with no share outside are left out.
        bearing: variables of the bearing whose values entered.
    """

    total: float
    parts: tuple[OutsidePart, ...]
    bearing: tuple[str, ...]

    @classmethod
    def of(cls, hazard: Hazard, space: DesignSpace, fixed: Mapping[str, float]) -> "Outside":
        """The share of a hazard's pulses outside a design space, by 16,384 points of a scrambled Sobol' sequence.

        Args:
            hazard: the hazard; its property bound applies.
            space: of the campaign.
            fixed: values of the bearing's variables; others are left out.

        Raises:
            InputError: as `activefail.campaign.hazard.check_applies` does.
        """
        check_applies(hazard, space, fixed)
        known = tuple(name for name in space.names if name in {PERIOD, AMPLITUDE, *fixed})
        pulses, certain = hazard.pulses()
        question = Question(hazard.title, known, pulses, {**fixed, **certain}, hazard.factors)
        U, weight = integration_points(pulses, _POINTS)
        X = question.designs(U)
        parameters = [space.parameters[space.names.index(name)] for name in known]
        parts, is_outside = [], np.zeros(len(X), dtype=bool)
        for parameter, x in zip(parameters, X.T, strict=True):
            for side, bound, beyond in (
                ("below", parameter.low, x < parameter.low),
                ("above", parameter.high, x > parameter.high),
            ):
                is_outside |= beyond
                if share := float((weight * beyond).mean()):
                    parts.append(OutsidePart(parameter.name, parameter.unit, side, bound, share))
        return cls(float((weight * is_outside).mean()), tuple(parts), tuple(fixed))

    def as_json(self) -> dict[str, Any]:
        """The shares as JSON values."""
        return {
            "total": self.total,
            "parts": [part._asdict() for part in self.parts],
            "bearing": list(self.bearing),
            "interval": None,
            "interval_reason": f"the share of {_POINTS:,} points of a scrambled Sobol' sequence",
        }


@dataclass(frozen=True)
class HazardSummary:
    """A hazard in numbers.

    Attributes:
        hazard: the hazard.
        spreads: T_p, the period of the velocity pulse, PGV and A_p.
        correlation: of ln PGV with ln T_p.
        curve: points of the hazard curve; empty if there is none.
        rate_at_median: annual rate at which the median PGV is exceeded; None without a curve or beyond its ends.
    """

    hazard: Hazard
    spreads: tuple[Spread, ...]
    correlation: float
    curve: tuple[CurvePoint, ...]
    rate_at_median: float | None

    @classmethod
    def of(cls, hazard: Hazard) -> "HazardSummary":
        """The numbers of a hazard."""
        spreads, correlation = _spreads_of_rows(hazard) if hazard.rows is not None else _lognormal_spreads(hazard)
        curve = hazard.settings.curve
        points = (
            tuple(CurvePoint(*pair) for pair in zip(curve.pgv_m_s, curve.annual_rate, strict=True)) if curve else ()
        )
        return cls(hazard, spreads, correlation, points, _rate_at(points, hazard.median_velocity))

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

    def as_json(self) -> dict[str, Any]:
        """The summary as JSON values."""
        settings, hazard = self.hazard.settings, self.hazard
        return {
            "title": hazard.title,
            "source": self.source,
            "pulses": {
                spread.name: {k: v for k, v in spread._asdict().items() if k != "name"} for spread in self.spreads
            },
            "correlation_of_logarithms": self.correlation,
            "properties": settings.properties.model_dump() if settings.properties else None,
            "record_factor": settings.record_factor.model_dump() if settings.record_factor else None,
            "uncertainty": settings.uncertainty.model_dump() if settings.uncertainty else None,
            "added_dispersion": hazard.added_dispersion,
            "bias": hazard.bias,
            "curve": [{"pgv_m_s": p.pgv, "annual_rate": p.rate, "return_period": p.return_period} for p in self.curve],
            "annual_rate_at_median_pgv": self.rate_at_median,
            "targets": RISK_CATEGORIES,
            "assumptions": self.assumptions,
        }


_VELOCITY_PULSE = "T_velocity"
"""Name of the period of the velocity pulse, which publications give."""


def _lognormal_spreads(hazard: Hazard) -> tuple[tuple[Spread, ...], float]:
    pgv = hazard.settings.pgv
    assert pgv is not None
    one, other, rho = hazard.period_dispersion, pgv.dispersion, pgv.correlation_with_period
    # A_p is proportional to PGV/T_p, so its logarithm is a difference of normal variables.
    of_amplitude = math.sqrt(one * one + other * other - 2.0 * rho * one * other)
    amplitude = float(amplitude_of(np.asarray(pgv.median_m_s), np.asarray(hazard.median_period)))

    def spread(name: str, unit: str, median: float, dispersion: float) -> Spread:
        factor = math.exp(_NORMAL_95 * dispersion)
        return Spread(name, unit, median / factor, median, median * factor, dispersion)

    return (
        spread(PERIOD, "s", hazard.median_period, one),
        spread(_VELOCITY_PULSE, "s", hazard.median_period * VELOCITY_PERIOD, one),
        spread(PGV, "m/s", pgv.median_m_s, other),
        spread(AMPLITUDE, "g", amplitude, of_amplitude),
    ), rho


def _spreads_of_rows(hazard: Hazard) -> tuple[tuple[Spread, ...], float]:
    rows = hazard.rows
    assert rows is not None
    weight = rows.weight / rows.weight.sum()
    period, pgv = rows.column(PERIOD), velocities(rows)

    def centred(values: Array) -> Array:
        logarithms = np.log(values)
        return np.asarray(logarithms - weight @ logarithms)

    def spread(name: str, unit: str, values: Array) -> Spread:
        low, median, high = weighted_quantiles(values, weight, _SHARES).tolist()
        return Spread(name, unit, low, median, high, math.sqrt(float(weight @ centred(values) ** 2)))

    spreads = (
        spread(PERIOD, "s", period),
        spread(_VELOCITY_PULSE, "s", period * VELOCITY_PERIOD),
        spread(PGV, "m/s", pgv),
        spread(AMPLITUDE, "g", amplitude_of(pgv, period)),
    )
    product = spreads[0].dispersion * spreads[2].dispersion
    covariance = float(weight @ (centred(period) * centred(pgv)))
    # Rows of one period, or of one velocity, have no correlation.
    return spreads, max(-1.0, min(1.0, covariance / product)) if product > 1e-12 else 0.0


def _rate_at(curve: tuple[CurvePoint, ...], pgv: float) -> float | None:
    if not curve or not curve[0].pgv <= pgv <= curve[-1].pgv:
        return None
    pgvs, rates = np.array([[point.pgv, point.rate] for point in curve]).T
    return float(exceedance(pgvs, rates, np.array([pgv]))[0])
