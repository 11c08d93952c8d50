"""A target that is a risk in a number of years, as a target given one of the pulses of the hazard's curve."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from activefail.campaign.hazard import Hazard
from activefail.campaign.question import PERIOD, PGV
from activefail.errors import InputError
from activefail.risk.design.task import LEAST_TARGET, Rate, Requirement
from activefail.risk.fragility.rates import exceedance
from activefail.space import Array
from activefail.weighted import BLOCKS, WeightedRows, weighted_quantiles

_ROWS = 256
"""Pulses of each block; a power of two."""

_REMAINING, _FARTHEST = 1e-4, 4.0
"""Share of the rate and factor of the velocity at which the extrapolated curve ends; what remains occurs there."""


def at_risk(hazard: Hazard | None, requirements: Sequence[Requirement]) -> tuple[Hazard, tuple[Requirement, ...], Rate]:
    """The pulses of the hazard's curve, targets given one of them, and how often they occur.

    Args:
        hazard: of the site; None without one.
        requirements: targets in a number of years.

    Raises:
        InputError: if there is no hazard or no curve, targets are of different kinds, or one is too small or large.
    """
    years = requirements[0].years
    if any(one.years != years for one in requirements) or years is None:
        raise InputError("target: all targets must be risks in the same number of years, or none.")
    if hazard is None or hazard.settings.curve is None:
        raise InputError("target: a risk in years requires a hazard with a [curve] of annual rates.")
    curve = hazard.settings.curve
    rate = Rate(curve.annual_rate[0], curve.pgv_m_s[0], years)
    given = []
    for one in requirements:
        target = rate.given_pulse(one.target)
        if not LEAST_TARGET <= target <= 0.9:
            raise InputError(
                f"target: {100.0 * one.target:g} % in {years:g} years is a probability of {target:.3g} given a pulse "
                f"of at least {rate.velocity:g} m/s, where the [curve] begins; it must be between {LEAST_TARGET:g} and "
                f"0.9. Begin the curve at a {'larger' if target < LEAST_TARGET else 'smaller'} velocity."
            )
        given.append(one._replace(target=target))
    title = f"pulses of at least {rate.velocity:g} m/s by the curve of {hazard.title}"
    return replace(hazard, title=title, rows=pulses_of_curve(hazard)), tuple(given), rate


def pulses_of_curve(hazard: Hazard) -> WeightedRows:
    """Pulses that occur as a hazard's curve says: T_p and PGV, in blocks each of which is a sample.

    Velocities are even in their logarithms; their weights are the rates. The curve is linear in logarithms and
    extrapolated at its upper end. Periods have their distribution given the velocity.
    """
    curve = hazard.settings.curve
    assert curve is not None
    velocities, rates = np.array(curve.pgv_m_s), np.array(curve.annual_rate)
    slope = np.log(rates[-1] / rates[-2]) / np.log(velocities[-1] / velocities[-2])
    farther = max(0.0, np.log(_REMAINING * rates[0] / rates[-1]) / slope)
    last = velocities[-1] * min(_FARTHEST, math.exp(farther))
    edges = np.exp(np.linspace(np.log(velocities[0]), np.log(last), _ROWS + 1))
    mass = -np.diff(exceedance(velocities, rates, edges))
    mass[-1] += exceedance(velocities, rates, edges[-1:])[0]
    blocks, weights = [], []
    for block in range(BLOCKS):
        U = qmc.Sobol(2, rng=np.random.default_rng(block)).random(_ROWS)
        # A scrambled Sobol' sequence has one point in each of the cells.
        cell = np.minimum((_ROWS * U[:, 0]).astype(np.int_), _ROWS - 1)
        speed = velocities[0] * (last / velocities[0]) ** U[:, 0]
        blocks.append(np.column_stack([_periods(hazard, speed, U[:, 1]), speed]))
        weights.append(mass[cell])
    return WeightedRows((PERIOD, PGV), np.concatenate(blocks), np.concatenate(weights), is_sample=True)


def _periods(hazard: Hazard, velocities: Array, shares: Array) -> Array:
    """Periods [s] at quantiles of their distribution given each velocity, (n,)."""
    if hazard.rows is not None:
        rows = hazard.rows
        return weighted_quantiles(rows.column(PERIOD), rows.weight, shares.tolist())
    medians, dispersions = np.transpose([hazard.period_given(velocity) for velocity in velocities.tolist()])
    return np.asarray(medians * np.exp(dispersions * ndtri(shares)))
