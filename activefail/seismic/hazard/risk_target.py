"""The pulses that occur as a hazard's curve of annual rates says, for targets that are risks in years."""

import math
from collections.abc import Callable

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from activefail.analyses.fragility.curve import Rate
from activefail.seismic.hazard.pulse_table import velocities as velocities_of
from activefail.seismic.hazard.velocity import PERIOD, PGV
from activefail.space.space import Array
from activefail.space.weighted import BLOCKS, WeightedRows, weighted_quantiles

PeriodGiven = Callable[[float], tuple[float, float]]
"""Median [s] and dispersion of the period, given a peak ground velocity [m/s]."""

_ROWS = 256
"""Pulses of each block; a power of two."""

_GRID = 20_000
"""Velocities at which the curve is tabulated."""

_NEAR = 0.1
"""Share of the weight of a table of pulses that gives the periods near a velocity."""

_REMAINING, _FARTHEST = 1e-4, 4.0
"""Share of the rate and factor of the velocity at which the extrapolated curve ends; what remains occurs there."""


def pulses_of_curve(rate: Rate, rows: WeightedRows | None, period_given: PeriodGiven) -> WeightedRows:
    """Pulses that occur as a hazard's curve says: T_p and PGV, in blocks each of which is a sample.

    Velocities are even in the mean of their logarithms' and their rates' shares, so that neither rare strong pulses nor
    a steep part of the curve rest on a few rows; their weights are the rates. The curve is linear in logarithms and
    extrapolated at its upper end. Periods have their distribution given the velocity.

    Args:
        rate: the curve.
        rows: the hazard's table of pulses, if it is one; it gives the periods.
        period_given: median and dispersion of the period given a velocity, without a table.
    """

    def periods(speed: Array, shares: Array) -> Array:
        """Periods [s] at quantiles of their distribution given each velocity, (n,)."""
        if rows is not None:
            return _periods_near(rows, speed, shares)
        medians, dispersions = np.transpose([period_given(one) for one in speed.tolist()])
        return np.asarray(medians * np.exp(dispersions * ndtri(shares)))

    velocities, rates = rate.levels, rate.rates
    slope = np.log(rates[-1] / rates[-2]) / np.log(velocities[-1] / velocities[-2])
    farther = np.clip(np.log(_REMAINING * rates[0] / rates[-1]) / slope, 0.0, math.log(_FARTHEST))
    last = velocities[-1] * math.exp(farther)
    grid = np.unique(np.append(np.geomspace(velocities[0], last, _GRID), velocities))
    nu = rate.exceeding(grid)
    by_rate, by_size = (nu[0] - nu) / (nu[0] - nu[-1]), np.log(grid / grid[0]) / np.log(grid[-1] / grid[0])
    shares, sizes = 0.5 * (by_rate + by_size), np.log(grid)
    edges = np.exp(np.interp(np.linspace(0.0, 1.0, _ROWS + 1), shares, sizes))
    mass = -np.diff(rate.exceeding(edges))
    mass[-1] += nu[-1]
    blocks, weights = [], []
    for block in range(BLOCKS):
        U = qmc.Sobol(2, rng=np.random.default_rng(block)).random(_ROWS)
        # A scrambled Sobol' sequence has one point in each of the cells.
        cell = np.minimum((_ROWS * U[:, 0]).astype(np.int_), _ROWS - 1)
        speed = np.exp(np.interp(U[:, 0], shares, sizes))
        blocks.append(np.column_stack([periods(speed, U[:, 1]), speed]))
        weights.append(mass[cell])
    return WeightedRows((PERIOD, PGV), np.concatenate(blocks), np.concatenate(weights), is_sample=True)


def _periods_near(rows: WeightedRows, velocities: Array, shares: Array) -> Array:
    """Periods at quantiles for a table of pulses: of the tenth of its weight whose velocities are nearest in rank."""
    size = velocities_of(rows)
    order = np.argsort(size, kind="stable")
    size, period, weight = size[order], rows.column(PERIOD)[order], rows.weight[order]
    below = np.cumsum(weight) / weight.sum()
    periods = []
    for rank, share in zip(np.interp(velocities, size, below).tolist(), shares.tolist(), strict=True):
        low = min(max(rank - 0.5 * _NEAR, 0.0), 1.0 - _NEAR)
        first, last = np.searchsorted(below, [low, low + _NEAR])
        near = slice(first, max(first, min(last, len(size) - 1)) + 1)
        periods.append(weighted_quantiles(period[near], weight[near], (share,))[0])
    return np.array(periods)
