"""The hazard of a site: the distribution of the pulses that a bearing must survive, from a file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from activefail.campaign.question import AMPLITUDE, PERIOD, PGV, Question, asked_of, check_names, check_pulse
from activefail.campaign.sections import Section
from activefail.campaign.settings import CampaignSettings, checked, parse_toml, read_text
from activefail.csv_table import read_cells
from activefail.distributions import moments, quantiles_at
from activefail.errors import InputError
from activefail.parameter import Parameter
from activefail.space import REACH, Array, DesignSpace, radius
from activefail.weighted import WeightedRows

FRICTION, CAPACITY = "mu", "D_tot"
"""Variables of a bearing that have property bounds."""

RELATIONS = {
    "shahi-baker-2011": (-5.73, 0.99, 0.56),
    "baker-2007": (-5.78, 1.02, 0.55),
    "somerville-2003-rock": (-3.17 * math.log(10.0), 0.5 * math.log(10.0), 0.40),
    "somerville-2003-soil": (-2.02 * math.log(10.0), 0.346 * math.log(10.0), 0.40),
}
"""ln T_p [s] of the velocity pulse = first + second × magnitude; the third is its standard deviation."""

Relation = Literal["shahi-baker-2011", "baker-2007", "somerville-2003-rock", "somerville-2003-soil"]

Dispersion = Annotated[float, Field(gt=0.0, le=2.0)]
"""Standard deviation of a logarithm."""

_NODES = 8
"""Values of each row's peak ground velocity that stand for added uncertainty."""


class MagnitudeSection(Section):
    """Pulse periods by the magnitude of the earthquake.

    Attributes:
        M: moment magnitude.
        relation: published relation between magnitude and pulse period.
    """

    M: float = Field(ge=5.0, le=9.0)
    relation: Relation = "shahi-baker-2011"


class PulsePeriodSection(Section):
    """Pulse periods by their median and dispersion.

    Attributes:
        median_s: [s].
        dispersion: of ln T_p.
        definition: "velocity" for a period of the velocity pulse, as published; "acceleration" for T_p.
    """

    median_s: float = Field(gt=0.05, le=30.0)
    dispersion: Dispersion
    definition: Literal["velocity", "acceleration"]


class VelocitySection(Section):
    """Peak ground velocities.

    Attributes:
        median_m_s: [m/s].
        dispersion: of ln PGV.
        correlation_with_period: of ln PGV with ln T_p.
    """

    median_m_s: float = Field(gt=0.0)
    dispersion: Dispersion
    correlation_with_period: float = Field(0.0, gt=-0.99, lt=0.99)

    @model_validator(mode="after")
    def _is_in_metres(self) -> Self:
        if self.median_m_s > _FASTEST:
            raise ValueError(
                f"median_m_s: must be at most {_FASTEST:g} m/s, got {self.median_m_s:g}; is it in cm/s? No recorded "
                "ground velocity is that large"
            )
        return self


_FASTEST = 5.0
"""Largest median of the peak ground velocity [m/s]; the largest recorded one is about 3 m/s."""


class PropertiesSection(Section):
    """Bounds on what the bearing will be (property modification factors).

    Attributes:
        mu_lower, mu_upper: factors on the friction coefficient.
        D_tot_lower: factor on the displacement capacity, for tolerances.
    """

    mu_lower: float = Field(1.0, gt=0.2, le=1.0)
    mu_upper: float = Field(1.0, ge=1.0, le=3.0)
    D_tot_lower: float = Field(1.0, gt=0.5, le=1.0)


class RecordFactorSection(Section):
    """From pulses to records, on the logarithm of the capacity.

    Attributes:
        bias: mean of ln(capacity under records / capacity under pulses).
        dispersion: its standard deviation.
    """

    bias: float = Field(0.0, ge=-1.0, le=1.0)
    dispersion: float = Field(0.0, ge=0.0, le=1.0)


class UncertaintySection(Section):
    """Dispersions of the capacity that the pulses do not show [FEMAP695]."""

    design_requirements: float = Field(0.0, ge=0.0, le=1.0)
    test_data: float = Field(0.0, ge=0.0, le=1.0)
    modelling: float = Field(0.0, ge=0.0, le=1.0)

    @property
    def total(self) -> float:
        """Root of the sum of squares."""
        return math.sqrt(self.design_requirements**2 + self.test_data**2 + self.modelling**2)


