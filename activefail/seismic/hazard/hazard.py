"""The hazard of a site: the distribution of the pulses that a bearing must survive, from a file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.question import (
    AMPLITUDE,
    PERIOD,
    PGV,
    Question,
    asked_of,
    check_names,
    check_no_choices,
    check_pulse,
)
from activefail.campaign.settings import checked, read_toml
from activefail.errors import InputError, naming
from activefail.seismic.bearing.pulse import VELOCITY_PERIOD
from activefail.seismic.hazard.pulse_table import read_pulses, velocities
from activefail.seismic.hazard.sections import HazardSettings, MagnitudeSection
from activefail.space.parameter import Parameter
from activefail.space.space import REACH, Array, DesignSpace, correlation_of_values, radius
from activefail.space.weighted import BLOCKS, WeightedRows, weighted_quantiles

FRICTION, CAPACITY = "mu", "D_tot"
"""Variables of a bearing that have property bounds."""

Bound = Literal["lower", "upper", "nominal"]

_BOUNDS: tuple[Bound, ...] = ("lower", "upper")

_PULSES = 2048
"""Least number of pulses that stand for rows with added uncertainty."""

_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Its multiples fill the unit interval evenly, modulo 1."""

_LEAST = 0.001
"""Least dispersion of the peak ground velocity that is not taken as none."""

_FARTHEST = 10.0
"""Largest |ln| of the ratio of a conditional median period to the median period."""


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
    bound: Bound = "lower"

    def without_uncertainty(self) -> "Hazard":
        """The hazard of the pulses alone."""
        return replace(self, with_uncertainty=False)

    def at_bound(self, bound: Bound) -> "Hazard":
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
            return float(weighted_quantiles(velocities(self.rows), self.rows.weight, [0.5])[0])
        assert self.settings.pgv is not None
        return self.settings.pgv.median_m_s

    def period_given(self, pgv: float) -> tuple[float, float]:
        """Median [s] and dispersion of the lognormal distribution of T_p, given the peak ground velocity [m/s].

        Raises:
            InputError: if the velocity is so far from its median that the periods are absurd.
        """
        section = self.settings.pgv
        assert section is not None
        rho = section.correlation_with_period
        shift = rho * self.period_dispersion / section.dispersion * math.log(pgv / section.median_m_s) if rho else 0.0
        if abs(shift) > _FARTHEST:
            raise InputError(
                f"pgv: must be closer to its median, {section.median_m_s:g} m/s: at {pgv:g} m/s the correlation with "
                "the period gives no finite period."
            )
        return self.median_period * math.exp(shift), self.period_dispersion * math.sqrt(1.0 - rho * rho)

    def pulses(self, pgv: float | None = None) -> tuple[DesignSpace | WeightedRows, dict[str, float]]:
        """The distribution of T_p and PGV, and the values of those that are certain.

        Args:
            pgv: the peak ground velocity [m/s], if it is given: the period then has its conditional distribution, or
                for rows that of all rows.

        Raises:
            InputError: if `pgv` is not positive, or so far from the median that its periods are absurd.
        """
        if pgv is not None and not (math.isfinite(pgv) and pgv > 0.0):
            raise InputError(f"pgv: must be positive and finite, got {pgv} m/s.")
        if self.rows is not None:
            return self._pulses_of_rows(self.rows, pgv)
        section = self.settings.pgv
        assert section is not None
        added, rho = self.added_dispersion, section.correlation_with_period
        median_period, period_dispersion = self.median_period, self.period_dispersion
        if pgv is None:
            median, dispersion = section.median_m_s * math.exp(-self.bias), math.hypot(section.dispersion, added)
            # What is added does not depend on the period.
            rho *= section.dispersion / dispersion
        else:
            median, dispersion = pgv * math.exp(-self.bias), added
            median_period, period_dispersion = self.period_given(pgv)
            rho = 0.0
        periods = _lognormal(PERIOD, median_period, period_dispersion, "s")
        if dispersion < _LEAST:
            return DesignSpace((periods,)), {PGV: median}
        sizes = _lognormal(PGV, median, dispersion, "m/s")
        # Files state the correlation of the logarithms, which is the copula's coefficient.
        correlation = ((PERIOD, PGV, correlation_of_values(periods, sizes, rho)),) if rho else ()
        return DesignSpace((periods, sizes), correlation=correlation), {}

    def _pulses_of_rows(self, rows: WeightedRows, pgv: float | None) -> tuple[WeightedRows, dict[str, float]]:
        periods, added = rows.column(PERIOD), self.added_dispersion
        sizes = velocities(rows) if pgv is None else np.full(len(periods), pgv)
        if added == 0.0:
            felt = sizes * math.exp(-self.bias)
            if pgv is not None:
                one = WeightedRows((PERIOD,), periods[:, None], rows.weight, rows.is_sample)
                return one, {PGV: pgv * math.exp(-self.bias)}
            return WeightedRows((PERIOD, PGV), np.column_stack([periods, felt]), rows.weight, rows.is_sample), {}
        row, z = _spread(sizes, periods)
        X = np.column_stack([periods[row], sizes[row] * np.exp(added * z - self.bias)])
        return WeightedRows((PERIOD, PGV), X, rows.weight[row], is_sample=True), {}

    @property
    def assumptions(self) -> list[str]:
        """What the hazard leaves out, and what it assumes, as sentences."""
        settings, sentences = self.settings, []
        if settings.properties is None or self.bound == "nominal":
            none = "The hazard has no property bounds: the" if settings.properties is None else "The"
            sentences.append(f"{none} bearing has exactly its nominal properties.")
        else:
            factors = ", ".join(f"{_IN_WORDS[name]} × {factor:g}" for name, factor in self.factors.items())
            sentences.append(
                f"The bearing has its {self.bound} property bounds: {factors}."
                if factors
                else f"The {self.bound} property bounds do not change the bearing."
            )
        if not self.added_dispersion and not self.bias:
            sentences.append("Only the pulses are uncertain: the hazard has no record factor and no [uncertainty].")
        else:
            sentences.append(
                f"The capacity has an added dispersion (β) of {self.added_dispersion:.3g} and a bias of "
                f"{self.bias:g}, both of ln PGV."
            )
        if settings.curve is None:
            sentences.append("The hazard has no curve of annual rates, so there is no risk in 50 years.")
        return sentences


