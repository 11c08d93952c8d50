"""Incremental dynamic analysis of one bearing: the findings in numbers and words."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from activefail.accelerogram_sets import RecordSet
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import TABLE_1, Model, Tolerance
from activefail.bearing.outcome import OUTCOMES
from activefail.errors import InputError
from activefail.risk.ida.capacity import Capacities, capacities, on_ladder
from activefail.risk.ida.collapse import CONFIDENCE, Fragility, Margin, collapse_margin, fitted
from activefail.risk.ida.equivalent_pulse import EquivalentPulse, PulseComparison, compare_pulses, equivalent_pulse
from activefail.risk.ida.intensity import Intensity
from activefail.risk.ida.p695 import MarginOptions
from activefail.risk.ida.predictions import Agreement, Prediction, Surrogate, predicted_by_reduced_model
from activefail.space import Array

LEVELS, BISECTIONS = 10, 5
"""Levels of the ladder, and of the bisection after it."""

_LARGEST = {"factor": 8.0, "pga": 3.0, "pgv": 4.0, "sa": 2.0}
"""Highest level of the ladder by default, by the kind of the intensity."""

_LOWEST = 1.0 / 16.0
"""The lowest level over the highest."""


def ladder(intensity: Intensity, highest: float | None = None) -> Array:
    """The rising levels of an analysis, with equal ratios between them.

    Raises:
        InputError: if the highest level is not positive.
    """
    top = _LARGEST[intensity.kind] if highest is None else highest
    if not (np.isfinite(top) and top > 0.0):
        raise InputError(f"--to: must be positive, got {top:g}.")
    return np.geomspace(_LOWEST * top, top, LEVELS)


@dataclass(frozen=True, eq=False)
class IdaFindings:
    """What an incremental dynamic analysis found.

    Attributes:
        bearing: (7,) T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5].
        model, tolerance: of all simulations.
        records: the set.
        intensity: of all levels.
        outcome: the outcome that is sought.
        found: the capacities.
        fragility: of the outcome, or a worse one; None if fewer than two records have a capacity.
        pulses: the comparison with equivalent pulses; None if it was not asked for.
        predictions: what predicts the outcomes at the ladder's levels, with `pulses`.
        margin: of FEMA P695; None if it was not asked for, or there is no fragility.
        options: of the margin.
    """

    bearing: Array
    model: Model
    tolerance: Tolerance
    records: RecordSet
    intensity: Intensity
    outcome: str
    found: Capacities
    fragility: Fragility | None
    margin: Margin | None
    options: MarginOptions | None
    pulses: PulseComparison | None = None
    predictions: tuple[Prediction, ...] = ()

    @property
    def failed(self) -> int:
        """Number of records with a capacity."""
        return int(np.isfinite(self.found.capacity).sum())

    @property
    def highest(self) -> float:
        """The highest level."""
        return float(self.found.levels[0][-1])

    @property
    def lowest(self) -> float:
        """The lowest level of the ladder; bisection may have gone lower."""
        return _LOWEST * self.highest

    @property
    def empirical(self) -> tuple[Array, Array]:
        """Capacities, rising, and the share of all records that have failed there, (m,) each."""
        capacity = np.sort(self.found.capacity[np.isfinite(self.found.capacity)])
        return capacity, np.arange(1, len(capacity) + 1) / len(self.found.capacity)

    @property
    def misfit(self) -> float:
        """Largest distance between the lognormal curve and the share of failed records; NaN without a curve."""
        levels, share = self.empirical
        if self.fragility is None:
            return float("nan")
        curve = ndtr(np.log(levels / self.fragility.fit.median) / self.fragility.fit.dispersion)
        before = share - 1.0 / len(self.found.capacity)
        return float(np.max(np.maximum(np.abs(curve - share), np.abs(curve - before))))

    @property
    def cmr_interval(self) -> tuple[float, ...]:
        """The interval of the collapse margin ratio, from that of the median; empty without one."""
        if self.fragility is None or self.options is None:
            return ()
        return tuple(end / self.options.mce for end in self.fragility.median)

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Titles and texts for a terminal."""
        unit = f" {self.intensity.unit}" if self.intensity.unit else ""
        count, records = len(self.found.capacity), self.records
        vertical = "with vertical components, " if records.has_vertical else ""
        lines = [
            ("records", f"{count} of {records.events} events, {vertical}scaled to {self.intensity.name}"),
            ("runs", f"{self.found.runs} simulations up to {self.highest:.3g}{unit}"),
            (self.outcome, f"{self.failed} of {count} records reach it"),
        ]
        if self.fragility is not None:
            fit, m, d = self.fragility.fit, self.fragility.median, self.fragility.dispersion
            lines += [
                ("median", f"{fit.median:.3g}{unit}{_interval(m)}"),
                ("dispersion", f"{fit.dispersion:.3g}{_interval(d)}"),
                (
                    "misfit",
                    f"the lognormal curve differs by at most {self.misfit:.2f} from the share of records that have "
                    "failed",
                ),
            ]
        if self.pulses is not None:
            lines += _pulse_lines(self.pulses)
            lines += [(one.title, one.text) for one in self.predictions]
        if self.margin is not None and self.options is not None:
            margin, factor = self.margin, self.options.shape_factor
            lines += [
                ("CMR", f"{margin.cmr:.3g}{_interval(self.cmr_interval)}"),
                (
                    "ACMR",
                    f"{margin.acmr:.3g} with a shape factor of {factor:.4g}"
                    f"{_interval(tuple(factor * end for end in self.cmr_interval))}",
                ),
            ]
            for share, least in (("10", margin.acceptable_10), ("20", margin.acceptable_20)):
                verdict = _verdict(margin.acmr, [factor * end for end in self.cmr_interval], least)
                lines.append((f"ACMR{share}%", f"{least:.3g} for β = {self.options.total_dispersion:.3g}: {verdict}"))
        return lines

    @property
    def notes(self) -> list[str]:
        """What is assumed, and what to know of the runs, as sentences."""
        found, notes = self.found, list[str]()
        at_lowest = int((found.capacity <= self.lowest).sum())
        if self.fragility is None:
            lower = "Lower" if 2 * at_lowest > len(found.capacity) else "Raise"
            without = "curve" if self.options is None else "curve and no margin"
            notes.append(
                "Fewer than two records both survive a level and reach the outcome at a higher one, so there is no "
                f"{without}. {lower} the levels with --to."
            )
        elif not self.fragility.median:
            notes.append("The curve has no interval: there are too few events, or too few of them with a capacity.")
        if self.fragility is not None and self.fragility.fit.median > self.highest:
            notes.append("The median lies above the highest level: it is an extrapolation. Raise the levels with --to.")
        notes += self.records.notes
        if self.records.has_vertical:
            notes.append(
                "Intensities are those of the horizontal components. The vertical ones are scaled by the same factors."
            )
            if self.pulses is not None:
                notes.append("The pulses and the reduced model have no vertical component.")
        if self.failed < len(found.capacity):
            notes.append("Records that never fail enter the fit as capacities above the highest level.")
        if at_lowest:
            notes.append(
                f"{at_lowest} of the records fail at the lowest level of the ladder, {self.lowest:.3g}, and are "
                "known less closely. Use a lower --to."
            )
        if risen := int((found.resurrections > 0).sum()):
            notes.append(
                f"Under {risen} of the records the bearing survives a level above its capacity. The capacity is the "
                "lowest level that fails among those that were simulated."
            )
        if lifted := int(found.lifted.sum()):
            notes.append(
                f"In {lifted} of the simulations the slider rocks so far that a plate rises above the rim before "
                "the slider touches a rim. They count as failures."
            )
        if failures := int(found.numerical_failures.sum()):
            notes.append(
                f"{failures} of the simulations failed numerically. They count as neither survived nor failed, so the "
                "capacities of their records are less certain than the fit assumes."
            )
        if self.pulses is not None and self.pulses.compared < len(found.capacity):
            left_out = len(found.capacity) - self.pulses.compared
            notes.append(
                f"{left_out} of the records, or their pulses, never fail or fail at every level, and are not in the "
                "ratio. If it is the pulses that never fail, the ratio is probably too small."
            )
        notes.append("Capacities, shares of records, counts of levels and the misfit have no interval.")
        notes.append(
            f"The {100 * CONFIDENCE:g} % intervals are for other records of the same kind. They do not cover the "
            "model, the scaling of records, or a lognormal curve that does not fit."
        )
        if self.margin is not None and self.options is not None:
            if self.outcome != OUTCOMES[-1]:
                notes.append(f"The margin is that of the outcome {self.outcome}, which is not a collapse.")
            notes.append(f"{self.options.note} The acceptable ACMR assumes a lognormal capacity with β.".lstrip())
        return notes

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        found, fragility, margin = self.found, self.fragility, self.margin
        rows = zip(self.records.records, found.below, found.capacity, strict=True)
        return {
            "bearing": dict(zip(TABLE_1.names, self.bearing.tolist(), strict=False)),
            "model": asdict(self.model),
            "tolerance": self.tolerance.relative,
            "outcome": self.outcome,
            "intensity": self.intensity.name,
            "unit": self.intensity.unit,
            "simulations": found.runs,
            "events": self.records.events,
            "vertical": self.records.has_vertical,
            "highest_level": self.highest,
            "records": [
                {
                    "record": one.motion.name,
                    "event": one.event,
                    "intensity": self.intensity.of_record(one.motion),
                    "below": float(below),
                    "capacity": float(capacity) if np.isfinite(capacity) else None,
                    "resurrections": int(found.resurrections[k]),
                    "numerical_failures": int(found.numerical_failures[k]),
                    "lifted": int(found.lifted[k]),
                }
                for k, (one, below, capacity) in enumerate(rows)
            ],
            "median": None if fragility is None else fragility.fit.median,
            "median_interval": None if fragility is None else list(fragility.median) or None,
            "dispersion": None if fragility is None else fragility.fit.dispersion,
            "dispersion_interval": None if fragility is None else list(fragility.dispersion) or None,
            "confidence": CONFIDENCE,
            "misfit": None if fragility is None else self.misfit,
            "cmr": None if margin is None else margin.cmr,
            "cmr_interval": list(self.cmr_interval) or None,
            "shape_factor": None if self.options is None else self.options.shape_factor,
            "beta_total": None if self.options is None else self.options.total_dispersion,
            "acmr": None if margin is None else margin.acmr,
            "acceptable_acmr_10": None if margin is None else margin.acceptable_10,
            "acceptable_acmr_20": None if margin is None else margin.acceptable_20,
            "pulses": None if self.pulses is None else _pulses_as_json(self.pulses),
            "predictions": [{"by": one.by, **one.levels.as_json(), "outside": one.outside} for one in self.predictions],
            "notes": self.notes,
        }


