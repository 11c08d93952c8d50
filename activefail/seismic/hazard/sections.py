"""The sections of a hazard file, each with its rules."""

import math
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, field_validator, model_validator

from activefail.campaign.section import Section, shown

LARGEST_VELOCITY = 10.0
"""Largest peak ground velocity [m/s]; the largest recorded ones are about 3 m/s."""

LARGEST_MEDIAN = 5.0
"""Largest median of the peak ground velocity [m/s]."""

SHORTEST, LONGEST = 0.05, 30.0
"""Shortest and longest pulse period [s]."""


class MagnitudeRelation(NamedTuple):
    """A published relation between magnitude and pulse period: ln T = constant + slope × M.

    Attributes:
        constant, slope: of ln T; T [s] is the period of the velocity pulse.
        dispersion: standard deviation of ln T; None where none is known, so that the file must give it.
    """

    constant: float
    slope: float
    dispersion: float | None


RELATIONS = {
    "shahi-baker-2011": MagnitudeRelation(-5.73, 0.99, 0.56),
    "baker-2007": MagnitudeRelation(-5.78, 1.02, 0.55),
    "somerville-2003-rock": MagnitudeRelation(-3.17 * math.log(10.0), 0.5 * math.log(10.0), None),
    "somerville-2003-soil": MagnitudeRelation(-2.02 * math.log(10.0), 0.346 * math.log(10.0), None),
}
"""From [ShahiBaker2011], [Baker2007] and [Somerville2003]; docs/hazard.md says what of them was verified."""

Relation = Literal["shahi-baker-2011", "baker-2007", "somerville-2003-rock", "somerville-2003-soil"]

Dispersion = Annotated[float, Field(ge=0.001, le=2.0)]
"""Standard deviation of a logarithm."""


class MagnitudeSection(Section):
    """Pulse periods by the magnitude of the earthquake.

    Attributes:
        M: moment magnitude.
        relation: published relation between magnitude and pulse period.
        dispersion: standard deviation of ln T_p; the relation's own if it is left out.
    """

    M: float = Field(ge=5.0, le=9.0)
    relation: Relation = "shahi-baker-2011"
    dispersion: Dispersion | None = None

    @model_validator(mode="after")
    def _has_a_dispersion(self) -> Self:
        if self.dispersion is None and RELATIONS[self.relation].dispersion is None:
            raise ValueError(f"the relation {self.relation!r} comes without a dispersion; set `dispersion`")
        return self

    @property
    def median_s(self) -> float:
        """Median period of the velocity pulse [s]."""
        relation = RELATIONS[self.relation]
        return math.exp(relation.constant + relation.slope * self.M)

    @property
    def period_dispersion(self) -> float:
        """Standard deviation of the logarithm of the period."""
        published = RELATIONS[self.relation].dispersion
        dispersion = published if self.dispersion is None else self.dispersion
        assert dispersion is not None
        return dispersion


class PulsePeriodSection(Section):
    """Pulse periods by their median and dispersion.

    Attributes:
        median_s: median of the period [s].
        dispersion: standard deviation of ln T_p.
        definition: "velocity" for a period of the velocity pulse, as published; "acceleration" for T_p.
    """

    median_s: float = Field(ge=SHORTEST, le=LONGEST)
    dispersion: Dispersion
    definition: Literal["velocity", "acceleration"]


class VelocitySection(Section):
    """Peak ground velocities.

    Attributes:
        median_m_s: median of the peak ground velocity [m/s].
        dispersion: standard deviation of ln PGV.
        correlation_with_period: correlation of ln PGV with ln T_p.
    """

    median_m_s: float = Field(ge=0.001)
    dispersion: Dispersion
    correlation_with_period: float = Field(0.0, ge=-0.99, le=0.99)

    @field_validator("median_m_s")
    @classmethod
    def _is_in_metres(cls, median: float) -> float:
        if median > LARGEST_MEDIAN:
            raise ValueError(f"must be at most {LARGEST_MEDIAN:g} m/s, got {median:g}; is it in cm/s?")
        return median


class PropertiesSection(Section):
    """Bounds on the bearing as built and aged: property modification factors [ASCE2017, 17.2.8].

    Attributes:
        mu_lower: smallest factor on the friction coefficient.
        mu_upper: largest factor on the friction coefficient.
        D_tot_lower: factor on the displacement capacity, for tolerances.
    """

    mu_lower: float = Field(1.0, ge=0.2, le=1.0)
    mu_upper: float = Field(1.0, ge=1.0, le=3.0)
    D_tot_lower: float = Field(1.0, ge=0.5, le=1.0)


