"""The fragility that follows from the capacities under records: a lognormal fit, its interval over events, P695."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr, ndtri

from activefail.space import Array

CONFIDENCE = 0.95
_BOOTSTRAPS = 1000

_BOUNDS = (math.log(0.02), math.log(3.0))
"""Of the logarithm of the dispersion, beyond which data of a few records say nothing."""


@dataclass(frozen=True)
class Lognormal:
    """A lognormal fragility: P(x) = Φ(ln(x/median)/dispersion)."""

    median: float
    dispersion: float

    def quantile(self, probability: float) -> float:
        """The intensity at which the curve has a probability."""
        return self.median * math.exp(self.dispersion * float(ndtri(probability)))


def fit_lognormal(below: Array, capacity: Array) -> Lognormal | None:
    """The lognormal curve of largest likelihood, from capacities that lie in (below, capacity], (n,) each.

    A record that never fails has an infinite capacity, and says only that it lies above `below`. None if fewer than two
    records fail: the data then do not bound the curve.
    """
    if int(np.isfinite(capacity).sum()) < 2:
        return None
    with np.errstate(divide="ignore"):
        low, high = np.log(below), np.log(capacity)

    def loss(parameters: Array) -> float:
        mean, scale = parameters[0], math.exp(parameters[1])
        upper, lower = log_ndtr((high - mean) / scale), log_ndtr((low - mean) / scale)
        # ln(Φ(b) − Φ(a)); where a record never fails the mirrored tail keeps its digits.
        never = np.isinf(high)
        tail = log_ndtr((mean - low) / scale)
        inside = upper + np.log(-np.expm1(np.minimum(lower - upper, -1e-300)))
        return -float(np.where(never, tail, np.maximum(inside, -1e3)).sum())

    middle = np.where(np.isfinite(high), np.where(np.isfinite(low), 0.5 * (low + high), high), low)
    start = np.array([float(np.median(middle)), math.log(max(0.1, float(np.std(middle))))])
    found = minimize(
        loss, start, method="Nelder-Mead", bounds=[(None, None), _BOUNDS], options={"xatol": 1e-5, "fatol": 1e-7}
    )
    return Lognormal(math.exp(float(found.x[0])), math.exp(float(found.x[1])))


@dataclass(frozen=True)
class Fragility:
    """A fitted curve with 95 % intervals by a bootstrap over events.

    Attributes:
        fit: the curve of all records.
        median, dispersion: their intervals, low and high; empty without two failing events.
        failed_fits: bootstrap samples without a fit; if there are many, the intervals are too short.
    """

    fit: Lognormal
    median: tuple[float, float] | tuple[()]
    dispersion: tuple[float, float] | tuple[()]
    failed_fits: int


def fitted(below: Array, capacity: Array, events: Sequence[str], rng: np.random.Generator) -> Fragility | None:
    """The fit with its intervals; None without a fit.

    Records of one event are drawn together, since they are not independent: the bootstrap draws events with
    replacement, as many as there are.

    Args:
        below, capacity: (n,) see `fit_lognormal`.
        events: (n,) of the records.
        rng: draws the events.
    """
    fit = fit_lognormal(below, capacity)
    if fit is None:
        return None
    rows = [np.flatnonzero(np.array(events) == event) for event in dict.fromkeys(events)]
    if len(rows) < 3:
        return Fragility(fit, (), (), 0)
    found = []
    for _ in range(_BOOTSTRAPS):
        drawn = np.concatenate([rows[k] for k in rng.integers(len(rows), size=len(rows))])
        one = fit_lognormal(below[drawn], capacity[drawn])
        if one is not None:
            found.append((one.median, one.dispersion))
    if len(found) < _BOOTSTRAPS // 2:
        return Fragility(fit, (), (), _BOOTSTRAPS - len(found))
    tail = 0.5 * (1.0 - CONFIDENCE)
    (m_low, d_low), (m_high, d_high) = np.quantile(np.array(found), [tail, 1.0 - tail], axis=0).tolist()
    return Fragility(fit, (m_low, m_high), (d_low, d_high), _BOOTSTRAPS - len(found))


@dataclass(frozen=True)
class Margin:
    """The collapse margin of [FEMA2009].

    Attributes:
        cmr: median collapse intensity over that of the maximum considered earthquake.
        acmr: `cmr` times the spectral shape factor.
        acceptable_10, acceptable_20: least acceptable ACMR for 10 and 20 % probability of collapse.
    """

    cmr: float
    acmr: float
    acceptable_10: float
    acceptable_20: float


def collapse_margin(median: float, mce: float, shape_factor: float, total_dispersion: float) -> Margin:
    """The margin of a median collapse intensity.

    The acceptable values follow from a lognormal capacity with the total uncertainty, exp(β Φ⁻¹(1 − p)), which is how
    [FEMA2009, table 7-3] is made.
    """
    cmr = median / mce
    acceptable = [math.exp(total_dispersion * float(ndtri(1.0 - p))) for p in (0.10, 0.20)]
    return Margin(cmr, shape_factor * cmr, *acceptable)