class CurveSection(Section):
    """Annual rates at which the peak ground velocity is exceeded.

    Attributes:
        pgv_m_s: velocities [m/s], increasing.
        annual_rate: decreasing.
    """

    pgv_m_s: list[Annotated[float, Field(gt=0.0, le=20.0)]] = Field(min_length=2)
    annual_rate: list[Annotated[float, Field(gt=0.0, le=10.0)]] = Field(min_length=2)

    @model_validator(mode="after")
    def _is_a_curve(self) -> Self:
        if len(self.pgv_m_s) != len(self.annual_rate):
            raise ValueError(
                f"pgv_m_s and annual_rate: must have equal lengths, got {len(self.pgv_m_s)} and {len(self.annual_rate)}"
            )
        if any(b <= a for a, b in zip(self.pgv_m_s, self.pgv_m_s[1:], strict=False)):
            raise ValueError(f"pgv_m_s: must increase, got {self.pgv_m_s}")
        if any(b >= a for a, b in zip(self.annual_rate, self.annual_rate[1:], strict=False)):
            raise ValueError(f"annual_rate: must decrease, got {self.annual_rate}")
        return self


class HazardSettings(Section):
    """A hazard file.

    Attributes:
        description: in words.
        magnitude, pulse_period: either gives the distribution of the pulse period.
        pgv: the distribution of the peak ground velocity.
        samples: file of pulses in place of both: columns T_p [s], PGV [m/s] or A_p [g], and weight.
        properties, record_factor, uncertainty, curve: as their classes say; what is left out is not applied.
    """

    description: str = Field("", max_length=200)
    magnitude: MagnitudeSection | None = None
    pulse_period: PulsePeriodSection | None = None
    pgv: VelocitySection | None = None
    samples: str | None = None
    properties: PropertiesSection | None = None
    record_factor: RecordFactorSection | None = None
    uncertainty: UncertaintySection | None = None
    curve: CurveSection | None = None

    @model_validator(mode="after")
    def _has_pulses(self) -> Self:
        periods = [name for name in ("magnitude", "pulse_period") if getattr(self, name) is not None]
        if self.samples is not None:
            if given := [*periods, *(["pgv"] if self.pgv is not None else [])]:
                raise ValueError(f"samples: cannot be combined with {given[0]}")
            return self
        if len(periods) != 1:
            got = "both" if periods else "none of them"
            raise ValueError(f"one of magnitude, pulse_period and samples is required, got {got}")
        if self.pgv is None:
            raise ValueError("pgv: required, but missing; samples of pulses may replace it")
        return self


