"""The hazard of a site: the distribution of the pulses that a bearing must survive, from a file."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.derived import check_no_choices
from activefail.campaign.hazard import Bound
from activefail.campaign.question import Question, asked_of, check_names
from activefail.campaign.settings import checked
from activefail.errors import InputError, naming
from activefail.seismic.bearing.pulse import VELOCITY_PERIOD
from activefail.seismic.hazard.pulse_table import read_pulses, velocities
from activefail.seismic.hazard.sections import HazardSettings, MagnitudeSection
from activefail.seismic.hazard.strata import deviates
from activefail.seismic.hazard.velocity import AMPLITUDE, PERIOD, PGV, VELOCITY
from activefail.space.parameter import Parameter
from activefail.space.space import REACH, Array, DesignSpace, correlation_of_values, radius
from activefail.space.weighted import BLOCKS, WeightedRows, weighted_quantiles
from activefail.text.toml import read_toml

if TYPE_CHECKING:
    from activefail.seismic.hazard.deaggregation import Deaggregation

FRICTION, CAPACITY = "mu", "D_tot"
"""Variables of a bearing that have property bounds."""

_BOUNDS: tuple[Bound, ...] = ("lower", "upper")

_RANGE = 0.1, 4.0
"""Peak ground velocities that the levels include at least [m/s]."""

_PER_DECADE = 24
"""Levels in a factor of ten."""

_PULSES = 2048
"""Least number of pulses that stand for rows with added uncertainty."""

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

    variables: ClassVar[tuple[str, ...]] = (PERIOD, AMPLITUDE)
    loads: ClassVar[str] = "pulses"
    intensity: ClassVar[str] = PGV
    unit: ClassVar[str] = "m/s"

    @classmethod
    def is_of(cls, values: Mapping[str, Any]) -> bool:
        """Whether values are those of a hazard file, by their keys, and not of a question file."""
        known = HazardSettings.model_fields.keys() - {"description"}
        return "space" not in values and not values.keys().isdisjoint(known)

    @classmethod
    def of(cls, values: dict[str, Any], path: Path) -> "Hazard":
        """The hazard with these values of a file."""
        settings = checked(HazardSettings, values, str(path))
        title = settings.description or f"the hazard {path.name}"
        if settings.samples is not None:
            with naming(f"{path}: "):
                rows = read_pulses(path.parent, settings.samples)
            log_periods = np.log(rows.column(PERIOD))
            middle = float(np.average(log_periods, weights=rows.weight))
            spread = math.sqrt(float(np.average((log_periods - middle) ** 2, weights=rows.weight)))
            return cls(title, settings, math.exp(middle), spread, rows)
        period = settings.period
        assert period is not None
        if isinstance(period, MagnitudeSection):
            return cls(title, settings, period.median_s / VELOCITY_PERIOD, period.period_dispersion)
        divisor = VELOCITY_PERIOD if period.definition == "velocity" else 1.0
        return cls(title, settings, period.median_s / divisor, period.dispersion)

    @classmethod
    def applies_to(cls, space: DesignSpace) -> bool:
        """Whether a campaign's variables contain a pulse."""
        try:
            VELOCITY.check(space, "")
        except InputError:
            return False
        return True

    @property
    def is_table(self) -> bool:
        """Whether the pulses are rows."""
        return self.rows is not None

    @property
    def alone(self) -> "Hazard | None":
        """The hazard of the pulses alone; None if nothing is added to them."""
        return self.without_uncertainty() if self.added_dispersion > 0.0 or self.bias != 0.0 else None

    def without_uncertainty(self) -> "Hazard":
        """The hazard of the pulses alone."""
        return replace(self, with_uncertainty=False)

    def at_bound(self, bound: Bound) -> "Hazard":
        """The hazard with another bound of the bearing's properties."""
        return replace(self, bound=bound)

    @property
    def bounds(self) -> tuple[Bound, ...]:
        """The property bounds that the file gives."""
        return ("lower", "nominal", "upper") if self.settings.properties else ("nominal",)

    @property
    def rates(self) -> tuple[Array, Array] | None:
        """Peak ground velocities [m/s] and the annual rates at which they are exceeded; None without a curve."""
        curve = self.settings.curve
        return None if curve is None else (np.array(curve.pgv_m_s), np.array(curve.annual_rate))

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

    @property
    def assumptions_at_levels(self) -> Sequence[str]:
        """What the question at each level assumes, as sentences."""
        if self.rows is None:
            return ()
        return ("At each PGV the periods have the distribution of all the hazard's pulses.",)

    def levels(self) -> Array:
        """Levels of the PGV, (n,): 24 in a factor of ten, which include the hazard's curve."""
        curve = self.settings.curve
        velocities = [*_RANGE, self.median, *(curve.pgv_m_s if curve else ())]
        first, last = (_PER_DECADE * np.log10(end) for end in (min(velocities), max(velocities)))
        steps = np.arange(int(np.floor(first + 1e-9)), int(np.ceil(last - 1e-9)) + 1)
        return np.asarray(10.0 ** (steps / _PER_DECADE))

    @property
    def median(self) -> float:
        """Median of the peak ground velocities [m/s]."""
        return self.median_velocity

    def question(self, space: DesignSpace, fixed: Mapping[str, float], at: float | None = None) -> Question:
        """The question that the hazard asks of a campaign.

        Given the peak ground velocity of the pulses, their period has its conditional distribution.

        Raises:
            InputError: as `check_applies` does, or if the pulses are rows and another variable has no value.
        """
        check_applies(self, space, fixed)
        pulses, certain = self.pulses(at)
        factors = self.factors
        if isinstance(pulses, WeightedRows):
            open_ones = [name for name in space.names if name not in {PERIOD, AMPLITUDE, *fixed}]
            if open_ones:
                raise InputError(
                    f"{open_ones[0]}: requires a value, because the hazard is a table of pulses. Give it with --fixed."
                )
            values = {**fixed, **certain}
            return Question(self.title, space.names, pulses, values, factors, stated=tuple(self.assumptions))
        changed = {parameter.name: parameter for parameter in pulses.parameters}
        correlation = [pair for pair in space.correlation if not {PERIOD, AMPLITUDE} & set(pair[:2])]
        question = asked_of(self.title, space, changed, {**fixed, **certain}, [*correlation, *pulses.correlation])
        return replace(question, factors=factors, stated=(*self.assumptions, *question.stated))

    def of_rates(self) -> "Hazard":
        """The pulses that occur as the curve says."""
        from activefail.analyses.fragility.curve import Rate
        from activefail.seismic.hazard.risk_target import pulses_of_curve

        assert self.rates is not None
        rate = Rate(*self.rates)
        title = f"pulses of at least {rate.least:g} m/s by the curve of {self.title}"
        return replace(self, title=title, rows=pulses_of_curve(rate, self.rows, self.period_given))

    def deaggregated(
        self,
        boundaries: Callable[[Array], Array],
        space: DesignSpace,
        fixed: Mapping[str, float],
        probability: Array,
    ) -> "list[Deaggregation]":
        """The failures beyond each boundary by the pulses (see `deaggregation.deaggregated`)."""
        from activefail.seismic.hazard.deaggregation import deaggregated

        question = self.without_uncertainty().question(space, fixed)
        return deaggregated(boundaries, question, self.added_dispersion, self.bias, probability)


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


def _lognormal(name: str, median: float, dispersion: float, unit: str) -> Parameter:
    numbers = {"median": median, "dispersion": dispersion}
    return Parameter.of_distribution(name, "lognormal", numbers, unit=unit, distance=radius(REACH, 2))


def read_hazard(path: Path) -> Hazard:
    """Read a hazard file."""
    return Hazard.of(read_toml(path), path)


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
    VELOCITY.check(space, "hazard")
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
