"""Which pulses of a hazard contribute the failures."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.special import ndtr

from activefail.campaign.question import Question
from activefail.learning.criteria.population import integration_points
from activefail.seismic.hazard.strata import deviates
from activefail.seismic.hazard.velocity import PERIOD, PGV
from activefail.space.shares import percent
from activefail.space.space import Array
from activefail.space.weighted import WeightedRows, weighted_quantiles

_POINTS, _WITH_UNCERTAINTY = 4096, 512
"""Pulses of a hazard; fewer where each has several values of the added uncertainty."""

_SPREAD, _LEAST = 8, 2048
"""Least number of values of the added uncertainty, of equal probability: for each pulse, and for all together."""

_BINS = 8

_RAREST = 1e-4
"""Least probability of failure that is attributed to pulses."""


class Percentiles(NamedTuple):
    """The 5th, 50th and 95th percentile."""

    p5: float
    p50: float
    p95: float


class Share(NamedTuple):
    """A part of the pulses, in bins of period and velocity."""

    share: Array  # (8, 8) in each bin
    period: Percentiles  # [s]
    velocity: Percentiles  # [m/s]


@dataclass(frozen=True, eq=False)
class Deaggregation:
    """The failures under a hazard by the pulse period and the peak ground velocity.

    The velocity is that of the ground motion: the added uncertainty belongs to the capacity.

    Attributes:
        probability: of failure under the whole hazard.
        period, velocity: (9,) edges of the bins [s] and [m/s]. The outermost bins are open.
        pulses: all of them.
        failures: those that cause failure; None if failure is too rare.
    """

    probability: float
    period: Array
    velocity: Array
    pulses: Share
    failures: Share | None

    figure: ClassVar[str] = "pulses"
    header: ClassVar[tuple[str, ...]] = (
        "T_p_from",
        "T_p_to",
        "PGV_from",
        "PGV_to",
        "share_of_failures",
        "share_of_pulses",
    )

    @property
    def numbers(self) -> dict[str, Any]:
        """What `--json` shows of it."""
        failures, pulses = self.failures, self.pulses
        return {
            "probability": self.probability,
            "interval": None,
            "interval_reason": "the classifier's number; `activefail probability` with the hazard gives an interval",
            "T_p_edges_s": self.period,
            "PGV_edges_m_s": self.velocity,
            "share_of_failures": failures and failures.share,
            "share_of_pulses": pulses.share,
            "T_p_of_failures_s": failures and failures.period,
            "PGV_of_failures_m_s": failures and failures.velocity,
            "T_p_of_pulses_s": pulses.period,
            "PGV_of_pulses_m_s": pulses.velocity,
        }

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts; a continued title is empty."""
        whole = f"{percent(self.probability)} under the whole hazard"
        if self.failures is None:
            return [("pulses", f"{whole}: failure is too rare to be attributed to pulses")]
        rows = [("pulses", whole)]
        for title, (_, T, v) in (("of the failures", self.failures), ("of all pulses", self.pulses)):
            text = (
                f"{title}: T_p {T.p50:.3g} s ({T.p5:.3g} to {T.p95:.3g}), PGV {v.p50:.3g} m/s ({v.p5:.3g} to "
                f"{v.p95:.3g}); medians and 90 % ranges"
            )
            rows.append(("", text))
        return rows

    @property
    def table(self) -> list[list[Any]]:
        """The bins: their edges, and their shares of the failures, empty if these are too rare, and of the pulses."""
        rows = []
        for row, column in np.ndindex(self.pulses.share.shape):
            edges = [*self.period[row : row + 2].tolist(), *self.velocity[column : column + 2].tolist()]
            of_failures = float(self.failures.share[row, column]) if self.failures else ""
            rows.append([*edges, of_failures, float(self.pulses.share[row, column])])
        return rows


def deaggregated(
    boundaries: Callable[[Array], Array], question: Question, added: float, bias: float, probability: Array
) -> list[Deaggregation]:
    """The failures beyond each boundary by the pulses of a hazard.

    Args:
        boundaries: of the campaign's designs.
        question: of the pulses alone.
        added, bias: dispersion that is added to ln PGV, and the mean that is subtracted.
        probability: (boundaries,) under the whole hazard.
    """
    names = question.space.names
    distribution, n = question.space, _WITH_UNCERTAINTY if added else _POINTS
    X, weight = integration_points(
        distribution.thinned(n) if isinstance(distribution, WeightedRows) else distribution, n
    )
    period, velocity = X[:, names.index(PERIOD)], X[:, names.index(PGV)]
    values = max(_SPREAD, math.ceil(_LEAST / len(X)))
    z = deviates(len(X), values) if added else np.zeros((len(X), 1))
    # What is added divides the capacity, or multiplies the velocity.
    felt = np.repeat(X, z.shape[1], axis=0)
    felt[:, names.index(PGV)] *= np.exp(added * z.ravel() - bias)
    beyond = ndtr(boundaries(question.designs(felt)))
    parts = weight[:, None] * beyond.reshape(*z.shape, -1).mean(axis=1)
    return [_of_boundary(period, velocity, weight, *of) for of in zip(parts.T, probability.tolist(), strict=True)]


def _of_boundary(period: Array, velocity: Array, weight: Array, part: Array, probability: float) -> Deaggregation:
    edges = _edges(period, weight), _edges(velocity, weight)
    row, column = (
        np.clip(np.searchsorted(edge, values, side="right") - 1, 0, _BINS - 1)
        for edge, values in zip(edges, (period, velocity), strict=True)
    )

    def share(weights: Array) -> Share:
        counts = np.bincount(row * _BINS + column, weights=weights, minlength=_BINS * _BINS) / weights.sum()
        return Share(counts.reshape(_BINS, _BINS), *(_percentiles(values, weights) for values in (period, velocity)))

    is_rare = probability < _RAREST or not part.any()
    return Deaggregation(probability, *edges, share(weight), None if is_rare else share(part))


def _edges(values: Array, weight: Array) -> Array:
    """Edges of bins of equal width in the logarithm, between the 0.5th and the 99.5th percentile of the pulses."""
    low, high = weighted_quantiles(values, weight, (0.005, 0.995)).tolist()
    if not low < high:
        low, high = 0.99 * low, 1.01 * high
    return np.geomspace(low, high, _BINS + 1)


def _percentiles(values: Array, weight: Array) -> Percentiles:
    return Percentiles(*weighted_quantiles(values, weight, (0.05, 0.5, 0.95)).tolist())