_IN_WORDS = {FRICTION: "friction", CAPACITY: "displacement capacity"}


def _spread(sizes: Array, periods: Array) -> tuple[NDArray[np.int_], Array]:
    """Rows, (m,), and their standard normal deviates, (m,), in blocks. Each block represents the whole distribution.

    A simulator is deterministic, so a row's outcome is a step in the deviate, which a quadrature of smooth functions
    would misplace. Each row has strata of equal probability. Their places within the strata differ from row to row, so
    that the steps of different rows do not coincide.
    """
    n = math.ceil(_PULSES / len(sizes))
    order = np.lexsort((periods, sizes))
    z = deviates(len(sizes), n)
    block = (np.arange(len(sizes))[:, None] + np.arange(n)) % BLOCKS
    by_block = np.argsort(block, axis=None, kind="stable")
    return np.repeat(order, n)[by_block], z.ravel()[by_block]


def deviates(rows: int, n: int) -> Array:
    """Standard normal deviates, (rows, n): in each row one in each of n strata of equal probability.

    Their places within the strata differ from row to row, so that all rows together have the tails as well.
    """
    from scipy.special import ndtri

    shifts = (np.arange(rows) + 0.5) * _GOLDEN % 1.0
    return np.asarray(ndtri((np.arange(n) + shifts[:, None]) / n))


def _lognormal(name: str, median: float, dispersion: float, unit: str) -> Parameter:
    numbers = {"median": median, "dispersion": dispersion}
    return Parameter.of_distribution(name, "lognormal", numbers, unit=unit, distance=radius(REACH, 2))


