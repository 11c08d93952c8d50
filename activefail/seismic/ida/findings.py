"""The findings of an incremental dynamic analysis in numbers and words."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr

from activefail.analyses.findings.lines import titled
from activefail.analyses.fragility.capacities import CONFIDENCE, LARGEST, Fragility, fitted
from activefail.seismic.bearing.terms import Terms
from activefail.seismic.ida.capacity import LOWEST, Capacities
from activefail.seismic.ida.equivalent_pulse import Prediction, PulseComparison
from activefail.seismic.ida.p695 import MarginOptions
from activefail.seismic.ida.simulations import BearingSubject, CampaignSubject
from activefail.seismic.motions.accelerogram_sets import RecordSet
from activefail.seismic.motions.intensity import Intensity
from activefail.space.shares import significant
from activefail.space.space import Array
from activefail.text.json_text import json_values, named
from activefail.visible import or_worse


@dataclass(frozen=True, eq=False)
class IdaFindings:
    """What an incremental dynamic analysis found."""

    subject: BearingSubject | CampaignSubject  # the bearing, or a campaign with values of its variables
    records: RecordSet  # the set
    intensity: Intensity  # of all levels
    outcome: str  # the outcome that is sought
    capacities: Capacities  # under the records
    highest: float  # the highest level
    options: MarginOptions | None = None  # of the margin of FEMA P695; None if it was not asked for
    pulses: PulseComparison | None = None  # the comparison with equivalent pulses; None if it was not asked for
    predictions: tuple[Prediction, ...] = ()  # what predicts the outcomes at the ladder's levels, with `pulses`

    exit_code = 0

    @cached_property
    def terms(self) -> Terms | None:
        """The bearing in the designer's terms; None for a campaign's simulator."""
        one = self.subject
        return Terms.of(one.values, one.model) if isinstance(one, BearingSubject) else None

    def _fitted(self, capacities: Capacities) -> Fragility | None:
        return fitted(capacities.below, capacities.capacity, [record.event for record in self.records.records])

    @cached_property
    def fragility(self) -> Fragility | None:
        """Of the outcome, or a worse one; None if fewer than two records have a capacity."""
        return self._fitted(self.capacities)

    @cached_property
    def if_lost_fail(self) -> Fragility | None:
        """The fragility if the simulations without an outcome are failures; None if all have one."""
        return self._fitted(self.capacities.if_lost_fail) if self.capacities.numerical_failures.any() else None

    @property
    def cmr(self) -> float:
        """The collapse margin ratio: the median over the intensity of the MCE; NaN if either is unknown."""
        if self.fragility is None or self.options is None:
            return math.nan
        return self.fragility.fit.median / self.options.mce

    @property
    def acmr(self) -> float:
        """The collapse margin ratio times the spectral shape factor of [FEMA2009]; NaN as for `cmr`."""
        return self.options.shape_factor * self.cmr if self.options else math.nan

    @property
    def is_of_worst(self) -> bool:
        """Whether the outcome that is sought is the most severe one."""
        return self.outcome == self.subject.outcomes[-1]

    @property
    def event(self) -> str:
        """The outcome that is sought, or a worse one, in words."""
        return or_worse(self.outcome, self.subject.outcomes)

    @property
    def failed(self) -> int:
        """Number of records with a capacity."""
        return int(np.isfinite(self.capacities.capacity).sum())

    @property
    def lowest(self) -> float:
        """The lowest level of the ladder; bisection may have gone lower."""
        return LOWEST * self.highest

    @property
    def empirical(self) -> tuple[Array, Array]:
        """Capacities, rising, and the share of all records that have failed there, (m,) each."""
        capacity = np.sort(self.capacities.capacity[np.isfinite(self.capacities.capacity)])
        return capacity, np.arange(1, len(capacity) + 1) / len(self.capacities.capacity)

    @property
    def misfit(self) -> float:
        """Largest distance between the lognormal curve and the share of failed records; NaN without a curve."""
        levels, share = self.empirical
        if self.fragility is None:
            return float("nan")
        curve = ndtr(np.log(levels / self.fragility.fit.median) / self.fragility.fit.dispersion)
        before = share - 1.0 / len(self.capacities.capacity)
        return float(np.max(np.maximum(np.abs(curve - share), np.abs(curve - before))))

    @property
    def cmr_interval(self) -> tuple[float, ...] | None:
        """The interval of the collapse margin ratio, from that of the median; None without one."""
        ends = self.fragility.median if self.fragility else ()
        return tuple(end / self.options.mce for end in ends) if self.options and ends else None

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        return titled(self.rows, 11) + [f"note: {note}" for note in self.notes]

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts."""
        unit = f" {self.intensity.unit}" if self.intensity.unit else ""
        count, records = len(self.capacities.capacity), self.records
        worse = "" if self.is_of_worst else ", or a worse outcome"
        vertical = "with vertical components, " if records.has_vertical else ""
        rows = [] if self.terms is None else self.terms.lines()
        now = ""
        if isinstance(self.subject, CampaignSubject):
            rows.append(("simulator", f"of {self.subject.name}"))
            if self.subject.simulated < self.capacities.runs:
                now = f", {self.subject.simulated} of them now"
        rows += [
            ("records", f"{count} from {records.events} events, {vertical}scaled to {self.intensity.name}"),
            ("runs", f"{self.capacities.runs} simulations up to {self.highest:.3g}{unit}{now}"),
            (self.outcome, f"{self.failed} of {count} records reach it{worse}"),
        ]
        if self.fragility is not None:
            fit, m, d = self.fragility.fit, self.fragility.median, self.fragility.dispersion
            differs = f"the lognormal curve differs by at most {self.misfit:.2f} from the share of records with a"
            rows += [
                ("median", f"{significant(fit.median)}{unit}{_interval(m)}"),
                ("dispersion", f"{significant(fit.dispersion)}{_interval(d)}"),
                ("misfit", f"{differs} capacity up to the level"),
            ]
        if (lost := self.if_lost_fail) is not None:
            text = f"median {significant(lost.fit.median)}{unit}{_interval(lost.median)}, dispersion "
            text += significant(lost.fit.dispersion)
            rows.append(("if lost", f"{text}, if the simulations without a result are failures"))
        if self.pulses is not None:
            rows += _pulse_lines(self.pulses)
            rows += [(one.by.split()[0], one.text) for one in self.predictions]
        if self.fragility is not None and self.options is not None:
            factor, dispersion = self.options.shape_factor, self.options.total_dispersion
            ends = tuple(factor * end for end in self.cmr_interval or ())
            rows += [
                ("CMR", f"{significant(self.cmr)}{_interval(self.cmr_interval or ())}"),
                ("ACMR", f"{significant(self.acmr)} with a shape factor of {factor:.4g}{_interval(ends)}"),
            ]
            for share in (0.10, 0.20):
                least = self.options.acceptable(share)
                text = f"{least:.3g} for β = {dispersion:.3g}: {_verdict(self.acmr, ends, least)}"
                rows.append((f"ACMR{100 * share:g}%", text))
        return rows

    @property
    def notes(self) -> list[str]:
        """What is assumed, and what to know of the runs, as sentences."""
        capacities, notes, count = self.capacities, list[str](), len(self.capacities.capacity)
        at_lowest, failures = int((capacities.capacity <= self.lowest).sum()), int(capacities.numerical_failures.sum())
        if self.fragility is None:
            # Motions that are far too strong have no outcome, rather than a capacity at the lowest level.
            lower = "Lower" if 2 * at_lowest > count or failures > count else "Raise"
            without = "curve" if self.options is None else "curve and no collapse margin ratio"
            notes.append(
                "Fewer than two records both survive a level and reach the outcome at a higher one, so there is no "
                f"{without}. {lower} the levels with --to."
            )
        elif not self.fragility.median:
            notes.append("The curve has no interval: there are too few events, or too few of them with a capacity.")
        elif self.fragility.dispersion and self.fragility.dispersion[1] == LARGEST:
            notes.append(
                f"The interval of the dispersion ends at {LARGEST:g}, the largest that a fit may have: there are too "
                "few events to say more."
            )
        if self.fragility is not None and self.fragility.fit.median > self.highest:
            notes.append("The median lies above the highest level: it is an extrapolation. Raise the levels with --to.")
        notes += self.records.notes
        if self.records.has_vertical:
            notes.append(
                "Intensities are those of the horizontal components. The vertical ones are scaled by the same factors."
            )
            if self.pulses is not None:
                notes.append("The pulses and the reduced model have no vertical component.")
        if self.failed < count:
            notes.append(
                "Records without a capacity enter the fit as capacities above the highest level that they survived."
            )
        if at_lowest:
            notes.append(
                f"{at_lowest} of the records have a capacity at or below the lowest level of the ladder, "
                f"{self.lowest:.3g}. These capacities are less accurate. Use a lower --to."
            )
        if risen := int((capacities.resurrections > 0).sum()):
            notes.append(
                f"Under {risen} of the records, the outcome does not occur at some level above the capacity. The "
                "capacity is the lowest simulated level at which it occurs."
            )
        if lifted := int(capacities.lifted.sum()):
            notes.append(
                f"In {lifted} of the simulations a plate rises above its rim and the bearing fails before the slider "
                "touches a rim. They count as failures."
            )
        if failures:
            notes.append(
                f"{failures} of the simulations failed numerically. They count as neither survived nor failed. If they "
                "are failures, the line `if lost` holds; for a custom simulator, simulator.lost says so. "
                f"{self.subject.fault}".rstrip()
            )
        if self.pulses is not None and self.pulses.compared < count:
            notes.append(
                f"{count - self.pulses.compared} of the records are not in the ratio: under the record or its pulse, "
                "the outcome occurs at no level or at every level. If it occurs at no level under the pulses, the "
                "ratio is probably too small."
            )
        notes += self.subject.notes
        notes.append("Capacities, shares of records, counts of levels and the misfit have no interval.")
        notes.append(
            f"The {100 * CONFIDENCE:g} % intervals are for other records of the same kind. They do not cover the "
            "model, the scaling of records, or a lognormal curve that does not fit."
        )
        if self.fragility is not None and self.options is not None:
            if not self.is_of_worst:
                notes.append(f"The margin ratio is that of the outcome {self.outcome}, which is not a collapse.")
            notes.append(f"{self.options.note} The acceptable ACMR assumes a lognormal capacity with β.".lstrip())
        return notes

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        subject, capacities, options, pulses = self.subject, self.capacities, self.options, self.pulses
        bearing = subject if isinstance(subject, BearingSubject) else None
        columns = ("below", "capacity", "resurrections", "numerical_failures", "lifted")
        of_records = zip(*(getattr(capacities, name) for name in columns), strict=True)
        records = [
            {"record": one.motion.name, "event": one.event, "intensity": self.intensity.of_record(one.motion)}
            | dict(zip(columns, numbers, strict=True))
            for one, numbers in zip(self.records.records, of_records, strict=True)
        ]
        margin = options if self.fragility else None
        values = {
            "bearing": subject.values,
            "terms": self.terms and self.terms.as_json(),
            "simulator": subject.name if isinstance(subject, CampaignSubject) else None,
            "model": bearing and bearing.model,
            "tolerance": bearing and bearing.tolerance.relative,
            "outcome": self.outcome,
            "intensity": self.intensity.name,
            "unit": self.intensity.unit,
            "simulations": capacities.runs,
            "events": self.records.events,
            "vertical": self.records.has_vertical,
            "highest_level": self.highest,
            "records": records,
            "if_lost_fail": self.if_lost_fail and _numbers(self.if_lost_fail),
            **_numbers(self.fragility),
            "confidence": CONFIDENCE,
            **named(self, "misfit", "cmr", "cmr_interval"),
            "shape_factor": options and options.shape_factor,
            "beta_total": options and options.total_dispersion,
            "acmr": self.acmr,
            "acceptable_acmr_10": margin and margin.acceptable(0.10),
            "acceptable_acmr_20": margin and margin.acceptable(0.20),
            "pulses": pulses and _pulses_as_json(pulses),
            "predictions": [{"by": one.by, **asdict(one.levels), "outside": one.outside} for one in self.predictions],
            "notes": self.notes,
        }
        return json_values(values)