@dataclass(frozen=True, eq=False)
class Hazard:
    """The pulses at a site, with property bounds and added uncertainty.

    Attributes:
        title: in words.
        settings: what the file says.
        median_period, period_dispersion: lognormal distribution of T_p [s]; of the rows, if there are rows.
        rows: pulses with weights, of T_p and PGV or A_p; None for lognormal distributions.
        with_uncertainty: whether the record factor and the added uncertainty are applied.
        bound: which property bound the bearing has: "lower", "upper", or "nominal".
    """

    title: str
    settings: HazardSettings
    median_period: float
    period_dispersion: float
    rows: WeightedRows | None = None
    with_uncertainty: bool = True
    bound: Literal["lower", "upper", "nominal"] = "lower"

    def without_uncertainty(self) -> "Hazard":
        """The hazard of the pulses alone."""
        return replace(self, with_uncertainty=False)

    def at_bound(self, bound: Literal["lower", "upper", "nominal"]) -> "Hazard":
        """The hazard with another bound of the bearing's properties."""
        return replace(self, bound=bound)

    @property
    def bias(self) -> float:
        """Mean of ln(capacity under records / capacity under pulses)."""
        factor = self.settings.record_factor
        return factor.bias if factor is not None and self.with_uncertainty else 0.0

    @property
    def added_dispersion(self) -> float:
        """Standard deviation that the record factor and the uncertainty add to ln PGV."""
        if not self.with_uncertainty:
            return 0.0
        factor, uncertainty = self.settings.record_factor, self.settings.uncertainty
        return math.hypot(factor.dispersion if factor else 0.0, uncertainty.total if uncertainty else 0.0)

    @property
    def factors(self) -> dict[str, float]:
        """Factors on the bearing's variables at the property bound."""
        properties = self.settings.properties
        if properties is None or self.bound == "nominal":
            return {}
        if self.bound == "upper":
            return {FRICTION: properties.mu_upper} if properties.mu_upper != 1.0 else {}
        factors = {FRICTION: properties.mu_lower, CAPACITY: properties.D_tot_lower}
        return {name: factor for name, factor in factors.items() if factor != 1.0}

    @property
    def median_velocity(self) -> float:
        """Median of the peak ground velocity [m/s]."""
        if self.rows is not None:
            order = np.argsort(velocities := _velocities(self.rows))
            return float(velocities[order][np.searchsorted(np.cumsum(self.rows.weight[order]), 0.5 * len(order))])
        assert self.settings.pgv is not None
        return self.settings.pgv.median_m_s

    def pulses(self, pgv: float | None = None) -> tuple[DesignSpace | WeightedRows, dict[str, float]]:
        """The distribution of T_p and PGV, and the values of those that are certain.

        Args:
            pgv: the peak ground velocity [m/s], if it is given: the period then has its conditional distribution, or
                for rows that of all rows.
        """
        if self.rows is not None:
            return self._pulses_of_rows(self.rows, pgv)
        given = self.settings.pgv
        assert given is not None
        added, rho = self.added_dispersion, given.correlation_with_period
        median_period, period_dispersion = self.median_period, self.period_dispersion
        if pgv is None:
            median, dispersion = given.median_m_s * math.exp(-self.bias), math.hypot(given.dispersion, added)
            # What is added does not depend on the period.
            rho *= given.dispersion / dispersion
        else:
            median, dispersion = pgv * math.exp(-self.bias), added
            median_period *= math.exp(rho * period_dispersion / given.dispersion * math.log(pgv / given.median_m_s))
            period_dispersion *= math.sqrt(1.0 - rho * rho)
            rho = 0.0
        periods = _lognormal(PERIOD, median_period, period_dispersion, "s")
        if dispersion == 0.0:
            return DesignSpace((periods,)), {PGV: median}
        velocities = _lognormal(PGV, median, dispersion, "m/s")
        of_values = _correlation_of_values(rho, period_dispersion, dispersion)
        return DesignSpace((periods, velocities), correlation=((PERIOD, PGV, of_values),) if rho else ()), {}

    def _pulses_of_rows(self, rows: WeightedRows, pgv: float | None) -> tuple[WeightedRows, dict[str, float]]:
        periods, added = rows.X[:, rows.names.index(PERIOD)], self.added_dispersion
        velocities = _velocities(rows) if pgv is None else np.full(len(periods), pgv)
        if pgv is not None and added == 0.0:
            return WeightedRows((PERIOD,), periods[:, None], rows.weight), {PGV: pgv * math.exp(-self.bias)}
        z, w = np.polynomial.hermite_e.hermegauss(_NODES if added else 1)
        spread = np.exp(added * z - self.bias)
        X = np.column_stack([np.repeat(periods, len(z)), np.outer(velocities, spread).ravel()])
        return WeightedRows((PERIOD, PGV), X, np.outer(rows.weight, w).ravel()), {}

    @property
    def assumptions(self) -> list[str]:
        """What the hazard leaves out, and what it assumes, as sentences."""
        settings, sentences = self.settings, []
        if settings.properties is None:
            sentences.append("The hazard has no property bounds: the bearing is exactly as designed.")
        elif self.bound == "lower":
            sentences.append(
                f"The bearing has its lower property bounds: friction × {settings.properties.mu_lower:g}, displacement "
                f"capacity × {settings.properties.D_tot_lower:g}."
            )
        if not self.added_dispersion and not self.bias:
            sentences.append(
                "No uncertainty is added to that of the pulses: no record factor and none of the uncertainties of "
                "FEMA P695."
            )
        else:
            sentences.append(
                f"The capacity has an added dispersion of {self.added_dispersion:.3g} and a bias of {self.bias:g}."
            )
        if settings.curve is None:
            sentences.append("The hazard has no curve of annual rates, so there is no risk in 50 years.")
        return sentences


def _velocities(rows: WeightedRows) -> Array:
    """Peak ground velocities of pulses [m/s], (n,)."""
    if PGV in rows.names:
        return rows.X[:, rows.names.index(PGV)]
    from activefail.bearing.pulse import velocity_of

    return velocity_of(rows.X[:, rows.names.index(AMPLITUDE)], rows.X[:, rows.names.index(PERIOD)])


def _lognormal(name: str, median: float, dispersion: float, unit: str) -> Parameter:
    mean, sd = moments("lognormal", None, None, {"median": median, "dispersion": dispersion})
    low, high = quantiles_at("lognormal", mean, sd, radius(REACH, 2))
    return Parameter(name, low, high, unit, "lognormal", mean, sd)


def _correlation_of_values(rho: float, one: float, other: float) -> float:
    """Correlation of two lognormal variables whose logarithms have a correlation and these standard deviations."""
    return math.expm1(rho * one * other) / math.sqrt(math.expm1(one * one) * math.expm1(other * other))


def read_hazard(path: Path) -> Hazard:
    """Read a hazard file.

    Raises:
        InputError: naming the file, the key, the rule and the value.
    """
    return hazard_of(parse_toml(read_text(path), str(path)), path)


