"""The pulse nearest to a record, and how well it stands for the record; predictions by it, and by reduced models."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from activefail.analyses.fragility.capacities import jackknife
from activefail.campaign.assembly import Campaign
from activefail.errors import InputError
from activefail.seismic.bearing.accelerogram import Accelerogram
from activefail.seismic.bearing.design import GRAVITY, TABLE_1, Model
from activefail.seismic.bearing.outcome import OUTCOMES
from activefail.seismic.bearing.pulse import HALF_DURATION, ground_acceleration, ground_velocity
from activefail.seismic.bearing.record_features import RECORD_FEATURES, record_features
from activefail.seismic.ida.capacity import Agreement, Capacities
from activefail.seismic.ida.simulations import BearingSubject
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.session.session import Session

_PERIODS = np.geomspace(0.25, 12.0, 60)
"""Periods that are tried first [s]."""

_SAMPLES = 400
"""Samples of a pulse as a record, over its three periods."""


@dataclass(frozen=True, eq=False)
class EquivalentPulse:
    """The pulse of the paper's eq. 1 that is nearest to a record in velocity, by least squares."""

    period: float  # T_p [s]
    amplitude: float  # A_p [m/s2], with its sign
    explained: float  # share of the velocity's energy ∫v² dt
    motion: Accelerogram  # the pulse as a record


def equivalent_pulse(record: Accelerogram) -> EquivalentPulse:
    """Fit period, amplitude, sign and time of a pulse to the velocity of a record.

    For each period the best time is the largest correlation of the record's velocity with that of the pulse (a matched
    filter), and the best amplitude follows.

    Raises:
        InputError: if the velocity is zero at all samples.
    """
    v = cumulative_trapezoid(record.acceleration, dx=record.dt, initial=0.0)
    energy = float(v @ v)
    if energy == 0.0:
        raise InputError(f"{record.name}: has no equivalent pulse, because its velocity is zero at all samples.")

    def fitted(period: float) -> tuple[float, float]:
        """The explained share, and the amplitude."""
        half = math.ceil(HALF_DURATION * period / record.dt)
        w = ground_velocity(record.dt * np.arange(-half, half + 1), 1.0, period)
        products = correlate(v, w, mode="full", method="fft")
        best = float(products[int(np.argmax(np.abs(products)))])
        return best**2 / (float(w @ w) * energy), best / float(w @ w)

    k = int(np.argmax([fitted(period)[0] for period in _PERIODS]))
    ends = math.log(_PERIODS[max(k - 1, 0)]), math.log(_PERIODS[min(k + 1, len(_PERIODS) - 1)])
    optimum = minimize_scalar(lambda x: -fitted(math.exp(x))[0], bounds=ends, method="bounded")
    period = math.exp(float(optimum.x))
    explained, amplitude = fitted(period)
    t = np.linspace(-HALF_DURATION * period, HALF_DURATION * period, _SAMPLES)
    sampled = np.array([ground_acceleration(one, amplitude, period) for one in t])
    name = f"pulse of {record.name}"
    return EquivalentPulse(period, amplitude, explained, Accelerogram(sampled, float(t[1] - t[0]), name))


@dataclass(frozen=True, eq=False)
class PulseComparison:
    """Records beside their equivalent pulses, scaled together.

    Attributes:
        pulses: of the n records.
        capacities: under the pulses, at the intensities of the records.
        mean: of ln(capacity under the pulse / capacity under the record); positive where the pulse is unconservative.
        interval: of the mean, over events; empty if it cannot be had.
        spread: standard deviation of the logarithm.
        compared: records with both capacities, each above a level that the bearing survives.
        levels: of the ladder, by the outcomes of record and pulse.
    """

    pulses: tuple[EquivalentPulse, ...]
    capacities: Capacities
    mean: float
    interval: tuple[float, float] | tuple[()]
    spread: float
    compared: int
    levels: Agreement