def is_of_hazard(values: Mapping[str, Any]) -> bool:
    """Whether values are those of a hazard file, by their keys, and not of a question file."""
    return "space" not in values and not values.keys().isdisjoint(HazardSettings.model_fields.keys() - {"description"})


def read_hazard(path: Path) -> Hazard:
    """Read a hazard file."""
    return hazard_of(read_toml(path), path)


def hazard_of(values: dict[str, Any], path: Path) -> Hazard:
    """The hazard with these values of a file.

    Raises:
        InputError: as `read_hazard` does.
    """
    settings = checked(HazardSettings, values, str(path))
    title = settings.description or f"the hazard {path.name}"
    if settings.samples is not None:
        with naming(f"{path}: "):
            rows = read_pulses(path.parent, settings.samples)
        log_periods = np.log(rows.column(PERIOD))
        middle = float(np.average(log_periods, weights=rows.weight))
        spread = math.sqrt(float(np.average((log_periods - middle) ** 2, weights=rows.weight)))
        return Hazard(title, settings, math.exp(middle), spread, rows)
    period = settings.period
    assert period is not None
    if isinstance(period, MagnitudeSection):
        return Hazard(title, settings, period.median_s / VELOCITY_PERIOD, period.period_dispersion)
    divisor = VELOCITY_PERIOD if period.definition == "velocity" else 1.0
    return Hazard(title, settings, period.median_s / divisor, period.dispersion)


def check_applies(hazard: Hazard, space: DesignSpace, fixed: Mapping[str, float]) -> None:
    """Check that a hazard says something about a campaign's variables.

    Args:
        hazard: the hazard.
        space: of the campaign.
        fixed: values of variables that are certain.

    Raises:
        InputError: if the campaign has no pulse, `fixed` gives one, or a property bound refers to no variable or to
            one with choices.
    """
    check_pulse(space, "hazard")
    check_names(fixed, space)
    for name in (PERIOD, AMPLITUDE):
        if name in fixed:
            raise InputError(
                f"{name}: is uncertain under a hazard, so `fixed` cannot give it a value, got {fixed[name]:g}."
            )
    # Both bounds: probabilities at the other one are shown beside.
    for bound in _BOUNDS:
        for name, factor in hazard.at_bound(bound).factors.items():
            check_no_choices(name, space, f"properties.{name}_{bound} = {factor:g}")
            if name not in space.names:
                has = f"fixes {name} for all designs" if name in space.fixed else f"has no variable {name}"
                if name in space.carriers:
                    has = f"has {name} as a feature of the choices of {space.carriers[name]}"
                raise InputError(f"properties.{name}_{bound}: cannot be applied, because the campaign {has}.")


def hazard_question(
    hazard: Hazard, space: DesignSpace, fixed: Mapping[str, float], pgv: float | None = None
) -> Question:
    """The question that a hazard asks of a campaign.

    Args:
        hazard: the hazard.
        space: of the campaign.
        fixed: values of variables that are certain; others keep the campaign's distributions.
        pgv: the peak ground velocity [m/s], if it is given.

    Raises:
        InputError: as `check_applies` does, or if the pulses are rows and another variable has no value.
    """
    check_applies(hazard, space, fixed)
    pulses, certain = hazard.pulses(pgv)
    factors = hazard.factors
    if isinstance(pulses, WeightedRows):
        open_ones = [name for name in space.names if name not in {PERIOD, AMPLITUDE, *fixed}]
        if open_ones:
            raise InputError(
                f"{open_ones[0]}: requires a value, because the hazard is a table of pulses. Give it with --fixed."
            )
        values = {**fixed, **certain}
        return Question(hazard.title, space.names, pulses, values, factors, stated=tuple(hazard.assumptions))
    changed = {parameter.name: parameter for parameter in pulses.parameters}
    correlation = [pair for pair in space.correlation if not {PERIOD, AMPLITUDE} & set(pair[:2])]
    question = asked_of(hazard.title, space, changed, {**fixed, **certain}, [*correlation, *pulses.correlation])
    return replace(question, factors=factors, stated=(*hazard.assumptions, *question.stated))
