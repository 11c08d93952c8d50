"""Which pulses of a hazard contribute the failures."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from activefail.acquisition.population import integration_points
from activefail.campaign.hazard import Hazard, deviates
from activefail.campaign.question import PERIOD, PGV, Question
from activefail.reliability.integral import Boundaries
from activefail.space import Array
from activefail.weighted import WeightedRows, weighted_quantiles

_POINTS, _WITH_UNCERTAINTY = 4096, 512
"""Pulses of a hazard; fewer where each has several values of the added uncertainty."""

_SPREAD, _LEAST = 8, 2048
"""Least number of values of the added uncertainty, of equal probability: for each pulse, and for all together."""

_BINS = 8

_RAREST = 1e-4
"""Least probability of failure that is attributed to pulses."""


class Percentiles(NamedTuple):
    """The 5th, 50th and 95th percentile."""

    low: float
    median: float
    high: float


@dataclass(frozen=True, eq=False)
class Deaggregation:
    """The failures under a hazard by the pulse period and the peak ground velocity.

    The velocity is that of the ground motion: the added uncertainty belongs to the capacity.

    Attributes:
        probability: of failure under the whole hazard.
        period, velocity: (9,) edges of the bins [s] and [m/s]. The outermost bins are open.
        of_failures: (8, 8) share of the failures in each bin, by period and velocity; None if failure is too rare.
        of_pulses: (8, 8) share of the pulses.
        period_of_failures, velocity_of_failures: percentiles; None if failure is too rare.
        period_of_pulses, velocity_of_pulses: percentiles.
    """

    probability: float
    period: Array
    velocity: Array
    of_failures: Array | None
    of_pulses: Array
    period_of_failures: Percentiles | None
    velocity_of_failures: Percentiles | None
    period_of_pulses: Percentiles
    velocity_of_pulses: Percentiles

    def as_json(self) -> dict[str, Any]:
        """The deaggregation as JSON values."""
        percentiles = {
            "T_p_of_failures_s": self.period_of_failures,
            "PGV_of_failures_m_s": self.velocity_of_failures,
            "T_p_of_pulses_s": self.period_of_pulses,
            "PGV_of_pulses_m_s": self.velocity_of_pulses,
        }
        return {
            "probability": self.probability,
            "interval": None,
            "interval_reason": "the classifier's number; `activefail probability` with the hazard gives an interval",
            "T_p_edges_s": self.period.tolist(),
            "PGV_edges_m_s": self.velocity.tolist(),
            "share_of_failures": None if self.of_failures is None else self.of_failures.tolist(),
            "share_of_pulses": self.of_pulses.tolist(),
            **{name: of and dict(zip(("p5", "p50", "p95"), of, strict=True)) for name, of in percentiles.items()},
        }


def deaggregated(
    boundaries: Boundaries, question_of: Callable[[Hazard], Question], hazard: Hazard, probability: Array
) -> list[Deaggregation]:
    """The failures beyond each boundary by the pulses of a hazard.

    Args:
        boundaries: of the campaign's designs.
        question_of: the question that a hazard asks.
        hazard: the hazard.
        probability: (boundaries,) under the whole hazard.
    """
    question = question_of(hazard.without_uncertainty())
    names, added = question.space.names, hazard.added_dispersion
    distribution, n = question.space, _WITH_UNCERTAINTY if added else _POINTS
    X, weight = integration_points(
        distribution.thinned(n) if isinstance(distribution, WeightedRows) else distribution, n
    )
    period, velocity = X[:, names.index(PERIOD)], X[:, names.index(PGV)]
    values = max(_SPREAD, math.ceil(_LEAST / len(X)))
    z = deviates(len(X), values) if added else np.zeros((len(X), 1))
    # What is added divides the capacity, or multiplies the velocity.
    felt = np.repeat(X, z.shape[1], axis=0)
    felt[:, names.index(PGV)] *= np.exp(added * z.ravel() - hazard.bias)
    beyond = ndtr(boundaries(question.designs(felt)))
    parts = weight[:, None] * beyond.reshape(*z.shape, -1).mean(axis=1)
    return [_of_boundary(period, velocity, weight, *of) for of in zip(parts.T, probability.tolist(), strict=True)]


def _of_boundary(period: Array, velocity: Array, weight: Array, part: Array, probability: float) -> Deaggregation:
    edges = [_edges(values, weight) for values in (period, velocity)]

    def binned(weights: Array) -> Array:
        rows = [
            np.clip(np.searchsorted(edge, values, side="right") - 1, 0, _BINS - 1)
            for edge, values in zip(edges, (period, velocity), strict=True)
        ]
        counts = np.bincount(rows[0] * _BINS + rows[1], weights=weights, minlength=_BINS * _BINS)
        return np.asarray(counts / weights.sum()).reshape(_BINS, _BINS)

    rare = probability < _RAREST or not part.any()
    return Deaggregation(
        probability=probability,
        period=edges[0],
        velocity=edges[1],
        of_failures=None if rare else binned(part),
        of_pulses=binned(weight),
        period_of_failures=None if rare else _percentiles(period, part),
        velocity_of_failures=None if rare else _percentiles(velocity, part),
        period_of_pulses=_percentiles(period, weight),
        velocity_of_pulses=_percentiles(velocity, weight),
    )


def _edges(values: Array, weight: Array) -> Array:
    """Edges of bins of equal width in the logarithm, between the 0.5th and the 99.5th percentile of the pulses."""
    low, high = weighted_quantiles(values, weight, (0.005, 0.995)).tolist()
    if not low < high:
        low, high = 0.99 * low, 1.01 * high
    return np.geomspace(low, high, _BINS + 1)


def _percentiles(values: Array, weight: Array) -> Percentiles:
    return Percentiles(*weighted_quantiles(values, weight, (0.05, 0.5, 0.95)).tolist())