def compare_pulses(
    pulses: Sequence[EquivalentPulse],
    of_pulses: Capacities,
    of_records: Capacities,
    events: Sequence[str],
    rungs: Array,
) -> PulseComparison:
    """Compare the capacities of n records and of their pulses, and the outcomes at the ladder's levels.

    Args:
        pulses: of the records.
        of_pulses, of_records: their capacities.
        events: (n,) of the records.
        rungs: (k,) levels of the ladder.
    """
    # A bearing that fails at every level has a capacity between 0 and the lowest: not a number to compare.
    known = [np.isfinite(one.capacity) & (one.below > 0.0) for one in (of_pulses, of_records)]
    both = known[0] & known[1]
    ratio = np.log(of_pulses.capacity[both] / of_records.capacity[both])
    names = [event for event, kept in zip(events, both, strict=True) if kept]
    record, pulse = (one.on_ladder(rungs).ravel() for one in (of_records, of_pulses))
    answered, severity = (record >= 0) & (pulse >= 0), of_records.severity
    half = jackknife(lambda rows: float(ratio[rows].mean()), names) if len(ratio) else None
    mean = float(ratio.mean()) if len(ratio) else math.nan
    return PulseComparison(
        tuple(pulses),
        of_pulses,
        mean,
        () if half is None else (mean - half, mean + half),
        float(ratio.std(ddof=1)) if len(ratio) > 1 else math.nan,
        len(ratio),
        Agreement.of(record[answered] >= severity, pulse[answered] >= severity),
    )


@dataclass(frozen=True)
class Prediction:
    """What predicts the outcomes, and how often it is right."""

    by: str
    levels: Agreement
    outside: float | None = None  # share of the levels outside the campaign's design space, if there is one

    @property
    def text(self) -> str:
        """The counts in words."""
        counts = self.levels
        text = (
            f"the {self.by} predicts {counts.same} of {counts.levels} outcomes correctly; it misses {counts.missed} "
            f"failures, and predicts {counts.false} that did not happen"
        )
        if self.outside is None:
            return text
        return f"{text}; {100 * self.outside:.0f} % of these pulses lie outside the campaign's design space"


def predictions(
    subject: BearingSubject,
    motions: Sequence[Accelerogram],
    pulses: Sequence[EquivalentPulse],
    run: "Session | None",
    of_records: Capacities,
    levels: Array,
    intensities: Array,
) -> tuple[Prediction, ...]:
    """What predicts the outcome that is sought, or a worse one, at the k levels of the ladder under n records.

    The classifier of a campaign under pulses sees the equivalent pulses; the model is symmetric, so their signs do not
    matter. The reduced models see the records, and expect failure where m* > 0, and impact where v* > 0.

    Args:
        subject: the bearing.
        motions, pulses: the records and their pulses, (n,) each.
        run: of the campaign, or None.
        of_records: what was simulated.
        levels: (k,) of the ladder.
        intensities: (n,) of the records as they are.
    """
    severity, outcome = of_records.severity, of_records.on_ladder(levels).ravel()
    answered = np.flatnonzero(outcome >= 0)
    which, factors = answered // len(levels), (levels / intensities[:, None]).ravel()[answered]
    fails = outcome[answered] >= severity
    features = record_features(np.tile(subject.row, (len(which), 1)), motions, which, factors, subject.model)
    column = RECORD_FEATURES.index("m*" if severity == len(OUTCOMES) - 1 else "v*")
    reduced = Prediction("reduced model", Agreement.of(fails, features[:, column] > 0.0))
    if run is None:
        return (reduced,)
    period, amplitude = np.array([[one.period, one.amplitude] for one in pulses])[which].T
    columns: dict[str, Any] = {**subject.values, "T_p": period, "A_p": np.abs(factors * amplitude) / GRAVITY}
    space = run.campaign.space
    X = np.column_stack([np.broadcast_to(columns[name], len(which)) for name in space.names])
    predicted = run.classifier.probabilities(X)[:, severity:].sum(axis=1) >= 0.5
    outside = float(np.mean(~space.contains(X)))
    return Prediction("classifier at the pulse", Agreement.of(fails, predicted), outside), reduced


def check_campaign(campaign: Campaign, values: Mapping[str, float], model: Model) -> None:
    """Check that a campaign is one of this bearing under pulses."""
    space, outcomes = campaign.space, tuple(campaign.simulator.outcomes)
    known = (*space.names, *space.fixed)
    if set(known) != set(TABLE_1.names) or not {"T_p", "A_p"} <= set(space.names) or outcomes != OUTCOMES:
        raise InputError(
            f"--campaign: must be a campaign under pulses, with the variables {', '.join(TABLE_1.names)} and the "
            f"outcomes {', '.join(OUTCOMES)}; got {', '.join(known)} and {', '.join(outcomes)}."
        )
    if campaign.settings.named["dfp"].model() != model:
        raise InputError(
            "--campaign: its [bearing] settings differ from this command's options. Give this command the same values."
        )
    for name, fixed in space.fixed.items():
        if values[name] != fixed:
            raise InputError(f"--campaign: fixes {name} to {fixed:g}, but the bearing has {values[name]:g}.")