def _verdict(acmr: float, interval: Sequence[float], least: float) -> str:
    """Whether a margin is acceptable; undecided if its interval contains the least acceptable value."""
    if interval and interval[0] < least <= interval[1]:
        return f"{'met' if acmr >= least else 'not met'}, but the interval of the ACMR contains this value"
    return "met" if acmr >= least else "not met"


def _pulse_lines(compared: PulseComparison) -> list[tuple[str, str]]:
    low, middle, high = np.quantile([one.explained for one in compared.pulses], [0.1, 0.5, 0.9])
    lines = [("pulses", f"explain {low:.2f}, {middle:.2f}, {high:.2f} of the velocity's energy (10, 50, 90 %)")]
    if compared.compared:
        ends = tuple(math.exp(end) for end in compared.interval)
        lines.append(
            (
                "ratio",
                f"a pulse alone fails at {math.exp(compared.mean):.3g} times its record's intensity{_interval(ends)}; "
                f"sd of the logarithm {compared.spread:.2g}; {compared.compared} records",
            )
        )
    levels = compared.levels
    lines.append(
        (
            "levels",
            f"{levels.same} of {levels.levels} outcomes are the same; {levels.missed} "
            f"failures missed by the pulse, {levels.false} only under the pulse",
        )
    )
    return lines


