"""The pulse nearest to a record, and how well it stands for the record: the capacities of both."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.pulse import HALF_DURATION, ground_acceleration, ground_velocity
from activefail.errors import InputError
from activefail.risk.ida.capacity import Capacities
from activefail.risk.ida.collapse import jackknife
from activefail.risk.ida.predictions import Agreement
from activefail.space import Array

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