def _pulses_as_json(compared: PulseComparison) -> dict[str, Any]:
    pairs = zip(compared.pulses, compared.capacities.capacity, strict=True)
    return {
        "pulses": [named(one, "period", "amplitude", "explained") | {"capacity": at} for one, at in pairs],
        "mean_log_ratio": compared.mean,
        "mean_log_ratio_interval": compared.interval or None,
        "sd_log_ratio": compared.spread,
        "compared": compared.compared,
        **asdict(compared.levels),
    }


def _numbers(fragility: Fragility | None) -> dict[str, Any]:
    if fragility is None:
        return dict.fromkeys(("median", "median_interval", "dispersion", "dispersion_interval"))
    return {
        "median": fragility.fit.median,
        "median_interval": fragility.median or None,
        "dispersion": fragility.fit.dispersion,
        "dispersion_interval": fragility.dispersion or None,
    }


def _verdict(acmr: float, interval: Sequence[float], least: float) -> str:
    """Whether a margin is acceptable; undecided if its interval contains the least acceptable value."""
    verdict = "met" if acmr >= least else "not met"
    contains = interval and interval[0] < least <= interval[1]
    return f"{verdict}, but the interval of the ACMR contains this value" if contains else verdict


def _pulse_lines(compared: PulseComparison) -> list[tuple[str, str]]:
    low, middle, high = np.quantile([one.explained for one in compared.pulses], [0.1, 0.5, 0.9])
    rows = [("pulses", f"explain {low:.2f}, {middle:.2f}, {high:.2f} of the velocity's energy (10, 50, 90 %)")]
    if compared.compared:
        text = (
            f"a pulse alone causes the outcome at {math.exp(compared.mean):.3g} times its record's intensity"
            f"{_interval(tuple(map(math.exp, compared.interval)))}; sd of the logarithm {compared.spread:.2g}; "
            f"{compared.compared} records"
        )
        rows.append(("ratio", text))
    levels = compared.levels
    text = (
        f"record and pulse cause the same outcome at {levels.same} of {levels.levels} levels; at {levels.missed} only "
        f"the record causes failure, at {levels.false} only the pulse"
    )
    return [*rows, ("levels", text)]


def _interval(ends: tuple[float, ...]) -> str:
    return f" ({100 * CONFIDENCE:g} % interval {' to '.join(map(significant, ends))})" if ends else " (no interval)"
