"""The rate of failure from a fragility curve and the rates at which ground motion is exceeded; the risk in 50 years."""

import math
from typing import NamedTuple

import numpy as np

from activefail.risk.fragility.curve import Curve
from activefail.space import Array

YEARS = 50.0
"""Years of the stated risk."""

_STEPS = 2000
"""Steps of the integral."""


class Risk(NamedTuple):
    """The rate of failure."""

    annual_rate: float  # λ [1/year]
    in_50_years: float  # probability of at least one failure, 1 − exp(−50 λ)
    outside: float  # share of λ from intensities outside the hazard's curve, where its ends are extrapolated
    beyond: float  # share of λ from intensities above the fragility curve, where its last value holds


def exceedance(velocities: Array, rates: Array, levels: Array) -> Array:
    """Annual rates at which levels are exceeded: linear in logarithms, extrapolated by the end's slope.

    Args:
        velocities: (m,) of the hazard's curve, increasing.
        rates: (m,) decreasing.
        levels: (n,).
    """
    x, y, at = np.log(velocities), np.log(rates), np.log(levels)
    segment = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    slope = np.diff(y) / np.diff(x)
    return np.asarray(np.exp(y[segment] + slope[segment] * (at - x[segment])))


def risk_of(curve: Curve, velocities: Array, rates: Array) -> Risk:
    """The risk: λ = ∫ P(v) |dν(v)| with the annual rate ν(v) of exceedance.

    Args:
        curve: P(v), against the intensity of the hazard's curve.
        velocities, rates: the hazard's curve.
    """
    low, high = (float(end) for end in np.log(curve.ladder.levels[[0, -1]]))
    corners = np.log(velocities)
    corners = corners[(corners > low) & (corners < high)]
    logarithms = np.unique(np.concatenate([np.linspace(low, high, _STEPS + 1), corners]))
    levels = np.exp(logarithms)
    nu = exceedance(velocities, rates, levels)
    middle = np.exp(0.5 * (logarithms[1:] + logarithms[:-1]))
    # Simpson's rule for the probability in each step of the rate.
    average = (curve.at(levels[:-1]) + 4.0 * curve.at(middle) + curve.at(levels[1:])) / 6.0
    parts = average * (nu[:-1] - nu[1:])
    beyond = float(curve.probability[-1] * nu[-1])
    total = float(parts.sum()) + beyond
    if total <= 0.0:
        return Risk(0.0, 0.0, 0.0, 0.0)
    within = (middle >= velocities[0]) & (middle <= velocities[-1])
    inside = float(parts[within].sum())
    return Risk(total, -math.expm1(-YEARS * total), 1.0 - inside / total, beyond / total)
