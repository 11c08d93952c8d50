"""The fragility that follows from the capacities under records: a lognormal fit, its interval over events, P695."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_ndtr, ndtri, stdtrit

from activefail.space import Array

CONFIDENCE = 0.95

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
    records both survive a level and fail at a higher one: the data then do not bound the curve.
    """
    if int((np.isfinite(capacity) & (below > 0.0)).sum()) < 2:
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
    """A fitted curve with 95 % intervals.

    Attributes:
        fit: the curve of all records.
        median, dispersion: their intervals, low and high; empty if they cannot be had.
    """

    fit: Lognormal
    median: tuple[float, float] | tuple[()]
    dispersion: tuple[float, float] | tuple[()]


def fitted(below: Array, capacity: Array, events: Sequence[str]) -> Fragility | None:
    """The fit with its intervals; None without a fit.

    Records of one event are not independent. The intervals therefore come from fits that leave one event out at a time
    (jackknife), on the logarithms of median and dispersion, with Student's t of one degree of freedom less than events.
    `experiments/ida_intervals.py` measures how often they hold, also beside a bootstrap over events. They need at least
    three events, and a fit without any of them.

    Args:
        below, capacity: (n,) see `fit_lognormal`.
        events: (n,) of the records.
    """
    fit = fit_lognormal(below, capacity)
    if fit is None:
        return None

    def logarithm(quantity: Callable[[Lognormal], float]) -> Callable[[NDArray[np.bool_]], float]:
        def of_rows(rows: NDArray[np.bool_]) -> float:
            one = fit_lognormal(below[rows], capacity[rows])
            return math.nan if one is None else math.log(quantity(one))

        return of_rows

    median = jackknife(logarithm(lambda one: one.median), events)
    dispersion = jackknife(logarithm(lambda one: one.dispersion), events)
    return Fragility(
        fit,
        () if median is None else _around(fit.median, median),
        () if dispersion is None else _around(fit.dispersion, dispersion),
    )


def jackknife(statistic: Callable[[NDArray[np.bool_]], float], events: Sequence[str]) -> float | None:
    """Half width of the interval of a statistic, from its values with one event left out at a time.

    Args:
        statistic: of the rows that a mask, (n,), keeps; NaN if it does not exist for them.
        events: (n,) of the rows.

    Returns:
        None with fewer than three events, or where the statistic does not exist without one of them.
    """
    names = np.array(events)
    left_out = np.array([statistic(names != event) for event in dict.fromkeys(events)])
    count = len(left_out)
    if count < 3 or np.isnan(left_out).any():
        return None
    error = math.sqrt((count - 1) / count * float(((left_out - left_out.mean()) ** 2).sum()))
    return float(stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE)) * error


def _around(value: float, half: float) -> tuple[float, float]:
    """The interval of a half width in the logarithm."""
    return value * math.exp(-half), value * math.exp(half)


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