def _pulses_as_json(compared: PulseComparison) -> dict[str, Any]:
    return {
        "pulses": [
            {
                "period": one.period,
                "amplitude": one.amplitude,
                "explained": one.explained,
                "capacity": float(capacity) if np.isfinite(capacity) else None,
            }
            for one, capacity in zip(compared.pulses, compared.found.capacity, strict=True)
        ],
        "mean_log_ratio": compared.mean,
        "mean_log_ratio_interval": list(compared.interval) or None,
        "sd_log_ratio": compared.spread,
        "compared": compared.compared,
        **compared.levels.as_json(),
    }


def _interval(ends: tuple[float, ...]) -> str:
    return f" ({100 * CONFIDENCE:g} % interval {ends[0]:.3g} to {ends[1]:.3g})" if ends else " (no interval)"


def analyse(
    bearing: Array,
    records: RecordSet,
    intensity: Intensity,
    outcome: str = OUTCOMES[-1],
    highest: float | None = None,
    options: MarginOptions | None = None,
    pulses: bool = False,
    surrogate: Surrogate | None = None,
    model: Model | None = None,
    tolerance: Tolerance | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> IdaFindings:
    """The incremental dynamic analysis of a bearing under a set of records.

    Args:
        bearing: (7,) T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5].
        records: the set.
        intensity: by which records are scaled.
        outcome: "impact" or "failure"; worse outcomes count too.
        highest: level of the ladder; by default 8, 3 g, 4 m/s or 2 g.
        options: of the collapse margin; None for none.
        pulses: whether to compare the records with their equivalent pulses, and with predictions.
        surrogate: a campaign's classifier, to predict the outcomes under the equivalent pulses.
        model, tolerance, threads, progress: as for `simulate_records`.

    Raises:
        InputError: if an argument is invalid.
    """
    if outcome not in OUTCOMES[1:]:
        raise InputError(f"outcome: must be one of {', '.join(OUTCOMES[1:])}, got {outcome!r}.")
    model, tolerance = model or Model(), tolerance or Tolerance()
    motions, severity = [record.motion for record in records.records], OUTCOMES.index(outcome)
    levels = ladder(intensity, highest)
    own = np.array([intensity.of_record(motion) for motion in motions])

    def capacities_under(ground: Sequence[Accelerogram]) -> Capacities:
        return capacities(bearing, ground, own, levels, BISECTIONS, severity, model, tolerance, threads, progress)

    found = capacities_under(motions)
    events = [record.event for record in records.records]
    fragility = fitted(found.below, found.capacity, events)
    margin = compared = None
    predictions: tuple[Prediction, ...] = ()
    if options is not None and fragility is not None:
        margin = collapse_margin(fragility.fit.median, options.mce, options.shape_factor, options.total_dispersion)
    if pulses:
        nearest = [equivalent_pulse(motion) for motion in motions]
        of_pulses = capacities_under([one.motion for one in nearest])
        compared = compare_pulses(nearest, of_pulses, found, events, levels, severity)
        predictions = _predictions(bearing, motions, nearest, surrogate, found, own, levels, severity, model)
    return IdaFindings(
        bearing, model, tolerance, records, intensity, outcome, found, fragility, margin, options, compared, predictions
    )


def _predictions(
    bearing: Array,
    motions: Sequence[Accelerogram],
    pulses: Sequence[EquivalentPulse],
    surrogate: Surrogate | None,
    found: Capacities,
    own: Array,
    levels: Array,
    severity: int,
    model: Model,
) -> tuple[Prediction, ...]:
    """What predicts the outcomes at the ladder's levels without simulating them."""
    outcome = on_ladder(found, levels).ravel()
    which, factors = np.repeat(np.arange(len(motions)), len(levels)), (levels / own[:, None]).ravel()
    answered = outcome >= 0
    fails, which, factors = outcome[answered] >= severity, which[answered], factors[answered]
    predictions = []
    if surrogate is not None:
        period, amplitude = (np.array([getattr(one, name) for one in pulses]) for name in ("period", "amplitude"))
        predicted, outside = surrogate.under_pulses(bearing, period[which], factors * amplitude[which])
        predictions.append(Prediction("classifier", "classifier at the pulse", Agreement.of(fails, predicted), outside))
    predicted = predicted_by_reduced_model(bearing, motions, which, factors, severity, model)
    predictions.append(Prediction("reduced", "reduced model", Agreement.of(fails, predicted)))
    return tuple(predictions)