class RecordFactorSection(Section):
    """From pulses to records, on the logarithm of the capacity.

    Attributes:
        bias: mean of ln(capacity under records / capacity under pulses).
        dispersion: its standard deviation.
    """

    bias: float = Field(0.0, ge=-1.0, le=1.0)
    dispersion: float = Field(0.0, ge=0.0, le=1.0)


class UncertaintySection(Section):
    """Dispersions of the capacity that the pulses do not show [FEMA2009].

    Attributes:
        design_requirements: of the design requirements, as a standard deviation of the logarithm of the capacity.
        test_data: of the test data, likewise.
        modelling: of the model, likewise.
    """

    design_requirements: float = Field(0.0, ge=0.0, le=1.0)
    test_data: float = Field(0.0, ge=0.0, le=1.0)
    modelling: float = Field(0.0, ge=0.0, le=1.0)

    @property
    def total(self) -> float:
        """Root of the sum of squares."""
        return math.hypot(self.design_requirements, self.test_data, self.modelling)


class CurveSection(Section):
    """Annual rates at which the peak ground velocity is exceeded.

    Attributes:
        pgv_m_s: velocities [m/s], increasing.
        annual_rate: rates [1/year], decreasing.
    """

    pgv_m_s: list[Annotated[float, Field(gt=0.0)]] = Field(min_length=2, max_length=1000)
    annual_rate: list[Annotated[float, Field(ge=1e-12, le=10.0)]] = Field(min_length=2, max_length=1000)

    @field_validator("pgv_m_s")
    @classmethod
    def _increases(cls, velocities: list[float]) -> list[float]:
        if velocities[-1] > LARGEST_VELOCITY:
            raise ValueError(f"must be at most {LARGEST_VELOCITY:g} m/s, got {velocities[-1]:g}; is it in cm/s?")
        if any(b <= a for a, b in pairwise(velocities)):
            raise ValueError(f"must increase, got {shown(velocities)}")
        return velocities

    @field_validator("annual_rate")
    @classmethod
    def _decreases(cls, rates: list[float]) -> list[float]:
        if any(b >= a for a, b in pairwise(rates)):
            raise ValueError(f"must decrease, got {shown(rates)}")
        return rates

    @model_validator(mode="after")
    def _has_pairs(self) -> Self:
        if len(self.pgv_m_s) != len(self.annual_rate):
            raise ValueError(
                f"`pgv_m_s` and `annual_rate` must have equal lengths, got {len(self.pgv_m_s)} and "
                f"{len(self.annual_rate)}"
            )
        return self


class HazardSettings(Section):
    """A hazard file.

    Attributes:
        description: the site, in words.
        magnitude: gives the distribution of the pulse period.
        pulse_period: gives the same in place of `magnitude`.
        pgv: the distribution of the peak ground velocity.
        samples: file of pulses in place of both: columns T_p [s], PGV [m/s] or A_p [g], and weight.
        properties: bounds on the bearing as built and aged; not applied if left out.
        record_factor: from pulses to records; not applied if left out.
        uncertainty: more dispersion of the capacity; none if left out.
        curve: hazard curve, which turns fragility into risk.
    """

    description: str = Field("", max_length=200)
    magnitude: MagnitudeSection | None = None
    pulse_period: PulsePeriodSection | None = None
    pgv: VelocitySection | None = None
    samples: str | None = Field(None, min_length=1, max_length=255)
    properties: PropertiesSection | None = None
    record_factor: RecordFactorSection | None = None
    uncertainty: UncertaintySection | None = None
    curve: CurveSection | None = None

    @model_validator(mode="after")
    def _has_pulses(self) -> Self:
        periods = [name for name in ("magnitude", "pulse_period") if getattr(self, name) is not None]
        if self.samples is not None:
            if excluded := [*periods, *(["pgv"] if self.pgv is not None else [])]:
                raise ValueError(f"`samples` cannot be combined with `{excluded[0]}`")
            return self
        if len(periods) == 2:
            raise ValueError("`magnitude` cannot be combined with `pulse_period`: both give the pulse period")
        if not periods:
            raise ValueError("requires `magnitude`, `pulse_period` or `samples` for the pulse period, got none of them")
        if self.pgv is None:
            raise ValueError(f"`{periods[0]}` requires `pgv`, which is missing; `samples` may replace both")
        return self

    @property
    def period(self) -> MagnitudeSection | PulsePeriodSection | None:
        """What gives the pulse period; None if there are samples."""
        return self.magnitude or self.pulse_period
