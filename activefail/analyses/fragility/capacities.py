"""The fragility that follows from capacities, such as those under records: a lognormal fit and its interval."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_ndtr, ndtr, stdtrit

from activefail.space.space import Array

CONFIDENCE = 0.95

LARGEST = 3.0
"""Largest dispersion of a fit, beyond which data of a few records say nothing."""

_BOUNDS = (math.log(0.02), math.log(LARGEST))
"""Of the logarithm of the dispersion."""

_POWER = -2.0 / 3.0
"""Of the dispersion in its interval. The estimate of a variance, to the power 1/3, is nearly normal, with a standard
deviation in proportion to the true value's [WilsonHilferty1931]; the interval is thus one of the reciprocal."""


@dataclass(frozen=True)
class Lognormal:
    """A lognormal fragility: P(x) = Φ(ln(x/median)/dispersion)."""

    median: float
    dispersion: float

    def at(self, levels: Array | float) -> Array:
        """Probabilities at levels."""
        return np.asarray(ndtr(np.log(np.asarray(levels) / self.median) / self.dispersion))


def fit_lognormal(below: Array, capacity: Array) -> Lognormal | None:
    """The lognormal curve of largest likelihood, from capacities that lie in (below, capacity], (n,) each.

    A record that never fails has an infinite capacity, and says only that it lies above `below`. None if fewer than two
    records both survive a level and fail at a higher one: the data then do not bound the curve.
    """
    if int((np.isfinite(capacity) & (below > 0.0)).sum()) < 2:
        return None
    with np.errstate(divide="ignore"):
        low, high = np.log(below), np.log(capacity)
    # A record without an answer, in (0, inf], says nothing.
    informs = np.isfinite(low) | np.isfinite(high)
    low, high = low[informs], high[informs]

    def loss(parameters: Array) -> float:
        mean, scale = parameters[0], math.exp(parameters[1])
        upper, lower = log_ndtr((high - mean) / scale), log_ndtr((low - mean) / scale)
        # ln(Φ(b) − Φ(a)); where a record never fails the mirrored tail keeps its digits.
        never = np.isinf(high)
        tail = log_ndtr((mean - low) / scale)
        inside = upper + np.log(-np.expm1(np.minimum(lower - upper, -1e-300)))
        return -float(np.where(never, tail, np.maximum(inside, -1e3)).sum())

    middle = 0.5 * (np.where(np.isinf(low), high, low) + np.where(np.isinf(high), low, high))
    start = np.array([float(np.median(middle)), math.log(max(0.1, float(np.std(middle))))])
    optimum = minimize(
        loss, start, method="Nelder-Mead", bounds=[(None, None), _BOUNDS], options={"xatol": 1e-5, "fatol": 1e-7}
    )
    return Lognormal(math.exp(float(optimum.x[0])), math.exp(float(optimum.x[1])))


@dataclass(frozen=True)
class Fragility:
    """A fitted curve with 95 % intervals."""

    fit: Lognormal  # the curve of all records
    median: tuple[float, float] | tuple[()]  # their intervals, low and high; empty if they cannot be had
    dispersion: tuple[float, float] | tuple[()]


def fitted(below: Array, capacity: Array, events: Sequence[str]) -> Fragility | None:
    """The fit with its intervals; None without a fit.

    Records of one event are not independent. The intervals therefore come from fits that leave one event out at a time
    (jackknife), with Student's t of one degree of freedom less than events: on the logarithm of the median, and on the
    dispersion to the power -2/3, without its bias. `studies/ida_intervals.py` measures how often they hold, also
    beside a bootstrap over events. They need at least three events, and a fit without any of them.

    Args:
        below, capacity: (n,) see `fit_lognormal`.
        events: (n,) of the records.
    """
    fit = fit_lognormal(below, capacity)
    if fit is None:
        return None

    def of_rows(rows: NDArray[np.bool_]) -> tuple[float, float]:
        one = fit_lognormal(below[rows], capacity[rows])
        return (math.nan, math.nan) if one is None else (math.log(one.median), one.dispersion**_POWER)

    left_out = _left_out(of_rows, events)
    if left_out is None:
        return Fragility(fit, (), ())
    half_of_median, half = _half_width(left_out).tolist()
    count, value = len(left_out), fit.dispersion**_POWER
    centre = value + (count - 1) * (value - float(left_out[:, 1].mean()))
    # A power that is not positive has no dispersion, so that only the fit's bound is left.
    ends = [end ** (1.0 / _POWER) if end > 0.0 else LARGEST for end in (centre + half, centre - half)]
    return Fragility(
        fit,
        (fit.median * math.exp(-half_of_median), fit.median * math.exp(half_of_median)),
        (ends[0], min(ends[1], LARGEST)),
    )


def jackknife(statistic: Callable[[NDArray[np.bool_]], float], events: Sequence[str]) -> float | None:
    """Half width of the interval of a statistic, from its values with one event left out at a time.

    Args:
        statistic: of the rows that a mask, (n,), keeps; NaN if it does not exist for them.
        events: (n,) of the rows.

    Returns:
        None with fewer than three events, or where the statistic does not exist without one of them.
    """
    left_out = _left_out(lambda rows: (statistic(rows),), events)
    return None if left_out is None else float(_half_width(left_out)[0])


def _left_out(statistics: Callable[[NDArray[np.bool_]], tuple[float, ...]], events: Sequence[str]) -> Array | None:
    """Statistics with one event left out at a time, (events, k); None with fewer than three events, or for NaN."""
    names = np.array(events)
    if len(set(events)) < 3:
        return None
    left_out = np.array([statistics(names != event) for event in dict.fromkeys(events)])
    return None if np.isnan(left_out).any() else left_out


def _half_width(left_out: Array) -> Array:
    """Half widths of the intervals of k statistics from their values with one event left out, (events, k)."""
    count = len(left_out)
    error = np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    return np.asarray(stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE) * error)