def hazard_of(values: dict[str, Any], path: Path) -> Hazard:
    """The hazard with these values of a file.

    Raises:
        InputError: as `read_hazard` does.
    """
    settings = checked(HazardSettings, values, str(path))
    title = settings.description or f"the hazard {path.name}"
    if settings.samples is not None:
        rows = _read_pulses(path.parent / settings.samples)
        log_periods = np.log(rows.X[:, rows.names.index(PERIOD)])
        middle = float(np.average(log_periods, weights=rows.weight))
        spread = math.sqrt(float(np.average((log_periods - middle) ** 2, weights=rows.weight)))
        return Hazard(title, settings, math.exp(middle), spread, rows)
    from activefail.bearing.pulse import VELOCITY_PERIOD

    if settings.magnitude is not None:
        first, second, dispersion = RELATIONS[settings.magnitude.relation]
        return Hazard(title, settings, math.exp(first + second * settings.magnitude.M) / VELOCITY_PERIOD, dispersion)
    assert settings.pulse_period is not None
    period = settings.pulse_period
    divisor = VELOCITY_PERIOD if period.definition == "velocity" else 1.0
    return Hazard(title, settings, period.median_s / divisor, period.dispersion)


def hazard_question(
    hazard: Hazard,
    settings: CampaignSettings,
    space: DesignSpace,
    fixed: Mapping[str, float],
    pgv: float | None = None,
) -> Question:
    """The question that a hazard asks of a campaign.

    Args:
        hazard: the hazard.
        settings, space: of the campaign.
        fixed: values of variables that are certain; others keep the campaign's distributions.
        pgv: the peak ground velocity [m/s], if it is given.

    Raises:
        InputError: if the campaign has no pulse, or `fixed` gives one.
    """
    check_pulse(space, "hazard")
    check_names(fixed, space)
    for name in (PERIOD, AMPLITUDE):
        if name in fixed:
            raise InputError(f"{name}: is uncertain under a hazard, so it cannot have a value.")
    pulses, certain = hazard.pulses(pgv)
    factors = {name: factor for name, factor in hazard.factors.items() if name in space.names}
    if isinstance(pulses, WeightedRows):
        open_ones = [name for name in space.names if name not in {PERIOD, AMPLITUDE, *fixed}]
        if open_ones:
            raise InputError(
                f"{open_ones[0]}: must have a value, because the hazard's pulses are rows of a file; give it with "
                "--fixed."
            )
        return Question(hazard.title, space.names, pulses, {**fixed, **certain}, factors)
    changed = {parameter.name: parameter for parameter in pulses.parameters}
    correlation = [pair for pair in settings.correlation if not {PERIOD, AMPLITUDE, *fixed} & set(pair[:2])]
    asked = asked_of(hazard.title, settings, space, changed, {**fixed, **certain}, [*correlation, *pulses.correlation])
    return replace(asked, factors=factors)


def _read_pulses(path: Path) -> WeightedRows:
    """Read a table of pulses: T_p [s], PGV [m/s] or A_p [g], and weight, 1 if it is left out.

    Raises:
        InputError: naming the file, and row, column, rule and value.
    """
    header, rows, _ = read_cells(path)
    size = [name for name in (PGV, AMPLITUDE) if name in header]
    if PERIOD not in header or len(size) != 1:
        raise InputError(f"{path}: the columns must be T_p, weight, and either PGV or A_p, got {','.join(header)}.")
    names = (PERIOD, size[0])

    def numbers(name: str, least: str) -> Array:
        values = np.ones(len(rows))
        if name not in header:
            return values
        for row, cells in enumerate(rows):
            text = cells[header.index(name)]
            try:
                values[row] = float(text)
            except ValueError:
                raise InputError(f"{path}: row {row + 1}, column {name}: must be a number, got {text!r}.") from None
            if not math.isfinite(values[row]) or values[row] < 0.0 or (least == "positive" and values[row] == 0.0):
                rule = "positive" if least == "positive" else "at least 0"
                raise InputError(f"{path}: row {row + 1}, column {name}: must be {rule}, got {text}.")
        return values

    X = np.column_stack([numbers(name, "positive") for name in names])
    weight = numbers("weight", "not negative")
    if not len(X):
        raise InputError(f"{path}: has no row.")
    if not weight.sum() > 0.0:
        raise InputError(f"{path}: column weight: at least one weight must be positive.")
    if size[0] == PGV and float(np.median(X[:, 1])) > _FASTEST:
        raise InputError(
            f"{path}: column PGV: the median must be at most {_FASTEST:g} m/s, got {np.median(X[:, 1]):g}; is it in "
            "cm/s?"
        )
    return WeightedRows(names, X, weight)
